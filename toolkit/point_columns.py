"""Named columns of a point file turned into a cloud's attributes, in metres.

Coordinates are found by name, never by place:

- `x`, `y`, `z` in either case, whatever else is there;
- else one set of three names that differ in nothing but the axis, with a unit or a word for points,
  positions or a frame: `x_m`, `X (mm)`, `pos_x`, `point.x`, `x_coord`, `x_lidar`;
- else the components 0, 1, 2 of a vector of points: `Points_m_XYZ:0`, `Points_1`, as ParaView and
  VeloView name them.

Units of length in a name count. Any other names are refused with the list of columns: angles and
ranges, degrees of longitude, feet, or two sets of coordinates."""

import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Shaped

Attributes = dict[str, np.ndarray]  # each (n, columns)

NORMALS = (("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz"))
COLOURS = (("red", "green", "blue"), ("r", "g", "b"))
UNITS_M = {
    "m": 1.0,
    "meter": 1.0,
    "meters": 1.0,
    "metre": 1.0,
    "metres": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "km": 1000.0,
}
FOREIGN_UNITS = (
    "ft",
    "feet",
    "foot",
    "in",
    "inch",
    "inches",
    "yd",
    "deg",
    "degree",
    "degrees",
    "rad",
    "um",
    "nm",
)
WORDS = (
    "point points pt pts p pos position positions coord coords coordinate coordinates location "
    "loc xyz cartesian vertex vertices center centre world local global sensor lidar laser "
    "velodyne vehicle car ego base map odom utm enu scan cloud"
)
_WORDS = frozenset(WORDS.split())
STATED_OFFSET = re.compile(
    r"\b(?:global[ _]?)?(?:offset|shift|origin|translation)s?\b[^\d+-]{0,20}"
    r"(?:[+-]?\d[\d.eE+-]*[\s,;]+){2}[+-]?\d[\d.eE+-]*",
    re.IGNORECASE,
)
MAX_LISTED = 200  # letters of the list of columns in an error


class CoordinateColumns(NamedTuple):
    """Columns that hold x, y and z.

    Attributes:
        names: their names, in the order x, y, z.
        scales_m: metres that 1 of each is.
    """

    names: tuple[str, str, str]
    scales_m: tuple[float, float, float]


class _Template(NamedTuple):
    """Common parts of the names of three coordinates: words, unit ("" if none), and whether numbers
    name their axes."""

    words: str
    unit: str
    numbered: bool


class _Parsed(NamedTuple):
    """A column's name, its axis (0 to 2), and its template."""

    name: str
    axis: int
    template: _Template


def name_attributes(columns: Mapping[str, Shaped[np.ndarray, "..."]]) -> Attributes:
    """Return a cloud's attributes from named columns: `positions` (n, 3) in metres, float32 or
    float64, `normals` and `colors` where present, every other column of numbers under its name.
    Raises ValueError if `find_axes` does."""
    left = {name: np.asarray(column) for name, column in columns.items()}
    axes = find_axes(list(left))
    if odd := [name for name in axes.names if left[name].dtype.kind not in "fiub"]:
        raise ValueError(
            f"column {odd[0]} must hold real numbers, got {left[odd[0]].dtype}: save it as float64"
        )
    positions = _together(left, *axes.names)
    if positions.dtype not in (np.float32, np.float64):
        positions = positions.astype(np.float64)
    if axes.scales_m != (1.0, 1.0, 1.0):
        positions = positions.astype(np.float64) * axes.scales_m
    attributes: Attributes = {"positions": positions}
    if three := next((names for names in NORMALS if set(names) <= left.keys()), None):
        attributes["normals"] = _together(left, *three).astype(positions.dtype)
    for packed in ("rgb", "rgba"):
        if (
            packed in left
            and left[packed].dtype.itemsize == 4
            and left[packed].shape[1:] in ((), (1,))
        ):
            word = np.ascontiguousarray(left.pop(packed)).reshape(-1).view(np.uint32)
            attributes["colors"] = np.stack([word >> 16, word >> 8, word], axis=1).astype(np.uint8)
    if "colors" not in attributes and (
        three := next((names for names in COLOURS if set(names) <= left.keys()), None)
    ):
        values = _together(left, *three)
        is_byte = values == np.clip(np.trunc(values.astype(np.float64)), 0, 255)
        attributes["colors"] = values.astype(np.uint8 if is_byte.all() else np.float32)
    reserved = {"positions", "normals", "colors"}
    for name, column in left.items():
        if column.dtype.kind in "fiub" and column.ndim <= 2 and name and name not in reserved:
            attributes[name] = column if column.ndim == 2 else column[:, None]
    return attributes


