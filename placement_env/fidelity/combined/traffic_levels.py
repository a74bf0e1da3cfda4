"""AP over levels of traffic: the frames in parts by how many objects are there at once, the worst part or their mean.

A set that is best on the whole may be weak where traffic is dense and hides itself, or where it is thin. Parts in which
there is nothing to find say nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast, get_args

import numpy as np

from placement_env.cases import LEVEL_NAMES, MOST_LEVELS
from placement_env.checks import whole
from placement_env.fidelity.combined.like import LikeFirst
from placement_env.protocol import ByClass, ClassEstimates, Estimate, Fidelity
from toolkit.arrays import Bool, Float64, Int64

LevelCombine = Literal["mean", "worst"]


@dataclass(frozen=True)
class TrafficLevels:
    """count: of levels, 1 for all traffic as one; combine: whether their worst AP counts or the mean. Raises ValueError
    where it is none of these."""

    count: int = 1
    combine: LevelCombine = "worst"

    def __post_init__(self) -> None:
        if not whole(self.count) or not 1 <= self.count <= MOST_LEVELS:
            raise ValueError(f"traffic has 1 to {MOST_LEVELS} levels, got {self.count!r}")
        if self.combine not in get_args(LevelCombine):
            raise ValueError(f"levels are combined by mean or worst, got {self.combine!r}")

    @property
    def described(self) -> str:
        """Over what an AP is taken, in words.

        >>> TrafficLevels(3).described, TrafficLevels(2, "mean").described
        ('at the worst of 3 levels of traffic', 'in the mean over 2 levels of traffic')
        """
        how = "at the worst of" if self.combine == "worst" else "in the mean over"
        return f"{how} {self.count} levels of traffic"

    @property
    def names(self) -> tuple[str, ...]:
        """Of the levels, thin traffic first."""
        return LEVEL_NAMES[self.count]

    def parts(self, objects: Int64[np.ndarray, " frames"]) -> tuple[Int64[np.ndarray, " _"], ...]:
        """The frames of each level, thin traffic first, as many in each as can be. objects: there are in each frame.

        >>> [part.tolist() for part in TrafficLevels(2).parts(np.array([5, 0, 9, 2]))]
        [[1, 3], [0, 2]]
        """
        order = np.argsort(objects, kind="stable")
        return tuple(np.sort(part) for part in np.array_split(order, self.count) if len(part))

    def combined(self, figures: Float64[np.ndarray, "levels *rest"]) -> Float64[np.ndarray, "*rest"]:
        """One figure of those of the levels; NaN stands for nothing to find, and is the answer where all are."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of levels that are all NaN
            return np.asarray(np.nanmin(figures, axis=0) if self.combine == "worst" else np.nanmean(figures, axis=0))


ALL_TRAFFIC = TrafficLevels()


class LevelFidelity(LikeFirst):
    """Sets scored over levels; kbit are those of all traffic. whole, parts: fidelity of all frames, and of each level's
    alone."""

    def __init__(self, whole: Fidelity, parts: Sequence[Fidelity], levels: TrafficLevels) -> None:
        super().__init__(whole)
        self._parts, self._levels = tuple(parts), levels

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """AP and recall of each set over the levels."""
        found = [each(subsets) for each in self._parts]
        ap, recall = (self._levels.combined(np.stack(each)) for each in zip(*(f[:2] for f in found), strict=True))
        return Estimate(ap, recall, self._first(subsets).kbit)

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """The same of each class. The worst level of one class need not be that of another."""
        found = [cast(ByClass, each).by_class(subsets) for each in self._parts]
        ap, recall = (self._levels.combined(np.stack(each)) for each in zip(*(f[:2] for f in found), strict=True))
        return ClassEstimates(ap, recall, cast(ByClass, self._first).by_class(subsets).kbit)
