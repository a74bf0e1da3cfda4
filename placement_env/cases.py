"""`Cases`: circumstances under which sets are scored, and how their figures become one.

Four kinds of case are combined: IoU thresholds, sensors that fail, levels of traffic and error
profiles of the sensors. A figure of m sets in all cases is an array [profile, level, iou, set];
the axes are reduced from the last:

    IoU thresholds   mean, as in COCO, so that no single threshold decides what is built
    levels           worst or mean over parts of the frames, by the number of road users in them;
                     NaN is left out
    failures         worst or mean over which sensors fail (N-1, N-2); a set that may lose all its
                     sensors keeps nothing
    error profiles   the profile with the lowest AP gives all figures of a set, or the mean

The methods here reduce the estimates of fast fidelities. `placement_env.analysis.case_figures`
reduces the figures of evaluated sets, with their resamples, by the same rules. Fields that do not
fit raise ValueError.
"""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, cast, get_args

import numpy as np

from placement_env.checks import check_choice, check_iou, whole
from placement_env.classes import Classes, Combine, join_names
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float64, Int64
from toolkit.frozen import set_fields
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PROFILES, find_profile, only_own_noise

if TYPE_CHECKING:
    Profiles = str | ErrorProfile | tuple[str | ErrorProfile, ...]
else:
    Profiles = tuple[str, ...]  # what the command line reads

