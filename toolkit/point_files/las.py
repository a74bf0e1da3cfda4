"""LAS and LAZ files of surveyors' scans (ASPRS LAS 1.0 to 1.4), by laspy.

- A coordinate is a whole number times the header's scale plus its offset, as float64. Scales
  and offsets that are not finite, and scales that are not positive, are refused.
- Coordinates are metres: a coordinate system in degrees or feet, by its WKT or GeoTIFF keys, is
  refused. Without a coordinate system nothing is known of the unit, and metres are taken.
- Points that are flagged as withheld count as deleted, as the standard says: they are left out with
  a warning.
- Colours of 16 bits, which the standard asks for, become bytes; writers that store bytes are
  believed with a warning. `gps_time` keeps its name, since its zero is of two kinds.
- The header's number of points and bounds must match the points.

https://github.com/ASPRSorg/LAS"""

import re
import warnings
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.point_columns import Attributes, name_attributes
from toolkit.point_files.las_sizes import check_chunks, check_records
from toolkit.runtime.array_files import MAX_CLOUD_BYTES, check_unpacked
from toolkit.runtime.reading import read_plain

_DEGREES_WKT = re.compile(r"\s*(?:GEOGCS|GEOGCRS|GEODCRS|GEOCCS)\b", re.IGNORECASE)
_FEET_WKT = re.compile(r'\b(?:LENGTH)?UNIT\s*\[\s*"[^"]*\b(?:foot|feet|ft)\b', re.IGNORECASE)
_MODEL_KEY = 1024  # GeoTIFF's GTModelTypeGeoKey
_PROJECTED = 1
_UNIT_KEYS = (3076, 4099)  # GeoTIFF's units of x and y, and of z
_METRE = 9001
_COLOURS = ("red", "green", "blue")
_FLAGS = (
    "synthetic",
    "key_point",
    "withheld",
    "overlap",
    "scan_direction_flag",
    "edge_of_flight_line",
)
_MAX_BYTE = 255


def read_las(path: str | Path) -> Attributes:
    """Read the attributes of a LAS or LAZ file's points (`name_attributes`), positions in float64.

    Raises ImportError without laspy, or without lazrs for LAZ; ValueError, in one line, if the file
    is empty, damaged, cut off, not in metres, or contradicts its header."""
    try:
        import laspy
    except ImportError:
        raise ImportError("reading .las needs laspy: pip install coview[scans]") from None
    content = read_plain(path)
    try:
        _check_begin(content)
        check_records(content)
        header = laspy.LasHeader.read_from(BytesIO(content), read_evlrs=True)
        _check_header(header, len(content))
        if header.are_points_compressed:
            if not laspy.LazBackend.Lazrs.is_available():
                raise ImportError("reading .laz needs lazrs: pip install coview[scans]")
            check_chunks(content, header)
        # in one thread: lazrs's threads reserve what the table of chunks says
        points = laspy.read(BytesIO(content), laz_backend=laspy.LazBackend.Lazrs)
        return _attributes(header, points)
    except ImportError:
        raise
    except BaseException as error:
        # laspy raises errors of any kind; a panic of lazrs is no subclass of Exception
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"{path} holds no points that can be read: {reason}") from None


def _check_begin(content: bytes) -> None:
    """Raise ValueError for an empty file, and one of another format."""
    if not content:
        raise ValueError("it is empty")
    if content[:4] != b"LASF":
        raise ValueError("it does not begin with LASF, is it a LAS file?")


def _check_header(header: Any, size: int) -> None:
    """Raise ValueError for a header whose numbers do not fit the file, or that is not in metres.

    header: laspy's header; size: bytes of the file."""
    count = int(header.point_count)
    point_bytes = int(header.point_format.size)
    check_unpacked(count * point_bytes, MAX_CLOUD_BYTES)
    first = int(header.offset_to_point_data)
    if not header.are_points_compressed and first + count * point_bytes > size:
        raise ValueError(
            f"it is cut off: {count} points of {point_bytes} bytes begin at byte {first}, but it "
            f"has {size}"
        )
    for name in ("scales", "offsets"):
        values = np.asarray(getattr(header, name), np.float64)
        if not np.isfinite(values).all() or (name == "scales" and (values <= 0).any()):
            raise ValueError(
                f"its {name} must be finite and scales positive, got {values.tolist()}"
            )
    _check_unit(header)


