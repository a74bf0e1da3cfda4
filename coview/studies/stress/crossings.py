"""Levels at which one scheme overtakes another.

The condition gets worse with its level. AP is taken as linear between two levels. The second scheme overtakes the first
at the level from which its AP is higher up to the greatest level tried; if one of them never leads by `LEAST_LEAD`,
neither overtakes. The interval of that level comes from draws of blocks of frames, the same draws for both schemes; a
draw in which the second scheme never overtakes counts as infinite.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from coview.studies.stress.stressing import StressRow
from placement_env.analysis.intervals import percentiles
from placement_env.report.content import CONFIDENCE
from toolkit.arrays import Float64

LEAST_LEAD = 0.005  # AP by which one scheme must lead to count as better

_Levels = Float64[np.ndarray, " levels"]
_Schemes = dict[str, list[StressRow]]


@dataclass(frozen=True)
class Crossing:
    """Level from which scheme `after` has a higher AP than `before`.

    low, high: interval of the level, infinite beyond what was tried; share: of the draws with a crossing at all.
    """

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
    """Scheme with the highest AP between two levels. Each level was tried or is a crossing."""

    kind: str
    iou: float
    scheme: str
    start: float
    end: float


def find_crossings(rows: Sequence[StressRow], *, seed: int = 0) -> tuple[Crossing, ...]:
    """Find every pair of schemes that change places. Per kind and IoU, lowest level first."""
    found: list[Crossing] = []
    for (kind, iou), levels, schemes in _group_by_scheme(rows):
        if any(row.tally is None for each in schemes.values() for row in each):
            raise ValueError(f"frames under {kind} are unknown: pass the rows that run_stress returns")
        aps = {name: _aps(each) for name, each in schemes.items()}
        drawn = {
            name: np.stack([row.tally.resamples(seed=seed) for row in each if row.tally is not None])
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
            ends = percentiles(np.where(np.isfinite(each), each, np.finfo(float).max), confidence=CONFIDENCE)
            low, high = (math.inf if end > 1e100 else end for end in ends)
            found.append(Crossing(kind, iou, before, after, level, min(low, level), max(high, level), share))
    return tuple(sorted(found, key=lambda each: (each.kind, each.iou, each.level)))


def best_schemes(rows: Sequence[StressRow]) -> tuple[BestScheme, ...]:
    """Best scheme at each level, per kind and IoU. A scheme stays the best until another one leads by `LEAST_LEAD`."""
    found: list[BestScheme] = []
    for (kind, iou), levels, schemes in _group_by_scheme(rows):
        aps = np.stack([_aps(each) for each in schemes.values()])
        zeros = [levels]  # and the places between levels where a lead changes its sign
        for one, other in combinations(aps, 2):
            lead = one - other
            k = np.flatnonzero(lead[1:] * lead[:-1] < 0)
            zeros.append(levels[k] + (levels[k + 1] - levels[k]) * lead[k] / (lead[k] - lead[k + 1]))
        places = np.unique(np.concatenate(zeros))
        middles = (places[1:] + places[:-1]) / 2
        best = 0
        for start, end, middle in zip(places[:-1].tolist(), places[1:].tolist(), middles.tolist(), strict=True):
            at = np.array([np.interp(middle, levels, ap) for ap in aps])
            best = best if at[best] > at.max() - LEAST_LEAD else int(at.argmax())
            name = list(schemes)[best]
            if found and (found[-1].kind, found[-1].iou, found[-1].scheme) == (kind, iou, name):
                start = found.pop().start
            found.append(BestScheme(kind, iou, name, start, end))
    return tuple(found)


def crossing_level(levels: Float64[np.ndarray, " n"], lead: Float64[np.ndarray, " n"]) -> float:
    """Level from which a lead, linear between levels, stays above 0 up to the last. Infinite if it never does.

    >>> crossing_level(np.array([0.0, 0.2, 0.4]), np.array([-0.1, -0.1, 0.3]))
    0.25
    >>> crossing_level(np.arange(2.0), np.array([1.0, 0]))
    inf
    """
    if not lead[-1] > 0:
        return math.inf
    behind = np.flatnonzero(lead <= 0)
    if not len(behind):
        return float(levels[0])
    k = behind[-1]
    return float(levels[k] + (levels[k + 1] - levels[k]) * lead[k] / (lead[k] - lead[k + 1]))


def _group_by_scheme(rows: Sequence[StressRow]) -> Iterator[tuple[tuple[str, float], _Levels, _Schemes]]:
    """Levels, and rows with an amount by kind, IoU and scheme. Groups with fewer than two of either are left out."""
    found: dict[tuple[str, float], _Schemes] = {}
    for row in rows:
        if row.amount is not None:
            found.setdefault((row.kind, row.iou), {}).setdefault(row.scheme, []).append(row)
    for key, schemes in found.items():
        ordered = {name: sorted(each, key=lambda row: row.amount or 0.0) for name, each in schemes.items()}
        levels = np.array([row.amount for row in next(iter(ordered.values()))])
        if len(ordered) > 1 and len(levels) > 1:
            yield key, levels, ordered


def _aps(rows: Sequence[StressRow]) -> Float64[np.ndarray, " levels"]:
    return np.nan_to_num(np.array([row.judged.ap for row in rows]))
