"""Occupancy: space that bodies take up over time, in steps of 0.1 s, and static things for good."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.boxes import WidenedBoxes, are_close, widen_boxes
from toolkit.traffic.obstacles import BODY_GAP_M, ROUNDING_M, LevelBoxes, Obstacles, place_boxes
from toolkit.traffic.road_lanes import VIEW_MARGIN_M, distance_to_area

_FIRST_CAPACITY = 256  # rows that are reserved at first
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
        self._tracks = _Tracks()

    def add(self, boxes: LevelBoxes, first: int) -> None:
        """Add a body with a box for each step from `first` on, as far as it may be seen."""
        rows = self._list_seen(boxes, first)
        if not len(rows):
            return
        # from the first to the last box that may be seen, with what is between them
        begin, end = int(rows[0]), int(rows[-1]) + 1
        self._tracks.append(boxes[begin:end], first + begin)

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
        bodies = self._tracks.list_near(_bounds(boxes[rows]), int(steps[0]), int(steps[-1]))
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
        bounds = _bounds(boxes) + BODY_GAP_M * np.array([-1, -1, 1, 1])
        is_near = self._tracks.mask_near(bodies, bounds, int(steps[0]), int(steps[-1]))
        places = self._tracks.find_places(bodies[is_near], steps)
        places = places.select(~is_close[places.moment])
        body_boxes = boxes[places.moment]
        reach = _radius(boxes[0, 3:5]) + _radius(places.size)
        distances = np.square(body_boxes[:, :2] - places.pose[:, :2]).sum(axis=1)
        is_open = distances < reach**2
        places = places.select(is_open)
        is_touching = widen_boxes(body_boxes[is_open], BODY_GAP_M).overlap(places.widen(BODY_GAP_M))
        is_close[places.moment[is_touching]] = True
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
    ) -> Bool[np.ndarray, "moments k n"]:
        """Mask of moments, lines and sections at which a body is within a gap of a box.

        Args:
            boxes: n sections of a course, in each k boxes of one size at equal distances from line
                to line, with one heading.
            moments: Moments.
            gap: Gap (m)."""
        flat_boxes = boxes.reshape(-1, 7)
        steps = moments.steps
        bounds = _bounds(flat_boxes) + gap * np.array([-1, -1, 1, 1])
        bodies = self._tracks.list_near(bounds, int(steps[0]), int(steps[-1]))
        places = self._tracks.find_places(bodies, steps)
        places = places.select(_mask_within(places, bounds))
        is_seen = self._is_near_view(flat_boxes).reshape(boxes.shape[:2])
        sections = _Sections.from_boxes(boxes, gap)
        place_row, section = sections.find_near(places, np.flatnonzero(is_seen.any(axis=1)))
        spans = sections.find_close(places, place_row, section, gap)
        blocked = spans.mask(
            (moments.number, *boxes.shape[1::-1]), places.moment[place_row], section
        )
        return blocked & is_seen.T

    def _list_seen(self, boxes: LevelBoxes, first: int) -> Int64[np.ndarray, " k"]:
        """Rows of boxes that may be seen in a frame. first: step of the first box."""
        steps = first + np.arange(len(boxes))
        return np.flatnonzero((steps >= 0) & (steps <= self.last) & self._is_near_view(boxes))

    def _is_near_view(self, boxes: LevelBoxes) -> Bool[np.ndarray, " n"]:
        """Mask of boxes that may reach into the view, the area and a margin around it."""
        radius = np.hypot(boxes[:, 3], boxes[:, 4]) / 2
        # a corner of the view is a diagonal of the margin away from the area
        return distance_to_area(boxes[:, :2], self._area) <= np.sqrt(2) * VIEW_MARGIN_M + radius


class _Places(NamedTuple):
    """Bodies at some moments, a row for each body at each moment.

    Attributes:
        body: number of the body, ascending.
        moment: row of the moment.
        pose: x, y (m), yaw (rad).
        size: length and width (m)."""

    body: Int64[np.ndarray, " k"]
    moment: Int64[np.ndarray, " k"]
    pose: Float64[np.ndarray, "k 3"]
    size: Float64[np.ndarray, "k 2"]

    def select(self, rows: Bool[np.ndarray, " k"] | Int64[np.ndarray, " k"]) -> "_Places":
        """Some of the places. rows: their rows, or a mask."""
        return _Places(self.body[rows], self.moment[rows], self.pose[rows], self.size[rows])

    def widen(self, gap: float) -> WidenedBoxes:
        """Boxes that are wider by half of a gap (m) on each side."""
        half_length, half_width = ((self.size + gap) / 2).T
        return WidenedBoxes(
            x=self.pose[:, 0],
            y=self.pose[:, 1],
            yaw=self.pose[:, 2],
            half_length=half_length,
            half_width=half_width,
        )

    def measure_extents(self) -> Float64[np.ndarray, "k 4"]:
        """Rectangle that each row's body covers in all its rows: xmin, ymin, xmax, ymax (m)."""
        if not len(self.body):
            return np.zeros((0, 4))
        is_first = np.append(True, np.diff(self.body) > 0)
        begins = np.flatnonzero(is_first)
        radius = np.hypot(*self.size[begins].T)[:, None] / 2
        low = np.minimum.reduceat(self.pose[:, :2], begins) - radius
        high = np.maximum.reduceat(self.pose[:, :2], begins) + radius
        return np.column_stack([low, high])[np.cumsum(is_first) - 1]