def _check_unit(header: Any) -> None:
    """Raise ValueError for a coordinate system that is not in metres.

    A record holds it as well-known text, or as pairs of a GeoTIFF key and its value. header: of
    laspy."""
    for record in (*header.vlrs, *(header.evlrs or ())):
        text = getattr(record, "string", "")
        keys = {key.id: key.value_offset for key in getattr(record, "geo_keys", ())}
        if _DEGREES_WKT.match(text) or keys.get(_MODEL_KEY, _PROJECTED) != _PROJECTED:
            raise ValueError(
                "its coordinates are degrees or earth-centred: project them to metres, as with "
                "pdal translate --filters.reprojection"
            )
        units = [keys[key] for key in _UNIT_KEYS if key in keys]
        if _FEET_WKT.search(text) or any(unit != _METRE for unit in units):
            raise ValueError(
                "its coordinate system is not in metres: convert it, as with pdal translate"
            )


def _attributes(header: Any, points: Any) -> Attributes:
    """Return the columns of all points that are not withheld; flags are left out.

    header, points: laspy's. Colours come back as bytes, unless all are 0."""
    positions = np.column_stack([np.asarray(points[axis], np.float64) for axis in "xyz"])
    if len(positions) != header.point_count:
        raise ValueError(
            f"it is cut off: its header states {header.point_count} points, {len(positions)} are "
            "there"
        )
    _check_bounds(header, positions)
    # X, Y and Z are the whole numbers from which x, y and z are computed
    names = [name for name in points.point_format.dimension_names if name not in ("X", "Y", "Z")]
    is_kept = np.ones(len(positions), bool)
    if "withheld" in names:
        is_kept = np.asarray(points["withheld"]) == 0
        if not is_kept.all():
            count = int((~is_kept).sum())
            warnings.warn(f"{count} points are flagged as withheld and left out", stacklevel=4)
    columns = dict(zip("xyz", positions[is_kept].T, strict=True))
    for name in names:
        if name not in _FLAGS and name not in _COLOURS:
            columns[name] = np.asarray(points[name])[is_kept]
    if set(_COLOURS) <= set(names):
        colours = np.column_stack([np.asarray(points[name])[is_kept] for name in _COLOURS])
        # a format with colours is often used without them
        if colours.any():
            columns |= dict(zip(_COLOURS, _as_byte_colours(colours).T, strict=True))
    return name_attributes(columns)


def _as_byte_colours(colours: np.ndarray) -> np.ndarray:
    """Return colours of 16 bits as bytes; bytes stay, with a warning."""
    if colours.max() > _MAX_BYTE:
        return (colours >> 8).astype(np.uint8)
    warnings.warn("colours are taken as bytes, none is above 255", stacklevel=5)
    return colours.astype(np.uint8)


def _check_bounds(header: Any, positions: Float64[np.ndarray, "n 3"]) -> None:
    """Warn if the header's bounds are not the points', as after an edit or a wrong offset."""
    if not len(positions):
        return
    stated = np.array([header.mins, header.maxs], np.float64)
    actual = np.array([positions.min(axis=0), positions.max(axis=0)])
    with np.errstate(invalid="ignore"):
        is_near = np.abs(stated - actual) <= 2 * np.asarray(header.scales, np.float64)
    if not is_near.all():
        warnings.warn(
            f"the bounds in its header are not its points': they are at "
            f"{actual.round(2).tolist()}, not {stated.round(2).tolist()}",
            stacklevel=5,
        )
