"""`LiveAnswer`: figures of a variant on the planner's frames, by the surrogate, with intervals.

The intervals (`placement_env.analysis.intervals`) use the same draws for every variant, so that the
change that a move makes has an interval too. The interval of an AP includes the error of the
surrogate. Intervals need `MIN_LIVE_BLOCKS` blocks of frames, fewer than an evaluated set needs; see
`docs/how-to/live.md` for how often they hold."""

import math
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np

from placement_env.analysis.approaches import find_approaches
from placement_env.analysis.intervals import (
    BLOCK_FRAMES,
    Interval,
    block_draws,
    count_blocks,
    figure_interval,
    percentiles,
    resample_ratio,
)
from placement_env.candidates.candidates import Candidates
from placement_env.cases import LEVEL_NAMES
from placement_env.fidelity.coverage import sent_per_frame
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.surrogate import Surrogate, resample_ap
from placement_env.fidelity.visibility import Visibility
from placement_env.handover.mounted import PoleLoad, measure_links
from placement_env.links import max_load
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float64, Int64

LEVELS = 3  # levels of traffic, from thin to dense
MIN_LIVE_BLOCKS = 5  # least number of blocks of frames for an interval
NORMAL_95_SIGMA = 1.96  # standard errors to the ends of a 95 % interval


@dataclass(frozen=True)
class FoundShare:
    """Share of the objects of a group that is found.

    Attributes:
        name: Name of the class, approach or level of traffic.
        ap: AP of a class, None for an approach or level.
        recall: Share of the objects that is found (0 to 1), NaN without objects.
        low: Lower end of the 95 % interval of the AP, or of the recall without an AP; NaN if there
            are too few frames.
        high: Upper end of that interval.
        objects: Number of objects in all frames.
    """

    name: str
    ap: float | None
    recall: float
    low: float
    high: float
    objects: int


@dataclass(frozen=True)
class LiveAnswer:
    """Figures of a variant.

    Attributes:
        what: Change that led to the variant, "" without one.
        sensors: Number of sensors.
        ap: AP that the surrogate predicts for the working sensors (0 to 1).
        low: Lower end of its 95 % interval, over frames and the error of the prediction; NaN, as
            all ends of intervals, if there are too few frames.
        high: Upper end of that interval.
        recall: Predicted recall.
        kbit: Data that all working sensors send per frame, on average.
        price: Price of all sensors and their poles, in `currency`.
        worst: AP that remains after the worst single failure.
        worst_low: Lower end of its interval.
        worst_high: Upper end of its interval.
        worst_sensor: Name of the sensor whose failure is the worst, "" without working sensors.
        spread: Standard error of the predicted AP, NaN if unknown.
        change: Change of the AP since the answer before, on the same frames.
        change_low: Lower end of the interval of the change.
        change_high: Upper end of the interval of the change.
        classes: Share found of each class.
        approaches: Share found on each approach.
        levels: Share found at each level of traffic.
        links: Load of the link of each pole.
        objects: Number of road users that count, in all frames.
        frames: Number of frames.
        unseen: Number of these road users without a point of any working sensor.
        currency: Currency of the price, "" for prices in ordinary poles.
        budget: Largest price, inf for any.
        problems: Sentences on what keeps the variant from being built.
        coarse: True if a view was interpolated between heights, or only the first frames count.
        resamples: AP in each resample of blocks of frames, the same draws for every variant.
        probability: Probability that each road user is found.
        hidden: Mask of the road users without a point of any working sensor.
    """

    what: str
    sensors: int
    ap: float
    low: float
    high: float
    recall: float
    kbit: float
    price: float
    worst: float
    worst_low: float
    worst_high: float
    worst_sensor: str
    spread: float
    change: float
    change_low: float
    change_high: float
    classes: tuple[FoundShare, ...]
    approaches: tuple[FoundShare, ...]
    levels: tuple[FoundShare, ...]
    links: tuple[PoleLoad, ...]
    objects: int
    frames: int
    unseen: int
    currency: str = ""
    budget: float = math.inf
    problems: tuple[str, ...] = ()
    coarse: bool = False
    resamples: Float64[np.ndarray, " resamples"] = field(
        default_factory=lambda: np.zeros(0), repr=False, compare=False
    )
    probability: Float64[np.ndarray, " objects"] = field(
        default_factory=lambda: np.zeros(0), repr=False, compare=False
    )
    hidden: Bool[np.ndarray, " objects"] = field(
        default_factory=lambda: np.zeros(0, np.bool_), repr=False, compare=False
    )

    def as_dict(self) -> dict[str, object]:
        """Return the figures as JSON values, without arrays, and without an infinite budget."""
        values = asdict(self)
        for array_name in ("resamples", "probability", "hidden"):
            del values[array_name]
        if math.isinf(self.budget):
            del values["budget"]
        return values

    def since(self, before: "LiveAnswer | None", what: str) -> "LiveAnswer":
        """Return the answer with the change of AP since an earlier one, on the same frames.

        before: earlier answer, None for no change (0); what: words for what made the change. The
        interval of the change always includes the change; its ends are NaN for too few frames."""
        if before is None:
            return replace(self, what=what, change=0.0, change_low=0.0, change_high=0.0)
        change = self.ap - before.ap
        # both answers use the same resamples, so they are subtracted pair by pair
        interval = percentiles(
            self.resamples - before.resamples, count_blocks(self.frames), fewest=MIN_LIVE_BLOCKS
        )
        return replace(
            self,
            what=what,
            change=change,
            change_low=min(interval.low, change),  # NaN first: min and max then keep it
            change_high=max(interval.high, change),
        )


