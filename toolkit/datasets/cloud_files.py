"""Recorded clouds from point files.

.ply .pcd .npz       with all their attributes
.xyz .txt .csv       text, separated by blanks, commas or semicolons: x y z first in each row,
                     or under a line or comment that names the columns
                     (`toolkit.point_columns`), kept if numeric
.npy                 array (n, 3 or more), x y z first, no other column kept; or one with names
.bin                 KITTI's: float32 x y z intensity; .pcd.bin, nuScenes': float32 x y z
                     intensity ring
.feather             columns x, y, z and others, as Argoverse 2 has them (needs pyarrow)
.las .laz            surveyors' scans, with all their attributes (needs laspy)"""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float32, Float64, Pose
from toolkit.datasets.coordinates import check_extent, describe_rounding
from toolkit.datasets.feather_files import read_table
from toolkit.datasets.text_clouds import read_text_columns
from toolkit.geometry import check_pose
from toolkit.point_columns import Attributes, find_axes, name_attributes
from toolkit.point_files.las import read_las
from toolkit.runtime import array_files, reading

if TYPE_CHECKING:
    from toolkit.clouds import PointCloud

MAX_CHECKED_ROWS = 1000  # rows of a .bin file whose columns are compared with other widths


def fuse_files(paths: Sequence[str | Path], poses: Sequence[Pose]) -> "PointCloud":
    """Read clouds from files and fuse them in the common frame of their poses, as float64.

    Sensor k recorded paths[k] at the pose poses[k]. Normals turn with their pose. Attributes that
    all files have with equal widths stay; a warning names the others. Points that are not finite,
    or at 0 0 0, are left out. Raises FileNotFoundError, and ValueError for a file without points or
    an invalid pose."""
    from toolkit.clouds import from_attributes, fuse

    if len(paths) != len(poses):
        raise ValueError(
            f"{len(paths)} cloud files but {len(poses)} poses: give one pose for each file"
        )
    checked_poses = [
        check_pose(pose, f"pose of {path}") for path, pose in zip(paths, poses, strict=True)
    ]
    clouds = []
    for number, path in enumerate(paths):
        attributes = _drop_infinite(read_recorded(path))
        has_return = (attributes["positions"] != 0).any(axis=1)
        no_return = int((~has_return).sum())
        if no_return:
            warnings.warn(
                f"{path}: {no_return} points at 0 0 0, of no return, are left out", stacklevel=2
            )
            attributes = {name: column[has_return] for name, column in attributes.items()}
        rounding = describe_rounding(attributes["positions"])
        if rounding:
            warnings.warn(f"{path}: {rounding}", stacklevel=2)
        clouds.append(from_attributes(attributes, sensor_id=number))
    return fuse(clouds, checked_poses)


def crop_area(
    cloud: "PointCloud",
    area: Sequence[float],
    height: float | None = None,
    *,
    floor: float = 0.0,
    remedy: str = "",
) -> "PointCloud":
    """Keep a cloud's points inside an area; raise ValueError if no point remains.

    area: xmin, ymin, xmax, ymax (m); height, floor: points with floor < z < height (m) stay,
    below 4 m by default; remedy: words that end the error, after the extent of the points."""
    from toolkit.clouds import crop, positions

    cropped_cloud = crop(cloud, area, height, floor=floor)
    if len(positions(cropped_cloud)):
        return cropped_cloud
    points = positions(cloud)
    if not len(points):
        raise ValueError("the clouds hold no point with finite coordinates: give others")
    bounds = zip("xyz", points.min(axis=0), points.max(axis=0), strict=True)
    extent = ", ".join(f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in bounds)
    raise ValueError(
        f"none of the {len(points)} points lies in the area: they lie at {extent} m; {remedy}"
    )


def read_points(path: str | Path) -> Float64[np.ndarray, "n 3"]:
    """Read the points of one file that are finite, as they are stored."""
    return _drop_infinite(read_recorded(path))["positions"]


def _drop_infinite(recorded: Attributes) -> Attributes:
    """Return attributes without the points whose coordinates are not finite."""
    is_finite = np.isfinite(recorded["positions"]).all(axis=1)
    return {name: column[is_finite] for name, column in recorded.items()}


