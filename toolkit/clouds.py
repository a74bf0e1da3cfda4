"""Open3D clouds: one per sensor, fused, cropped, counted.

A cloud is an `open3d.t.geometry.PointCloud` with `positions` (n, 3), float32 in a site's frame, and `sensor` (n, 1)
int32, the number of the sensor that measured each point. Open3D's own viewer, filters and files work on it as it is.
Files: ply and pcd (binary), and npz keep both attributes bit for bit; ASCII ply rounds positions to 6 digits; xyz, pts
and the legacy `open3d.geometry.PointCloud` lose `sensor`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d

from toolkit.arrays import Bool, Float, Float64, Int, Int32, Int64
from toolkit.boxes import count_points
from toolkit.frame import Frame
from toolkit.points import Area, Metric, area_of, beyond, frame_points, height_of, inside, select_sensors, unproject
from toolkit.runtime.files import reserve, writing
from toolkit.sensors.sensor import Sensor

__all__ = [
    "DensityMap",
    "crop",
    "density_cdf",
    "density_map",
    "frame_cloud",
    "frame_points",
    "from_depth",
    "from_points",
    "fuse",
    "load",
    "outside_radius",
    "points_per_box",
    "positions",
    "save",
    "sensor_numbers",
]

Cloud = o3d.t.geometry.PointCloud


def from_depth(
    sensor: Sensor,
    measurement: Float[np.ndarray, "rows columns"],
    *,
    rng: np.random.Generator | None = None,
    sensor_id: int = 0,
) -> Cloud:
    """The cloud, world frame, of one depth image or lidar range image (paper equations 1 and 2).

    Pixels that are NaN, infinite, zero, negative or beyond the sensor's range make no point. rng draws its noise first.
    """
    if rng is not None:
        measurement = sensor.model.noisy(measurement, rng)
    xyz, valid = unproject(sensor, measurement)
    return from_points(xyz.take(np.flatnonzero(valid), axis=1).T, sensor_id)


def frame_cloud(
    frame: Frame,
    sensors: Sequence[int | str] | None = None,
    *,
    area: Area,
    height: float | None = None,
    rng: np.random.Generator | None = None,
) -> Cloud:
    """All a frame's sensors measured inside the area, fused: `from_depth`, `crop` and `fuse` in one, and faster.

    Arguments as of `toolkit.points.frame_points`; each point carries its sensor's position in `frame.sensors`.
    """
    chosen = select_sensors(frame.sensors, sensors)
    clouds = frame_points(frame, chosen, area=area, height=height, rng=rng)
    points = np.concatenate([np.zeros((0, 3), np.float32), *clouds])
    return from_points(points, np.repeat(np.array(chosen, np.int32), [len(cloud) for cloud in clouds]))


def from_points(points: Float[np.ndarray, "n 3"], sensor_id: int | Int[np.ndarray, " n"] = 0) -> Cloud:
    """A cloud of points, all by one sensor or each by its own; float32 and float64 positions stay what they are."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {points.shape}")
    numbers = np.empty((len(points), 1), np.int32)
    numbers[:, 0] = sensor_id
    cloud = Cloud(o3d.core.Tensor.from_numpy(np.ascontiguousarray(points)))
    cloud.point["sensor"] = o3d.core.Tensor.from_numpy(numbers)
    return cloud


def positions(cloud: Cloud) -> Float[np.ndarray, "n 3"]:
    """The points of a cloud as an array that shares its memory; (0, 3) where there are none."""
    if "positions" not in cloud.point:
        return np.zeros((0, 3), np.float32)
    return cloud.point.positions.cpu().numpy()


def sensor_numbers(cloud: Cloud) -> Int32[np.ndarray, " n"]:
    """The number of the sensor of each point; 0 where the cloud does not say."""
    if "sensor" not in cloud.point:
        return np.zeros(len(positions(cloud)), np.int32)
    return cloud.point["sensor"].cpu().numpy().reshape(-1).astype(np.int32, copy=False)


def fuse(clouds: Iterable[Cloud]) -> Cloud:
    """All points of all clouds, in order, each with the number of its sensor. No clouds make an empty one."""
    clouds = list(clouds)
    points = [np.zeros((0, 3), np.float32), *map(positions, clouds)]
    numbers = [np.zeros(0, np.int32), *map(sensor_numbers, clouds)]
    return from_points(np.concatenate(points), np.concatenate(numbers))


def crop(cloud: Cloud, area: Area, height: float | None = None, *, floor: float = 0.0) -> Cloud:
    """The points inside a site's detection area, or xmin, ymin, xmax, ymax (m), with floor < z < height.

    height: the site's own where one is given, else 4 m (paper section II-B).
    """
    return _select(cloud, inside(positions(cloud), area_of(area), height_of(area, height), floor))


def outside_radius(
    cloud: Cloud, sensor: Sensor | Float[np.ndarray, "4 4"], radius: float, metric: Metric = "horizontal"
) -> Cloud:
    """The points that hybrid fusion sends: those farther than `radius` (m) from the sensor (paper section II-E).

    metric: "horizontal" as in the paper, or "published" as in its code; see `toolkit.points.beyond`.
    """
    return _select(cloud, beyond(positions(cloud), sensor, radius, metric))


def points_per_box(cloud: Cloud | Float[np.ndarray, "n 3"], boxes: Float[np.ndarray, "m 7"]) -> Int64[np.ndarray, " m"]:
    """The point density of each box: how many points lie in it (paper section IV-E)."""
    return count_points(cloud if isinstance(cloud, np.ndarray) else positions(cloud), boxes)


