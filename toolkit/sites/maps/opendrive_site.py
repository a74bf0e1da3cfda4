"""Sites from pieces of OpenDRIVE files."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Pose
from toolkit.geometry import STEEPEST, pose
from toolkit.runtime.reading import name_errors
from toolkit.sites import network as nets
from toolkit.sites.maps.finish import finish_site
from toolkit.sites.maps.map_bays import find_free_bays, lay_bays
from toolkit.sites.maps.network_frame import move_network_to_site
from toolkit.sites.maps.opendrive_network import (
    STOREY_GAP_M,
    cut_network,
    describe_near_warnings,
    find_near_edges,
    find_nearest_road,
    make_whole_network,
)
from toolkit.sites.maps.piece import MAP_REACH_M, SURROUNDINGS_M, MapPiece
from toolkit.sites.maps.road_surface import junction_corners, whole_road
from toolkit.sites.maps.tracks import find_tracks
from toolkit.sites.opendrive.ground_plane import find_plane
from toolkit.sites.opendrive.lane_shapes import align_lanes
from toolkit.sites.opendrive.lane_surfaces import (
    FOOTWAY,
    UNPAVED,
    MapLane,
    describe_widths,
    outline_lanes,
)
from toolkit.sites.opendrive.map_file import locate_degrees, read_opendrive
from toolkit.sites.opendrive.map_frame import move_shape_to_map, move_shape_to_site
from toolkit.sites.opendrive.map_problems import describe_problems
from toolkit.sites.opendrive.map_projection import describe_turn, find_placement, find_projection
from toolkit.sites.opendrive.map_roads import MapRoad, find_near_roads
from toolkit.sites.opendrive.plain_map import PlainMap, write_plain
from toolkit.sites.opendrive.road_objects import (
    move_objects_to_site,
    read_road_objects,
    select_solids,
)
from toolkit.sites.site import Relief, Site
from toolkit.sites.surroundings.parking_bays import Bay

MIN_SLOPE = 0.005  # m per m; flatter ground counts as level
MIN_BAY_LANE_M = 1.8  # width of a lane for parking that has room for bays


def import_opendrive(piece: MapPiece) -> Site:
    """Import a site from an OpenDRIVE file (1.4 to 1.8).

    docs/reference/opendrive.md lists the elements that are read. Roads are on one plane, which
    slopes as they do; those more than `STOREY_GAP_M` above or below are left out. Traffic keeps to
    the side, limits and users of the map. Objects and signals become solids and bays, mounts are
    made along the kerbs. Warnings name a georeference that leads nowhere, what is left out or taken
    otherwise, and what is drawn.

    Raises ValueError in one line if the file is no OpenDRIVE map or has no road there, ImportError
    without SUMO."""
    path = piece.path
    with name_errors(path):
        root = read_opendrive(path, (float(piece.centre[0]), float(piece.centre[1])))
        placement = find_placement(root)
        plain_map = write_plain(root)
    geo_reference = find_projection(root, path.name)
    network = _make_network(root, plain_map, piece)
    frame = network.map_SE3_site
    with name_errors(path):
        window = _find_window(piece)
        roads, other_storeys = find_near_roads(root, window, frame[2, 3], STOREY_GAP_M)
        objects = move_objects_to_site(read_road_objects(roads), frame)
        map_lanes = [lane for road in roads for lane in outline_lanes(road)]
    tracks = find_tracks(network.text)
    lanes, footways = _make_surfaces(map_lanes, piece, network, tracks)
    reach = piece.around(SURROUNDINGS_M)
    solids, notes = select_solids(objects, reach, lanes, tracks)
    relief, slope_notes = _fit_relief(roads, piece, frame)
    bays = [*objects.bays, *_lay_lane_bays(map_lanes, frame)]
    parking = find_free_bays(bays, reach, solids, tracks)
    notes += [
        *slope_notes,
        *_describe_storeys(other_storeys),
        *describe_turn(root),
        *describe_widths(map_lanes),
        *describe_problems(plain_map, roads),
        *describe_near_warnings(network.warnings, network.text),
    ]
    make_site = partial(Site, path.stem, piece.area, map_SE3_site=placement @ frame)
    place_site = partial(make_site, geo_reference=geo_reference, relief=relief)
    site = place_site(lanes=lanes, footways=footways, parking=parking, network=network.text)
    lamps = np.array(objects.lamps).reshape(-1, 2)
    return finish_site(site, piece, solids, lamps=lamps, notes=notes)


class _SiteNetwork(NamedTuple):
    """SUMO network of a site.

    Attributes:
        text: net.xml text of the roads near the site, in its frame.
        whole: net.xml text of all roads, in the map's coordinates.
        map_SE3_site: pose of the site in the map; z is the height of the road nearest to it.
        warnings: lines that netconvert warned in, without their prefix."""

    text: str
    whole: str
    map_SE3_site: Pose
    warnings: Sequence[str]

    def find_nearest_road(self) -> tuple[float, float] | None:
        """Place x, y on the road nearest to the site, in the map's coordinates; None if none."""
        return find_nearest_road(self.whole, shapely.Point(*self.map_SE3_site[:2, 3]))


