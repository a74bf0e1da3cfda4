"""OpenDRIVE files: their elements, and the ground that their roads cover."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from toolkit.arrays import Float64
from toolkit.sites.opendrive.cubics import read_number
from toolkit.sites.opendrive.map_projection import move_to_file, project_degrees


def read_opendrive(path: Path, centre: tuple[float, float]) -> ElementTree.Element:
    """Read an OpenDRIVE file; return its root element, all tags without their namespace.

    centre: x, y (m) in the file's coordinates. Raises ValueError, which does not name the file, for
    damage, no map, and a centre outside it."""
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(
            f"not an OpenDRIVE map or a damaged one ({error}): give an .xodr file"
        ) from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    if root.tag != "OpenDRIVE":
        raise ValueError(f"not an OpenDRIVE map (it begins with <{root.tag}>): give an .xodr file")
    rows = _list_pieces(root)
    if not len(rows):
        raise ValueError("the map has no road: export it again")
    if not _reaches(rows, np.array(centre)):
        raise ValueError(_describe_outside(root, centre, rows))
    return root


def _list_pieces(root: ElementTree.Element) -> Float64[np.ndarray, "n 4"]:
    """Rows x, y (m), heading (rad), length (m) of the starts of all pieces of roads."""
    pieces = root.findall("road/planView/geometry")
    keys = ("x", "y", "hdg", "length")
    numbers = [read_number(piece, key) for piece in pieces for key in keys]
    return np.array(numbers, np.float64).reshape(-1, 4)


def _reaches(rows: Float64[np.ndarray, "n 4"], point: Float64[np.ndarray, "2"]) -> bool:
    """True if a place x, y is within the map, or outside by at most its longest piece of road.

    rows: x, y, heading and length of all pieces of roads."""
    low = rows[:, :2].min(axis=0)
    high = rows[:, :2].max(axis=0)
    longest = rows[:, 3].max()
    return bool(((low - longest <= point) & (point <= high + longest)).all())


def _describe_outside(
    root: ElementTree.Element, centre: tuple[float, float], rows: Float64[np.ndarray, "n 4"]
) -> str:
    """Message for a centre outside the map, with one that is inside it.

    That is the place meant, if `centre` is one in degrees or in coordinates of the projection, and
    else a place on a road near the middle of the map. rows: as for `_reaches`."""
    low = rows[:, :2].min(axis=0)
    high = rows[:, :2].max(axis=0)
    spans = f"x {low[0]:.10g} to {high[0]:.10g} and y {low[1]:.10g} to {high[1]:.10g}"
    outside = (
        f"centre {centre[0]:.10g} {centre[1]:.10g} lies outside the map, whose roads start at "
        f"{spans}"
    )
    for kind, metres in (
        ("coordinates of its projection", centre),
        ("degrees", project_degrees(root, centre)),
    ):
        if metres is not None:
            inside = move_to_file(root, metres)
            if _reaches(rows, inside):
                return (
                    f"{outside}: these are {kind}, in the file it is --centre {inside[0]:.10g} "
                    f"{inside[1]:.10g}"
                )
    along = np.column_stack([np.cos(rows[:, 2]), np.sin(rows[:, 2])])
    middles = (rows[:, :2] + rows[:, 3:] / 2 * along).round(1)
    inside = middles[np.hypot(*(middles - np.median(middles, axis=0)).T).argmin()]
    return f"{outside}: give --centre X Y inside it, as --centre {inside[0]:.10g} {inside[1]:.10g}"


def locate_degrees(
    root: ElementTree.Element, lon_lat: tuple[float, float]
) -> tuple[float, float] | None:
    """Place x, y (m) in the file of longitude and latitude (degrees).

    None if the map has no projection, or they lead nowhere on the map."""
    metres = project_degrees(root, lon_lat)
    if metres is None:
        return None
    x, y = move_to_file(root, metres).tolist()
    return (x, y) if _reaches(_list_pieces(root), np.array([x, y])) else None
