"""Velocities of objects, from their tracks in neighbouring frames."""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import Float64
from toolkit.objects import Objects

MOST_APART = 0.5  # s; frames farther apart give no velocities


def velocities(
    objects: Objects, time: float, around: Sequence[tuple[Objects, float]]
) -> Float64[np.ndarray, "n 3"]:
    """Velocity (m/s, world frame) of each object of a frame, from its track in neighbouring frames.

    It is the mean of the velocities towards each neighbour, 0 for a track in no neighbour.

    Args:
        objects: objects of the frame; equal ids in two frames are one track.
        time: time of the frame (s).
        around: objects and time (s) of each neighbouring frame.

    Raises ValueError without neighbours, and for one at the same time or more than `MOST_APART`
    away."""
    gaps = [abs(neighbour_time - time) for _, neighbour_time in around]
    if not gaps or not all(0 < gap <= MOST_APART for gap in gaps):
        intervals = ", ".join(f"{gap:g} s" for gap in gaps) or "nothing"
        remedy = "leave the clock's offset out, or record more often"
        raise ValueError(
            f"velocities need frames at most {MOST_APART} s apart, got {intervals}: {remedy}"
        )
    total = np.zeros((len(objects), 3))
    count = np.zeros(len(objects))
    for neighbour, neighbour_time in around:
        # rows of the tracks that are in both frames
        _, rows, neighbour_rows = np.intersect1d(objects.ids, neighbour.ids, return_indices=True)
        displacement = neighbour.boxes[neighbour_rows, :3] - objects.boxes[rows, :3]
        total[rows] += displacement / (neighbour_time - time)
        count[rows] += 1
    return total / np.maximum(count, 1)[:, None]
