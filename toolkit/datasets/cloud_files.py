"""Recorded clouds from point files, and sensor poses to fuse them.

    .ply .pcd .npz       with all their attributes
    .xyz .txt .csv       text, separated by blanks, commas or semicolons: x y z first in each row,
                         or under a line or comment that names the columns
                         (`toolkit.point_columns`), kept if numeric
    .npy                 array (n, 3 or more), x y z first, no other column kept; or one with names
    .bin                 KITTI's: float32 x y z intensity; .pcd.bin, nuScenes': float32 x y z
                         intensity ring
    .feather             columns x, y, z and others, as Argoverse 2 has them (needs pyarrow)

A pose is world_SE3_sensor (world → sensor with `inverted`): 16 numbers (4×4 by rows), 12 (the first
three rows, as KITTI) or 7 (qw qx qy qz tx ty tz, metres). A pose file is JSON (one pose, a list of
poses, or an object {name: pose}) or text (one pose a line, with or without its name before it, or
one pose in four lines, or rows under the names name, qw, qx, qy, qz, tx, ty, tz in any order). A
pose's name is its cloud's file name without the ending. All is float64, so that map coordinates of
a million metres keep their millimetres."""

import csv
import io
import re
import struct
import warnings
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from toolkit.arrays import Float32, Float64, Pose
from toolkit.geometry import MAX_COORDINATE_M, check_pose, invert
from toolkit.point_columns import Attributes, find_axes, name_attributes, warn_of_offset
from toolkit.runtime import files

if TYPE_CHECKING:  # Open3D takes long to load, and simulated recordings do without
    from toolkit.clouds import PointCloud

_MIN_COORDINATE_M = 1e-30  # smaller ones are whole numbers, or parts of others, read as floats
MIN_ROUNDING_M = 0.01  # of float32 coordinates, for a warning
MIN_NUMBERED_ROWS = 5  # rows whose first cells 0, 1, 2, ... are no coordinates
POSE_FORMS = "16, 12 or 7 numbers (4×4, 3×4, or qw qx qy qz tx ty tz)"
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
PLACE_COLUMNS = (("tx", "ty", "tz"), ("tx_m", "ty_m", "tz_m"), ("x", "y", "z"))
NAME_COLUMNS = ("name", "sensor", "sensor_name", "frame", "file", "id")
MAX_SHOWN = 60  # characters of a row in an error
MAX_CHECKED_ROWS = 1000  # rows of a .bin file whose columns are compared with other widths
_MAX_SPREAD_M = 5000.0  # from the middle to half of a sensor's points; beyond are millimetres
_DICTIONARY = 2  # kind of an Arrow message
_BATCH = 3  # kind of an Arrow message
_DECIMAL_COMMA = (
    r'(?m)^[^#/\n]*\d,\d+[^\S\r\n]+-?\d|"[-+]?\d+,\d+"'  # with blanks or quotes between the cells
)
_COMMENT = "#|//"


def fuse_files(paths: Sequence[str | Path], poses: Sequence[Pose]) -> "PointCloud":
    """Return one float64 cloud in the poses' common frame.

    Sensor k recorded paths[k] at the pose poses[k]. Normals turn with their pose. Attributes that
    all files have stay; a warning names the others, see `fuse`. Raises FileNotFoundError, and
    ValueError for a file without points or an invalid pose."""
    from toolkit.clouds import from_attributes, fuse

    if len(paths) != len(poses):
        raise ValueError(
            f"{len(paths)} cloud files but {len(poses)} poses: give one pose for each file"
        )
    checked = [check_pose(pose, f"pose of {path}") for path, pose in zip(paths, poses, strict=True)]
    parts = []
    for number, path in enumerate(paths):
        recorded = _finite(read_recorded(path))
        returned = (recorded["positions"] != 0).any(axis=1)
        no_return = int((~returned).sum())
        if no_return:
            warnings.warn(
                f"{path}: {no_return} points at 0 0 0, of no return, are left out", stacklevel=2
            )
            recorded = {name: column[returned] for name, column in recorded.items()}
        rounding = describe_rounding(recorded["positions"])
        if rounding:
            warnings.warn(f"{path}: {rounding}", stacklevel=2)
        parts.append(from_attributes(recorded, number))
    return fuse(parts, checked)


