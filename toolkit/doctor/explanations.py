"""Explanations of labels that fit badly: a mistake, and the boxes without it.

The fit of a box, 0 to 1, is the share of its points that are where a correct box has them
(`toolkit.doctor.box_fits`)."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.doctor.box_fits import GroundView, fits_better, measure_fits, measure_view_fits
from toolkit.doctor.label_mistake import LabelMistake
from toolkit.frame import Frame

# Mistakes whose mean fits are this close to the best one are as good; the first in the list is
# named.
MAX_TIED_FIT_GAP = 0.04
# least gain in mean fit by explanations that choose a sensor for each box, since chance helps them
MIN_CHOICE_GAIN = 0.1


class Explanation(NamedTuple):
    """Mistake that may explain why labels fit badly, and the boxes without it.

    Attributes:
        mistake: the mistake that is undone.
        boxes: boxes of each frame without it (m, 7), world frame.
        fits: fit of each such box, 0 to 1, frame after frame."""

    mistake: LabelMistake
    boxes: list[np.ndarray]
    fits: np.ndarray


def find_nearly_best(
    explanations: Sequence[Explanation], current_fits: np.ndarray, *gain: float
) -> Explanation | None:
    """Return the first explanation that fits nearly best, None if none improves the fits.

    Args:
        explanations: explanations in order of preference.
        current_fits: fit of each box as it is, frame after frame.
        gain: least gain in mean fit, one number or none; without it, `MIN_FIT_GAIN`."""
    better_explanations = [
        explanation
        for explanation in explanations
        if fits_better(current_fits, explanation.fits, *gain)
    ]
    means = _mean_fits(better_explanations) if better_explanations else []
    for explanation, mean in zip(better_explanations, means, strict=True):
        if mean >= max(means) - MAX_TIED_FIT_GAP:
            return explanation
    return None


def choose_clearer(
    best: Explanation | None, freer: Explanation | None, margin: float
) -> Explanation | None:
    """Return the freer explanation if it fits better by more than a margin, else the best.

    best, freer: explanations; the freer one has more numbers to choose, so chance helps
    it. If one is None, the other is returned. margin: in mean fit, may be negative."""
    if best is None or freer is None:
        return best or freer
    best_mean, freer_mean = _mean_fits([best, freer])
    return freer if freer_mean > best_mean + margin else best


def _mean_fits(explanations: Sequence[Explanation]) -> list[float]:
    """Mean fit of each explanation, over the boxes that have a fit in any explanation."""
    has_fit = np.any([explanation.fits > 0 for explanation in explanations], axis=0)
    return [float(explanation.fits[has_fit].mean()) for explanation in explanations]


def undo_each(
    mistake: LabelMistake,
    views: Sequence[GroundView],
    choose: Callable[[Frame], Sequence[np.ndarray]],
) -> Explanation:
    """Undo a mistake with, for each box, the choice that fits best.

    Args:
        mistake: mistake that the result names.
        views: frames with their points above the ground.
        choose: returns possible boxes (m, 7) of a frame without the mistake, one array for each
            choice, all with the boxes in the same order. A tie takes the first."""
    boxes = []
    for view in views:
        choices = np.stack(choose(view.sample))  # (choices, m, 7)
        box_count = choices.shape[1]
        best = np.zeros(box_count, np.int64)  # index of the best choice of each box
        if len(choices) > 1:
            best = np.argmax([measure_fits(view.points, rows) for rows in choices], axis=0)
        boxes.append(choices[best, np.arange(box_count)])
    return Explanation(mistake, boxes, measure_view_fits(views, boxes))
