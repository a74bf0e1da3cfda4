"""Failures: what a sensor set is worth when one of its sensors, or several, are lost (N-1, N-2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from placement_env.analysis.tables import columns
from placement_env.subsets import SetFunction
from toolkit.arrays import Bool, Float64, Int64


@dataclass(frozen=True, eq=False)
class Failures:
    """Values of a sensor set of which each combination of a number of sensors fails. intact: the value with none
    failed; lost: the sensors that fail, a row for each of k combinations; left: the value of those that remain."""

    intact: float
    lost: Int64[np.ndarray, "k failing"]
    left: Float64[np.ndarray, " k"]

    @property
    def mean(self) -> float:
        """Mean value over the combinations."""
        return float(self.left.mean())

    @property
    def worst(self) -> float:
        """Least value of any combination."""
        return float(self.left.min())

    @property
    def most_missed(self) -> tuple[int, ...]:
        """The sensors whose failure leaves the least; of equal combinations the first."""
        return tuple(self.lost[self.left.argmin()].tolist())


def failures(value: SetFunction, chosen: Bool[np.ndarray, " C"], *, failing: int = 1) -> Failures:
    """What remains of a chosen set when every combination of `failing` of its sensors fails: 1 is N-1, 2 is N-2.

    Raises ValueError if the set does not have that many sensors.
    """
    members = np.flatnonzero(chosen)
    if not 1 <= failing <= len(members):
        raise ValueError(f"from 1 to all {len(members)} sensors of the set can fail, got failing={failing}")
    lost = np.array(list(combinations(members.tolist(), failing)))
    sets = np.repeat(chosen[None], len(lost) + 1, axis=0)
    sets[np.arange(len(lost))[:, None] + 1, lost] = False
    figures = np.asarray(value(sets), float)
    return Failures(float(figures[0]), lost, figures[1:])


def format_failures(cases: Sequence[Failures], names: Sequence[str]) -> str:
    """A line per number of failing sensors: mean and least value, and the failure that leaves the least."""
    table = [["failing", "intact", "mean", "worst", "without"]]
    for failed in cases:
        figures = [f"{figure:.4f}" for figure in (failed.intact, failed.mean, failed.worst)]
        table.append([f"N-{failed.lost.shape[1]}", *figures, ", ".join(names[i] for i in failed.most_missed)])
    return columns(table)
