"""`Cases`: circumstances under which sets are scored, and how their figures become one.

Four kinds of case cross: IoU thresholds, sensors that fail, levels of traffic and error profiles of
the sensors. A figure of m sets in all of them is an array [profile, level, iou, set]; the axes are
reduced from the last:

    IoU thresholds   mean, as in COCO, so that no threshold alone decides what is built
    levels           worst or mean over parts of the frames, by how many road users are there at
                     once; NaN is left out
    failures         worst or mean over which sensors fail (N-1, N-2); a set that may lose all its
                     sensors keeps nothing
    error profiles   the profile of least AP gives all figures of a set, or the mean over profiles

Resamples of a paired bootstrap are reduced in the same way, each by itself, as a trailing axis.
Fields that do not fit raise ValueError."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, cast, get_args

import numpy as np

from placement_env.checks import check_choice, check_iou, whole
from placement_env.classes import Classes, Combine, join_names
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float64, Int64
from toolkit.sensors.error_profiles import PROFILES, ErrorProfile, find_profile, only_own_noise

if TYPE_CHECKING:
    Profiles = str | ErrorProfile | tuple[str | ErrorProfile, ...]
else:
    Profiles = tuple[str, ...]  # what the command line reads

IoUs = float | tuple[float, ...]  # one threshold, or several whose mean counts
MOST_FAILING = 2
MOST_LEVELS = 4
LEVEL_NAMES: dict[int, tuple[str, ...]] = {
    1: ("all traffic",),
    2: ("thin traffic", "dense traffic"),
    3: ("thin traffic", "middling traffic", "dense traffic"),
    4: ("thin traffic", "lighter traffic", "heavier traffic", "dense traffic"),
}
COCO_STEP = 0.05  # of IoU, between the ends of a range
# share of the intact set's AP, so that a search that adds one sensor after another does not begin
# blindly
TIE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Cases:
    """Conditions under which a set of sensors is scored."""

    iou: float | str | tuple[float, ...] = 0.7
    """IoU at which a detection counts; 0.5:0.95 averages AP over 0.5, 0.55 to 0.95, as in COCO."""
    failing: int = 0
    """Number of sensors that fail (0 to 2); the remaining sensors are scored."""
    failures: Combine = "worst"
    """Score the worst choice of failing sensors, or the mean over all choices."""
    levels: int = 1
    """Number of traffic levels (1 to 4), from thin to dense, that are scored separately."""
    levels_by: Combine = "worst"
    """Score the worst traffic level, or the mean over levels."""
    errors: Profiles = ("paper",)
    """Error profiles of the sensors: paper, surveyed, typical, glare, poor; for scoring by the
    detector."""
    errors_by: Combine = "worst"
    """Score the worst error profile, or the mean over profiles."""

    def __post_init__(self) -> None:
        ious = _thresholds(self.iou)
        object.__setattr__(self, "iou", ious[0] if len(ious) == 1 else ious)
        errors = self.errors if isinstance(self.errors, tuple | list) else (self.errors,)
        given = [find_profile(each) for each in errors]  # named where they have a name of their own
        short = tuple(each.name if PROFILES.get(each.name) == each else each for each in given)
        object.__setattr__(self, "errors", short)
        if not whole(self.failing) or not 0 <= self.failing <= MOST_FAILING:
            raise ValueError(f"failing must be 0 to {MOST_FAILING} sensors, got {self.failing!r}")
        if not whole(self.levels) or not 1 <= self.levels <= MOST_LEVELS:
            raise ValueError(f"traffic has 1 to {MOST_LEVELS} levels, got {self.levels!r}")
        for name in ("failures", "levels_by", "errors_by"):
            check_choice(name, getattr(self, name), get_args(Combine))
        if (
            not len(self.profiles)
            == len(set(self.names))
            == len({each.digest for each in self.profiles})
            > 0
        ):
            names = ", ".join(self.names) or "none"
            raise ValueError(f"error profiles must be different ones, got {names}: name each once")

    @property
    def ious(self) -> tuple[float, ...]:
        """IoU thresholds, ascending."""
        return self.threshold if isinstance(self.threshold, tuple) else (self.threshold,)

    @property
    def threshold(self) -> IoUs:
        """The IoU threshold, or all of several."""
        return cast(IoUs, self.iou)

    @cached_property
    def profiles(self) -> tuple[ErrorProfile, ...]:
        """Error profiles."""
        return tuple(
            find_profile(each) for each in cast("tuple[str | ErrorProfile, ...]", self.errors)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the error profiles."""
        return tuple(each.name for each in self.profiles)

    @property
    def plain(self) -> bool:
        """True for one threshold, no failures and undivided traffic, whatever the errors."""
        return len(self.ious) == 1 and not self.failing and self.levels == 1

    @property
    def noise_only(self) -> bool:
        """True where sensors have no errors but their models' own noise."""
        return all(map(only_own_noise, self.profiles))

    @property
    def origin(self) -> dict[str, object]:
        """Thresholds, failures and levels as results state them."""
        failing = (
            {"failing": {"sensors": self.failing, "combine": self.failures}} if self.failing else {}
        )
        levels = (
            {"levels": {"count": self.levels, "combine": self.levels_by}} if self.levels > 1 else {}
        )
        return {"iou": self.iou if len(self.ious) == 1 else list(self.ious), **failing, **levels}

    @property
    def errors_origin(self) -> dict[str, object]:
        """Error profiles as results state them."""
        if len(self.profiles) == 1:
            return dict(self.profiles[0].origin)
        return {"profiles": [each.origin for each in self.profiles], "combine": self.errors_by}

    @cached_property
    def errors_text(self) -> str:
        """Names of the error profiles in words."""
        return join_names(self.names)

    def describe_failures(self) -> str:
        """Words for what is left of a set."""
        what = "1 sensor fails" if self.failing == 1 else f"{self.failing} sensors fail"
        return (
            f"what is left {'in the worst case' if self.failures == 'worst' else 'on average'} "
            f"when {what}"
        )

    def describe_levels(self) -> str:
        """Words for how levels of traffic become one."""
        return f"{_HOW[self.levels_by]} {self.levels} levels of traffic"

    def describe_errors(self) -> str:
        """Words for how error profiles become one."""
        return f"{_HOW[self.errors_by]} the error profiles {self.errors_text}"

    def class_ious(self, classes: Classes, name: str) -> IoUs:
        """IoU threshold or thresholds of one class: its own where it has one."""
        own = tuple(sorted({classes.get_iou(name, iou) for iou in self.ious}))
        return own[0] if len(own) == 1 else own

    def split(self, objects: Int64[np.ndarray, " frames"]) -> tuple[Int64[np.ndarray, " _"], ...]:
        """Frames of each level, thin traffic first, in parts as equal as can be. objects: number in
        each frame."""
        order = np.argsort(objects, kind="stable")
        return tuple(np.sort(part) for part in np.array_split(order, self.levels) if len(part))

    def expand(self, sets: Sets) -> tuple[Bool[np.ndarray, "m C"], Int64[np.ndarray, " m"]]:
        """Sets followed by what each failure leaves of them, and the set that each row belongs to.
        A set that may lose all its sensors has one case, the empty set."""
        rows = [*sets]
        owners = list(range(len(sets)))
        for n, row in enumerate(sets) if self.failing else ():
            members = np.flatnonzero(row)
            for lost in (
                combinations(members.tolist(), self.failing)
                if len(members) > self.failing
                else [members]
            ):
                rows.append(row.copy())
                rows[-1][list(lost)] = False
                owners.append(n)
        return np.array(rows, np.bool_).reshape(len(rows), sets.shape[1]), np.array(
            owners, np.int64
        )

    def over_levels(
        self, figures: Float64[np.ndarray, "levels *rest"]
    ) -> Float64[np.ndarray, "*rest"]:
        """Figures of the levels as one; NaN where all are."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of levels that are all NaN
            return np.asarray(
                np.nanmin(figures, axis=0)
                if self.levels_by == "worst"
                else np.nanmean(figures, axis=0)
            )

    def over_failures(
        self,
        figures: Float64[np.ndarray, "m *rest"],
        owners: Int64[np.ndarray, " m"],
        *,
        tie: float = TIE,
    ) -> Float64[np.ndarray, "n *rest"]:
        """Figures of n sets, of rows and owners as `expand` gives them. tie: share of the intact
        set's to add."""
        if not self.failing:
            return figures
        count = int(owners.max(initial=-1)) + 1
        cases = figures[count:]
        of = owners[count:]
        reduce = np.mean if self.failures == "mean" else np.min
        left = (
            np.stack([reduce(cases[of == n], axis=0) for n in range(count)])
            if count
            else figures[:0]
        )
        return np.asarray(left + tie * figures[:count]) if tie else left

    def at_profiles(
        self,
        figures: Float64[np.ndarray, "P L I m *rest"],
        owners: Int64[np.ndarray, " m"],
        *,
        tie: float = TIE,
    ) -> Float64[np.ndarray, "P n *rest"]:
        """Figures of n sets at each error profile, over thresholds, levels and failures."""
        ious = figures.shape[2]
        mean = figures[:, :, 0] if ious == 1 else sum(figures[:, :, i] for i in range(ious)) / ious
        levels = (at[0] if len(at) == 1 else self.over_levels(at) for at in mean)
        return np.stack([self.over_failures(each, owners, tie=tie) for each in levels])

    def over_errors(self, figures: Float64[np.ndarray, "P *rest"]) -> Float64[np.ndarray, "*rest"]:
        """Least or mean of each figure over the error profiles."""
        return np.asarray(
            figures.min(axis=0) if self.errors_by == "worst" else figures.mean(axis=0)
        )

    def shares(self, ap: Float64[np.ndarray, "P n"]) -> Float64[np.ndarray, "P n"]:
        """Share with which each error profile counts for each set: all for that of least AP, or all
        alike."""
        if self.errors_by == "mean":
            return np.full(ap.shape, 1 / len(ap))
        return (np.arange(len(ap))[:, None] == ap.argmin(axis=0)).astype(np.float64)


