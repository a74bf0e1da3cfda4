"""Approaches: the lanes that lead motor vehicles to a junction.

A junction is a node with roads to three neighbours or more; the nodes of a roundabout count as one.
An approach is an edge that ends in a junction, with the edges before it back to the previous
junction; an edge that leaves a junction without reaching another is an exit. Edges within a
roundabout or a node belong to the junction. Streets have the names of the network.
"""

from collections import defaultdict
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64, Int64
from toolkit.sites.network import list_users, parse_shape
from toolkit.sites.site import Site

MAX_BAY_DISTANCE_M = 1.5  # from a parked vehicle to the middle of its bay
COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
EXIT = "leaving the junction"
JUNCTION = "inside the junction"
PARKED = "parked"
MAX_MIDDLE_DISTANCE_M = 5.0  # from the middle junction to the middle of the area


@dataclass(frozen=True, eq=False)
class Approaches:
    """Possible places of a vehicle in a road network.

    Attributes:
        names: Names of the places; the last is `PARKED`, so there is one more than `lanes`.
        lanes: Centre lines of each place except the last.
        bays: Parking bays: x and y of the middle (m), yaw (rad); frame of the site.
    """

    names: tuple[str, ...]
    lanes: tuple[shapely.Geometry, ...]
    bays: Float64[np.ndarray, "n 3"]

    def locate(self, boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        """Index into `names` for each box: parked close to a bay's middle, else the nearest lane's.

        boxes: x, y, z, length, width, height (m), yaw (rad); frame of the site."""
        centres = boxes[:, :2]
        # `lanes` has a line for each of `names` except the last, which is for parked vehicles
        nearest = np.zeros(len(boxes), np.int64)
        if len(self.lanes):
            centre_points = shapely.points(centres)
            distances = [shapely.distance(line, centre_points) for line in self.lanes]
            nearest = np.array(distances).argmin(axis=0)
        # axes: box, bay; bays are x, y, yaw
        bay_distances = np.linalg.norm(centres[:, None] - self.bays[:, :2], axis=2)
        is_parked = bay_distances.min(axis=1, initial=np.inf) <= MAX_BAY_DISTANCE_M
        return np.where(is_parked, len(self.names) - 1, nearest).astype(np.int64)


def find_approaches(site: Site) -> Approaches:
    """Approaches of a site's network, then its other lanes: places of a vehicle.

    The last place is parked in a bay of the site. Without any lane the whole area is a place."""
    root = ElementTree.fromstring(site.network or "<net/>")
    edges = {edge.get("id", ""): edge for edge in root.findall("edge") if _list_centre_lines(edge)}
    ring_edges: set[str] = set()
    # name of the roundabout of each node that belongs to one
    roundabout_names: dict[str, str] = {}
    for number, roundabout in enumerate(root.findall("roundabout")):
        ring_edges |= set(roundabout.get("edges", "").split())
        nodes = roundabout.get("nodes", "").split()
        roundabout_names |= dict.fromkeys(nodes, f"roundabout {number}")
    roads = {
        name: edge
        for name, edge in edges.items()
        if not edge.get("function") and name not in ring_edges
    }
    edge_ends: dict[str, tuple[str, str]] = {}  # nodes at which each road begins and ends
    neighbours: dict[str, set[str]] = defaultdict(set)
    for name, edge in roads.items():
        first_node = edge.get("from", "")
        last_node = edge.get("to", "")
        begin = roundabout_names.get(first_node, first_node)
        end = roundabout_names.get(last_node, last_node)
        edge_ends[name] = (begin, end)
        neighbours[begin].add(end)
        neighbours[end].add(begin)
    junctions = {
        node
        for node, adjacent in neighbours.items()
        if len(adjacent) >= 3 or node.startswith("roundabout ")
    }
    junction_names = _name_junctions(site, root, roundabout_names, junctions)
    approaches = _group_lanes(site, roads, edge_ends, junctions, junction_names)
    approach_lines = {line.wkb for lines in approaches.values() for line in lines}
    exit_lines = []
    junction_lines = []
    for name, edge in edges.items():
        lines = _list_centre_lines(edge)
        if name in roads:
            exit_lines += [line for line in lines if line.wkb not in approach_lines]
        else:
            junction_lines += lines
    by_name = {**dict(sorted(approaches.items())), EXIT: exit_lines, JUNCTION: junction_lines}
    lanes = {name: shapely.union_all(lines) for name, lines in by_name.items() if lines}
    if not lanes:
        lanes = {JUNCTION: shapely.box(*site.area)}
    # `PARKED` has no lanes: its places are the bays
    return Approaches(names=(*lanes, PARKED), lanes=tuple(lanes.values()), bays=site.parking)


def _group_lanes(
    site: Site,
    roads: dict[str, ElementTree.Element],
    edge_ends: dict[str, tuple[str, str]],
    junctions: set[str],
    junction_names: dict[str, str],
) -> dict[str, list[shapely.Geometry]]:
    """Centre lines of the approaches (roads to a junction) by street, direction and junction.

    Args:
        site: Site with the map's direction of north.
        roads: Elements of edges outside junctions, by name of the edge.
        edge_ends: Nodes at which each road begins and ends.
        junctions: Nodes that are junctions.
        junction_names: Names of the junctions."""
    groups: dict[str, list[shapely.Geometry]] = {}
    for name, (_, end_node) in edge_ends.items():
        if end_node not in junctions:
            continue
        # names of edges from the junction back: `name` first, the farthest one last
        chain = _find_chain(name, edge_ends, junctions)
        first_lane, *_ = _list_centre_lines(roads[chain[-1]])
        last_lane, *_ = _list_centre_lines(roads[name])
        start = first_lane.coords[0]
        stop = last_lane.coords[-1]  # at the junction
        street = roads[name].get("name", "")
        compass_point = compass(site, np.subtract(start[:2], stop[:2]))
        label = f"{street}, from the {compass_point}" if street else f"from the {compass_point}"
        if len(junctions) > 1:
            label = f"{label} to {junction_names[end_node]}"
        for edge in chain:
            groups.setdefault(label, []).extend(_list_centre_lines(roads[edge]))
    return groups


def find_streets(site: Site) -> Approaches:
    """Streets in the area as places of a vehicle, named by compass point from the area's middle.

    A street that crosses the middle is one place on each side. There are no bays, so no vehicle is
    at the last place, `PARKED`."""
    area = shapely.box(*site.area)
    area_middle = [*area.centroid.coords[0]]
    lines_by_street = defaultdict[str, list[shapely.Geometry]](list)
    for edge in ElementTree.fromstring(site.network or "<net/>").findall("edge"):
        lines = shapely.intersection(shapely.union_all(_list_centre_lines(edge)), area)
        if not lines.is_empty:
            offset = np.array([*lines.centroid.coords[0]]) - area_middle
            name = f"{edge.get('name') or 'the road'} in the {compass(site, offset)}"
            is_in_junction = edge.get("function")  # SUMO marks edges within a node so
            lines_by_street["the junction" if is_in_junction else name].append(lines)
    streets = {name: shapely.union_all(lines) for name, lines in sorted(lines_by_street.items())}
    streets = streets or {"the junction": area}
    no_bays = np.empty((0, 3))  # x, y, yaw
    # `names` has `PARKED` at its end, for which there is no lane
    return Approaches(names=(*streets, PARKED), lanes=tuple(streets.values()), bays=no_bays)


def _name_junctions(
    site: Site, root: ElementTree.Element, roundabout_names: dict[str, str], junctions: set[str]
) -> dict[str, str]:
    """Names of junctions by their side of the area, equal names numbered from its middle outwards.

    Args:
        site: Site with the area.
        root: Root element of the road network.
        roundabout_names: Name of the roundabout of each node that belongs to one.
        junctions: Nodes and roundabouts that are junctions."""
    middle = (site.area[:2] + site.area[2:]) / 2
    # positions of the nodes of each junction (m, frame of the site)
    spots = defaultdict[str, list[Float64[np.ndarray, "2"]]](list)
    for junction in root.findall("junction"):
        node = junction.get("id", "")
        spot = np.array([float(junction.get("x", 0)), float(junction.get("y", 0))])
        spots[roundabout_names.get(node, node)].append(spot)
    sides: dict[str, str] = {}
    distances: dict[str, float] = {}
    for node in junctions:
        sides[node] = ""
        distances[node] = np.inf
        if spots[node]:
            offset = np.mean(spots[node], axis=0) - middle
            distances[node] = float(np.hypot(*offset))
            is_middle = distances[node] <= MAX_MIDDLE_DISTANCE_M
            sides[node] = "middle" if is_middle else compass(site, offset)
    by_name = defaultdict[str, list[str]](list)
    for node in sorted(junctions, key=lambda node: (distances[node], node)):
        side = sides[node]
        by_name[f"the {side} junction" if side else "junction"].append(node)
    names = dict[str, str]()
    for name, nodes in by_name.items():
        for number, node in enumerate(nodes, 1):
            names[node] = f"{name} {number}" if len(nodes) > 1 else name
    return names


def compass(site: Site, offset: Float64[np.ndarray, "2"]) -> str:
    """Compass point of a direction in the site's frame (x, y). North is +y of its map."""
    east, north = (site.map_SE3_site[:2, :2] @ offset).tolist()
    angle_deg = np.degrees(np.arctan2(east, north))  # clockwise from north
    return COMPASS[round(angle_deg / 45) % 8]


def _find_chain(name: str, edge_ends: dict[str, tuple[str, str]], junctions: set[str]) -> list[str]:
    """Names of an edge and the edges before it, back to a junction or a dead end.

    The walk never goes round a circle: it begins at an edge that ends at a junction, and the node
    at which it would enter a circle has three neighbours, so is a junction.

    Args:
        name: Name of the edge, with which the result begins.
        edge_ends: Nodes at which each edge begins and ends.
        junctions: Nodes that are junctions.
    """
    chain = [name]
    begin_node, end_node = edge_ends[name]
    while begin_node not in junctions:
        # edges that lead here, but for the opposite direction of the same road
        previous_edges = [
            edge
            for edge, (begin, end) in edge_ends.items()
            if end == begin_node and begin != end_node
        ]
        if len(previous_edges) != 1:
            break
        chain += previous_edges
        begin_node, end_node = edge_ends[chain[-1]]
    return chain


def _list_centre_lines(edge: ElementTree.Element) -> list[shapely.LineString]:
    """Centre lines of the lanes of an edge that cars may use."""
    shapes = [parse_shape(lane) for lane in edge.findall("lane") if "passenger" in list_users(lane)]
    return [shapely.LineString(points) for points in shapes if len(points) > 1]
