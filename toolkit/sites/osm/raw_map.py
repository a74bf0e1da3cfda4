"""Nodes, ways and relations of an OpenStreetMap file, in degrees.

Extracts are untidy: ids are there twice, nodes lack a place, relations lack members. Unusable parts
are left out and counted."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Self
from xml.etree import ElementTree

import numpy as np

from toolkit.sites.osm.elements import read_elements
from toolkit.sites.osm.extract import Restriction
from toolkit.sites.osm.road_rules import Tags

OFF_EARTH_NOTE = "nodes that are no place on earth were left out"
TWICE_NOTE = "nodes or ways of one id are there twice: the last one counts"
TURN_HOURS_NOTE = (
    "rules of turning hold for some hours or vehicles only (restriction:conditional), and are "
    "not used"
)
TURN_UNREAD_NOTE = "rules of turning lead over ways or lack a part, and are not used"
TURN_EXCEPT_NOTE = "rules of turning except some vehicles, but hold for all here"


class RawWay(NamedTuple):
    """Way as the file lists it: ids of its nodes, and its tags."""

    nodes: list[str]
    tags: Tags


class Multipolygon(NamedTuple):
    """Relation of ways that enclose an area.

    Attributes:
        members: id and role of each way; the role "inner" is for holes.
        tags: tags of the relation."""

    members: list[tuple[str, str]]
    tags: Tags


@dataclass
class RawMap:
    """Contents of a map file.

    Attributes:
        node_lon_lats: longitude and latitude (degrees) of nodes by id.
        node_tags: tags of the nodes that have any, by id.
        bounds: west, south, east and north (degrees) of each <bounds>.
        ways: ways by id.
        multipolygons: areas made of several ways.
        restrictions: turns that the map forbids or prescribes.
        oddities: number of parts that were left out or changed, by the words of their note."""

    node_lon_lats: dict[str, list[float]] = field(default_factory=dict)
    node_tags: dict[str, Tags] = field(default_factory=dict)
    bounds: list[list[float]] = field(default_factory=list)
    ways: dict[str, RawWay] = field(default_factory=dict)
    multipolygons: list[Multipolygon] = field(default_factory=list)
    restrictions: list[Restriction] = field(default_factory=list)
    oddities: Counter[str] = field(default_factory=Counter)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a map file. Raises ValueError for another or a damaged file."""
        raw_map = cls()
        for element in read_elements(path):
            raw_map._add(element)
        return raw_map

    def _add(self, element: ElementTree.Element) -> None:
        """Add an element of the file, or remove a node or way that an editor marked as deleted."""
        tags = {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}
        relation_type = tags.get("type", "") if element.tag == "relation" else ""
        # a deleted element has no other meaning, so it is looked for first
        if element.get("action") == "delete" or element.get("visible") == "false":
            self._remove(element)
        elif element.tag == "bounds":
            south_west = _read_degrees(element, "minlon", "minlat")
            north_east = _read_degrees(element, "maxlon", "maxlat")
            self.bounds.append([*south_west, *north_east])
        elif element.tag == "node":
            self._add_node(element, tags)
        elif element.tag == "way":
            self._add_way(element, tags)
        elif relation_type == "multipolygon":
            ways = [row for row in element.iter("member") if row.get("type") == "way"]
            members = [(way.get("ref", ""), way.get("role", "")) for way in ways]
            self.multipolygons.append(Multipolygon(members, tags))
        elif relation_type.startswith("restriction"):
            turns, note = _read_restriction(element, tags)
            self.restrictions += turns
            self.oddities[note] += bool(note)  # "", without a note, remains at 0

    def _remove(self, element: ElementTree.Element) -> None:
        """Remove a node or way that an earlier element described."""
        name = element.get("id", "")
        if element.tag == "node":
            self.node_lon_lats.pop(name, None)
            self.node_tags.pop(name, None)
        elif element.tag == "way":
            self.ways.pop(name, None)

    def _add_node(self, element: ElementTree.Element, tags: Tags) -> None:
        """Add a node with its tags if it is a place on earth, and count it as odd if not."""
        name = element.get("id", "")
        lon_lat = _read_degrees(element, "lon", "lat")
        is_on_earth = not np.isnan(lon_lat[0])
        # a bool counts as 0 or 1; a node that is there twice at the same place is not odd
        self.oddities[OFF_EARTH_NOTE] += not is_on_earth
        self.oddities[TWICE_NOTE] += self.node_lon_lats.get(name, lon_lat) != lon_lat
        if is_on_earth:
            self.node_lon_lats[name] = lon_lat
            if tags:
                self.node_tags[name] = tags

    def _add_way(self, element: ElementTree.Element, tags: Tags) -> None:
        """Add a way, and the nodes whose places Overpass lists within it ("out geom").

        Nodes that the file has listed before keep their place."""
        name = element.get("id", "")
        self.oddities[TWICE_NOTE] += name in self.ways
        nodes = [row.get("ref", "") for row in element.iter("nd")]
        self.ways[name] = RawWay(nodes, tags)
        for row in element.iter("nd"):
            node = row.get("ref", "")
            if row.get("lat") is None or node in self.node_lon_lats:
                continue
            lon_lat = _read_degrees(row, "lon", "lat")
            if not np.isnan(lon_lat[0]):
                self.node_lon_lats[node] = lon_lat


def _read_degrees(element: ElementTree.Element, lon_key: str, lat_key: str) -> list[float]:
    """Longitude and latitude (degrees) in two attributes, both NaN if they are no place on earth.

    lon_key, lat_key: names of the attributes."""
    try:
        longitude = float(element.get(lon_key, "nan"))
        latitude = float(element.get(lat_key, "nan"))
    except ValueError:
        return [np.nan, np.nan]
    is_on_earth = abs(longitude) <= 180 and abs(latitude) < 90
    return [longitude, latitude] if is_on_earth else [np.nan, np.nan]


def _read_restriction(element: ElementTree.Element, tags: Tags) -> tuple[list[Restriction], str]:
    """Read the turns that a relation forbids or prescribes; return them and a note of unused parts.

    One relation may have several ways before and after the turn, and gives a turn for each pair.
    The note is "" if all is used."""
    members = _list_members(element)
    kind = tags.get("restriction", "").strip().lower()
    if not kind:
        is_timed = any(key.startswith("restriction:") for key in tags)
        return [], TURN_HOURS_NOTE if is_timed else TURN_UNREAD_NOTE
    if "no_u_turn" in kind:
        return [], ""  # nobody turns back on these roads
    name = element.get("id", "")
    via_nodes = members.get("via node", [])
    turns = [
        Restriction(name, kind, origin=origin, via=via_nodes[0], target=target)
        for origin in members.get("from way", [])
        for target in members.get("to way", [])
        if via_nodes
    ]
    if not turns or len(via_nodes) > 1 or not kind.startswith(("no_", "only_")):
        return [], TURN_UNREAD_NOTE
    return turns, TURN_EXCEPT_NOTE if "except" in tags else ""


def _list_members(element: ElementTree.Element) -> Mapping[str, list[str]]:
    """Ids of a relation's members by role and type, such as "from way"."""
    members: dict[str, list[str]] = {}
    for member in element.iter("member"):
        role = f"{member.get('role')} {member.get('type')}"
        members.setdefault(role, []).append(member.get("ref", ""))
    return members
