"""The roads of an OpenDRIVE map about a place, as arrays: their surface by lane, and how steep they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.geometry import LEVEL, Slope
from toolkit.sites.opendrive.reference_line import ReferenceLine, cubics, number, reference_line

FOOTWAY = ("sidewalk", "walking")
UNPAVED = ("none", "border", "curb", "median", "rail", "tram", *FOOTWAY)  # all other types are carriageway
STATIONS_EVERY = 1.0  # m between the corners of a lane
SPREAD = 3.0  # m, deviation of road middles along a direction; where they spread less, it has no slope
THINNEST_LANE = 0.05  # m, of a lane that is kept


@dataclass(frozen=True, eq=False)
class MapRoad:
    """One <road> of the map: its reference line and the element itself."""

    line: ReferenceLine
    element: ElementTree.Element


@dataclass(frozen=True, eq=False)
class MapLane:
    """One lane of one section: type, outline and middle line (map frame, metres), its mean width."""

    kind: str
    outline: shapely.Geometry
    middle: Float64[np.ndarray, "k 2"]
    width: float


def roads_near(path: Path, window: shapely.Geometry, level: float, storey: float) -> list[MapRoad]:
    """The roads that reach into `window` within `storey` m of the height `level`.

    Raises ValueError in one line where a number in the map is none.
    """
    root = ElementTree.parse(path).getroot()
    found = []
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    for element in root.iter("road"):
        try:
            line = reference_line(element)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        s = np.linspace(0.0, line.length, int(line.length / 5.0) + 2)
        near = shapely.intersects_xy(window.buffer(30.0), line.at(s)[:, :2])
        if near.any() and abs(line.elevation.at(s[near]) - level).min() <= storey:
            found.append(MapRoad(line, element))
    return found


def surfaces(path: Path, roads_there: Sequence[MapRoad]) -> list[MapLane]:
    """All lanes of `roads_there`; ValueError that names the file where a number among them is none."""
    try:
        return [lane for road in roads_there for lane in lanes(road)]
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def lanes(road: MapRoad) -> Iterator[MapLane]:
    """All lanes of `road` that are wider than nothing."""
    sections = road.element.findall("lanes/laneSection")
    starts = [number(section, "s") for section in sections]
    offset = cubics(road.element.findall("lanes/laneOffset"))
    for section, start, end in zip(sections, starts, [*starts[1:], road.line.length], strict=True):
        if not 0 <= start < end - 1e-3:
            continue
        s = np.linspace(start, end, int((end - start) / STATIONS_EVERY) + 2)
        for side, sign in (("left", 1.0), ("right", -1.0)):
            inner = offset.at(s)
            for lane in sorted(section.findall(f"{side}/lane"), key=lambda each: abs(number(each, "id"))):
                width = np.clip(cubics(lane.findall("width"), "sOffset").at(s - start), 0.0, 50.0)
                outer = inner + sign * width
                if width.max() > THINNEST_LANE:
                    corners = np.concatenate([road.line.beside(s, inner), road.line.beside(s, outer)[::-1]])
                    outline = shapely.make_valid(shapely.Polygon(corners))
                    middle = road.line.beside(s, (inner + outer) / 2)
                    yield MapLane(lane.get("type", "none"), outline, middle, float(width.mean()))
                inner = outer


def steepest(roads_there: Sequence[MapRoad], window: shapely.Geometry) -> float:
    """The steepest slope (rise over run) of the roads within `window`."""
    slopes = [0.0]
    for road in roads_there:
        s = np.linspace(0.0, road.line.length, int(road.line.length / STATIONS_EVERY) + 2)
        inside = shapely.intersects_xy(window, road.line.at(s)[:, :2])
        slopes += list(abs(road.line.elevation.slope(s[inside])))
    return float(max(slopes))


def plane(
    roads_there: Sequence[MapRoad], window: shapely.Geometry, map_SE3_site: Float[np.ndarray, "4 4"]
) -> tuple[Slope, float]:
    """How the roads within `window` (map frame) rise along x and y of the site, by least squares over their middle
    lines, and how far (m) they leave that plane. Level where they say nothing of one direction."""
    rows = [np.zeros((0, 3))]
    for road in roads_there:
        s = np.linspace(0.0, road.line.length, int(road.line.length / STATIONS_EVERY) + 2)
        xy = road.line.at(s)[:, :2]
        inside = shapely.intersects_xy(window, xy)
        rows.append(np.column_stack([xy, road.line.elevation.at(s)])[inside])
    places = np.concatenate(rows)
    if len(places) < 3:
        return LEVEL, 0.0
    xy = (places[:, :2] - map_SE3_site[:2, 3]) @ map_SE3_site[:2, :2]
    xy, z = xy - xy.mean(axis=0), places[:, 2] - places[:, 2].mean()
    shortest = (SPREAD * np.sqrt(len(xy))) ** 2  # squared, of the sum over stations
    values, axes = np.linalg.eigh(xy.T @ xy)
    known = axes[:, values > shortest]
    along = xy @ known
    slope = known @ np.linalg.lstsq(along, z, rcond=None)[0] if known.size else np.zeros(2)
    return (float(slope[0]), float(slope[1])), float(abs(z - xy @ slope).max())


def in_site(shape: shapely.Geometry, map_SE3_site: Float[np.ndarray, "4 4"]) -> shapely.Geometry:
    """A shape of the map in the site's frame."""
    turn, origin = map_SE3_site[:2, :2], map_SE3_site[:2, 3]
    return shapely.transform(shape, lambda xy: (xy - origin) @ turn)


def in_map(shape: shapely.Geometry, map_SE3_site: Float[np.ndarray, "4 4"]) -> shapely.Geometry:
    """A shape of the site in the map's frame."""
    turn, origin = map_SE3_site[:2, :2], map_SE3_site[:2, 3]
    return shapely.transform(shape, lambda xy: xy @ turn.T + origin)
