"""`LiveAnswer`: figures of a variant on the planner's frames, by the surrogate, with intervals.

The intervals (`placement_env.analysis.intervals`) use the same draws for every variant, so that the
change that a move makes has an interval too. The interval of an AP includes the error of the
surrogate. Intervals need `LEAST_BLOCKS` blocks of frames, fewer than an evaluated set needs; see
`docs/how-to/live.md` for how often they hold."""

import math
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from placement_env.analysis.approaches import find_approaches
from placement_env.analysis.intervals import (
    BLOCK_FRAMES,
    Interval,
    block_draws,
    count_blocks,
    figure_interval,
    percentiles,
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

LEVELS = 3  # levels of traffic
LEAST_BLOCKS = 5  # blocks of frames that have an interval here
NORMAL_ENDS = 1.96  # standard errors to the ends of a 95 % interval


@dataclass(frozen=True)
class FoundShare:
    """Share of the objects of a group that is found.

    Attributes:
        name: Name of the class, approach or level of traffic.
        ap: AP of a class, else None.
        recall: Share of the objects that is found.
        low: Lower end of the interval of the AP, or of the share without one.
        high: Upper end of that interval.
        objects: Number of objects.
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
        ap: Predicted AP.
        low: Lower end of its 95 % interval, over frames and the error of the prediction.
        high: Upper end of that interval.
        recall: Predicted recall.
        kbit: Data that all sensors send per frame.
        price: Price in `currency`.
        worst: AP that remains after the worst single failure.
        worst_low: Lower end of its interval.
        worst_high: Upper end of its interval.
        worst_sensor: Sensor whose failure is the worst, "" without sensors.
        spread: Standard error of the prediction, NaN if unknown.
        change: Change of the AP since the answer before, on the same frames.
        change_low: Lower end of the interval of the change.
        change_high: Upper end of the interval of the change.
        classes: Share found of each class.
        approaches: Share found on each approach.
        levels: Share found at each level of traffic.
        links: Load of the link of each pole.
        objects: Number of road users.
        frames: Number of frames.
        unseen: Number of road users without a point.
        currency: Currency of the price, "" for prices in ordinary poles.
        budget: Largest price.
        problems: Sentences on what keeps the variant from being built.
        coarse: Whether a view was interpolated between heights, or only the first frames count.
        resamples: Resampled AP.
        probability: Probability that each road user is found.
        hidden: Mask of the road users without a point.
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
    probability: Float64[np.ndarray, " O"] = field(
        default_factory=lambda: np.zeros(0), repr=False, compare=False
    )
    hidden: Bool[np.ndarray, " O"] = field(
        default_factory=lambda: np.zeros(0, np.bool_), repr=False, compare=False
    )

    def as_dict(self) -> dict[str, object]:
        """Return the figures for JSON."""
        unlimited = {"budget"} if math.isinf(self.budget) else set()
        left_out = {"resamples", "probability", "hidden"} | unlimited
        return {name: value for name, value in asdict(self).items() if name not in left_out}

    def since(self, before: "LiveAnswer | None", what: str) -> "LiveAnswer":
        """The answer with the change of AP since another, on the same frames, and what made it."""
        if before is None:
            return replace(self, what=what, change=0.0, change_low=0.0, change_high=0.0)
        change = self.ap - before.ap
        ends = percentiles(
            self.resamples - before.resamples, count_blocks(self.frames), fewest=LEAST_BLOCKS
        )
        low, high = min(ends.low, change), max(ends.high, change)
        return replace(self, what=what, change=change, change_low=low, change_high=high)


def widen_interval(figure: float, ends: Interval, spread: float) -> Interval:
    """Interval of a predicted share, from its interval over frames and its standard error.

    spread: standard error, NaN to leave it out."""
    if math.isnan(ends.low):
        return ends
    margin = NORMAL_ENDS * (0.0 if math.isnan(spread) else spread)
    low, high = (math.hypot(figure - end, margin) for end in ends)
    return Interval(max(0.0, figure - low), min(1.0, figure + high))


class Meter:
    """Figures of variants in the traffic of a preparation."""

    def __init__(self, preparation: Preparation, currency: str) -> None:
        self.preparation = preparation
        self._currency = currency
        self.blocks = count_blocks(preparation.frames)
        self._draws = block_draws(self.blocks, block=1).astype(np.float32)

    def objective(self, candidates: Candidates, visibility: Visibility) -> Objective:
        """Objective of sensors whose view is known."""
        preparation = self.preparation
        return Objective.from_view(preparation, candidates, visibility, preparation.setting.weights)

    def judge(
        self, candidates: Candidates, seen: Visibility, is_working: Bool[np.ndarray, " C"]
    ) -> tuple[float, int]:
        """AP and number of problems, in a tenth of the time of `measure`."""
        objective = self.objective(candidates, seen)
        return float(objective.scores(is_working[None]).ap[0]), len(_list_problems(objective))

    def measure(
        self, candidates: Candidates, seen: Visibility, is_working: Bool[np.ndarray, " C"]
    ) -> LiveAnswer:
        """Figures of all sensors, without a change. is_working: False for failed sensors."""
        objective = self.objective(candidates, seen)
        all_working = is_working[None]
        members = np.flatnonzero(is_working)
        remaining = np.repeat(all_working, len(members), axis=0)
        remaining[np.arange(len(members)), members] = False
        scores = objective.scores(np.concatenate([all_working, remaining]))
        worst_index = int(scores.ap[1:].argmin()) if len(members) else -1
        surrogate = cast(Surrogate, objective.scored_by)
        worst = 0.0
        without_worst = is_working
        spread = 0.0
        worst_spread = 0.0
        if len(members):
            worst = float(scores.ap[1:][worst_index])
            without_worst = remaining[worst_index]
            spread, worst_spread = surrogate.spread(np.stack([is_working, without_worst])).tolist()
        classes, resamples, probability = self._by_class(surrogate, is_working, seen, spread)
        ap = float(scores.ap[0])
        objects = len(probability)
        sample = {"blocks": self.blocks, "objects": objects, "fewest": LEAST_BLOCKS}
        bounds = widen_interval(ap, figure_interval(ap, resamples, **sample), spread)
        worst_resamples = self._resample(surrogate, without_worst)[0]
        worst_bounds = widen_interval(
            worst, figure_interval(worst, worst_resamples, **sample), worst_spread
        )
        hidden = seen.points[is_working].sum(axis=0) == 0
        return LiveAnswer(
            what="",
            sensors=len(is_working),
            ap=ap,
            low=bounds.low,
            high=bounds.high,
            recall=float(scores.recall[0]),
            kbit=float(scores.kbit[0]),
            price=float(objective.price(np.ones_like(all_working))[0]),
            worst=worst,
            worst_low=worst_bounds.low,
            worst_high=worst_bounds.high,
            worst_sensor=objective.names[members[worst_index]] if len(members) else "",
            spread=spread,
            change=0.0,
            change_low=0.0,
            change_high=0.0,
            classes=classes,
            approaches=self._by_group(*self._approaches, probability),
            levels=self._by_group(*self._levels, probability),
            links=self._loads(candidates, seen, is_working),
            objects=objects,
            frames=seen.frames,
            unseen=int(hidden.sum()),
            currency=self._currency,
            budget=self.preparation.setting.most_price,
            problems=_list_problems(objective),
            resamples=resamples,
            probability=probability,
            hidden=hidden,
        )

    @cached_property
    def _block(self) -> Int64[np.ndarray, " O"]:
        return self.unseen.frame // BLOCK_FRAMES

    @property
    def unseen(self) -> Visibility:
        """The road users that count, seen by no sensor."""
        return self.preparation.unseen

    def _by_class(
        self,
        surrogate: Surrogate,
        is_working: Bool[np.ndarray, " C"],
        seen: Visibility,
        spread: float,
    ) -> tuple[
        tuple[FoundShare, ...], Float64[np.ndarray, " resamples"], Float64[np.ndarray, " O"]
    ]:
        """Each class, resampled AP of all, and the hit probability of each object. spread: the
        prediction's."""
        resamples, drawn = self._resample(surrogate, is_working)
        probability = np.zeros(len(seen.boxes))
        rows = []
        aps = surrogate.by_class(is_working[None]).ap[0].tolist()
        for k, (name, hits) in enumerate(
            zip(surrogate.classes.names, surrogate.hits(is_working), strict=True)
        ):
            probability[seen.labels == surrogate.classes.labels[k]] = hits
            bounds = Interval(np.nan, np.nan)
            if len(hits):
                frames = figure_interval(
                    aps[k], drawn[k], blocks=self.blocks, objects=len(hits), fewest=LEAST_BLOCKS
                )
                bounds = widen_interval(aps[k], frames, spread)
            recall = float(hits.mean()) if len(hits) else np.nan
            rows.append(FoundShare(name, aps[k], recall, *bounds, len(hits)))
        return tuple(rows), resamples, probability

    def _resample(
        self, surrogate: Surrogate, is_working: Bool[np.ndarray, " C"]
    ) -> tuple[Float64[np.ndarray, " resamples"], list[Float64[np.ndarray, " resamples"]]]:
        """AP of all and of each class over the draws of frames."""
        labels = surrogate.classes.labels
        hits = surrogate.hits(is_working)
        drawn = [
            resample_ap(
                probability,
                model.false_alarms,
                self._draws,
                self._block[self.unseen.labels == label],
            )
            for label, model, probability in zip(labels, surrogate.models, hits, strict=True)
        ]
        return surrogate.classes.combined(np.stack(drawn, axis=1)), drawn

    def _by_group(
        self,
        names: tuple[str, ...],
        group: Int64[np.ndarray, " O"],
        probability: Float64[np.ndarray, " O"],
    ) -> tuple[FoundShare, ...]:
        """Share found of each group of objects. group: group of each."""
        cell = group * self.blocks + self._block
        rows = []
        shape = (len(names), self.blocks)
        counts = np.bincount(cell, minlength=math.prod(shape)).reshape(shape)
        sums = np.bincount(cell, probability, math.prod(shape)).reshape(shape)
        for k in np.flatnonzero(counts.any(axis=1)).tolist():
            objects = int(counts[k].sum())
            drawn_counts = self._draws @ counts[k]
            shares = np.divide(
                self._draws @ sums[k],
                drawn_counts,
                out=np.full(len(drawn_counts), np.nan),
                where=drawn_counts > 0,
            )
            recall = float(sums[k].sum() / objects)
            bounds = figure_interval(
                recall, shares, blocks=self.blocks, objects=objects, fewest=LEAST_BLOCKS
            )
            rows.append(FoundShare(names[k], None, recall, *bounds, objects))
        return tuple(rows)

    @cached_property
    def _approaches(self) -> tuple[tuple[str, ...], np.ndarray]:
        approaches = find_approaches(self.preparation.setting.place)
        return approaches.names, approaches.locate(self.unseen.boxes)

    @cached_property
    def _levels(self) -> tuple[tuple[str, ...], np.ndarray]:
        level = np.zeros(self.preparation.frames, np.int64)
        for k, frames in enumerate(self.preparation.split(LEVELS)):
            level[frames] = k
        return LEVEL_NAMES[LEVELS], level[self.unseen.frame]

    def _loads(
        self, candidates: Candidates, seen: Visibility, is_working: np.ndarray
    ) -> tuple[PoleLoad, ...]:
        setting = self.preparation.setting
        kbit = sent_per_frame(seen, setting.fusion, setting.codec) * is_working[:, None]
        return measure_links(
            candidates, kbit, setting.link_share, limited=setting.fusion.sends_points
        )


def _list_problems(objective: Objective) -> tuple[str, ...]:
    """Sentences on what keeps all candidates from being built together."""
    candidates = objective.candidates
    all_sensors = np.ones((1, len(objective.candidates)), np.bool_)
    problems = [
        f"{name} sends more than its link carries"
        for name in np.array(objective.names)[~objective.linked]
    ]
    per_mount = candidates.per_mount(all_sensors)[0]
    price = float(objective.price(all_sensors)[0])
    crowded = [
        m.name
        for m, count in zip(candidates.mounts, per_mount, strict=True)
        if count > m.max_sensors
    ]
    problems += [f"{name} carries more sensors than it may" for name in crowded]
    if (loads := objective.shared_links) is not None:
        sums = candidates.per_mount(all_sensors, loads)[0]
        mounts = zip(candidates.mounts, sums, per_mount, strict=True)
        narrow = [m.name for m, load, count in mounts if count > 1 and load > max_load(m.capacity)]
        problems += [
            f"the sensors on {name} together send more than its link carries" for name in narrow
        ]
    if not objective.affordable(np.array([price]))[0]:
        problems.append(f"it costs {price:g}, more than {objective.most_price:g}")
    return tuple(problems)
