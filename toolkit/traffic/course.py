"""`Course`: way of a body through a site, as if nobody else were there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Float64, Shaped
from toolkit.traffic.body_motion import shift_left, smooth_direction
from toolkit.traffic.occupancy import size_boxes

ASIDE_SPACING_M = 0.2  # between lines next to a course


@dataclass(frozen=True)
class Course:
    """Course of a body.

    Attributes:
        first: step of the first pose.
        poses: x, y (m), yaw (rad), one for each step.
        size: length, width, height of the body (m).
        label: class of `toolkit.objects`."""

    first: int
    poses: Float64[np.ndarray, "steps 3"]
    size: Float64[np.ndarray, "3"]
    label: int

    @cached_property
    def directions(self) -> Float64[np.ndarray, " steps"]:
        """Direction of the course (rad) that sides are counted from, which turns slowly."""
        return smooth_direction(self.poses[:, 2])

    @cached_property
    def changes(self) -> Float64[np.ndarray, "steps 3"]:
        """Change (x, y in m, yaw in rad) from each pose to the next; headings turn the shorter way.

        The last pose has 0."""
        changes = np.zeros_like(self.poses)
        changes[:-1] = np.diff(self.poses, axis=0)
        changes[:, 2] = np.arctan2(np.sin(changes[:, 2]), np.cos(changes[:, 2]))
        return changes

    def pick(self, rows: Shaped[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """Poses (x, y in m, yaw in rad) at rows that may be between two."""
        low = np.clip(rows.astype(np.int64), 0, len(self.poses) - 1)
        return self.poses[low] + (rows - low)[:, None] * self.changes[low]

    def shift(
        self, rows: Shaped[np.ndarray, " k"], left: Float64[np.ndarray, " k"]
    ) -> Float64[np.ndarray, "k 3"]:
        """Poses to the left of the course, with its headings.

        rows: rows of its poses, which may be between two; left: distance at each (m)."""
        directions = np.interp(rows, np.arange(len(self.poses)), self.directions)
        return shift_left(self.pick(rows), directions, left)

    def list_lines(
        self, rows: Shaped[np.ndarray, " k"], asides: Float64[np.ndarray, " lines"]
    ) -> Float64[np.ndarray, "k lines 7"]:
        """Boxes of the body at rows, on lines next to the course.

        asides: distance of each line to the left of the course (m)."""
        poses = self.shift(np.repeat(rows, len(asides)), np.tile(asides, len(rows)))
        return size_boxes(poses, self.size).reshape(len(rows), len(asides), 7)


def list_asides(line_count: int) -> Float64[np.ndarray, " lines"]:
    """Distances to the left of a course (m) of its own line and `line_count` on each side.

    >>> list_asides(2).tolist()
    [-0.4, -0.2, 0.0, 0.2, 0.4]
    """
    return ASIDE_SPACING_M * np.arange(-line_count, line_count + 1)
