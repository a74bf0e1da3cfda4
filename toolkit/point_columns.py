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
    """Return a cloud's attributes from named columns of n rows.

    These are `positions` (n, 3) in metres, float32 or float64; `normals` (n, 3) and `colors` (n, 3)
    if there are any; and every other column of numbers, (n, columns), under its name.

    Raises:
        ValueError: The coordinates are not real numbers, or `find_axes` does not find them.
    """
    unread = {name: np.asarray(column) for name, column in columns.items()}
    positions = _pop_positions(unread)
    attributes: Attributes = {"positions": positions}
    normal_names = _first_present(NORMALS, unread)
    if normal_names:
        attributes["normals"] = _pop_together(unread, normal_names).astype(positions.dtype)
    colours = _pop_colours(unread)
    if colours is not None:
        attributes["colors"] = colours
    reserved = {"positions", "normals", "colors"}
    for name, column in unread.items():
        if column.dtype.kind in "fiub" and column.ndim <= 2 and name and name not in reserved:
            attributes[name] = column if column.ndim == 2 else column[:, None]
    return attributes


def _pop_positions(unread: dict[str, np.ndarray]) -> np.ndarray:
    """Take x, y and z out of `unread`; return them (n, 3) in metres, float32 or float64.

    unread: columns that are not attributes yet, by name; changed in place."""
    axes = find_axes(list(unread))
    for name in axes.names:
        dtype = unread[name].dtype
        if dtype.kind not in "fiub":
            raise ValueError(
                f"column {name} must hold real numbers, got {dtype}: save it as float64"
            )
    positions = _pop_together(unread, axes.names)
    if positions.dtype not in (np.float32, np.float64):
        positions = positions.astype(np.float64)
    if axes.scales_m != (1.0, 1.0, 1.0):
        positions = positions.astype(np.float64) * axes.scales_m
    return positions


def _pop_colours(unread: dict[str, np.ndarray]) -> np.ndarray | None:
    """Take colours out of `unread`; return red, green and blue (n, 3), None if there are none.

    They are bytes, or float32 if the columns hold anything but whole numbers from 0 to 255. unread:
    columns that are not attributes yet, by name; changed in place.
    """
    colours = None
    for name in ("rgb", "rgba"):  # packed into the four bytes of one number
        column = unread.get(name)
        if column is not None and column.dtype.itemsize == 4 and column.shape[1:] in ((), (1,)):
            word = np.ascontiguousarray(unread.pop(name)).reshape(-1).view(np.uint32)
            # blue is the lowest byte; uint8 drops the bytes above
            colours = np.stack([word >> 16, word >> 8, word], axis=1).astype(np.uint8)
    # separate columns are left as they are if there are packed colours
    channel_names = _first_present(COLOURS, unread)
    if colours is not None or channel_names is None:
        return colours
    channels = _pop_together(unread, channel_names)
    is_byte = channels == np.clip(np.trunc(channels.astype(np.float64)), 0, 255)
    return channels.astype(np.uint8 if is_byte.all() else np.float32)


def _first_present(
    name_sets: Iterable[tuple[str, str, str]], columns: Mapping[str, object]
) -> tuple[str, str, str] | None:
    """Return the first set of names that the columns have all of, or None."""
    return next((names for names in name_sets if set(names) <= columns.keys()), None)


