"""OpenStreetMap extracts in metres around a centre."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.osm.road_rules import RoadRules, Tags


@dataclass(frozen=True)
class Way:
    """Line or outline of a map.

    Attributes:
        line: (k, 2) points x, y (m) in the frame of the extract.
        nodes: ids of its k nodes, one for each point.
        tags: its tags.
        name: its id in the map, the same for all pieces of a way.
        rules: who may drive on it and how fast, for a piece of road; None for other ways."""

    line: Float64[np.ndarray, "k 2"] = field(repr=False)
    nodes: tuple[str, ...]
    tags: Tags
    name: str = ""
    rules: RoadRules | None = None

    @property
    def is_closed(self) -> bool:
        """True if the way ends at its first node and has three corners or more."""
        return len(self.nodes) > 3 and self.nodes[0] == self.nodes[-1]


class Restriction(NamedTuple):
    """Rule for vehicles that turn at a node.

    Attributes:
        name: id in the map.
        kind: no_left_turn, only_straight_on and so on.
        origin: id of the way before the turn.
        via: id of the node.
        target: id of the way after the turn."""

    name: str
    kind: str
    origin: str
    via: str
    target: str


@dataclass(frozen=True)
class Extract:
    """Map in metres around its centre, which is the origin of its frame.

    Attributes:
        centre: longitude, latitude (degrees).
        heading: direction of x (rad, counter-clockwise from east).
        ways: all ways with two or more known nodes.
        areas: areas with their holes, and their tags.
        places: point x, y (m) and tags of each node that has tags.
        notes: texts that name and count what was left out or changed.
        node_tags: tags of the nodes that have any, by id.
        restrictions: rules of turning."""

    centre: tuple[float, float]
    heading: float
    ways: tuple[Way, ...]
    areas: tuple[tuple[shapely.Polygon, Tags], ...]
    places: tuple[tuple[Float64[np.ndarray, "2"], Tags], ...]
    notes: tuple[str, ...] = ()
    node_tags: Mapping[str, Tags] = field(default_factory=dict, repr=False)
    restrictions: tuple[Restriction, ...] = ()
