"""Header of a PCD file: its fields, its number of points and their storage."""

import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.geometry import MAX_COORDINATE_M
from toolkit.point_columns import find_axes, warn_of_offset
from toolkit.point_files.rows import MAX_FIELDS, whole_numbers

ORIGIN_COMMENT = "# coview origin:"  # in a PCD file, before what to add to x, y and z (m)
PADDING = "_"
_TYPES = {
    (kind, size): f"<{kind.lower()}{size}"
    for kind in "FIU"
    for size in (1, 2, 4, 8)
    if kind != "F" or size > 2
}


class PcdHeader(NamedTuple):
    """Header of a PCD file.

    Attributes:
        names: names of the fields.
        row: type of a point.
        points: number of points.
        data: storage: ascii, binary or binary_compressed.
        origin: what coview took off the positions (m), None if nothing.
    """

    names: tuple[str, ...]
    row: np.dtype
    points: int
    data: str
    origin: np.ndarray | None = None

    def fields(self) -> Iterator[tuple[np.dtype, int]]:
        """Type and number of values of each field."""
        types = [self.row[name] for name in self.row.names or ()]
        return ((kind.base, kind.itemsize // kind.base.itemsize) for kind in types)


class _Field(NamedTuple):
    """Field of a point: its name, its TYPE and SIZE, and its number of values."""

    name: str
    kind: tuple[str, int]
    value_count: int


def parse_pcd_header(content: bytes) -> tuple[PcdHeader, bytes]:
    """Header of a file's content, and the bytes after it. Raises ValueError for a wrong header."""
    data_line = re.search(rb"^DATA[^\n]*\n?", content, re.MULTILINE)
    if data_line is None:
        raise ValueError("its header has no line DATA, is it a PCD file?")
    entries = _split_entries(content[: data_line.end()])
    fields = _read_fields(entries)
    _check_fields(fields)
    points = _count_points(entries)
    if "VIEWPOINT" in entries and not _is_at_origin(entries["VIEWPOINT"]):
        warnings.warn(
            "the VIEWPOINT of a PCD file is not applied, its points stay as they are", stacklevel=2
        )
    data = " ".join(entries["DATA"])
    if data not in ("ascii", "binary", "binary_compressed") or points < 0:
        raise ValueError(
            f"DATA must be ascii, binary or binary_compressed, got {data!r:.40} of {points} points"
        )
    # numbers instead of names, since paddings share one name
    columns = [(f"{k}", _TYPES[field.kind], (field.value_count,)) for k, field in enumerate(fields)]
    before_data = content[: data_line.start()]
    origin = _read_origin(before_data)
    if origin is None:
        lines = before_data.decode("ascii", "replace").splitlines()
        warn_of_offset(line for line in lines if line.startswith("#"))
    header = PcdHeader(
        names=tuple(field.name for field in fields),
        row=np.dtype(columns),
        points=points,
        data=data,
        origin=origin,
    )
    return header, content[data_line.end() :]


def _split_entries(header: bytes) -> dict[str, list[str]]:
    """Words of each line of a PCD header after the first word, by that word, without comments.

    Raises ValueError for two lines with one first word."""
    entries: dict[str, list[str]] = {}
    for line in header.split(b"\n"):
        words = line.split(b"#")[0].decode("ascii", "replace").split()
        if not words:
            continue
        if words[0] in entries:
            raise ValueError(f"its header has two lines {words[0]:.40}")
        entries[words[0]] = words[1:]
    if "FIELDS" in entries and "COLUMNS" in entries:
        raise ValueError("its header has both FIELDS and COLUMNS")
    return entries


def _read_fields(entries: Mapping[str, list[str]]) -> list[_Field]:
    """Fields of a point that have a value, from the entries of a PCD header.

    entries: words of each line after the first word, by that word. Raises ValueError if lines do
    not fit together."""
    name_words = entries.get("FIELDS", entries.get("COLUMNS", []))  # COLUMNS until version 0.5
    names = [name.lower() if len(name) == 1 else name for name in name_words]
    size_words = entries.get("SIZE", [])
    types = entries.get("TYPE", [])
    if entries.get("DATA") == ["ascii"] and "SIZE" not in entries and "TYPE" not in entries:
        size_words = ["4"] * len(names)  # as in version 0.5
        types = ["F"] * len(names)
    sizes = whole_numbers(size_words)
    counts = whole_numbers(entries.get("COUNT", ["1"] * len(names)))
    if not len(names) == len(sizes) == len(counts) == len(types):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT of its header are not of one length")
    fields = [
        _Field(name=name, kind=(type_letter, size), value_count=count)
        for name, type_letter, size, count in zip(names, types, sizes, counts, strict=True)
    ]
    # SUSTechPOINTS writes fields of COUNT 0: nothing
    return [field for field in fields if field.value_count != 0]


def _check_fields(fields: Sequence[_Field]) -> None:
    """Raise ValueError for too many fields, a name twice, unknown types, and no x, y and z."""
    names = [field.name for field in fields]
    if len(names) > MAX_FIELDS:
        raise ValueError(f"its header names {len(names)} fields, more than {MAX_FIELDS}")
    point_names = [name for name in names if name != PADDING]
    if len(set(point_names)) < len(point_names):
        raise ValueError(f"two fields have one name: {', '.join(names)[:200]}")
    # fields that hold x, y and z
    coordinate_names = find_axes(names).names
    kinds = [field.kind for field in fields]  # pairs of TYPE and SIZE
    counts = [field.value_count for field in fields]
    is_known = all(kind in _TYPES for kind in kinds)
    if not is_known or any(not 0 < count < 1 << 20 for count in counts):
        got = f"{kinds} and COUNT {counts}"[:300]
        raise ValueError(f"TYPE and SIZE of a field must be F, I or U and 1, 2, 4 or 8, got {got}")
    if any(field.value_count != 1 for field in fields if field.name in coordinate_names):
        raise ValueError(f"{', '.join(coordinate_names)} must have COUNT 1")


def _count_points(entries: Mapping[str, list[str]]) -> int:
    """Number of points that a PCD header states, as POINTS or WIDTH x HEIGHT or both.

    Raises ValueError if it states none, or two different ones."""
    counts = []
    if "POINTS" in entries:
        counts.append(math.prod(whole_numbers(entries["POINTS"])))
    if "WIDTH" in entries:
        sides = [*entries["WIDTH"], *entries.get("HEIGHT", ["1"])]
        counts.append(math.prod(whole_numbers(sides)))
    if not counts or len(set(counts)) > 1:
        problem = (
            f"POINTS and WIDTH x HEIGHT of its header must say one number of points, got {counts}"
        )
        raise ValueError(problem[:200])
    return counts[0]


def _is_at_origin(viewpoint: Sequence[str]) -> bool:
    """True for the viewpoint 0 0 0 1 0 0 0: its position, then its rotation as a quaternion."""
    return [word.strip("-0.") for word in viewpoint] == ["", "", "", "1", "", "", ""]


def _read_origin(header: bytes) -> np.ndarray | None:
    """Origin (x, y, z; m) of the points that a PCD header written by coview states in a comment.

    None without such a comment; ValueError for a damaged one."""
    line = re.search(rb"^" + ORIGIN_COMMENT.encode() + rb"([^\n]*)$", header, re.MULTILINE)
    if line is None:
        return None
    words = line[1].decode("ascii", "replace").split()
    try:
        origin = np.array([float(word) for word in words])
    except ValueError:
        origin = np.zeros(0)  # refused below
    if origin.shape != (3,) or not (np.abs(origin) <= MAX_COORDINATE_M).all():
        raise ValueError(
            f"its origin must be three numbers of metres, got {' '.join(words)[:60]!r}"
        )
    return origin