def crop_area(
    cloud: "PointCloud",
    area: Sequence[float],
    height: float | None = None,
    *,
    floor: float = 0.0,
    remedy: str = "",
) -> "PointCloud":
    """Crop by `toolkit.clouds.crop`.

    If no point remains, raises ValueError with the positions of the points and `remedy`."""
    from toolkit.clouds import crop, positions

    cropped = crop(cloud, area, height, floor=floor)
    if not len(positions(cropped)):
        points = positions(cloud)
        if not len(points):
            raise ValueError("the clouds hold no point with finite coordinates: give others")
        bounds = zip("xyz", points.min(axis=0), points.max(axis=0), strict=True)
        extent = ", ".join(f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in bounds)
        raise ValueError(
            f"none of the {len(points)} points lies in the area: they lie at {extent} m; {remedy}"
        )
    return cropped


def read_points(path: str | Path) -> Float64[np.ndarray, "n 3"]:
    """Finite points of one file, as they are stored."""
    return _finite(read_recorded(path))["positions"]


def _finite(recorded: Attributes) -> Attributes:
    finite = np.isfinite(recorded["positions"]).all(axis=1)
    return {name: column[finite] for name, column in recorded.items()}


def read_recorded(path: str | Path) -> Attributes:
    """Attributes of one file by name, including `positions` (float64), also of points that are not
    finite.

    Raises FileNotFoundError, and ValueError for a file that holds no points."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such cloud file: {path}")
    with np.errstate(all="ignore"):
        recorded = _read(path)
        recorded["positions"] = np.asarray(recorded["positions"], np.float64)
        with files.name_errors(path):
            check_extent(recorded["positions"])
    return recorded


def check_extent(points: Float64[np.ndarray, "n 3"]) -> None:
    """Raise ValueError for numbers that are no positions, or too far apart to be in metres."""
    sample = points[:: len(points) // 1000 + 1]
    finite = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) and not np.isfinite(points).all(axis=1).any():
        raise ValueError(
            f"none of its {len(points)} points has three finite coordinates: record it again"
        )
    distances = (
        np.linalg.norm(finite - np.median(finite, axis=0), axis=1) if len(finite) else np.zeros(1)
    )
    if len(finite) and np.median(np.abs(finite).max(axis=1)) > MAX_COORDINATE_M:
        raise ValueError(
            f"half of its points are beyond {MAX_COORDINATE_M:g} m: give metres, or repair the file"
        )
    if np.median(distances) > _MAX_SPREAD_M:
        problem = (
            f"half of its points are more than {np.median(distances) / 1000:.3g} km from their "
            "middle"
        )
        raise ValueError(f"{problem}: give metres, or repair the file")
    is_tiny = (finite != 0) & (np.abs(finite) < _MIN_COORDINATE_M)
    outliers = np.unique(
        finite[(distances > _MAX_SPREAD_M) | is_tiny.any(axis=1)] if len(finite) else finite, axis=0
    )
    # a driver's value of no return is always the same
    if len(outliers) > max(5, 0.1 * len(finite)):
        raise ValueError(
            f"{len(outliers)} of {len(finite)} points, such as {outliers[0]}, are no places: "
            "repair the file"
        )


def describe_rounding(points: Float64[np.ndarray, "n 3"]) -> str | None:
    """Words on coordinates that lost centimetres before they were read; None if they did not."""
    sample = points[:: len(points) // 1000 + 1]
    sample = sample[np.isfinite(sample).all(axis=1)]
    farthest = np.median(np.abs(sample), axis=0).max() if len(sample) else 0.0
    step_m = float(np.spacing(np.float32(farthest)))
    if step_m < MIN_ROUNDING_M or (sample != sample.astype(np.float32)).any():
        return None
    lost = f"its coordinates are rounded to {step_m:g} m, as float32 does near {farthest:.0f} m"
    return f"{lost}: export them as double, or with an origin taken off"


def read_poses(path: str | Path, *, inverted: bool = False) -> dict[str, Pose]:
    """Poses of a file by name. Unnamed poses are called 0, 1, 2, ...

    Raises ValueError that names a bad pose."""
    path = Path(path)
    if not path.exists() or path.is_dir():
        raise FileNotFoundError(f"no such pose file: {path}")
    text = files.read_text(path)  # once: it may be a pipe, which has no ending either
    try:
        is_json = path.suffix.lower() == ".json" or text.lstrip()[:1] in ("[", "{")
        numbers: Mapping[str, object] = (
            _poses_of_json(files.parse_json(text)) if is_json else _poses_of_text(text)
        )
    except ValueError as error:
        raise ValueError(f"{path} holds no poses: {error}") from None
    poses = {
        name: parse_pose(values, f"pose {name!r} of {path}") for name, values in numbers.items()
    }
    return {name: invert(pose) for name, pose in poses.items()} if inverted else poses


def load_poses(
    paths: Sequence[str | Path], files: Sequence[str | Path], *, inverted: bool = False
) -> list[Pose]:
    """Load the pose of each cloud file from one pose file for all clouds, or from one file each."""
    if len(files) == 1:
        return match_poses(paths, read_poses(files[0], inverted=inverted))
    poses_by_file = [list(read_poses(file, inverted=inverted).values()) for file in files]
    if len(files) != len(paths) or any(len(poses) != 1 for poses in poses_by_file):
        raise ValueError(
            f"give one pose file for all {len(paths)} clouds, or {len(paths)} files of one pose "
            "each"
        )
    return [pose for (pose,) in poses_by_file]


def match_poses(paths: Sequence[str | Path], poses: Mapping[str, Pose]) -> list[Pose]:
    """Pose of each cloud, matched by file name with or without its ending or folder.

    Poses without names are matched in order."""
    stems = [Path(path).stem.removesuffix(".pcd") for path in paths]
    for names in (
        stems,
        [Path(path).name for path in paths],
        [Path(path).as_posix() for path in paths],
    ):
        if poses.keys() >= set(names) and len(set(names)) == len(names):
            return [poses[name] for name in names]
    if len(poses) == len(paths) and list(poses) == [str(k) for k in range(len(poses))]:
        return list(poses.values())
    whose = f"files {', '.join(stems)}, poses {', '.join(poses)}"
    raise ValueError(
        f"cannot tell which pose is whose: {whose}; name each pose as its file, such as "
        f"{stems[0]!r}"
    )


def parse_pose(numbers: object, name: str = "pose") -> Pose:
    """Parse a pose of 16, 12 or 7 numbers, nested or flat."""
    try:
        flat = np.array(numbers, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        forms = POSE_FORMS if isinstance(numbers, dict) else "numbers"
        raise ValueError(f"{name} must be {forms}, got {str(numbers)[:60]}") from None
    if flat.size == 7:
        with files.name_errors(name):
            _check_order(flat)
            placed = quaternion_pose(flat[:4], flat[4:])
        return check_pose(placed, name)
    if flat.size == 12:
        flat = np.append(flat, [0.0, 0.0, 0.0, 1.0])
    if flat.size != 16:
        raise ValueError(f"{name} must be {POSE_FORMS}, got {flat.size}")
    return check_pose(flat.reshape(4, 4), name)


def _check_order(numbers: Float64[np.ndarray, "7"]) -> None:
    """Raise ValueError if the quaternion comes last, as in TUM's trajectories; warn if it might."""
    is_first = abs(np.linalg.norm(numbers[:4]) - 1) < 0.01
    is_last = abs(np.linalg.norm(numbers[3:]) - 1) < 0.01
    if is_last and not is_first:
        raise ValueError(
            f"it ends in a quaternion of length 1, got {numbers.tolist()}: write qw qx qy qz tx "
            "ty tz"
        )
    if is_last and np.any(numbers[4:6]):
        read = "qw qx qy qz tx ty tz, but might be tx ty tz qx qy qz qw: write a 4×4 matrix if so"
        warnings.warn(f"the pose {numbers.tolist()} is read as {read}", stacklevel=4)
    elif _is_likelier_last(numbers[:4]):
        read = "qw qx qy qz tx ty tz, but might be qx qy qz qw tx ty tz: write a 4×4 matrix if so"
        warnings.warn(f"the pose {numbers.tolist()} is read as {read}", stacklevel=4)


