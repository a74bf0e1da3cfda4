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
        numbers: Mapping[str, object] = (
            _poses_of_json(text_values.parse_json(text)) if is_json else _poses_of_text(text)
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
    """Load the pose of each cloud file, in their order.

    paths: the cloud files; files: one pose file for all clouds, or one for each; inverted: see
    `read_poses`. Raises ValueError if there is not one pose for each cloud."""
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

    Poses without names, called 0, 1, 2, ..., are matched in order. Raises ValueError if neither
    fits."""
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
    """Parse a pose (4, 4) of 16, 12 or 7 numbers, nested or flat, see `POSE_FORMS`.

    name: what errors call it."""
    try:
        flat = np.array(numbers, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        forms = POSE_FORMS if isinstance(numbers, dict) else "numbers"
        raise ValueError(f"{name} must be {forms}, got {str(numbers)[:60]}") from None
    if flat.size == 7:
        with reading.name_errors(name):
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
    """Return True if four numbers keep a sensor upright only when read as x y z w.

    Read as w x y z they turn the sensor upside down or half round."""
    # upright_first and upright_last: z of the sensor's z axis, positive for an upright sensor
    q = quaternion.tolist()
    if q[0] == q[1] == 0.0:
        return q[3] != 0.0
    upright_first = 1 - 2 * (q[1] ** 2 + q[2] ** 2)
    upright_last = 1 - 2 * (q[0] ** 2 + q[1] ** 2)
    return upright_first < 0 < upright_last


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
    pose[:3, :3] = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    pose[:3, 3] = translation
    return pose


def _poses_of_json(content: object) -> dict[str, object]:
    # Numbers of each pose by name, from a pose, a list of poses or an object of poses.
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
    """Return the poses of a table's rows by the name in the row, or by the row's number.

    columns: names of the columns; rows: cells of each row."""
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
    # Numbers of each pose by name; one more cell than a pose has numbers is its name.
    rows = [list(filter(None, row)) for row in split_rows(text)]
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
