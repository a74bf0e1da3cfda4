"""Occupancy: space that bodies take up over time, in steps of 0.1 s, and static things for good."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.boxes import WidenedBoxes, are_close
from toolkit.traffic.obstacles import BODY_GAP_M, LevelBoxes, Obstacles, place_boxes
from toolkit.traffic.road_lanes import VIEW_MARGIN_M, distance_to_area

ROUNDING_M = 1e-6
_FIRST_CAPACITY = 256  # bodies for which memory is set aside at first
_STRETCH_STEPS = 128  # searched together for conflicts, the first stretch first


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
        bodies = self._list_near(_bounds(boxes[rows]), int(steps[0]), int(steps[-1]))
        for begin in range(0, len(rows), _STRETCH_STEPS):
            stretch = slice(begin, begin + _STRETCH_STEPS)
            is_conflict = self._find_close(boxes[rows[stretch]], steps[stretch], bodies)
            if is_conflict.any():
                return int(steps[stretch][np.argmax(is_conflict)])
        return None

    def _find_close(
        self,
        boxes: LevelBoxes,
        steps: Int64[np.ndarray, " n"],
        bodies: Int64[np.ndarray, " bodies"],
    ) -> Bool[np.ndarray, " n"]:
        """Mask of the steps at which a body comes closer to another than `BODY_GAP_M`.

        Solids and parked vehicles count too.

        Args:
            boxes: Box of the body at each step.
            steps: Steps.
            bodies: Numbers of the others that may be near."""
        is_close = self.is_obstructed(boxes)
        radius = _radius(boxes)
        bounds = _bounds(boxes) + BODY_GAP_M * np.array([-1, -1, 1, 1])
        is_near = self._mask_near(bodies, bounds, int(steps[0]), int(steps[-1]))
        for body in bodies[is_near].tolist():
            track = self._boxes[body]
            offsets = steps - int(self._extents[body, 0])  # rows of its track
            rows = np.flatnonzero((offsets >= 0) & (offsets < len(track)) & ~is_close)
            others = track[offsets[rows]]
            distances = np.square(boxes[rows, :2] - others[:, :2]).sum(axis=1)
            is_open = distances < (radius + _radius(track)) ** 2
            if is_open.any():
                rows = rows[is_open]
                is_close[rows] = are_close(boxes[rows], others[is_open], BODY_GAP_M)
        return is_close

    def is_obstructed(self, boxes: LevelBoxes, gap: float = BODY_GAP_M) -> Bool[np.ndarray, " n"]:
        """Mask of boxes that touch a solid, or come within a gap (m) of a parked vehicle."""
        mask = self._obstacles.hit(boxes)
        for parked_box in self._parked_boxes:
            mask |= are_close(boxes, parked_box[None], gap)
        return mask

    def is_obstructed_in_view(
        self, boxes: Float64[np.ndarray, "n k 7"], gap: float
    ) -> Bool[np.ndarray, "n k"]:
        """Mask of boxes that may be seen and touch a solid, or are within a gap (m) of a parked
        vehicle.

        boxes: n sections of a course, with k boxes next to each other in each."""
        flat_boxes = boxes.reshape(-1, 7)
        mask = self._is_near_view(flat_boxes)
        mask[mask] = self.is_obstructed(flat_boxes[mask], gap)
        return mask.reshape(boxes.shape[:2])

    def find_blocked(
        self, boxes: Float64[np.ndarray, "n k 7"], moments: Moments, gap: float
    ) -> Bool[np.ndarray, "moments n k"]:
        """Mask of moments and boxes at which a body is within a gap of a box.

        Args:
            boxes: n sections of a course, with k boxes next to each other in each, of one size.
            moments: Moments.
            gap: Gap (m)."""
        count, across = boxes.shape[:2]
        blocked = np.zeros((moments.number, count, across), np.bool_)
        flat_boxes = boxes.reshape(-1, 7)
        is_seen = self._is_near_view(flat_boxes).reshape(count, across)
        x, y = np.ascontiguousarray(flat_boxes[:, :2].T).reshape(2, count, across)
        steps = moments.steps
        bounds = _bounds(flat_boxes) + gap * np.array([-1, -1, 1, 1])
        box_radius = np.hypot(*boxes[0, 0, 3:5]) / 2 + gap
        sections = _Sections.surround(boxes, gap)
        for body in self._list_near(bounds, int(steps[0]), int(steps[-1])).tolist():
            track = self._boxes[body]
            radius = np.hypot(*track[0, 3:5]) / 2
            offsets = steps - int(self._extents[body, 0])  # rows of its track
            rows = np.flatnonzero((offsets >= 0) & (offsets < len(track)))
            bodies = track[offsets[rows]]
            is_inside = (bodies[:, :2] > bounds[:2] - radius).all(axis=1)
            is_inside &= (bodies[:, :2] < bounds[2:] + radius).all(axis=1)
            rows = rows[is_inside]
            if not len(rows):
                continue
            bodies = bodies[is_inside]
            low = bodies[:, :2].min(axis=0) - radius - box_radius
            high = bodies[:, :2].max(axis=0) + radius + box_radius
            is_near = is_seen & (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
            moment, section = sections.find_near(bodies, np.flatnonzero(is_near.any(axis=1)))
            if len(moment):
                pairs = _Pairs(bodies, boxes, moment, section)
                blocked[rows[moment], section] |= pairs.mask_close(gap) & is_near[section]
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

    def _list_near(
        self, bounds: Float64[np.ndarray, "4"], begin: int, end: int
    ) -> Int64[np.ndarray, " k"]:
        """Numbers of the bodies that may come within bounds at a step from `begin` to `end`.

        bounds: xmin, ymin, xmax, ymax (m)."""
        bodies = np.arange(len(self._boxes))
        return bodies[self._mask_near(bodies, bounds, begin, end)]

    def _mask_near(
        self,
        bodies: Int64[np.ndarray, " n"],
        bounds: Float64[np.ndarray, "4"],
        begin: int,
        end: int,
    ) -> Bool[np.ndarray, " n"]:
        """Mask of bodies that may come within bounds at a step from `begin` to `end`.

        bodies: their numbers; bounds: xmin, ymin, xmax, ymax (m)."""
        # a row for each body: first and last step, xmin, ymin, xmax, ymax
        extents = self._extents[bodies]
        is_near = (extents[:, 0] <= end) & (extents[:, 1] >= begin)
        is_near &= (extents[:, 2:4] <= bounds[2:] + BODY_GAP_M).all(axis=1)
        is_near &= (extents[:, 4:] >= bounds[:2] - BODY_GAP_M).all(axis=1)
        return is_near


class _Sections(NamedTuple):
    """Circles around the sections of a course.

    Attributes:
        middles: x, y of each (m).
        radius: radius of each circle (m)."""

    middles: Float64[np.ndarray, "n 2"]
    radius: float

    @staticmethod
    def surround(boxes: Float64[np.ndarray, "n k 7"], gap: float) -> "_Sections":
        """Circles that hold all within a gap (m) of the k boxes of each section."""
        low = boxes[:, :, :2].min(axis=1)
        high = boxes[:, :, :2].max(axis=1)
        spread = np.hypot(*(high - low).T).max() / 2
        # a little more, so that rounding leaves nothing out
        radius = spread + np.hypot(*boxes[0, 0, 3:5]) / 2 + 1.5 * gap + ROUNDING_M
        return _Sections((low + high) / 2, float(radius))

    def find_near(
        self, bodies: LevelBoxes, sections: Int64[np.ndarray, " sections"]
    ) -> tuple[Int64[np.ndarray, " pairs"], Int64[np.ndarray, " pairs"]]:
        """Rows of bodies of one size, and which of some sections each may be within the gap of."""
        reach = self.radius + np.hypot(*bodies[0, 3:5]) / 2
        dx = self.middles[sections, 0] - bodies[:, 0, None]
        dy = self.middles[sections, 1] - bodies[:, 1, None]
        row, column = np.nonzero(dx * dx + dy * dy < reach * reach)
        return row, sections[column]


class _Pairs(NamedTuple):
    """Boxes of a body, each with the boxes of a section of a course.

    Attributes:
        bodies: boxes of the body, of one size.
        boxes: sections of k boxes of another size, with one heading in each section.
        body: row of the body's box of each pair.
        section: section of each pair."""

    bodies: LevelBoxes
    boxes: Float64[np.ndarray, "n k 7"]
    body: Int64[np.ndarray, " pairs"]
    section: Int64[np.ndarray, " pairs"]

    def mask_close(self, gap: float) -> Bool[np.ndarray, "pairs k"]:
        """Mask of boxes within a gap (m) of the body, as `are_close` finds them but for corners."""
        half_length, half_width = ((self.bodies[0, 3:5] + gap) / 2).tolist()
        bodies = WidenedBoxes(
            x=self.bodies[self.body, 0, None],
            y=self.bodies[self.body, 1, None],
            yaw=self.bodies[self.body, 6, None],
            half_length=half_length,
            half_width=half_width,
        )
        half_length, half_width = ((self.boxes[0, 0, 3:5] + gap) / 2).tolist()
        boxes = WidenedBoxes(
            x=self.boxes[:, :, 0][self.section],
            y=self.boxes[:, :, 1][self.section],
            yaw=self.boxes[:, 0, 6][self.section, None],
            half_length=half_length,
            half_width=half_width,
            # no place within half of the gap is farther from the middle
            max_extent=float(np.hypot(*self.boxes[0, 0, 3:5])) / 2 + gap / 2,
        )
        return bodies.overlap(boxes)


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
