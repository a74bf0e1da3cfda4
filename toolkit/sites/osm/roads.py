"""Roads for vehicles of an OpenStreetMap extract.

`toolkit.sites.osm.road_rules` reads who may drive where, and how fast; only well-formed tags reach
netconvert."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import cast

import shapely

from toolkit.sites.osm.extract import Extract, Way
from toolkit.sites.osm.road_notes import (
    describe_crossings,
    describe_rings,
    describe_unused,
    list_unused_places,
)
from toolkit.sites.osm.road_pieces import cut_way, split_way
from toolkit.sites.osm.road_rules import (
    RoadReading,
    RoadRules,
    Tags,
    count_notes,
    describe_barrier,
    is_barred,
    number_pieces,
    read_rules,
)
from toolkit.sites.osm.tag_values import is_off_ground, is_underground
from toolkit.sites.osm.way_kinds import crosses_road, is_driven_walk, is_road, reaches_window

BARRED_NOTE = "barriers on roads that cars cannot pass, and no vehicle here"
DRIVEN_WALKS_NOTE = "pedestrian streets open to some vehicles, not driven on here"


def find_roads(
    extract: Extract, window: shapely.Geometry, *, lefthand: bool = False
) -> tuple[list[Way], list[str]]:
    """Find the roads for vehicles within `window`, cut at its edge and at barriers, and notes.

    They have the tags meant for netconvert, and their rules. Tunnels and bridges over another road
    are left out and noted. window: in the extract's frame; lefthand: traffic keeps left."""
    near_ways = [
        way for way in extract.ways if "highway" in way.tags and reaches_window(way, window)
    ]
    roads, notes = _select_roads(near_ways)
    notes += describe_crossings(roads)
    readings = [read_rules(road.tags) for road in roads]
    barred_nodes = _list_barred(roads, extract.node_tags)
    unused_rules = [
        *_list_unused_rules(roads, readings, barred_nodes, extract.node_tags),
        *(DRIVEN_WALKS_NOTE for way in near_ways if is_driven_walk(way.tags)),
        *list_unused_places(extract, window),
    ]
    notes += count_notes(unused_rules)
    notes += describe_unused(near_ways)
    notes += describe_rings(roads, lefthand=lefthand)
    pieces: list[Way] = []
    for road, reading in zip(roads, readings, strict=True):
        for stretch in split_way(road, barred_nodes):
            pieces += cut_way(stretch, window, reading, lefthand=lefthand)
    rules = number_pieces(cast("RoadRules", piece.rules) for piece in pieces)
    pieces = [replace(piece, rules=rule) for piece, rule in zip(pieces, rules, strict=True)]
    return pieces, notes


def _select_roads(ways: Sequence[Way]) -> tuple[list[Way], list[str]]:
    """Select the roads on the ground from ways, each once; return them and notes of the others.

    Bridges over no other road stay."""
    notes = []
    roads = [way for way in ways if is_road(way.tags)]
    roads_above_ground = [road for road in roads if not is_underground(road.tags)]
    level_roads = [road for road in roads_above_ground if not is_off_ground(road.tags)]
    usable_roads = [road for road in roads_above_ground if not _crosses_over(road, level_roads)]
    unusable_count = len(roads) - len(usable_roads)
    if unusable_count:
        notes.append(f"{unusable_count} tunnels or bridges over a road were left out")
    single_roads = _drop_doubles(usable_roads)
    double_count = len(usable_roads) - len(single_roads)
    if double_count:
        notes.append(f"{double_count} roads that are in the map twice were left out")
    return single_roads, notes


def _crosses_over(way: Way, level_roads: Iterable[Way]) -> bool:
    """True for a way off the ground that crosses a road on the ground."""
    return is_off_ground(way.tags) and any(crosses_road(way, road) for road in level_roads)


def _drop_doubles(ways: Iterable[Way]) -> list[Way]:
    """Return roads without those that run along earlier ones from first node to last."""
    seen_steps: set[frozenset[str]] = set()
    single_roads: list[Way] = []
    for way in ways:
        # pairs of neighbouring nodes, in either direction
        steps = {frozenset(step) for step in pairwise(way.nodes)}
        if not steps <= seen_steps:
            single_roads.append(way)
        seen_steps |= steps
    return single_roads


def _list_unused_rules(
    roads: Iterable[Way],
    readings: Iterable[RoadReading],
    barred_nodes: Collection[str],
    node_tags: Mapping[str, Tags],
) -> Iterator[str]:
    """Yield a note for each rule of a road, or of a barrier on one, that is not used.

    The same note comes once for each place. readings: one for each road; barred_nodes: ids of nodes
    that no car can pass; node_tags: tags of nodes by id."""
    roads = list(roads)
    for reading in readings:
        yield from reading.notes
    for road in roads:
        for node in road.nodes:
            if node in barred_nodes:
                yield BARRED_NOTE
    for node in _list_tagged(roads, node_tags):
        yield from describe_barrier(node_tags[node])


def _list_barred(ways: Iterable[Way], node_tags: Mapping[str, Tags]) -> set[str]:
    """Ids of the nodes of ways that no car can pass. node_tags: tags of nodes by id."""
    return {node for node in _list_tagged(ways, node_tags) if is_barred(node_tags[node])}


def _list_tagged(ways: Iterable[Way], node_tags: Mapping[str, Tags]) -> set[str]:
    """Ids of the nodes of ways that have tags. node_tags: tags of nodes by id."""
    return {node for way in ways for node in way.nodes if node in node_tags}
