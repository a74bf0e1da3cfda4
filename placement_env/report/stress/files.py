"""A stress test as text, JSON and SVG."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from placement_env.report.drawings.charts import interval_bars
from placement_env.report.stress.crossings import Crossing, best_schemes
from placement_env.report.stress.exact_failures import ExactFailure
from placement_env.report.stress.noticing import FalseAlarms, Noticed
from placement_env.report.stress.outcomes import StressRow
from toolkit.runtime.files import finite, write_text, writing_together
from toolkit.runtime.text_tables import aligned

STRESS_FILES = ("stress.json", "stress.svg")


def format_stress(rows: Sequence[StressRow]) -> str:
    """A line for each scheme under each condition at each IoU."""
    table = [["stress", "level", "scheme", "sent as", "IoU", "AP", "95 % interval", "kbit/sensor", "age"]]
    for row in rows:
        judged = row.judged
        figures = [f"{judged.ap:.3f}", f"{judged.low:.3f} to {judged.high:.3f}", f"{row.kbit_per_sensor:.2f}"]
        table.append([row.kind, row.level, row.scheme, row.codec, f"{row.iou:g}", *figures, f"{row.age:.2f} s"])
    return aligned(table, texts=4)


def format_crossings(rows: Sequence[StressRow], crossed: Sequence[Crossing]) -> str:
    """Which scheme is best up to which level, and where schemes overtake each other; empty where no level is a
    number."""
    best = [["highest AP", "IoU", "scheme", "from", "to"]]
    best += [[b.kind, f"{b.iou:g}", b.scheme, f"{b.start:.2f}", f"{b.end:.2f}"] for b in best_schemes(rows)]
    table = [["overtaken", "IoU", "scheme", "by", "from level", "95 % interval", "of draws"]]
    for each in crossed:
        ends = f"{each.low:.2f} to {each.high:.2f}"
        said = [each.kind, f"{each.iou:g}", each.before, each.after, f"{each.level:.2f}", ends, f"{each.share:.0%}"]
        table.append(said)
    texts = [aligned(best, texts=3), aligned(table, texts=4)]
    return "\n\n".join(text for text, lines in zip(texts, (best, table), strict=True) if len(lines) > 1)


def format_noticed(noticed: Sequence[Noticed], alarms: Sequence[FalseAlarms]) -> str:
    """How soon faults are noticed, and how often one is said to be that is none."""
    table = [["fault", "sent as", "cases", "noticed", "median", "worst"]]
    for each in noticed:
        times = [f"{seconds:.1f} s" for seconds in (each.median, each.worst)]
        table.append([each.fault, each.sent_as, str(each.cases), str(each.noticed), *times])
    false = [["false alarms: link", "sent as", "alarms", "sensor-minutes"]]
    false += [[each.link, each.sent_as, str(each.alarms), f"{each.minutes:.1f}"] for each in alarms]
    return f"{aligned(table, texts=2)}\n\n{aligned(false, texts=2)}"


def format_exact(left: Sequence[ExactFailure]) -> str:
    """N-1 and N-2 of a table, a line each."""
    table = [["exact", "scheme", "IoU", "intact", "mean", "worst", "without"]]
    for each in left:
        figures = [f"{ap:.3f}" for ap in (each.intact, each.mean, each.worst)]
        table.append([f"N-{each.failing}", each.scheme, f"{each.iou:g}", *figures, ", ".join(each.without)])
    return aligned(table, texts=2)


def stress_content(rows: Sequence[StressRow], provenance: Mapping[str, Any], **beside: Sequence[Any]) -> dict[str, Any]:
    """For JSON: figures that are undefined are None. beside: lists of what else is known, by what it is, such as
    crossings."""
    lists = {name: [each.as_dict() for each in some] for name, some in beside.items()}
    return {"provenance": dict(provenance), **finite({"rows": [row.as_dict() for row in rows], **lists})}


def write_rows(rows: Sequence[StressRow], provenance: Mapping[str, Any], folder: str | Path) -> None:
    """Write stress.json alone, of the rows that are there so far."""
    path = Path(folder) / "stress.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(stress_content(rows, provenance), indent=1, allow_nan=False))


def write_stress(rows: Sequence[StressRow], content: Mapping[str, Any], folder: str | Path) -> None:
    """Write `STRESS_FILES` into a folder made if missing: all, or where that fails (OSError) none. content: of
    `stress_content`."""
    named = [(f"{row.kind} {row.level}: {row.scheme}, {row.codec}, IoU {row.iou:g}", row.judged) for row in rows]
    with writing_together(folder) as unfinished:
        write_text(unfinished / "stress.json", json.dumps(content, indent=1, allow_nan=False))
        write_text(unfinished / "stress.svg", interval_bars(named, "AP under stress"))