def _is_likelier_last(quaternion: Float64[np.ndarray, "4"]) -> bool:
    """Return True if a quaternion keeps a sensor upright only with w last.

    With w first it turns the sensor half round or over."""
    q = quaternion.tolist()
    if q[0] == q[1] == 0.0:
        return q[3] != 0.0
    upright_first = 1 - 2 * (q[1] ** 2 + q[2] ** 2)
    upright_last = 1 - 2 * (q[0] ** 2 + q[1] ** 2)
    return upright_first < 0 < upright_last


def quaternion_pose(
    quaternion: Float64[np.ndarray, "4"], translation: Float64[np.ndarray, "3"]
) -> Pose:
    """Pose from a unit quaternion w x y z and a translation (m)."""
    norm = float(np.linalg.norm(quaternion))
    if not 0.99 < norm < 1.01:
        raise ValueError(
            f"a quaternion qw qx qy qz must have length 1, got {quaternion.tolist()} of length "
            f"{norm:.4g}"
        )
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    pose[:3, 3] = translation
    return pose


def read_table(path: str | Path) -> dict[str, np.ndarray]:
    """Columns of a feather file by name.

    Raises ImportError without pyarrow, ValueError for a damaged file."""
    try:
        import pyarrow.ipc
    except ImportError:
        raise ImportError("reading .feather needs pyarrow: pip install pyarrow") from None
    unpacked = 0
    try:
        content = files.read_plain(path)
        if content[:6] != b"ARROW1" or content[-6:] != b"ARROW1":
            raise ValueError("it is cut off or of another format: write it with pyarrow.feather")
        # the file's footer could point elsewhere
        stream = pyarrow.py_buffer(content).slice(8)
        batches = 0
        for message in pyarrow.ipc.MessageReader.open_stream(stream):
            batches += message.type == "record batch"
            unpacked += _batch_size(message.metadata.to_pybytes(), message.body or b"")
            files.check_unpacked(unpacked, files.MAX_CLOUD_BYTES)
        if batches != pyarrow.ipc.open_file(content).num_record_batches:
            raise ValueError("it lacks some of its rows: copy it again")
        table = pyarrow.ipc.open_stream(stream).read_all()
        table.validate(full=True)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        return {
            name: column.astype(np.float32) if column.dtype == np.float16 else column
            for name, column in columns.items()
        }
    except (
        pyarrow.ArrowException,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        MemoryError,
        struct.error,
    ) as error:
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"{path} is no feather file that can be read: {reason}") from None


