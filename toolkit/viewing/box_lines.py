"""Lines of boxes and their marks."""

import numpy as np

from toolkit.arrays import BoxRows, Float64
from toolkit.boxes import corners

# pairs of corners, numbered as in `toolkit.boxes`: bottom, top, uprights
EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
SPIKE_M = 2.5  # height of the mark on a false alarm
# start and end (x, y, z in m) of lines
Segments = Float64[np.ndarray, "_ 2 3"]


def box_edges(boxes: BoxRows) -> Segments:
    """Edges of boxes, twelve each, box after box."""
    return corners(boxes)[:, EDGES].reshape(-1, 2, 3)


def headings(boxes: BoxRows) -> Segments:
    """Line on the roof of each box, from its middle to its front, as start and end (m)."""
    # columns of a box: x, y, z of the centre, length (3), width (4), height (5), yaw (6)
    length = boxes[:, 3:4]
    height = boxes[:, 5:6]
    yaw = boxes[:, 6]
    roof_middle = boxes[:, :3] + np.array([0.0, 0, 0.5]) * height
    forward = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(boxes))])
    front = roof_middle + forward * length / 2
    return np.stack([roof_middle, front], axis=1).astype(np.float64)


def roof_crosses(boxes: BoxRows) -> Segments:
    """Both diagonals of each box's roof, the mark of a missed label."""
    diagonals = [[4, 6], [5, 7]]  # pairs of corners of the roof
    return corners(boxes)[:, diagonals].reshape(-1, 2, 3)


def spikes(boxes: BoxRows) -> Segments:
    """Upright with a cross of two bars (1.6 m) on each roof, the mark of a false alarm.

    Returns all uprights, then all bars along x, then all bars along y."""
    height = boxes[:, 5:6]
    # x, y, z (m) of points in each box's mark: its foot, its tip, the crossing of its bars
    roof = boxes[:, :3] + np.array([0.0, 0, 1]) * (height / 2)
    tip = roof + np.array([0.0, 0, SPIKE_M])
    crossing = roof + np.array([0.0, 0, 0.7 * SPIKE_M])
    lines = [np.stack([roof, tip], axis=1)]
    for half_bar in (np.array([0.8, 0, 0]), np.array([0, 0.8, 0])):
        lines.append(np.stack([crossing - half_bar, crossing + half_bar], axis=1))
    return np.concatenate(lines).astype(np.float64)


def arrows(boxes: BoxRows) -> Segments:
    """Arrow down onto the roof of each box, the mark of an object that no sensor sees."""
    height = boxes[:, 5:6]
    tip = boxes[:, :3] + np.array([0.0, 0, 1]) * (height / 2 + 0.3)  # 0.3 m above the roof
    # ends of lines from the tip: the shaft, then four barbs, in units of SPIKE_M
    ends = [(0.0, 0, 1.4), (0.4, 0, 0.5), (-0.4, 0, 0.5), (0, 0.4, 0.5), (0, -0.4, 0.5)]
    lines = [np.stack([tip, tip + SPIKE_M * np.array(end)], axis=1) for end in ends]
    return np.concatenate(lines).astype(np.float64)


def dashes(segments: Segments, *, dash: float, gap: float) -> Segments:
    """Split segments into dashes.

    dash, gap: lengths (m) of a dash and of the gap after it; a segment begins with a dash and the
    last dash is cut at its end."""
    segment_dashes = [np.zeros((0, 2, 3))]
    for start, end in segments:
        length = float(np.linalg.norm(end - start))
        # 1e-9: a segment of no length becomes one dash of no length
        dash_starts = np.arange(0.0, max(length, 1e-9), dash + gap)
        dash_ends = np.minimum(dash_starts + dash, length)
        # start and end of each dash as shares of the segment
        shares = np.stack([dash_starts, dash_ends], axis=1) / max(length, 1e-9)
        # axes: dash, (start, end), (x, y, z)
        segment_dashes.append(start + shares[:, :, None] * (end - start))
    return np.concatenate(segment_dashes)
