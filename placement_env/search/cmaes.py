"""Continuous sensor poses, optimised by CMA-ES (Hansen and Ostermeier 2001, `cma`).

A vector has for each sensor: height in the range of its mount (0 to 1), heading (half turns from
its first direction, without bounds), tilt between `TILT_RANGE` (0 to 1) and, where sensors may
roam, x and y in the rectangle of all mounts (0 to 1 each), which mean the nearest mount where
earlier sensors have left a place. Every vector is rendered: in panoramas of the mounts where the
preparation makes these (`Preparation.live`), else by rays, which is affordable for a few hundred
vectors. So the start should be good. Panoramas nearly always agree with rays within 3 % or 8 points
of an object."""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from types import ModuleType

import numpy as np

from placement_env.candidates.candidates import Candidates, aim_sensor, aims
from placement_env.fidelity.panorama import LiveView
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.objective import Objective, Score
from placement_env.search import greedy
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.progress import Limits
from placement_env.search.result import Certificate, Result, load_score
from placement_env.setting import Weights
from toolkit.arrays import Float64
from toolkit.sensors.sensor import Sensor

TILT_RANGE = (float(np.deg2rad(-5.0)), float(np.deg2rad(60.0)))  # rad below the horizon
VECTORS = 300  # vectors scored by default
STEP = 0.15  # standard deviation of the first vectors around the start
INFEASIBLE_COST = 1e6  # cost of a set that may not be built
Poses = tuple[Sensor, ...]
# scores sets of sensors; None: may not be built
PoseScorer = Callable[[Sequence[Poses]], Sequence[Score | None]]
FREE = Weights()


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Greedy's set with turned, tilted and lifted sensors; `Result.best` names the candidates they
    come from.

    The limits hold for the moved sets, seconds for both stages; checkpoint: see `improve`. If no
    sensor pays, that is the answer. Poses seen in panoramas are scored by rays in the end; the
    answer is the start where that is better. Raises ValueError for an objective without a site, and
    for several IoU thresholds, failures or levels of traffic."""
    made = objective.preparation
    if made is None:
        raise ValueError(
            "CMA-ES moves sensors, so it needs an objective made from a site: Objective(site)"
        )
    if not objective.setting.cases.plain:
        raise ValueError(
            "CMA-ES knows one IoU threshold and no failures: say --method portfolio or swap"
        )
    began = time.monotonic()
    first = greedy.search(objective, budget, seconds=seconds)
    if not first.best.subset:
        return first
    start = objective.candidates.select(first.best.subset)
    live = None if objective.fidelity == "detector" else made.live
    left = None if seconds is None else max(1e-3, seconds - (time.monotonic() - began))
    score_poses = build_pose_scorer(made, objective.weights, live=live)
    result = improve(
        score_poses, start, seed=seed, seconds=left, evaluations=evaluations, checkpoint=checkpoint
    )
    if live is not None and result.sensors:
        result = settle_by_rays(build_pose_scorer(made, objective.weights), start, result)
    best = replace(result.best, subset=first.best.subset)
    certificate = replace(result.certificate, value=best.reward)
    origin = objective.describe_origin(()) | {
        "sensors": [sensor.name for sensor in result.sensors or start.sensors]
    }
    return replace(
        result, best=best, certificate=certificate, seconds=time.monotonic() - began, origin=origin
    )


def settle_by_rays(score_poses: PoseScorer, start: Candidates, result: Result) -> Result:
    """Better of a result and its start, scored exactly."""
    before, after = score_poses([start.sensors, result.sensors])
    if after is None or (before is not None and before.reward >= after.reward):
        result = replace(result, sensors=start.sensors)
        after = before
    return replace(result, best=after or result.best)


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

    start: on separate mounts; checkpoint: where the costs of all steps are kept; without a limit
    300 vectors are scored. The answer is never worse than the start, which is scored first. When
    the search has settled it restarts at the best with twice the population. `Result.best.subset`
    just counts the sensors. Raises ValueError without a sensor, where two share a mount or where
    the start may not be built, and ImportError without `cma`."""
    if (
        not len(start)
        or (np.bincount(start.mount, minlength=len(start.mounts)) > start.places).any()
    ):
        mounts = np.unique(start.mount).size
        raise ValueError(
            f"need sensors on mounts of their own, got {len(start)} on {mounts} mounts"
        )
    cma = _cma()
    limits = Limits(seconds, VECTORS if seconds is None and evaluations is None else evaluations)
    rng = np.random.default_rng(seed)
    coding = Coding(start)
    sensors = start.sensors
    (first_score,) = score_poses([sensors])
    if first_score is None:
        raise ValueError("the sensors to start from may not be built: choose a feasible set")
    score = first_score
    limits.count += 1
    limits.record(score.reward)
    best = coding.encode()
    reward = score.reward
    size = 4 + int(3 * np.log(len(best)))
    # our own generator
    quiet = {"seed": np.nan, "randn": lambda *shape: rng.standard_normal(shape), "verbose": -9}
    kept = checkpoint.load()
    known = [] if kept is None else np.split(kept["costs"], kept["ends"])[:-1]
    steps_costs: list[Float64[np.ndarray, " _"]] = []

    def state() -> KeptState:
        costs = np.concatenate([*steps_costs, np.zeros(0)])
        ends = np.cumsum([len(each) for each in steps_costs]).tolist()
        return {"limits": limits.state(), "score": asdict(score), "costs": costs, "ends": ends}

    while known or not limits.spent:
        strategy = cma.CMAEvolutionStrategy(
            best, STEP, {**coding.options(), **quiet, "popsize": size}
        )
        while not strategy.stop() and (known or not limits.spent):
            vectors = strategy.ask()
            sets = [coding.decode(vector) for vector in vectors]
            if known:
                costs = known.pop(0).tolist()
                scores: Sequence[Score | None] = [None] * len(costs)
            else:
                room = int(min(len(vectors), limits.evaluations - limits.count))
                scores = score_poses(sets[:room])
                limits.count += room
                costs = [INFEASIBLE_COST if s is None else -s.reward for s in scores]
            first = int(np.argmin(costs))
            if -costs[first] > reward:
                reward = -costs[first]
                sensors = sets[first]
                best = vectors[first]
                score = scores[first] or score
                limits.record(reward)
            if len(costs) == len(vectors):
                strategy.tell(vectors, costs)
            steps_costs.append(np.array(costs))
            if kept is None:
                checkpoint.offer(state)
            elif not known:  # back where it was killed
                limits.resume(kept["limits"])
                score = load_score(kept["score"])
                kept = None
        size *= 2
    score = replace(score, subset=tuple(range(len(sensors))))
    certificate = Certificate(
        "none", score.reward, note="CMA-ES proves nothing; the answer is no worse than its start"
    )
    history = limits.history(score.reward)
    return Result(
        "CMA-ES", score, history, certificate, limits.count, limits.elapsed, sensors=sensors
    )