_HOW = {"worst": "at the worst of", "mean": "averaged over"}


def _thresholds(iou: float | str | Iterable[float]) -> tuple[float, ...]:
    if isinstance(iou, str):
        try:
            ends = [float(each) for each in iou.split(":")]
        except ValueError:
            ends = []
        if len(ends) not in (1, 2) or not 0 < ends[0] <= ends[-1] <= 1:
            raise ValueError(f"iou must lie in (0, 1], as 0.7 or 0.5:0.95, got {iou}")
        if len(ends) == 1:
            return (ends[0],)
        return tuple(np.round(np.arange(ends[0], ends[1] + COCO_STEP / 2, COCO_STEP), 2).tolist())
    found: tuple[float, ...] = tuple(sorted(iou)) if isinstance(iou, Iterable) else (iou,)
    for each in found:
        check_iou(each)
    if not found or len(set(found)) < len(found):
        raise ValueError(f"IoU thresholds must be one or several different ones, got {iou!r}")
    return tuple(float(each) for each in found)


def iou_text(iou: IoUs) -> str:
    """Words for a threshold, or several."""
    if isinstance(iou, float | int):
        return f"{iou:g}"
    return f"{iou[0]:g} to {iou[-1]:g} (mean of {len(iou)} thresholds)"


USUAL_CASES = Cases()
