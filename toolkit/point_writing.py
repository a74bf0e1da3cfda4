"""Cloud attributes written as PCD and PLY files that other programs read as they are meant.

- PCD stores positions in float32: `open3d.io.read_point_cloud` (Open3D 0.20.0) reads 8-byte x, y
  and z as zeros without a word. Far from the world's origin, such as in UTM coordinates, whole
  kilometres are taken off first. The header states them in a comment, since the format has no field
  for an origin, and `toolkit.point_files.pcd.read_pcd` adds them again. PLY stores positions of
  float64 as `double`.
- Colours are bytes, `rgb` in PCD and `red`, `green`, `blue` in PLY. Floats are taken as Open3D's,
  from 0 to 1; readers take floating `red` for shares of 255.
- PLY knows no 64-bit integers: they become `int` if all fit, else `double` if that is exact."""

import re
import warnings
from collections.abc import Mapping

import numpy as np

from toolkit.arrays import Float, Float64, Shaped
from toolkit.point_columns import COLOURS, NORMALS, Attributes
from toolkit.point_files.pcd import pcd_bytes
from toolkit.point_files.pcd_header import ORIGIN_COMMENT

NEAR_ORIGIN_M = 4096.0  # farther out, float32 is off by more than a quarter of a millimetre
ORIGIN_GRID_M = 1000.0
EXACT_DOUBLE = 2**53
PCD_NORMALS, PLY_NORMALS = NORMALS
PLY_COLOURS = COLOURS[0]  # red, green, blue
PLY_NAMES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}

Columns = dict[str, np.ndarray]  # each (n,)


def choose_origin(points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    """Return an origin (m) from which float32 holds `points` exactly enough.

    It is zero on each axis, or whole kilometres if they are far away on it.

    >>> choose_origin(np.array([[692012.0, 5336044.0, 520.0]]))
    array([ 692000., 5336000.,       0.])
    """
    finite_points = points[np.isfinite(points).all(axis=1)]
    if not len(finite_points):
        return np.zeros(3)
    middle = np.median(finite_points.astype(np.float64), axis=0)
    is_far = np.abs(finite_points).max(axis=0) > NEAR_ORIGIN_M  # for each axis
    return np.where(is_far, np.round(middle / ORIGIN_GRID_M) * ORIGIN_GRID_M, 0.0)


def format_pcd(attributes: Attributes) -> tuple[bytes, Float64[np.ndarray, "3"]]:
    """Return a cloud's attributes as a binary PCD file, and the origin subtracted from it (m).

    attributes: by name, n rows each, "positions" (n, 3) among them."""
    points = attributes["positions"]
    # float32 keeps enough of large coordinates only near an origin
    origin = choose_origin(points) if points.dtype == np.float64 else np.zeros(3)
    points_from_origin = (points - origin.astype(points.dtype)).astype(np.float32)
    columns = dict(zip("xyz", points_from_origin.T, strict=True))
    if "normals" in attributes:
        columns |= _split(PCD_NORMALS, attributes["normals"].astype(np.float32))
    if "colors" in attributes:
        red, green, blue = _as_bytes(attributes["colors"]).astype(np.uint32).T
        columns["rgb"] = red << 16 | green << 8 | blue  # a byte of each in one number, as PCL does
    columns |= _single_columns(attributes, columns)
    comment = ""
    if origin.any():
        comment = f"{ORIGIN_COMMENT} {' '.join(f'{value:.0f}' for value in origin)}"
    return pcd_bytes(columns, comment), origin


def format_ply(attributes: Attributes) -> bytes:
    """Return a cloud's attributes as a binary little-endian PLY file.

    attributes: by name, n rows each, "positions" (n, 3) among them."""
    columns = dict(zip("xyz", attributes["positions"].T, strict=True))
    if "normals" in attributes:
        columns |= _split(PLY_NORMALS, attributes["normals"])
    if "colors" in attributes:
        columns |= _split(PLY_COLOURS, _as_bytes(attributes["colors"]))
    for name, column in _single_columns(attributes, columns).items():
        # None if PLY cannot hold it
        ply_column = _fit_ply(name, column)
        if ply_column is not None:
            columns[name] = ply_column
    little_endian = [column.astype(column.dtype.newbyteorder("<")) for column in columns.values()]
    table = np.rec.fromarrays(little_endian)
    properties = []
    for name, column in zip(columns, little_endian, strict=True):
        type_code = column.dtype.str[1:]  # such as f4, without the byte order
        properties.append(f"property {PLY_NAMES[type_code]} {name}")
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}", *properties]
    return "\n".join([*lines, "end_header\n"]).encode("ascii") + table.tobytes()


def _single_columns(attributes: Attributes, columns_in_use: Mapping[str, object]) -> Columns:
    """Return attributes of one number a point, by names that a header can hold.

    Positions, normals and colours are not among them. Attributes of several numbers a point, and
    those whose name is in use, are left out with a warning.
    """
    columns: Columns = {}
    for name, values in attributes.items():
        if name in ("positions", "normals", "colors"):
            continue
        header_name = re.sub(r"[^!-~]+", "_", name)  # visible ASCII letters only
        if values[:1].size != 1 or header_name in columns_in_use or header_name in columns:
            reason = "the file holds one number of each name a point, .npz holds all"
            warnings.warn(f"{name} is left out: {reason}", stacklevel=4)
            continue
        column = values.reshape(-1)
        columns[header_name] = column.astype(np.uint8) if column.dtype == np.bool_ else column
    return columns


def _fit_ply(name: str, column: Shaped[np.ndarray, " n"]) -> np.ndarray | None:
    """Return a column in a type that PLY has; None, with a warning, if none holds its numbers."""
    type_code = column.dtype.str[1:]  # such as f4, without the byte order
    if type_code in PLY_NAMES:
        return column
    # 64-bit integers are left
    lowest = int(column.min())
    highest = int(column.max())
    limits = np.iinfo(np.int32)
    if limits.min <= lowest and highest <= limits.max:
        return column.astype(np.int32)
    if max(-lowest, highest) <= EXACT_DOUBLE:
        return column.astype(np.float64)
    warnings.warn(
        f"{name} is left out: PLY has no 64-bit integers, .pcd and .npz have", stacklevel=4
    )
    return None


def _split(names: tuple[str, str, str], rows: Shaped[np.ndarray, "n 3"]) -> Columns:
    """Return the three columns of rows by their names."""
    return dict(zip(names, np.ascontiguousarray(rows.T), strict=True))


def _as_bytes(colours: Shaped[np.ndarray, "n 3"]) -> np.ndarray:
    """Return colours as bytes; floats are shares of full intensity."""
    if colours.dtype.kind != "f":
        return np.clip(colours, 0, 255).astype(np.uint8)
    shares = np.nan_to_num(colours, nan=0.0)
    return np.round(np.clip(shares, 0.0, 1.0) * 255).astype(np.uint8)
