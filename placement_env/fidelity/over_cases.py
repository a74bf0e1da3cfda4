"""`CasesFidelity`: combine fidelities of single cases into one. See `placement_env.cases`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np

from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.protocol import ByClass, ByFrames, ClassEstimates, Estimate, Fidelity
from toolkit.arrays import Bool

_Estimated = TypeVar("_Estimated", Estimate, ClassEstimates)


@dataclass(frozen=True)
class ProfileFidelities:
    """Fidelities at one error profile."""

    whole: Fidelity
    levels: tuple[tuple[Fidelity, ...], ...]


class CasesFidelity:
    """Score sets over all cases; kbit are those of the intact set, by the error profile of least AP, or means."""

    def __init__(self, profiles: Sequence[ProfileFidelities], cases: Cases) -> None:
        self._profiles, self.cases, self._first = tuple(profiles), cases, profiles[0].whole
        self.detector = getattr(self._first, "detector", None)

    @property
    def name(self) -> str:
        """Name of the fidelity."""
        return self._first.name

    @property
    def classes(self) -> Classes:
        """Classes that count."""
        return cast(ByClass, self._first).classes

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Figures of each set."""
        return self._reduce(subsets, lambda fidelity, rows: fidelity(rows))

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """Figures of each set for each class.

        The worst failure or level of one class need not be that of another; the worst error profile is that of all
        classes together.
        """
        found = self._at_profiles(subsets, lambda fidelity, rows: cast(ByClass, fidelity).by_class(rows))
        return ClassEstimates(*self._over_profiles(found, [each.combined(self.classes).ap for each in found]))

    def at_each(self, subsets: Bool[np.ndarray, "n C"]) -> dict[str, Estimate]:
        """Figures of each set at each error profile, by its name."""
        found = self._at_profiles(subsets, lambda fidelity, rows: fidelity(rows))
        return dict(zip(self.cases.names, found, strict=True))

    def _reduce(
        self, subsets: Bool[np.ndarray, "n C"], score: Callable[[Fidelity, Bool[np.ndarray, "m C"]], Estimate]
    ) -> Estimate:
        found = self._at_profiles(subsets, score)
        return Estimate(*self._over_profiles(found, [each.ap for each in found]))

    def _over_profiles(self, found: list[_Estimated], ap: list[np.ndarray]) -> list[np.ndarray]:
        """Figures over the error profiles, weighed by set."""
        shares = self.cases.shares(np.stack(ap))  # (profile, set)
        figures = [np.stack(each) for each in zip(*found, strict=True)]
        return [(shares.reshape(*shares.shape, *[1] * (each.ndim - 2)) * each).sum(axis=0) for each in figures]

    def _at_profiles(
        self, subsets: Bool[np.ndarray, "n C"], score: Callable[[Fidelity, Bool[np.ndarray, "m C"]], _Estimated]
    ) -> list[_Estimated]:
        rows, owners = self.cases.expand(subsets)
        found = []
        for profile in self._profiles:
            scored = [[score(fidelity, rows) for fidelity in level] for level in profile.levels]
            ap, recall = (
                self.cases.at_profiles(np.array([[[e[figure] for e in level] for level in scored]]), owners)[0]
                for figure in (0, 1)
            )
            intact = scored[0][0] if profile.whole is profile.levels[0][0] else score(profile.whole, subsets)
            found.append(type(intact)(ap, recall, intact.kbit[: len(subsets)]))
        return found


class CasesByFrames(CasesFidelity):
    """`CasesFidelity` that can score some frames alone."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return cast(ByFrames, self._first).frames

    def partial(self, subsets: Bool[np.ndarray, "n C"], frames: Sequence[int]) -> Estimate:
        """Figures of each set over these frames."""
        return self._reduce(subsets, lambda fidelity, rows: cast(ByFrames, fidelity).partial(rows, frames))


def over_cases(profiles: Sequence[ProfileFidelities], cases: Cases) -> Fidelity:
    """Fidelity over the cases."""
    if cases.plain and len(profiles) == 1:
        return profiles[0].whole
    every = [each for profile in profiles for level in profile.levels for each in level]
    made = CasesByFrames if all(isinstance(each, ByFrames) for each in every) else CasesFidelity
    return made(profiles, cases)
