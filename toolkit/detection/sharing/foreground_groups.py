"""What a sensor can send piece by piece: its foreground, split into the pixels of each box it detected and the
connected pixels that no box explains; and how many of these pieces, the most wanted first, fit so many bits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.boxes import points_in_boxes
from toolkit.detection.sharing.requests import Request
from toolkit.objects import Detections

BOX_MARGIN = 0.3  # m about a box, within which pixels are taken as its own
PLACE_REACH = 0.5  # m beyond a place that is asked for, within which pieces are taken as there
LEAST_PIXELS = 5  # of a piece that may be somebody whom the detector missed
MISSED, KNOWN, SPECK = 0.25, 0.02, 0.001  # what such a piece is worth, one of a sure box, and one still smaller
_TRIALS = 7


@dataclass(frozen=True, eq=False)
class Groups:
    """Pieces of a foreground. of: the piece of each of its pixels; sizes: pixels of each; centres: mean x and y (m);
    box: number of the sensor's own box that each belongs to, -1 where none explains it."""

    of: Int64[np.ndarray, " pixels"]
    sizes: Int64[np.ndarray, " n"]
    centres: Float64[np.ndarray, "n 2"]
    box: Int64[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Ranked:
    """Pieces that may be sent, the most wanted first, and what each is worth."""

    order: Int64[np.ndarray, " n"]
    worth: Float64[np.ndarray, " n"]


def foreground_groups(
    pixels: Int64[np.ndarray, " pixels"],
    points: Float32[np.ndarray, "pixels 3"],
    shape: tuple[int, int],
    boxes: Float64[np.ndarray, "m 7"],
) -> Groups:
    """Pieces of the pixels (counted row after row of an image of that shape) that measure these points. A pixel in two
    boxes belongs to the first."""
    from scipy.ndimage import label

    owner = np.full(len(pixels), -1)
    grown = boxes + np.array([0, 0, 0, 2 * BOX_MARGIN, 2 * BOX_MARGIN, 2 * BOX_MARGIN, 0])
    for each in (boxes, grown) if len(boxes) else ():
        within = points_in_boxes(points, each)
        free = (owner < 0) & within.any(axis=1)
        owner[free] = within[free].argmax(axis=1)
    unexplained = np.zeros(shape, bool)
    unexplained.ravel()[pixels[owner < 0]] = True
    connected = label(unexplained, np.ones((3, 3)))[0].ravel()[pixels]
    key = np.where(owner >= 0, owner, len(boxes) + connected)
    keys, of, sizes = np.unique(key, return_inverse=True, return_counts=True)
    sums = np.zeros((len(keys), 2))
    np.add.at(sums, of, points[:, :2].astype(np.float64))
    return Groups(of.reshape(-1), sizes, sums / sizes[:, None], np.where(keys < len(boxes), keys, -1))


def ranked(groups: Groups, request: Request, own: Detections) -> Ranked:
    """Pieces in the order in which they are sent: those asked for, in the order they are; then those that no box of the
    sensor's own explains, the largest first; then those of its own boxes, the least sure first; then specks."""
    n = len(groups.sizes)
    away = np.hypot(*(groups.centres[:, None] - request.places[None, :, :2]).transpose(2, 0, 1))
    there = away <= request.places[:, 2] + PLACE_REACH
    asked = there.any(axis=1)
    place = there.argmax(axis=1) if len(request) else np.zeros(n, np.int64)
    doubt = 1 - np.concatenate([own.scores, [1.0]])[groups.box]
    speck = (groups.box < 0) & (groups.sizes < LEAST_PIXELS)
    rank = np.select([speck, asked, groups.box < 0], [3, 0, 1], 2)
    within = np.select([rank == 0, rank == 2], [place, -doubt], -groups.sizes)
    order = np.lexsort((-groups.sizes, within, rank))
    shared = np.bincount(place[rank == 0], groups.sizes[rank == 0], minlength=max(len(request), 1))
    gains = request.gains if len(request) else np.zeros(1)
    asked_worth = gains[place] * groups.sizes / np.maximum(shared[place], 1)
    return Ranked(order, np.select([rank == 0, rank == 1, rank == 2], [asked_worth, MISSED, KNOWN + doubt / 4], SPECK))


def fitting(
    order: Int64[np.ndarray, " n"],
    sizes: Int64[np.ndarray, " n"],
    encode: Callable[[Bool[np.ndarray, " n"]], bytes],
    most_bits: int,
) -> tuple[bytes, Bool[np.ndarray, " n"]] | None:
    """The message with as many pieces as fit so many bits, one after another, leaving out such as do not, and which
    these are; None where not one does. encode: makes the message of some pieces."""
    taken = np.ones(len(order), bool)
    message = encode(taken)
    if 8 * len(message) <= most_bits:
        return (message, taken) if taken.any() else None
    best = None
    low, high = 0.0, float(sizes.sum())
    for _ in range(_TRIALS):
        middle = (low + high) / 2
        taken = _within(order, sizes, middle)
        message = encode(taken)
        if 8 * len(message) <= most_bits:
            low = middle
            best = (message, taken) if taken.any() else best
        else:
            high = middle
    return best


def _within(order: np.ndarray, sizes: np.ndarray, most: float) -> np.ndarray:
    """One piece after another, as long as all together have at most so many pixels."""
    taken, total = np.zeros(len(order), bool), 0
    for each in order.tolist():
        if total + sizes[each] <= most:
            taken[each] = True
            total += sizes[each]
    return taken
