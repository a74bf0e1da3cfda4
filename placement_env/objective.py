"""`Objective`: the reward of sensor sets, which every search and environment maximises.

    reward = AP - λ_comm · kbit per sensor - λ_price · price

kbit per sensor is the paper's measure of communication (section IV-A): the data that each sensor of
a set sends in a frame, averaged over frames and sensors. A set passes these stages:

    candidates        rows of booleans by index or name     `placement_env.feasibility`
    feasible or not   mounts, links, price, kept poles      `placement_env.feasibility`
    figures           AP, recall and kbit by the fidelity   `placement_env.score_memory`
    score             figures, price and reward             `Objective.scores`
"""

import json
import math
from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.cases import iou_text
from placement_env.defaults import USUAL_CASES
from placement_env.feasibility import FeasibleSets, Members
from placement_env.fidelity.coverage import sent_per_frame
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.visibility import Visibility
from placement_env.links import sent_in_most
from placement_env.protocol import ByFrames
from placement_env.racing import Race, race
from placement_env.score_memory import ScoreMemory, SetFigures
from placement_env.setting import Setting, Weights
from placement_env.subsets import Sets
from toolkit.arrays import Float64, Int64, Mask
from toolkit.detection.provenance import detector_origin, settings_origin
from toolkit.detection.scheme import scheme_codec
from toolkit.runtime.run import Run
from toolkit.runtime.text_values import replace_infinite
from toolkit.sites.site import Site

# called with a better set (indices of candidates), its reward, and the number of frames of a race
# that scored it, or 0
Observer = Callable[[tuple[int, ...], float, int], None]


@dataclass(frozen=True)
class Score:
    """Score of one set. Its `terms` add up to the reward.

    Attributes:
        subset: Indices of the candidates, ascending.
        ap: Average precision (0 to 1) of all classes combined.
        recall: Recall (0 to 1) of all classes combined.
        kbit_per_sensor: Data that each sensor sends per frame, averaged over frames and sensors.
        kbit: Data that all sensors send per frame, averaged over frames.
        price: Price of sensors and mounts, each mount paid once.
        reward: AP minus weighted kbit per sensor and price.
        terms: Terms of the reward: "ap", and as negative numbers "comm" and "price".
        fidelity: Name of the fidelity that scored the set, such as "surrogate".
        cache_hit: Whether the set was scored before.
        class_ap: AP of each class by name, NaN for a class without an object.
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
    """Fields of `Score` for n sets, as arrays with one figure of each set, in the sets' order."""

    ap: Float64[np.ndarray, " n"]
    recall: Float64[np.ndarray, " n"]
    kbit_per_sensor: Float64[np.ndarray, " n"]
    kbit: Float64[np.ndarray, " n"]
    price: Float64[np.ndarray, " n"]
    reward: Float64[np.ndarray, " n"]
    cache_hit: Mask


class _Weighed(NamedTuple):
    """Costs and reward of n sets.

    Attributes:
        kbit_per_sensor: Data that each sensor of a set sends per frame, on average.
        price: Price of the set's sensors and mounts.
        reward: AP minus both, times their weights.
    """

    kbit_per_sensor: Float64[np.ndarray, " n"]
    price: Float64[np.ndarray, " n"]
    reward: Float64[np.ndarray, " n"]


