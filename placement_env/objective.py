"""The objective that every search and environment maximises.

Reward = AP − λ_comm · kbit per sensor − λ_price · price.

kbit per sensor is the paper's measure of communication (section IV-A): the data that each sensor of
a set sends in a frame, averaged over frames and sensors. A set is feasible if its mounts have room
for its sensors, no sensor sends more than the link of its mount carries (`placement_env.links`),
its mounts and sensors cost no more than the maximum price, and every mount that must carry a sensor
has one.
"""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from placement_env.candidates.candidates import Candidates, extra_prices, fit_together, room_beside
from placement_env.cases import USUAL_CASES, iou_text
from placement_env.classes import VEHICLES, Classes
from placement_env.fidelity.coverage import sent_per_frame
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.visibility import Visibility
from placement_env.links import link_load, max_load
from placement_env.protocol import ByClass, ByFrames
from placement_env.racing import Race, race
from placement_env.setting import Setting, Weights
from placement_env.subsets import Sets, find_index
from toolkit.arrays import Bool, Float64, Int64, Mask
from toolkit.detection.provenance import detector_origin, settings_origin
from toolkit.detection.scheme import scheme_codec
from toolkit.runtime.run import Run
from toolkit.runtime.text_values import replace_infinite
from toolkit.sites.site import Site

Members = Iterable[int | str] | Int64[np.ndarray, " k"]  # members of a set, by index or name
# called with better sets, their reward, and frames of a race or 0
Observer = Callable[[tuple[int, ...], float, int], None]
PRICE_ROUNDING_SHARE = 1e-9  # excess over a price that rounding of sums may cause
MAX_REMEMBERED = 200_000  # sets kept in memory, which is emptied when there are more


@dataclass(frozen=True)
class Score:
    """Score of one set. Its `terms` add up to the reward.

    Attributes:
        subset: Indices of the candidates, ascending.
        ap: Average precision.
        recall: Recall.
        kbit_per_sensor: Data that each sensor sends per frame, on average.
        kbit: Data that all sensors send per frame.
        price: Price of sensors and mounts.
        reward: AP minus costs.
        terms: Terms of the reward by name.
        fidelity: Name of the fidelity.
        cache_hit: Whether the set was scored before.
        class_ap: AP of each class, NaN without an object.
    """

    subset: tuple[int, ...]
    ap: float
    recall: float
    kbit_per_sensor: float
    kbit: float
    price: float
    reward: float
    terms: dict[str, float]
    fidelity: str
    cache_hit: bool
    class_ap: dict[str, float] = field(default_factory=dict)


class Scores(NamedTuple):
    """`Score` of n sets as arrays."""

    ap: Float64[np.ndarray, " n"]
    recall: Float64[np.ndarray, " n"]
    kbit_per_sensor: Float64[np.ndarray, " n"]
    kbit: Float64[np.ndarray, " n"]
    price: Float64[np.ndarray, " n"]
    reward: Float64[np.ndarray, " n"]
    cache_hit: Mask


class _Weighed(NamedTuple):
    """kbit per sensor, price and reward of each set."""

    kbit_per_sensor: Float64[np.ndarray, " n"]
    price: Float64[np.ndarray, " n"]
    reward: Float64[np.ndarray, " n"]