def find_axes(names: Sequence[str]) -> CoordinateColumns:
    """Return which columns are x, y and z. Raises ValueError with the columns if that is not said
    by their names.

    >>> find_axes(["intensity", "x_m", "y_m", "z_m"]).names
    ('x_m', 'y_m', 'z_m')
    >>> find_axes(["X (mm)", "Y (mm)", "Z (mm)"]).scales_m
    (0.001, 0.001, 0.001)
    """
    for spelled in (names, [name.lower() for name in names]):
        if all(spelled.count(axis) == 1 for axis in "xyz"):
            x, y, z = (names[spelled.index(axis)] for axis in "xyz")
            return CoordinateColumns((x, y, z), (1.0, 1.0, 1.0))
    sets = _coordinate_sets(names)
    if len(sets) != 1:
        listed = ", ".join(names)[:MAX_LISTED]
        lower_names = [name.lower() for name in names]
        missing = ", ".join(axis for axis in "xyz" if axis not in lower_names)
        finding = (
            f"{len(sets)} sets of coordinates" if sets or not missing else f"no column {missing}"
        )
        raise ValueError(
            f"it has {finding}, only {listed}: name its coordinates x, y and z, in metres"
        )
    by_axis = sets[0]
    units = [by_axis[axis][1] for axis in range(3)]
    if foreign := next((unit for unit in units if unit in FOREIGN_UNITS), None):
        listed = ", ".join(names)[:MAX_LISTED]
        raise ValueError(
            f"its coordinates are in {foreign}, its columns {listed}: convert them to metres"
        )
    first, second, third = (UNITS_M[unit] if unit else 1.0 for unit in units)
    return CoordinateColumns((by_axis[0][0], by_axis[1][0], by_axis[2][0]), (first, second, third))


def warn_of_offset(comments: Iterable[str]) -> None:
    """Warn of an offset that another program left in a comment: no format gives it a meaning to
    apply."""
    for comment in comments:
        stated = STATED_OFFSET.search(comment)
        if stated is not None:
            message = (
                f"the comment {stated[0]!r} is not applied, the points stay as they are: add it "
                "if it is theirs"
            )
            warnings.warn(message, stacklevel=3)


def _coordinate_sets(names: Iterable[str]) -> list[dict[int, tuple[str, str]]]:
    """Sets of three columns of one template and unit, each as name and unit by axis."""
    templates: dict[_Template, list[_Parsed]] = {}
    for name in names:
        parsed = _parse(name)
        if parsed is not None:
            templates.setdefault(parsed.template, []).append(parsed)
    lettered: list[dict[int, tuple[str, str]]] = []
    numbered: list[dict[int, tuple[str, str]]] = []
    for template, columns in templates.items():
        by_axis = {column.axis: (column.name, template.unit) for column in columns}
        if len(columns) == len(by_axis) == 3:
            (numbered if template.numbered else lettered).append(by_axis)
    return lettered or numbered


def _parse(name: str) -> _Parsed | None:
    """Parts of a column's name; None if it names no coordinate."""
    separated = re.sub(
        r"(?<=[a-z])(?=[XYZ]\b)|(?<=\b[XYZ])(?=[A-Z]?[a-z])|(?<=\b[xyz])(?=[A-Z])", " ", name
    )
    tokens = re.findall(r"[^\W_]+", separated.lower())
    indices = [index for index, token in enumerate(tokens) if token in ("x", "y", "z")]
    numbered = False
    if not indices and len(tokens) > 1 and tokens[-1] in ("0", "1", "2"):
        indices = [len(tokens) - 1]
        numbered = True
    if len(indices) != 1:
        return None
    letter = tokens.pop(indices[0])
    units = [token for token in tokens if token in UNITS_M or token in FOREIGN_UNITS]
    words = [token for token in tokens if token not in units]
    about_points = all(token in _WORDS for token in words)
    if len(units) > 1 or not about_points or (numbered and not words):
        return None
    axis = "012".index(letter) if numbered else "xyz".index(letter)
    unit = units[0] if units else ""
    return _Parsed(name, axis, _Template(" ".join(words), unit, numbered))


def _together(left: dict[str, np.ndarray], *names: str) -> np.ndarray:
    return np.stack([left.pop(name).reshape(-1) for name in names], axis=1)
