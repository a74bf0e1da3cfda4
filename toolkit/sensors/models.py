"""Sensor models: a depth camera, three lidars, and the catalogue of all known models by name.

A lidar's rays form a grid of elevations and azimuths; its frame has x forward, y left, z up, rows
from the top down, columns from the right (-y) to the left, centred on +x. A model defined elsewhere
becomes known to files and to the command line by `@register_sensor_model` above its class."""

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

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
from toolkit.geometry import BODY_SE3_CAMERA, pose
from toolkit.sensors import sensor as shared
from toolkit.sensors.sensor import (
    NEAR,
    Deviation,
    Measure,
    SensorModel,
    angle,
    check_noise,
    check_numbers,
    check_rays,
)

# pairs of a box's corners, which include its edges
_PAIRS = np.array([(i, j) for i in range(8) for j in range(i + 1, 8)])
# elevations of a RowLidar's rows by default (degrees)
_DEGREES = [15, 10, 7, 5, 3, *np.arange(2.0, -4.5, -1 / 3), -5, -6, -7, -9, -11, -15, -25]
_ELEVATIONS = tuple(np.deg2rad(_DEGREES).tolist())
MODELS: dict[str, type[Any]] = {}  # by the name of the class in words, such as "depth-camera"
# keys of a sensor in files, in addition to the fields of its model
TAKEN = ("name", "model", "type", "site_SE3_sensor")

Model = TypeVar("Model", bound=type)


class _Noisy:
    # Noise of the models with one standard deviation, or with a `deviation` of their class.
    sigma: float  # standard deviation (m)

    def deviation(self, measurement: Float[np.ndarray, "*shape"]) -> Deviation:
        """Standard deviation of the noise (m): `sigma`, whatever the measurement."""
        return np.float32(self.sigma)

    def noisy(self, measurement: Float[np.ndarray, "rows columns"], rng: Rng) -> ImageRanges:
        """Add normal noise with the standard deviation `deviation`; no return becomes 0."""
        return shared.with_noise(measurement, cast(SensorModel, self), rng)