def _batch_size(message: bytes, body: Any) -> int:
    """Bytes that a batch of an Arrow file declares to unpack to (its Message.fbs, a flat
    buffer)."""

    def number(kind: str, position: int) -> int:
        return int(struct.unpack_from(f"<{kind}", message, position)[0])

    def field(table: int, field_index: int) -> int:
        """Position of a table's field, 0 if the table lacks it."""
        fields = table - number("i", table)
        offset = (
            number("H", fields + 4 + 2 * field_index)
            if 4 + 2 * field_index < number("H", fields)
            else 0
        )
        return table + offset if offset else 0

    def pointed(position: int) -> int:
        return position + number("I", position)

    root = number("I", 0)
    kind = number("B", field(root, 1))
    batch = pointed(field(root, 2))
    if kind not in (_DICTIONARY, _BATCH):
        return 0
    batch = pointed(field(batch, 1)) if kind == _DICTIONARY else batch
    columns = pointed(field(batch, 1))
    buffers = pointed(field(batch, 2))
    rows = number("q", field(batch, 0)) if field(batch, 0) else 0
    # as NumPy's columns, also of nulls that take no bytes in the file
    size = rows * number("I", columns) * 8
    is_compressed = field(batch, 3)  # a compressed buffer begins with its size
    for k in range(number("I", buffers) if is_compressed else 0):
        position = number("q", buffers + 4 + 16 * k)
        length = number("q", buffers + 12 + 16 * k)
        size += max(length, struct.unpack_from("<q", body, position)[0] if length else 0)
    return size


