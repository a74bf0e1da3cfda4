"""`CasesFidelity`: score sets over all cases, from the scorers of single cases."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar, cast

import numpy as np

from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.protocol import ByClass, ByFrames, ClassEstimates, Estimate, Fidelity
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Int64

_Estimated = TypeVar("_Estimated", Estimate, ClassEstimates)


@dataclass(frozen=True)
class ProfileFidelities:
    """Scorers of sets with sensor errors of one profile."""

    whole: Fidelity  # in all frames, at the first IoU threshold
    levels: tuple[tuple[Fidelity, ...], ...]  # for each level of traffic, one for each threshold


class CasesFidelity:
    """Score sets over all cases: error profiles, IoU thresholds, levels of traffic and failures.

    kbit are for the intact set in all traffic: at the error profile with the least AP, or
    means over the profiles, as the cases combine them.

    Args:
        profiles: Scorers at each error profile, in the order of `cases.profiles`.
        cases: Cases, and how they are combined."""

    def __init__(self, profiles: Sequence[ProfileFidelities], cases: Cases) -> None:
        self._profiles = tuple(profiles)
        self.cases = cases
        self._first = profiles[0].whole
        self.detector = getattr(self._first, "detector", None)

    @property
    def name(self) -> str:
        """Name of the fidelity that all cases are scored by."""
        return self._first.name

    @property
    def classes(self) -> Classes:
        """Classes of the objects that count, and how they are combined."""
        return cast(ByClass, self._first).classes

    def __call__(self, subsets: Sets, /) -> Estimate:
        """AP, recall and kbit of each set over all cases."""
        return self._reduce(subsets, lambda fidelity, rows: fidelity(rows))

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """AP and recall of each set for each class over all cases, and kbit of the set.

        Each class has its worst failure and level; the worst error profile is the one of all
        classes together."""
        by_profile = self._at_profiles(
            subsets, lambda fidelity, rows: cast(ByClass, fidelity).by_class(rows)
        )
        return ClassEstimates(
            *self._over_profiles(
                by_profile, [estimates.combined(self.classes).ap for estimates in by_profile]
            )
        )

    def at_each(self, subsets: Sets) -> dict[str, Estimate]:
        """AP, recall and kbit of each set over the other cases, by name of the error profile."""
        by_profile = self._at_profiles(subsets, lambda fidelity, rows: fidelity(rows))
        return dict(zip(self.cases.names, by_profile, strict=True))

    def _reduce(
        self, subsets: Sets, score: Callable[[Fidelity, Bool[np.ndarray, "m C"]], Estimate]
    ) -> Estimate:
        # figures of each set over all cases. score: returns a scorer's figures of rows of booleans
        by_profile = self._at_profiles(subsets, score)
        return Estimate(*self._over_profiles(by_profile, [estimate.ap for estimate in by_profile]))

    def _over_profiles(
        self, by_profile: list[_Estimated], ap: list[np.ndarray]
    ) -> list[np.ndarray]:
        """Each figure (AP, recall, kbit) of n sets over the error profiles.

        Args:
            by_profile: Figures at each profile.
            ap: AP (n,) at each profile, which chooses the worst profile of each set."""
        shares = self.cases.shares(np.stack(ap))  # (profile, set)
        figures = [np.stack(figure) for figure in zip(*by_profile, strict=True)]
        # weights get an axis of length 1 for each further axis of a figure, such as classes
        return [
            (shares.reshape(*shares.shape, *[1] * (figure.ndim - 2)) * figure).sum(axis=0)
            for figure in figures
        ]

    def _at_profiles(
        self, subsets: Sets, score: Callable[[Fidelity, Bool[np.ndarray, "m C"]], _Estimated]
    ) -> list[_Estimated]:
        # figures of each set at each error profile, over thresholds, levels and failures. Rows are
        # the sets, then what remains after each failure
        rows, owners = self.cases.expand(subsets)
        by_profile = []
        for profile in self._profiles:
            scored = []
            for level in profile.levels:
                scored.append([score(fidelity, rows) for fidelity in level])
            ap = self._combine(scored, "ap", owners)
            recall = self._combine(scored, "recall", owners)
            is_plain = profile.whole is profile.levels[0][0]
            intact = scored[0][0] if is_plain else score(profile.whole, subsets)
            by_profile.append(type(intact)(ap, recall, intact.kbit[: len(subsets)]))
        return by_profile

    def _combine(
        self,
        scored: list[list[_Estimated]],
        figure: Literal["ap", "recall"],
        owners: Int64[np.ndarray, " m"],
    ) -> np.ndarray:
        """One figure of each set over levels, IoU thresholds and failures.

        Args:
            scored: Figures of m rows for each level (outer list) and threshold (inner list).
            figure: Name of the figure.
            owners: Index of the set that each row belongs to."""
        by_level = []
        for level in scored:
            by_level.append([getattr(estimate, figure) for estimate in level])
        return np.asarray(self.cases.at_profiles(np.array([by_level]), owners)[0])


class CasesByFrames(CasesFidelity):
    """`CasesFidelity` that can also score sets on only some of the frames."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return cast(ByFrames, self._first).frames

    def partial(self, subsets: Sets, frames: Sequence[int]) -> Estimate:
        """AP, recall and kbit of each set over all cases, in these frames (indices)."""
        return self._reduce(
            subsets, lambda fidelity, rows: cast(ByFrames, fidelity).partial(rows, frames)
        )


def over_cases(profiles: Sequence[ProfileFidelities], cases: Cases) -> Fidelity:
    """Scorer of sets over all cases, from the scorers at each error profile.

    If there is only one case, it is that scorer itself. It can score some frames if all can."""
    if cases.plain and len(profiles) == 1:
        return profiles[0].whole
    fidelities = [
        fidelity for profile in profiles for level in profile.levels for fidelity in level
    ]
    kind = (
        CasesByFrames
        if all(isinstance(fidelity, ByFrames) for fidelity in fidelities)
        else CasesFidelity
    )
    return kind(profiles, cases)