IoUs = float | tuple[float, ...]  # one threshold, or several whose mean counts
MAX_FAILING = 2
MAX_LEVELS = 4
LEVEL_NAMES: dict[int, tuple[str, ...]] = {
    1: ("all traffic",),
    2: ("thin traffic", "dense traffic"),
    3: ("thin traffic", "middling traffic", "dense traffic"),
    4: ("thin traffic", "lighter traffic", "heavier traffic", "dense traffic"),
}
COCO_IOU_STEP = 0.05
# The intact set's AP counts with this share, so that a search that adds one sensor at a time can
# distinguish sets that fail completely.
TIE_SHARE = 1e-6
# words by the value of `levels_by` or `errors_by`
_COMBINED_TEXTS = {"worst": "at the worst of", "mean": "averaged over"}


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
        """Read thresholds and profiles, and raise ValueError if a field does not fit.

        The fields become one threshold or an ascending tuple, and a tuple of error profiles."""
        ious = _read_thresholds(self.iou)
        errors = self.errors if isinstance(self.errors, tuple | list) else (self.errors,)
        profiles = [find_profile(profile) for profile in errors]
        # shipped profiles by their name, others as they are
        errors_named = tuple(
            profile.name if PROFILES.get(profile.name) == profile else profile
            for profile in profiles
        )
        set_fields(self, iou=ious[0] if len(ious) == 1 else ious, errors=errors_named)
        if not whole(self.failing) or not 0 <= self.failing <= MAX_FAILING:
            raise ValueError(f"failing must be 0 to {MAX_FAILING} sensors, got {self.failing!r}")
        if not whole(self.levels) or not 1 <= self.levels <= MAX_LEVELS:
            raise ValueError(f"traffic has 1 to {MAX_LEVELS} levels, got {self.levels!r}")
        for name in ("failures", "levels_by", "errors_by"):
            check_choice(name, getattr(self, name), get_args(Combine))
        digests = {profile.digest for profile in self.profiles}
        # at least one profile, and no name or content twice
        if not len(self.profiles) == len(set(self.names)) == len(digests) > 0:
            names = ", ".join(self.names) or "none"
            raise ValueError(f"error profiles must be different ones, got {names}: name each once")

    @cached_property
    def ious(self) -> tuple[float, ...]:
        """All IoU thresholds, ascending; a single one as a tuple of one."""
        return self.threshold if isinstance(self.threshold, tuple) else (self.threshold,)

    @property
    def threshold(self) -> IoUs:
        """IoU threshold as a number, or all of several, ascending, as a tuple."""
        return cast(IoUs, self.iou)

    @cached_property
    def profiles(self) -> tuple[ErrorProfile, ...]:
        """Error profiles of the sensors, in the given order, with names looked up."""
        errors = cast("tuple[str | ErrorProfile, ...]", self.errors)
        return tuple(find_profile(profile) for profile in errors)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the error profiles, in the order of `profiles`."""
        return tuple(profile.name for profile in self.profiles)

    @cached_property
    def is_one_case(self) -> bool:
        """True if a set is scored in one case for each error profile.

        There is one IoU threshold, no sensor fails, and traffic is not divided into levels."""
        return len(self.ious) == 1 and not self.failing and self.levels == 1

    @cached_property
    def noise_only(self) -> bool:
        """True if all profiles leave sensors without errors except their models' noise."""
        return all(map(only_own_noise, self.profiles))

    @property
    def origin(self) -> dict[str, object]:
        """Thresholds, failures and levels as JSON values for files of results.

        "failing" and "levels" are left out if no sensor fails and traffic is not divided."""
        origin: dict[str, object] = {"iou": self.iou if len(self.ious) == 1 else list(self.ious)}
        if self.failing:
            origin["failing"] = {"sensors": self.failing, "combine": self.failures}
        if self.levels > 1:
            origin["levels"] = {"count": self.levels, "combine": self.levels_by}
        return origin

    @property
    def errors_origin(self) -> dict[str, object]:
        """Error profiles as JSON values for files of results.

        One profile gives its fields directly; several are listed with how they combine."""
        if len(self.profiles) == 1:
            return dict(self.profiles[0].origin)
        return {
            "profiles": [profile.origin for profile in self.profiles],
            "combine": self.errors_by,
        }

    @cached_property
    def errors_text(self) -> str:
        """Names of the error profiles as text: "paper, glare and poor"."""
        return join_names(self.names)

    def describe_failures(self) -> str:
        """Words for what failures leave of a set: "what is left in the worst case when …"."""
        failure = "1 sensor fails" if self.failing == 1 else f"{self.failing} sensors fail"
        case = "in the worst case" if self.failures == "worst" else "on average"
        return f"what is left {case} when {failure}"

    def describe_levels(self) -> str:
        """Words for how figures at all levels of traffic become one figure."""
        return f"{_COMBINED_TEXTS[self.levels_by]} {self.levels} levels of traffic"

    def describe_errors(self) -> str:
        """Words for how figures at all error profiles become one figure."""
        return f"{_COMBINED_TEXTS[self.errors_by]} the error profiles {self.errors_text}"

    def class_ious(self, classes: Classes, name: str) -> IoUs:
        """IoU threshold of one class, or several, ascending and different.

        They may differ from `ious`: small classes count from a lower IoU. name: class."""
        ious = tuple(sorted({classes.get_iou(name, iou) for iou in self.ious}))
        return ious[0] if len(ious) == 1 else ious

    def split(self, objects: Int64[np.ndarray, " frames"]) -> tuple[Int64[np.ndarray, " _"], ...]:
        """Indices of the frames of each level of traffic, ascending, thin traffic first.

        The levels have nearly equal numbers of frames; a level without a frame is left out.
        objects: number of road users in each frame.
        """
        order = np.argsort(objects, kind="stable")
        return tuple(np.sort(part) for part in np.array_split(order, self.levels) if len(part))

    def expand(
        self, sets: Sets
    ) -> tuple[Bool[np.ndarray, "m candidates"], Int64[np.ndarray, " m"]]:
        """Rows of n sets, followed by the sensors that each failure leaves.

        A set that may lose all its sensors has one case, the empty set.

        Returns:
            m rows of booleans, the intact sets first, and for each row the index (0 to n-1) of the
            set that it comes from. Without failures these are the sets themselves.
        """
        rows = list(sets)
        owners = list(range(len(sets)))
        for n, row in enumerate(sets) if self.failing else ():
            members = np.flatnonzero(row).tolist()
            failures: list[Sequence[int]] = [members]  # lists of sensors that fail together
            if len(members) > self.failing:
                failures = list(combinations(members, self.failing))
            for failed in failures:
                remaining = row.copy()
                remaining[list(failed)] = False
                rows.append(remaining)
                owners.append(n)
        # `reshape` for no rows at all
        expanded = np.array(rows, np.bool_).reshape(len(rows), sets.shape[1])
        return expanded, np.array(owners, np.int64)

    def over_levels(
        self, figures: Float64[np.ndarray, "levels *rest"]
    ) -> Float64[np.ndarray, "*rest"]:
        """Lowest or mean value of each figure over the levels of traffic.

        figures: levels of traffic on the first axis. A NaN level is left out; the result is NaN
        only if all levels are NaN."""
        reduce = np.nanmin if self.levels_by == "worst" else np.nanmean
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # if all levels are NaN
            return np.asarray(reduce(figures, axis=0))

    def over_failures(
        self,
        figures: Float64[np.ndarray, "m *rest"],
        owners: Int64[np.ndarray, " m"],
        *,
        tie: float = TIE_SHARE,
    ) -> Float64[np.ndarray, "n *rest"]:
        """Lowest or mean figures of n sets over their failures.

        Without failures the figures come back unchanged.

        Args:
            figures: Figures of the m rows that `expand` returns: intact sets, then failed ones.
            owners: Index of the set of each row.
            tie: Share of the intact set's figures to add, which separates sets that fail
                completely; 0 for the pure figures."""
        if not self.failing:
            return figures
        set_count = int(owners.max(initial=-1)) + 1
        intact = figures[:set_count]  # rows after the intact sets are failures
        failures = figures[set_count:]
        failure_owners = owners[set_count:]
        reduce = np.mean if self.failures == "mean" else np.min
        if not set_count:
            return intact
        reduced = np.stack(
            [reduce(failures[failure_owners == n], axis=0) for n in range(set_count)]
        )
        return np.asarray(reduced + tie * intact) if tie else reduced

    def at_profile(
        self, figures: Float64[np.ndarray, "levels ious m *rest"], owners: Int64[np.ndarray, " m"]
    ) -> Float64[np.ndarray, "n *rest"]:
        """Figures of n sets over thresholds, levels and failures, at one error profile.

        The share `TIE_SHARE` of the intact set's figures is added after failures.

        figures: axes are level of traffic, IoU threshold, row of `expand`, and any others; owners:
        index of the set of each row."""
        level_count, iou_count = figures.shape[:2]
        iou_mean = figures[:, 0]  # axes: level, row and others
        if iou_count > 1:
            iou_sum = sum(figures[:, i] for i in range(iou_count))
            iou_mean = np.asarray(iou_sum / iou_count)
        one_figure = iou_mean[0] if level_count == 1 else self.over_levels(iou_mean)
        return self.over_failures(one_figure, owners)

    def shares(self, ap: Float64[np.ndarray, "profiles n"]) -> Float64[np.ndarray, "profiles n"]:
        """Weight of each error profile in the figures of each of n sets.

        It is 1 for the profile with the lowest AP and 0 for others if the worst counts, and equal
        for all if the mean does. ap: AP of each set at each profile."""
        profile_count = len(ap)
        if self.errors_by == "mean":
            return np.full(ap.shape, 1 / profile_count)
        worst_profile = ap.argmin(axis=0)  # index, of each set
        return (np.arange(profile_count)[:, None] == worst_profile).astype(np.float64)