def density_cdf(counts: Int[np.ndarray, " n"]) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """d and F(d): the share of objects whose point density is d or less (paper section IV-E), from d = 0 on.

    >>> density_cdf(np.array([0, 3, 3, 7]))
    (array([0, 3, 7]), array([0.25, 0.75, 1.  ]))
    """
    counts = np.asarray(counts, np.int64)
    if counts.size == 0:
        return np.zeros(0, np.int64), np.zeros(0)
    density = np.union1d(counts, 0)
    return density, np.searchsorted(np.sort(counts), density, side="right") / counts.size


class DensityMap(NamedTuple):
    """A grid over an area, row 0 at ymin, column 0 at xmin: points per m² and how many sensors see each cell."""

    points_per_m2: Float64[np.ndarray, "rows columns"]
    sensors: Int64[np.ndarray, "rows columns"]


def density_map(cloud: Cloud, area: Area, cell: float = 1.0) -> DensityMap:
    """Points per m² and distinct sensors per cell of `cell` m; the last row and column may reach past the area."""
    if not cell > 0:
        raise ValueError(f"cell must be greater than 0 m, got {cell}")
    xmin, ymin, xmax, ymax = area_of(area)
    columns, rows = (max(1, int(np.ceil(extent / cell - 1e-9))) for extent in (xmax - xmin, ymax - ymin))
    x, y, _ = positions(cloud).astype(np.float64).T
    within = (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)
    column = np.minimum((x[within] - xmin) // cell, columns - 1)
    row = np.minimum((y[within] - ymin) // cell, rows - 1)
    place = (row * columns + column).astype(np.int64)
    seen = np.unique(np.stack([place, sensor_numbers(cloud)[within]]), axis=1)[0]
    points, sensors = (np.bincount(p, minlength=rows * columns).reshape(rows, columns) for p in (place, seen))
    return DensityMap(points / cell**2, sensors)


def save(cloud: Cloud, path: str | Path) -> None:
    """Write a cloud as ply, pcd or npz, whole or not at all. Raises OSError where that is impossible, and ValueError
    for another kind of file and for a cloud without points, which these formats cannot hold."""
    path = Path(path)
    if not len(positions(cloud)):
        raise ValueError(f"the cloud for {path.name} has no points: is the area where the sensors are?")
    if path.suffix.lower() not in (".ply", ".pcd", ".npz"):
        raise ValueError(f"a cloud is saved as .ply, .pcd or .npz, got {path.name}")
    refused = OSError(f"cannot write {path}: check that its folder exists and the disk has room")
    if not path.parent.is_dir():
        raise refused
    with writing(path) as unfinished:
        reserve(unfinished, sum(values.numpy().nbytes for _, values in cloud.point.items()))
        if not o3d.t.io.write_point_cloud(unfinished, cloud):
            raise refused


def load(path: str | Path) -> Cloud:
    """Read a cloud that Open3D reads; without a `sensor` attribute every point gets sensor 0.

    Raises FileNotFoundError, and ValueError for a file that holds no cloud.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such cloud file: {path}")
    damaged = f"{path} holds no points that Open3D can read: is it a damaged or foreign file?"
    if _declares_no_points(path):
        return from_points(np.zeros((0, 3), np.float32))
    try:
        cloud = o3d.t.io.read_point_cloud(path)
    except RuntimeError:
        raise ValueError(damaged) from None
    if "positions" not in cloud.point:
        raise ValueError(damaged)
    if _ply_is_cut_off(path):
        raise ValueError(f"{path} is cut off, fewer points are there than its header says: copy it again")
    return from_points(positions(cloud).copy(), sensor_numbers(cloud))


def _declares_no_points(path: Path) -> bool:
    """Whether the header of a pcd says that a sensor saw nothing, which Open3D takes for damage."""
    with path.open("rb") as file:
        return (
            path.suffix.lower() == ".pcd" and re.search(rb"^POINTS\s+0\s*$", file.read(4096), re.MULTILINE) is not None
        )


_PLY_BYTES = {"char": 1, "short": 2, "int": 4, "float": 4, "double": 8}
_PLY_BYTES |= {"uchar": 1, "ushort": 2, "uint": 4, "float32": 4, "float64": 8}
_PLY_BYTES |= {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4}


def _ply_is_cut_off(path: Path) -> bool:
    """Whether a ply ends before its last point; Open3D fills the rest with whatever was in memory."""
    if path.suffix.lower() != ".ply":
        return False
    content = path.read_bytes()
    header, _, body = content.partition(b"end_header")
    vertex = re.search(r"element vertex (\d+)\s+((?:property \w+ \w+\s+)+)", header.decode("ascii", "replace"))
    if vertex is None:
        return False
    types = re.findall(r"property (\w+) ", vertex[2])
    if b"format ascii" in header:
        return len(body.split()) < int(vertex[1]) * len(types)
    return len(body) - 1 < int(vertex[1]) * sum(_PLY_BYTES.get(name, 1) for name in types)


def _select(cloud: Cloud, keep: Bool[np.ndarray, " n"]) -> Cloud:
    """The points at a mask, with all their attributes."""
    chosen, rows = Cloud(), np.flatnonzero(keep)
    for name in cloud.point:
        chosen.point[name] = o3d.core.Tensor.from_numpy(cloud.point[name].cpu().numpy().take(rows, axis=0))
    return chosen