def widen_interval(figure: float, interval: Interval, spread: float) -> Interval:
    """Interval of a predicted share, widened by the error of the prediction, within 0 to 1.

    Each end moves away from the figure: its distance becomes the root of the sum of squares of
    that distance and of the error.

    Args:
        figure: Predicted share (0 to 1).
        interval: Its 95 % interval over frames, returned unchanged if it is NaN.
        spread: Standard error of the prediction, NaN to leave it out.
    """
    if math.isnan(interval.low):
        return interval
    margin = NORMAL_95_SIGMA * (0.0 if math.isnan(spread) else spread)
    lower_width = math.hypot(figure - interval.low, margin)
    upper_width = math.hypot(figure - interval.high, margin)
    return Interval(max(0.0, figure - lower_width), min(1.0, figure + upper_width))


class Meter:
    """Figures of variants in the traffic of a preparation.

    Attributes:
        preparation: Traffic, and the setting that sets are scored by.
        blocks: Number of blocks of frames that intervals draw from.
    """

    def __init__(self, preparation: Preparation, currency: str) -> None:
        """Measure in a preparation's traffic. currency: "" for prices of one ordinary pole."""
        self.preparation = preparation
        self._currency = currency
        self.blocks = count_blocks(preparation.frames)
        # times that each resample draws each block, equal for all variants
        self._draws = block_draws(self.blocks, block=1).astype(np.float32)

    def objective(self, candidates: Candidates, visibility: Visibility) -> Objective:
        """Objective of sensors whose view of the preparation's traffic is known."""
        preparation = self.preparation
        return Objective.from_view(preparation, candidates, visibility, preparation.setting.weights)

    def measure_ap(
        self, candidates: Candidates, seen: Visibility, is_working: Bool[np.ndarray, " candidates"]
    ) -> tuple[float, int]:
        """AP of the working sensors, and number of problems of all sensors.

        It takes a tenth of the time of `measure`. seen: view of the candidates; is_working: False
        for failed sensors."""
        objective = self.objective(candidates, seen)
        one_set = is_working[None]
        ap = float(objective.scores(one_set).ap[0])
        return ap, len(list_problems(objective))

    def measure(
        self, candidates: Candidates, seen: Visibility, is_working: Bool[np.ndarray, " candidates"]
    ) -> LiveAnswer:
        """Figures of the working sensors, without a change since others.

        candidates: all sensors of a variant; seen: their view; is_working: False for failed
        sensors, which count in number, price and problems only."""
        objective = self.objective(candidates, seen)
        members = np.flatnonzero(is_working)
        remaining = _without_each(is_working, members)  # row k: sensor `members[k]` fails
        scores = objective.scores(np.concatenate([is_working[None], remaining]))
        ap, *failure_aps = scores.ap.tolist()
        surrogate = cast(Surrogate, objective.scored_by)
        worst_ap = 0.0
        worst_sensor = ""
        without_worst = is_working
        spread = 0.0
        worst_spread = 0.0
        if len(members):
            worst_index = int(np.argmin(failure_aps))
            worst_ap = failure_aps[worst_index]
            worst_sensor = objective.names[members[worst_index]]
            without_worst = remaining[worst_index]
            spread, worst_spread = surrogate.spread(np.stack([is_working, without_worst])).tolist()
        classes, resamples, probability = self._by_class(surrogate, is_working, seen, spread)
        object_count = len(probability)
        sample = {"blocks": self.blocks, "objects": object_count, "fewest": MIN_LIVE_BLOCKS}
        bounds = widen_interval(ap, figure_interval(ap, resamples, **sample), spread)
        worst_resamples, _ = self._resample(surrogate, without_worst)
        worst_interval = figure_interval(worst_ap, worst_resamples, **sample)
        worst_bounds = widen_interval(worst_ap, worst_interval, worst_spread)
        hidden = seen.points[is_working].sum(axis=0) == 0
        return LiveAnswer(
            what="",
            sensors=len(is_working),
            ap=ap,
            low=bounds.low,
            high=bounds.high,
            recall=float(scores.recall[0]),
            kbit=float(scores.kbit[0]),
            price=float(objective.price(np.ones_like(is_working)[None])[0]),
            worst=worst_ap,
            worst_low=worst_bounds.low,
            worst_high=worst_bounds.high,
            worst_sensor=worst_sensor,
            spread=spread,
            change=0.0,
            change_low=0.0,
            change_high=0.0,
            classes=classes,
            approaches=self._by_group(self._approaches, probability),
            levels=self._by_group(self._levels, probability),
            links=self._measure_loads(candidates, seen, is_working),
            objects=object_count,
            frames=seen.frames,
            unseen=int(hidden.sum()),
            currency=self._currency,
            budget=self.preparation.setting.most_price,
            problems=list_problems(objective),
            resamples=resamples,
            probability=probability,
            hidden=hidden,
        )

    @cached_property
    def _block_of_object(self) -> Int64[np.ndarray, " objects"]:
        """Number of the block of frames of each road user."""
        return self.unseen.frame // BLOCK_FRAMES

    @property
    def unseen(self) -> Visibility:
        """View without a sensor: the road users that count, in all frames."""
        return self.preparation.unseen

    def _by_class(
        self,
        surrogate: Surrogate,
        is_working: Bool[np.ndarray, " candidates"],
        seen: Visibility,
        spread: float,
    ) -> tuple[
        tuple[FoundShare, ...], Float64[np.ndarray, " resamples"], Float64[np.ndarray, " objects"]
    ]:
        """Figures of each class, resampled AP of all, and probability that each object is found.

        is_working: mask of the sensors that have not failed; spread: standard error of the
        predicted AP, which the intervals of classes include."""
        resamples, class_resamples = self._resample(surrogate, is_working)
        probability = np.zeros(len(seen.boxes))
        rows = []
        one_set = is_working[None]
        aps = surrogate.by_class(one_set).ap[0].tolist()
        hits_by_class = surrogate.hits(is_working)  # probability that each object is found
        for k, (name, hits) in enumerate(zip(surrogate.classes.names, hits_by_class, strict=True)):
            probability[seen.labels == surrogate.classes.labels[k]] = hits
            interval = Interval(np.nan, np.nan)
            recall = np.nan
            if len(hits):
                recall = float(hits.mean())
                frames_interval = figure_interval(
                    aps[k],
                    class_resamples[k],
                    blocks=self.blocks,
                    objects=len(hits),
                    fewest=MIN_LIVE_BLOCKS,
                )
                interval = widen_interval(aps[k], frames_interval, spread)
            rows.append(
                FoundShare(
                    name=name,
                    ap=aps[k],
                    recall=recall,
                    low=interval.low,
                    high=interval.high,
                    objects=len(hits),
                )
            )
        return tuple(rows), resamples, probability

    def _resample(
        self, surrogate: Surrogate, is_working: Bool[np.ndarray, " candidates"]
    ) -> tuple[Float64[np.ndarray, " resamples"], list[Float64[np.ndarray, " resamples"]]]:
        """AP of all classes combined, and list with the AP of each class, in each resample.

        is_working: sensors that count. Resamples draw blocks of frames by `_draws`."""
        labels = surrogate.classes.labels
        hits_by_class = surrogate.hits(is_working)  # probability that each object is found
        class_resamples = []
        for label, model, hits in zip(labels, surrogate.models, hits_by_class, strict=True):
            block_of_object = self._block_of_object[self.unseen.labels == label]
            class_resamples.append(
                resample_ap(hits, model.false_alarms, self._draws, block=block_of_object)
            )
        return surrogate.classes.combined(np.stack(class_resamples, axis=1)), class_resamples

    def _by_group(
        self, groups: "_ObjectGroups", probability: Float64[np.ndarray, " objects"]
    ) -> tuple[FoundShare, ...]:
        """Share found of each group of objects, with its interval; groups without any are left out.

        groups: names, and the group of each object; probability: that each object is found."""
        shape = (len(groups.names), self.blocks)  # axes: group, block of frames
        # index in the flattened array of each object's group and block
        cell = groups.group_indices * self.blocks + self._block_of_object
        counts = np.bincount(cell, minlength=math.prod(shape)).reshape(shape)
        found_sums = np.bincount(cell, probability, math.prod(shape)).reshape(shape)
        rows = []
        # groups with objects
        for k in np.flatnonzero(counts.any(axis=1)).tolist():
            object_count = int(counts[k].sum())
            # share found in each resample of the blocks of frames
            shares = resample_ratio(self._draws, found_sums[k], counts[k])
            recall = float(found_sums[k].sum() / object_count)
            # `fewest`: number of blocks below which there is no interval
            interval = figure_interval(
                recall, shares, blocks=self.blocks, objects=object_count, fewest=MIN_LIVE_BLOCKS
            )
            rows.append(
                FoundShare(
                    name=groups.names[k],
                    ap=None,
                    recall=recall,
                    low=interval.low,
                    high=interval.high,
                    objects=object_count,
                )
            )
        return tuple(rows)

    @cached_property
    def _approaches(self) -> "_ObjectGroups":
        """Road users by approach."""
        approaches = find_approaches(self.preparation.setting.place)
        return _ObjectGroups(approaches.names, approaches.locate(self.unseen.boxes))

    @cached_property
    def _levels(self) -> "_ObjectGroups":
        """Road users by level of traffic."""
        level_of_frame = np.zeros(self.preparation.frames, np.int64)
        for k, frames in enumerate(self.preparation.split(LEVELS)):
            level_of_frame[frames] = k
        return _ObjectGroups(LEVEL_NAMES[LEVELS], level_of_frame[self.unseen.frame])

    def _measure_loads(
        self, candidates: Candidates, seen: Visibility, is_working: np.ndarray
    ) -> tuple[PoleLoad, ...]:
        """Load of the link of each pole, by the data of its working sensors.

        candidates: sensors of a variant; seen: their view of the traffic; is_working: False for
        failed ones."""
        setting = self.preparation.setting
        # axes: sensor, frame; failed sensors send nothing
        kbit = sent_per_frame(seen, setting.fusion, setting.codec) * is_working[:, None]
        # only points count against the capacity of a link
        return measure_links(
            candidates, kbit, setting.link_share, limited=setting.fusion.sends_points
        )


