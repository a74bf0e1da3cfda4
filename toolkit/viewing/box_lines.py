"""Lines and points of 3D scenes as plain arrays: edges of boxes, headings, marks, dashes, thinned clouds."""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.boxes import corners

EDGES = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]])
SPIKE = 2.5  # m, height of the mark on a false alarm

Segments = Float64[np.ndarray, "_ 2 3"]


def box_edges(boxes: Float64[np.ndarray, "n 7"]) -> Segments:
    """The twelve edges of each box."""
    return corners(boxes)[:, EDGES].reshape(-1, 2, 3)


def headings(boxes: Float64[np.ndarray, "n 7"]) -> Segments:
    """A line on the roof of each box, from its middle to the front.

    >>> headings(np.array([[1.0, 2.0, 0.5, 4.0, 2.0, 1.0, 0.0]])).tolist()
    [[[1.0, 2.0, 1.0], [3.0, 2.0, 1.0]]]
    """
    middle = boxes[:, :3] + np.array([0.0, 0, 0.5]) * boxes[:, 5:6]
    ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))])
    return np.stack([middle, middle + ahead * boxes[:, 3:4] / 2], axis=1).astype(np.float64)


def roof_crosses(boxes: Float64[np.ndarray, "n 7"]) -> Segments:
    """Both diagonals of each box's roof: the mark of a vehicle that was missed."""
    return corners(boxes)[:, [[4, 6], [5, 7]]].reshape(-1, 2, 3)


def spikes(boxes: Float64[np.ndarray, "n 7"]) -> Segments:
    """An upright line with a cross bar above each box: the mark of a false alarm."""
    top = boxes[:, :3] + np.array([0.0, 0, 1]) * (boxes[:, 5:6] / 2)
    tip, bar = (top + np.array([0.0, 0, height]) for height in (SPIKE, 0.7 * SPIKE))
    upright = np.stack([top, tip], 1)
    bars = [np.stack([bar - side, bar + side], 1) for side in (np.array([0.8, 0, 0]), np.array([0, 0.8, 0]))]
    return np.concatenate([upright, *bars]).astype(np.float64)


def dashed(segments: Segments, *, dash: float, gap: float) -> Segments:
    """The segments as dashes of `dash` metres with gaps of `gap` metres.

    >>> dashed(np.array([[[0.0, 0, 0], [5, 0, 0]]]), dash=2.0, gap=1.0)[:, :, 0]
    array([[0., 2.],
           [3., 5.]])
    """
    parts = [np.zeros((0, 2, 3))]
    for start, end in segments:
        length = float(np.linalg.norm(end - start))
        begins = np.arange(0.0, max(length, 1e-9), dash + gap)
        along = np.stack([begins, np.minimum(begins + dash, length)], 1) / max(length, 1e-9)
        parts.append(start + along[:, :, None] * (end - start))
    return np.concatenate(parts)


def sampled(points: Float32[np.ndarray, "n 3"], most: int) -> Float32[np.ndarray, "m 3"]:
    """At most so many of the points, evenly taken.

    >>> len(sampled(np.zeros((10, 3), np.float32), 4))
    4
    """
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points), most, endpoint=False).astype(np.int64)]
