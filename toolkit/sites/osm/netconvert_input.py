"""Text of OpenStreetMap's roads for netconvert."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import cast

import numpy as np

from toolkit.geometry import plane_rotation
from toolkit.sites import network as nets
from toolkit.sites.georeference import inverse_project
from toolkit.sites.osm.extract import Extract, Restriction, Way
from toolkit.sites.osm.road_rules import RoadRules, name_types


def write_osm(pieces: Iterable[Way], extract: Extract) -> str:
    """Format pieces of roads as the text of an OSM XML file that netconvert reads.

    pieces: with their rules, in the extract's frame; nodes and ways get new numbers."""
    pieces = list(pieces)
    positions: dict[str, np.ndarray] = {}
    for piece in pieces:
        positions.update(zip(piece.nodes, piece.line, strict=True))
    numbers = {node: number for number, node in enumerate(positions, start=1)}
    elements = [
        *_format_nodes(positions, extract),
        *_format_ways(pieces, numbers),
        *_format_restrictions(pieces, numbers, extract.restrictions),
    ]
    return "\n".join(['<osm version="0.6">', *elements, "</osm>\n"])


def _format_nodes(positions: Mapping[str, np.ndarray], extract: Extract) -> Iterator[str]:
    """Yield OSM nodes in degrees, numbered from 1 in their order, with the map's traffic lights.

    positions: x, y (m) in the extract's frame by id."""
    points = np.array(list(positions.values())).reshape(-1, 2)
    map_points = points @ plane_rotation(extract.heading).T
    degrees = inverse_project(map_points, extract.centre)
    # places of traffic lights, rounded to mm to find the same place again
    signal_places = {
        tuple(xy.round(3))
        for xy, tags in extract.places
        if tags.get("highway") == "traffic_signals"
    }
    for number, (xy, lon_lat) in enumerate(zip(points, degrees, strict=True), start=1):
        has_signal = tuple(xy.round(3)) in signal_places
        tag = '<tag k="highway" v="traffic_signals"/>' if has_signal else ""
        longitude, latitude = lon_lat
        position = f'lon="{longitude:.9f}" lat="{latitude:.9f}"'
        yield f'<node id="{number}" {position}>{tag}</node>'


def _format_ways(pieces: Sequence[Way], numbers: Mapping[str, int]) -> Iterator[str]:
    """Yield OSM ways, numbered from 1 in their order. numbers: numbers of the nodes by id.

    Their highway is the name of SUMO's edge type for their rules."""
    types = name_types(cast("RoadRules", piece.rules) for piece in pieces)
    for number, piece in enumerate(pieces, start=1):
        tags = {**piece.tags, "highway": types[cast("RoadRules", piece.rules)]}
        elements = [f'<nd ref="{numbers[node]}"/>' for node in piece.nodes]
        for key, value in tags.items():
            elements.append(nets.format_element("tag", {"k": key, "v": value}))
        yield nets.format_element("way", {"id": number}, "".join(elements))


def _format_restrictions(
    pieces: Sequence[Way], numbers: Mapping[str, int], restrictions: Iterable[Restriction]
) -> Iterator[str]:
    """Yield OSM relations of the turns between pieces, one for each pair that meets at the node.

    pieces: parts of the map's ways, each named by the id of its way, numbered from 1 in the order
    given; numbers: numbers of the nodes by id."""
    # numbers of the pieces by id of their way and of a node on them
    piece_numbers: dict[tuple[str, str], list[int]] = {}
    for number, piece in enumerate(pieces, start=1):
        for node in piece.nodes:
            piece_numbers.setdefault((piece.name, node), []).append(number)
    for number, turn in enumerate(restrictions, start=1):
        # named as in the map, for netconvert's warnings
        name = turn.name if re.fullmatch(r"\d{1,15}", turn.name, re.ASCII) else number
        for origin in piece_numbers.get((turn.origin, turn.via), ()):
            for target in piece_numbers.get((turn.target, turn.via), ()):
                rows: list[tuple[str, nets.XmlAttributes]] = [
                    ("member", {"type": "way", "ref": origin, "role": "from"}),
                    ("member", {"type": "node", "ref": numbers[turn.via], "role": "via"}),
                    ("member", {"type": "way", "ref": target, "role": "to"}),
                    ("tag", {"k": "type", "v": "restriction"}),
                    ("tag", {"k": "restriction", "v": turn.kind}),
                ]
                content = "".join(nets.format_element(tag, row) for tag, row in rows)
                yield nets.format_element("relation", {"id": name}, content)
