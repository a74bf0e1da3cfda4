"""SUMO network of the roads of an OpenStreetMap extract."""

import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

from toolkit.geometry import pose
from toolkit.runtime.reading import name_errors
from toolkit.sites import network as nets
from toolkit.sites.georeference import projection
from toolkit.sites.maps.network_frame import move_network_to_site
from toolkit.sites.maps.piece import MAP_REACH_M, MapPiece
from toolkit.sites.netconvert_warnings import describe_warnings
from toolkit.sites.osm.extract import Extract, Way
from toolkit.sites.osm.netconvert_input import write_osm
from toolkit.sites.osm.parking import Parking
from toolkit.sites.osm.parking_strips import find_parking_strips, restrict_network, widen_network
from toolkit.sites.osm.road_notes import describe_roadless
from toolkit.sites.osm.road_rules import RoadRules, format_types, name_types

_OSM_OPTIONS = (
    "--osm.sidewalks",
    "--crossings.guess",
    "--geometry.remove",
    "--roundabouts.guess",
    "--junctions.join",
    "--tls.guess-signals",
    "--tls.discard-simple",
    "--tls.join",
    "--output.street-names",
)
# as netconvert writes the names of OpenStreetMap's streets
_ESCAPED_TWICE = re.compile(r"&amp;(amp|lt|gt|quot|apos);")


def make_osm_network(
    pieces: Sequence[Way], extract: Extract, piece: MapPiece, parking: Parking
) -> tuple[str, list[str]]:
    """Make the net.xml text of the roads of an OpenStreetMap file, in the site's frame, and notes.

    pieces: roads within reach of the site, with their rules; parking: along which roads vehicles
    park. Raises ValueError if netconvert makes no road, ImportError without SUMO.

    netconvert reads the roads and writes them as plain edges. If the two directions of a road have
    different rules, or vehicles park along a kerb, these are changed and read again."""
    map_SE3_site = pose(yaw=piece.heading)
    side_options = ["--lefthand"] if parking.lefthand else []
    second_options = ["--output.street-names", "--no-warnings", *side_options]
    types = name_types(cast("RoadRules", way.rules) for way in pieces)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = [*_write_roads(folder, pieces, extract, types), *side_options]
        with name_errors(piece.path):
            network, warning_lines = nets.run_netconvert_with_warnings(options)
        if "<edge " not in network:
            raise piece.no_road(nearby=describe_roadless(extract, piece.around(MAP_REACH_M)))
        notes = describe_warnings(warning_lines)
        network = move_network_to_site(network, map_SE3_site)
        strips = find_parking_strips(network, parking) if parking else {}
        if any(rules.number is not None for rules in types):
            restrict_network(folder, types)
            restricted_network = nets.run_netconvert([*widen_network(folder, {}), *second_options])
            network = move_network_to_site(restricted_network, map_SE3_site)
        if strips:
            try:
                widened_network = nets.run_netconvert(
                    [*widen_network(folder, strips), *second_options]
                )
                network = move_network_to_site(widened_network, map_SE3_site)
            except ValueError as error:
                notes.append(f"parking along the kerbs was left out ({error})")
    return _ESCAPED_TWICE.sub(r"&\1;", network), notes


def _write_roads(
    folder: Path, pieces: Sequence[Way], extract: Extract, types: Mapping[RoadRules, str]
) -> list[str]:
    """Write roads and their types into a folder; return the options of netconvert for them.

    With these options netconvert also writes its edges into the folder, as plain.edg.xml and so on.

    pieces: roads within reach of the site; extract: the map's, with the places of their points;
    types: names of SUMO's edge types by the rules of the pieces."""
    road_file = folder / "roads.osm"
    type_file = folder / "types.xml"
    road_file.write_text(write_osm(pieces, extract), "utf-8")
    type_file.write_text(format_types(types), "utf-8")
    return [
        f"--osm-files={road_file}",
        f"--type-files={type_file}",
        f"--proj={projection(*extract.centre)}",
        *_OSM_OPTIONS,
        f"--plain-output-prefix={folder / 'plain'}",
    ]
