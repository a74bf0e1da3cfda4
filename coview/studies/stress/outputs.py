"""Results of a stress test as text, JSON and SVG. A table of every set adds what is left when sensors fail for good."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from coview.studies.stress.crossings import Crossing, best_schemes
from coview.studies.stress.noticing import FalseAlarms, Noticed
from coview.studies.stress.stressing import StressRow
from placement_env.analysis.worth import failures
from placement_env.fidelity.table import Table
from placement_env.report.charts import interval_bars
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.objects import LABELS, VEHICLE
from toolkit.runtime.files import replace_infinite, write_text, writing_together
from toolkit.runtime.text_tables import align_columns

STRESS_FILES = ("stress.json", "stress.svg")


@dataclass(frozen=True)
class ExactFailure:
    """AP of all sensors, and its mean and minimum over every choice of `failing` sensors that fail.

    without: names of the sensors whose failure leaves the least.
    """

    scheme: str
    iou: float
    failing: int
    intact: float
    mean: float
    worst: float
    without: tuple[str, ...]


def exact_failures(
    table: Table, *, ious: Sequence[float] = (0.7,), label: str = LABELS[VEHICLE]
) -> tuple[ExactFailure, ...]:
    """Compute N-1 and N-2 of every scheme at those IoUs that the table holds.

    Raises ValueError if it holds none of the IoUs, or not this class.
    """
    names = table.origin.sensors
    at = table.origin.ious[table.origin.classes.index(label)] if label in table.origin.classes else table.origin.ious[0]
    known = [iou for iou in ious if iou in at]
    if not known:
        held, given = (", ".join(map(str, dict.fromkeys(each))) for each in (at, ious))
        raise ValueError(f"this table holds AP at IoU {held}, not at {given}: change --iou")
    found: list[ExactFailure] = []
    for scheme in PAPER_SCHEMES:
        for iou in known:
            ap = table.column(scheme, label, iou)[0]

            def look_up(sets: np.ndarray, ap: np.ndarray = ap) -> np.ndarray:
                return ap[table.row(sets)]

            for failing in range(1, min(2, len(names)) + 1):
                left = failures(look_up, np.ones(len(names), bool), failing=failing)
                without = tuple(names[k] for k in left.most_missed)
                found.append(ExactFailure(scheme, iou, failing, left.intact, left.mean, left.worst, without))
    return tuple(found)


@dataclass(frozen=True)
class StressResults:
    """Results of a stress test, None where nothing was examined.

    rows: of each scheme, condition and IoU; noticed, false_alarms: of the sensors' monitors; exact: from a table.
    """

    rows: tuple[StressRow, ...]
    crossings: tuple[Crossing, ...] | None = None
    noticed: tuple[Noticed, ...] | None = None
    false_alarms: tuple[FalseAlarms, ...] | None = None
    exact: tuple[ExactFailure, ...] | None = None

    def as_dict(self, provenance: Mapping[str, object]) -> dict[str, object]:
        """Return the values for JSON: None for undefined figures."""
        given = {name: some for name, some in vars(self).items() if some is not None}
        lists = {name: [_values(row) for row in some] for name, some in given.items()}
        return {"provenance": dict(provenance), **replace_infinite(lists)}

    def as_text(self) -> str:
        """Tables for people, one below the other."""
        texts = [format_rows(self.rows)]
        texts += [] if self.crossings is None else [format_crossings(self.rows, self.crossings)]
        if self.noticed is not None and self.false_alarms is not None:
            texts.append(format_noticed(self.noticed, self.false_alarms))
        texts += [] if self.exact is None else [format_exact(self.exact)]
        return "\n\n".join(filter(None, texts))


def _values(row: StressRow | Crossing | Noticed | FalseAlarms | ExactFailure) -> dict[str, object]:
    kept = {name: value for name, value in vars(row).items() if name != "tally"}
    return kept | ({"judged": asdict(row.judged)} if isinstance(row, StressRow) else {})


def format_rows(rows: Sequence[StressRow]) -> str:
    """Format a line per scheme, condition and IoU."""
    table = [["stress", "level", "scheme", "sent as", "IoU", "AP", "95 % interval", "kbit/sensor", "age"]]
    for row in rows:
        judged = row.judged
        figures = [f"{judged.ap:.3f}", f"{judged.low:.3f} to {judged.high:.3f}", f"{row.kbit_per_sensor:.2f}"]
        table.append([row.kind, row.level, row.scheme, row.codec, f"{row.iou:g}", *figures, f"{row.age:.2f} s"])
    return align_columns(table, texts=4)


def format_crossings(rows: Sequence[StressRow], crossings: Sequence[Crossing]) -> str:
    """Format the best scheme per range of levels, and where schemes overtake each other, if levels are numbers."""
    best = [["highest AP", "IoU", "scheme", "from", "to"]]
    best += [[b.kind, f"{b.iou:g}", b.scheme, f"{b.start:.2f}", f"{b.end:.2f}"] for b in best_schemes(rows)]
    table = [["overtaken", "IoU", "scheme", "by", "from level", "95 % interval", "of draws"]]
    for each in crossings:
        names = [each.kind, f"{each.iou:g}", each.before, each.after]
        table.append([*names, f"{each.level:.2f}", f"{each.low:.2f} to {each.high:.2f}", f"{each.share:.0%}"])
    texts = [align_columns(best, texts=3), align_columns(table, texts=4)]
    return "\n\n".join(text for text, lines in zip(texts, (best, table), strict=True) if len(lines) > 1)


def format_noticed(noticed: Sequence[Noticed], alarms: Sequence[FalseAlarms]) -> str:
    """Format the times to notice faults, and false alarms."""
    table = [["fault", "sent as", "cases", "noticed", "median", "worst"]]
    for each in noticed:
        times = [f"{seconds:.1f} s" for seconds in (each.median, each.worst)]
        table.append([each.fault, each.sent_as, str(each.cases), str(each.noticed), *times])
    false = [["false alarms: link", "sent as", "alarms", "sensor-minutes"]]
    false += [[each.link, each.sent_as, str(each.alarms), f"{each.minutes:.1f}"] for each in alarms]
    return f"{align_columns(table, texts=2)}\n\n{align_columns(false, texts=2)}"


def format_exact(left: Sequence[ExactFailure]) -> str:
    """N-1 and N-2 from a table, a line each."""
    table = [["exact", "scheme", "IoU", "intact", "mean", "worst", "without"]]
    for each in left:
        figures = [f"{ap:.3f}" for ap in (each.intact, each.mean, each.worst)]
        table.append([f"N-{each.failing}", each.scheme, f"{each.iou:g}", *figures, ", ".join(each.without)])
    return align_columns(table, texts=2)


def write_rows(rows: Sequence[StressRow], provenance: Mapping[str, object], folder: str | Path) -> None:
    """Write stress.json alone, with the rows so far."""
    path = Path(folder) / "stress.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    content = StressResults(tuple(rows)).as_dict(provenance)
    write_text(path, json.dumps(content, indent=1, allow_nan=False))


def write_stress(results: StressResults, provenance: Mapping[str, object], folder: str | Path) -> None:
    """Write `STRESS_FILES` into a folder, made if missing: all of them or, if that fails (OSError), none."""
    named = [(f"{r.kind} {r.level}: {r.scheme}, {r.codec}, IoU {r.iou:g}", r.judged) for r in results.rows]
    content = results.as_dict(provenance)
    with writing_together(folder) as unfinished:
        write_text(unfinished / "stress.json", json.dumps(content, indent=1, allow_nan=False))
        write_text(unfinished / "stress.svg", interval_bars(named, "AP under stress"))