def _find_window(piece: MapPiece) -> shapely.Polygon:
    """Ground of the map whose roads are kept, in its coordinates."""
    x, y = map(float, piece.centre)
    return move_shape_to_map(piece.around(MAP_REACH_M), pose(x, y, yaw=piece.heading))


def _make_network(root: ElementTree.Element, plain: PlainMap, piece: MapPiece) -> _SiteNetwork:
    """Make the network of the roads near a site, in its frame and as a whole.

    root: the map; plain: its roads as netconvert reads them. Raises ValueError if no road is near,
    ImportError without SUMO."""
    x, y = map(float, piece.centre)
    window = _find_window(piece)
    raw_network, warning_lines = make_whole_network(plain, piece)
    whole_network = align_lanes(raw_network, plain, window)
    near_edges = find_near_edges(whole_network, window)
    if not near_edges.has_edges:
        nearest_place = find_nearest_road(whole_network, shapely.Point(x, y))
        raise piece.no_road(nearest_place, nearby=_describe_degrees(root, (x, y)))
    map_network = cut_network(whole_network, near_edges.other_edges, piece, lefthand=plain.lefthand)
    map_SE3_site = pose(x, y, near_edges.level, yaw=piece.heading)
    return _SiteNetwork(
        text=move_network_to_site(map_network, map_SE3_site),
        whole=whole_network,
        map_SE3_site=map_SE3_site,
        warnings=warning_lines,
    )


def _describe_degrees(root: ElementTree.Element, centre: tuple[float, float]) -> str:
    """Hint for a centre that is on the map if it is read as longitude and latitude, else "".

    The hint names the place in the file's coordinates."""
    place = locate_degrees(root, centre)
    if place is None:
        return ""
    x, y = place
    return f"if these are degrees, in the file it is --centre {x:.10g} {y:.10g}"


def _make_surfaces(
    map_lanes: Sequence[MapLane], piece: MapPiece, network: _SiteNetwork, tracks: shapely.Geometry
) -> tuple[nets.Polygons, nets.Polygons]:
    """Make the polygons of the carriageway and of the footways of the site, in its frame.

    map_lanes: lanes of the map, in its frame; tracks: ground that vehicles drive on, in the site's
    frame. Raises ValueError if no carriageway is in the area."""
    frame = network.map_SE3_site
    driven_lanes = [
        move_shape_to_site(lane.outline, frame) for lane in map_lanes if lane.kind not in UNPAVED
    ]
    walked_lanes = [
        move_shape_to_site(lane.outline, frame) for lane in map_lanes if lane.kind in FOOTWAY
    ]
    if not driven_lanes:
        kinds = sorted({lane.kind for lane in map_lanes})
        if kinds:
            raise piece.no_carriageway(kinds)
        raise piece.no_road(network.find_nearest_road())
    window = piece.around(SURROUNDINGS_M)
    corners = junction_corners(network.text)  # carriageway and footway that the lanes leave open
    lanes, footways = whole_road(driven_lanes, walked_lanes, tracks, window, fillings=corners)
    if not nets.unite(lanes).intersects(shapely.box(*piece.area)):
        raise piece.no_road(network.find_nearest_road())
    return lanes, footways


def _lay_lane_bays(map_lanes: Sequence[MapLane], map_SE3_site: Pose) -> list[Bay]:
    """List bays x, y (m), yaw (rad) on the map's lanes for parking, in the site's frame.

    map_lanes: lanes of the map, in its frame; map_SE3_site: pose of the site in the map."""
    bays: list[Bay] = []
    for lane in map_lanes:
        if lane.kind == "parking" and lane.width >= MIN_BAY_LANE_M:
            middle = move_shape_to_site(shapely.LineString(lane.middle), map_SE3_site)
            bays += lay_bays(shapely.get_coordinates(middle))
    return bays


def _fit_relief(
    roads: Sequence[MapRoad], piece: MapPiece, map_SE3_site: Pose
) -> tuple[Relief, list[str]]:
    """Fit a relief that slopes as the roads in the area do; return it and notes.

    The relief is level if the roads are level to `MIN_SLOPE`, or if they do not share a slope that
    a site can have (`STEEPEST`). map_SE3_site: pose of the site in the map."""
    area = move_shape_to_map(piece.around(0.0), map_SE3_site)
    plane = find_plane(roads, area, map_SE3_site)
    if plane.steepest <= MIN_SLOPE:
        return Relief(), []
    slope_x, slope_y = plane.slope
    rise = float(np.hypot(slope_x, slope_y))  # m per m, in the steepest direction
    if MIN_SLOPE < rise <= STEEPEST:
        relief = Relief(slope=(round(slope_x, 5), round(slope_y, 5)))
        note = (
            f"the site slopes by {100 * rise:.1f} % as its roads do, which leave that plane by up "
            f"to {plane.deviation:.2f} m"
        )
        return relief, [note]
    steepest = f"{100 * plane.steepest:.1f} %"
    return Relief(), [f"the steepest road in the area rises by {steepest}; the site is level"]


def _describe_storeys(other_storeys: int) -> list[str]:
    """Return a note of the number of roads on other storeys, none for 0."""
    if not other_storeys:
        return []
    return [
        f"{other_storeys} roads more than {STOREY_GAP_M:g} m above or below the site were left out"
    ]
