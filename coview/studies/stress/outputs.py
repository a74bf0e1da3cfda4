"""Results of a stress test: levels at which schemes overtake each other, and all figures as text,
JSON and SVG.

The condition gets worse with its level. AP is taken as linear between two levels. The second scheme
overtakes the first at the level from which its AP is higher up to the greatest level tried; if one
of them never leads by `LEAST_LEAD`, neither overtakes. The interval of that level comes from draws
of blocks of frames, the same draws for both schemes; a draw in which the second scheme never
overtakes counts as infinite."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from coview.studies.stress.noticing import FalseAlarms, Noticed
from coview.studies.stress.stressing import StressRow
from placement_env.analysis.intervals import percentiles
from placement_env.analysis.worth import failures
from placement_env.fidelity.table import Table
from placement_env.report.charts import interval_bars
from placement_env.report.content import CONFIDENCE
from toolkit.arrays import Float64
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.display import format_share
from toolkit.runtime.files import replace_infinite, write_text, writing_together
from toolkit.runtime.text_tables import align_columns

LEAST_LEAD = 0.005  # AP by which one scheme must lead to count as better

_Levels = Float64[np.ndarray, " levels"]
_Schemes = dict[str, list[StressRow]]


@dataclass(frozen=True)
class Crossing:
    """Level from which scheme `after` has a higher AP than `before`. low, high: interval of the
    level, infinite beyond what was tried; share: of the draws with a crossing at all."""

    kind: str
    iou: float
    before: str
    after: str
    level: float
    low: float
    high: float
    share: float


@dataclass(frozen=True)
class BestScheme:
    """Scheme with the highest AP between two levels."""

    kind: str
    iou: float
    scheme: str
    start: float
    end: float


def find_crossings(rows: Sequence[StressRow], *, seed: int = 0) -> tuple[Crossing, ...]:
    """Find every pair of schemes that change places."""
    found: list[Crossing] = []
    for (kind, iou), levels, schemes in _group_by_scheme(rows):
        if any(row.tally is None for each in schemes.values() for row in each):
            raise ValueError(
                f"frames under {kind} are unknown: pass the rows that run_stress returns"
            )
        aps = {name: _aps(each) for name, each in schemes.items()}
        drawn = {
            name: np.stack(
                [row.tally.resamples(seed=seed) for row in each if row.tally is not None]
            )
            for name, each in schemes.items()
        }
        for one, other in combinations(schemes, 2):
            before, after = (one, other) if aps[other][-1] > aps[one][-1] else (other, one)
            lead = aps[after] - aps[before]
            if not (lead[-1] >= LEAST_LEAD and lead.min() <= -LEAST_LEAD):
                continue
            level = crossing_level(levels, lead)
            draws = [lead for lead in (drawn[after] - drawn[before]).T if not np.isnan(lead).any()]
            each = np.array([crossing_level(levels, lead) for lead in draws])
            share = float(np.isfinite(each).mean()) if len(each) else 0.0
            ends = percentiles(
                np.where(np.isfinite(each), each, np.finfo(float).max), confidence=CONFIDENCE
            )
            low, high = (math.inf if end > 1e100 else end for end in ends)
            found.append(
                Crossing(kind, iou, before, after, level, min(low, level), max(high, level), share)
            )
    return tuple(sorted(found, key=lambda each: (each.kind, each.iou, each.level)))


def best_schemes(rows: Sequence[StressRow]) -> tuple[BestScheme, ...]:
    """Best scheme at each level, per kind and IoU. A scheme stays the best until another one leads
    by `LEAST_LEAD`."""
    found: list[BestScheme] = []
    for (kind, iou), levels, schemes in _group_by_scheme(rows):
        aps = np.stack([_aps(each) for each in schemes.values()])
        zeros = [levels]  # and the places between levels where a lead changes its sign
        for one, other in combinations(aps, 2):
            lead = one - other
            k = np.flatnonzero(lead[1:] * lead[:-1] < 0)
            zeros.append(
                levels[k] + (levels[k + 1] - levels[k]) * lead[k] / (lead[k] - lead[k + 1])
            )
        places = np.unique(np.concatenate(zeros))
        middles = (places[1:] + places[:-1]) / 2
        best = 0
        for start, end, middle in zip(
            places[:-1].tolist(), places[1:].tolist(), middles.tolist(), strict=True
        ):
            at = np.array([np.interp(middle, levels, ap) for ap in aps])
            best = best if at[best] > at.max() - LEAST_LEAD else int(at.argmax())
            name = list(schemes)[best]
            if found and (found[-1].kind, found[-1].iou, found[-1].scheme) == (kind, iou, name):
                start = found.pop().start
            found.append(BestScheme(kind, iou, name, start, end))
    return tuple(found)


def crossing_level(levels: Float64[np.ndarray, " n"], lead: Float64[np.ndarray, " n"]) -> float:
    """Level from which a lead, linear between levels, stays above 0 up to the last. Infinite if it
    never does."""
    if not lead[-1] > 0:
        return math.inf
    behind = np.flatnonzero(lead <= 0)
    if not len(behind):
        return float(levels[0])
    k = behind[-1]
    return float(levels[k] + (levels[k + 1] - levels[k]) * lead[k] / (lead[k] - lead[k + 1]))


def _group_by_scheme(
    rows: Sequence[StressRow],
) -> Iterator[tuple[tuple[str, float], _Levels, _Schemes]]:
    """Levels, and rows by kind, IoU and scheme, where both are at least two."""
    found: dict[tuple[str, float], _Schemes] = {}
    for row in rows:
        if row.amount is not None:
            found.setdefault((row.kind, row.iou), {}).setdefault(row.scheme, []).append(row)
    for key, schemes in found.items():
        ordered = {
            name: sorted(each, key=lambda row: row.amount or 0.0) for name, each in schemes.items()
        }
        levels = np.array([row.amount for row in next(iter(ordered.values()))])
        if len(ordered) > 1 and len(levels) > 1:
            yield key, levels, ordered


def _aps(rows: Sequence[StressRow]) -> Float64[np.ndarray, " levels"]:
    return np.nan_to_num(np.array([row.judged.ap for row in rows]))


STRESS_FILES = ("stress.json", "stress.svg")


@dataclass(frozen=True)
class ExactFailure:
    """AP of all sensors, and its mean and minimum over every choice of `failing` sensors that fail.
    without: names of the sensors whose failure leaves the least; objects: number to find in all
    frames."""

    scheme: str
    iou: float
    failing: int
    intact: float
    mean: float
    worst: float
    without: tuple[str, ...]
    objects: int


def exact_failures(
    table: Table, *, ious: Sequence[float] = (0.7,), label: str = "vehicle"
) -> tuple[ExactFailure, ...]:
    """Compute N-1 and N-2 of every scheme at these IoUs. Raises ValueError if a table lacks them
    all, or the class."""
    names = table.origin.sensors
    at = (
        table.origin.ious[table.origin.classes.index(label)]
        if label in table.origin.classes
        else table.origin.ious[0]
    )
    known = [iou for iou in ious if iou in at]
    if not known:
        held, given = (", ".join(map(str, dict.fromkeys(each))) for each in (at, ious))
        raise ValueError(f"this table holds AP at IoU {held}, not at {given}: change --iou")
    found = list[ExactFailure]()
    objects = table.origin.objects
    for scheme in PAPER_SCHEMES:
        for iou in known:
            ap = table.column(scheme, label, iou)[0]

            def look_up(sets: np.ndarray, ap: np.ndarray = ap) -> np.ndarray:
                return ap[table.row(sets)]

            for failing in range(1, min(2, len(names)) + 1):
                left = failures(look_up, np.ones(len(names), bool), failing=failing)
                without = tuple(names[k] for k in left.most_missed)
                found.append(
                    ExactFailure(
                        scheme, iou, failing, left.intact, left.mean, left.worst, without, objects
                    )
                )
    return tuple(found)


@dataclass(frozen=True)
class StressResults:
    """Results of a stress test, None where nothing was examined. rows: of each scheme, condition
    and IoU; noticed, false_alarms: of the sensors' monitors; exact: from a table."""

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
    table = [
        ["stress", "level", "scheme", "sent as", "IoU", "AP", "95 % interval", "kbit/sensor", "age"]
    ]
    for row in rows:
        judged = row.judged
        figures = [judged.format_ap(), judged.describe_interval(), f"{row.kbit_per_sensor:.2f}"]
        table.append(
            [
                row.kind,
                row.level,
                row.scheme,
                row.codec,
                f"{row.iou:g}",
                *figures,
                f"{row.age:.2f} s",
            ]
        )
    return align_columns(table, texts=4)


