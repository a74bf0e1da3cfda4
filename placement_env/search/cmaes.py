"""Continuous sensor poses, optimised by CMA-ES (Hansen and Ostermeier 2001, `cma`).

A vector holds for each sensor: height in the range of its mount (0 to 1), heading (half turns from
its first direction, unbounded) and tilt in `TILT_RANGE_RAD` (0 to 1). Every vector is rendered: in
panoramas of the mounts if the preparation makes them (`Preparation.live`), otherwise by rays. That
is affordable for a few hundred vectors, so the start should be good. Panoramas nearly always agree
with rays within 3 % or 8 points of an object.
"""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from placement_env.candidates.candidates import Candidates, aim_sensor, aims
from placement_env.fidelity.panorama import TrafficView
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.objective import Objective, Score
from placement_env.search import greedy
from placement_env.search.checkpoint import Checkpoint, KeptState
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.progress import Limits
from placement_env.search.result import Certificate, Result, load_score
from placement_env.setting import Weights
from toolkit.arrays import Float64
from toolkit.display import describe_count
from toolkit.sensors.sensor import Sensor

TILT_RANGE_RAD = (float(np.deg2rad(-5.0)), float(np.deg2rad(60.0)))  # rad below the horizon
DEFAULT_VECTORS = 300  # scored without a limit
INITIAL_SPREAD = 0.15  # standard deviation of the first vectors around the start
INFEASIBLE_COST = 1e6  # cost of a set that may not be built
Poses = tuple[Sensor, ...]
# scores sets of sensors, None for a set that may not be built
PoseScorer = Callable[[Sequence[Poses]], Sequence[Score | None]]
NO_COSTS = Weights()


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Greedy's set with turned, tilted and lifted sensors.

    `Result.best` names the candidates that the sensors come from. The limit of scored sets holds
    for the moved sets, seconds for greedy and moving together; checkpoint: keeps the costs of all
    steps. If no sensor pays, the empty set is the answer.
    Poses seen in panoramas are scored by rays in the end; the answer is the start if that is
    better. Raises ValueError for an objective without a site, and for several IoU thresholds,
    failures or levels of traffic.
    """
    preparation = objective.preparation
    if preparation is None:
        raise ValueError(
            "CMA-ES moves sensors, so it needs an objective made from a site: Objective(site)"
        )
    if not objective.setting.cases.is_one_case:
        raise ValueError(
            "CMA-ES knows one IoU threshold and no failures: pass --method portfolio or swap"
        )
    began = time.monotonic()
    initial = greedy.search(objective, budget, seconds=seconds)
    if not initial.best.subset:
        return initial
    start = objective.candidates.select(initial.best.subset)
    live = None if objective.fidelity == "detector" else preparation.live
    remaining_s = None if seconds is None else max(1e-3, seconds - (time.monotonic() - began))
    score_poses = build_pose_scorer(preparation, objective.weights, live=live)
    result = improve(
        score_poses,
        start,
        seed=seed,
        seconds=remaining_s,
        evaluations=evaluations,
        checkpoint=checkpoint,
    )
    if live is not None and result.sensors:
        score_by_rays = build_pose_scorer(preparation, objective.weights)
        result = settle_by_rays(score_by_rays, start, result)
    best = replace(result.best, subset=initial.best.subset)
    certificate = replace(result.certificate, value=best.reward)
    origin = objective.describe_origin(()) | {
        "sensors": [sensor.name for sensor in result.sensors or start.sensors]
    }
    return replace(
        result, best=best, certificate=certificate, seconds=time.monotonic() - began, origin=origin
    )


def settle_by_rays(score_poses: PoseScorer, start: Candidates, result: Result) -> Result:
    """Result with the moved sensors or with the start's, whichever the exact score prefers.

    Args:
        score_poses: Exact scorer, by rays; None is its score of a set that may not be built.
        start: Sensors before they were moved.
        result: Result with the moved sensors, scored in panoramas. If neither set may be built, the
            start's sensors come back with this score."""
    start_score, moved_score = score_poses([start.sensors, result.sensors])
    if moved_score is None or (
        start_score is not None and start_score.reward >= moved_score.reward
    ):
        return replace(result, sensors=start.sensors, best=start_score or result.best)
    return replace(result, best=moved_score)


