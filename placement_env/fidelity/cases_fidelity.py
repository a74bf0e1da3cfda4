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
    """Scorers of sets with sensor errors of one profile.

    Attributes:
        whole: Scorer in all frames, at the first IoU threshold.
        levels: For each level of traffic, a scorer at each IoU threshold."""

    whole: Fidelity
    levels: tuple[tuple[Fidelity, ...], ...]


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
        return self._score_over_cases(subsets, lambda fidelity, rows: fidelity(rows))

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """AP and recall of each set for each class over all cases, and kbit of the set.

        Failures of sensors and levels of traffic are the worst for each class alone. The error
        profile is the worst for the AP of all classes together, if the cases ask for the worst."""
        # rows: sets that a fidelity of one case scores
        by_profile = self._score_at_profiles(
            subsets, lambda fidelity, rows: cast(ByClass, fidelity).by_class(rows)
        )
        # AP of all classes together, by which the worst profile gets all weight
        combined_ap = [estimates.combined(self.classes).ap for estimates in by_profile]
        return ClassEstimates(*self._average_over_profiles(by_profile, combined_ap))

    def at_each(self, subsets: Sets) -> dict[str, Estimate]:
        """AP, recall and kbit of each set over the other cases, by name of the error profile."""
        by_profile = self._score_at_profiles(subsets, lambda fidelity, rows: fidelity(rows))
        return dict(zip(self.cases.names, by_profile, strict=True))

    def _score_over_cases(
        self, subsets: Sets, score: Callable[[Fidelity, Bool[np.ndarray, "m candidates"]], Estimate]
    ) -> Estimate:
        """AP, recall and kbit of each set over all cases.

        score: Function of a scorer of one case and sets (rows of booleans) that returns their
            figures."""
        by_profile = self._score_at_profiles(subsets, score)
        ap = [estimate.ap for estimate in by_profile]
        # the means come in the order of the fields: AP, recall, kbit
        return Estimate(*self._average_over_profiles(by_profile, ap))

    def _average_over_profiles(
        self, by_profile: list[_Estimated], ap: list[np.ndarray]
    ) -> list[np.ndarray]:
        """AP, recall and kbit of n sets, each a weighted mean over the error profiles.

        The worst profile has all the weight, or all have the same, as the cases combine them.

        Args:
            by_profile: Figures of the sets at each profile.
            ap: AP (n,) of the sets at each profile, by which the worst profile of a set is
                chosen."""
        shares = self.cases.shares(np.stack(ap))  # weights, axes: profile, set
        means = []
        for figures in zip(*by_profile, strict=True):  # AP, then recall, then kbit
            stacked = np.stack(figures)  # axes: profile, set, and classes if there are any
            # weights get an axis of length 1 for each further axis of a figure
            weights = shares.reshape(*shares.shape, *[1] * (stacked.ndim - 2))
            means.append((weights * stacked).sum(axis=0))
        return means

    def _score_at_profiles(
        self,
        subsets: Sets,
        score: Callable[[Fidelity, Bool[np.ndarray, "m candidates"]], _Estimated],
    ) -> list[_Estimated]:
        """Figures of each set at each error profile, over thresholds, levels and failures.

        Levels are parts of the traffic from thin to dense; failures leave out sensors of a set.

        score: Function of a scorer of one case and sets (rows of booleans) that returns their
            figures."""
        # rows: the sets, then the sets that each failure leaves; owners: index of each row's set
        rows, owners = self.cases.expand(subsets)
        by_profile = []
        for profile in self._profiles:
            by_level = []
            for level in profile.levels:
                by_level.append([score(fidelity, rows) for fidelity in level])
            ap = self._combine(by_level, "ap", owners)
            recall = self._combine(by_level, "recall", owners)
            # kbit are for intact sets in all traffic; without levels these are scored already
            first_scorer = profile.levels[0][0]  # at the first level and the first IoU threshold
            is_scored = profile.whole is first_scorer
            intact = by_level[0][0] if is_scored else score(profile.whole, subsets)
            kbit = intact.kbit[: len(subsets)]  # the first rows are the intact sets
            by_profile.append(type(intact)(ap=ap, recall=recall, kbit=kbit))
        return by_profile

    def _combine(
        self,
        by_level: list[list[_Estimated]],
        figure: Literal["ap", "recall"],
        owners: Int64[np.ndarray, " m"],
    ) -> np.ndarray:
        """One figure of each set, combined over levels of traffic, IoU thresholds and failures.

        Args:
            by_level: Figures of m rows for each level (outer list) and threshold (inner list).
            figure: Name of the figure to combine.
            owners: Index of the set that each row belongs to."""
        values = []
        for level in by_level:
            values.append([getattr(estimate, figure) for estimate in level])
        return self.cases.at_profile(np.array(values), owners)


class CasesByFrames(CasesFidelity):
    """`CasesFidelity` that can also score sets on only some of the frames."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return cast(ByFrames, self._first).frames

    def partial(self, subsets: Sets, frames: Sequence[int]) -> Estimate:
        """AP, recall and kbit of each set over all cases, in these frames (indices)."""
        return self._score_over_cases(
            subsets, lambda fidelity, rows: cast(ByFrames, fidelity).partial(rows, frames)
        )


def over_cases(profiles: Sequence[ProfileFidelities], cases: Cases) -> Fidelity:
    """Scorer of sets over all cases, from the scorers at each error profile.

    A case is an error profile, an IoU threshold, a level of traffic and a failure of sensors. With
    a single case, that case's scorer is returned itself. The result can score sets on only
    some frames (`ByFrames`) if all given scorers can."""
    if cases.is_one_case and len(profiles) == 1:
        return profiles[0].whole
    fidelities = [
        fidelity for profile in profiles for level in profile.levels for fidelity in level
    ]
    if all(isinstance(fidelity, ByFrames) for fidelity in fidelities):
        return CasesByFrames(profiles, cases)
    return CasesFidelity(profiles, cases)