@dataclass(frozen=True)
class DepthCamera(_Noisy):
    """Pinhole depth camera; frame: x right, y down, z forward. The defaults are the paper's."""

    kind: ClassVar[str] = "camera"
    measures: ClassVar[Measure] = "depth"
    body_SE3_sensor: ClassVar[np.ndarray] = BODY_SE3_CAMERA

    width: int = 400  # pixels of the full image
    height: int = 300
    stride: int = 2  # every stride-th pixel of each row and column is measured
    fov: float = angle(np.pi / 2)  # horizontal (rad)
    sigma: float = 0.015  # standard deviation of the additive depth noise (m)
    max_range: float = 1000.0  # depth beyond which nothing returns (m)
    centre: tuple[float, float] | None = (
        None  # principal point (u, v) in pixels of the full image, or its middle
    )

    def __post_init__(self) -> None:
        """Raise ValueError for a field that is no number or out of its range."""
        check_numbers(self)
        if min(self.width, self.height, self.stride) < 1:
            raise ValueError(f"width, height and stride must be at least 1, got {self}")
        rows, columns = self.shape
        check_rays(rows, columns)
        # the size of the image and the stride are limited too, even if few pixels are measured
        check_rays(1, max(self.width, self.height, self.stride))
        if not 0 < self.fov < np.pi:
            raise ValueError(
                f"fov must lie between 0 and pi rad, got {self.fov}: give degrees as np.deg2rad(90)"
            )
        centre = (0.0, 0.0) if self.centre is None else self.centre
        has_numbers = isinstance(centre, tuple) and all(
            isinstance(number, int | float | np.number) for number in centre
        )
        if not (has_numbers and len(centre) == 2 and np.isfinite(centre).all()):
            raise ValueError(f"centre must be two numbers (u, v) in pixels, got {self.centre}")
        check_noise(self.sigma, self.max_range)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns that are measured."""
        # rounded up
        return -(-self.height // self.stride), -(-self.width // self.stride)

    @property
    def horizontal_fov(self) -> float:
        """Width of the field of view (rad): `fov`."""
        return self.fov

    @property
    def vertical_fov(self) -> float:
        """Height of the field of view (rad)."""
        return float(2 * np.arctan(self.height / 2 / self.intrinsic[1, 1]))

    @property
    def intrinsic(self) -> Float64[np.ndarray, "3 3"]:
        """Camera matrix K in pixels of the full image: [[f, 0, u], [0, f, v], [0, 0, 1]].

        f = (width / 2) / tan(fov / 2) for both axes; u, v: `centre`, or the middle of the image."""
        focal = self.width / 2 / np.tan(self.fov / 2)
        u, v = self.centre or (self.width / 2, self.height / 2)
        return np.array([[focal, 0.0, u], [0.0, focal, v], [0.0, 0.0, 1.0]])

    def rays(self) -> ImageVectors:
        """Ray of each measured pixel u, v, sensor frame: ((u - cu) / f, (v - cv) / f, 1).

        cu, cv: principal point. Read-only and shared by equal cameras."""
        return _camera_rays(self)

    def in_view(self, points: Float64[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Mask of points (m, sensor frame) inside the image and at a depth below `max_range`."""
        # comparisons of x / z and y / z, multiplied by z so that nothing is divided by 0
        x, y, z = np.moveaxis(points, -1, 0)
        # rows of the camera matrix: (focal, 0, centre_u), (0, focal, centre_v), (0, 0, 1)
        (focal, _, centre_u), (_, _, centre_v), _ = self.intrinsic
        in_columns = (-centre_u * z <= focal * x) & (focal * x <= (self.width - centre_u) * z)
        in_rows = (-centre_v * z <= focal * y) & (focal * y <= (self.height - centre_v) * z)
        return in_columns & in_rows & (z > 0) & (z < self.max_range)

    def windows(self, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
        """Rectangles of pixels (row, top, bottom, left, right) around the visible part of each box.

        sensor_corners: corners of each box (x right, y down, z forward; m). row: row of the box in
        it; bottom and right are excluded. Boxes out of view have no rectangle."""
        points = _cut_behind(sensor_corners)  # (box, point, 3)
        depth = points[..., 2:]
        is_ahead = depth >= NEAR - 1e-6
        focal = self.intrinsic[0, 0]
        centre = self.intrinsic[:2, 2]
        # u, v of each point, in measured pixels
        pixels = (points[..., :2] / np.maximum(depth, NEAR - 1e-6) * focal + centre) / self.stride
        # 1e9 leaves points behind the plane out of the minimum and maximum
        left, top = np.floor(np.where(is_ahead, pixels, 1e9).min(axis=1)).T
        right, bottom = np.ceil(np.where(is_ahead, pixels, -1e9).max(axis=1)).T + 1
        bounds = np.column_stack([np.arange(len(points)), top, bottom, left, right])
        is_in_range = sensor_corners[..., 2].min(axis=1) < self.max_range
        return shared.clip_windows(bounds[is_in_range & is_ahead.any(axis=(1, 2))], self.shape)


def _cut_behind(sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Float64[np.ndarray, "n 36 3"]:
    """Corners of each box, and the points at which its edges cross the plane z = NEAR.

    Points behind that plane do not project into a camera's image. sensor_corners: x right, y down,
    z forward (m). For each pair of corners there is a point on the line between them: at the
    plane, or one of the two if the line does not cross it."""
    start = sensor_corners[:, _PAIRS[:, 0]]
    end = sensor_corners[:, _PAIRS[:, 1]]
    start_z = start[..., 2:]
    rise = end[..., 2:] - start_z
    share = (NEAR - start_z) / np.where(rise == 0, np.inf, rise)
    return np.concatenate([sensor_corners, start + np.clip(share, 0, 1) * (end - start)], axis=1)


@lru_cache(maxsize=64)
def _camera_rays(camera: DepthCamera) -> np.ndarray:
    """Ray of each measured pixel; read-only, since equal cameras share it (`DepthCamera.rays`)."""
    # rows of the camera matrix: (focal, 0, centre_u), (0, focal, centre_v), (0, 0, 1)
    (focal, _, centre_u), (_, _, centre_v), _ = camera.intrinsic
    u, v = np.arange(0, camera.width, camera.stride), np.arange(0, camera.height, camera.stride)
    x, y = np.meshgrid((u - centre_u) / focal, (v - centre_v) / focal)
    return shared.freeze(np.stack([x, y, np.ones_like(x)], axis=-1))


class AngleGrid(NamedTuple):
    """Directions of a lidar's rays: rows of equal elevation, columns of equal azimuth.

    Columns are evenly spaced from the right to the left, each in the middle of its share of
    `width`."""

    elevations: tuple[float, ...]  # elevation of each row (rad above the horizon), top first
    columns: int  # number of columns
    width: float  # angle that all columns cover (rad)
    heading: float = 0.0  # azimuth of the middle of the columns (rad from +x to the left)


@lru_cache(maxsize=64)
def unit_rays(grid: AngleGrid) -> ImageVectors:
    """Unit ray (x forward, y left, z up) of each row and column of a lidar's image.

    grid: elevation of each row, number of columns, the angle that they cover, and the azimuth of
    their middle (rad). The result is read-only, since it is cached."""
    elevation = np.array(grid.elevations)[:, None]
    columns_from_middle = np.arange(grid.columns) - (grid.columns - 1) / 2
    azimuth = grid.heading + columns_from_middle * grid.width / grid.columns
    horizontal_length = np.cos(elevation)
    x = horizontal_length * np.cos(azimuth)
    y = horizontal_length * np.sin(azimuth)
    z = np.sin(elevation) + 0 * azimuth  # the sum gives it the shape (rows, columns) of x and y
    return shared.freeze(np.stack([x, y, z], axis=-1))


def _half_angle(radius: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Half of the angle (rad) that a sphere fills, 2 pi if the sensor is inside the sphere.

    distance: from the sensor to the sphere's middle (m)."""
    return np.where(
        distance > radius, np.arcsin(np.minimum(radius / np.maximum(distance, 1e-9), 1)), 2 * np.pi
    )


class _Lidar(_Noisy):
    """Rays of a lidar on a grid of angles."""

    measures: ClassVar[Measure] = "range"
    max_range: float

    @property
    def _grid(self) -> AngleGrid:
        # Directions of the rays, in the sensor's frame.
        raise NotImplementedError

    @property
    def body_SE3_sensor(self) -> Pose:
        """Pose of the sensor's frame in its body's frame.

        The body's x axis points along the heading of the rays."""
        return pose(yaw=-self._grid.heading) if self._grid.heading else np.eye(4)

    @property
    def shape(self) -> tuple[int, int]:
        # Rows and columns of an image.
        return len(self._grid.elevations), self._grid.columns

    @property
    def horizontal_fov(self) -> float:
        """Angle swept (rad)."""
        return self._grid.width

    @property
    def vertical_fov(self) -> float:
        """Angle between the lowest row and the highest (rad)."""
        return self._grid.elevations[0] - self._grid.elevations[-1]

    def rays(self) -> ImageVectors:
        """Unit ray per row and column, sensor frame."""
        return unit_rays(self._grid)

    def in_view(self, points: Float64[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Mask of points (m, sensor frame) inside the rows, the columns and the range."""
        # axes of the middle column: azimuth 0 is its direction
        x, y, z = np.moveaxis(self._to_heading_axes(points), -1, 0)
        horizontal_distance = np.hypot(x, y)
        grid = self._grid
        elevation = np.arctan2(z, horizontal_distance)
        highest, lowest = grid.elevations[0], grid.elevations[-1]
        in_rows = (lowest <= elevation) & (elevation <= highest)
        in_columns = np.abs(np.arctan2(y, x)) <= grid.width / 2
        return in_rows & in_columns & (np.hypot(horizontal_distance, z) < self.max_range)

    def windows(self, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Int64[np.ndarray, "m 5"]:
        """Rectangles of pixels (row, top, bottom, left, right) around a sphere on each box.

        The sphere goes through the corners of the box. sensor_corners: corners of each box (m,
        sensor frame). row: row of the box in it; bottom and right are excluded. A box across the
        seam of the columns has several rectangles."""
        middle, radius, distance = shared.bounding_spheres(self._to_heading_axes(sensor_corners))
        x, y, z = middle.T
        elevation = np.arcsin(z / np.maximum(distance, 1e-9))
        half_height = _half_angle(radius, distance)
        # negative, so that they rise from row to row, as searchsorted needs
        negative_elevations = -np.array(self._grid.elevations)
        top = np.searchsorted(negative_elevations, -(elevation + half_height) - 1e-6)
        bottom = np.searchsorted(
            negative_elevations, -(elevation - half_height) + 1e-6, side="right"
        )
        azimuth = np.arctan2(y, x)
        half_width = np.minimum(_half_angle(radius, np.linalg.norm(middle[:, :2], axis=1)), np.pi)
        columns = self._grid.columns
        rad_per_column = self._grid.width / columns
        half_columns = half_width / rad_per_column
        parts = []
        # also one full turn to either side: a rectangle that ends beyond the seam begins again
        for turn in (-2 * np.pi, 0.0, 2 * np.pi):
            column = (azimuth + turn) / rad_per_column + (columns - 1) / 2
            left = np.floor(column - half_columns)
            right = np.ceil(column + half_columns) + 1
            bounds = np.column_stack([np.arange(len(middle)), top, bottom, left, right])
            parts.append(bounds[distance - radius < self.max_range])
        return shared.clip_windows(np.concatenate(parts), self.shape)

    def _to_heading_axes(self, points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
        """Turn points from sensor axes into axes with x along the heading, y left, z up."""
        return points @ self.body_SE3_sensor[:3, :3].T if self._grid.heading else points


@dataclass(frozen=True)
class SpinningLidar(_Lidar):
    """Spinning lidar; frame: x forward, y left, z up."""

    kind: ClassVar[str] = "lidar"

    channels: int = 64  # laser rows, top first
    fov_up: float = angle(np.deg2rad(10.0))  # highest row (rad above the horizon)
    fov_down: float = angle(np.deg2rad(-40.0))  # lowest row
    azimuth_step: float = angle(np.deg2rad(0.4))  # rad between columns
    azimuth_fov: float = angle(2 * np.pi)  # rad swept, centred on +x
    sigma: float = 0.02  # noise of the range (m)
    max_range: float = 120.0  # m

    def __post_init__(self) -> None:
        """Raise ValueError for a field that is no number or out of its range."""
        check_numbers(self)
        if self.channels < 1:
            raise ValueError(f"channels must be at least 1, got {self.channels}")
        if not -np.pi / 2 <= self.fov_down <= self.fov_up <= np.pi / 2:
            raise ValueError(
                f"need -pi/2 <= fov_down <= fov_up <= pi/2 rad, got {self.fov_down} and "
                f"{self.fov_up}"
            )
        if not 0 < self.azimuth_step <= self.azimuth_fov <= 2 * np.pi + 1e-9:
            raise ValueError(
                f"need 0 < azimuth_step <= azimuth_fov <= 2 pi rad, got {self.azimuth_step}"
            )
        check_rays(self.channels, self.azimuth_fov / self.azimuth_step)
        check_noise(self.sigma, self.max_range)

    @property
    def _grid(self) -> AngleGrid:
        elevations = np.linspace(self.fov_up, self.fov_down, self.channels).tolist()
        columns = max(1, round(self.azimuth_fov / self.azimuth_step))
        return AngleGrid(tuple(elevations), columns, width=self.azimuth_fov)


@dataclass(frozen=True)
class SolidStateLidar(_Lidar):
    """Solid-state lidar; frame: x forward, y left, z up, field of view centred on +x."""

    kind: ClassVar[str] = "solidstate"

    rows: int = 64
    columns: int = 300
    horizontal_fov: float = angle(float(np.deg2rad(120.0)))
    vertical_fov: float = angle(float(np.deg2rad(25.0)))
    sigma: float = 0.02  # noise of the range at the sensor (m)
    sigma_per_metre: float = 0.0003  # by which it grows with the range
    max_range: float = 150.0  # m

    def __post_init__(self) -> None:
        """Raise ValueError for a field that is no number or out of its range."""
        check_numbers(self)
        check_rays(self.rows, self.columns)
        if not (0 < self.horizontal_fov <= 2 * np.pi and 0 < self.vertical_fov <= np.pi):
            got = f"{self.horizontal_fov} and {self.vertical_fov}: give degrees as np.deg2rad(120)"
            raise ValueError(
                f"need 0 < horizontal_fov <= 2 pi and 0 < vertical_fov <= pi rad, got {got}"
            )
        check_noise(self.sigma, self.max_range)
        if not 0 <= self.sigma_per_metre < np.inf:
            raise ValueError(
                f"sigma_per_metre must be finite and not negative, got {self.sigma_per_metre}"
            )

    def deviation(self, measurement: Float[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
        """sigma + sigma_per_metre · range."""
        return np.float32(self.sigma) + np.float32(self.sigma_per_metre) * np.asarray(
            measurement, np.float32
        )

    @property
    def _grid(self) -> AngleGrid:
        elevations = np.linspace(self.vertical_fov / 2, -self.vertical_fov / 2, self.rows).tolist()
        return AngleGrid(tuple(elevations), self.columns, width=self.horizontal_fov)


@dataclass(frozen=True)
class RowLidar(_Lidar):
    """Lidar of rows that need not be evenly spaced; frame: x forward, y left, z up."""

    kind: ClassVar[str] = "rowlidar"

    # elevations of its rows (rad above the horizon), top first
    elevations: tuple[float, ...] = angle(_ELEVATIONS)
    columns: int = 1800  # steps of the azimuths that it sweeps
    azimuth_fov: float = angle(2 * np.pi)  # rad swept, centred on `heading`
    heading: float = angle(0.0)  # rad from +x to the left
    sigma: float = 0.02  # noise of the range (m)
    max_range: float = 200.0  # m

    def __post_init__(self) -> None:
        """Raise ValueError for a field that is no number or out of its range."""
        check_numbers(self)
        elevations = np.array(self.elevations, np.float64)
        is_list = elevations.ndim == 1 and len(elevations) > 0 and np.isfinite(elevations).all()
        if not is_list or (np.diff(elevations) >= 0).any():
            raise ValueError(
                f"elevations must fall from row to row, got {str(self.elevations)[:60]}"
            )
        if np.abs(elevations).max() > np.pi / 2:
            span = f"{elevations[0]:.2f} to {elevations[-1]:.2f}"
            raise ValueError(f"elevations must lie in -pi/2..pi/2 rad, got {span}")
        check_rays(len(elevations), self.columns)
        if not (0 < self.azimuth_fov <= 2 * np.pi + 1e-9 and abs(self.heading) <= np.pi + 1e-9):
            raise ValueError(
                f"need 0 < azimuth_fov <= 2 pi and heading within pi rad, got {self.azimuth_fov}"
            )
        check_noise(self.sigma, self.max_range)

    @property
    def _grid(self) -> AngleGrid:
        return AngleGrid(
            self.elevations, self.columns, width=self.azimuth_fov, heading=self.heading
        )


def register_sensor_model(model: Model) -> Model:
    """Register a class of sensors for files and `--model`, and return it; a class decorator.

    Raises ValueError if the class is no frozen dataclass that fits `SensorModel`, if a field has
    no default or a name of `TAKEN`, or if another model has the name of the class."""
    name = model.__name__
    parameters = getattr(model, "__dataclass_params__", None)
    if not is_dataclass(model) or parameters is None or not (parameters.frozen and parameters.eq):
        raise ValueError(
            f"{name} must be a frozen dataclass that compares by value: put "
            "@dataclass(frozen=True) on it"
        )
    without_default = [
        f.name for f in fields(model) if f.default is MISSING and f.default_factory is MISSING
    ]
    if without_default or {f.name for f in fields(model)} & set(TAKEN):
        raise ValueError(
            f"fields of {name} need defaults ({', '.join(without_default) or 'all have'}) and no "
            f"name of {TAKEN}"
        )
    if not isinstance(model(), SensorModel):
        required = (attribute for attribute in dir(SensorModel) if not attribute.startswith("_"))
        lacks = ", ".join(attribute for attribute in required if not hasattr(model, attribute))
        raise ValueError(
            f"{name} is not a SensorModel, it lacks {lacks}: see toolkit.sensors.sensor"
        )
    before = MODELS.get(name_in_words(name), model)
    if (before.__module__, before.__qualname__) != (model.__module__, model.__qualname__):
        raise ValueError(
            f"sensor model {name} exists already, in {before.__module__}: choose another name"
        )
    MODELS[name_in_words(name)] = model
    return model


def find_model(name: str) -> SensorModel:
    """Return a sensor model with default parameters by name, such as "solid-state-lidar".

    Raises ValueError that lists all names for an unknown one."""
    return find_model_class(name)()


def find_model_class(name: str) -> type[Any]:
    """Return the class of a sensor model by its name, written as SpinningLidar or spinning-lidar.

    Raises ValueError that lists all names for an unknown one."""
    if name_in_words(str(name)) not in MODELS:
        raise ValueError(
            f"unknown sensor model {str(name)[:60]!r}: choose among {', '.join(class_names())}"
        )
    return MODELS[name_in_words(str(name))]


def class_names() -> list[str]:
    """Names of the classes of all registered models, as files write them."""
    return [model.__name__ for model in MODELS.values()]


def make_model(name: str, values: Mapping[str, Any]) -> SensorModel:
    """Make a sensor model from its name and the values of some of its fields.

    name: such as SpinningLidar or spinning-lidar; values: by name of the field, angles in rad,
    lists for tuples. Other fields keep their defaults. Raises ValueError for an unknown name or
    field, and for a value that the model refuses."""
    model = find_model_class(name)
    field_names = [entry.name for entry in fields(model)]
    if unknown := [key for key in values if key not in field_names]:
        raise ValueError(
            f"{unknown[0]} is unknown to {model.__name__}: it has {', '.join(field_names)}"
        )
    arguments = {
        key: tuple(value) if isinstance(value, list) else value for key, value in values.items()
    }
    try:
        return model(**arguments)
    except TypeError as error:
        raise ValueError(f"{model.__name__} cannot have {arguments} ({error})") from None


def name_in_words(name: str) -> str:
    """Name of a class in lower case words: SolidStateLidar becomes solid-state-lidar.

    A name that is already in words stays as it is."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).replace("_", "-").lower()


for _model in (DepthCamera, SpinningLidar, SolidStateLidar, RowLidar):
    register_sensor_model(_model)
