"""Calibration: scores that say which share of the detections of that score are true, and thresholds above which
nearly all are."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from models.config import VoxelNetConfig
from models.network.rivals import left_of, logit, sigmoid, strongest_rivals
from models.network.voxelnet import VoxelNet
from models.training.packed import PackedFrames
from models.training.validation import detections_of
from models.training.widening import rebuilt
from toolkit.arrays import Bool, Float, Int64
from toolkit.detection.metrics import TRUE_IOU, match
from toolkit.objects import HEAVY, LABELS, VEHICLE, Detections

PRECISION = 0.97  # of the detections above the threshold that is chosen
MOST_LOST = 0.05  # share of the true detections that a threshold may cost, whatever the precision
FEWEST = 30  # detections, below which a class is left as it is and no precision is believed
LOWEST = 0.05  # score of detections that are looked at
LEAST_SURE = 0.2  # calibrated score below which nothing is reported unless it is asked for
TRUE, FALSE, UNCOUNTED = 1, 0, -1  # outcomes of detections
_SUBSETS, _ERRORS = 0.3, 0.3  # shares of the frames that some of the sensors see, and sensors with errors
_RIDGE = 1.0  # pulls the slope to 1 and the intercept to 0, as so many detections would
_LEAST_SLOPE = 0.05


def platt(scores: Float[np.ndarray, " n"], hits: Bool[np.ndarray, " n"]) -> tuple[float, float]:
    """Slope and intercept that make sigmoid(slope · logit(score) + intercept) the likeliest share of true detections
    (Platt 1999)."""
    slope, intercept = with_rivals(scores, np.zeros((len(scores), 0)), hits)
    return slope, intercept


def with_rivals(
    scores: Float[np.ndarray, " n"], rivals: Float[np.ndarray, "n L"], hits: Bool[np.ndarray, " n"]
) -> tuple[float, ...]:
    """Slope, intercept and the weights, at least 0, of L rivals' scores that make
    sigmoid(slope · logit(score) + intercept - Σ weight · rival) the likeliest share of true detections."""
    rows = np.column_stack([logit(scores), np.ones(len(scores)), -rivals])
    wanted = np.zeros(rows.shape[1])
    wanted[0] = 1.0

    def lost(answer: np.ndarray) -> tuple[float, np.ndarray]:
        p, off = rows @ answer, answer - wanted
        return (
            float(np.logaddexp(0.0, p).sum() - p[hits].sum() + _RIDGE / 2 * off @ off),
            rows.T @ (sigmoid(p) - hits) + _RIDGE * off,
        )

    bounds = [(_LEAST_SLOPE, None), (None, None), *((0.0, None) for _ in rivals.T)]
    found = minimize(lost, wanted, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-13, "gtol": 1e-7})
    return tuple(float(each) for each in found.x)


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
    """The network with a calibration, what rivals take from a score and a threshold per class, the lowest above which
    `PRECISION` of its detections are true, over the first `count` frames (None: all) of a file it was not trained on,
    some of them seen by some of the sensors or by sensors with errors."""
    bare = rebuilt(network, calibration=(), rivalry=(), thresholds=(), score_threshold=LOWEST)
    labels = bare.config.labels
    judged = _judged(bare, frames, count, seed)
    scores, of, hits = _columns(judged)
    counts = hits != UNCOUNTED
    pairs = []
    for label in labels:
        own = counts & (of == LABELS.index(label))
        pairs.append(platt(scores[own], hits[own] == TRUE) if own.sum() >= FEWEST else (1.0, 0.0))
    calibrated = rebuilt(bare, calibration=tuple(pairs))
    sure = [_rescored(found, calibrated.config) for found, _ in judged]
    rivals = np.concatenate([np.zeros((0, len(labels))), *(strongest_rivals(found, bare.config) for found in sure)])
    scores = Detections.merge(sure).scores
    rows, thresholds = [], []
    for label in labels:
        own = counts & (of == LABELS.index(label))
        true = hits[own] == TRUE
        enough = len(labels) > 1 and own.sum() >= FEWEST
        row = with_rivals(scores[own], rivals[own], true) if enough else (1.0, 0.0, *np.zeros(len(labels)).tolist())
        left = left_of(scores[own], rivals[own], np.array([row]))
        rows.append(row)
        thresholds.append(round(max(LEAST_SURE, lowest_threshold(left, true, PRECISION)), 3))
    return rebuilt(calibrated, rivalry=tuple(rows) if len(labels) > 1 else (), thresholds=tuple(thresholds))


def _judged(
    network: VoxelNet, frames: PackedFrames, count: int | None, seed: int
) -> list[tuple[Detections, Int64[np.ndarray, " n"]]]:
    """Per frame what is detected and of each detection whether it is TRUE, FALSE or one that does not count. A vehicle
    found on a heavy one is false where the network knows both."""
    judged, tells_apart = [], {"vehicle", "heavy"} <= set(network.config.labels)
    for found, truth, counted in detections_of(
        network, frames, count=count, seed=seed, subsets=_SUBSETS, errors=_ERRORS
    ):
        hits = np.full(len(found), UNCOUNTED)
        for number in map(LABELS.index, network.config.labels):
            known = (truth.labels != HEAVY) | (not tells_apart or number != VEHICLE)
            at = match(found, truth[known], TRUE_IOU[number], label=number, counted=counted[known])
            hits[~at.ignored] = np.where(at.truth[~at.ignored] >= 0, TRUE, FALSE)
        judged.append((found, hits))
    return judged


def _columns(judged: list[tuple[Detections, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scores, labels and outcomes of all frames, one after the other."""
    found = Detections.merge(each for each, _ in judged)
    return found.scores, found.labels, np.concatenate([np.zeros(0, int), *(hits for _, hits in judged)])


def _rescored(found: Detections, config: VoxelNetConfig) -> Detections:
    """Detections with calibrated scores."""
    by_label = {LABELS.index(label): pair for label, pair in zip(config.labels, config.calibration, strict=True)}
    slope, shift = np.array([by_label[int(label)] for label in found.labels]).reshape(-1, 2).T
    return Detections(found.boxes, sigmoid(slope * logit(found.scores) + shift), found.labels)
