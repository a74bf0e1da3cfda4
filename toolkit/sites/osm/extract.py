"""OpenStreetMap extracts: what is in the file, in metres around a centre.

Extracts are untidy: ways refer to nodes that were cut off, relations to members that are missing, values are free text.
What cannot be used is left out; only a file that is no map is refused. https://wiki.openstreetmap.org/wiki/OSM_XML
"""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BufferedIOBase
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites.georeference import inverse_project, project
from toolkit.sites.network import polygons_in

Tags = Mapping[str, str]

AT_THE_EDGE = 5e-4  # degrees beyond the map's bounds where a centre still is in it


@dataclass(frozen=True)
class Way:
    """A line or outline. line: (k, 2) metres; nodes: the k ids of its corners."""

    line: Float64[np.ndarray, "k 2"] = field(repr=False)
    nodes: tuple[str, ...]
    tags: Tags

    @property
    def closed(self) -> bool:
        """Whether it ends where it begins."""
        return len(self.nodes) > 3 and self.nodes[0] == self.nodes[-1]


@dataclass(frozen=True)
class Extract:
    """A map in metres around its `centre` (longitude, latitude), x along `heading` (rad counter-clockwise from east).

    areas: polygons, holes and all, with their tags; places: tagged single points and their (2,) positions.
    """

    centre: tuple[float, float]
    heading: float
    ways: tuple[Way, ...]
    areas: tuple[tuple[shapely.Polygon, Tags], ...]
    places: tuple[tuple[Float64[np.ndarray, "2"], Tags], ...]


def read_map(path: Path, centre: tuple[float, float], heading: float = 0.0) -> Extract:
    """The map in `path` (.osm, .osm.xml or either with .gz), in metres around `centre` (longitude, latitude), x along
    `heading` (rad counter-clockwise from east).

    Raises ValueError where the file is no OSM XML, is damaged or empty, or `centre` lies outside it.
    """
    points: dict[str, list[float]] = {}
    place_tags: dict[str, Tags] = {}
    bounds: list[list[float]] = []
    raw_ways: dict[str, tuple[list[str], Tags]] = {}
    relations: list[tuple[list[tuple[str, str]], Tags]] = []
    for element in _elements(path):
        tags = {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}
        name = element.get("id", "")
        if element.tag == "bounds":
            bounds.append([_degrees(element, key) for key in ("minlon", "minlat", "maxlon", "maxlat")])
        elif element.tag == "node":
            lon_lat = [_degrees(element, "lon"), _degrees(element, "lat")]
            if np.isfinite(lon_lat).all():
                points[name] = lon_lat
                place_tags |= {name: tags} if tags else {}
        elif element.tag == "way":
            raw_ways[name] = ([nd.get("ref", "") for nd in element.iter("nd")], tags)
        elif element.tag == "relation" and tags.get("type") == "multipolygon":
            members = [m for m in element.iter("member") if m.get("type") == "way"]
            relations.append(([(m.get("ref", ""), m.get("role", "")) for m in members], tags))
    if not points:
        raise ValueError(f"{path}: the map is empty: it has no node with a latitude and longitude")
    degrees = np.array(list(points.values()))
    _check_centre(path, centre, degrees, np.array(bounds))
    position = dict(zip(points, project(degrees, centre) @ _turn(-heading).T, strict=True))
    ways = {name: way for name, raw in raw_ways.items() if (way := _way(*raw, position)) is not None}
    places = tuple((position[name], tags) for name, tags in place_tags.items())
    return Extract(centre, heading, tuple(ways.values()), tuple(_areas(ways, relations)), places)