def read_recorded(path: str | Path) -> Attributes:
    """Read the attributes of one file's points by name, including `positions` (n, 3; float64).

    Points that are not finite are kept. Raises FileNotFoundError, and ValueError for a file that
    holds no points."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such cloud file: {path}")
    with np.errstate(all="ignore"):
        attributes = _read_by_ending(path)
        attributes["positions"] = np.asarray(attributes["positions"], np.float64)
        with reading.name_errors(path):
            check_extent(attributes["positions"])
    return attributes


def _read_by_ending(path: Path) -> Attributes:
    """Attributes of one file, read as its ending states; ValueError for an unknown ending."""
    readers = {
        (".ply", ".pcd", ".npz"): _read_cloud,
        (".xyz", ".txt", ".csv"): _read_text,
        (".npy",): _read_array,
        (".bin",): _read_binary,
        (".feather",): _read_feather,
        (".las", ".laz"): read_las,
    }
    for endings, reader in readers.items():
        if path.suffix.lower() in endings:
            return reader(path)
    raise ValueError(
        f"{path}: a cloud file ends in .ply .pcd .npz .xyz .txt .csv .npy .bin .feather .las "
        "or .laz"
    )


def _read_cloud(path: Path) -> Attributes:
    """Attributes of a file with named columns, without the numbers of sensors."""
    from toolkit.clouds import attributes, load

    return {name: column for name, column in attributes(load(path)).items() if name != "sensor"}


def _read_text(path: Path) -> Attributes:
    """Attributes of a text file."""
    return name_attributes(read_text_columns(path))


def _read_array(path: Path) -> Attributes:
    """Attributes of a .npy file: rows of x y z, or named columns.

    Raises ValueError for other arrays."""
    table = array_files.load_arrays(path).get("")  # "" is the array of a .npy file
    if table is None:
        raise ValueError(f"{path} is an archive of arrays, not one: call it .npz")
    if table.dtype.names is not None and table.ndim == 1:
        fields = {name: table[name] for name in table.dtype.names if table[name].ndim == 1}
        with reading.name_errors(path):
            return name_attributes(fields)
    if table.ndim != 2 or table.shape[1] < 3:
        raise ValueError(f"{path} must hold rows of x y z, got an array of shape {table.shape}")
    if table.dtype.kind not in "fiu":
        raise ValueError(f"{path} must hold numbers, got an array of {table.dtype}")
    # columns of points instead of rows; a cloud of three or four points is not that wide
    if len(table) in (3, 4) and table.shape[1] > 20:
        raise ValueError(
            f"{path} must hold rows of x y z, got an array of shape {table.shape}: transpose it"
        )
    return {"positions": table[:, :3]}


def _read_binary(path: Path) -> Attributes:
    """Attributes of rows of float32, as KITTI and nuScenes write them.

    Raises ValueError for numbers that seem to be of another type or width."""
    is_nuscenes = path.name.lower().endswith(".pcd.bin")
    names = ("x", "y", "z", "intensity", "ring")[: 5 if is_nuscenes else 4]
    rule = f"{path} must hold rows of float32 {' '.join(names)}"
    size = path.stat().st_size
    count = len(names)
    if size % (4 * count):  # a float32 has 4 bytes
        raise ValueError(
            f"{path} must hold rows of {count} float32, but {size} bytes are no whole number "
            "of them"
        )
    rows = np.frombuffer(reading.read_plain(path), "<f4").reshape(-1, count)
    intensities = rows[:, 3]
    # bytes of another type make some intensities negative
    if len(rows) and np.mean(intensities < 0) > 0.01:
        problem = f"{rule}, but its intensities are below 0"
        raise ValueError(f"{problem}: save other types or columns as .npy or .csv")
    if not is_nuscenes and _has_five_columns(rows):
        layout = "5 columns, the last of whole numbers, as nuScenes has them"
        raise ValueError(f"{rule}, but fits {layout}: call it .pcd.bin")
    return name_attributes(dict(zip(names, rows.T, strict=True)))


def _read_feather(path: Path) -> Attributes:
    """Attributes of a feather file: its columns by their usual names.

    Raises ValueError without columns of x, y and z that are numbers."""
    columns = read_table(path)
    with reading.name_errors(path):
        coordinate_names = find_axes(list(columns)).names
    if any(columns[name].dtype.kind not in "fiu" for name in coordinate_names):
        raise ValueError(f"{path} must hold numbers in its columns {', '.join(coordinate_names)}")
    return name_attributes(columns)


def _has_five_columns(rows: Float32[np.ndarray, "n 4"]) -> bool:
    """Return True if numbers read as rows of 4 look like rows of 5, whose fifth, a ring, is whole.

    rows: as read, x y z intensity if they are really 4 wide. Whole intensities speak for 4."""
    if rows.size % 5 or not len(rows):
        return False
    intensities = rows[:MAX_CHECKED_ROWS, 3]
    if (intensities == np.trunc(intensities)).all():
        return False
    rings = rows.reshape(-1, 5)[:MAX_CHECKED_ROWS, 4]
    return bool((rings == np.trunc(rings)).all()) and bool(rings.any())
