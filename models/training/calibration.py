"""Calibration: scores that say which share of the detections of that score are true, and thresholds above which
nearly all are."""

from __future__ import annotations

import numpy as np

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet
from models.training.packed import PackedFrames
from models.training.validation import detections_of
from models.training.widening import rebuilt
from toolkit.arrays import Bool, Float
from toolkit.detection.metrics import TRUE_IOU, match
from toolkit.objects import LABELS

PRECISION = 0.97  # of the detections above the threshold that is chosen
MOST_LOST = 0.05  # share of the true detections that a threshold may cost, whatever the precision
FEWEST = 30  # detections, below which a class is left as it is and no precision is believed
LOWEST = 0.05  # score of detections that are looked at
LEAST_SURE = 0.2  # calibrated score below which nothing is reported unless it is asked for
_SUBSETS, _ERRORS = 0.3, 0.3  # shares of the frames that some of the sensors see, and sensors with errors
_RIDGE = 1.0  # pulls the slope to 1 and the intercept to 0, as so many detections would
_STEPS = 50


def platt(scores: Float[np.ndarray, " n"], hits: Bool[np.ndarray, " n"]) -> tuple[float, float]:
    """Slope and intercept that make sigmoid(slope · logit(score) + intercept) the likeliest share of true detections
    (Platt 1999), by Newton's method."""
    x = logit(scores)
    rows = np.stack([x, np.ones_like(x)], axis=1)
    wanted = np.array([1.0, 0.0])
    answer = wanted.copy()
    for _ in range(_STEPS):
        p = sigmoid(rows @ answer)
        slope = rows.T @ (p - hits) + _RIDGE * (answer - wanted)
        curvature = (rows * (p * (1 - p))[:, None]).T @ rows + _RIDGE * np.eye(2)
        answer = answer - np.linalg.solve(curvature, slope)
    return max(float(answer[0]), 0.05), float(answer[1])


def lowest_threshold(scores: Float[np.ndarray, " n"], hits: Bool[np.ndarray, " n"], precision: float) -> float:
    """The lowest score above which such a share of the detections is true, 0 where that holds for all of them. Where it
    holds for no `FEWEST` or more, the score above which that many are left; but none that loses more than `MOST_LOST`
    of the true detections.

    >>> lowest_threshold(np.linspace(0.01, 1, 100), np.arange(100) >= 20, 1.0)
    0.2
    """
    order = np.argsort(-scores, kind="stable")
    share = np.cumsum(hits[order]) / np.arange(1, len(order) + 1)
    good = np.flatnonzero((share >= precision) & (np.arange(1, len(order) + 1) >= FEWEST))
    first_out = good[-1] + 1 if len(good) else min(FEWEST, len(order))
    least = float(scores[order][first_out]) if first_out < len(order) else 0.0
    true = np.sort(scores[hits])
    return min(least, float(np.nextafter(true[int(MOST_LOST * len(true))], 0.0))) if len(true) else least


def calibrated_on(network: VoxelNet, frames: PackedFrames, *, count: int | None = None, seed: int = 0) -> VoxelNet:
    """The network with a calibration and a threshold per class, the lowest above which `PRECISION` of its detections
    are true, over the first `count` frames (None: all) of a file it was not trained on, some of them seen by some of
    the sensors or by sensors with errors."""
    bare = rebuilt(network, calibration=(), thresholds=(), score_threshold=LOWEST)
    scores, hits = _judged(bare, frames, count, seed)
    pairs = [platt(*each) if len(each[0]) >= FEWEST else (1.0, 0.0) for each in zip(scores, hits, strict=True)]
    sure = [sigmoid(slope * logit(score) + shift) for (slope, shift), score in zip(pairs, scores, strict=True)]
    least = [lowest_threshold(score, hit, PRECISION) for score, hit in zip(sure, hits, strict=True)]
    thresholds = tuple(round(max(LEAST_SURE, each), 3) for each in least)
    return rebuilt(bare, calibration=tuple(pairs), thresholds=thresholds)


def _judged(
    network: VoxelNet, frames: PackedFrames, count: int | None, seed: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Per label the scores of all detections that count, and whether each is true."""
    config: VoxelNetConfig = network.config
    scores: list[list[np.ndarray]] = [[np.zeros(0)] for _ in config.labels]
    hits: list[list[np.ndarray]] = [[np.zeros(0, bool)] for _ in config.labels]
    for found, truth, counted in detections_of(
        network, frames, count=count, seed=seed, subsets=_SUBSETS, errors=_ERRORS
    ):
        for k, label in enumerate(config.labels):
            number = LABELS.index(label)
            at = match(found, truth, TRUE_IOU[number], label=number, counted=counted)
            scores[k].append(found.scores[~at.ignored])
            hits[k].append(at.truth[~at.ignored] >= 0)
    return [np.concatenate(each) for each in scores], [np.concatenate(each) for each in hits]


def logit(scores: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Log odds, of scores cut to 1e-6 from 0 and 1 as the detector cuts them."""
    cut = np.clip(scores, 1e-6, 1 - 1e-6)
    return np.log(cut / (1 - cut))


def sigmoid(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The inverse of `logit`."""
    return 1 / (1 + np.exp(-values))