class _Tracks:
    """Tracks of bodies, one after the other, in arrays that grow."""

    def __init__(self) -> None:
        """Begin without bodies."""
        self._count = 0
        self._end = 0  # rows in use
        self._poses = np.empty((_FIRST_CAPACITY, 3))  # x, y (m), yaw (rad)
        # for each body: row of its first pose, size (m), first and last step and bounds (m)
        self._begins = np.empty(_FIRST_CAPACITY, np.int64)
        self._sizes = np.empty((_FIRST_CAPACITY, 2))
        self._spans = np.empty((_FIRST_CAPACITY, 2), np.int64)
        self._bounds = np.empty((_FIRST_CAPACITY, 4))

    def append(self, boxes: LevelBoxes, first: int) -> None:
        """Add a body with a box for each step from `first` on."""
        end = self._end + len(boxes)
        self._poses = _reserve(self._poses, end)
        self._poses[self._end : end] = boxes[:, [0, 1, 6]]
        count = self._count
        self._begins = _reserve(self._begins, count + 1)
        self._sizes = _reserve(self._sizes, count + 1)
        self._spans = _reserve(self._spans, count + 1)
        self._bounds = _reserve(self._bounds, count + 1)
        self._begins[count] = self._end
        self._sizes[count] = boxes[0, 3:5]
        self._spans[count] = first, first + len(boxes) - 1
        self._bounds[count] = _bounds(boxes)
        self._count = count + 1
        self._end = end

    def list_near(
        self, bounds: Float64[np.ndarray, "4"], begin: int, end: int
    ) -> Int64[np.ndarray, " k"]:
        """Numbers of the bodies that may come within bounds at a step from `begin` to `end`.

        bounds: xmin, ymin, xmax, ymax (m)."""
        return np.flatnonzero(self.mask_near(slice(self._count), bounds, begin, end))

    def mask_near(
        self,
        bodies: Int64[np.ndarray, " n"] | slice,
        bounds: Float64[np.ndarray, "4"],
        begin: int,
        end: int,
    ) -> Bool[np.ndarray, " n"]:
        """Mask of bodies that may come within bounds at a step from `begin` to `end`.

        bodies: their numbers; bounds: xmin, ymin, xmax, ymax (m)."""
        spans = self._spans[bodies]
        extents = self._bounds[bodies]
        is_near = (spans[:, 0] <= end) & (spans[:, 1] >= begin)
        is_near &= (extents[:, :2] <= bounds[2:] + BODY_GAP_M).all(axis=1)
        is_near &= (extents[:, 2:] >= bounds[:2] - BODY_GAP_M).all(axis=1)
        return is_near

    def find_places(
        self, bodies: Int64[np.ndarray, " n"], steps: Int64[np.ndarray, " moments"]
    ) -> _Places:
        """Places of bodies at some steps, as far as each is there."""
        spans = self._spans[bodies]
        is_there = (steps >= spans[:, :1]) & (steps <= spans[:, 1:])
        number, moment = np.nonzero(is_there)
        rows = self._begins[bodies][number] + steps[moment] - spans[number, 0]
        return _Places(
            bodies[number], moment, pose=self._poses[rows], size=self._sizes[bodies][number]
        )


