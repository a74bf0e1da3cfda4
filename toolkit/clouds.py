"""Open3D clouds: one per sensor, fused, cropped, counted.

A cloud is an `open3d.t.geometry.PointCloud` with `positions` (n, 3), float32 in a site's frame, and
`sensor` (n, 1) int32, the number of the sensor that measured each point. Further attributes
(`colors`, `normals`, `intensity`, `time` ...) go with their points through every function. The
viewer, filters and files of Open3D work on it as it is, but its `voxel_down_sample` averages all
attributes of a voxel in float32 (Open3D 0.20.0): sensor numbers become the truncated mean of
several sensors, positions in UTM coordinates end decimetres off, and nanosecond stamps lose
seconds. Use `down_sample`.

Files: npz keeps the attributes bit for bit. ply and pcd (binary) keep them too, but for colours,
which become bytes, in pcd positions, which become float32, and what `toolkit.point_writing` leaves
out; ASCII ply rounds positions to 6 digits; xyz, pts and the legacy `open3d.geometry.PointCloud`
lose `sensor`."""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from toolkit.arrays import Float, Int, Int32, Int64, Mask, Points, Pose, Rng
from toolkit.boxes import count_points
from toolkit.frame import unproject
from toolkit.geometry import check_pose, transform
from toolkit.point_columns import MAX_LISTED, Attributes
from toolkit.point_files.pcd import read_pcd
from toolkit.point_files.ply import read_ply
from toolkit.point_writing import format_pcd, format_ply
from toolkit.points import Area, Crop
from toolkit.runtime.array_files import MAX_CLOUD_BYTES, load_arrays
from toolkit.runtime.light_open3d import o3d
from toolkit.runtime.writing import reserve, write_bytes, writing
from toolkit.sensors.sensor import Sensor

PointCloud = o3d.t.geometry.PointCloud
# arrays are (n, 3), or (n, 4) with intensity
AnyCloud = PointCloud | o3d.geometry.PointCloud | np.ndarray
MAX_LISTED_CLOUDS = 10


def from_depth(
    sensor: Sensor,
    measurement: Float[np.ndarray, "rows columns"],
    *,
    rng: Rng | None = None,
    sensor_id: int = 0,
) -> PointCloud:
    """Return the cloud, world frame, of one depth or lidar range image (paper equations 1 and 2).

    rng: draws noise that is added to the image first, None for none; sensor_id: number of the
    sensor, which each point gets.
    """
    if rng is not None:
        measurement = sensor.model.noisy(measurement, rng)
    xyz, valid = unproject(sensor, measurement)
    return from_points(xyz.take(np.flatnonzero(valid), axis=1).T, sensor_id)


def from_points(points: Points, sensor_id: int | Int[np.ndarray, " n"] = 0) -> PointCloud:
    """Return a cloud of points (n, 3).

    sensor_id: number of the sensor that measured them, one for all or one for each. float32 and
    float64 positions keep their type.
    """
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {points.shape}")
    numbers = np.empty((len(points), 1), np.int32)
    numbers[:, 0] = sensor_id
    cloud = PointCloud(o3d.core.Tensor.from_numpy(np.ascontiguousarray(points)))
    cloud.point["sensor"] = o3d.core.Tensor.from_numpy(numbers)
    return cloud


def positions(cloud: PointCloud) -> Points:
    """Return the points (n, 3) of a cloud, in shared memory; (0, 3) if it has none."""
    if "positions" not in cloud.point:
        return np.zeros((0, 3), np.float32)
    return cloud.point.positions.cpu().numpy()


def sensor_numbers(cloud: PointCloud) -> Int32[np.ndarray, " n"]:
    """Return the sensor number of each point, 0 for a cloud without numbers."""
    if "sensor" not in cloud.point:
        return np.zeros(len(positions(cloud)), np.int32)
    return cloud.point["sensor"].cpu().numpy().reshape(-1).astype(np.int32, copy=False)


