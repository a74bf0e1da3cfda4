"""`Fidelity`: a way to score sensor sets, from counting points to running the detector."""

from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from placement_env.classes import Classes
from placement_env.subsets import Sets
from toolkit.arrays import Float64

FidelityName = Literal["coverage", "surrogate", "detector", "table"]


class Estimate(NamedTuple):
    """Figures of n sensor sets.

    Attributes:
        ap: Average precision (0 to 1) of each set.
        recall: Recall (0 to 1) of each set.
        kbit: Data that all sensors of a set send in a frame, averaged over frames.
    """

    ap: Float64[np.ndarray, " n"]
    recall: Float64[np.ndarray, " n"]
    kbit: Float64[np.ndarray, " n"]

    def without_nan(self) -> "Estimate":
        """Same figures, with AP and recall 0 instead of NaN, which means no object to detect."""
        return Estimate(
            ap=np.nan_to_num(self.ap), recall=np.nan_to_num(self.recall), kbit=self.kbit
        )


class ClassEstimates(NamedTuple):
    """Figures of n sensor sets for each of k classes, NaN for a class without objects.

    Attributes:
        ap: Average precision of each set for each class.
        recall: Recall of each set for each class.
        kbit: Data that all sensors of a set send in a frame, the same for all classes.
    """

    ap: Float64[np.ndarray, "n k"]
    recall: Float64[np.ndarray, "n k"]
    kbit: Float64[np.ndarray, " n"]

    def combined(self, classes: Classes) -> Estimate:
        """Combine the classes to one AP and recall of each set, as `classes` weighs them."""
        return Estimate(
            ap=classes.combined(self.ap), recall=classes.combined(self.recall), kbit=self.kbit
        )


@runtime_checkable
class Fidelity(Protocol):
    """Scorer of sets of candidates, given as rows of booleans.

    The same sets get the same figures, in any order.
    """

    @property
    def name(self) -> str:
        """Name: coverage, surrogate, detector or table."""

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Figures of each set; the empty set has AP 0 and sends nothing."""


@runtime_checkable
class ByFrames(Fidelity, Protocol):
    """Fidelity that can score sets on some of the frames, so that weak sets are dropped early."""

    @property
    def frames(self) -> int:
        """Number of frames."""

    def partial(self, subsets: Sets, frames: Sequence[int]) -> Estimate:
        """Figures of each set over these frames only, scoring no set on a frame twice.

        frames: indices of frames; what earlier calls scored is taken from memory."""


@runtime_checkable
class ByClass(Fidelity, Protocol):
    """Fidelity whose figures combine some classes of road users."""

    @property
    def classes(self) -> Classes:
        """Classes, and how they are combined."""

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """Figures of each set for each class, in the order of `classes`.

        Combined they are the figures that a call of the fidelity gives."""


@runtime_checkable
class Doubting(Fidelity, Protocol):
    """Fidelity that was fitted to data and estimates its uncertainty."""

    def spread(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Standard error of each set's AP; NaN if unknown."""

    def doubts(self, sensors: Iterable[str] = ()) -> tuple[str, ...]:
        """Sentences on how the scored sets differ from the data that the fidelity was fitted to.

        sensors: kinds of the candidates' sensor models. Empty if nothing differs."""
