"""Occupancy: space that bodies take up over time, in steps of 0.1 s, and static things for good."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.boxes import are_close
from toolkit.traffic.obstacles import BODY_GAP_M, LevelBoxes, Obstacles, place_boxes
from toolkit.traffic.road_lanes import VIEW_MARGIN_M, distance_to_area

ROUNDING_M = 1e-6
_FIRST_CAPACITY = 256  # bodies for which memory is set aside at first


class Moments(NamedTuple):
    """Moments at equal distances in time.

    Attributes:
        begin: step of the first moment.
        stride: steps between moments.
        number: number of moments."""

    begin: int
    stride: int
    number: int

    @property
    def steps(self) -> Int64[np.ndarray, " moments"]:
        """Step of each moment."""
        return self.begin + self.stride * np.arange(self.number)


class Occupancy:
    """Bodies near the view of a site, each with a box for each step in which it is there.

    Only steps from 0 to the last one count, and only boxes that may be seen.

    Args:
        area: Detection area: xmin, ymin, xmax, ymax (m).
        obstacles: Solids in the way.
        parked_boxes: Boxes of parked vehicles, on level ground.
        last: Number of the last step."""

    def __init__(
        self,
        area: Float64[np.ndarray, "4"],
        obstacles: Obstacles,
        parked_boxes: LevelBoxes,
        last: int,
    ) -> None:
        """Begin with the parked vehicles only."""
        self.last = last
        self._area = area
        self._obstacles = obstacles
        self._parked_boxes = parked_boxes
        self._boxes: list[LevelBoxes] = []
        # for each body: first and last step, xmin, ymin, xmax, ymax of all it covers
        self._extents = np.empty((_FIRST_CAPACITY, 6))

    def add(self, boxes: LevelBoxes, first: int) -> None:
        """Add a body with a box for each step from `first` on, as far as it may be seen."""
        rows = self._list_seen(boxes, first)
        if not len(rows):
            return
        # from the first to the last box that may be seen, with what is between them
        begin, end = int(rows[0]), int(rows[-1]) + 1
        count = len(self._boxes)
        if count == len(self._extents):
            self._extents = np.concatenate([self._extents, np.empty_like(self._extents)])
        self._boxes.append(boxes[begin:end])
        self._extents[count, :2] = first + begin, first + end - 1
        self._extents[count, 2:] = _bounds(boxes[begin:end])

    def find_conflict(
        self, boxes: LevelBoxes, first: int, *, since: int | None = None
    ) -> int | None:
        """First step at which a body comes closer to another than `BODY_GAP_M`; None without one.

        Solids and parked vehicles count too, but only steps in which the body may be seen.

        Args:
            boxes: Box of the body for each step from `first` on.
            first: Step of the first box.
            since: Step to begin at, None for the first."""
        rows = self._list_seen(boxes, first)
        if since is not None:
            rows = rows[rows >= since - first]
        if not len(rows):
            return None
        steps = first + rows
        radius = _radius(boxes)
        conflicts = [int(step) for step in steps[self.is_obstructed(boxes[rows])][:1]]
        for body in self._list_near(_bounds(boxes[rows]), int(steps[0]), int(steps[-1])):
            body_first = int(self._extents[body, 0])
            body_track = self._boxes[body]
            is_common = (steps >= body_first) & (steps < body_first + len(body_track))
            common = steps[is_common]
            offsets = boxes[common - first, :2] - body_track[common - body_first, :2]
            common = common[np.square(offsets).sum(axis=1) < (radius + _radius(body_track)) ** 2]
            is_close = are_close(boxes[common - first], body_track[common - body_first], BODY_GAP_M)
            conflicts += common[is_close][:1].tolist()
        return min(conflicts, default=None)

    def is_obstructed(self, boxes: LevelBoxes, gap: float = BODY_GAP_M) -> Bool[np.ndarray, " n"]:
        """Mask of boxes that touch a solid, or come within a gap (m) of a parked vehicle."""
        mask = self._obstacles.hit(boxes)
        for parked_box in self._parked_boxes:
            mask |= are_close(boxes, parked_box[None], gap)
        return mask

    def is_obstructed_in_view(self, boxes: LevelBoxes, gap: float) -> Bool[np.ndarray, " n"]:
        """Mask of boxes that may be seen and touch a solid, or are within a gap (m) of a parked
        vehicle."""
        return self.is_obstructed(boxes, gap) & self._is_near_view(boxes)

    def find_blocked(
        self, boxes: LevelBoxes, moments: Moments, gap: float
    ) -> Bool[np.ndarray, "moments n"]:
        """Mask of moments and boxes at which a body is within a gap of a box.

        Args:
            boxes: Boxes of one size.
            moments: Moments.
            gap: Gap (m)."""
        blocked = np.zeros((moments.number, len(boxes)), np.bool_)
        is_seen = self._is_near_view(boxes)
        steps = moments.steps
        bounds = _bounds(boxes) + gap * np.array([-1, -1, 1, 1])
        for body in self._list_near(bounds, int(steps[0]), int(steps[-1])):
            body_first = int(self._extents[body, 0])
            body_track = self._boxes[body]
            rows = np.flatnonzero((steps >= body_first) & (steps < body_first + len(body_track)))
            body_boxes = body_track[steps[rows] - body_first]
            radius = np.hypot(*body_boxes[0, 3:5]) / 2
            is_inside = (body_boxes[:, :2] > bounds[:2] - radius).all(axis=1)
            is_inside &= (body_boxes[:, :2] < bounds[2:] + radius).all(axis=1)
            rows = rows[is_inside]
            body_boxes = body_boxes[is_inside]
            if not len(rows):
                continue
            # in the frame of the body, how far a box can be away and still be close
            box_radius = np.hypot(*boxes[0, 3:5]) / 2 + gap
            reach = body_boxes[0, 3:5] / 2 + box_radius
            low = body_boxes[:, :2].min(axis=0) - radius - box_radius
            high = body_boxes[:, :2].max(axis=0) + radius + box_radius
            is_near = is_seen & ((boxes[:, :2] > low) & (boxes[:, :2] < high)).all(axis=1)
            near = np.flatnonzero(is_near)
            dx = boxes[near, 0] - body_boxes[:, 0, None]
            dy = boxes[near, 1] - body_boxes[:, 1, None]
            cos = np.cos(body_boxes[:, 6, None])
            sin = np.sin(body_boxes[:, 6, None])
            ahead = np.abs(dx * cos + dy * sin)
            aside = np.abs(dy * cos - dx * sin)
            # a box whose middle is so near is close, whatever its yaw
            half = (body_boxes[0, 3:5] + gap) / 2
            inner = half + (boxes[0, 3:5].min() + gap) / 2 - ROUNDING_M
            is_close = (ahead < inner[0]) & (aside < half[1])
            is_close |= (ahead < half[0]) & (aside < inner[1])
            blocked[np.ix_(rows, near)] |= is_close
            is_open = (ahead < reach[0]) & (aside < reach[1]) & ~is_close
            moment, column = np.nonzero(is_open)
            box = near[column]
            is_close = are_close(body_boxes[moment], boxes[box], gap)
            blocked[rows[moment[is_close]], box[is_close]] = True
        return blocked

    def _list_seen(self, boxes: LevelBoxes, first: int) -> Int64[np.ndarray, " k"]:
        """Rows of boxes that may be seen in a frame. first: step of the first box."""
        steps = first + np.arange(len(boxes))
        return np.flatnonzero((steps >= 0) & (steps <= self.last) & self._is_near_view(boxes))

    def _is_near_view(self, boxes: LevelBoxes) -> Bool[np.ndarray, " n"]:
        """Mask of boxes that may reach into the view, the area and a margin around it."""
        radius = np.hypot(boxes[:, 3], boxes[:, 4]) / 2
        # a corner of the view is a diagonal of the margin away from the area
        return distance_to_area(boxes[:, :2], self._area) <= np.sqrt(2) * VIEW_MARGIN_M + radius

    def _list_near(self, bounds: Float64[np.ndarray, "4"], begin: int, end: int) -> list[int]:
        """Numbers of the bodies that may come within bounds at a step from `begin` to `end`.

        bounds: xmin, ymin, xmax, ymax (m)."""
        # a row for each body: first and last step, xmin, ymin, xmax, ymax
        extents = self._extents[: len(self._boxes)]
        is_near = (extents[:, 0] <= end) & (extents[:, 1] >= begin)
        is_near &= (extents[:, 2:4] <= bounds[2:] + BODY_GAP_M).all(axis=1)
        is_near &= (extents[:, 4:] >= bounds[:2] - BODY_GAP_M).all(axis=1)
        return np.flatnonzero(is_near).tolist()


def size_boxes(poses: Float64[np.ndarray, "n 3"], size: Float64[np.ndarray, "3"]) -> LevelBoxes:
    """Boxes of one body on level ground, one for each pose.

    poses: x, y (m), yaw (rad); size: length, width, height (m)."""
    return place_boxes(poses, np.tile(size, (len(poses), 1)))


def _radius(boxes: LevelBoxes) -> float:
    """Largest distance (m) from the middle of a body to any place within `BODY_GAP_M` of it.

    boxes: boxes of the body, all of one size."""
    return float(np.hypot(boxes[0, 3], boxes[0, 4])) / 2 + BODY_GAP_M


def _bounds(boxes: LevelBoxes) -> Float64[np.ndarray, "4"]:
    """Lowest and highest x and y (m) that boxes may reach: xmin, ymin, xmax, ymax."""
    radius = float(np.hypot(boxes[:, 3], boxes[:, 4]).max()) / 2
    low = boxes[:, :2].min(axis=0) - radius
    return np.concatenate([low, boxes[:, :2].max(axis=0) + radius])
