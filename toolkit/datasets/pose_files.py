"""Poses of sensors in files.

A pose is world_SE3_sensor (world → sensor with `inverted`): 16 numbers (4×4 by rows), 12 (the first
three rows, as KITTI) or 7 (qw qx qy qz tx ty tz, metres). A pose file is JSON (one pose, a list of
poses, or an object {name: pose}) or text (one pose a line, with or without its name before it, or
one pose in four lines, or rows under the names name, qw, qx, qy, qz, tx, ty, tz in any order). A
pose's name is its cloud's file name without the ending. All is float64, so that map coordinates of
a million metres keep their millimetres."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.datasets.text_clouds import MAX_SHOWN, split_rows
from toolkit.geometry import check_pose, invert
from toolkit.runtime import reading, text_values

POSE_FORMS = "16, 12 or 7 numbers (4×4, 3×4, or qw qx qy qz tx ty tz)"
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
PLACE_COLUMNS = (("tx", "ty", "tz"), ("tx_m", "ty_m", "tz_m"), ("x", "y", "z"))
NAME_COLUMNS = ("name", "sensor", "sensor_name", "frame", "file", "id")


def read_poses(path: str | Path, *, inverted: bool = False) -> dict[str, Pose]:
    """Read the poses (4, 4) of a file by name; unnamed poses are called 0, 1, 2, ...

    inverted: True if the file gives world → sensor; the result is always world_SE3_sensor.
    Raises ValueError that names a bad pose."""
    path = Path(path)
    if not path.exists() or path.is_dir():
        raise FileNotFoundError(f"no such pose file: {path}")
    text = reading.read_text(path)  # once: it may be a pipe, which has no ending either
    try:
        is_json = path.suffix.lower() == ".json" or text.lstrip()[:1] in ("[", "{")
        # the numbers of each pose, not parsed yet
        unparsed_poses: Mapping[str, object] = (
            _list_json_poses(text_values.parse_json(text)) if is_json else _list_text_poses(text)
        )
    except ValueError as error:
        raise ValueError(f"{path} holds no poses: {error}") from None
    poses = {
        name: parse_pose(numbers, f"pose {name!r} of {path}")
        for name, numbers in unparsed_poses.items()
    }
    return {name: invert(pose) for name, pose in poses.items()} if inverted else poses


def load_poses(
    paths: Sequence[str | Path], files: Sequence[str | Path], *, inverted: bool = False
) -> list[Pose]:
    """Load the pose of each cloud file, in their order.

    paths: the cloud files; files: one pose file for all clouds, or one for each; inverted: True if
    the files give world → sensor. Raises ValueError if there is not one pose for each cloud."""
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
    """Return the pose of each cloud file, matched by file name with or without ending or folder.

    paths: the cloud files; poses: by name. Poses without names, called 0, 1, 2, ..., are matched in
    order. Raises ValueError if neither fits."""
    stems = [Path(path).stem.removesuffix(".pcd") for path in paths]  # of .pcd.bin too
    file_names = [Path(path).name for path in paths]
    path_names = [Path(path).as_posix() for path in paths]
    for names in (stems, file_names, path_names):
        if poses.keys() >= set(names) and len(set(names)) == len(names):
            return [poses[name] for name in names]
    if len(poses) == len(paths) and list(poses) == [str(k) for k in range(len(poses))]:
        return list(poses.values())
    both_names = f"files {', '.join(stems)}, poses {', '.join(poses)}"
    raise ValueError(
        f"cannot tell which pose is whose: {both_names}; name each pose as its file, such as "
        f"{stems[0]!r}"
    )


def parse_pose(numbers: object, name: str = "pose") -> Pose:
    """Parse a pose (4, 4) of 16 or 12 numbers (4×4 or 3×4 by rows), or 7 (quaternion and place).

    numbers: nested or flat, also as text; name: what errors call it. Raises ValueError for anything
    else."""
    try:
        flat_numbers = np.array(numbers, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        forms = POSE_FORMS if isinstance(numbers, dict) else "numbers"
        raise ValueError(f"{name} must be {forms}, got {str(numbers)[:60]}") from None
    if flat_numbers.size == 7:
        with reading.name_errors(name):
            _check_order(flat_numbers)
            pose = quaternion_pose(quaternion=flat_numbers[:4], translation=flat_numbers[4:])
        return check_pose(pose, name)
    if flat_numbers.size == 12:
        flat_numbers = np.append(flat_numbers, [0.0, 0.0, 0.0, 1.0])
    if flat_numbers.size != 16:
        raise ValueError(f"{name} must be {POSE_FORMS}, got {flat_numbers.size}")
    return check_pose(flat_numbers.reshape(4, 4), name)


def _check_order(numbers: Float64[np.ndarray, "7"]) -> None:
    """Raise ValueError if the quaternion comes last, as in TUM's trajectories; warn if it might.

    numbers: qw qx qy qz tx ty tz, if they are in the right order. Also warn of a quaternion whose w
    might be last."""
    starts_with_quaternion = abs(np.linalg.norm(numbers[:4]) - 1) < 0.01
    ends_with_quaternion = abs(np.linalg.norm(numbers[3:]) - 1) < 0.01
    if ends_with_quaternion and not starts_with_quaternion:
        raise ValueError(
            f"it ends in a quaternion of length 1, got {numbers.tolist()}: write qw qx qy qz tx "
            "ty tz"
        )
    # with tx = ty = 0 it may well be a sensor 1 m above the origin
    if ends_with_quaternion and np.any(numbers[4:6]):
        orders = "qw qx qy qz tx ty tz, but might be tx ty tz qx qy qz qw"
    elif _is_likelier_last(numbers[:4]):
        orders = "qw qx qy qz tx ty tz, but might be qx qy qz qw tx ty tz"
    else:
        return
    remedy = "write a 4×4 matrix if so"
    warnings.warn(f"the pose {numbers.tolist()} is read as {orders}: {remedy}", stacklevel=4)


def _is_likelier_last(quaternion: Float64[np.ndarray, "4"]) -> bool:
    """Return True if four numbers are a likelier pose of a sensor when read as x y z w.

    They are if they keep it upright when read so, but turn it upside down when read as w x y z. Of
    numbers whose first two are 0, both readings may be upright."""
    w, x, y, z = quaternion.tolist()  # named as if w came first
    # with w last, this is a turn about the vertical; if the last number is 0, it is half a turn,
    # and no likelier than what w first gives
    if w == x == 0.0:
        return z != 0.0
    # z of the sensor's z axis is 1 - 2 (x² + y²), positive for an upright sensor; if w comes last,
    # the first two numbers are really x and y
    up_if_w_first = 1 - 2 * (x**2 + y**2)
    up_if_w_last = 1 - 2 * (w**2 + x**2)
    return up_if_w_first < 0 < up_if_w_last


def quaternion_pose(
    quaternion: Float64[np.ndarray, "4"], translation: Float64[np.ndarray, "3"]
) -> Pose:
    """Return the pose of a unit quaternion w x y z and a translation (m).

    Raises ValueError for a length more than 1 % from 1."""
    norm = float(np.linalg.norm(quaternion))
    if not 0.99 < norm < 1.01:
        raise ValueError(
            f"a quaternion qw qx qy qz must have length 1, got {quaternion.tolist()} of length "
            f"{norm:.4g}"
        )
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    xyzw = np.roll(quaternion, -1)  # SciPy's order
    pose[:3, :3] = Rotation.from_quat(xyzw).as_matrix()
    pose[:3, 3] = translation
    return pose


def _list_json_poses(content: object) -> dict[str, object]:
    """Return the numbers of each pose by name, not parsed yet.

    content: parsed JSON, a pose, a list of poses or an object {name: pose}. Raises ValueError for
    anything else."""
    if isinstance(content, dict):
        if not content:
            raise ValueError("it is empty")
        # a pose may be among other fields of a sensor, as coview calibrate writes them
        return {
            name: pose.get("world_SE3_sensor", pose) if isinstance(pose, dict) else pose
            for name, pose in content.items()
        }
    if not isinstance(content, list) or not content:
        raise ValueError("it must be a pose, a list of poses, or an object {name: pose}")
    number_count = np.array(content, dtype=object).size
    is_one_pose = number_count in (7, 12, 16) and not isinstance(content[0], dict)
    return {str(k): pose for k, pose in enumerate([content] if is_one_pose else content)}


def _list_table_poses(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[str, object]:
    """Return the poses of a table's rows by the name in the row, or by the row's number.

    columns: names of the columns; rows: cells of each row. Raises ValueError for a table without
    the columns of a pose, with a missing cell, or with one name twice."""
    position_columns = next((names for names in PLACE_COLUMNS if set(names) <= set(columns)), None)
    if position_columns is None or len(set(columns)) < len(columns):
        rule = "one each of qw, qx, qy, qz, and tx, ty, tz or x, y, z in metres"
        raise ValueError(f"its columns must be {rule}, got {', '.join(columns)[:MAX_SHOWN]}")
    if any(len(row) != len(columns) for row in rows) or not rows:
        raise ValueError("it must have a cell under each of its names in every row")
    name_column = next((columns.index(name) for name in NAME_COLUMNS if name in columns), None)
    pose_columns = [columns.index(name) for name in (*QUATERNION_COLUMNS, *position_columns)]
    if name_column is None:
        row_names = [str(number) for number in range(len(rows))]
    else:
        row_names = [row[name_column] for row in rows]
    if len(set(row_names)) < len(row_names):
        raise ValueError(f"two poses have one name: {', '.join(row_names)[:MAX_SHOWN]}")
    poses: dict[str, object] = {}
    for name, row in zip(row_names, rows, strict=True):
        numbers = np.array([row[column] for column in pose_columns], np.float64)
        poses[name] = quaternion_pose(quaternion=numbers[:4], translation=numbers[4:])
    return poses


def _list_text_poses(text: str) -> Mapping[str, object]:
    """Return the cells of each pose by name: a pose a line, one in four lines, or a table.

    A line with one more cell than a pose has numbers begins with the name. Raises ValueError for an
    empty text and for one name twice."""
    rows = [list(filter(None, row)) for row in split_rows(text)]
    if not rows:
        raise ValueError("it is empty")
    header = [cell.lower() for cell in rows[0]]
    if set(QUATERNION_COLUMNS) <= set(header):
        return _list_table_poses(columns=header, rows=rows[1:])
    if [len(row) for row in rows] in ([4] * 4, [4] * 3):  # the rows of one matrix
        return {"0": [number for row in rows for number in row]}
    row_names = []
    row_numbers = []
    for k, row in enumerate(rows):
        # one cell more than a quaternion pose (7), or a matrix of three (12) or four rows (16)
        has_name = len(row) in (8, 13, 17)
        row_names.append(row[0].removesuffix(":") if has_name else str(k))
        row_numbers.append(row[1:] if has_name else row)
    if len(set(row_names)) < len(row_names):
        raise ValueError(f"two poses have one name: {', '.join(row_names)}")
    return dict(zip(row_names, row_numbers, strict=True))