class Objective(FeasibleSets):
    """Score of sets of candidate sensors for a setting, a site or the name of one.

    setting: a site, or its name, means a setting with all other fields as usual. run: seed, number
    of frames, cache and progress. visibility: view of the candidates, for a setting with a custom
    fidelity. Without it, each candidate is scored separately to find how much it sends. stride:
    step between the frames of the run that count. Raises ValueError if the fidelity cannot score
    the setting.

    Attributes:
        setting: Question that the sets are scored by.
        run: How it is computed: seed, number of frames, cache and progress.
        visibility: Points and objects that each candidate sees in each frame, None if unknown.
        preparation: Traffic and views of a fidelity given by name, None for a custom fidelity.
        scored_by: Fidelity, which gives AP, recall and kbit of sets.
        site: Site, None if only candidates are known.
        weights: Costs in the reward.
        codec: Codec of the data sent, as the fusion scheme uses it.
        classes: Classes that count.
        watch: Called with better sets as searches find them, None for nobody.
    """

    def __init__(
        self,
        setting: Setting | Site | str,
        run: Run = Run(),
        *,
        visibility: Visibility | None = None,
        stride: int = 1,
    ) -> None:
        """Prepare the traffic and the fidelity of a setting; candidates are rendered for both.

        Args:
            setting: Setting; or a site or its name, for the usual setting there.
            run: Seed, number of frames, cache and progress.
            visibility: Points of the candidates on the objects, for a setting with a custom
                fidelity; None if unknown. A fidelity given by name brings its visibility.
            stride: Step between the frames of the run that count.

        Raises ValueError if the fidelity cannot score the setting."""
        setting = setting if isinstance(setting, Setting) else Setting(setting)
        self.run = run
        self.visibility = visibility
        self.preparation: Preparation | None = None
        if isinstance(setting.fidelity, str):
            self.preparation = Preparation(setting, run, stride)
            self.preparation.check()
            if setting.fidelity != "table":
                self.visibility = self.preparation.visibility
            self.scored_by = self.preparation.fidelity()
        else:
            self.scored_by = setting.fidelity
        self.candidates = setting.pool
        self.scheme = setting.fusion
        self.codec = scheme_codec(self.scheme, setting.codec)
        self._apply_setting(setting)
        self._memory = ScoreMemory(self.scored_by)
        self.classes = self._memory.classes

    def _apply_setting(self, setting: Setting) -> None:
        """Take over site, costs and limits of a setting; count scored sets from 0, stop watching.

        Candidates, scheme, fidelity and memory stay."""
        self.setting = setting
        self.site = setting.site if isinstance(setting.site, Site) else None
        self.weights = setting.weights
        self.most_price = setting.most_price
        self.keep = setting.keep
        self.link_share = setting.link_share
        self._scored_count = 0
        self.watch: Observer | None = None

    @classmethod
    def from_view(
        cls,
        preparation: Preparation,
        candidates: Candidates,
        visibility: Visibility,
        weights: Weights,
    ) -> "Objective":
        """Objective of other candidates with known visibility, in a preparation's traffic.

        Nothing is rendered again. Questions asked of sets (the setting) and how they are computed
        (the run: frames, seed, processes) are the preparation's, except for candidates and weights.

        visibility: points and objects that these candidates see in that traffic."""
        # what estimates or measures the AP of sets
        fidelity = preparation.build_fidelity(candidates, visibility)
        setting = preparation.setting.with_candidates(
            candidates, fidelity=fidelity, weights=weights
        )
        return cls(setting, preparation.run, visibility=visibility)

    def __repr__(self) -> str:
        """One line with site, candidates and conditions; limits that do not apply are left out."""
        site_text = "" if self.site is None else f"{self.site.name!r}, "
        summary = (
            f"{site_text}{len(self.candidates)} candidates, scheme={self.scheme.name!r}, "
            f"fidelity={self.fidelity!r}"
        )
        classes = ", ".join(self.classes.names)
        iou = iou_text(self.setting.cases.threshold)
        limits = "" if math.isinf(self.most_price) else f", most_price={self.most_price:g}"
        limits += f", keep={self.keep}" if self.keep else ""
        frames = ""
        if self.preparation is not None:
            frames = f", frames={self.preparation.frames}, seed={self.run.seed}"
        weights = f"comm={self.weights.comm:g}, price={self.weights.price:g}"
        return f"Objective({summary}, classes={classes!r}, iou={iou}, {weights}{limits}{frames})"

    def __getstate__(self) -> dict[str, object]:
        # for pickling and copying; a watcher may be a function that cannot be pickled
        return {**self.__dict__, "_memory": copy(self._memory), "watch": None}

    def with_weights(self, weights: Weights, *, most_price: float | None = None) -> "Objective":
        """Copy of the objective with other weights, and a copy of its memory of scored sets.

        most_price: new limit of the price, None for the present one."""
        objective = copy(self)
        max_price = self.most_price if most_price is None else most_price
        objective._apply_setting(self.setting.with_costs(weights, max_price))
        objective._memory = self._memory.fork()
        return objective

    def forget(self) -> None:
        """Empty the memory of scored sets."""
        self._memory.forget()

    @property
    def fidelity(self) -> str:
        """Name of the fidelity, such as "surrogate"."""
        return self.scored_by.name

    @property
    def provenance(self) -> dict[str, Any]:
        """Origin of the scores, by name: everything that they depend on, for files of results.

        Only facts that apply have an entry; values need not be JSON (`describe_origin`)."""
        preparation = self.preparation
        cases = self.setting.cases
        detector = getattr(self.scored_by, "detector", None)  # most fidelities have no detector
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
        """Provenance of a set's score as JSON values, with the names of its sensors.

        members: indices of the set's candidates."""
        origin = self.provenance | {"sensors": [self.names[member] for member in members]}
        return cast(dict[str, Any], json.loads(json.dumps(replace_infinite(origin), default=str)))

    @cached_property
    def sent(self) -> Float64[np.ndarray, " candidates"]:
        """Data (kbit) that each candidate sends in a frame, averaged over the frames."""
        if self.visibility is None or not self.scheme.sends_points:
            single_candidates = np.eye(len(self.candidates), dtype=np.bool_)
            return self.scores(single_candidates).kbit
        # number of points that each candidate sends, averaged over the frames
        points = self.scheme.sent_points(self.visibility).mean(axis=1, dtype=np.float64)
        return np.asarray(self.codec.bits(points=points) / 1000)

    @cached_property
    def loads(self) -> Float64[np.ndarray, " candidates"]:
        """Load (kbit per frame) of each candidate on the link of its mount.

        It is the amount that the candidate's data do not exceed in a share of the frames, the
        setting's `link_share`. If the data in single frames are unknown, it is their mean."""
        if self.visibility is None or not self.scheme.sends_points:
            return self.sent
        frame_kbit = sent_per_frame(self.visibility, self.scheme, self.codec)
        return sent_in_most(frame_kbit, self.setting.link_share)

    def score(self, subset: Members) -> Score:
        """Score of one set, given as indices or names of candidates.

        Raises ValueError for an unknown candidate."""
        # mask of the candidates
        row = self.row(subset)
        scores = self.scores(row[None])  # arrays with one figure
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
                # 0 - x is 0 for no cost, and -x would be -0.0
                "comm": 0 - self.weights.comm * float(scores.kbit_per_sensor[0]),
                "price": 0 - self.weights.price * float(scores.price[0]),
            },
            fidelity=self.fidelity,
            cache_hit=bool(scores.cache_hit[0]),
            class_ap=dict(zip(self.classes.names, class_ap, strict=True)),
        )

    def class_ap(self, subsets: Sets) -> Float64[np.ndarray, "n k"]:
        """AP of each of k classes for each of n sets, NaN for a class without objects.

        Columns are in the order of `classes`."""
        return self._figures(subsets).class_ap

    def scores(self, subsets: Sets) -> Scores:
        """Scores of n sets, feasible or not, in their order.

        A set in memory is not scored again, and the empty set has AP and reward 0."""
        figures = self._figures(subsets)
        weighed = self._weigh(subsets, figures.ap, figures.kbit)
        return Scores(
            ap=figures.ap,
            recall=figures.recall,
            kbit_per_sensor=weighed.kbit_per_sensor,
            kbit=figures.kbit,
            price=weighed.price,
            reward=weighed.reward,
            cache_hit=figures.cache_hit,
        )

    def race(
        self, subsets: Sets, *, keep: int = 1, first: int = 8, eta: int = 3, seed: int = 0
    ) -> Race:
        """Find the sets with the greatest reward while most sets are scored on few frames only.

        Args:
            subsets: Sets as rows of booleans.
            keep: Number of best sets.
            first: Number of frames on which all sets are scored first.
            eta: Factor by which frames then grow and sets shrink (`racing.race`).
            seed: Seed of the random order of the frames.

        Raises ValueError if the fidelity cannot score single frames."""
        scored_by = self.scored_by
        if not isinstance(scored_by, ByFrames):
            raise ValueError(
                f"fidelity {self.fidelity} scores all frames at once, which is quick: take scores()"
            )

        def rewards(sets: Sets, frames: Int64[np.ndarray, " k"]) -> Float64[np.ndarray, " n"]:
            """Rewards of sets, estimated from some of the frames (indices)."""
            estimate = scored_by.partial(sets, frames.tolist())
            self._report_scored(len(sets))
            return self._weigh(sets, estimate.ap, estimate.kbit).reward

        return race(rewards, subsets, scored_by.frames, keep=keep, first=first, eta=eta, seed=seed)

    def _weigh(
        self, subsets: Sets, ap: Float64[np.ndarray, " n"], kbit: Float64[np.ndarray, " n"]
    ) -> "_Weighed":
        """Costs and reward of each set, from its AP and the data of its sensors.

        kbit: data of all the set's sensors per frame."""
        sensor_count = np.maximum(subsets.sum(axis=1), 1)  # 1 for the empty set, which sends 0
        kbit_per_sensor = kbit / sensor_count
        price = self.price(subsets)
        reward = ap - self.weights.comm * kbit_per_sensor - self.weights.price * price
        return _Weighed(kbit_per_sensor=kbit_per_sensor, price=price, reward=reward)

    def _figures(self, subsets: Sets) -> SetFigures:
        """Figures of sets in their order, from memory or scored now."""
        figures = self._memory.figures(subsets)
        if figures.scored:
            self._report_scored(figures.scored)
        return figures

    def _report_scored(self, new_sets: int) -> None:
        """Add newly scored sets to the count, and report it as progress if the run asks for it."""
        self._scored_count += new_sets
        if self.run.progress:
            self.run.progress("sets scored", self._scored_count, None)
