"""Values of records in foreign files, checked as they are read.

Damage becomes one line that names a file. Numbers may be strings (DAIR-V2X, and YAML's 1e-05), and
rotations may be slightly off; anything worse is a ValueError."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.geometry import check_pose
from toolkit.runtime.reading import read_bytes
from toolkit.runtime.text_values import parse_json

Unchecked = Any  # a value of a file
MAX_ROTATION_ERROR = 0.05  # largest entry of R Rᵀ - 1 of a rotation
_DAMAGE = (
    csv.Error,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    ArithmeticError,
    RecursionError,
)
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)  # last row of a pose's matrix


@contextmanager
def name_damage(
    path: str | Path, what: str, kinds: tuple[type[Exception], ...] = _DAMAGE
) -> Iterator[None]:
    """Turn errors of a `with` block that reads a file into one ValueError that names the file.

    Overflowing numbers give no warnings. what: what the file should be, such as "calibration";
    kinds: classes of errors that show damage; an OSError passes unchanged."""
    try:
        with np.errstate(all="ignore"):
            yield
    except OSError:
        raise
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no {what}: byte {error.start} is not UTF-8") from None
    except kinds as error:
        text = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        reason = " ".join(text.split())[:200] or type(error).__name__
        raise ValueError(f"{path} is no {what} that can be read: {reason}") from None


def load_json(path: str | Path) -> Unchecked:
    """Values of a JSON file; call it in `name_damage`."""
    return parse_json(read_bytes(path).decode("utf-8-sig"))


def entry(record: Unchecked, *keys: str) -> Unchecked:
    """Return record[key][key]..., or raise ValueError that names the missing key."""
    value = record
    for k, key in enumerate(keys):
        if not isinstance(value, dict) or key not in value:
            raise ValueError(f"it has no entry {'.'.join(keys[: k + 1])}")
        value = value[key]
    return value


def as_number(value: Unchecked, name: str = "entry") -> float:
    """Return a value as a number, also if it is written as a string; ValueError for others.

    name: what errors call it."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be a number, got {str(value)[:40]!r}") from None


def numbers(values: Unchecked, count: int, name: str = "entry") -> Float64[np.ndarray, " count"]:
    """Return the `count` numbers of a list, nested or flat, also as strings.

    name: what errors call the list. Raises ValueError for another count and for other values."""
    try:
        flat_numbers = np.array(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        flat_numbers = np.zeros(0)  # refused below
    if flat_numbers.size != count:
        raise ValueError(f"{name} must be {count} numbers, got {str(values)[:60]!r}")
    return flat_numbers


def xyz(record: Unchecked, name: str, axes: str = "xyz") -> Float64[np.ndarray, "3"]:
    """Return the three numbers of an entry such as {x: .., y: .., z: ..}.

    name: key of the entry in the record; axes: its keys, in the order of the result."""
    return np.array([as_number(entry(record, name, axis), f"{name}.{axis}") for axis in axes])


def as_list(content: Unchecked, name: str = "it") -> list[Unchecked]:
    """Return a value if it is a list, or raise ValueError. name: what errors call it."""
    if not isinstance(content, list):
        raise ValueError(f"{name} must be a list, got {str(content)[:40]!r}")
    return content


def rigid(rotation: Unchecked, translation: Unchecked, name: str = "pose") -> Pose:
    """Return the pose (4, 4) of a 3×3 rotation and a translation (m), nested or flat.

    A rotation that is slightly off is replaced by the nearest true one (SVD). name: what errors
    call the pose. Raises ValueError for anything but a rotation."""
    matrix = numbers(rotation, 9, f"rotation of {name}").reshape(3, 3)
    pose = np.eye(4)
    pose[:3, 3] = numbers(translation, 3, f"translation of {name}")
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 2 or np.linalg.det(matrix) <= 0:
        raise ValueError(f"{name} must turn by a rotation, got {matrix.tolist()}")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > MAX_ROTATION_ERROR:
        raise ValueError(
            f"{name} must turn by a rotation, got one that stretches: {matrix.tolist()}"
        )
    u, _, v = np.linalg.svd(matrix)
    pose[:3, :3] = u @ v
    return check_pose(pose, name)


def rigid_matrix(values: Unchecked, name: str = "pose") -> Pose:
    """Return the pose (4, 4) of a 4×4 or 3×4 matrix, row after row, nested or flat.

    A rotation that is slightly off is replaced by the nearest true one. name: what errors call the
    pose. Raises ValueError for anything but a rotation and a translation."""
    value_count = np.asarray(values, dtype=object).size
    matrix = numbers(values, 16 if value_count == 16 else 12, name).reshape(-1, 4)
    pose = rigid(rotation=matrix[:3, :3], translation=matrix[:3, 3], name=name)
    if len(matrix) == 4 and not np.allclose(matrix[3], _LAST_ROW, atol=1e-3):
        raise ValueError(
            f"{name} must end with the row 0 0 0 1, got {matrix[3].tolist()}: give its transpose?"
        )
    return pose
