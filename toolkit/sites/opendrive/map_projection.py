"""Projection of an OpenDRIVE map, and the place of its frame in it."""

import re
import warnings
from xml.etree import ElementTree

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.geometry import invert, pose, transform
from toolkit.sites.georeference import project_to_map
from toolkit.sites.opendrive.cubics import read_number

MAX_OFFSET_TURN_RAD = 2 * np.pi
# regular expression of the texts that may name a map in metres: PROJ, EPSG, AUTHORITY:CODE or WKT
NAMES_PROJECTION = r"\bproj=(?!lat|lon)|EPSG:|^\w+:\w+$|PROJ(CS|CRS|ECTEDCRS)\b"


def move_to_file(
    root: ElementTree.Element, projection_xy: tuple[float, float]
) -> Float64[np.ndarray, "2"]:
    """Convert x, y (m) from the map's projection to the file's coordinates, to 1 cm.

    root: of the file, whose header places its coordinates in the projection."""
    projection_xyz = np.array([[*projection_xy, 0.0]])
    (file_xyz,) = transform(invert(find_placement(root)), projection_xyz)
    return file_xyz[:2].round(2) + 0.0  # + 0.0 makes 0 of -0


def project_degrees(
    root: ElementTree.Element, lon_lat: tuple[float, float]
) -> tuple[float, float] | None:
    """Convert longitude and latitude (degrees) to x, y (m) in a map's projection.

    None if the map has none, the place is not on earth, or PROJ is missing."""
    reference = _read_reference(root)
    longitude, latitude = lon_lat
    if not reference or not (abs(longitude) <= 180 and abs(latitude) <= 90):
        return None
    try:
        x, y = project_to_map(reference, lon_lat)
    except (ImportError, ValueError):
        return None
    return (x, y) if np.isfinite([x, y]).all() else None


def find_placement(root: ElementTree.Element) -> Pose:
    """Pose of the file's frame in its projection: the <offset> of its header (1.8, 8.5).

    A point of the file is turned by `hdg`, then moved by x, y and z. Raises ValueError for a
    damaged number."""
    offset = root.find("header/offset")
    if offset is None:
        return np.eye(4)
    x = read_number(offset, "x", 0.0)
    y = read_number(offset, "y", 0.0)
    z = read_number(offset, "z", 0.0)
    return pose(x, y, z, yaw=read_number(offset, "hdg", 0.0))


def _list_references(root: ElementTree.Element) -> list[str]:
    """Different texts of <geoReference>, in the header or, against the standard, next to it."""
    elements = [*root.findall("header/geoReference"), *root.findall("geoReference")]
    texts = ((element.text or "").strip() for element in elements)
    return list(dict.fromkeys(filter(None, texts)))


def _read_reference(root: ElementTree.Element) -> str:
    """First text of <geoReference>, or ""."""
    return next(iter(_list_references(root)), "")


def find_projection(root: ElementTree.Element, name: str) -> str | None:
    """Find the projection of a map, as a text that PROJ can use.

    None without a geoReference and, with a warning, if it names no projection, or one that PROJ
    cannot use, for example without a grid of shifts that is not installed. The map is in metres all
    the same.

    name: name of the file."""
    reference = _read_reference(root)
    if not reference:
        return None
    # stacklevel 3: the warnings appear at the caller of the import
    count = len(_list_references(root))
    if count > 1:
        warnings.warn(
            f"{name}: it has {count} geoReferences that differ, and the first one counts",
            stacklevel=3,
        )
    fault = _find_fault(reference)
    if fault:
        warnings.warn(
            f"{name}: {fault}, so the site does not say where on earth it is", stacklevel=3
        )
    return None if fault else reference


def describe_turn(root: ElementTree.Element) -> list[str]:
    """Return a note on a header whose offset turns by more than a full turn, as degrees would.

    The list is empty for all other headers."""
    offset = root.find("header/offset")
    turn = 0.0 if offset is None else read_number(offset, "hdg", 0.0)  # rad
    if abs(turn) <= MAX_OFFSET_TURN_RAD:
        return []
    problem = f"its header turns the map by hdg = {turn:g} rad, more than a full turn"
    return [f"{problem}: check that these are no degrees"]


def _find_fault(reference: str) -> str:
    """Reason why PROJ cannot convert a map's coordinates to longitude and latitude.

    Empty if it can, or is not installed. reference: the map's <geoReference>."""
    if not re.search(NAMES_PROJECTION, reference, re.IGNORECASE):
        return f"its geoReference names no projection ({reference[:90]!r})"
    try:
        from pyproj import CRS, Transformer
        from pyproj.exceptions import ProjError
    except ImportError:
        return ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of +init=
            projection = CRS.from_user_input(reference)
        if not projection.is_projected:
            kind = "in degrees" if projection.is_geographic else f"a {projection.type_name}"
            return f"its geoReference is {kind} ({reference[:90]!r}), not a map in metres"
        Transformer.from_crs(projection, "EPSG:4326", always_xy=True)
    except ProjError:
        match = re.search(r"\+nadgrids=(\S+)", reference)
        if match:
            grid = match[1][:60]
            return f"its geoReference needs the grid {grid!r}: install it for PROJ and import again"
        return f"its geoReference is no projection that PROJ knows ({reference[:90]!r})"
    return ""
