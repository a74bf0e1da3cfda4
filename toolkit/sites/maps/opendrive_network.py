"""SUMO network of an OpenDRIVE map: all roads, then the roads near a site."""

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.runtime.reading import name_errors
from toolkit.sites import network as nets
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.netconvert_warnings import describe_warnings
from toolkit.sites.opendrive.map_roads import is_on_level
from toolkit.sites.opendrive.plain_map import PlainMap

STOREY_GAP_M = 3.5  # a road higher or lower by more is on another storey, and left out
_OPENDRIVE_OPTIONS = (
    "--opendrive.import-all-lanes",
    "--opendrive.curve-resolution=1",
    "--junctions.endpoint-shape",
)
_CROSSINGS = ("--crossings.guess", "--crossings.guess.speed-threshold=100")  # whatever the limit is


def _run_netconvert(options: Sequence[str], piece: MapPiece) -> tuple[str, list[str]]:
    """Run netconvert; return a net.xml text with a road in it, and netconvert's warnings.

    options: netconvert's; piece: names the map file in the ValueError if it fails or makes no
    road."""
    with name_errors(piece.path):  # errors begin with the path
        network, warning_lines = nets.run_netconvert_with_warnings(options)
    if "<edge " not in network:
        raise piece.no_road()
    return network, warning_lines


def describe_near_warnings(warning_lines: Sequence[str], network: str) -> list[str]:
    """Return notes of the warnings of netconvert that concern a network's roads and junctions.

    warning_lines: warnings about the whole map; network: net.xml text of a part of the map."""
    if not warning_lines:
        return []
    root = ElementTree.fromstring(network)
    names = {element.get("id", "") for element in root.iter("edge")}
    names |= {element.get("id", "") for element in root.iter("junction")}
    # roads of the map by the names of their edges, which are ROAD#PIECE, with - for one direction
    names |= {name.strip("-").partition("#")[0] for name in names}
    near_warnings = []
    for warning in warning_lines:
        quoted_names = re.findall(r"'([^']*)'", warning)
        if not names.isdisjoint(quoted_names):
            near_warnings.append(warning)
    return describe_warnings(near_warnings)


def make_whole_network(plain: PlainMap, piece: MapPiece) -> tuple[str, list[str]]:
    """Make the net.xml text of a whole map, in its coordinates, and netconvert's warnings.

    plain: roads of the map as netconvert reads them, and their types of lanes; piece: names the map
    file in errors."""
    with tempfile.TemporaryDirectory() as folder:
        type_file = Path(folder, "types.xml")
        road_file = Path(folder, "plain.xodr")
        type_elements = [nets.format_element("type", row) for row in plain.types]
        type_file.write_text(nets.format_xml("types", type_elements), "utf-8")
        road_file.write_text(plain.text, "utf-8")
        options = [f"--opendrive-files={road_file}", f"--type-files={type_file}"]
        options += _OPENDRIVE_OPTIONS
        if plain.lefthand:
            options.append("--lefthand")
        return _run_netconvert(options, piece)


def cut_network(network: str, edges: Sequence[str], piece: MapPiece, *, lefthand: bool) -> str:
    """Return a net.xml text without some edges, and with crossings for pedestrians.

    netconvert cuts networks, but not OpenDRIVE maps. edges: ids of the edges to remove; piece:
    names the map file in errors; lefthand: traffic keeps left."""
    with tempfile.TemporaryDirectory() as folder:
        network_file = Path(folder, "net.xml")
        edges_file = Path(folder, "edges.txt")
        network_file.write_text(network, "utf-8")
        edges_file.write_text("".join(f"edge:{edge}\n" for edge in edges), "utf-8")
        options = [
            f"--sumo-net-file={network_file}",
            f"--remove-edges.input-file={edges_file}",
            *_CROSSINGS,
            "--no-warnings",
            "--junctions.endpoint-shape",
        ]
        if lefthand:
            options.append("--lefthand")
        network_without_edges, _ = _run_netconvert(options, piece)
        return network_without_edges


def find_nearest_road(network: str, point: shapely.Point) -> tuple[float, float] | None:
    """Place x, y on the lane of a network, open to cars, that is nearest to a point, to 0.1 m.

    None without such a lane. network: net.xml text; point: in its coordinates."""
    lines = [
        shapely.LineString(nets.parse_shape(lane))
        for _, lane in nets.list_lanes(network)
        if "passenger" in nets.list_users(lane)
    ]
    if not lines:
        return None
    link = shapely.shortest_line(shapely.MultiLineString(lines), point)
    lane_end, _ = shapely.get_coordinates(link)
    x, y = lane_end.round(1).tolist()
    return x, y


class NearEdges(NamedTuple):
    """Edges of a network near a site.

    Attributes:
        level: height of the nearest road (m).
        other_edges: ids of edges elsewhere, or on another storey than this road.
        has_edges: True if any edge is near."""

    level: float
    other_edges: list[str]
    has_edges: bool


def find_near_edges(network: str, window: shapely.Polygon) -> NearEdges:
    """Find the edges in `window` that are on the storey of the road nearest to its middle.

    network: net.xml text; window: in its coordinates."""
    lines_by_edge: dict[str, list[shapely.LineString]] = {}  # lines of its lanes
    middle = window.centroid
    min_distance = np.inf
    level = 0.0  # height (m) of the nearest lane so far
    for edge, lane in nets.list_lanes(network):
        line = shapely.LineString(_parse_points(lane))
        lines_by_edge.setdefault(edge.get("id", ""), []).append(line)
        distance = line.distance(middle)
        if distance < min_distance:
            min_distance = distance
            level = line.interpolate(line.project(middle)).z
    other_edges = [
        name
        for name, lines in lines_by_edge.items()
        if not is_on_level(lines, window, level, STOREY_GAP_M)
    ]
    has_edges = len(other_edges) < len(lines_by_edge)
    return NearEdges(level=round(level, 3), other_edges=other_edges, has_edges=has_edges)


def _parse_points(lane: ElementTree.Element) -> list[list[float]]:
    """Points x, y, z (m) of a lane's shape; z is 0 if the network has no heights."""
    points = [list(map(float, point.split(","))) for point in lane.get("shape", "").split()]
    return [[*point, 0.0][:3] for point in points]