def degrees_of(extract: Extract, points: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Longitude and latitude of points of the extract."""
    return inverse_project(points @ _turn(extract.heading).T, extract.centre)


def metres(text: str) -> float | None:
    """A length as mappers write it, None where it is none or not positive; of several the greatest.

    >>> [metres(text) for text in ("12", "12 m", "3;4", "40'", "7,5", "tall", "-2")]
    [12.0, 12.0, 4.0, 12.192, 7.5, None, None]
    """
    found = [_metres(part.strip().lower().replace(",", ".")) for part in text.split(";")]
    lengths = [length for length in found if length is not None and 0 < length < 1000]
    return max(lengths, default=None)


def _metres(text: str) -> float | None:
    feet = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(?:'|ft|feet)\s*(?:(\d+(?:\.\d+)?)\s*(?:\"|''|in)?)?", text)
    if feet:
        return round(0.3048 * (float(feet[1]) + float(feet[2] or 0) / 12), 4)
    plain = re.fullmatch(r"~?\s*(\d+(?:\.\d+)?)\s*(?:m|metres?|meters?)?", text)
    return float(plain[1]) if plain else None


def _elements(path: Path) -> Iterator[ElementTree.Element]:
    """The file's elements one by one, each let go before the next; ValueError in one line where it is no OSM XML."""
    if path.name.lower().endswith((".pbf", ".o5m", ".bz2", ".zip")):
        raise ValueError(f"{path}: only .osm, .osm.xml and .osm.gz are read: convert it first (osmium cat -o map.osm)")
    try:
        with _opened(path) as stream:
            head = stream.read(65536)
        start = re.search(rb"<(?!\?|!)", head)
        if start is None or not head[start.start() :].startswith(b"<osm") or b"<!DOCTYPE" in head[: start.start()]:
            raise ValueError(f"{path}: not OpenStreetMap XML (it does not begin with <osm>): export the map as .osm")
        with _opened(path) as stream:
            parser = ElementTree.iterparse(stream, events=("start", "end"))
            _, root = next(parser)
            for event, element in parser:
                if event == "end" and element.tag in ("node", "way", "relation", "bounds"):
                    if element.get("action") != "delete" and element.get("visible") != "false":
                        yield element
                    root.clear()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: damaged XML ({error}): download the map again") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: damaged gzip file ({error}): download the map again") from None


def _opened(path: Path) -> BufferedIOBase:
    with path.open("rb") as stream:
        compressed = stream.read(2) == b"\x1f\x8b"
    return gzip.open(path) if compressed else path.open("rb")


def _turn(angle: float) -> Float64[np.ndarray, "2 2"]:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _degrees(element: ElementTree.Element, key: str) -> float:
    try:
        return float(element.get(key, "nan"))
    except ValueError:
        return float("nan")


def _check_centre(path: Path, centre: tuple[float, float], degrees: np.ndarray, bounds: np.ndarray) -> None:
    usable = len(bounds) > 0 and np.isfinite(bounds).all()
    low = bounds[:, :2].min(axis=0) if usable else degrees.min(axis=0)
    high = bounds[:, 2:].max(axis=0) if usable else degrees.max(axis=0)
    if not ((low - AT_THE_EDGE <= centre) & (centre <= high + AT_THE_EDGE)).all():
        raise ValueError(
            f"{path}: centre {centre[0]:g} {centre[1]:g} lies outside the map, which spans longitude {low[0]:.6g} to "
            f"{high[0]:.6g} and latitude {low[1]:.6g} to {high[1]:.6g}: give --centre LONGITUDE LATITUDE inside it"
        )


def _way(references: list[str], tags: Tags, position: Mapping[str, np.ndarray]) -> Way | None:
    """The way through the nodes that the extract holds, repeated ones once; None where fewer than two are left."""
    known = [node for node in references if node in position]
    nodes = [node for i, node in enumerate(known) if i == 0 or node != known[i - 1]]
    return Way(np.array([position[node] for node in nodes]), tuple(nodes), tags) if len(nodes) > 1 else None


def _areas(
    ways: Mapping[str, Way], relations: list[tuple[list[tuple[str, str]], Tags]]
) -> Iterator[tuple[shapely.Polygon, Tags]]:
    for way in ways.values():
        if way.closed and (way.tags.get("highway") is None or way.tags.get("area") == "yes"):
            yield from ((polygon, way.tags) for polygon in _valid(shapely.Polygon(way.line)))
    for members, tags in relations:
        parts = [(ways[name], role) for name, role in members if name in ways]
        outer = _rings(way for way, role in parts if role != "inner")
        inner = _rings(way for way, role in parts if role == "inner")
        shared = {} if "building" in tags or "building:part" in tags else dict(parts[0][0].tags) if parts else {}
        yield from ((polygon, {**shared, **tags}) for polygon in _valid(outer.difference(inner)))


def _rings(ways: Iterable[Way]) -> shapely.Geometry:
    """The ground enclosed by rings that may be made of several ways each."""
    lines = [shapely.LineString(way.line) for way in ways]
    return shapely.union_all([shapely.Polygon(ring.exterior) for ring in shapely.get_parts(shapely.polygonize(lines))])


def _valid(shape: shapely.Geometry) -> list[shapely.Polygon]:
    return [piece for piece in polygons_in(shapely.make_valid(shape)) if piece.area > 0.1]