def find_axes(names: Sequence[str]) -> CoordinateColumns:
    """Return which columns are x, y and z, and their units.

    Raises ValueError with the list of columns if their names do not state it.

    >>> find_axes(["intensity", "x_m", "y_m", "z_m"]).names
    ('x_m', 'y_m', 'z_m')
    >>> find_axes(["X (mm)", "Y (mm)", "Z (mm)"]).scales_m
    (0.001, 0.001, 0.001)
    """
    lower_names = [name.lower() for name in names]
    for spellings in (names, lower_names):
        if all(spellings.count(axis) == 1 for axis in "xyz"):
            x, y, z = (names[spellings.index(axis)] for axis in "xyz")
            return CoordinateColumns(names=(x, y, z), scales_m=(1.0, 1.0, 1.0))
    sets = _coordinate_sets(names)
    listed = ", ".join(names)[:MAX_LISTED]
    if len(sets) != 1:
        missing = ", ".join(axis for axis in "xyz" if axis not in lower_names)
        finding = (
            f"{len(sets)} sets of coordinates" if sets or not missing else f"no column {missing}"
        )
        raise ValueError(
            f"it has {finding}, only {listed}: name its coordinates x, y and z, in metres"
        )
    x_column, y_column, z_column = sets[0]
    unit = x_column.template.unit  # the same for all three
    if unit in FOREIGN_UNITS:
        raise ValueError(
            f"its coordinates are in {unit}, its columns {listed}: convert them to metres"
        )
    scale_m = UNITS_M[unit] if unit else 1.0
    return CoordinateColumns(
        names=(x_column.name, y_column.name, z_column.name), scales_m=(scale_m, scale_m, scale_m)
    )


def warn_of_offset(comments: Iterable[str]) -> None:
    """Warn of an offset of coordinates that another program left in a file's comment.

    It is not applied, because no format defines it.
    """
    for comment in comments:
        offset = STATED_OFFSET.search(comment)
        if offset is not None:
            message = (
                f"the comment {offset[0]!r} is not applied, the points stay as they are: add it "
                "if it is theirs"
            )
            warnings.warn(message, stacklevel=3)


def _coordinate_sets(names: Iterable[str]) -> list[list[_Parsed]]:
    """Return every x, y and z column, in this order, whose names differ in nothing but the axis.

    Names with axes by number, such as Points_0, count only if none has letters.
    """
    columns_by_template: dict[_Template, list[_Parsed]] = {}
    for name in names:
        column = _parse(name)
        if column is not None:
            columns_by_template.setdefault(column.template, []).append(column)
    lettered_sets: list[list[_Parsed]] = []
    numbered_sets: list[list[_Parsed]] = []
    for template, columns in columns_by_template.items():
        columns.sort(key=lambda column: column.axis)
        if [column.axis for column in columns] != [0, 1, 2]:
            continue
        if template.numbered:
            numbered_sets.append(columns)
        else:
            lettered_sets.append(columns)
    return lettered_sets or numbered_sets


def _parse(name: str) -> _Parsed | None:
    """Return the parts of a column's name: axis (0 to 2), unit and other words.

    None if it names no coordinate of points: no axis or two, two units, or an unknown word."""
    # "posX" -> "pos X", "Xcoord" -> "X coord", "xPos" -> "x Pos"
    separated = re.sub(
        r"(?<=[a-z])(?=[XYZ]\b)|(?<=\b[XYZ])(?=[A-Z]?[a-z])|(?<=\b[xyz])(?=[A-Z])", " ", name
    )
    tokens = re.findall(r"[^\W_]+", separated.lower())
    axis_indices = [index for index, token in enumerate(tokens) if token in ("x", "y", "z")]
    is_numbered = False
    if not axis_indices and len(tokens) > 1 and tokens[-1] in ("0", "1", "2"):
        axis_indices = [len(tokens) - 1]
        is_numbered = True
    if len(axis_indices) != 1:
        return None
    # a number counts as an axis only behind other words, as in "points 0"
    axis_token = tokens.pop(axis_indices[0])
    units = [token for token in tokens if token in UNITS_M or token in FOREIGN_UNITS]
    words = [token for token in tokens if token not in units]
    is_about_points = all(token in _WORDS for token in words)
    if len(units) > 1 or not is_about_points or (is_numbered and not words):
        return None
    axis = "012".index(axis_token) if is_numbered else "xyz".index(axis_token)
    unit = units[0] if units else ""
    template = _Template(words=" ".join(words), unit=unit, numbered=is_numbered)
    return _Parsed(name, axis=axis, template=template)


def _pop_together(unread: dict[str, np.ndarray], names: Iterable[str]) -> np.ndarray:
    """Take named columns out of `unread`; return them side by side, (n, columns)."""
    return np.stack([unread.pop(name).reshape(-1) for name in names], axis=1)
