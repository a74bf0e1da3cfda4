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
        element.tag = element.tag.rpartition("}")[2]  # {NAMESPACE}TAG
    if root.tag != "OpenDRIVE":
        raise ValueError(f"not an OpenDRIVE map (it begins with <{root.tag}>): give an .xodr file")
    pieces = _list_pieces(root)
    if not len(pieces):
        raise ValueError("the map has no road: export it again")
    if not _reaches(pieces, np.array(centre)):
        raise ValueError(_describe_outside(root, centre, pieces))
    return root


def _list_pieces(root: ElementTree.Element) -> Float64[np.ndarray, "n 4"]:
    """Rows x, y (m), heading (rad), length (m) of the starts of all pieces of roads."""
    pieces = root.findall("road/planView/geometry")
    keys = ("x", "y", "hdg", "length")
    numbers = [read_number(piece, key) for piece in pieces for key in keys]
    return np.array(numbers, np.float64).reshape(-1, 4)


def _reaches(pieces: Float64[np.ndarray, "n 4"], point: Float64[np.ndarray, "2"]) -> bool:
    """True if a place x, y is within the map, or outside by at most its longest piece of road.

    pieces: rows x, y, heading, length of all pieces of roads."""
    starts = pieces[:, :2]
    lengths = pieces[:, 3]
    low = starts.min(axis=0)
    high = starts.max(axis=0)
    max_length = lengths.max()
    return bool(((low - max_length <= point) & (point <= high + max_length)).all())


def _describe_outside(
    root: ElementTree.Element, centre: tuple[float, float], pieces: Float64[np.ndarray, "n 4"]
) -> str:
    """Message for a centre outside the map, with one that is inside it.

    That is the place meant, if `centre` is one in degrees or in coordinates of the projection, and
    else a place on a road near the middle of the map. pieces: rows x, y, heading, length of all
    pieces of roads."""
    starts = pieces[:, :2]
    xmin, ymin = starts.min(axis=0)
    xmax, ymax = starts.max(axis=0)
    x, y = centre
    spans = f"x {xmin:.10g} to {xmax:.10g} and y {ymin:.10g} to {ymax:.10g}"
    problem = f"centre {x:.10g} {y:.10g} lies outside the map, whose roads start at {spans}"
    # places in the map's projection that the centre may mean
    meanings = {"coordinates of its projection": centre, "degrees": project_degrees(root, centre)}
    for kind, metres in meanings.items():
        if metres is None:
            continue
        place = move_to_file(root, metres)
        if _reaches(pieces, place):
            x, y = place
            return f"{problem}: these are {kind}, in the file it is --centre {x:.10g} {y:.10g}"
    x, y = _find_middle_place(pieces)
    return f"{problem}: give --centre X Y inside it, as --centre {x:.10g} {y:.10g}"


def _find_middle_place(pieces: Float64[np.ndarray, "n 4"]) -> Float64[np.ndarray, "2"]:
    """Middle x, y of the piece of road nearest to the middle of the map, to 0.1 m.

    pieces: rows x, y, heading, length of all pieces of roads."""
    starts = pieces[:, :2]
    headings = pieces[:, 2]
    lengths = pieces[:, 3:]  # a column, for each x and y
    directions = np.column_stack([np.cos(headings), np.sin(headings)])
    middles = (starts + lengths / 2 * directions).round(1)
    dx, dy = (middles - np.median(middles, axis=0)).T
    middle: Float64[np.ndarray, "2"] = middles[np.hypot(dx, dy).argmin()]
    return middle


def locate_degrees(
    root: ElementTree.Element, lon_lat: tuple[float, float]
) -> tuple[float, float] | None:
    """Convert longitude and latitude (degrees) to a place x, y (m) in the file's coordinates.

    None if the map has no projection, or they lead nowhere on the map."""
    metres = project_degrees(root, lon_lat)
    if metres is None:
        return None
    x, y = move_to_file(root, metres).tolist()
    return (x, y) if _reaches(_list_pieces(root), np.array([x, y])) else None
