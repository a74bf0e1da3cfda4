"""The objective that every search and environment maximises.

Reward = AP − λ_comm · kbit per sensor − λ_price · price.

kbit per sensor is the paper's measure of communication (section IV-A): the data that each sensor of
a set sends in a frame, averaged over frames and sensors. A set is feasible when its mounts have
room for its sensors, no sensor sends more than the link of its mount carries
(`placement_env.links`), its mounts and sensors cost no more than the money available, and every
mount that must carry a sensor has one."""

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
from toolkit.runtime.files import replace_infinite
from toolkit.runtime.run import Run
from toolkit.sites.site import Site

Members = Iterable[int | str] | Int64[np.ndarray, " k"]  # of a set, by index or name
# of better sets, their reward, and frames of a race or 0
Observer = Callable[[tuple[int, ...], float, int], None]
ROUNDING = 1e-9  # share of a price by which a sum of prices may exceed it
MOST_REMEMBERED = 200_000  # sets kept in memory; when there are more, the memory starts anew


@dataclass(frozen=True)
class Score:
    """Score of one set (ascending indices). Its `terms` add up to the reward; class_ap: NaN without
    an object."""

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


class Objective:
    """Score sets of candidate sensors for a setting, a site or the name of one.

    visibility: what the candidates see, for a setting with a custom fidelity. Without it, each
    candidate is scored alone to find how much it sends. stride: step between the frames of the run
    that count. `watch`, where it is set, is told better sets as searches find them. Raises
    ValueError where the fidelity cannot score the setting this way."""

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
        several = len(self.classes.names) if isinstance(self.scored_by, ByClass) else 1
        self._width = 3 if several == 1 else 3 + several
        self.forget()

    @classmethod
    def of_moved(
        cls,
        preparation: Preparation,
        candidates: Candidates,
        visibility: Visibility,
        weights: Weights,
    ) -> "Objective":
        """Objective of other candidates, whose visibility is known, in a preparation's traffic."""
        fidelity = preparation.at(candidates, visibility).fidelity()
        setting = replace(
            preparation.setting, candidates=candidates, fidelity=fidelity, weights=weights
        )
        return cls(setting, preparation.run, visibility=visibility)

    def __repr__(self) -> str:
        setting = self.setting
        place = "" if self.site is None else f"{self.site.name!r}, "
        shown = (
            f"{place}{len(self.candidates)} candidates, scheme={self.scheme.name!r}, "
            f"fidelity={self.fidelity!r}"
        )
        classes = ", ".join(self.classes.names)
        iou = iou_text(setting.cases.threshold)
        limits = "" if math.isinf(self.most_price) else f", most_price={self.most_price:g}"
        limits += f", keep={setting.keep}" if setting.keep else ""
        made = self.preparation
        frames = "" if made is None else f", frames={made.frames}, seed={self.run.seed}"
        weights = f"comm={self.weights.comm:g}, price={self.weights.price:g}"
        return f"Objective({shown}, classes={classes!r}, iou={iou}, {weights}{limits}{frames})"

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_known": self._empty(), "watch": None}

    @property
    def site(self) -> Site | None:
        """The site, None where candidates alone are known."""
        return self.setting.site if isinstance(self.setting.site, Site) else None

    @property
    def weights(self) -> Weights:
        """Costs in the reward."""
        return self.setting.weights

    @property
    def most_price(self) -> float:
        """Most that a set may cost."""
        return self.setting.most_price

    def weighed(self, weights: Weights, *, most_price: float | None = None) -> "Objective":
        """Same objective with other weights, a price limit where given, and its own memory."""
        other = copy(self)
        most = self.most_price if most_price is None else most_price
        other.setting = replace(self.setting, weights=weights, most_price=most)
        vars(other.setting)["pool"] = self.candidates
        other._known = dict(self._known)
        other._scored = 0
        other.watch = None
        return other

    def forget(self) -> None:
        """Empty the memory of scored sets."""
        self._known = self._empty()

    def _empty(self) -> dict[bytes, tuple[float, ...]]:
        """Memory of the empty set alone: AP, recall, kbit and the AP of each of several classes
        under a set's bits."""
        return {bytes(-(-len(self.candidates) // 8)): (0.0,) * self._width}

    @property
    def fidelity(self) -> str:
        """Name of the fidelity."""
        return self.scored_by.name

    @property
    def provenance(self) -> dict[str, Any]:
        """Origin of its scores."""
        made = self.preparation
        cases = self.setting.cases
        detector = getattr(self.scored_by, "detector", None)
        known: dict[str, Any] = {"keep": list(self.setting.keep)} if self.setting.keep else {}
        if self.site is not None:
            known |= {"site": self.site.name, "hybrid_radius": self.site.hybrid_radius}
        if made is not None:
            known |= {"frames": made.frames, "seed": self.run.seed}
        if made is not None or cases != USUAL_CASES:
            known |= cases.origin
        if made is not None:
            known["errors"] = cases.errors_origin
        return settings_origin(
            self.codec,
            **known,
            candidates=self.candidates.digest(),
            scheme=self.scheme.digest,
            fidelity=self.fidelity,
            classes=self.classes.origin,
            weights=asdict(self.weights),
            **({} if detector is None else detector_origin(detector)),
        )

    def describe_origin(self, members: Iterable[int]) -> dict[str, Any]:
        """Provenance of a set, as JSON keeps it, with the names of its sensors."""
        known = self.provenance | {"sensors": [self.names[member] for member in members]}
        return cast(dict[str, Any], json.loads(json.dumps(replace_infinite(known), default=str)))

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
        """kbit of a frame that each candidate takes up of a link; the mean where frames are not
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
        """True if the links of a set carry what its sensors send. kbit: each sensor's, in frames of
        any traffic."""
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
        """Least price of a sensor on each mount, which is paid too; 0 where none may stand."""
        least = np.full(len(self.candidates.mounts), np.inf)
        np.minimum.at(
            least, self.candidates.mount[self.linked], self.candidates.prices[self.linked]
        )
        return np.where(np.isfinite(least), least, 0.0)

    def score(self, subset: Members) -> Score:
        """Score of one set, given as indices or names of candidates. Raises ValueError for an
        unknown one."""
        row = self.row(subset)
        scores = self.scores(row[None])
        ap, recall, per_sensor, kbit, price, reward = (float(figure[0]) for figure in scores[:6])
        terms = {
            "ap": ap,
            "comm": 0 - self.weights.comm * per_sensor,
            "price": 0 - self.weights.price * price,
        }
        members = tuple(np.flatnonzero(row).tolist())
        by_class = dict(zip(self.classes.names, self.class_ap(row[None])[0].tolist(), strict=True))
        figures = (ap, recall, per_sensor, kbit, price, reward)
        return Score(members, *figures, terms, self.fidelity, bool(scores.cache_hit[0]), by_class)

    def class_ap(self, subsets: Sets) -> Float64[np.ndarray, "n k"]:
        """AP of each class for each set, NaN for a class without objects."""
        figures, _ = self._figures(subsets)
        return figures[:, 3:] if self._width > 3 else figures[:, :1]

    def scores(self, subsets: Sets) -> Scores:
        """Scores of sets, feasible or not. A known set is not scored again, and the empty set
        scores 0."""
        figures, cache_hit = self._figures(subsets)
        ap, recall, kbit = figures.T[:3]
        per_sensor, price, reward = self._weigh(subsets, ap, kbit)
        return Scores(ap, recall, per_sensor, kbit, price, reward, cache_hit)

    def race(
        self, subsets: Sets, *, keep: int = 1, first: int = 8, eta: int = 3, seed: int = 0
    ) -> Race:
        """Sets of the greatest reward, as by `racing.race`. Raises ValueError if the fidelity
        cannot."""
        scored_by = self.scored_by
        if not isinstance(scored_by, ByFrames):
            raise ValueError(
                f"fidelity {self.fidelity} scores all frames at once, which is quick: take scores()"
            )

        def rewards(sets: Sets, frames: Int64[np.ndarray, " k"]) -> Float64[np.ndarray, " n"]:
            estimate = scored_by.partial(sets, frames.tolist())
            self._tell(len(sets))
            return self._weigh(sets, estimate.ap, estimate.kbit)[2]

        return race(rewards, subsets, scored_by.frames, keep=keep, first=first, eta=eta, seed=seed)

    def _weigh(
        self, subsets: Sets, ap: Float64[np.ndarray, " n"], kbit: Float64[np.ndarray, " n"]
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """kbit per sensor, price and reward of each set."""
        per_sensor = kbit / np.maximum(subsets.sum(axis=1), 1)
        price = self.price(subsets)
        return per_sensor, price, ap - self.weights.comm * per_sensor - self.weights.price * price

    def price(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Price of the mounts, each paid once, and sensors of each set."""
        built = np.zeros((len(subsets), len(self.candidates.mounts)), np.bool_)
        row, candidate = subsets.nonzero()
        built[row, self.candidates.mount[candidate]] = True
        models = np.bincount(row, self.candidates.model_prices[candidate], minlength=len(subsets))
        return np.asarray(built @ self.candidates.mount_prices + models)

    def affordable(self, prices: Float64[np.ndarray, " n"]) -> Mask:
        """Mask of prices within `most_price`, up to rounding."""
        return np.asarray(prices <= self.most_price * (1 + ROUNDING))

    def feasible(self, subsets: Sets) -> Mask:
        """Mask of sets that may be built."""
        together = fit_together(self.candidates, subsets, self.shared_links) & self.keeps(subsets)
        return np.asarray(
            together & ~(subsets & ~self.linked).any(axis=1) & self.affordable(self.price(subsets))
        )

    def keeps(self, subsets: Sets) -> Mask:
        """Mask of sets with a sensor on every mount that must carry one."""
        if not len(self.kept):
            return np.ones(len(subsets), np.bool_)
        return np.asarray((self.candidates.per_mount(subsets)[:, self.kept] > 0).all(axis=1))

    def allowed(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that keep a set feasible: with room on their mounts, and money left
        for them."""
        return self._fitting(subset, 0.0)

    def next_allowed(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        """Mask of candidates to add next: on mounts that must carry a sensor until all do, which
        leave money for these. Then any that is allowed."""
        mount = self.candidates.mount
        bare = np.setdiff1d(self.kept, mount[self._row(subset)])
        if not len(bare):
            return self.allowed(subset)
        return self._fitting(
            subset, self._least_prices[bare].sum() - self._least_prices[mount]
        ) & np.isin(mount, bare)

    def _fitting(
        self, subset: Bool[np.ndarray, " C"] | Members, reserve: float | Float64[np.ndarray, " C"]
    ) -> Bool[np.ndarray, " C"]:
        """Mask of candidates that keep a set feasible and some money in reserve."""
        row = self._row(subset)
        price = self.price(row[None])[0] + extra_prices(self.candidates, row)
        room = room_beside(self.candidates, row[None], self.shared_links)[0]
        return np.asarray(room & self.linked & self.affordable(price + reserve))

    def _row(self, subset: Bool[np.ndarray, " C"] | Members) -> Bool[np.ndarray, " C"]:
        return (
            subset
            if isinstance(subset, np.ndarray) and subset.dtype == np.bool_
            else self.row(subset)
        )

    @property
    def shared_links(self) -> Float64[np.ndarray, " C"] | None:
        """Load of each candidate, None unless sensors share the link of a mount and may send too
        much together."""
        return self.loads if self.candidates.several and self.scheme.sends_points else None

    def row(self, subset: Members) -> Bool[np.ndarray, " C"]:
        """Row of booleans of a set of indices or names of candidates."""
        row = np.zeros(len(self.candidates), np.bool_)
        for member in subset.tolist() if isinstance(subset, np.ndarray) else subset:
            row[find_index(member, self.names)] = True
        return row

    def _figures(self, subsets: Sets) -> tuple[Float64[np.ndarray, "n _"], Mask]:
        """AP, recall, kbit and the AP of each of several classes of each set, and whether it was
        known before."""
        if len(self._known) > MOST_REMEMBERED:
            self.forget()
        keys = [key.tobytes() for key in np.packbits(subsets, axis=1)]
        cache_hit = np.fromiter((key in self._known for key in keys), np.bool_, len(keys))
        fresh = {key: row for row, key in enumerate(keys) if not cache_hit[row]}
        if fresh:
            sets = subsets[list(fresh.values())]
            of_classes: tuple[np.ndarray, ...] = ()
            if self._width == 3:
                estimate = self.scored_by(sets)
            else:
                each = cast(ByClass, self.scored_by).by_class(sets)
                estimate = each.combined(self.classes)
                of_classes = tuple(each.ap.T)
            if not np.isfinite(estimate.ap).all():
                there = " or ".join(self.classes.names)
                raise ValueError(
                    f"there is no {there} to find in these frames: say more --frames, or another "
                    "--seed"
                )
            if not np.isfinite(estimate.kbit).all():
                raise ValueError(
                    f"kbit must be finite, fidelity {self.fidelity!r} says "
                    f"{estimate.kbit.tolist()[:3]}"
                )
            columns = (estimate.ap, estimate.recall, estimate.kbit, *of_classes)
            self._known.update(
                zip(fresh, zip(*(column.tolist() for column in columns), strict=True), strict=True)
            )
            self._tell(len(fresh))
        return np.array([self._known[key] for key in keys], np.float64).reshape(
            -1, self._width
        ), cache_hit

    def _tell(self, scored: int) -> None:
        """Count newly scored sets, on some frames or all."""
        self._scored += scored
        if self.run.progress:
            self.run.progress("sets scored", self._scored, None)
