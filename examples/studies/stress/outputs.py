"""Results of a stress test, as text, JSON and SVG, and the levels at which schemes change places.

A condition gets worse with its level. AP is taken as linear between two levels. The second scheme
overtakes the first at the level from which its AP is higher up to the greatest level tried. If one
of them never leads by `MIN_LEAD_AP`, neither overtakes. The interval of that level comes from draws
of blocks of frames, the same draws for both schemes. A draw in which the second scheme never
overtakes counts as infinite."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from examples.studies.stress.noticing import FalseAlarms, Noticed
from examples.studies.stress.stressing import StressRow
from placement_env.analysis.intervals import percentiles
from placement_env.analysis.worth import failures
from placement_env.fidelity.table import Table
from placement_env.report.charts import interval_bars
from placement_env.report.content import CONFIDENCE
from toolkit.arrays import Float64, Int64
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.display import format_share
from toolkit.runtime.text_tables import align_columns
from toolkit.runtime.text_values import replace_infinite
from toolkit.runtime.writing import write_text, writing_together

STRESS_FILES = ("stress.json", "stress.svg")
MIN_LEAD_AP = 0.005  # a scheme must lead by this to count as better

_Levels = Float64[np.ndarray, " levels"]
_Schemes = dict[str, list[StressRow]]


@dataclass(frozen=True)
class Crossing:
    """Level from which scheme `after` has a higher AP than scheme `before`.

    Attributes:
        kind: Kind of stress.
        iou: IoU threshold.
        before: Scheme with the higher AP below the level.
        after: Scheme with the higher AP above the level.
        level: The level.
        low: Lower end of the level's interval.
        high: Upper end of the interval, infinite beyond the greatest level tried.
        share: Share of the draws with a crossing."""

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
    """Scheme with the highest AP between the levels `start` and `end`, for a kind and IoU."""

    kind: str
    iou: float
    scheme: str
    start: float
    end: float


def find_crossings(rows: Sequence[StressRow], *, seed: int = 0) -> tuple[Crossing, ...]:
    """Find every pair of schemes that change places, with the level at which they do.

    Sorted by kind, IoU and level. seed: seed of the draws. Raises ValueError for rows without
    a tally."""
    crossings: list[Crossing] = []
    for (kind, iou), levels, schemes in _group_by_scheme(rows):
        if any(row.tally is None for scheme_rows in schemes.values() for row in scheme_rows):
            raise ValueError(
                f"frames under {kind} are unknown: pass the rows that run_stress returns"
            )
        aps = {name: _aps(scheme_rows) for name, scheme_rows in schemes.items()}
        drawn_aps = {name: _draw_aps(scheme_rows, seed) for name, scheme_rows in schemes.items()}
        for first, second in combinations(schemes, 2):
            before, after = (first, second) if aps[second][-1] > aps[first][-1] else (second, first)
            lead = aps[after] - aps[before]
            if not (lead[-1] >= MIN_LEAD_AP and lead.min() <= -MIN_LEAD_AP):
                continue
            level = crossing_level(levels, lead)
            drawn_levels = _draw_levels(levels, drawn_aps[after] - drawn_aps[before])
            is_crossing = np.isfinite(drawn_levels)
            share = float(is_crossing.mean()) if len(drawn_levels) else 0.0
            # the greatest float for infinity, so that percentiles can be interpolated
            finite_levels = np.where(is_crossing, drawn_levels, np.finfo(float).max)
            low, high = percentiles(finite_levels, confidence=CONFIDENCE)
            low = min(math.inf if low > 1e100 else low, level)
            high = max(math.inf if high > 1e100 else high, level)
            crossings.append(Crossing(kind, iou, before, after, level, low, high, share))
    crossings.sort(key=lambda crossing: (crossing.kind, crossing.iou, crossing.level))
    return tuple(crossings)


def _draw_aps(rows: Sequence[StressRow], seed: int) -> Float64[np.ndarray, "levels draws"]:
    """Return the AP of each level in each resample of the frames. rows: one for each level."""
    tallies = [row.tally for row in rows if row.tally is not None]
    return np.stack([tally.resamples(seed=seed) for tally in tallies])


def _draw_levels(
    levels: _Levels, leads: Float64[np.ndarray, "levels draws"]
) -> Float64[np.ndarray, " n"]:
    """Return the crossing level of each resample without NaN, infinite if the lead never stays."""
    valid_leads = [lead for lead in leads.T if not np.isnan(lead).any()]
    return np.array([crossing_level(levels, lead) for lead in valid_leads])


def best_schemes(rows: Sequence[StressRow]) -> tuple[BestScheme, ...]:
    """Return the best scheme at each level, per kind and IoU.

    A scheme remains the best until another one leads by `MIN_LEAD_AP`."""
    best_ranges: list[BestScheme] = []
    for (kind, iou), levels, schemes in _group_by_scheme(rows):
        names = list(schemes)
        aps = np.stack([_aps(scheme_rows) for scheme_rows in schemes.values()])
        changes = [levels]  # levels, and points between them at which a lead changes its sign
        for first, second in combinations(aps, 2):
            lead = first - second
            k = np.flatnonzero(lead[1:] * lead[:-1] < 0)  # the sign changes after level k
            changes.append(_find_zero(levels, lead, k))
        best = 0
        for start, end in pairwise(np.unique(np.concatenate(changes)).tolist()):
            middle = (start + end) / 2
            aps_at_middle = np.array([np.interp(middle, levels, ap) for ap in aps])
            if aps_at_middle[best] <= aps_at_middle.max() - MIN_LEAD_AP:
                best = int(aps_at_middle.argmax())
            best_range = BestScheme(kind, iou, names[best], start, end)
            if best_ranges and _continues(best_ranges[-1], best_range):
                best_range = replace(best_range, start=best_ranges.pop().start)
            best_ranges.append(best_range)
    return tuple(best_ranges)


def _continues(before: BestScheme, after: BestScheme) -> bool:
    """Return True if two neighbouring ranges of levels have the same scheme, kind and IoU."""
    return (before.kind, before.iou, before.scheme) == (after.kind, after.iou, after.scheme)


def _find_zero(
    levels: _Levels, lead: Float64[np.ndarray, " levels"], k: Int64[np.ndarray, " k"]
) -> Float64[np.ndarray, " k"]:
    """Return the levels at which a lead, linear between levels, is 0.

    k: index of the level before each; the lead changes its sign up to the next level."""
    return levels[k] + (levels[k + 1] - levels[k]) * lead[k] / (lead[k] - lead[k + 1])


def crossing_level(levels: Float64[np.ndarray, " n"], lead: Float64[np.ndarray, " n"]) -> float:
    """Return the level from which a lead remains above 0 up to the last level.

    The lead is linear between levels. The result is infinite if the lead is not above 0 at the
    last level. levels: ascending; lead: lead at each."""
    if not lead[-1] > 0:
        return math.inf
    behind = np.flatnonzero(lead <= 0)
    if not len(behind):
        return float(levels[0])
    return float(_find_zero(levels, lead, behind[-1:])[0])


def _group_by_scheme(
    rows: Sequence[StressRow],
) -> Iterator[tuple[tuple[str, float], _Levels, _Schemes]]:
    """Yield kind and IoU, ascending levels, and rows by scheme in the order of levels.

    Rows without a level as a number, and groups of one level or one scheme, are left out."""
    groups: dict[tuple[str, float], _Schemes] = {}
    for row in rows:
        if row.amount is not None:
            groups.setdefault((row.kind, row.iou), {}).setdefault(row.scheme, []).append(row)
    for key, schemes in groups.items():
        for scheme_rows in schemes.values():
            scheme_rows.sort(key=lambda row: row.amount or 0.0)
        levels = np.array([row.amount for row in next(iter(schemes.values()))])
        if len(schemes) > 1 and len(levels) > 1:
            yield key, levels, schemes


def _aps(rows: Sequence[StressRow]) -> Float64[np.ndarray, " levels"]:
    # AP of each row, 0 if it is undefined
    return np.nan_to_num(np.array([row.judged.ap for row in rows]))


@dataclass(frozen=True)
class ExactFailure:
    """AP of all sensors, and its mean and minimum over all failures of `failing` sensors.

    Attributes:
        scheme: Name of the scheme.
        iou: IoU threshold.
        failing: Number of failing sensors.
        intact: AP of all sensors.
        mean: Mean AP over all failures.
        worst: Lowest AP over all failures.
        without: Names of the sensors whose failure leaves the lowest AP.
        objects: Number of objects to find in all frames."""

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
    """Compute AP after all failures of one and of two sensors (N-1, N-2), of every scheme.

    table: AP of all sensor sets; ious: thresholds; the table must hold one; label: class.
    Raises ValueError if a table has none of the IoUs, or not the class."""
    names = table.origin.sensors
    classes = table.origin.classes
    class_ious = table.origin.ious[classes.index(label) if label in classes else 0]
    usable_ious = [iou for iou in ious if iou in class_ious]
    if not usable_ious:
        table_ious = ", ".join(map(str, dict.fromkeys(class_ious)))
        asked_ious = ", ".join(map(str, dict.fromkeys(ious)))
        raise ValueError(
            f"this table holds AP at IoU {table_ious}, not at {asked_ious}: change --iou"
        )
    exact: list[ExactFailure] = []
    objects = table.origin.objects
    for scheme in PAPER_SCHEMES:
        for iou in usable_ious:
            ap = table.column(scheme, label, iou)[0]

            def look_up(sets: np.ndarray, ap: np.ndarray = ap) -> np.ndarray:
                return ap[table.row(sets)]

            for failing in range(1, min(2, len(names)) + 1):
                left = failures(look_up, np.ones(len(names), bool), failing=failing)
                failure = ExactFailure(
                    scheme,
                    iou,
                    failing,
                    left.intact,
                    left.mean,
                    left.worst,
                    without=tuple(names[k] for k in left.most_missed),
                    objects=objects,
                )
                exact.append(failure)
    return tuple(exact)


@dataclass(frozen=True)
class StressResults:
    """Results of a stress test, None for what was not examined.

    Attributes:
        rows: Results of each scheme, condition and IoU.
        crossings: Levels at which schemes change places.
        noticed: Times until the sensors' monitors notice faults.
        false_alarms: False alarms of the monitors.
        exact: Exact failures, from a table."""

    rows: tuple[StressRow, ...]
    crossings: tuple[Crossing, ...] | None = None
    noticed: tuple[Noticed, ...] | None = None
    false_alarms: tuple[FalseAlarms, ...] | None = None
    exact: tuple[ExactFailure, ...] | None = None

    def as_dict(self, provenance: Mapping[str, object]) -> dict[str, object]:
        """Return the values for JSON, with None for undefined figures."""
        lists: dict[str, object] = {}
        for name, rows in vars(self).items():
            if rows is not None:
                lists[name] = [_values(row) for row in rows]
        return {"provenance": dict(provenance), **replace_infinite(lists)}

    def as_text(self) -> str:
        """Format tables for readers, one below the other."""
        texts = [format_stress_rows(self.rows)]
        if self.crossings is not None:
            texts.append(format_crossings(self.rows, self.crossings))
        if self.noticed is not None and self.false_alarms is not None:
            texts.append(format_noticed(self.noticed, self.false_alarms))
        if self.exact is not None:
            texts.append(format_exact(self.exact))
        return "\n\n".join(filter(None, texts))


def _values(row: StressRow | Crossing | Noticed | FalseAlarms | ExactFailure) -> dict[str, object]:
    # values of a row for JSON, without tallies
    values = {name: value for name, value in vars(row).items() if name != "tally"}
    if isinstance(row, StressRow):
        values["judged"] = asdict(row.judged)
    return values


def format_stress_rows(rows: Sequence[StressRow]) -> str:
    """Format a table with a line for each scheme, condition and IoU."""
    table = [
        ["stress", "level", "scheme", "sent as", "IoU", "AP", "95 % interval", "kbit/sensor", "age"]
    ]
    for row in rows:
        judged = row.judged
        names = [row.kind, row.level, row.scheme, row.codec, f"{row.iou:g}"]
        kbit = f"{row.kbit_per_sensor:.2f}"
        figures = [judged.format_ap(), judged.describe_interval(), kbit, f"{row.age:.2f} s"]
        table.append([*names, *figures])
    return align_columns(table, texts=4)


def format_crossings(rows: Sequence[StressRow], crossings: Sequence[Crossing]) -> str:
    """Format the best scheme per range of levels, and the levels of overtaking."""
    best = [["highest AP", "IoU", "scheme", "from", "to"]]
    best += [
        [
            best_range.kind,
            f"{best_range.iou:g}",
            best_range.scheme,
            f"{best_range.start:.2f}",
            f"{best_range.end:.2f}",
        ]
        for best_range in best_schemes(rows)
    ]
    table = [["overtaken", "IoU", "scheme", "by", "from level", "95 % interval", "of draws"]]
    for crossing in crossings:
        names = [crossing.kind, f"{crossing.iou:g}", crossing.before, crossing.after]
        interval = f"{crossing.low:.2f} to {crossing.high:.2f}"
        table.append([*names, f"{crossing.level:.2f}", interval, f"{crossing.share:.0%}"])
    texts = []
    if len(best) > 1:
        texts.append(align_columns(best, texts=3))
    if len(table) > 1:
        texts.append(align_columns(table, texts=4))
    return "\n\n".join(texts)


def format_noticed(noticed: Sequence[Noticed], alarms: Sequence[FalseAlarms]) -> str:
    """Format the times to notice faults, and false alarms."""
    table = [["fault", "sent as", "cases", "noticed", "median", "worst"]]
    for row in noticed:
        times = [f"{seconds:.1f} s" for seconds in (row.median, row.worst)]
        table.append([row.fault, row.sent_as, str(row.cases), str(row.noticed), *times])
    false = [["false alarms: link", "sent as", "alarms", "sensor-minutes"]]
    false += [
        [alarm.link, alarm.sent_as, str(alarm.alarms), f"{alarm.minutes:.1f}"] for alarm in alarms
    ]
    return f"{align_columns(table, texts=2)}\n\n{align_columns(false, texts=2)}"


def format_exact(left: Sequence[ExactFailure]) -> str:
    """Format N-1 and N-2 from a table, a line each."""
    table = [["exact", "scheme", "IoU", "intact", "mean", "worst", "without"]]
    for failure in left:
        names = [f"N-{failure.failing}", failure.scheme, f"{failure.iou:g}"]
        aps = (failure.intact, failure.mean, failure.worst)
        figures = [format_share(ap, failure.objects) for ap in aps]
        table.append([*names, *figures, ", ".join(failure.without)])
    return align_columns(table, texts=2)


def write_rows(
    rows: Sequence[StressRow], provenance: Mapping[str, object], folder: str | Path
) -> None:
    """Write only stress.json, with the rows so far."""
    path = Path(folder) / "stress.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    content = StressResults(tuple(rows)).as_dict(provenance)
    write_text(path, json.dumps(content, indent=1, allow_nan=False))


def write_stress(
    results: StressResults, provenance: Mapping[str, object], folder: str | Path
) -> None:
    """Write `STRESS_FILES` into a folder, made if missing.

    All files are written or, if that fails (OSError), none."""
    named_judgements = [
        (f"{row.kind} {row.level}: {row.scheme}, {row.codec}, IoU {row.iou:g}", row.judged)
        for row in results.rows
    ]
    content = results.as_dict(provenance)
    with writing_together(folder) as unfinished:
        write_text(unfinished / "stress.json", json.dumps(content, indent=1, allow_nan=False))
        write_text(unfinished / "stress.svg", interval_bars(named_judgements, "AP under stress"))
