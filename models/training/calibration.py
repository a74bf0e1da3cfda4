"""Calibration: scores that say which share of the detections of that score are true, and the threshold above which
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

PRECISION = 0.95  # of the detections above the threshold that is chosen
FEWEST = 30  # detections, below which a class is left as it is and no precision is believed
LOWEST = 0.05  # score of detections that are looked at
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
    holds for no `FEWEST` or more, the score above which that many are left.

    >>> lowest_threshold(np.linspace(0.01, 1, 100), np.arange(100) >= 20, 1.0)
    0.2
    """
    order = np.argsort(-scores, kind="stable")
    share = np.cumsum(hits[order]) / np.arange(1, len(order) + 1)
    good = np.flatnonzero((share >= precision) & (np.arange(1, len(order) + 1) >= FEWEST))
    first_out = good[-1] + 1 if len(good) else min(FEWEST, len(order))
    return float(scores[order][first_out]) if first_out < len(order) else 0.0


def calibrated_on(network: VoxelNet, frames: PackedFrames, *, count: int | None = None, seed: int = 0) -> VoxelNet:
    """The network with a calibration per class and the lowest threshold above which 0.95 of the detections of all
    classes are true, over the first `count` frames (None: all) of a file it was not trained on."""
    bare = rebuilt(network, calibration=(), score_threshold=LOWEST)
    labels = network.config.labels
    rows, hits = _judged(bare, frames, count, seed)
    pairs = [platt(rows[k], hits[k]) if len(rows[k]) >= FEWEST else (1.0, 0.0) for k in range(len(labels))]
    sure = [sigmoid(slope * logit(score) + shift) for (slope, shift), score in zip(pairs, rows, strict=True)]
    threshold = max(LOWEST, lowest_threshold(np.concatenate(sure), np.concatenate(hits), PRECISION))
    return rebuilt(network, calibration=tuple(pairs), score_threshold=round(threshold, 3))


def _judged(
    network: VoxelNet, frames: PackedFrames, count: int | None, seed: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Per label the scores of all detections that count, and whether each is true."""
    config: VoxelNetConfig = network.config
    scores: list[list[np.ndarray]] = [[np.zeros(0)] for _ in config.labels]
    hits: list[list[np.ndarray]] = [[np.zeros(0, bool)] for _ in config.labels]
    for found, truth, counted in detections_of(network, frames, count=count, seed=seed):
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