def _read(path: Path) -> Attributes:
    ending = path.suffix.lower()
    if ending in (".ply", ".pcd", ".npz"):
        from toolkit.clouds import attributes, load

        return {name: column for name, column in attributes(load(path)).items() if name != "sensor"}
    if ending in (".xyz", ".txt", ".csv"):
        return name_attributes(_columns_of_text(path))
    if ending == ".npy":
        table = files.load_arrays(path).get("")
        if table is None:
            raise ValueError(f"{path} is an archive of arrays, not one: call it .npz")
        if table.dtype.names is not None and table.ndim == 1:
            fields = {name: table[name] for name in table.dtype.names if table[name].ndim == 1}
            with files.name_errors(path):
                return name_attributes(fields)
        if table.ndim != 2 or table.shape[1] < 3:
            raise ValueError(f"{path} must hold rows of x y z, got an array of shape {table.shape}")
        if table.dtype.kind not in "fiu":
            raise ValueError(f"{path} must hold numbers, got an array of {table.dtype}")
        if len(table) in (3, 4) and table.shape[1] > 20:
            raise ValueError(
                f"{path} must hold rows of x y z, got an array of shape {table.shape}: transpose it"
            )
        return {"positions": table[:, :3]}
    if ending == ".bin":
        names = ("x", "y", "z", "intensity", "ring")[
            : 5 if path.name.lower().endswith(".pcd.bin") else 4
        ]
        size = path.stat().st_size
        count = len(names)
        if size % (4 * count):
            raise ValueError(
                f"{path} must hold rows of {count} float32, but {size} bytes are no whole number "
                "of them"
            )
        rows = np.frombuffer(files.read_plain(path), "<f4").reshape(-1, count)
        if len(rows) and np.mean(rows[:, 3] < 0) > 0.01:
            problem = (
                f"{path} must hold rows of float32 {' '.join(names)}, but its intensities are "
                "below 0"
            )
            raise ValueError(f"{problem}: save other types or columns as .npy or .csv")
        if count == 4 and _has_five_columns(rows):
            layout = "5 columns, the last of whole numbers, as nuScenes has them"
            raise ValueError(
                f"{path} must hold rows of float32 {' '.join(names)}, but fits {layout}: call it "
                ".pcd.bin"
            )
        return name_attributes(dict(zip(names, rows.T, strict=True)))
    if ending == ".feather":
        columns = read_table(path)
        with files.name_errors(path):
            axes = find_axes(list(columns)).names
        if any(columns[name].dtype.kind not in "fiu" for name in axes):
            raise ValueError(f"{path} must hold numbers in its columns {', '.join(axes)}")
        return name_attributes(columns)
    raise ValueError(
        f"{path}: a cloud file ends in .ply .pcd .npz .xyz .txt .csv .npy .bin or .feather"
    )


def _has_five_columns(rows: Float32[np.ndarray, "n 4"]) -> bool:
    """Return True if rows of 4 numbers look like rows of 5 whose fifth, a ring, is whole."""
    if rows.size % 5 or not len(rows):
        return False
    fifth = rows.reshape(-1, 5)[:MAX_CHECKED_ROWS, 4]
    fourth = rows[:MAX_CHECKED_ROWS, 3]
    if (fourth == np.trunc(fourth)).all():
        return False
    return bool((fifth == np.trunc(fifth)).all()) and bool(fifth.any())