def _reserve(array: np.ndarray, count: int) -> np.ndarray:
    """Array with room for a count of rows: itself, or a larger one that begins with its rows."""
    if count <= len(array):
        return array
    larger = np.empty((max(count, 2 * len(array)), *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


class _LineSpans(NamedTuple):
    """Lines next to a course that are blocked, in a row for each body and section.

    Lines are numbered in steps from the first one, which may be parts of a step.

    Attributes:
        low: lowest number.
        high: highest number, below the lowest one if none is blocked."""

    low: Float64[np.ndarray, " pairs"]
    high: Float64[np.ndarray, " pairs"]

    @staticmethod
    def endless(count: int) -> "_LineSpans":
        """Spans without ends."""
        return _LineSpans(np.full(count, -np.inf), np.full(count, np.inf))

    def shorten(
        self,
        low: Float64[np.ndarray, " pairs"],
        high: Float64[np.ndarray, " pairs"],
        growth: Float64[np.ndarray, " pairs"],
    ) -> "_LineSpans":
        """Parts of the spans in which a distance is between two limits.

        low, high: limits less the distance at line 0; growth: growth of the distance with each
        line. Without growth both quotients are infinite, and have one sign if nothing is left."""
        with np.errstate(divide="ignore", invalid="ignore"):
            begin = low / growth
            end = high / growth
        return _LineSpans(
            np.fmax(self.low, np.minimum(begin, end)), np.fmin(self.high, np.maximum(begin, end))
        )

    def mask(
        self,
        shape: tuple[int, int, int],
        moment: Int64[np.ndarray, " pairs"],
        section: Int64[np.ndarray, " pairs"],
    ) -> Bool[np.ndarray, "moments k n"]:
        """Mask of the moments, lines and sections at which a line is blocked.

        shape: their numbers; moment, section: number of each for each row."""
        first = np.ceil(np.clip(self.low, 0, shape[1])).astype(np.int64)
        last = np.floor(np.clip(self.high, -1, shape[1] - 1)).astype(np.int64)
        rows = np.flatnonzero(first <= last)
        # each row begins at its first line and ends after its last one
        shape = (shape[0], shape[1] + 1, shape[2])
        size = int(np.prod(shape))
        counts = np.zeros(size, np.int64)
        for line, sign in ((first[rows], 1), (last[rows] + 1, -1)):
            cells = np.ravel_multi_index((moment[rows], line, section[rows]), shape)
            counts += sign * np.bincount(cells, minlength=size)
        return np.cumsum(counts.reshape(shape)[:, :-1], axis=1) > 0


class _Sections(NamedTuple):
    """Sections of a course: k boxes of one size on lines next to each other, with one heading.

    Attributes:
        first: x, y of the middle of each section's first box (m).
        step: vector from each line to the next (m).
        yaw: heading of each section (rad).
        half_size: half of length and width of the boxes (m), with the gap in which they block.
        max_extent: largest distance (m) from the middle of a box to what is within half of the gap.
        middle: x, y of the middle of each section (m).
        radius: radius (m) of a circle that holds all that is close to a section."""

    first: Float64[np.ndarray, "n 2"]
    step: Float64[np.ndarray, "n 2"]
    yaw: Float64[np.ndarray, " n"]
    half_size: tuple[float, float]
    max_extent: float
    middle: Float64[np.ndarray, "n 2"]
    radius: float

    @staticmethod
    def from_boxes(boxes: Float64[np.ndarray, "n k 7"], gap: float) -> "_Sections":
        """Sections of k boxes each. gap: distance (m) within which bodies are close to a box."""
        length, width = boxes[0, 0, 3:5].tolist()
        first = boxes[:, 0, :2]
        last = boxes[:, -1, :2]
        half_diagonal = float(np.hypot(length, width)) / 2
        spread = np.hypot(*(last - first).T).max() / 2
        return _Sections(
            first=first,
            step=(last - first) / max(1, boxes.shape[1] - 1),
            yaw=boxes[:, 0, 6],
            half_size=((length + gap) / 2, (width + gap) / 2),
            max_extent=half_diagonal + gap / 2,
            middle=(first + last) / 2,
            # a little more, so that rounding leaves nothing out
            radius=float(spread) + half_diagonal + 1.5 * gap + ROUNDING_M,
        )

    def find_near(
        self, places: _Places, sections: Int64[np.ndarray, " sections"]
    ) -> tuple[Int64[np.ndarray, " pairs"], Int64[np.ndarray, " pairs"]]:
        """Rows of places, and which of some sections each may be close to."""
        reach = self.radius + np.hypot(*places.size.T)[:, None] / 2
        dx = self.middle[sections, 0] - places.pose[:, 0, None]
        dy = self.middle[sections, 1] - places.pose[:, 1, None]
        place_row, column = np.nonzero(dx * dx + dy * dy < reach * reach)
        return place_row, sections[column]

    def find_close(
        self,
        places: _Places,
        place_row: Int64[np.ndarray, " pairs"],
        section: Int64[np.ndarray, " pairs"],
        gap: float,
    ) -> _LineSpans:
        """Lines on which a place is within the gap of a section's box, for each pair.

        Boxes are close unless an edge of one separates them, as `are_close` finds it but for
        corners. From line to line their offset grows evenly along the normal of each edge."""
        body_cos = np.cos(places.pose[:, 2])[place_row]
        body_sin = np.sin(places.pose[:, 2])[place_row]
        section_cos = np.cos(self.yaw)[section]
        section_sin = np.sin(self.yaw)[section]
        # cosine and sine of the angle between the two headings, without sign
        cos = np.abs(body_cos * section_cos + body_sin * section_sin)
        sin = np.abs(body_cos * section_sin - body_sin * section_cos)
        body_length, body_width = ((places.size + gap) / 2)[place_row].T
        length, width = self.half_size
        max_extent = self.max_extent
        spans = _LineSpans.endless(len(place_row))
        first = self.first[section]
        step = self.step[section]
        offset = first - places.pose[place_row, :2]
        # normals of the edges, and offsets along them up to which the boxes overlap
        body_ahead = np.stack([body_cos, body_sin], axis=1)
        body_left = np.stack([-body_sin, body_cos], axis=1)
        section_ahead = np.stack([section_cos, section_sin], axis=1)
        section_left = np.stack([-section_sin, section_cos], axis=1)
        reaches = (
            (body_ahead, body_length + np.minimum(length * cos + width * sin, max_extent)),
            (body_left, body_width + np.minimum(length * sin + width * cos, max_extent)),
            (section_ahead, length + body_length * cos + body_width * sin),
            (section_left, width + body_length * sin + body_width * cos),
        )
        for normal, reach in reaches:
            distance = offset[:, 0] * normal[:, 0] + offset[:, 1] * normal[:, 1]
            growth = step[:, 0] * normal[:, 0] + step[:, 1] * normal[:, 1]
            spans = spans.shorten(-reach - distance, reach - distance, growth)
        # close boxes are also within the gap of the covered ground along x and along y
        box_radius = self.max_extent + gap / 2
        extents = places.measure_extents()[place_row]
        for axis in (0, 1):
            low = extents[:, axis] - box_radius - first[:, axis]
            high = extents[:, axis + 2] + box_radius - first[:, axis]
            spans = spans.shorten(low, high, step[:, axis])
        return spans


def size_boxes(poses: Float64[np.ndarray, "n 3"], size: Float64[np.ndarray, "3"]) -> LevelBoxes:
    """Boxes of one body on level ground, one for each pose.

    poses: x, y (m), yaw (rad); size: length, width, height (m)."""
    return place_boxes(poses, np.tile(size, (len(poses), 1)))


def _mask_within(places: _Places, bounds: Float64[np.ndarray, "4"]) -> Bool[np.ndarray, " k"]:
    """Mask of the places at which a body may reach into bounds: xmin, ymin, xmax, ymax (m)."""
    radius = np.hypot(*places.size.T)[:, None] / 2
    is_within = (places.pose[:, :2] > bounds[:2] - radius).all(axis=1)
    return is_within & (places.pose[:, :2] < bounds[2:] + radius).all(axis=1)


def _radius(size: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n"]:
    """Largest distance (m) from the middle of a body to any place within `BODY_GAP_M` of it.

    size: length and width of each body (m)."""
    return np.hypot(size[..., 0], size[..., 1]) / 2 + BODY_GAP_M


def _bounds(boxes: LevelBoxes) -> Float64[np.ndarray, "4"]:
    """Lowest and highest x and y (m) that boxes may reach: xmin, ymin, xmax, ymax."""
    radius = float(np.hypot(boxes[:, 3], boxes[:, 4]).max()) / 2
    low = boxes[:, :2].min(axis=0) - radius
    return np.concatenate([low, boxes[:, :2].max(axis=0) + radius])