def format_crossings(rows: Sequence[StressRow], crossings: Sequence[Crossing]) -> str:
    """Format the best scheme per range of levels, and where schemes overtake each other."""
    best = [["highest AP", "IoU", "scheme", "from", "to"]]
    best += [
        [b.kind, f"{b.iou:g}", b.scheme, f"{b.start:.2f}", f"{b.end:.2f}"]
        for b in best_schemes(rows)
    ]
    table = [["overtaken", "IoU", "scheme", "by", "from level", "95 % interval", "of draws"]]
    for each in crossings:
        names = [each.kind, f"{each.iou:g}", each.before, each.after]
        table.append(
            [*names, f"{each.level:.2f}", f"{each.low:.2f} to {each.high:.2f}", f"{each.share:.0%}"]
        )
    texts = [align_columns(best, texts=3), align_columns(table, texts=4)]
    return "\n\n".join(
        text for text, lines in zip(texts, (best, table), strict=True) if len(lines) > 1
    )


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
        figures = [format_share(ap, each.objects) for ap in (each.intact, each.mean, each.worst)]
        table.append(
            [f"N-{each.failing}", each.scheme, f"{each.iou:g}", *figures, ", ".join(each.without)]
        )
    return align_columns(table, texts=2)


def write_rows(
    rows: Sequence[StressRow], provenance: Mapping[str, object], folder: str | Path
) -> None:
    """Write stress.json alone, with the rows so far."""
    path = Path(folder) / "stress.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(
        path, json.dumps(StressResults(tuple(rows)).as_dict(provenance), indent=1, allow_nan=False)
    )


def write_stress(
    results: StressResults, provenance: Mapping[str, object], folder: str | Path
) -> None:
    """Write `STRESS_FILES` into a folder, made if missing: all of them or, if that fails (OSError),
    none."""
    named = [
        (f"{r.kind} {r.level}: {r.scheme}, {r.codec}, IoU {r.iou:g}", r.judged)
        for r in results.rows
    ]
    content = results.as_dict(provenance)
    with writing_together(folder) as unfinished:
        write_text(unfinished / "stress.json", json.dumps(content, indent=1, allow_nan=False))
        write_text(unfinished / "stress.svg", interval_bars(named, "AP under stress"))
