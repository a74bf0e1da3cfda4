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
    """Return the points of each sensor inside the detection area, world frame, (n, 3) each.

    Args:
        frame: Measurements of all sensors at one time.
        sensors: Indices or names; None for all.
        area: Site, or xmin, ymin, xmax, ymax (m).
        height: Points with 0 < z < height (m) stay; the site's by default, else 4 m. On a site that
            slopes, z counts from its plane.
        rng: Draws the sensors' noise; without one the measurements are taken as they are.

    Raises:
        ValueError: A sensor is unknown, or the area is empty.
    """
    crop = Crop.from_place(area, height)
    return [
        crop_sensor(frame, index, crop, rng) for index in select_sensors(frame.sensors, sensors)
    ]


def crop_sensor(
    frame: Frame, index: int, crop: "Crop", rng: Rng | None = None
) -> Float32[np.ndarray, "_ 3"]:
    """Return the points (n, 3) of sensor number `index` inside a crop, world frame.

    rng: draws the noise of an image, None for none; recorded clouds get no noise.
    """
    sensor = frame.sensors[index]
    measurement = frame.measurements[index]
    if isinstance(measurement, SensorCloud):
        points = measurement.in_world()
        return points[crop.holds(points)].astype(np.float32)
    if rng is not None:
        measurement = sensor.model.noisy(measurement, rng)
    shift = frame.shifts[index] if frame.shifts else None
    xyz, pixels = crop_image(sensor, measurement, crop, shift=shift)
    return np.ascontiguousarray(xyz.take(pixels, axis=1).T)


class Crop(NamedTuple):
    """Area (xmin ymin xmax ymax, m), height (m) and slope."""

    area: tuple[float, ...]
    height: float
    slope: Slope = LEVEL

    @staticmethod
    def from_place(place: Area, height: float | None = None) -> "Crop":
        """Return the crop of a site or an area (xmin, ymin, xmax, ymax, m) below `height` (m).

        The height is the site's by default, else 4 m (paper section II-B).
        """
        if height is not None and np.isnan(height):
            raise ValueError("height must be a number of metres, got NaN")
        if isinstance(place, Site):
            area, default_height = place.area, place.height
        else:
            area, default_height = check_area(place), 4.0
        top = default_height if height is None else height
        return Crop(tuple(area.tolist()), height=top, slope=get_slope(place))

    def holds(self, points: Points, floor: float = 0.0) -> Mask:
        """Return the mask of points (world frame) inside, at floor < z < height."""
        levelled = points if self.slope == LEVEL else level_rows(points, self.slope)
        return is_inside(levelled, np.array(self.area), self.height, floor)


def crop_image(
    sensor: Sensor,
    measurement: Float32[np.ndarray, "rows columns"],
    crop: Crop,
    *,
    shift: ImageVectors | None = None,
) -> tuple[Float32[np.ndarray, "3 pixels"], Int64[np.ndarray, " n"]]:
    """Return x, y, z in the world of every pixel, and the numbers of pixels inside the crop.

    Pixels are numbered row by row. shift: displacement of each pixel's point (m, world frame), None
    for none.
    """
    xyz, valid = unproject(sensor, measurement, shift)
    return xyz, np.flatnonzero(valid & crop.holds(xyz.T))


def is_inside(
    points: Points, area: Float64[np.ndarray, "4"], height: float = 4.0, floor: float = 0.0
) -> Mask:
    """Return the mask of points in the area and between `floor` and `height` (m).

    The area's edge (xmin, ymin, xmax, ymax, m) is included, floor and height are not, as in the
    published code.
    """
    x, y, z = points.T
    xmin, ymin, xmax, ymax = area.tolist()
    is_in_area = (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)
    return is_in_area & (z > floor) & (z < height)


def count_on_ground(
    points: Points, boxes: Float64[np.ndarray, "m 7"], place: Area
) -> Int64[np.ndarray, " m"]:
    """Return the number of points in each box, on level ground if the place slopes."""
    slope = get_slope(place)
    return count_points(level_rows(points, slope), level_rows(boxes, slope))


def detect_on_ground(
    detector: Detector, points: Float32[np.ndarray, "n 3"], place: Area
) -> Detections:
    """Run a detector on levelled points, and return its boxes on the ground of the place.

    points: world frame; place: site, or a plain area, which is level."""
    slope = get_slope(place)
    if slope == LEVEL:
        return detector(points)
    detections = detector(level_rows(points, slope))
    return replace(detections, boxes=tilt_rows(detections.boxes, slope))


def detect_unions_on_ground(
    detector: UnionDetector,
    clouds: Sequence[Float32[np.ndarray, "_ 3"]],
    unions: Bool[np.ndarray, "unions clouds"],
    place: Area,
) -> list[Detections]:
    """Run a detector on each union of some clouds; return its boxes on the ground of the place.

    The detector gets levelled points. clouds: points of each sensor, world frame; unions: a row
    for each union, True for its clouds.
    """
    slope = get_slope(place)
    level_clouds = [level_rows(cloud, slope) for cloud in clouds]
    level_detections = detector.unions(level_clouds, unions)
    return [
        replace(detections, boxes=tilt_rows(detections.boxes, slope))
        for detections in level_detections
    ]


def join_clouds(
    clouds: Sequence[Float[np.ndarray, "_ 3"]], union: Bool[np.ndarray, " clouds"]
) -> Points:
    """Return the points of the clouds that `union` marks, in their order."""
    members = [cloud for cloud, is_member in zip(clouds, union, strict=True) if is_member]
    return np.concatenate(members) if members else np.zeros((0, 3), np.float32)


def has_centre_inside(boxes: BoxRows, area: Float64[np.ndarray, "4"]) -> Mask:
    """Return the mask of boxes with their centre in the area (xmin, ymin, xmax, ymax, m)."""
    x, y = boxes[:, :2].T
    xmin, ymin, xmax, ymax = area.tolist()
    return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)


def is_beyond(
    points: Points, sensor: Sensor | Pose, radius: float, metric: Distance = "horizontal"
) -> Mask:
    """Return the mask of points outside a circle about a sensor (paper section II-E).

    Args:
        points: World frame.
        sensor: Sensor, or the pose of a camera (world_SE3_camera).
        radius: m.
        metric: "horizontal" measures in the world's horizontal plane, as the paper states;
            "published" in the plane of the sensor's forward and sideways axes, which tilts with
            it, as its code does.
    """
    if not radius >= 0:
        raise ValueError(f"radius must be at least 0 m, got {radius}")
    if metric == "horizontal":  # camera and body of a sensor have one position
        pose = sensor.pose if isinstance(sensor, Sensor) else sensor
        sensor_xy = np.asarray(pose)[:2, 3]
        offsets = points[:, :2] - sensor_xy
    elif metric == "published":
        if isinstance(sensor, Sensor):
            world_SE3_body = sensor.world_SE3_body
        else:
            world_SE3_body = sensor @ invert(BODY_SE3_CAMERA)
        forward_and_left = world_SE3_body[:3, :2]
        offsets = (points - world_SE3_body[:3, 3]) @ forward_and_left
    else:
        raise ValueError(f'metric must be "horizontal" or "published", got {metric!r}')
    return np.einsum("ij,ij->i", offsets, offsets) > radius**2


def get_slope(place: Area) -> Slope:
    """Return the slope of a site's ground (m per m along x and y); level for a plain area."""
    return place.relief.slope if isinstance(place, Site) else LEVEL
