"""What is left of a set when sensors fail: the mean over which of them do, or the worst case (N-1, N-2).

A set with no more sensors than may fail is worth nothing then. `TIE` of the AP of the intact set tells equal ones
apart, so that a search that adds one sensor after another does not begin blindly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, cast, get_args

import numpy as np

from placement_env.cases import MOST_FAILING, TIE
from placement_env.checks import whole
from placement_env.fidelity.combined.like import LikeFirst, LikeFirstByFrames
from placement_env.protocol import ByClass, ByFrames, ClassEstimates, Estimate, Fidelity
from toolkit.arrays import Bool, Float64, Int64

FailureCombine = Literal["mean", "worst"]


@dataclass(frozen=True)
class Failing:
    """How many sensors fail, 0 to 2, and whether the mean over which of them do counts or the worst case. Raises
    ValueError where it is none of these."""

    sensors: int = 0
    combine: FailureCombine = "worst"

    def __post_init__(self) -> None:
        if not whole(self.sensors) or not 0 <= self.sensors <= MOST_FAILING:
            raise ValueError(f"0, 1 or 2 sensors may fail, got {self.sensors!r}")
        if self.combine not in get_args(FailureCombine):
            raise ValueError(f"failures are combined by mean or worst, got {self.combine!r}")

    @property
    def described(self) -> str:
        """What is left, in words.

        >>> Failing(1).described, Failing(2, "mean").described
        ('what is left in the worst case when 1 sensor fails', 'what is left in the mean over which 2 sensors fail')
        """
        what = "1 sensor fails" if self.sensors == 1 else f"{self.sensors} sensors fail"
        return f"what is left in the {'worst case when' if self.combine == 'worst' else 'mean over which'} {what}"

    def cases(self, subsets: Bool[np.ndarray, "n C"]) -> tuple[Bool[np.ndarray, "m C"], Int64[np.ndarray, " m"]]:
        """The intact sets, and after them what is left in each case of failure; and of which set each is a case. A set
        of which nothing may be left has one case, the empty set."""
        rows, owners = [*subsets], [*range(len(subsets))]
        for n, row in enumerate(subsets):
            members = np.flatnonzero(row)
            if len(members) <= self.sensors:
                rows.append(np.zeros(len(row), np.bool_))
                owners.append(n)
                continue
            for lost in combinations(members.tolist(), self.sensors):
                left = row.copy()
                left[list(lost)] = False
                rows.append(left)
                owners.append(n)
        return np.array(rows, np.bool_).reshape(len(rows), subsets.shape[1]), np.array(owners, np.int64)

    def left(
        self, figures: Float64[np.ndarray, "m *rest"], owners: Int64[np.ndarray, " m"]
    ) -> Float64[np.ndarray, "n *rest"]:
        """What is left of each set, of figures of the cases; NaN stays."""
        reduced = self.reduced(figures, owners)
        return reduced + TIE * figures[: len(reduced)]

    def reduced(
        self, figures: Float64[np.ndarray, "m *rest"], owners: Int64[np.ndarray, " m"]
    ) -> Float64[np.ndarray, "n *rest"]:
        """The same without what tells equal sets apart."""
        count = int(owners.max(initial=-1)) + 1
        cases, of = figures[count:], owners[count:]
        return np.stack([self._reduced(cases[of == n]) for n in range(count)]) if count else figures[:0]

    def _reduced(self, cases: np.ndarray) -> np.ndarray:
        return np.asarray(cases.mean(axis=0) if self.combine == "mean" else cases.min(axis=0))


class RobustFidelity(LikeFirst):
    """Sets scored by what is left when sensors fail; kbit are those of the intact set."""

    def __init__(self, fidelity: Fidelity, failing: Failing) -> None:
        super().__init__(fidelity)
        self._failing = failing

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """AP and recall that are left of each set."""
        return self._of(subsets, self._first)

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """The same of each class. The worst case of one class need not be that of another."""
        rows, owners = self._failing.cases(subsets)
        found = cast(ByClass, self._first).by_class(rows)
        ap, recall = (self._failing.left(each, owners) for each in (found.ap, found.recall))
        return ClassEstimates(ap, recall, found.kbit[: len(subsets)])

    def _of(self, subsets: Bool[np.ndarray, "n C"], scores: Callable[[Any], Estimate]) -> Estimate:
        rows, owners = self._failing.cases(subsets)
        found = scores(rows)
        ap, recall = (self._failing.left(each, owners) for each in (found.ap, found.recall))
        return Estimate(ap, recall, found.kbit[: len(subsets)])


class RobustByFrames(RobustFidelity, LikeFirstByFrames):
    """The same of a fidelity that scores some frames alone."""

    def partial(self, subsets: Bool[np.ndarray, "n C"], frames: Sequence[int]) -> Estimate:
        """Figures of each set over these frames."""
        inner = cast(ByFrames, self._first)
        return self._of(subsets, lambda rows: inner.partial(rows, frames))


def robust(fidelity: Fidelity, failing: Failing) -> Fidelity:
    """The fidelity itself where nothing fails, else what is left of it."""
    if not failing.sensors:
        return fidelity
    made = RobustByFrames if isinstance(fidelity, ByFrames) else RobustFidelity
    return made(fidelity, failing)
