"""Lines of boxes and their marks."""

import numpy as np

from toolkit.arrays import BoxRows, Float64
from toolkit.boxes import corners

# pairs of corners, numbered as in `toolkit.boxes`: bottom, top, uprights
EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
SPIKE = 2.5  # m, height of the mark on a false alarm
# start and end (x, y, z in m) of lines
Segments = Float64[np.ndarray, "_ 2 3"]


def box_edges(boxes: BoxRows) -> Segments:
    """Edges of boxes, twelve each, box after box."""
    return corners(boxes)[:, EDGES].reshape(-1, 2, 3)


def headings(boxes: BoxRows) -> Segments:
    """Line on the roof of each box, from its middle to its front."""
    # columns of a box: x, y, z of the centre, length (3), width (4), height (5), yaw (6)
    middle = boxes[:, :3] + np.array([0.0, 0, 0.5]) * boxes[:, 5:6]
    ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))])
    return np.stack([middle, middle + ahead * boxes[:, 3:4] / 2], axis=1).astype(np.float64)


def roof_crosses(boxes: BoxRows) -> Segments:
    """Both diagonals of each box's roof, the mark of a missed label."""
    return corners(boxes)[:, [[4, 6], [5, 7]]].reshape(-1, 2, 3)


def spikes(boxes: BoxRows) -> Segments:
    """Upright with a cross of two bars (1.6 m) on each roof, the mark of a false alarm.

    Returns all uprights, then all bars along x, then all bars along y."""
    top = boxes[:, :3] + np.array([0.0, 0, 1]) * (boxes[:, 5:6] / 2)
    tip = top + np.array([0.0, 0, SPIKE])
    bar = top + np.array([0.0, 0, 0.7 * SPIKE])
    lines = [np.stack([top, tip], axis=1)]
    for side in (np.array([0.8, 0, 0]), np.array([0, 0.8, 0])):
        lines.append(np.stack([bar - side, bar + side], axis=1))
    return np.concatenate(lines).astype(np.float64)


def arrows(boxes: BoxRows) -> Segments:
    """Arrow down onto the roof of each box, the mark of an object that no sensor sees."""
    # from the tip, 0.3 m above the roof: the shaft, then four barbs, in units of SPIKE
    tip = boxes[:, :3] + np.array([0.0, 0, 1]) * (boxes[:, 5:6] / 2 + 0.3)
    ends = [(0.0, 0, 1.4), (0.4, 0, 0.5), (-0.4, 0, 0.5), (0, 0.4, 0.5), (0, -0.4, 0.5)]
    lines = [np.stack([tip, tip + SPIKE * np.array(end)], axis=1) for end in ends]
    return np.concatenate(lines).astype(np.float64)


def dashes(segments: Segments, *, dash: float, gap: float) -> Segments:
    """Split segments into dashes.

    dash, gap: lengths (m) of a dash and of the gap after it; a segment begins with a dash and the
    last dash is cut at its end."""
    # 1e-9: a segment of no length becomes one dash of no length
    parts = [np.zeros((0, 2, 3))]
    for start, end in segments:
        length = float(np.linalg.norm(end - start))
        begins = np.arange(0.0, max(length, 1e-9), dash + gap)
        ends = np.minimum(begins + dash, length)
        shares = np.stack([begins, ends], axis=1) / max(length, 1e-9)
        # (dashes, 2, 3): start and end of each dash
        parts.append(start + shares[:, :, None] * (end - start))
    return np.concatenate(parts)