def _columns_of_text(path: Path) -> dict[str, np.ndarray]:
    """Columns of a text file: by the names above its rows, else x, y and z first.

    Other columns are read if they are named and purely numeric."""
    text = files.read_text(path)
    rows = _drop_count(_rows(text.replace('"', "") if '"' in text else text))
    warn_of_offset(_first_comments(text))
    names: list[str] = []
    if rows and not any(map(_is_number, rows[0])):
        names = _split_header(_uncommented(text, 0))
        rows = _drop_count(rows[1:])
    elif rows:
        names = _commented_header(text, len(rows[0]))
    widths = {len(row) - (not row[-1]) for row in rows}  # a row may end in its separator
    counts = sorted(widths | ({len(names) - (not names[-1])} if names else set()))
    if re.search(_DECIMAL_COMMA, text):
        raise ValueError(f"{path} must have no decimal commas: write points for them")
    if len(counts) > 1:
        got = f"got rows of {' and '.join(map(str, counts[:4]))}"
        raise ValueError(f"{path} must have as many cells in each row as names, {got}")
    if rows and not names:
        rows = _check_numbering(path, rows)
    column_by_name = _find_columns(path, names) if names else {"x": 0, "y": 1, "z": 2}
    try:
        table = {name: _parse_column(rows, column) for name, column in column_by_name.items()}
    except (ValueError, IndexError):
        columns = [*column_by_name.values()]
        row = next(row for row in rows if not _has_numbers(row, columns))
        got = f"got {', '.join(row)[:MAX_SHOWN]!r}"
        raise ValueError(
            f"{path} must hold x y z in every row, numbers with decimal points only, {got}"
        ) from None
    if not names and max(widths, default=0) >= 6 and "," in text and "." not in text:
        warnings.warn(
            f"{path}: all numbers are whole: if its commas are decimal, write points for them",
            stacklevel=2,
        )
    for column, name in enumerate(names):
        is_extra = name and name not in column_by_name
        if is_extra and all(_has_numbers(row, [column]) for row in rows):
            table[name.lower()] = _parse_column(rows, column)
    return table


def _find_columns(path: Path, names: list[str]) -> dict[str, int]:
    """Columns of x, y and z by their names."""
    repeated = {name for name in names if name and names.count(name) > 1}
    if repeated:
        raise ValueError(
            f"{path} must have each column once, got {', '.join(sorted(repeated))} again"
        )
    with files.name_errors(path):
        axes = find_axes(names).names
    return {name: names.index(name) for name in axes}


def _parse_column(rows: Sequence[Sequence[str]], column: int) -> Float64[np.ndarray, " n"]:
    return np.array([float(row[column]) for row in rows])


def _has_numbers(row: Sequence[str], columns: Sequence[int]) -> bool:
    return all(len(row) > column and _is_number(row[column]) for column in columns)


def _drop_count(rows: list[list[str]]) -> list[list[str]]:
    """Rows without a first row that holds their number, as in PTS files and CloudCompare's text."""
    return rows[1:] if rows and rows[0] == [str(len(rows) - 1)] else rows


def _check_numbering(path: Path, rows: list[list[str]]) -> list[list[str]]:
    """Rows without names, without a first one that numbers the columns.

    Raises ValueError if the first column numbers the rows, so that x would be their number."""
    width = len(rows[0])
    if width >= 3 and len(rows) > 1 and rows[0] == [str(k) for k in range(width)]:
        warnings.warn(
            f"{path}: its first row, {' '.join(rows[0])}, numbers the columns and is left out",
            stacklevel=4,
        )
        rows = rows[1:]
    first = rows[0][0]
    last = rows[-1][0]
    if (
        width < 4
        or len(rows) < MIN_NUMBERED_ROWS
        or first not in ("0", "1")
        or last != str(len(rows) - 1 + int(first))
    ):
        return rows
    if [row[0] for row in rows] == [str(k + int(first)) for k in range(len(rows))]:
        raise ValueError(
            f"{path} numbers its rows in the first column: name the columns in a line above"
        )
    return rows


def _rows(text: str) -> list[list[str]]:
    """The cells of each line that has any, without comments."""
    lines = (re.split(_COMMENT, line)[0].strip() for line in text.splitlines())
    return [re.split(rf"\s*{';' if ';' in line else ','}\s*|\s+", line) for line in lines if line]


def _uncommented(text: str, number: int) -> str:
    """Line of a text by its number among those that hold more than a comment."""
    lines = (re.split(_COMMENT, line)[0].strip() for line in io.StringIO(text, newline=None))
    return next(islice((line for line in lines if line), number, None))


