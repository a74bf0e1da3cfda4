"""Sensors: the `SensorModel` protocol, what all models share, and `Sensor`, a model at a pose.

`rays()` gives a vector per pixel in the sensor's frame, scaled so that

    point = measurement · ray                                    (paper equation 2 for the camera)
    point in the world = measurement · (R ray) + t               (paper equation 1; R ray is
                                                                 `Sensor.world_rays`)

A model that measures "depth" has rays of length 1 along its optical axis, one that measures "range"
rays of length 1. A measurement that is NaN, infinite, zero or negative is no return and makes no
point. A model is a frozen dataclass whose fields all have defaults: files hold them under the name
of its class (`models.register_sensor_model`)."""

import json
from collections.abc import Sequence
from dataclasses import Field, asdict, dataclass, field, fields
from functools import cached_property
from hashlib import sha256
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import (
    Bool,
    Float,
    Float32,
    Float64,
    ImageRanges,
    ImageVectors,
    Int64,
    Pose,
    Rng,
)
from toolkit.display import Table
from toolkit.frozen import set_fields
from toolkit.geometry import check_pose, invert

NEAR = 0.3  # m; nothing nearer returns, so a sensor does not see its post
MAX_RAYS = 1 << 23  # for one sensor; a camera of 3840 x 2160 pixels fits

Measure = Literal["depth", "range"]
Deviation = np.ndarray | np.float32


