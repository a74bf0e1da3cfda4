"""Approaches: the lanes that lead motor vehicles to a junction.

A junction is a node from which roads go to three neighbours or more; the nodes of a roundabout
count as one. An approach is an edge that ends in a junction, with the edges before it back to the
previous junction; one that leaves a junction without reaching another is an exit. Edges within a
roundabout or a node belong to the junction. Streets have the names that the network gives them."""

from collections import defaultdict
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64, Int64
from toolkit.sites.network import list_users, parse_shape
from toolkit.sites.site import Site

NEAR_BAY = 1.5  # m from the middle of a parking bay, within which a vehicle is parked
COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
EXIT = "leaving the junction"
JUNCTION = "inside the junction"
PARKED = "parked"
MIDDLE_M = 5.0  # from the middle of the area, within which a junction is the middle one


@dataclass(frozen=True, eq=False)
class Approaches:
    """Places of a road network where a vehicle can be. lanes: centre lines of each but the last,
    which is `PARKED`."""

    names: tuple[str, ...]
    lanes: tuple[shapely.Geometry, ...]
    bays: Float64[np.ndarray, "n 3"]

    def locate(self, boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        """Index into `names` of each box. A box is parked in a bay, else on the nearest lane."""
        spots = shapely.points(boxes[:, :2])
        distance = np.array([shapely.distance(line, spots) for line in self.lanes]).reshape(
            len(self.lanes), len(boxes)
        )
        place = distance.argmin(axis=0) if len(self.lanes) else np.zeros(len(boxes), np.int64)
        to_bay = np.linalg.norm(boxes[:, None, :2] - self.bays[:, :2], axis=2).min(
            axis=1, initial=np.inf
        )
        return np.where(to_bay <= NEAR_BAY, len(self.names) - 1, place).astype(np.int64)


def find_approaches(site: Site) -> Approaches:
    """Find the approaches of a site's network."""
    root = ElementTree.fromstring(site.network or "<net/>")
    edges = {edge.get("id", ""): edge for edge in root.findall("edge") if _lines(edge)}
    ring = {name for each in root.findall("roundabout") for name in each.get("edges", "").split()}
    circles = enumerate(root.findall("roundabout"))
    merged = {
        node: f"roundabout {i}" for i, each in circles for node in each.get("nodes", "").split()
    }
    roads = {
        name: edge for name, edge in edges.items() if not edge.get("function") and name not in ring
    }
    nodes = {name: (edge.get("from", ""), edge.get("to", "")) for name, edge in roads.items()}
    ends = {name: tuple(merged.get(node, node) for node in both) for name, both in nodes.items()}
    neighbours: dict[str, set[str]] = defaultdict(set)
    for begin, end in ends.values():
        neighbours[begin].add(end)
        neighbours[end].add(begin)
    junctions = {
        node
        for node, near in neighbours.items()
        if len(near) >= 3 or node.startswith("roundabout ")
    }
    places = _name_junctions(site, root, merged, junctions)
    groups: dict[str, list[shapely.Geometry]] = {}
    for name, (_, end) in ends.items():
        if end in junctions:
            chain = _chain(name, ends, junctions)
            start = _lines(roads[chain[-1]])[0].coords[0]
            stop = _lines(roads[name])[0].coords[-1]
            street = roads[name].get("name", "")
            heading = compass(site, np.subtract(start[:2], stop[:2]))
            label = f"{street}, from the {heading}" if street else f"from the {heading}"
            label = f"{label} to {places[end]}" if len(junctions) > 1 else label
            groups.setdefault(label, []).extend(
                line for each in chain for line in _lines(roads[each])
            )
    used = {line.wkb for lines in groups.values() for line in lines}
    leaving = [line for edge in roads.values() for line in _lines(edge) if line.wkb not in used]
    inside = [line for name, edge in edges.items() if name not in roads for line in _lines(edge)]
    named = {**dict(sorted(groups.items())), EXIT: leaving, JUNCTION: inside}
    kept = {name: shapely.union_all(lines) for name, lines in named.items() if lines}
    if not kept:
        kept = {JUNCTION: shapely.box(*site.area)}
    return Approaches((*kept, PARKED), tuple(kept.values()), site.parking)


def find_streets(site: Site) -> Approaches:
    """Find the streets in the area, each side of the area's middle by itself; unnamed ones by their
    compass point."""
    area = shapely.box(*site.area)
    groups = defaultdict[str, list[shapely.Geometry]](list)
    for edge in ElementTree.fromstring(site.network or "<net/>").findall("edge"):
        inside = shapely.intersection(shapely.union_all(_lines(edge)), area)
        if not inside.is_empty:
            middle = np.array([*inside.centroid.coords[0]]) - [*area.centroid.coords[0]]
            name = f"{edge.get('name') or 'the road'} in the {compass(site, middle)}"
            groups["the junction" if edge.get("function") else name].append(inside)
    kept = {name: shapely.union_all(lines) for name, lines in sorted(groups.items())} or {
        "the junction": area
    }
    return Approaches((*kept, PARKED), tuple(kept.values()), np.empty((0, 3)))


def _name_junctions(
    site: Site, root: ElementTree.Element, merged: dict[str, str], junctions: set[str]
) -> dict[str, str]:
    """Names of junctions by where they are in the area, those of one name numbered from its middle
    on."""
    middle = (site.area[:2] + site.area[2:]) / 2
    spots = defaultdict[str, list[Float64[np.ndarray, "2"]]](list)
    for each in root.findall("junction"):
        node = each.get("id", "")
        spots[merged.get(node, node)].append(
            np.array([float(each.get("x", 0)), float(each.get("y", 0))])
        )
    offsets = {
        node: np.mean(spots[node], axis=0) - middle if spots[node] else None for node in junctions
    }
    away = {
        node: np.inf if offset is None else float(np.hypot(*offset))
        for node, offset in offsets.items()
    }
    places = defaultdict[str, list[str]](list)
    names = dict[str, str]()
    for node in sorted(junctions, key=lambda node: (away[node], node)):
        offset = offsets[node]
        place = (
            "" if offset is None else "middle" if away[node] <= MIDDLE_M else compass(site, offset)
        )
        places[f"the {place} junction" if place else "junction"].append(node)
    for name, nodes in places.items():
        for number, node in enumerate(nodes, 1):
            names[node] = f"{name} {number}" if len(nodes) > 1 else name
    return names


def compass(site: Site, offset: Float64[np.ndarray, "2"]) -> str:
    """Point of the compass in a direction of the site's frame. North is +y of its map."""
    east, north = (site.map_SE3_site[:2, :2] @ offset).tolist()
    return COMPASS[round(np.degrees(np.arctan2(east, north)) / 45) % 8]


def _chain(name: str, ends: dict[str, tuple[str, ...]], junctions: set[str]) -> list[str]:
    """An edge and those before it, back to a junction."""
    chain = [name]
    while ends[chain[-1]][0] not in junctions:
        start, target = ends[chain[-1]]
        # a circle has a junction
        before = [other for other, (a, b) in ends.items() if b == start and a != target]
        if len(before) != 1:
            break
        chain += before
    return chain


def _lines(edge: ElementTree.Element) -> list[shapely.LineString]:
    """Centre lines of the lanes of an edge that cars may use."""
    shapes = [parse_shape(lane) for lane in edge.findall("lane") if "passenger" in list_users(lane)]
    return [shapely.LineString(points) for points in shapes if len(points) > 1]
