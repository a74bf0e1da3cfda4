"""What every layout reads with: entries and numbers of records, rigid motions, damage as one line that names a file.

Numbers may be strings (DAIR-V2X, and YAML's 1e-05), rotations may be a little off; what is worse is a ValueError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.sample import Sample
from toolkit.geometry import check_pose
from toolkit.runtime.files import parse_json

NOT_RIGID = 0.05  # that a rotation may be off, largest entry of R Rᵀ - 1, before it is none
_DAMAGE = (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, ArithmeticError, RecursionError)


@dataclass(frozen=True)
class Listing:
    """Samples by name, each read when it is asked for. No `Sequence`: checkers of types would read one."""

    names: tuple[str, ...]
    load: Callable[[str], Sample]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Sample]:
        return map(self.load, self.names)

    def __getitem__(self, index: int) -> Sample:
        return self.load(self.names[index])


@runtime_checkable
class Samples(Protocol):
    """The samples of a recording, in order: how many there are, and each when its turn comes."""

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Sample]: ...


@contextmanager
def named_damage(path: str | Path, what: str) -> Iterator[None]:
    """Damage met in the block becomes one ValueError, which names the file; numbers that overflow are no warnings."""
    try:
        with np.errstate(all="ignore"):
            yield
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no {what}: byte {error.start} is not UTF-8") from None
    except _DAMAGE as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(f"{path} is no {what} that can be read: {reason}") from None


def text_of(path: str | Path) -> str:
    """The text of a file. Raises OSError, and UnicodeDecodeError where it is none."""
    return Path(path).read_text(encoding="utf-8-sig")


def json_of(path: str | Path) -> Any:
    """The values of a JSON file; to be called in `named_damage`."""
    return parse_json(text_of(path))


def entry(record: Any, *keys: str) -> Any:
    """record[key][key]..., or ValueError that says which is missing.

    >>> entry({"a": {"b": 3}}, "a", "b")
    3
    """
    value = record
    for k, key in enumerate(keys):
        if not isinstance(value, dict) or key not in value:
            raise ValueError(f"it has no entry {'.'.join(keys[: k + 1])}")
        value = value[key]
    return value


def as_number(value: Any, name: str = "entry") -> float:
    """A number, also where it is written as a string.

    >>> as_number("1e-05")
    1e-05
    """
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be a number, got {str(value)[:40]!r}") from None


def numbers(values: Any, count: int, name: str = "entry") -> Float64[np.ndarray, " count"]:
    """So many numbers, nested or flat, also as strings. Raises ValueError for another count."""
    try:
        flat = np.array(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        flat = np.zeros(0)
    if flat.size != count:
        raise ValueError(f"{name} must be {count} numbers, got {str(values)[:60]!r}")
    return flat


def xyz(record: Any, name: str, axes: str = "xyz") -> Float64[np.ndarray, "3"]:
    """The numbers of an entry {x: .., y: .., z: ..}."""
    return np.array([as_number(entry(record, name, axis), f"{name}.{axis}") for axis in axes])


def records(content: Any, name: str = "it") -> list[Any]:
    """A list, or ValueError."""
    if not isinstance(content, list):
        raise ValueError(f"{name} must be a list, got {str(content)[:40]!r}")
    return content


def rigid(rotation: Any, translation: Any, name: str = "pose") -> Float64[np.ndarray, "4 4"]:
    """The pose of a 3×3 rotation and a translation; a rotation that is a little off becomes the nearest one (SVD).

    >>> rigid([[1, 0, 0], [0, 1, 0.001], [0, 0, 1]], [["1"], ["2"], ["3"]]).round(3)[:, 3].tolist()
    [1.0, 2.0, 3.0, 1.0]
    """
    matrix = numbers(rotation, 9, f"rotation of {name}").reshape(3, 3)
    pose = np.eye(4)
    pose[:3, 3] = numbers(translation, 3, f"translation of {name}")
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 2 or np.linalg.det(matrix) <= 0:
        raise ValueError(f"{name} must turn by a rotation, got {matrix.tolist()}")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > NOT_RIGID:
        raise ValueError(f"{name} must turn by a rotation, got one that stretches: {matrix.tolist()}")
    u, _, v = np.linalg.svd(matrix)
    pose[:3, :3] = u @ v
    return check_pose(pose, name)


def rigid_matrix(values: Any, name: str = "pose") -> Float64[np.ndarray, "4 4"]:
    """The pose of 16 or 12 numbers by rows, its rotation made one."""
    flat = np.asarray(values, dtype=object).ravel()
    matrix = numbers(values, 16 if flat.size == 16 else 12, name).reshape(-1, 4)
    return rigid(matrix[:3, :3], matrix[:3, 3], name)


def heading(target_SE3_source: Float64[np.ndarray, "4 4"], yaw: Any) -> Float64[np.ndarray, "*n"]:
    """Yaw (rad) in the target frame of headings in the source frame: of the turned forward direction, seen from above.

    >>> heading(np.eye(4), [0.5])
    array([0.5])
    """
    yaw = np.asarray(yaw, np.float64)
    forward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1) @ target_SE3_source[:3, :3].T
    return np.asarray(np.arctan2(forward[..., 1], forward[..., 0]))
