"""Where one scheme overtakes another as more of the same goes wrong.

AP between two levels is taken to be linear. The second scheme overtakes the first at the level from which on it has the
higher AP up to the greatest level that was tried; where one of them never leads by `LEAST_LEAD`, nobody overtakes. The
interval is that of these levels over draws of blocks of frames, the same draws for both schemes; in a draw where the
second never overtakes, the level is infinite.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from placement_env.analysis.intervals import percentiles
from placement_env.report.content import CONFIDENCE
from placement_env.report.stress.outcomes import StressRow
from toolkit.arrays import Float64
from toolkit.runtime.files import finite

LEAST_LEAD = 0.005  # of AP, from which on one scheme is said to be better than another


@dataclass(frozen=True)
class Crossing:
    """From `level` on the scheme `after` has a higher AP than `before`. low, high: interval of the level, infinite
    where it lies beyond what was tried; share: of the draws in which the second overtakes the first there at all."""

    kind: str
    iou: float
    before: str
    after: str
    level: float
    low: float
    high: float
    share: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON: None for infinity."""
        return {name: finite(value) for name, value in asdict(self).items()}


@dataclass(frozen=True)
class BestScheme:
    """The scheme of the highest AP from one level to another, both of what was tried or where schemes cross."""

    kind: str
    iou: float
    scheme: str
    start: float
    end: float


def crossings(rows: Sequence[StressRow], *, seed: int = 0) -> tuple[Crossing, ...]:
    """Of every two schemes that change places, kind by kind and IoU by IoU, the lowest level first."""
    made: list[Crossing] = []
    for (kind, iou), schemes in _graded(rows).items():
        levels = np.array([row.amount for row in next(iter(schemes.values()))])
        aps = {name: _aps(each) for name, each in schemes.items()}
        drawn = {name: np.stack([_resampled(row, seed) for row in each]) for name, each in schemes.items()}
        for one, other in combinations(schemes, 2):
            before, after = (one, other) if aps[other][-1] > aps[one][-1] else (other, one)
            lead = aps[after] - aps[before]
            if not (lead[-1] >= LEAST_LEAD and lead.min() <= -LEAST_LEAD):
                continue
            level = overtaken(levels, lead)
            each = np.array([overtaken(levels, d) for d in (drawn[after] - drawn[before]).T if not np.isnan(d).any()])
            share = float(np.isfinite(each).mean()) if len(each) else 0.0
            low, high = _middle(each)
            made.append(Crossing(kind, iou, before, after, level, min(low, level), max(high, level), share))
    return tuple(sorted(made, key=lambda each: (each.kind, each.iou, each.level)))


def best_schemes(rows: Sequence[StressRow]) -> tuple[BestScheme, ...]:
    """Which scheme is best at which levels, kind by kind and IoU by IoU: one stays so until another leads by
    `LEAST_LEAD`."""
    made: list[BestScheme] = []
    for (kind, iou), schemes in _graded(rows).items():
        levels = np.array([row.amount for row in next(iter(schemes.values()))])
        aps = np.stack([_aps(each) for each in schemes.values()])
        places = np.unique(np.concatenate([levels, *(_zeros(levels, a - b) for a, b in combinations(aps, 2))]))
        middles = (places[1:] + places[:-1]) / 2
        best = 0
        for start, end, middle in zip(places[:-1].tolist(), places[1:].tolist(), middles.tolist(), strict=True):
            at = np.array([np.interp(middle, levels, ap) for ap in aps])
            best = best if at[best] > at.max() - LEAST_LEAD else int(at.argmax())
            name = list(schemes)[best]
            if made and (made[-1].kind, made[-1].iou, made[-1].scheme) == (kind, iou, name):
                start = made.pop().start
            made.append(BestScheme(kind, iou, name, start, end))
    return tuple(made)


def overtaken(levels: Float64[np.ndarray, " n"], lead: Float64[np.ndarray, " n"]) -> float:
    """The level from which on a lead, linear between levels, is above 0 up to the last; infinite where it is not there.

    >>> overtaken(np.array([0.0, 0.2, 0.4]), np.array([-0.1, -0.1, 0.3])), overtaken(np.arange(2.0), np.array([1.0, 0]))
    (0.25, inf)
    """
    if not lead[-1] > 0:
        return math.inf
    behind = np.flatnonzero(lead <= 0)
    if not len(behind):
        return float(levels[0])
    k = behind[-1]
    return float(levels[k] + (levels[k + 1] - levels[k]) * lead[k] / (lead[k] - lead[k + 1]))


def _graded(rows: Sequence[StressRow]) -> dict[tuple[str, float], dict[str, list[StressRow]]]:
    """Rows whose level is a number, in its order, by kind and IoU and then by scheme; two schemes and two levels at
    least."""
    found: dict[tuple[str, float], dict[str, list[StressRow]]] = {}
    for row in rows:
        if row.amount is not None:
            found.setdefault((row.kind, row.iou), {}).setdefault(row.scheme, []).append(row)
    ordered = {
        key: {name: sorted(each, key=lambda row: row.amount or 0.0) for name, each in schemes.items()}
        for key, schemes in found.items()
    }
    return {key: each for key, each in ordered.items() if len(each) > 1 and len(next(iter(each.values()))) > 1}


def _aps(rows: Sequence[StressRow]) -> Float64[np.ndarray, " levels"]:
    return np.nan_to_num(np.array([row.judged.ap for row in rows]))


def _resampled(row: StressRow, seed: int) -> Float64[np.ndarray, " resamples"]:
    if row.tally is None:
        raise ValueError(f"{row.kind} {row.level}: nothing is known of its frames: take rows as stress makes them")
    return row.tally.resamples(seed=seed)


def _zeros(levels: Float64[np.ndarray, " n"], lead: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " m"]:
    """Where it changes its sign between levels."""
    k = np.flatnonzero(lead[1:] * lead[:-1] < 0)
    return levels[k] + (levels[k + 1] - levels[k]) * lead[k] / (lead[k] - lead[k + 1])


def _middle(levels: Float64[np.ndarray, " draws"]) -> tuple[float, float]:
    """The interval of levels, some of which may be infinite."""
    some = percentiles(np.where(np.isfinite(levels), levels, np.finfo(float).max), confidence=CONFIDENCE)
    low, high = (math.inf if end > 1e100 else end for end in some)
    return low, high