def from_attributes(
    attributes: Mapping[str, np.ndarray], sensor_id: int | None = None
) -> PointCloud:
    """Return a cloud of positions (n, 3) and other attributes of n rows.

    Args:
        attributes: Columns by name, "positions" among them.
        sensor_id: Sensor number of all points; by default each has the one in the column "sensor",
            or 0 if there is no such column.

    Raises:
        ValueError: The lengths differ.
    """
    if sensor_id is None:
        sensor_column = attributes.get("sensor", np.zeros(1))
    else:
        sensor_column = np.array([sensor_id])
    numbers = sensor_column.reshape(-1).astype(np.int32)
    points = attributes["positions"]
    if len(numbers) == 1:  # one for all points
        numbers = np.broadcast_to(numbers, len(points))
    cloud = from_points(points, numbers)
    for name, column in attributes.items():
        if name in ("positions", "sensor"):
            continue
        rows = column if column.ndim == 2 else column[:, None]
        if len(rows) != len(points):
            raise ValueError(
                f"{name} must have one row for each of {len(points)} points, got {len(rows)}"
            )
        cloud.point[name] = o3d.core.Tensor.from_numpy(np.array(rows, order="C"))
    return cloud


def attributes(cloud: PointCloud) -> dict[str, np.ndarray]:
    """Return all attributes of a cloud by name, positions included, in shared memory."""
    return {name: cloud.point[name].cpu().numpy() for name in cloud.point}


def fuse(clouds: Iterable[AnyCloud], poses: Sequence[Pose] | None = None) -> PointCloud:
    """Join the points of all clouds, in order, each with the number of its sensor.

    Attributes that all clouds have stay; a warning names the others, also those of unequal width.
    Clouds without points do not count.

    Args:
        clouds: Open3D's, tensor or legacy, or arrays of x, y, z (n, 3) or x, y, z, intensity
            (n, 4), in m. A cloud without an attribute `sensor` gets its place in the list as its
            number.
        poses: For each cloud the motion (4, 4) from its frame into the common one; positions become
            float64, and normals turn. Without poses the clouds must be in one frame already, and a
            warning names the clouds that have neither a pose nor a sensor number.

    Raises:
        ValueError: Something is no cloud or no pose, their numbers differ, or a cloud would get the
            number of another's sensor.
    """
    if isinstance(clouds, PointCloud | o3d.geometry.PointCloud) or getattr(clouds, "ndim", 3) == 2:
        raise ValueError(
            "fuse takes a list of clouds, got a single one: give fuse([first, second, ...])"
        )
    tables = [cloud_attributes(cloud) for cloud in clouds]
    if poses is not None:
        if len(tables) != len(poses):
            raise ValueError(
                f"{len(tables)} clouds but {len(poses)} poses: give one pose for each cloud"
            )
        checked = [check_pose(pose, f"pose {k}") for k, pose in enumerate(poses)]
        tables = [_move(table, pose) for table, pose in zip(tables, checked, strict=True)]
    numbers_in_use = {
        int(number) for table in tables for number in np.unique(table.get("sensor", ()))
    }
    unnumbered = [
        k for k, table in enumerate(tables) if "sensor" not in table and len(table["positions"])
    ]
    for k in unnumbered:
        if k in numbers_in_use:
            raise ValueError(
                f"cloud {k} has no sensor number, and another has number {k}: give it one by "
                "from_points"
            )
        tables[k]["sensor"] = np.full(len(tables[k]["positions"]), k, np.int32)
    if poses is None and len(unnumbered) > 1:
        names = ", ".join(map(str, unnumbered[:MAX_LISTED_CLOUDS]))
        rule = "have neither a pose nor a sensor number, so they are taken to be in one frame"
        warnings.warn(
            f"clouds {names} {rule}: give poses=, np.eye(4) for each that is", stacklevel=2
        )
    return _join([table for table in tables if len(table["positions"])])


def _join(tables: Sequence[Attributes]) -> PointCloud:
    """Join clouds, given by their attributes, into one.

    Each has the attribute "sensor", numbers of sensors. Attributes that not all clouds have in one
    width are dropped, with a warning."""
    if not tables:
        return from_points(np.zeros((0, 3), np.float32))
    names = {name for table in tables for name in table} - {"sensor"}
    common_names = [name for name in tables[0] if name in names and _have_one_width(tables, name)]
    if len(common_names) < len(names):
        dropped = ", ".join(sorted(names - set(common_names)))
        warnings.warn(
            f"fuse drops {dropped}: not all {len(tables)} clouds have them in one width",
            stacklevel=3,
        )
    numbers = [np.asarray(table["sensor"]).reshape(-1) for table in tables]
    fused = {"sensor": np.concatenate(numbers)}
    for name in common_names:
        fused[name] = np.concatenate([table[name] for table in tables])
    return from_attributes(fused)


def _have_one_width(tables: Sequence[Attributes], name: str) -> bool:
    """True if all clouds have an attribute, in the same width."""
    widths = {table[name].shape[1:] if name in table else None for table in tables}
    return len(widths) == 1