def build_pose_scorer(
    preparation: Preparation, weights: Weights = FREE, *, live: LiveView | None = None
) -> PoseScorer:
    """Scorer of sets by the preparation's fidelity, None for sets that do not fit. live: panoramas,
    None for rays."""
    quiet = replace(preparation.run, cache=None, progress=None)

    def score_poses(sets: Sequence[Poses]) -> list[Score | None]:
        candidates = as_candidates(
            [sensor for chosen in sets for sensor in chosen], preparation.setting.pool
        )
        if live is not None:
            seen = live.see(candidates)
        else:
            seen = see(
                preparation.traffic,
                candidates,
                labels=preparation.setting.counted.labels,
                run=quiet,
            )
        objective = Objective.of_moved(preparation, candidates, seen, weights)
        subsets = (
            np.repeat(np.arange(len(sets)), [len(chosen) for chosen in sets])
            == np.arange(len(sets))[:, None]
        )
        objective.scores(subsets)
        rows = zip(subsets, objective.feasible(subsets), strict=True)
        return [
            objective.score(np.flatnonzero(row).tolist()) if fits else None for row, fits in rows
        ]

    return score_poses


def as_candidates(sensors: Sequence[Sensor], pool: Candidates) -> Candidates:
    """Any sensors as candidates on the mounts whose feet are nearest, seen from above, with a
    number in their names."""
    feet = np.array([mount.position[:2] for mount in pool.mounts])
    spots = np.array([sensor.position[:2] for sensor in sensors])
    mount = np.linalg.norm(spots[:, None] - feet, axis=2).argmin(axis=1)
    numbered = [replace(sensor, name=f"{i}_{sensor.name}") for i, sensor in enumerate(sensors)]
    return Candidates.of_poses(
        numbered, mount, np.array([angles(sensor) for sensor in sensors]), pool
    )


def angles(sensor: Sensor) -> tuple[float, float, float]:
    """Height above zero (m), heading and tilt below the horizon (rad) of a sensor."""
    (heading,), (tilt,) = aims([sensor])
    return float(sensor.position[2]), float(heading), float(tilt)


class Coding:
    """Convert sets of sensors to vectors and back. Each sensor keeps its model and mount."""

    def __init__(self, start: Candidates) -> None:
        self.start = start
        self.feet = np.array([mount.position for mount in start.mounts])
        self.heights = np.array([[mount.min_height, mount.max_height] for mount in start.mounts])

    def encode(self) -> Float64[np.ndarray, " n"]:
        """The vector of the start."""
        feet, (low, high) = self.feet[self.start.mount], self.heights[self.start.mount].T
        height, _, tilt = np.array([angles(sensor) for sensor in self.start.sensors]).T
        lift = (height - feet[:, 2] - low) / np.maximum(high - low, 1e-9)
        columns = [
            lift,
            np.zeros(len(lift)),
            (tilt - TILT_RANGE[0]) / (TILT_RANGE[1] - TILT_RANGE[0]),
        ]
        return np.clip(np.stack(columns, axis=1), 0.0, 1.0).ravel()

    def decode(self, vector: Float64[np.ndarray, " n"]) -> Poses:
        """The sensors of a vector."""
        sensors = []
        rows = vector.reshape(len(self.start), -1)
        for sensor, mount, (lift, turn, tilt) in zip(
            self.start.sensors, self.start.mount, rows, strict=True
        ):
            low, high = self.heights[mount]
            position = self.feet[mount] + [0.0, 0.0, low + lift * (high - low)]
            heading = float(angles(sensor)[1] + np.pi * turn)
            down = float(TILT_RANGE[0] + tilt * (TILT_RANGE[1] - TILT_RANGE[0]))
            sensors.append(aim_sensor(sensor, position, heading, down))
        return tuple(sensors)

    def options(self) -> dict[str, object]:
        """Bounds as `cma` takes them. All values but the headings are bounded."""
        return {"bounds": [[end, None, end] * len(self.start) for end in (0.0, 1.0)]}


def _cma() -> ModuleType:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warning about a missing plotting library
            import cma
    except ImportError as error:
        raise ImportError("CMA-ES needs the package cma: pip install coview[search]") from error
    return cma