class _ObjectGroups(NamedTuple):
    """Groups of the road users that count.

    Attributes:
        names: Names of the groups.
        group_indices: Index in `names` of the group of each road user."""

    names: tuple[str, ...]
    group_indices: Int64[np.ndarray, " objects"]


def list_problems(objective: Objective) -> tuple[str, ...]:
    """Sentences on what keeps all candidates from being built together."""
    candidates = objective.candidates
    all_sensors = np.ones((1, len(objective.candidates)), np.bool_)  # one set with all
    names = np.array(objective.names)
    problems = [f"{name} sends more than its link carries" for name in names[~objective.linked]]
    sensor_counts = candidates.per_mount(all_sensors)[0]
    price = float(objective.price(all_sensors)[0])
    for mount, count in zip(candidates.mounts, sensor_counts, strict=True):
        if count > mount.max_sensors:
            problems.append(f"{mount.name} carries more sensors than it may")
    if (loads := objective.shared_links) is not None:
        # kbit per frame
        load_sums = candidates.per_mount(all_sensors, loads)[0]
        for mount, load, count in zip(candidates.mounts, load_sums, sensor_counts, strict=True):
            # one sensor that sends too much has a sentence above
            if count > 1 and load > max_load(mount.capacity):
                problems.append(
                    f"the sensors on {mount.name} together send more than its link carries"
                )
    if not objective.affordable(np.array([price]))[0]:
        problems.append(f"it costs {price:g}, more than {objective.most_price:g}")
    return tuple(problems)


def _without_each(
    is_working: Bool[np.ndarray, " candidates"], members: Int64[np.ndarray, " m"]
) -> Bool[np.ndarray, "m candidates"]:
    """Masks of the working sensors without one: row k without sensor `members[k]`."""
    remaining = np.repeat(is_working[None], len(members), axis=0)
    remaining[np.arange(len(members)), members] = False
    return remaining
