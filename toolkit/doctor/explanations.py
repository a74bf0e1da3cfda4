"""Explanations of labels that fit badly: a mistake, and the boxes without it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.doctor.box_fits import GroundView, fits, fits_better, measure_fits
from toolkit.doctor.label_mistake import LabelMistake
from toolkit.frame import Frame

MAX_TIED_FIT_GAP = 0.04  # in mean fit; the first of such mistakes in the list is named
MIN_CHOICE_GAIN = 0.1  # in mean fit, for explanations that choose a sensor for each box


class Explanation(NamedTuple):
    """Mistake, the boxes without it, and their fits."""

    mistake: LabelMistake
    boxes: list[np.ndarray]
    fits: np.ndarray


def find_nearly_best(
    attempts: Sequence[Explanation], current: np.ndarray, *gain: float
) -> Explanation | None:
    """Return the first of the mistakes that fit nearly best, None if none improves the fits."""
    surer = [attempt for attempt in attempts if fits_better(current, attempt.fits, *gain)]
    means = _means(surer) if surer else []
    for attempt, mean in zip(surer, means, strict=True):
        if mean >= max(means) - MAX_TIED_FIT_GAP:
            return attempt
    return None


def choose_clearer(
    best: Explanation | None, freer: Explanation | None, margin: float
) -> Explanation | None:
    """Return the freer explanation if it wins by a margin."""
    if best is None or freer is None:
        return best or freer
    best_mean, freer_mean = _means([best, freer])
    return freer if freer_mean > best_mean + margin else best


def _means(attempts: Sequence[Explanation]) -> list[float]:
    """Mean fit under each explanation, over the same boxes."""
    has_fit = np.any([attempt.fits > 0 for attempt in attempts], axis=0)
    return [float(attempt.fits[has_fit].mean()) for attempt in attempts]


def undo_each(
    mistake: LabelMistake,
    views: Sequence[GroundView],
    choose: Callable[[Frame], Sequence[np.ndarray]],
) -> Explanation:
    """Take the choice with the best fit for every box."""
    boxes = []
    for view in views:
        choices = choose(view.sample)
        best = np.zeros(len(choices[0]), np.int64)
        if len(choices) > 1:
            best = np.argmax([measure_fits(view.points, rows) for rows in choices], axis=0)
        boxes.append(np.stack(choices)[best, np.arange(len(choices[0]))])
    return Explanation(mistake, boxes, fits(views, boxes))