@runtime_checkable
class SensorModel(Protocol):
    """Rays, field of view and noise of a sensor."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __hash__(self) -> int:
        """Hash by value, so that equal models share rays."""

    @property
    def kind(self) -> str:
        """Short word for names of candidates, such as "camera"."""

    @property
    def measures(self) -> Measure:
        """ "depth" along the optical axis, or "range" along each ray."""

    @property
    def body_SE3_sensor(self) -> np.ndarray:
        """Pose of its frame in its body's, (4, 4). A body has x forward (the optical axis), y left,
        z up."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a measurement."""

    @property
    def horizontal_fov(self) -> float:
        """Width of the field of view (rad) about the optical axis."""

    @property
    def vertical_fov(self) -> float:
        """Height of the field of view (rad)."""

    @property
    def max_range(self) -> float:
        """Measurement (m) from which on nothing returns."""

    def rays(self) -> ImageVectors:
        """Ray per pixel, sensor frame."""

    def deviation(self, measurement: Float[np.ndarray, "*shape"]) -> Deviation:
        """Standard deviation (m) of each measurement's noise. float32; one number if all are the
        same."""

    def noisy(self, measurement: Float[np.ndarray, "rows columns"], rng: Rng) -> ImageRanges:
        """Add the model's normal noise to an image; pixels without return become 0."""

    def in_view(self, points: Float64[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Mask of points (m, sensor frame) in its field of view and range."""

    def windows(self, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
        """Rectangles of pixels around boxes: columns row, top, bottom, left, right.

        sensor_corners: corners of each box (m, sensor frame). row: row of the box in it; top to
        bottom and left to right are ranges of image rows and columns, the ends excluded. Rays
        outside a box's rectangles do not meet it. A box may come more than once, as across the
        seam of a spinning lidar, or not at all."""


def is_return(
    measurement: Float[np.ndarray, "*shape"], max_range: float = np.inf
) -> Bool[np.ndarray, "*shape"]:
    """Mask of measurements that make a point: finite, positive and nearer than `max_range`."""
    return (measurement > 0) & (measurement < min(max_range, np.finfo(np.float32).max))


def with_noise(measurement: np.ndarray, model: SensorModel, rng: Rng) -> np.ndarray:
    """Add normal noise to an image, with the standard deviations of a model.

    A number is drawn for every pixel. Pixels without return are 0 in the result."""
    clean = np.asarray(measurement, np.float32)
    valid = is_return(clean, model.max_range)
    noise = rng.standard_normal(clean.shape, dtype=np.float32) * model.deviation(
        np.where(valid, clean, np.float32(0))
    )
    return np.where(valid, clean + noise, np.float32(0))


def nearest(
    model: SensorModel, sensor_corners: Float64[np.ndarray, "n 8 3"]
) -> Float64[np.ndarray, " n"]:
    """Lower bound of the measurement (m) of each box; may be negative.

    sensor_corners: corners of each box (m, sensor frame). The bound is 1 mm low, for rounding."""
    if model.measures == "depth":
        forward_axis = model.body_SE3_sensor[0, :3]
        return (sensor_corners @ forward_axis).min(axis=1) - 1e-3
    _, radius, distance = bounding_spheres(sensor_corners)
    return distance - radius - 1e-3


def bounding_spheres(
    corners: Float64[np.ndarray, "n 8 3"],
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Middle (x, y, z), radius and distance of the sphere through the corners of each box.

    The distance is from the origin to the middle; all in m, in the frame of the corners."""
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1, initial=0)
    return middle, radius, np.linalg.norm(middle, axis=1)


def clip_windows(
    bounds: Float64[np.ndarray, "m 5"], shape: tuple[int, int]
) -> Int64[np.ndarray, "k 5"]:
    """Cut rectangles of pixels to an image; leave out those outside.

    bounds and the result: row of the box, top, bottom, left, right, all whole numbers; bottom and
    right are excluded. shape: rows and columns of the image."""
    rows, columns = shape
    top = np.clip(bounds[:, 1], 0, None)
    bottom = np.minimum(bounds[:, 2], rows)
    left = np.clip(bounds[:, 3], 0, None)
    right = np.minimum(bounds[:, 4], columns)
    is_inside = (top < bottom) & (left < right)
    windows = np.column_stack([bounds[:, 0], top, bottom, left, right])
    return windows[is_inside].astype(np.int64)


def freeze(rays: np.ndarray) -> np.ndarray:
    """Return a float32 copy of rays that cannot be written to, as caches share it."""
    rays = rays.astype(np.float32)
    rays.setflags(write=False)
    return rays


def angle(default: float | tuple[float, ...]) -> Any:
    """Declare a dataclass field as an angle, with a default: radians here, degrees in files."""
    return field(default=default, metadata={"unit": "rad"})


def find_angles(model: Any) -> dict[str, bool]:
    """Names of all fields of a model or its class, each with True if declared by `angle`."""
    return {entry.name: entry.metadata.get("unit") == "rad" for entry in fields(model)}


def check_numbers(model: Any) -> None:
    """Raise ValueError if a field with a numeric default holds no fitting number.

    It must be a whole number if its default is one, otherwise a real number, not NaN."""
    for entry in fields(model):
        value = getattr(model, entry.name)
        default = entry.default
        if isinstance(default, bool) or not isinstance(default, int | float):
            continue
        must_be_whole = isinstance(default, int)
        fits = isinstance(value, int | np.integer) or (
            not must_be_whole and isinstance(value, float | np.floating)
        )
        # value != value holds for NaN only
        if isinstance(value, bool) or not fits or value != value:
            word = "whole number" if must_be_whole else "number"
            raise ValueError(
                f"{entry.name} must be a {word}, got {value!r:.60} for a {type(model).__name__}"
            )


def check_rays(rows: float, columns: float) -> None:
    """Raise ValueError for less than one row or column, and for more than `MAX_RAYS` rays."""
    if min(rows, columns) < 1:
        raise ValueError(
            f"rows and columns of a sensor must be at least 1, got {rows!s:.20} and {columns!s:.20}"
        )
    if max(rows, columns, rows * columns) > MAX_RAYS:
        got = f"{rows!s:.20} x {columns!s:.20}"
        raise ValueError(
            f"a sensor has at most {MAX_RAYS} rays, got {got}: take fewer, or wider steps"
        )


def check_noise(sigma: float, max_range: float) -> None:
    """Raise ValueError unless sigma (m) is finite and not negative, and max_range (m) above 0."""
    if not 0 <= sigma < np.inf or not max_range > 0:
        raise ValueError(
            f"need finite sigma >= 0 and max_range > 0, got sigma {sigma} and max_range {max_range}"
        )


@dataclass(frozen=True, eq=False)
class Sensor:
    """Sensor model at a pose in a site's frame.

    pose: world_SE3_sensor (4, 4); it is copied and made read-only.

    float32 points are good to 1 mm within 10 km. Raises ValueError if the pose is no rigid
    motion."""

    name: str
    model: SensorModel
    pose: Pose = field(repr=False)

    def __post_init__(self) -> None:
        set_fields(self, pose=check_pose(self.pose, f"pose of sensor {self.name!r}").copy())
        self.pose.setflags(write=False)

    def __eq__(self, other: object) -> bool:
        """Sensors are equal if their name, model and pose are."""
        if not isinstance(other, Sensor):
            return False
        return (self.name, self.model) == (other.name, other.model) and np.array_equal(
            self.pose, other.pose
        )

    def __hash__(self) -> int:
        return hash((self.name, self.model))

    @cached_property
    def position(self) -> Float64[np.ndarray, "3"]:
        """Position in the world frame (m)."""
        return self.pose[:3, 3]

    @property
    def world_SE3_body(self) -> Pose:
        """Pose of its body: x along the optical axis, y left, z up."""
        return self.pose @ invert(self.model.body_SE3_sensor)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of model and pose, whatever the name: equal for sensors that measure the same."""
        described = [type(self.model).__name__, asdict(self.model), self.pose.tolist()]
        return sha256(
            json.dumps(described, sort_keys=True, default=np.ndarray.tolist).encode()
        ).hexdigest()

    @cached_property
    def world_rays(self) -> Float32[np.ndarray, "3 pixels"]:
        """x, y and z of each pixel's ray, world axes (paper equation 1), row after row of the
        image."""
        rays = self.model.rays().reshape(-1, 3).astype(np.float64)
        return freeze(np.ascontiguousarray(self.pose[:3, :3] @ rays.T))


def tabulate_sensors(sensors: Sequence[Sensor]) -> Table:
    """Columns of a table of sensors: name, class of the model, and x, y, z of the position (m)."""
    x, y, z = np.array([sensor.position for sensor in sensors]).reshape(-1, 3).T
    models = [type(sensor.model).__name__ for sensor in sensors]
    return {"name": [sensor.name for sensor in sensors], "model": models, "x": x, "y": y, "z": z}
