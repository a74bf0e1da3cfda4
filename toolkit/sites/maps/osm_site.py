"""Sites from pieces of OpenStreetMap files."""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import shapely

from toolkit.geometry import pose
from toolkit.sites import network as nets
from toolkit.sites.georeference import projection
from toolkit.sites.maps.finish import finish_site
from toolkit.sites.maps.map_bays import find_free_bays
from toolkit.sites.maps.osm_network import make_osm_network
from toolkit.sites.maps.piece import MAP_REACH_M, SURROUNDINGS_M, MapPiece
from toolkit.sites.maps.road_surface import whole_road
from toolkit.sites.maps.tracks import find_tracks
from toolkit.sites.osm.buildings import make_buildings
from toolkit.sites.osm.extract import Extract
from toolkit.sites.osm.map_reader import read_map
from toolkit.sites.osm.parking import find_parking
from toolkit.sites.osm.parking_strips import find_strip_bays
from toolkit.sites.osm.paved_areas import find_parking_spaces, find_walks
from toolkit.sites.osm.road_notes import describe_roadless
from toolkit.sites.osm.road_rules import ROADS
from toolkit.sites.osm.roads import find_roads
from toolkit.sites.osm.street_objects import make_barriers, make_furniture, make_trees
from toolkit.sites.osm.traffic_side import choose_side
from toolkit.sites.site import Site


def import_osm(piece: MapPiece, *, lefthand: bool | None = None) -> Site:
    """Import a site from an OpenStreetMap file (.osm, also .gz or .bz2, or JSON of Overpass).

    lefthand: traffic keeps left, or right if False; None for the side that the map's roads or their
    country keep to.

    Roads, footways, parking along kerbs, buildings with heights, walls, fences, hedges, trees and
    lamp posts come from the map; mounts are on its lamp posts, or else along the kerbs. Roads have
    the map's rules: who may use them, which way, how fast, and where they turn. What the site
    cannot hold (tunnels, bridges over a road, buildings over a road, rules of some hours) is left
    out with a warning.

    Raises ValueError in one line if the file is no OSM map or has no road there, ImportError
    without SUMO."""
    centre = (float(piece.centre[0]), float(piece.centre[1]))
    extract = read_map(piece.path, centre, piece.heading)
    surroundings = piece.around(MAP_REACH_M)
    lefthand, side_notes = choose_side(extract, surroundings, lefthand)
    pieces, road_notes = find_roads(extract, surroundings, lefthand=lefthand)
    if not pieces:
        raise piece.no_road(nearby=describe_roadless(extract, surroundings))
    parking = find_parking(extract, ROADS, surroundings, lefthand=lefthand)
    network, network_notes = make_osm_network(pieces, extract, piece, parking)
    window = piece.around(SURROUNDINGS_M)
    street = _Street(*nets.road_polygons(network, piece.area))
    solids, building_notes = make_buildings(extract, window, street.ground.buffer(0.1))
    houses = nets.unite(solid.footprint for solid in solids)
    tracks = find_tracks(network)
    lanes, footways = _make_surfaces(extract, window, street, houses, tracks)
    solids += make_barriers(extract, window, street.ground.union(houses))
    solids += make_trees(extract, window, street.ground.union(houses))
    posts, lamps = make_furniture(extract, window, street.carriageway.union(houses))
    solids += posts
    occupied = nets.unite(solid.footprint for solid in solids).union(nets.unite(lanes))
    spaces = find_parking_spaces(extract, window, occupied.buffer(0.2))
    kerb_bays = find_free_bays(find_strip_bays(network, parking), window, solids, tracks)
    bays = np.concatenate([np.array(spaces, np.float64).reshape(-1, 3), kerb_bays])
    name = piece.path.name.partition(".")[0]
    place_site = partial(Site, name, piece.area, map_SE3_site=pose(yaw=piece.heading))
    make_site = partial(place_site, geo_reference=projection(*centre), network=network)
    site = make_site(lanes=lanes, footways=footways, parking=bays)
    if not nets.unite(lanes).intersects(shapely.box(*site.area)):
        raise piece.no_road(nearby=describe_roadless(extract, piece.around(0.0)))
    notes = [*extract.notes, *side_notes, *road_notes, *network_notes, *building_notes]
    return finish_site(site, piece, solids, lamps=lamps, notes=notes)


@dataclass(frozen=True)
class _Street:
    """Polygons of the lanes and footways of a network, in the site's frame."""

    lanes: nets.Polygons
    footways: nets.Polygons

    @cached_property
    def carriageway(self) -> shapely.Geometry:
        """Union of the lanes."""
        return nets.unite(self.lanes)

    @cached_property
    def ground(self) -> shapely.Geometry:
        """Union of lanes and footways."""
        return nets.unite([*self.lanes, *self.footways])


def _make_surfaces(
    extract: Extract,
    window: shapely.Polygon,
    street: _Street,
    houses: shapely.Geometry,
    tracks: shapely.Geometry,
) -> tuple[nets.Polygons, nets.Polygons]:
    """Make the polygons of the carriageway and of the footways of a site.

    The map's walks that belong to no road, off the street and off houses, are footways too.

    window: ground of the site; street: lanes and footways of the network; houses: their ground;
    tracks: ground that vehicles drive on."""
    walks = [
        walk.difference(street.ground).difference(houses) for walk in find_walks(extract, window)
    ]
    footway_rings = [*street.footways, *nets.cut_polygons(walks, window)]
    footways = [shapely.Polygon(ring).difference(street.carriageway) for ring in footway_rings]
    lanes = [shapely.Polygon(ring) for ring in street.lanes]
    return whole_road(lanes, footways, tracks, window)
