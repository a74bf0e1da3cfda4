"""Moving boxes of a frame, by their tracks in the frames next to it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Int64
from toolkit.frame import Frame
from toolkit.geometry import invert, transform

MIN_MOVING_SPEED_MPS = 2.0  # slower boxes do not count as moving
MAX_TRACK_SPEED_MPS = 60.0  # a faster track has jumped


class MovingBoxes(NamedTuple):
    """Moving boxes of a frame, a row each.

    Attributes:
        boxes: (n, 7) boxes, world frame.
        velocities: (n, 2) velocity along x and y (m/s), same frame.
        ids: (n,) track of each box."""

    boxes: BoxRows
    velocities: Float64[np.ndarray, "n 2"]
    ids: Int64[np.ndarray, " n"]

    def move(self, seconds: float) -> BoxRows:
        """Boxes some seconds later, or earlier if negative, at constant velocity."""
        # x and y change, the other five columns do not
        offsets = np.column_stack([seconds * self.velocities, np.zeros((len(self.boxes), 5))])
        return self.boxes + offsets


def find_moving(samples: Sequence[Frame], k: int) -> MovingBoxes:
    """Find the moving boxes of frame k by their tracks in the frame after, or else before.

    samples: consecutive frames. Boxes without a track in those frames are left out, and those that
    stand still or move faster than a road user can."""
    frame = samples[k]
    moving_rows = list[int]()  # rows of the moving boxes
    velocities = list[np.ndarray]()  # x, y (m/s) in the world of frame k
    neighbours = [samples[index] for index in (k + 1, k - 1) if 0 <= index < len(samples)]
    for row, track in enumerate(frame.objects.ids):
        for neighbour in neighbours:
            track_rows = np.flatnonzero(neighbour.objects.ids == track)
            seconds = neighbour.time - frame.time  # negative for the frame before
            # an id that several boxes have, or boxes without one share, is no track
            if len(track_rows) == 1 and np.isfinite(seconds) and seconds != 0:
                # the worlds of two frames may differ, as around a vehicle; the map is the same
                centres = neighbour.objects.boxes[track_rows, :3]  # (1, 3)
                centres_in_map = transform(neighbour.map_SE3_world, centres)
                position = transform(invert(frame.map_SE3_world), centres_in_map)[0, :2]
                velocity = (position - frame.objects.boxes[row, :2]) / seconds
                if MIN_MOVING_SPEED_MPS < np.linalg.norm(velocity) < MAX_TRACK_SPEED_MPS:
                    moving_rows.append(row)
                    velocities.append(velocity)
                break
    row_indices = np.array(moving_rows, np.int64)
    return MovingBoxes(
        boxes=frame.objects.boxes[row_indices],
        velocities=np.array(velocities).reshape(-1, 2),
        ids=frame.objects.ids[row_indices],
    )
