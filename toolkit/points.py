"""Points in the world frame as plain (n, 3) float32 arrays: measured by which sensor, inside which area, how far away.

This is the fast path of every evaluation, and needs NumPy only; `toolkit.clouds` offers the same on Open3D clouds.
Per sensor the rays are turned into the world once and kept, so that a frame costs one multiplication, one addition and
one comparison per coordinate (paper equations 1 and 2 and the crop of section II-B).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Int64
from toolkit.boxes import count_points
from toolkit.frame import Frame
from toolkit.geometry import BODY_SE3_CAMERA, LEVEL, Slope, invert, levelled, on_slope
from toolkit.objects import Detections, Detector, UnionDetector
from toolkit.sensors.sensor import Sensor, returned
from toolkit.sites.site import Site, check_area

Distance = Literal["horizontal", "published"]
Area = Site | Sequence[int | float] | Float[np.ndarray, "4"]


def frame_points(
    frame: Frame,
    sensors: Sequence[int | str] | None = None,
    *,
    area: Area,
    height: float | None = None,
    rng: np.random.Generator | None = None,
) -> list[Float32[np.ndarray, "_ 3"]]:
    """What each sensor would send: its points inside the detection area, world frame, one (n, 3) array per sensor.

    sensors: indices or names, None for all; area: a site, or xmin, ymin, xmax, ymax (m); points with
    0 < z < height stay, by default the site's own height, else 4 m; z counts from the plane of a site that slopes.
    rng draws the sensors' noise; without one the measurements are taken as they are.
    Raises ValueError for a sensor the frame does not have and for an area that is none.
    """
    crop, clouds = Crop.of(area, height), []
    for index in select_sensors(frame.sensors, sensors):
        sensor, measurement = frame.sensors[index], frame.measurements[index]
        if rng is not None:
            measurement = sensor.model.noisy(measurement, rng)
        shift = frame.shifts[index] if frame.shifts else None
        xyz, keep = cropped(sensor, measurement, crop, shift=shift)
        clouds.append(np.ascontiguousarray(xyz.take(keep, axis=1).T))
    return clouds


def cropped_pixels(frame: Frame, sensor: int, *, area: Area, height: float | None = None) -> Int64[np.ndarray, " n"]:
    """The pixels, counted row after row, whose points `frame_points` has of a sensor (index), in the same order."""
    shift = frame.shifts[sensor] if frame.shifts else None
    return cropped(frame.sensors[sensor], frame.measurements[sensor], Crop.of(area, height), shift=shift)[1]


class Crop(NamedTuple):
    """What is kept: points in the area (xmin ymin xmax ymax, m), up to a height (m) over the plane that the ground
    slopes with."""

    area: tuple[float, ...]
    height: float
    slope: Slope = LEVEL

    @staticmethod
    def of(place: Area, height: float | None = None) -> Crop:
        """Of a site or an area, up to the height given, else the site's own, else 4 m."""
        return Crop(tuple(area_of(place).tolist()), height_of(place, height), slope_of(place))

    def holds(self, points: Float[np.ndarray, "n 3"], floor: float = 0.0) -> Bool[np.ndarray, " n"]:
        """Which points, world frame, it keeps; floor: in place of the ground."""
        return inside(levelled(points, self.slope), np.array(self.area), self.height, floor)


def cropped(
    sensor: Sensor,
    measurement: Float32[np.ndarray, "rows columns"],
    crop: Crop,
    *,
    shift: Float32[np.ndarray, "rows columns 3"] | None = None,
) -> tuple[Float32[np.ndarray, "3 pixels"], Int64[np.ndarray, " n"]]:
    """x, y and z in the world of every pixel, row after row, and which of them are kept; shift: see `Frame.shifts`."""
    xyz, valid = unproject(sensor, measurement)
    if shift is not None:
        xyz += shift.reshape(-1, 3).T
    return xyz, np.flatnonzero(valid & crop.holds(xyz.T))


def unproject(
    sensor: Sensor, measurement: Float[np.ndarray, "rows columns"]
) -> tuple[Float32[np.ndarray, "3 pixels"], Bool[np.ndarray, " pixels"]]:
    """x, y and z in the world of every pixel, row after row of the image, and which of them returned anything."""
    if measurement.shape != sensor.model.shape:
        raise ValueError(
            f"sensor {sensor.name!r} measures {sensor.model.shape} pixels, got an image of {measurement.shape}"
        )
    if np.abs(sensor.position).max() > 1e5:
        raise ValueError(
            f"sensor {sensor.name!r} stands at {sensor.position.tolist()}, too far from the origin for float32 points: "
            "take coordinates from an origin near the site"
        )
    flat = np.asarray(measurement, np.float32).ravel()
    valid = returned(flat, sensor.model.max_range)
    xyz = sensor.world_rays * np.where(valid, flat, np.float32(0))
    xyz += sensor.position.astype(np.float32)[:, None]
    return xyz, valid