class Objective:
    """Score of sets of candidate sensors for a setting, a site or the name of one.

    visibility: view of the candidates, for a setting with a custom fidelity. Without it, each
    candidate is scored separately to find how much it sends. stride: step between the frames of the
    run that count. If `watch` is set, it is called with better sets as searches find them. Raises
    ValueError if the fidelity cannot score the setting.
    """

    def __init__(
        self,
        setting: Setting | Site | str,
        run: Run = Run(),
        *,
        visibility: Visibility | None = None,
        stride: int = 1,
    ) -> None:
        self.setting = setting if isinstance(setting, Setting) else Setting(setting)
        self.run = run
        self.visibility = visibility
        self._scored = 0
        self.watch: Observer | None = None
        self.preparation: Preparation | None = None
        if isinstance(self.setting.fidelity, str):
            self.preparation = Preparation(self.setting, run, stride)
            self.preparation.check()
            if self.setting.fidelity != "table":
                self.visibility = self.preparation.visibility
            self.scored_by = self.preparation.fidelity()
        else:
            self.scored_by = self.setting.fidelity
        self.candidates = self.setting.pool
        self.scheme = self.setting.fusion
        self.codec = scheme_codec(self.scheme, self.setting.codec)
        self.classes: Classes = getattr(self.scored_by, "classes", VEHICLES)
        class_count = len(self.classes.names) if isinstance(self.scored_by, ByClass) else 1
        self._width = 3 if class_count == 1 else 3 + class_count
        self.forget()

    @classmethod
    def of_moved(
        cls,
        preparation: Preparation,
        candidates: Candidates,
        visibility: Visibility,
        weights: Weights,
    ) -> "Objective":
        """Objective of other candidates with known visibility, in a preparation's traffic."""
        fidelity = preparation.at(candidates, visibility).fidelity()
        setting = replace(
            preparation.setting, candidates=candidates, fidelity=fidelity, weights=weights
        )
        return cls(setting, preparation.run, visibility=visibility)

    def __repr__(self) -> str:
        setting = self.setting
        site_name = "" if self.site is None else f"{self.site.name!r}, "
        summary = (
            f"{site_name}{len(self.candidates)} candidates, scheme={self.scheme.name!r}, "
            f"fidelity={self.fidelity!r}"
        )
        classes = ", ".join(self.classes.names)
        iou = iou_text(setting.cases.threshold)
        limits = "" if math.isinf(self.most_price) else f", most_price={self.most_price:g}"
        limits += f", keep={setting.keep}" if setting.keep else ""
        preparation = self.preparation
        frames = (
            "" if preparation is None else f", frames={preparation.frames}, seed={self.run.seed}"
        )
        weights = f"comm={self.weights.comm:g}, price={self.weights.price:g}"
        return f"Objective({summary}, classes={classes!r}, iou={iou}, {weights}{limits}{frames})"

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_known": self._empty(), "watch": None}

    @property
    def site(self) -> Site | None:
        """Site, None if only candidates are known."""
        return self.setting.site if isinstance(self.setting.site, Site) else None

    @property
    def weights(self) -> Weights:
        """Costs in the reward."""
        return self.setting.weights

    @property
    def most_price(self) -> float:
        """Largest price of a set."""
        return self.setting.most_price

    def weighed(self, weights: Weights, *, most_price: float | None = None) -> "Objective":
        """Same objective with other weights, optionally another price limit, and a separate
        memory."""
        reweighed = copy(self)
        max_price = self.most_price if most_price is None else most_price
        reweighed.setting = replace(self.setting, weights=weights, most_price=max_price)
        vars(reweighed.setting)["pool"] = self.candidates
        reweighed._known = dict(self._known)
        reweighed._scored = 0
        reweighed.watch = None
        return reweighed

    def forget(self) -> None:
        """Empty the memory of scored sets."""
        self._known = self._empty()

    def _empty(self) -> dict[bytes, tuple[float, ...]]:
        """Memory of only the empty set: AP, recall, kbit and the AP of several classes under a
        set's bits."""
        return {bytes(-(-len(self.candidates) // 8)): (0.0,) * self._width}

    @property
    def fidelity(self) -> str:
        """Name of the fidelity."""
        return self.scored_by.name

    @property
    def provenance(self) -> dict[str, Any]:
        """Origin of its scores."""
        preparation = self.preparation
        cases = self.setting.cases
        detector = getattr(self.scored_by, "detector", None)
        facts: dict[str, Any] = {}
        if self.setting.keep:
            facts["keep"] = list(self.setting.keep)
        if self.site is not None:
            facts |= {"site": self.site.name, "hybrid_radius": self.site.hybrid_radius}
        if preparation is not None:
            facts |= {"frames": preparation.frames, "seed": self.run.seed}
        if preparation is not None or cases != USUAL_CASES:
            facts |= cases.origin
        if preparation is not None:
            facts["errors"] = cases.errors_origin
        return settings_origin(
            self.codec,
            **facts,
            candidates=self.candidates.digest(),
            scheme=self.scheme.digest,
            fidelity=self.fidelity,
            classes=self.classes.origin,
            weights=asdict(self.weights),
            **({} if detector is None else detector_origin(detector)),
        )

    def describe_origin(self, members: Iterable[int]) -> dict[str, Any]:
        """Provenance of a set as JSON values, with the names of its sensors."""
        origin = self.provenance | {"sensors": [self.names[member] for member in members]}
        return cast(dict[str, Any], json.loads(json.dumps(replace_infinite(origin), default=str)))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates."""
        return tuple(sensor.name for sensor in self.candidates.sensors)

    @cached_property
    def sent(self) -> Float64[np.ndarray, " C"]:
        """kbit that each candidate sends in a frame, on average."""
        if self.visibility is None or not self.scheme.sends_points:
            return self.scores(np.eye(len(self.candidates), dtype=np.bool_)).kbit
        points = self.scheme.sent_points(self.visibility).mean(axis=1, dtype=np.float64)
        return np.asarray(self.codec.bits(points=points) / 1000)

    @cached_property
    def loads(self) -> Float64[np.ndarray, " C"]:
        """kbit per frame that each candidate takes up of a link; the mean if frames are not
        known."""
        if self.visibility is None or not self.scheme.sends_points:
            return self.sent
        return link_load(
            sent_per_frame(self.visibility, self.scheme, self.codec), self.setting.link_share
        )

    @cached_property
    def linked(self) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that fit their mount's link."""
        if not self.scheme.sends_points:
            return np.ones(len(self.candidates), np.bool_)
        return np.asarray(self.loads <= max_load(self.candidates.capacity))

    def fits_links(self, members: Sequence[int], kbit: Float64[np.ndarray, "k frames"]) -> bool:
        """True if the links of a set carry the data of its sensors.

        kbit: data of each sensor in frames of any traffic.
        """
        if not self.scheme.sends_points:
            return True
        mounts = self.candidates.mount[list(members)]
        loads = np.bincount(
            mounts, link_load(kbit, self.setting.link_share), minlength=len(self.candidates.mounts)
        )
        capacity = np.array([mount.capacity for mount in self.candidates.mounts])
        return bool((loads <= max_load(capacity)).all())

    @cached_property
    def kept(self) -> Int64[np.ndarray, " k"]:
        """Mounts that must carry a sensor."""
        return self.candidates.find_mounts(self.setting.keep)

    @cached_property
    def _least_prices(self) -> Float64[np.ndarray, " M"]:
        """Lowest price of a mount plus one sensor; 0 for unusable mounts."""
        lowest = np.full(len(self.candidates.mounts), np.inf)
        np.minimum.at(
            lowest, self.candidates.mount[self.linked], self.candidates.prices[self.linked]
        )
        return np.where(np.isfinite(lowest), lowest, 0.0)

    def score(self, subset: Members) -> Score:
        """Score of one set, given as indices or names of candidates.

        Raises ValueError for an unknown candidate."""
        row = self.row(subset)
        scores = self.scores(row[None])
        class_ap = self.class_ap(row[None])[0].tolist()
        return Score(
            subset=tuple(np.flatnonzero(row).tolist()),
            ap=float(scores.ap[0]),
            recall=float(scores.recall[0]),
            kbit_per_sensor=float(scores.kbit_per_sensor[0]),
            kbit=float(scores.kbit[0]),
            price=float(scores.price[0]),
            reward=float(scores.reward[0]),
            terms={
                "ap": float(scores.ap[0]),
                "comm": 0 - self.weights.comm * float(scores.kbit_per_sensor[0]),
                "price": 0 - self.weights.price * float(scores.price[0]),
            },
            fidelity=self.fidelity,
            cache_hit=bool(scores.cache_hit[0]),
            class_ap=dict(zip(self.classes.names, class_ap, strict=True)),
        )

    def class_ap(self, subsets: Sets) -> Float64[np.ndarray, "n k"]:
        """AP of each class for each set, NaN for a class without objects."""
        figures, _ = self._figures(subsets)
        return figures[:, 3:] if self._width > 3 else figures[:, :1]

    def scores(self, subsets: Sets) -> Scores:
        """Scores of sets, feasible or not. A known set is not scored again, and the empty set
        scores 0."""
        figures, cache_hit = self._figures(subsets)
        ap, recall, kbit = figures.T[:3]
        weighed = self._weigh(subsets, ap, kbit)
        return Scores(
            ap=ap,
            recall=recall,
            kbit_per_sensor=weighed.kbit_per_sensor,
            kbit=kbit,
            price=weighed.price,
            reward=weighed.reward,
            cache_hit=cache_hit,
        )

    def race(
        self, subsets: Sets, *, keep: int = 1, first: int = 8, eta: int = 3, seed: int = 0
    ) -> Race:
        """Sets with the greatest reward by `racing.race`. Raises ValueError if the fidelity cannot
        race."""
        scored_by = self.scored_by
        if not isinstance(scored_by, ByFrames):
            raise ValueError(
                f"fidelity {self.fidelity} scores all frames at once, which is quick: take scores()"
            )

        def rewards(sets: Sets, frames: Int64[np.ndarray, " k"]) -> Float64[np.ndarray, " n"]:
            estimate = scored_by.partial(sets, frames.tolist())
            self._tell(len(sets))
            return self._weigh(sets, estimate.ap, estimate.kbit).reward

        return race(rewards, subsets, scored_by.frames, keep=keep, first=first, eta=eta, seed=seed)

    def _weigh(
        self, subsets: Sets, ap: Float64[np.ndarray, " n"], kbit: Float64[np.ndarray, " n"]
    ) -> "_Weighed":
        """Costs and reward of each set."""
        per_sensor = kbit / np.maximum(subsets.sum(axis=1), 1)
        price = self.price(subsets)
        reward = ap - self.weights.comm * per_sensor - self.weights.price * price
        return _Weighed(per_sensor, price, reward)

    def price(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Price of the sensors of each set and their mounts, each mount paid once."""
        built = np.zeros((len(subsets), len(self.candidates.mounts)), np.bool_)
        row, candidate = subsets.nonzero()
        built[row, self.candidates.mount[candidate]] = True
        models = np.bincount(row, self.candidates.model_prices[candidate], minlength=len(subsets))
        return np.asarray(built @ self.candidates.mount_prices + models)

    def affordable(self, prices: Float64[np.ndarray, " n"]) -> Mask:
        """Mask of prices within `most_price`, up to rounding."""
        return np.asarray(prices <= self.most_price * (1 + PRICE_ROUNDING_SHARE))

    def feasible(self, subsets: Sets) -> Mask:
        """Mask of sets that may be built."""
        is_fitting = fit_together(self.candidates, subsets, self.shared_links) & self.keeps(subsets)
        return np.asarray(
            is_fitting
            & ~(subsets & ~self.linked).any(axis=1)
            & self.affordable(self.price(subsets))
        )

    def keeps(self, subsets: Sets) -> Mask:
        """Mask of sets with a sensor on every mount that must carry one."""
        if not len(self.kept):
            return np.ones(len(subsets), np.bool_)
        return np.asarray((self.candidates.per_mount(subsets)[:, self.kept] > 0).all(axis=1))

    def allowed(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that keep a set feasible: there is room on their mounts, and money for
        them."""
        return self._fitting(subset, 0.0)

    def next_allowed(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        """Mask of candidates to add next.

        Until all mounts that must carry a sensor have one, these are candidates on such mounts that
        leave money for the others; then any that are allowed.
        """
        mount = self.candidates.mount
        empty_mounts = np.setdiff1d(self.kept, mount[self._row(subset)])
        if not len(empty_mounts):
            return self.allowed(subset)
        reserve = self._least_prices[empty_mounts].sum() - self._least_prices[mount]
        return self._fitting(subset, reserve) & np.isin(mount, empty_mounts)

    def _fitting(
        self, subset: Bool[np.ndarray, " C"] | Members, reserve: float | Float64[np.ndarray, " C"]
    ) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that keep a set feasible and some money in reserve."""
        row = self._row(subset)
        price = self.price(row[None])[0] + extra_prices(self.candidates, row)
        has_room = room_beside(self.candidates, row[None], self.shared_links)[0]
        return np.asarray(has_room & self.linked & self.affordable(price + reserve))

    def _row(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        if isinstance(subset, np.ndarray) and subset.dtype == np.bool_:
            return subset
        return self.row(subset)

    @property
    def shared_links(self) -> Float64[np.ndarray, " C"] | None:
        """Load of each candidate if sensors may share the link of a mount and exceed it together,
        else None."""
        return self.loads if self.candidates.several and self.scheme.sends_points else None

    def row(self, subset: Members) -> Bool[np.ndarray, " C"]:
        """Row of booleans for a set of indices or names of candidates."""
        row = np.zeros(len(self.candidates), np.bool_)
        for member in subset.tolist() if isinstance(subset, np.ndarray) else subset:
            row[find_index(member, self.names)] = True
        return row

    def _figures(self, subsets: Sets) -> tuple[Float64[np.ndarray, "n _"], Mask]:
        """AP, recall, kbit and the AP of several classes of each set, and whether it was known
        before."""
        if len(self._known) > MAX_REMEMBERED:
            self.forget()
        keys = [key.tobytes() for key in np.packbits(subsets, axis=1)]
        cache_hit = np.fromiter((key in self._known for key in keys), np.bool_, len(keys))
        new_rows = {key: row for row, key in enumerate(keys) if not cache_hit[row]}
        if new_rows:
            sets = subsets[list(new_rows.values())]
            class_columns: tuple[np.ndarray, ...] = ()
            if self._width == 3:
                estimate = self.scored_by(sets)
            else:
                estimates = cast(ByClass, self.scored_by).by_class(sets)
                estimate = estimates.combined(self.classes)
                class_columns = tuple(estimates.ap.T)
            if not np.isfinite(estimate.ap).all():
                nouns = " or ".join(self.classes.names)
                raise ValueError(
                    f"there is no {nouns} to find in these frames: say more --frames, or another "
                    "--seed"
                )
            if not np.isfinite(estimate.kbit).all():
                raise ValueError(
                    f"kbit must be finite, fidelity {self.fidelity!r} says "
                    f"{estimate.kbit.tolist()[:3]}"
                )
            columns = np.stack(
                [estimate.ap, estimate.recall, estimate.kbit, *class_columns], axis=1
            )
            for key, row in zip(new_rows, columns.tolist(), strict=True):
                self._known[key] = tuple(row)
            self._tell(len(new_rows))
        figures = np.array([self._known[key] for key in keys], np.float64)
        return figures.reshape(-1, self._width), cache_hit

    def _tell(self, scored: int) -> None:
        """Count newly scored sets, on some frames or all."""
        self._scored += scored
        if self.run.progress:
            self.run.progress("sets scored", self._scored, None)