def _move(table: Attributes, pose: Pose) -> Attributes:
    """Return a cloud's attributes with positions (float64) moved and normals turned by a pose."""
    moved = {"positions": transform(pose, table["positions"].astype(np.float64))}
    if "normals" in table:
        rotation = pose[:3, :3].astype(table["normals"].dtype)
        moved["normals"] = table["normals"] @ rotation.T
    return {**table, **moved}


def cloud_attributes(cloud: AnyCloud) -> Attributes:
    """Return the attributes of any cloud that `fuse` takes, by name.

    Covariances of a legacy cloud are left out, with a warning.

    Raises:
        ValueError: It is neither a cloud of Open3D nor an array (n, 3), or (n, 4) with intensity.
    """
    if isinstance(cloud, PointCloud):
        return {"positions": np.zeros((0, 3), np.float32), **attributes(cloud)}
    if isinstance(cloud, o3d.geometry.PointCloud):
        columns = {"positions": np.array(cloud.points)}
        if cloud.has_normals():
            columns["normals"] = np.array(cloud.normals)
        if cloud.has_colors():
            columns["colors"] = np.array(cloud.colors)
        if cloud.has_covariances():
            warnings.warn("the covariances of a legacy cloud are left out", stacklevel=3)
        return columns
    points = np.asarray(cloud)
    if points.ndim != 2 or points.shape[1] not in (3, 4) or points.dtype.kind not in "fiu":
        hint = ": pass points.T?" if points.ndim == 2 and points.shape[0] in (3, 4) else ""
        rule = "a cloud must be Open3D's or an array (n, 3) of x, y, z or (n, 4) with intensity"
        raise ValueError(f"{rule}, got {type(cloud).__name__} {points.shape}{hint}")
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    columns = {"positions": points[:, :3]}
    return columns if points.shape[1] == 3 else {**columns, "intensity": points[:, 3:]}


def down_sample(cloud: AnyCloud, voxel_m: float) -> PointCloud:
    """Keep one point of each sensor in each cube of edge `voxel_m` (m), with all its attributes.

    It is the point nearest to the mean of the sensor's points in the cube, the first of equals, and
    points keep their order. Sensors are thinned separately, so that sets of sensors stay
    comparable. cloud: any that `fuse` takes.
    """
    if not 0 < voxel_m < np.inf:
        raise ValueError(f"voxel_m must be above 0 m, got {voxel_m}")
    cloud = _tensor_cloud(cloud)
    points = positions(cloud).astype(np.float64)
    if not len(points):
        return _select(cloud, np.zeros(0, bool))
    # a cube of a sensor is named by four numbers
    cube_names = np.column_stack([np.floor(points / voxel_m), sensor_numbers(cloud)])
    _, inverse, count = np.unique(cube_names, axis=0, return_inverse=True, return_counts=True)
    cube = inverse.reshape(-1)  # number of each point's cube
    totals = np.stack([np.bincount(cube, column) for column in points.T], axis=1)
    means = totals / count[:, None]
    squared_distance = ((points - means[cube]) ** 2).sum(axis=1)
    # by cube, then distance, then place in the cloud; rounded, so that equals count as equal
    order = np.lexsort((np.arange(len(points)), squared_distance.round(12), cube))
    first_of_cube = np.append(0, np.cumsum(count)[:-1])  # index in `order`
    keep = np.zeros(len(points), bool)
    keep[order[first_of_cube]] = True
    return _select(cloud, keep)


def crop(
    cloud: AnyCloud, area: Area, height: float | None = None, *, floor: float = 0.0
) -> PointCloud:
    """Keep the points inside an area, at floor < z < height.

    Args:
        cloud: Any that `fuse` takes.
        area: Site, or xmin, ymin, xmax, ymax (m).
        height: m; the site's by default, else 4 m (paper section II-B).
        floor: m. On a site that slopes, z counts from its plane.
    """
    if np.isnan(floor):
        raise ValueError("floor must be a number of metres, got NaN")
    cloud = _tensor_cloud(cloud)
    return _select(cloud, Crop.from_place(area, height).holds(positions(cloud), floor))


def points_per_box(cloud: AnyCloud, boxes: Float[np.ndarray, "m 7"]) -> Int64[np.ndarray, " m"]:
    """Return the number of points in each box, the paper's point density.

    cloud: any that `fuse` takes.
    """
    return count_points(cloud_attributes(cloud)["positions"], boxes)