def inside(
    points: Float[np.ndarray, "n 3"], area: Float64[np.ndarray, "4"], height: float = 4.0, floor: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Which points lie in the area (its edge included) and strictly between `floor` and `height`, as published.

    >>> inside(np.array([[0, 0, 1], [9, 0, 1], [0, 0, 4.0]]), np.array([-1.0, -1, 1, 1]))
    array([ True, False, False])
    """
    x, y, z = points.T
    xmin, ymin, xmax, ymax = area.tolist()
    return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax) & (z > floor) & (z < height)


def points_on(
    points: Float[np.ndarray, "n 3"], boxes: Float64[np.ndarray, "m 7"], place: Area
) -> Int64[np.ndarray, " m"]:
    """Number of points inside each box, as `toolkit.boxes.count_points`. Where the site slopes bodies slope with it, so
    both are taken as on level ground."""
    slope = slope_of(place)
    return count_points(levelled(points, slope), levelled(boxes, slope))


def detect_on_ground(detector: Detector, points: Float32[np.ndarray, "n 3"], place: Area) -> Detections:
    """What a detector, which knows level ground at z = 0 only, says of points of a place that may slope; its boxes come
    back upright on the slope."""
    slope = slope_of(place)
    detections = detector(levelled(points, slope))
    return detections if slope == LEVEL else replace(detections, boxes=on_slope(detections.boxes, slope))


def detect_unions_on_ground(
    detector: UnionDetector, clouds: Sequence[Float32[np.ndarray, "_ 3"]], unions: Bool[np.ndarray, "U C"], place: Area
) -> list[Detections]:
    """`detect_on_ground` in many unions of the same clouds."""
    slope = slope_of(place)
    found = detector.unions([levelled(cloud, slope) for cloud in clouds], unions)
    return [each if slope == LEVEL else replace(each, boxes=on_slope(each.boxes, slope)) for each in found]


def union_of(clouds: Sequence[Float[np.ndarray, "_ 3"]], union: Bool[np.ndarray, " C"]) -> Float[np.ndarray, "n 3"]:
    """The points of the clouds of a union together, in their order.

    >>> union_of([np.zeros((2, 3)), np.ones((1, 3)), np.zeros((4, 3))], np.array([True, True, False])).shape
    (3, 3)
    """
    among = [cloud for cloud, chosen in zip(clouds, union, strict=True) if chosen]
    return np.concatenate(among) if among else np.zeros((0, 3), np.float32)


def centred_in(boxes: Float64[np.ndarray, "n 7"], area: Float64[np.ndarray, "4"]) -> Bool[np.ndarray, " n"]:
    """Which boxes have their centre in the area, its edge included, at any height."""
    (x, y), (xmin, ymin, xmax, ymax) = boxes[:, :2].T, area.tolist()
    return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)


def beyond(
    points: Float[np.ndarray, "n 3"],
    sensor: Sensor | Float[np.ndarray, "4 4"],
    radius: float,
    metric: Distance = "horizontal",
) -> Bool[np.ndarray, " n"]:
    """Which points, world frame, lie outside a circle of `radius` (m) about a sensor, or about a camera's pose.

    Hybrid fusion sends these (paper section II-E). "horizontal" measures in the world's horizontal plane, as the paper
    says; "published" in the plane of the sensor's forward and sideways axes, tilted with it, as its code does.
    """
    if not radius >= 0:
        raise ValueError(f"radius must be at least 0 m, got {radius}")
    body = sensor.world_SE3_body if isinstance(sensor, Sensor) else sensor @ invert(BODY_SE3_CAMERA)
    if metric == "horizontal":
        across = points[:, :2] - body[:2, 3]
    elif metric == "published":
        across = (points - body[:3, 3]) @ body[:3, :2]
    else:
        raise ValueError(f'metric must be "horizontal" or "published", got {metric!r}')
    return np.einsum("ij,ij->i", across, across) > radius**2


def select_sensors(available: Sequence[Sensor], wanted: Sequence[int | str] | None = None) -> list[int]:
    """Positions in `available` of the sensors named or numbered in `wanted`, None for all.

    Raises ValueError that lists what there is, for one that is not there; and for one that is chosen twice, or a name
    that two of them have.
    """
    names = [sensor.name for sensor in available]
    if len(set(names)) < len(names):
        raise ValueError(f"every sensor needs a name of its own, got {', '.join(names)}: rename those that share one")
    if wanted is None:
        return list(range(len(names)))
    if isinstance(wanted, str):
        raise ValueError(f"sensors must be a list of numbers or names, got the text {wanted!r}: pass [{wanted!r}]")
    chosen = [_position(names, which) for which in wanted]
    if len(set(chosen)) < len(chosen):
        raise ValueError(f"a sensor can be chosen once only, got {list(wanted)}: leave out what is there twice")
    return chosen


def _position(names: list[str], which: int | str) -> int:
    if isinstance(which, str) and which in names:
        return names.index(which)
    if isinstance(which, int | np.integer) and 0 <= which < len(names):
        return int(which)
    raise ValueError(f"no sensor {which!r}: choose among 0..{len(names) - 1} or {', '.join(names)}")


def area_of(place: Area) -> Float64[np.ndarray, "4"]:
    """xmin, ymin, xmax, ymax (m) of a site, or these numbers themselves; ValueError if they enclose nothing."""
    return place.area if isinstance(place, Site) else check_area(place)


def slope_of(place: Area) -> Slope:
    """How the ground of a site rises along x and y (m per m); level where only an area is known."""
    return place.relief.slope if isinstance(place, Site) else LEVEL


def height_of(place: Area, height: float | None = None) -> float:
    """The height (m) up to which points are kept: the one given, else a site's own, else 4 m (paper section II-B)."""
    if height is not None:
        if np.isnan(height):
            raise ValueError("height must be a number of metres, got NaN")
        return height
    return place.height if isinstance(place, Site) else 4.0