def improve(
    score_poses: PoseScorer,
    start: Candidates,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Turn, tilt and lift the sensors of `start` to raise their score.

    The answer is never worse than the start, which is scored first. When the search has settled, it
    restarts at the best with twice the population. `Result.best.subset` only counts the sensors.

    Args:
        score_poses: Scorer of sets of sensors in any poses.
        start: Sensors to move, on mounts with a place for each.
        seed: Seed of the drawn vectors.
        seconds: Limit of the search, None for none.
        evaluations: Limit on scored sets; None for none, or `DEFAULT_VECTORS` without `seconds`.
        checkpoint: Keeps the costs of all steps.

    Raises ValueError without a sensor, if a mount has more sensors than places or if the start may
    not be built, and ImportError without `cma`.
    """
    _check_start(start)
    cma = _load_cma()
    has_limit = seconds is not None or evaluations is not None
    limits = Limits(seconds, evaluations if has_limit else DEFAULT_VECTORS)
    rng = np.random.default_rng(seed)
    coding = Coding(start)
    climb = _Climb(score_poses, coding, start.sensors, limits, checkpoint)
    # `cma` draws from this generator instead of the global one
    generator_options = {
        "seed": np.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
        "verbose": -9,
    }
    # vectors in a step; the usual number for this many dimensions
    population = 4 + int(3 * np.log(len(climb.vector)))
    while climb.continues:
        options = {**coding.options(), **generator_options, "popsize": population}
        strategy = cma.CMAEvolutionStrategy(climb.vector, INITIAL_SPREAD, options)
        while not strategy.stop() and climb.continues:
            climb.step(strategy)
        population *= 2
    score = replace(climb.score, subset=tuple(range(len(climb.sensors))))
    certificate = Certificate(
        "none", score.reward, note="CMA-ES proves nothing; the answer is no worse than its start"
    )
    history = limits.history(score.reward)
    return Result(
        method="CMA-ES",
        best=score,
        history=history,
        certificate=certificate,
        evaluations=limits.count,
        seconds=limits.elapsed,
        sensors=climb.sensors,
    )


def _check_start(start: Candidates) -> None:
    """Raise ValueError without a sensor, or if a mount has more sensors than places."""
    if not len(start):
        raise ValueError("CMA-ES has no sensor to move: start from a set with at least one")
    mount_counts = np.bincount(start.mount, minlength=len(start.mounts))
    overfull_mounts = np.flatnonzero(mount_counts > start.places)  # indices of mounts
    if len(overfull_mounts):
        mount = start.mounts[overfull_mounts[0]]
        count = int(mount_counts[overfull_mounts[0]])
        raise ValueError(
            f"mount {mount.name} has {describe_count(count, 'sensor')} but max_sensors "
            f"{mount.max_sensors}: leave {count - mount.max_sensors} out of the start, or raise "
            "max_sensors"
        )


class _Climb:
    """Best set of poses so far, and the costs of all steps.

    An interrupted climb resumes from the costs in its checkpoint. These are passed to the strategy
    again, so it comes back to where it was without scoring.

    Attributes:
        vector: Coded poses of the best set.
        sensors: The best set.
        score: Its score.
        reward: Its reward."""

    def __init__(
        self,
        score_poses: PoseScorer,
        coding: "Coding",
        sensors: Poses,
        limits: Limits,
        checkpoint: Checkpoint,
    ) -> None:
        """Score the sensors at the start, which counts as the first scored set.

        Args:
            score_poses: Scorer of sets of sensors in any poses.
            coding: Conversion between sensors and vectors.
            sensors: Sensors at the start.
            limits: Limits and history, changed in place.
            checkpoint: Checkpoint that may hold an interrupted climb.

        Raises ValueError if the sensors may not be built."""
        (score,) = score_poses([sensors])
        if score is None:
            raise ValueError("the sensors to start from may not be built: choose a feasible set")
        limits.count += 1
        limits.record(score.reward)
        self.vector = coding.encode()
        self.sensors = sensors
        self.score = score
        self.reward = score.reward
        self._score_poses = score_poses
        self._coding = coding
        self._limits = limits
        self._checkpoint = checkpoint
        self._step_costs: list[Float64[np.ndarray, " _"]] = []  # costs of the vectors of each step
        self._saved = checkpoint.load()  # None when all saved steps are repeated
        self._saved_costs: list[np.ndarray] = []  # costs of each step to be repeated
        if self._saved is not None:
            costs, ends = self._saved["costs"], self._saved["ends"]
            self._saved_costs = np.split(costs, ends)[:-1]  # nothing is after the last end

    @property
    def continues(self) -> bool:
        """True while saved costs are left or the limits allow more."""
        return bool(self._saved_costs) or not self._limits.spent

    def step(self, strategy: Any) -> None:
        """Score the vectors that the strategy asks for, and keep the best.

        A step that the checkpoint holds takes its costs from there and scores nothing; after the
        last such step, `_save_or_resume` restores the score of the best set.

        strategy: a `cma.CMAEvolutionStrategy`, which then gets the costs of its vectors."""
        # asked even if costs are saved: the strategy must draw the same random numbers
        vectors = strategy.ask()
        sets = [self._coding.decode(vector) for vector in vectors]
        if self._saved_costs:
            costs = self._saved_costs.pop(0).tolist()
            scores: Sequence[Score | None] = [None] * len(costs)  # unknown, only the costs are kept
        else:
            # sets that may still be scored, of `evaluations` in all
            scorable = int(min(len(vectors), self._limits.evaluations - self._limits.count))
            scores = self._score_poses(sets[:scorable])
            self._limits.count += scorable
            costs = [INFEASIBLE_COST if score is None else -score.reward for score in scores]
        best_index = int(np.argmin(costs))
        if -costs[best_index] > self.reward:
            self.reward = -costs[best_index]
            self.sensors = sets[best_index]
            self.vector = vectors[best_index]
            self.score = scores[best_index] or self.score  # unknown while saved steps are repeated
            self._limits.record(self.reward)
        if len(costs) == len(vectors):  # fewer if the limit ended the step
            strategy.tell(vectors, costs)
        self._step_costs.append(np.array(costs))
        self._save_or_resume()

    def _save_or_resume(self) -> None:
        """Offer a state to the checkpoint, or resume limits and score after the last saved step.

        While saved steps are still to be repeated, nothing happens."""
        if self._saved is None:
            self._checkpoint.offer(self._state)
        elif not self._saved_costs:  # back at the interruption
            self._limits.resume(self._saved["limits"])
            self.score = load_score(self._saved["score"])
            self._saved = None

    def _state(self) -> KeptState:
        """Values for a checkpoint: costs of all steps, and the index at which each step ends."""
        costs = np.concatenate([*self._step_costs, np.zeros(0)])  # `zeros`: without any step
        ends = np.cumsum([len(step_costs) for step_costs in self._step_costs]).tolist()
        return {
            "limits": self._limits.state(),
            "score": asdict(self.score),
            "costs": costs,
            "ends": ends,
        }


def build_pose_scorer(
    preparation: Preparation, weights: Weights = NO_COSTS, *, live: TrafficView | None = None
) -> PoseScorer:
    """Function that scores sets of sensors in any poses by the preparation's fidelity.

    It returns a score for each set, None for a set that may not be built. All sensors of a call are
    measured together.

    weights: costs in the reward; live: panoramas to measure from, None to cast rays.
    """
    quiet_run = replace(preparation.run, cache=None, progress=None)

    def score_poses(sets: Sequence[Poses]) -> list[Score | None]:
        """Score of each set, None for a set that may not be built.

        The sensors of all sets become the candidates of one objective, set after set."""
        sensors = [sensor for poses in sets for sensor in poses]
        candidates = as_candidates(sensors, preparation.setting.pool)
        if live is not None:
            seen = live.see(candidates)
        else:
            seen = see(
                preparation.traffic,
                candidates,
                labels=preparation.setting.counted.labels,
                run=quiet_run,
            )
        objective = Objective.from_view(preparation, candidates, visibility=seen, weights=weights)
        set_of_sensor = np.repeat(np.arange(len(sets)), [len(poses) for poses in sets])
        subsets = set_of_sensor == np.arange(len(sets))[:, None]  # sets × candidates
        objective.scores(subsets)  # all sets in one batch; `score` below finds them kept
        rows = zip(subsets, objective.feasible(subsets), strict=True)
        return [
            objective.score(np.flatnonzero(row).tolist()) if fits else None for row, fits in rows
        ]

    return score_poses


def as_candidates(sensors: Sequence[Sensor], pool: Candidates) -> Candidates:
    """Candidates made from any sensors, each on the mount whose foot is nearest in the plane.

    The index of a sensor precedes its name, because names of candidates must differ.

    pool: candidates whose mounts are taken."""
    feet = np.array([mount.position[:2] for mount in pool.mounts])  # x, y (m)
    spots = np.array([sensor.position[:2] for sensor in sensors])
    distances = np.linalg.norm(spots[:, None] - feet, axis=2)  # sensors × mounts
    mount = distances.argmin(axis=1)  # index of the mount of each sensor
    numbered = [replace(sensor, name=f"{i}_{sensor.name}") for i, sensor in enumerate(sensors)]
    heights_and_angles = np.array([angles(sensor) for sensor in sensors])
    return Candidates.from_poses(numbered, mount, heights_and_angles, pool)


class SensorAngles(NamedTuple):
    """Height and direction of a sensor.

    Attributes:
        height: Height above z = 0 (m).
        heading: Heading from +x (rad).
        tilt: Tilt below the horizon (rad).
    """

    height: float
    heading: float
    tilt: float


def angles(sensor: Sensor) -> SensorAngles:
    """Height above z = 0, heading and tilt of a sensor."""
    (heading,), (tilt,) = aims([sensor])
    return SensorAngles(float(sensor.position[2]), float(heading), float(tilt))


class Coding:
    """Conversion of sets of sensors to vectors and back. Each sensor keeps its model and mount.

    A vector has three numbers for each sensor: lift, 0 to 1 in the range of heights of its mount;
    turn, in half turns from its first heading; tilt, 0 to 1 in `TILT_RANGE_RAD`.

    Attributes:
        start: Sensors before they are moved.
        feet: Foot of each mount (m), with the columns x, y, z.
        heights: Lowest and highest place of a sensor above the foot of each mount (m).
    """

    def __init__(self, start: Candidates) -> None:
        self.start = start
        self.feet = np.array([mount.position for mount in start.mounts])
        self.heights = np.array([[mount.min_height, mount.max_height] for mount in start.mounts])

    def encode(self) -> Float64[np.ndarray, " n"]:
        """Vector of the start: lift, turn and tilt of each sensor, clipped to 0 to 1.

        Lift and tilt are places in their ranges, 0 at the least height or tilt and 1 at the
        greatest. Turns are 0, as they count from the headings of the start, in half turns."""
        foot_z = self.feet[self.start.mount][:, 2]
        low, high = self.heights[self.start.mount].T  # above the foot (m), for each sensor
        poses = [angles(sensor) for sensor in self.start.sensors]
        height = np.array([pose.height for pose in poses])
        tilt_rad = np.array([pose.tilt for pose in poses])
        min_tilt_rad, max_tilt_rad = TILT_RANGE_RAD
        # 1e-9: no division by 0 for a mount with a single height
        lift = (height - foot_z - low) / np.maximum(high - low, 1e-9)
        turn = np.zeros(len(lift))
        tilt = (tilt_rad - min_tilt_rad) / (max_tilt_rad - min_tilt_rad)
        return np.clip(np.stack([lift, turn, tilt], axis=1), 0.0, 1.0).ravel()

    def decode(self, vector: Float64[np.ndarray, " n"]) -> Poses:
        """Sensors in the poses of a vector, in the order of the start.

        vector: lift and tilt as parts of their ranges, and turn in half turns from the start's
        heading, sensor after sensor."""
        sensors = []
        rows = vector.reshape(len(self.start), -1)  # lift, turn and tilt of each sensor
        min_tilt_rad, max_tilt_rad = TILT_RANGE_RAD
        for n, sensor in enumerate(self.start.sensors):
            mount = self.start.mount[n]  # index
            lift, turn, tilt = rows[n]
            low, high = self.heights[mount]
            height = low + lift * (high - low)  # above the foot
            position = self.feet[mount] + [0.0, 0.0, height]
            heading = float(angles(sensor).heading + np.pi * turn)
            tilt_rad = float(min_tilt_rad + tilt * (max_tilt_rad - min_tilt_rad))
            sensors.append(aim_sensor(sensor, position, heading, tilt=tilt_rad))
        return tuple(sensors)

    def options(self) -> dict[str, object]:
        """Options of `cma`: lower and upper bounds of all values, none for headings."""
        # lift, turn and tilt of each sensor: lower bounds, then upper ones
        return {"bounds": [[end, None, end] * len(self.start) for end in (0.0, 1.0)]}


def _load_cma() -> ModuleType:
    """Import the package `cma` without its warnings. Raises ImportError if it is missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warning about a missing plotting library
            import cma
    except ImportError as error:
        raise ImportError("CMA-ES needs the package cma: pip install coview[search]") from error
    return cma
