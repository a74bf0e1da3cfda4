"""`Fidelity`: how sensor sets are scored, from counting points to running the detector; all of them look the same."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal, NamedTuple, Protocol, get_args, runtime_checkable

import numpy as np

from placement_env.classes import Classes
from toolkit.arrays import Bool, Float64

FidelityName = Literal["coverage", "surrogate", "detector", "table"]
FIDELITIES: tuple[FidelityName, ...] = get_args(FidelityName)


class Estimate(NamedTuple):
    """What a fidelity says of n sensor sets. ap and recall: 0 to 1, of the scored objects; kbit: what the sensors of a
    set send together in a frame, mean over the frames."""

    ap: Float64[np.ndarray, " n"]
    recall: Float64[np.ndarray, " n"]
    kbit: Float64[np.ndarray, " n"]


class ClassEstimates(NamedTuple):
    """The same of each of k classes: ap and recall NaN where a class has nothing to find; kbit: of the whole set."""

    ap: Float64[np.ndarray, "n k"]
    recall: Float64[np.ndarray, "n k"]
    kbit: Float64[np.ndarray, " n"]

    def combined(self, classes: Classes) -> Estimate:
        """One figure of all classes."""
        return Estimate(classes.combined(self.ap), classes.combined(self.recall), self.kbit)


@runtime_checkable
class Fidelity(Protocol):
    """Scores sets of C candidates, given as rows of booleans. The same sets get the same figures, in any order."""

    @property
    def name(self) -> str:
        """coverage, surrogate, detector or table."""

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Figures of each set; the empty set has AP 0 and sends nothing."""


@runtime_checkable
class ByFrames(Fidelity, Protocol):
    """A fidelity that also scores sets on some of its frames alone, so that weak ones may be dropped early."""

    @property
    def frames(self) -> int:
        """How many there are."""

    def partial(self, subsets: Bool[np.ndarray, "n C"], frames: Sequence[int]) -> Estimate:
        """Figures of each set over these frames; what was scored on a frame before is not scored there again."""


@runtime_checkable
class ByClass(Fidelity, Protocol):
    """A fidelity whose figures are those of some classes of road users, combined."""

    @property
    def classes(self) -> Classes:
        """Which they are, and how they are combined."""

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """Figures of each set for each class; combined they are what it says of the set."""


@runtime_checkable
class Doubting(Fidelity, Protocol):
    """A fidelity that was fitted to something, and says how sure it is."""

    def spread(self, subsets: Bool[np.ndarray, "n C"]) -> Float64[np.ndarray, " n"]:
        """Standard deviation of the AP of each set over resamples of what it was fitted to; NaN where not known."""

    def doubts(self, sensors: Iterable[str] = ()) -> tuple[str, ...]:
        """In what way it is asked about something else, a sentence each. sensors: kinds of their models."""


def check_fidelity(fidelity: Any) -> None:
    """Raises ValueError where there is no fidelity of that name."""
    if fidelity not in FIDELITIES:
        raise ValueError(f"fidelity must be one of {', '.join(FIDELITIES)}, got {fidelity!r}")
