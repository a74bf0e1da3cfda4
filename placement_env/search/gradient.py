"""Continuous poses by gradient ascent on a smooth coverage, as Arnold et al. optimise them (arXiv 2106.05308).

    maximise  mean over objects of  1 - exp(-n_o / SCALE),    n_o = Σ_i points that sensor i has on object o

over height, heading and tilt of each sensor of a set. Of several classes the means of each are combined. Points are
counted by rays, with occlusion, so the gradient is of central differences; as points of sensors add up, a difference
takes a look by the one sensor that moved and no other. Steps are those of Adam (Kingma and Ba 2015), within bounds.
Where steps gain no more, the ascent begins anew from the best vector, disturbed. Of the poses on the way the best by
the objective is the answer.

The rest of that paper, the best of a pool by integer programming, is `placement_env.search.exact.cpsat` for the
greatest coverage and `placement_env.search.exact.cheapest` for the fewest sensors that cover a share of all objects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.classes import Classes
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.cmaes import Coding, PoseScorer, check_continuous, improved, look_of
from placement_env.search.progress import Limits
from placement_env.search.result import Certificate, Result, score_of
from toolkit.arrays import Float64
from toolkit.sensors.sensor import Sensor

SCALE = LEAST  # points of which an object counts by 63 %
APART = np.array([0.02, 0.02, 0.03])  # by which height, heading and tilt differ to either side, in parts of a vector
LEARNING_RATE = 0.03  # of Adam, in parts of a vector
FORGETTING = (0.8, 0.95)  # by which Adam forgets gradients and their squares
PATIENCE = 12  # steps without a better score, after which it begins anew
DISTURBED = 0.15  # standard deviation of a vector that it begins anew from
ASCENTS = 300  # evaluated where no limit is given

Look = Callable[[Sequence[Sensor]], Visibility]


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Greedy's set, then every sensor of it turned, tilted and lifted uphill.

    `Result.sensors` are the poses and `Result.best` is their score; its subset names the candidates they come from. An
    evaluation is a set scored or a difference taken; checkpoint: where the state of the ascent is kept. Raises
    ValueError for an objective without a site, and one of several IoU thresholds or failures.
    """
    made = check_continuous(objective, "gradient ascent")

    def uphill(score_poses: PoseScorer, start: Candidates, left: float | None) -> Result:
        classes = objective.classes
        return ascend(
            score_poses, look_of(made), start, classes=classes, seed=seed, seconds=left, evaluations=evaluations,
            checkpoint=checkpoint,
        )  # fmt: skip

    return improved(objective, budget, uphill, seconds=seconds)


def ascend(
    score_poses: PoseScorer,
    look: Look,
    start: Candidates,
    *,
    classes: Classes,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Move the sensors of `start`, all of which are placed, uphill; the answer is no worse than the start.

    look: what sensors see; classes: of the objects that count; without a limit `ASCENTS` evaluations are made. Raises
    ValueError where the start may not be built.
    """
    if seconds is None and evaluations is None:
        evaluations = ASCENTS
    limits, rng, coding = Limits(seconds, evaluations), np.random.default_rng(seed), Coding(start, roam=False)
    sensors, best = start.sensors, coding.encode()
    first_score = score_poses([sensors])[0]
    if first_score is None:
        raise ValueError("the sensors to start from may not be built: choose a feasible set")
    score = first_score
    limits.count += 1
    limits.record(score.reward)
    vector, moments, step, idle = best.copy(), np.zeros((2, len(best))), 0, 0
    if (kept := checkpoint.load()) is not None:
        limits.resume(kept["limits"])
        rng.bit_generator.state = kept["rng"]
        vector, best, moments, (step, idle) = kept["vector"], kept["best"], kept["moments"], kept["counts"]
        score, sensors = score_of(kept["score"]), coding.decode(best) if kept["moved"] else sensors

    def state() -> KeptState:
        now = {"limits": limits.state(), "rng": rng.bit_generator.state, "counts": [step, idle]}
        where = {"vector": vector, "best": best, "moments": moments, "moved": sensors is not start.sensors}
        return now | where | {"score": asdict(score)}

    while not limits.spent:
        slope = gradient(look, coding, vector, classes)
        limits.count += 2 * len(vector)
        step += 1
        moments[0] = FORGETTING[0] * moments[0] + (1 - FORGETTING[0]) * slope
        moments[1] = FORGETTING[1] * moments[1] + (1 - FORGETTING[1]) * slope**2
        mean, square = (each / (1 - forgets**step) for each, forgets in zip(moments, FORGETTING, strict=True))
        vector = bounded(vector + LEARNING_RATE * mean / (np.sqrt(square) + 1e-9))
        there = coding.decode(vector)
        found = score_poses([there])[0]
        limits.count += 1
        idle += 1
        if found is not None and found.reward > score.reward:
            score, sensors, best, idle = found, there, vector.copy(), 0
            limits.record(score.reward)
        if idle >= PATIENCE:
            vector = bounded(best + rng.normal(0.0, DISTURBED, len(best)))
            moments, step, idle = np.zeros_like(moments), 0, 0
        checkpoint.offer(state)
    score = replace(score, subset=tuple(range(len(sensors))))
    note = "gradient ascent ends at a local best; the answer is no worse than its start"
    certificate = Certificate("none", score.reward, note=note)
    return Result(
        "gradient", score, limits.history(score.reward), certificate, limits.count, limits.elapsed, sensors=sensors
    )


def gradient(
    look: Look, coding: Coding, vector: Float64[np.ndarray, " n"], classes: Classes
) -> Float64[np.ndarray, " n"]:
    """Of the smooth coverage, by central differences: one look at all sensors, each also moved to either side. A
    difference at a bound is taken within it."""
    width, count = coding.width, len(coding.start)
    steps = np.tile(APART, count)
    sides = [bounded(vector + sign * steps * np.eye(len(vector))) for sign in (1.0, -1.0)]  # row d moves entry d
    moved = [coding.decode(row)[d // width] for side in sides for d, row in enumerate(side)]
    seen = look([*coding.decode(vector), *moved])
    points = seen.points.astype(np.float64)
    own, others = points[:count], points[:count].sum(axis=0)
    owner = np.tile(np.arange(len(vector)) // width, 2)
    values = smooth_coverage(others - own[owner] + points[count:], seen.labels, classes)
    above, below = values[: len(vector)], values[len(vector) :]
    across = np.diagonal(sides[0]) - np.diagonal(sides[1])
    return np.asarray((above - below) / np.maximum(across, 1e-9))


def smooth_coverage(
    points: Float64[np.ndarray, "n O"], labels: np.ndarray, classes: Classes
) -> Float64[np.ndarray, " n"]:
    """The mean over objects, of several classes combined; 0 without an object.

    >>> smooth_coverage(np.array([[0.0, 1e9], [20.0, 20.0]]), np.zeros(2, int), Classes()).round(3)
    array([0.5  , 0.632])
    """
    each = 1 - np.exp(-points / SCALE)
    shares = np.full((len(points), len(classes)), np.nan)
    for k, label in enumerate(classes.labels):
        if (labels == label).any():
            shares[:, k] = each[:, labels == label].mean(axis=1)
    return np.nan_to_num(classes.combined(shares))


def bounded(vectors: Float64[np.ndarray, "*rest n"]) -> Float64[np.ndarray, "*rest n"]:
    """Vectors of height, heading and tilt with heights and tilts in their ranges; headings go round."""
    turns = np.arange(vectors.shape[-1]) % len(APART) == 1
    return np.where(turns, vectors, np.clip(vectors, 0.0, 1.0))