def _split_header(line: str) -> list[str]:
    """Names of the columns in a line, without quotes."""
    joined = re.sub(r"\s+(?=[(\[])", "", line.strip())  # a unit belongs to the name before it
    separator = next((mark for mark in (";", ",", "\t") if mark in joined), None)
    if separator is None:
        return [name.strip("\"'") for name in joined.split()]
    cells = next(csv.reader([joined], delimiter=separator, skipinitialspace=True))
    return [cell.strip().strip("'") for cell in cells]


def _commented_header(text: str, width: int) -> list[str]:
    """Names in the last comment above the rows, [] if they do not fit.

    They fit if they are as many as cells and include coordinates."""
    comments = _first_comments(text)
    names = _split_header(comments[-1]) if comments else []
    try:
        find_axes(names)
    except ValueError:
        return []
    return names if len(names) == width else []


def _first_comments(text: str) -> list[str]:
    """Comments above the first row of a text."""
    comments = []
    for line in io.StringIO(text, newline=None):
        marked = re.match(rf"\s*(?:{_COMMENT})+(.*)", line)
        if marked is None and line.strip():
            break
        if marked is not None and marked[1].strip():
            comments.append(marked[1])
    return comments


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _poses_of_json(content: object) -> dict[str, object]:
    if isinstance(content, dict):
        if not content:
            raise ValueError("it is empty")
        # object with more fields of a sensor, as coview calibrate writes them
        placed = "world_SE3_sensor"
        return {
            name: pose.get(placed, pose) if isinstance(pose, dict) else pose
            for name, pose in content.items()
        }
    if not isinstance(content, list) or not content:
        raise ValueError("it must be a pose, a list of poses, or an object {name: pose}")
    single = np.array(content, dtype=object).size in (7, 12, 16) and not isinstance(
        content[0], dict
    )
    return {str(k): pose for k, pose in enumerate([content] if single else content)}


def _poses_of_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[str, object]:
    """Poses of rows under the names of their columns, by their name or number."""
    position_columns = next((names for names in PLACE_COLUMNS if set(names) <= set(columns)), None)
    if position_columns is None or len(set(columns)) < len(columns):
        rule = "one each of qw, qx, qy, qz, and tx, ty, tz or x, y, z in metres"
        raise ValueError(f"its columns must be {rule}, got {', '.join(columns)[:MAX_SHOWN]}")
    if any(len(row) != len(columns) for row in rows) or not rows:
        raise ValueError("it must have a cell under each of its names in every row")
    title = next((columns.index(name) for name in NAME_COLUMNS if name in columns), None)
    pose_columns = [columns.index(name) for name in (*QUATERNION_COLUMNS, *position_columns)]
    row_names = [str(number) if title is None else row[title] for number, row in enumerate(rows)]
    if len(set(row_names)) < len(row_names):
        raise ValueError(f"two poses have one name: {', '.join(row_names)[:MAX_SHOWN]}")
    poses: dict[str, object] = {}
    for name, row in zip(row_names, rows, strict=True):
        numbers = np.array([row[column] for column in pose_columns], np.float64)
        poses[name] = quaternion_pose(numbers[:4], numbers[4:])
    return poses


def _poses_of_text(text: str) -> Mapping[str, object]:
    rows = [list(filter(None, row)) for row in _rows(text)]
    if not rows:
        raise ValueError("it is empty")
    named_columns = [cell.lower() for cell in rows[0]]
    if set(QUATERNION_COLUMNS) <= set(named_columns):
        return _poses_of_table(named_columns, rows[1:])
    if [len(row) for row in rows] in ([4] * 4, [4] * 3):
        return {"0": [number for row in rows for number in row]}
    row_names = [
        row[0].removesuffix(":") if len(row) in (8, 13, 17) else str(k)
        for k, row in enumerate(rows)
    ]
    if len(set(row_names)) < len(row_names):
        raise ValueError(f"two poses have one name: {', '.join(row_names)}")
    return {
        name: row[1:] if len(row) in (8, 13, 17) else row
        for name, row in zip(row_names, rows, strict=True)
    }