def _read_thresholds(iou: float | str | Iterable[float]) -> tuple[float, ...]:
    """IoU thresholds, ascending, from one, several, or text.

    Text is "0.7", or "0.5:0.95" for steps of `COCO_IOU_STEP`. Raises ValueError for thresholds
    outside (0, 1], equal ones, or none."""
    if isinstance(iou, str):
        try:
            ends = [float(threshold) for threshold in iou.split(":")]
        except ValueError:
            # refused below
            ends = []
        if len(ends) not in (1, 2) or not 0 < ends[0] <= ends[-1] <= 1:
            raise ValueError(f"iou must lie in (0, 1], as 0.7 or 0.5:0.95, got {iou}")
        if len(ends) == 1:
            return (ends[0],)
        low, high = ends
        # half a step more, so that the upper end is among them
        steps = np.arange(low, high + COCO_IOU_STEP / 2, COCO_IOU_STEP)
        return tuple(np.round(steps, 2).tolist())
    thresholds: tuple[float, ...] = tuple(sorted(iou)) if isinstance(iou, Iterable) else (iou,)
    for threshold in thresholds:
        check_iou(threshold)
    if not thresholds or len(set(thresholds)) < len(thresholds):
        raise ValueError(f"IoU thresholds must be one or several different ones, got {iou!r}")
    return tuple(float(threshold) for threshold in thresholds)


def iou_text(iou: IoUs) -> str:
    """Words for an IoU threshold: "0.7", or "0.5 to 0.95 (mean of 10 thresholds)"."""
    if isinstance(iou, float | int):
        return f"{iou:g}"
    return f"{iou[0]:g} to {iou[-1]:g} (mean of {len(iou)} thresholds)"
