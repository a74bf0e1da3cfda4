"""Detections of different classes at one place: what the score of one leaves of the other's.

Boxes suppress those of their own class alone, so somebody on a bicycle can be found as a cyclist and as a pedestrian,
and the cab of a truck as a vehicle. What a detection's score still says where there is such a rival is fitted to
detections whose truth is known (`models.training.calibration`).
"""

from __future__ import annotations

import numpy as np

from models.config import VoxelNetConfig
from toolkit.arrays import Float
from toolkit.boxes import footprint_inside
from toolkit.objects import Detections, label_index

TOGETHER = 0.3  # share of the smaller of two footprints that lies on the other, above which both claim one place
LEAST_RIVAL = 0.2  # score below which nobody is a rival
_NEVER_SURE = 1e-6  # scores are cut to so much from 0 and 1


def strongest_rivals(found: Detections, config: VoxelNetConfig) -> Float[np.ndarray, "n L"]:
    """For every detection and each label, the greatest score of a box of that label on the same ground; 0 where there
    is none of at least `LEAST_RIVAL`, and for its own label."""
    strongest = np.zeros((len(found), len(config.labels)))
    if not len(found):
        return strongest
    inside = footprint_inside(found.boxes, found.boxes)
    together = (np.maximum(inside, inside.T) > TOGETHER) & (found.labels[:, None] != found.labels)
    scores = np.where(together & (found.scores >= LEAST_RIVAL), found.scores, 0.0)
    for column, name in enumerate(config.labels):
        strongest[:, column] = scores[:, found.labels == label_index(name)].max(axis=1, initial=0.0)
    return strongest


def contested(found: Detections, config: VoxelNetConfig) -> Detections:
    """The detections with the scores that their rivals leave them, as `config.rivalry` has it:
    sigmoid(slope · logit(score) + intercept - Σ weight of a label · score of its strongest rival)."""
    if not config.rivalry or not len(found):
        return found
    own = {label_index(name): row for row, name in enumerate(config.labels)}
    rows = np.array(config.rivalry)[[own[int(label)] for label in found.labels]]
    return Detections(found.boxes, left_of(found.scores, strongest_rivals(found, config), rows), found.labels)


def left_of(
    scores: Float[np.ndarray, " n"], rivals: Float[np.ndarray, "n L"], rows: Float[np.ndarray, "r K"]
) -> Float[np.ndarray, " n"]:
    """What rivals leave of scores, by slope, intercept and the weights of labels (K = L + 2), a row for each score or
    one for all."""
    return sigmoid(rows[:, 0] * logit(scores) + rows[:, 1] - (rows[:, 2:] * rivals).sum(axis=1))


def logit(scores: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Log odds, of scores cut to 1e-6 from 0 and 1 as the detector cuts them."""
    cut = np.clip(scores, _NEVER_SURE, 1 - _NEVER_SURE)
    return np.log(cut / (1 - cut))


def sigmoid(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The inverse of `logit`."""
    return 1 / (1 + np.exp(-values))
