"""AP over error profiles of the sensors: the profile at which a set's AP is least, or their mean.

A set that is best with exact sensors may be weak where poses are off or it rains. What detects is asked at each profile
by itself, IoU thresholds, levels of traffic and failures included, and the profiles are combined last: the AP that
counts is the least, or the mean, of those that are stated of the profiles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

import numpy as np

from placement_env.fidelity.combined.like import LikeFirst, LikeFirstByFrames
from placement_env.protocol import ByClass, ByFrames, ClassEstimates, Estimate, Fidelity
from toolkit.arrays import Bool, Float64
from toolkit.sensors.error_profiles import ErrorProfile, get_profile

ProfileCombine = Literal["mean", "worst"]


@dataclass(frozen=True)
class ErrorProfiles:
    """Several error profiles; combine: whether the one of least AP counts or their mean. Raises ValueError where they
    are not two or more different ones."""

    profiles: tuple[ErrorProfile, ...]
    combine: ProfileCombine = "worst"

    def __post_init__(self) -> None:
        if self.combine not in get_args(ProfileCombine):
            raise ValueError(f"error profiles are combined by mean or worst, got {self.combine!r}")
        names, terms = {each.name for each in self.profiles}, {each.digest for each in self.profiles}
        if not 1 < len(self.profiles) == len(names) == len(terms):
            given = ", ".join(each.name for each in self.profiles) or "none"
            raise ValueError(f"several error profiles must be different ones, got {given}: name each once")

    @property
    def name(self) -> str:
        """Those of the profiles.

        >>> errors_of(["paper", "typical", "poor"]).name
        'paper, typical and poor'
        """
        *others, last = self.names
        return f"{', '.join(others)} and {last}"

    @property
    def names(self) -> tuple[str, ...]:
        """Of each profile."""
        return tuple(each.name for each in self.profiles)

    @property
    def described(self) -> str:
        """Over what an AP is taken, in words.

        >>> errors_of(["paper", "poor"], "mean").described
        'in the mean over the error profiles paper and poor'
        """
        how = "at the worst of" if self.combine == "worst" else "in the mean over"
        return f"{how} the error profiles {self.name}"

    @property
    def origin(self) -> dict[str, Any]:
        """What results say of them."""
        return {"profiles": [each.origin for each in self.profiles], "combine": self.combine}

    def shares(self, ap: Float64[np.ndarray, "profiles n"]) -> Float64[np.ndarray, "profiles n"]:
        """By how much each profile counts for each set, of the set's AP at each: all of the first of least AP, or all
        alike.

        >>> errors_of(["paper", "poor"]).shares(np.array([[0.9, 0.5], [0.8, 0.5]])).tolist()
        [[0.0, 1.0], [1.0, 0.0]]
        """
        if self.combine == "mean":
            return np.full(ap.shape, 1 / len(ap))
        return (np.arange(len(ap))[:, None] == ap.argmin(axis=0)).astype(np.float64)

    def combined(self, figures: Float64[np.ndarray, "profiles *rest"]) -> Float64[np.ndarray, "*rest"]:
        """The least of each figure over the profiles, or its mean."""
        return np.asarray(figures.min(axis=0) if self.combine == "worst" else figures.mean(axis=0))


Errors = ErrorProfile | ErrorProfiles  # one profile, or several
AskedErrors = Errors | str | Sequence[ErrorProfile | str]  # the same, by names or as a list, of which the worst counts


def errors_of(errors: ErrorProfiles | ErrorProfile | Iterable[Any], combine: ProfileCombine = "worst") -> Errors:
    """One profile or several, from these themselves or from names; a list of one is that one. combine: of a list.
    Raises ValueError for a name that there is not, and as `ErrorProfiles` does.

    >>> errors_of("poor").name, errors_of(["poor"]).name
    ('poor', 'poor')
    """
    if isinstance(errors, ErrorProfiles):
        return errors
    if isinstance(errors, ErrorProfile | str):
        return get_profile(errors)
    profiles = tuple(get_profile(each) for each in errors)
    return profiles[0] if len(profiles) == 1 else ErrorProfiles(profiles, combine)


def several(errors: Errors) -> ErrorProfiles | None:
    """Several profiles, None where it is one."""
    return errors if isinstance(errors, ErrorProfiles) else None


def profiles_in(errors: Errors) -> tuple[ErrorProfile, ...]:
    """Each of them."""
    return errors.profiles if isinstance(errors, ErrorProfiles) else (errors,)


class ProfileFidelity(LikeFirst):
    """Sets scored at several error profiles: all figures of a set are those of the profile at which its AP is least, or
    their means. fidelities: one for each profile."""

    def __init__(self, fidelities: Sequence[Fidelity], errors: ErrorProfiles) -> None:
        super().__init__(fidelities[0])
        self._fidelities, self.errors = tuple(fidelities), errors

    @property
    def detector(self) -> Any:
        """That scores, None where it is not known."""
        return getattr(self._first, "detector", None)

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Figures of each set over the profiles."""
        return self._over([each(subsets) for each in self._fidelities])

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """The same of each class. The worst profile is that of all classes together, for each set."""
        found = [cast(ByClass, each).by_class(subsets) for each in self._fidelities]
        shares = self.errors.shares(np.stack([each.combined(self.classes).ap for each in found]))
        ap, recall = (
            (shares[:, :, None] * np.stack([getattr(each, name) for each in found])).sum(axis=0)
            for name in ("ap", "recall")
        )
        return ClassEstimates(ap, recall, (shares * np.stack([each.kbit for each in found])).sum(axis=0))

    def at_each(self, subsets: Bool[np.ndarray, "n C"]) -> dict[str, Estimate]:
        """Figures of each set at each profile, by its name."""
        return {name: each(subsets) for name, each in zip(self.errors.names, self._fidelities, strict=True)}

    def _over(self, found: Sequence[Estimate]) -> Estimate:
        ap, recall, kbit = (np.stack(each) for each in zip(*found, strict=True))
        shares = self.errors.shares(ap)
        return Estimate(*((shares * each).sum(axis=0) for each in (ap, recall, kbit)))


class ProfileByFrames(ProfileFidelity, LikeFirstByFrames):
    """The same of fidelities that score some frames alone."""

    def partial(self, subsets: Bool[np.ndarray, "n C"], frames: Sequence[int]) -> Estimate:
        """Figures of each set over these frames."""
        return self._over([cast(ByFrames, each).partial(subsets, frames) for each in self._fidelities])


def over_profiles(fidelities: Sequence[Fidelity], errors: ErrorProfiles) -> ProfileFidelity:
    """Of fidelities at one profile each, what counts over all of them."""
    made = ProfileByFrames if all(isinstance(each, ByFrames) for each in fidelities) else ProfileFidelity
    return made(fidelities, errors)