def save(cloud: PointCloud, path: str | Path) -> None:
    """Write a cloud as ply, pcd or npz, whole or not at all.

    A warning states the origin from which a pcd far from the world's origin counts, and what the
    file cannot hold.

    Raises:
        OSError: The file cannot be written.
        ValueError: The ending is another one, or the cloud has no points, which these formats
            cannot hold.
    """
    path = Path(path)
    if not len(positions(cloud)):
        raise ValueError(
            f"the cloud for {path.name} has no points: is the area where the sensors are?"
        )
    if path.suffix.lower() not in (".ply", ".pcd", ".npz"):
        raise ValueError(f"a cloud is saved as .ply, .pcd or .npz, got {path.name}")
    refused = OSError(f"cannot write {path}: check that its folder exists and the disk has room")
    if not path.parent.is_dir():
        raise refused
    if path.suffix.lower() == ".npz":
        with writing(path) as unfinished:
            reserve(unfinished, sum(values.numpy().nbytes for _, values in cloud.point.items()))
            if not o3d.t.io.write_point_cloud(unfinished, cloud):
                raise refused
    elif path.suffix.lower() == ".ply":
        write_bytes(path, format_ply(attributes(cloud)))
    else:
        content, origin = format_pcd(attributes(cloud))
        write_bytes(path, content)
        if origin.any():
            where = " ".join(f"{value:.0f}" for value in origin)
            rule = (
                "PCD holds float32, so its points are counted from an origin that its header states"
            )
            warnings.warn(
                f"{path.name}: {rule}: {where} m; .ply and .npz hold them whole", stacklevel=2
            )


def load(path: str | Path) -> PointCloud:
    """Read a ply, pcd or npz with all its attributes; sensor 0 if it names none.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file holds no cloud.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such cloud file: {path}")
    kind = path.suffix.lower()
    readers: dict[str, Callable[[Path], dict[str, np.ndarray]]] = {
        ".ply": read_ply,
        ".pcd": read_pcd,
        ".npz": partial(load_arrays, max_bytes=MAX_CLOUD_BYTES),
    }
    if kind not in readers:
        raise ValueError(
            f"a cloud is read from .ply, .pcd or .npz, got {path.name}: see "
            "toolkit.datasets.cloud_files"
        )
    columns = readers[kind](path)
    _check_positions(path, columns)
    count = len(columns["positions"])
    sound = {name: column for name, column in columns.items() if _is_sound(column, count)}
    lost = [name for name in columns if name not in sound]
    if lost:
        warnings.warn(
            f"{path.name}: {', '.join(lost)} left out: no number for each of {count} points",
            stacklevel=2,
        )
    sensor = sound.get("sensor", np.zeros(0))
    if "sensor" in columns and (sensor.dtype.kind not in "iu" or sensor.size != count):
        raise ValueError(
            f"{path}: sensor must be a whole number for each of {count} points: write it again"
        )
    return from_attributes(sound)


def _check_positions(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError for columns of a file without positions (n, 3) of floats.

    path: the file, for the error; columns: arrays of the file by name."""
    points = columns.get("positions")
    is_table = points is not None and points.ndim == 2 and points.shape[1] == 3
    if points is not None and is_table and points.dtype in (np.float32, np.float64):
        return
    columns_text = ", ".join(
        f"{name} {column.dtype} {column.shape}" for name, column in columns.items()
    )
    rule = "its array positions must be (n, 3) of float32 or float64"
    got = columns_text[:MAX_LISTED] or "no array"
    raise ValueError(f"{path} has no points: {rule}, got {got}")


def _is_sound(column: np.ndarray, count: int) -> bool:
    """True for a column of numbers, one or several for each of the `count` points of a cloud."""
    is_number = column.dtype.kind in "iub" or column.dtype in (np.float32, np.float64)
    has_rows = column.ndim in (1, 2) and len(column) == count
    return is_number and column.dtype.isnative and has_rows


def _tensor_cloud(cloud: AnyCloud) -> PointCloud:
    """Return a cloud as tensors."""
    return cloud if isinstance(cloud, PointCloud) else from_attributes(cloud_attributes(cloud))


def _select(cloud: PointCloud, keep: Mask) -> PointCloud:
    """Return the points of a mask, with all their attributes."""
    selection = PointCloud()
    rows = np.flatnonzero(keep)
    for name in cloud.point:
        selection.point[name] = o3d.core.Tensor.from_numpy(
            cloud.point[name].cpu().numpy().take(rows, axis=0)
        )
    return selection
