"""Places: a detection area and its level ground, z = 0, on which points are put.

A detector that learnt on ground at z = 0 finds nothing in a raw cloud, whose origin is the lidar. A
recording of a known site defines its ground. For any other recording the ground is found first
(`toolkit.calibration.ground`), in every frame, or once if the sensors do not move. Detectors work
in float32 around a nearby origin: points are counted from the middle of the area, and boxes are
moved back into the frame's world."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal

import numpy as np

from toolkit.arrays import Float, Float32, Float64, Points
from toolkit.calibration.ground import Ground, level
from toolkit.calibration.level_warning import level_warning
from toolkit.calibration.levels import describe_levels
from toolkit.frame import Frame
from toolkit.objects import Detections
from toolkit.points import Area, Crop
from toolkit.sites.site import Site, check_area

Level = Literal["map", "plane", "none"]
Corners = tuple[float, float, float, float]
LEVELS: tuple[Level, ...] = ("map", "plane", "none")
DETECTION_REACH_M = 50.0  # around the sensors, if no area is given
CROP_HEIGHT_M = 4.0  # as in the paper's crop
GROUND_MARGINS_M = (0.0, 5.0, 20.0)  # around the area, in which its ground is looked for
MIN_GROUND_SQUARES = 150  # least number of squares, a metre wide, with points to find ground by
ROW_STRIDE = 1 << 20  # more squares than a row of an area has, so that each has its number


@dataclass(frozen=True)
class Stand:
    """Ground and area of one frame.

    Attributes:
        area: a site, or xmin ymin xmax ymax (m) around the middle.
        middle: x and y, world frame, from which points are counted.
        ground: ground in the frame that is counted from the middle, None if it is z = 0 already.
        warning: warning of ground that is not level, or that was not found; None without one.
        ms: time that finding the ground took.
    """

    area: Area
    middle: Float64[np.ndarray, "2"]
    ground: Ground | None = None
    warning: str | None = None
    ms: float = 0.0

    @property
    def corners(self) -> Float64[np.ndarray, "4"]:
        """Corners of the area: xmin, ymin, xmax, ymax (m), world frame."""
        area = self.area.area if isinstance(self.area, Site) else np.asarray(self.area, np.float64)
        return area + np.concatenate([self.middle, self.middle])

    def lift(self, points: Float64[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        """Put points (m, world frame) on level ground, counted from the middle of the area."""
        from_middle = points - [*self.middle, 0.0]
        if self.ground is not None and len(from_middle):
            from_middle = self.ground.points(from_middle)
        return from_middle.astype(np.float32)

    def put_back(self, detections: Detections) -> Detections:
        """Return detections, made in lifted points, in the world frame.

        At a site they are returned as they are, since lifting does not move points there."""
        if isinstance(self.area, Site):
            return detections
        boxes = detections.boxes
        if self.ground is not None and len(detections):
            boxes = self.ground.boxes_back(boxes)
        # only x and y, the first two columns of boxes, are counted from the middle
        return replace(detections, boxes=boxes + np.array([*self.middle, 0, 0, 0, 0, 0]))


@dataclass(frozen=True)
class Place:
    """Detection area and its ground."""

    level: Level | None = None
    """Ground: a map of heights, a plane, or none for ground at z = 0; map when left out, none at a
    known site."""
    still: bool = False
    """Find the ground once, because the sensors do not move."""
    area: Corners | None = None
    """Area xmin ymin xmax ymax (m, world frame); the site's, or 50 m around the sensors, when left
    out."""

    def __post_init__(self) -> None:
        if self.level is not None and self.level not in LEVELS:
            raise ValueError(f"level must be one of {', '.join(LEVELS)}, got {self.level!r}")
        if self.area is not None:
            check_area(self.area)

    @property
    def half(self) -> tuple[float, float]:
        """Half the sides of the area along x and y (m)."""
        if self.area is None:
            return DETECTION_REACH_M, DETECTION_REACH_M
        xmin, ymin, xmax, ymax = self.area
        return (xmax - xmin) / 2, (ymax - ymin) / 2

    def find_middle(self, frame: Frame) -> Float64[np.ndarray, "2"]:
        """Return x and y (m, world frame) of the middle of the area.

        Without an area, it is the mean position of the frame's sensors, rounded to metres; without
        sensors, the origin."""
        if self.area is not None:
            return (np.array(self.area[:2]) + np.array(self.area[2:])) / 2
        positions = [sensor.position[:2] for sensor in frame.sensors]
        if not positions:
            return np.zeros(2)
        return np.asarray(np.round(np.mean(positions, axis=0)), np.float64)

    def uses_site(self, site: Site | None) -> bool:
        """Return True if detection uses the site's ground and area.

        site: None if the recording's site is unknown."""
        return site is not None and self.level is None and self.area is None

    def find_ground(self, points: Points, method: Literal["map", "plane"]) -> Ground:
        """Find the ground below points, of the area only if one is given.

        points: (n, 3) m, counted from the middle of the area; method: see
        `toolkit.calibration.ground.level`. If the area has too few points, those around it count
        too. Raises ValueError if no ground is found."""
        if self.area is None:
            return level(points, method=method)
        half = np.array(self.half)
        xy = points[:, :2]
        column, row = np.floor(xy.T)  # indices of each point's square, a metre wide
        for margin in GROUND_MARGINS_M:
            is_inside = (np.abs(xy) <= half + margin).all(axis=1)
            # one number for each square, far quicker to sort than pairs of numbers
            squares = column[is_inside] * ROW_STRIDE + row[is_inside]
            if len(np.unique(squares)) >= MIN_GROUND_SQUARES:
                return level(points[is_inside], method=method)
        return level(points, method=method)

    def stands(
        self, frames: Iterable[Frame], site: Site | None = None
    ) -> Iterator[tuple[Frame, Stand]]:
        """Yield every frame with its ground and area.

        site: known site of the frames, None without one. Ground is found in each frame, or once if
        sensors stand still. If it is not level or not found, the result has a warning."""
        if site is not None and self.uses_site(site):
            yield from ((frame, Stand(site, np.zeros(2))) for frame in frames)
            return
        half_x, half_y = self.half
        still_ground: Ground | None = None
        method = self.level or ("map" if site is None else "none")
        for frame in frames:
            middle = self.find_middle(frame)
            start = perf_counter()
            ground = still_ground
            warning = None
            # points are read only if the ground is not known yet
            points = frame.points() - [*middle, 0.0] if still_ground is None else np.zeros((0, 3))
            if method == "none":
                warning = level_warning(points) if len(points) else None
            elif len(points):
                try:
                    ground = self.find_ground(points, method)
                    warning = describe_levels(ground.levels)
                except ValueError as error:
                    warning = f"not levelled: {error}"
            still_ground = ground if self.still else None
            ms = 1e3 * (perf_counter() - start)
            area = np.array([-half_x, -half_y, half_x, half_y])
            yield frame, Stand(area, middle, ground=ground, warning=warning, ms=ms)


def crop_points(points: Points, area: Area) -> Float[np.ndarray, "_ 3"]:
    """Return the points in an area, above its ground and below `CROP_HEIGHT_M`.

    points: m, on level ground, counted from the middle of the area, or in a known site's frame."""
    return points[Crop.from_place(area, CROP_HEIGHT_M).holds(points)]
