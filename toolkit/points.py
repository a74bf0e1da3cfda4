"""Points in the world frame as plain (n, 3) float32 arrays: by sensor, area and distance.

This is the fast path of every evaluation; `toolkit.clouds` offers the same on Open3D clouds. The
rays of a sensor are turned into the world once and kept, so that a frame costs one multiplication,
one addition and one comparison per coordinate (paper equations 1 and 2 and the crop of section
II-B)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from toolkit.arrays import (
    Bool,
    BoxRows,
    Float,
    Float32,
    Float64,
    ImageVectors,
    Int64,
    Mask,
    Points,
    Pose,
    Rng,
)
from toolkit.boxes import count_points
from toolkit.frame import Frame, SensorCloud, select_sensors, unproject
from toolkit.geometry import BODY_SE3_CAMERA, LEVEL, Slope, invert, level_rows, tilt_rows
from toolkit.objects import Detections, Detector, UnionDetector
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, check_area

Distance = Literal["horizontal", "published"]
Area = Site | Sequence[int | float] | Float[np.ndarray, "4"]


def frame_points(
    frame: Frame,
    sensors: Sequence[int | str] | None = None,
    *,
    area: Area,
    height: float | None = None,
    rng: Rng | None = None,
) -> list[Float32[np.ndarray, "_ 3"]]:
    """Points of each sensor inside the detection area, world frame: an (n, 3) array per sensor.

    sensors: indices or names, None for all; area: a site, or xmin, ymin, xmax, ymax (m); points
    with 0 < z < height stay, by default the site's own height, else 4 m; z counts from the plane of
    a site that slopes. rng draws the sensors' noise; without one the measurements are taken as they
    are. Raises ValueError for an unknown sensor or an empty area."""
    crop = Crop.of(area, height)
    return [
        crop_sensor(frame, index, crop, rng) for index in select_sensors(frame.sensors, sensors)
    ]


def crop_sensor(
    frame: Frame, index: int, crop: "Crop", rng: Rng | None = None
) -> Float32[np.ndarray, "_ 3"]:
    """Points of one sensor inside a crop, see `frame_points`."""
    sensor = frame.sensors[index]
    measurement = frame.measurements[index]
    if isinstance(measurement, SensorCloud):
        points = measurement.in_world()
        return points[crop.holds(points)].astype(np.float32)
    if rng is not None:
        measurement = sensor.model.noisy(measurement, rng)
    xyz, keep = crop_image(
        sensor, measurement, crop, shift=frame.shifts[index] if frame.shifts else None
    )
    return np.ascontiguousarray(xyz.take(keep, axis=1).T)


class Crop(NamedTuple):
    """Area (xmin ymin xmax ymax, m), height (m) and slope."""

    area: tuple[float, ...]
    height: float
    slope: Slope = LEVEL

    @staticmethod
    def of(place: Area, height: float | None = None) -> "Crop":
        """Crop of a site or an area below `height`, by default the site's own, else 4 m (paper
        section II-B)."""
        if height is not None and np.isnan(height):
            raise ValueError("height must be a number of metres, got NaN")
        area, default_height = (
            (place.area, place.height) if isinstance(place, Site) else (check_area(place), 4.0)
        )
        return Crop(
            tuple(area.tolist()), default_height if height is None else height, get_slope(place)
        )

    def holds(self, points: Points, floor: float = 0.0) -> Mask:
        """Mask of kept points (world). floor: in place of ground."""
        level = points if self.slope == LEVEL else level_rows(points, self.slope)
        return is_inside(level, np.array(self.area), self.height, floor)


def crop_image(
    sensor: Sensor,
    measurement: Float32[np.ndarray, "rows columns"],
    crop: Crop,
    *,
    shift: ImageVectors | None = None,
) -> tuple[Float32[np.ndarray, "3 pixels"], Int64[np.ndarray, " n"]]:
    """x, y, z in the world of every pixel, and rows of the kept ones. shift: see `Frame.shifts`."""
    xyz, valid = unproject(sensor, measurement, shift)
    return xyz, np.flatnonzero(valid & crop.holds(xyz.T))


def is_inside(
    points: Points, area: Float64[np.ndarray, "4"], height: float = 4.0, floor: float = 0.0
) -> Mask:
    """Mask of points in the area, its edge included, and between `floor` and `height`, both
    excluded, as published."""
    x, y, z = points.T
    xmin, ymin, xmax, ymax = area.tolist()
    return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax) & (z > floor) & (z < height)


def count_on_ground(
    points: Points, boxes: Float64[np.ndarray, "m 7"], place: Area
) -> Int64[np.ndarray, " m"]:
    """Number of points in each box, levelled on a slope."""
    slope = get_slope(place)
    return count_points(level_rows(points, slope), level_rows(boxes, slope))


def detect_on_ground(
    detector: Detector, points: Float32[np.ndarray, "n 3"], place: Area
) -> Detections:
    """Run a detector of level ground on ground that slopes."""
    slope = get_slope(place)
    if slope == LEVEL:
        return detector(points)
    detections = detector(level_rows(points, slope))
    return replace(detections, boxes=tilt_rows(detections.boxes, slope))


def detect_unions_on_ground(
    detector: UnionDetector,
    clouds: Sequence[Float32[np.ndarray, "_ 3"]],
    unions: Bool[np.ndarray, "U C"],
    place: Area,
) -> list[Detections]:
    """Run `detect_on_ground` on many unions of the same clouds."""
    slope = get_slope(place)
    level_detections = detector.unions([level_rows(cloud, slope) for cloud in clouds], unions)
    return [
        replace(detections, boxes=tilt_rows(detections.boxes, slope))
        for detections in level_detections
    ]


def join_clouds(
    clouds: Sequence[Float[np.ndarray, "_ 3"]], union: Bool[np.ndarray, " C"]
) -> Points:
    """Join the clouds of a union, in their order."""
    members = [cloud for cloud, is_member in zip(clouds, union, strict=True) if is_member]
    return np.concatenate(members) if members else np.zeros((0, 3), np.float32)


def has_centre_inside(boxes: BoxRows, area: Float64[np.ndarray, "4"]) -> Mask:
    """Mask of boxes with their centre in the area."""
    (x, y), (xmin, ymin, xmax, ymax) = boxes[:, :2].T, area.tolist()
    return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)


def is_beyond(
    points: Points, sensor: Sensor | Pose, radius: float, metric: Distance = "horizontal"
) -> Mask:
    """Mask of points outside a circle of `radius` (m) about a sensor or a camera's pose (paper
    section II-E). "horizontal" measures in the world's horizontal plane, as the paper says;
    "published" in the plane of the sensor's forward and sideways axes, tilted with it, as its code
    does."""
    if not radius >= 0:
        raise ValueError(f"radius must be at least 0 m, got {radius}")
    if metric == "horizontal":  # a sensor stands where its body does
        across = (
            points[:, :2] - np.asarray(sensor.pose if isinstance(sensor, Sensor) else sensor)[:2, 3]
        )
    elif metric == "published":
        body = (
            sensor.world_SE3_body
            if isinstance(sensor, Sensor)
            else sensor @ invert(BODY_SE3_CAMERA)
        )
        across = (points - body[:3, 3]) @ body[:3, :2]
    else:
        raise ValueError(f'metric must be "horizontal" or "published", got {metric!r}')
    return np.einsum("ij,ij->i", across, across) > radius**2


def get_slope(place: Area) -> Slope:
    """Slope of a place (m per m)."""
    return place.relief.slope if isinstance(place, Site) else LEVEL
