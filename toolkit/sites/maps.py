"""Sites from pieces of OpenDRIVE or OpenStreetMap files.

SUMO's netconvert makes their roads. The site frame is centred at the given place, x along
`heading`; `map_SE3_site` leads back to the map's coordinates. These are in the OpenDRIVE file's
projection, to which its header's offset leads, or metres of a transverse Mercator map of WGS84
(`geo_reference`) about the centre. The site has no sensors yet; mounts on lamp posts are real,
mounts along the kerbs are suggestions, all at a price of 1. Surroundings that the map leaves open
are drawn from a seed."""

import re
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Pose, Rng
from toolkit.geometry import STEEPEST, pose
from toolkit.runtime.reading import name_errors
from toolkit.sites import (
    furniture as f,
    lane_shapes,
    network as nets,
    opendrive,
    osm,
    osm_rules,
    plain_map,
    surroundings,
)
from toolkit.sites.georeference import doubt_place, doubt_scale, projection
from toolkit.sites.netconvert_warnings import describe_warnings
from toolkit.sites.site import Furnishing, Mount, Relief, Site, Solid

CRACK_M = 0.3  # half the width of cracks between polygons of a map that are closed
# half the width of a slot in the carriageway that is a fault of the network's corners
STUB_M = 1.2
OUTLINE_GRID_M = 1e-3  # grid of outlines
SLIVER_M = 0.2  # half the width of the thinnest footway that is kept
MIN_ROAD_M = 0.5  # half the width of the thinnest carriageway that is kept
# of a footway in the middle of a carriageway that is a fault of the network's corners
MAX_ISLET_M2 = 20.0
KERB_SIZE_M = (0.15, 0.12)  # width and height of kerbstones
MAX_TRACK_M = 3.5  # of the track a vehicle follows over a junction
MAP_BAY_SIZE_M = (5.8, 2.3)  # length and width of a bay without a size in the map
CORNER_CUT_M = 1.2  # next to the track of a turning vehicle, with lowered kerbs
TURNING_BODY_M = (5.5, 2.6)  # length and width of a turning vehicle, with room next to it
MAX_ROUGHNESS_M = 0.12  # of the ground's unevenness that is drawn, as in random sites
MAP_REACH_M = 80.0  # of road kept around the area, for traffic to enter
SURROUNDINGS_M = 30.0  # around the area, with buildings and furniture
MIN_SLOPE = 0.005  # m per m; flatter ground counts as level
STOREY_GAP_M = 3.5  # a road higher or lower by more is on another storey, and left out
BRACKET_M = 0.45  # from a lamp post's axis to the sensor it carries

_OPENDRIVE_OPTIONS = (
    "--opendrive.import-all-lanes",
    "--opendrive.curve-resolution=1",
    "--junctions.endpoint-shape",
)
_CROSSINGS = ("--crossings.guess", "--crossings.guess.speed-threshold=100")  # whatever the limit is
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


def find_tracks(network: str) -> shapely.Geometry:
    """Tracks of motor vehicles in a net.xml text. Over junctions with the room that both ends of a
    vehicle need."""
    tracks = []
    for edge, lane in nets.list_lanes(network, "normal", "internal"):
        if "passenger" in nets.list_users(lane):
            tracks.append(_track(lane))
            if edge.get("function") == "internal":
                tracks += _turning(nets.parse_shape(lane))
    return shapely.union_all(tracks)


def find_turns(network: str) -> shapely.Geometry:
    """Ground within `CORNER_CUT_M` of bent tracks over junctions."""
    bent = []
    for _, lane in nets.list_lanes(network, "internal"):
        if "passenger" in nets.list_users(lane):
            points = nets.parse_shape(lane)
            line = shapely.LineString(points)
            if line.hausdorff_distance(shapely.LineString(points[[0, -1]])) > 0.3:
                bent += [_track(lane), *_turning(points)]
    return shapely.union_all(bent).buffer(CORNER_CUT_M)


def junction_corners(network: str) -> tuple[shapely.Geometry, shapely.Geometry]:
    """Carriageway and footway at the corners of a network's junctions."""
    footway = shapely.union_all(
        [nets.enclose(lane) for _, lane in nets.list_lanes(network, "walkingarea")]
    )
    junctions = ElementTree.fromstring(network).iter("junction")
    ground = [
        nets.enclose(junction)
        for junction in junctions
        if junction.get("type") not in ("internal", "dead_end")
    ]
    return shapely.union_all(ground).difference(footway), footway


def whole_road(
    lanes: Sequence[shapely.Geometry],
    footways: Sequence[shapely.Geometry],
    tracks: shapely.Geometry,
    window: shapely.Geometry,
    *,
    fillings: tuple[shapely.Geometry, shapely.Geometry] = (shapely.Polygon(), shapely.Polygon()),
) -> tuple[nets.Polygons, nets.Polygons]:
    """Lanes and footways within `window` without cracks, stubs and slivers.

    Driven ground is carriageway, and a footway begins at the end of the carriageway.

    fillings: carriageway and footway at places that the map leaves open."""
    around = window.buffer(2 * STUB_M)
    paved = shapely.union_all([*lanes, tracks]).intersection(around)
    walk = shapely.union_all(list(footways)).intersection(around)
    paved = paved.union(fillings[0].intersection(around).difference(walk))
    closed = _open_shape(_close_shape(paved, CRACK_M), MIN_ROAD_M)
    walk = _close_shape(walk.union(fillings[1].intersection(around)), CRACK_M)
    stubs = _close_shape(closed, STUB_M).difference(closed).intersection(walk)
    walk = _open_shape(walk.difference(closed.union(stubs)), SLIVER_M)
    border = closed.buffer(0.1)
    small_pieces = [piece for piece in shapely.get_parts(walk) if piece.area < MAX_ISLET_M2]
    islets = [
        islet
        for islet in small_pieces
        if islet.boundary.intersection(border).length > 0.85 * islet.boundary.length
    ]
    carriageway = shapely.union_all([closed, stubs, *islets])
    # off the grid an overlay may lose a whole lane
    carriageway = shapely.set_precision(carriageway, OUTLINE_GRID_M)
    if carriageway.geom_type == "GeometryCollection":  # whose overlays are slow
        carriageway = shapely.union_all(nets.list_polygons(carriageway))
    between = _open_shape(carriageway.difference(shapely.union_all(list(lanes))), 0.01)
    near = [lane for lane in lanes if lane.intersects(window)]
    pieces = nets.cut_polygons(
        [lane.intersection(carriageway) for lane in near] + [between], window
    )
    carriageway = nets.unite(pieces)
    walk = _open_shape(walk.difference(carriageway), SLIVER_M).difference(carriageway)
    return pieces, nets.cut_polygons([walk], window)


def kerbstones(
    lanes: nets.Polygons, footways: nets.Polygons, lowered: shapely.Geometry
) -> list[Solid]:
    """Kerbstones between lanes and footways, off ground with lowered kerbs.

    lowered: this ground, as at corners that vehicles cut."""
    carriageway = nets.unite(lanes).buffer(0.01)
    walk = nets.unite(footways)
    if walk.is_empty:
        return []
    edge = (
        shapely.intersection(walk.boundary, carriageway.buffer(0.02))
        .simplify(0.02)
        .difference(lowered)
    )
    edge = shapely.line_merge(edge) if edge.geom_type == "MultiLineString" else edge
    return f.set_kerbs(edge, carriageway, KERB_SIZE_M)


def legs(network: str) -> tuple[list[Float64[np.ndarray, "_ 2"]], list[tuple[float, float]]]:
    """Paths of the network's streets near the site, with half their widths left and right (m).

    They are within 100 m of its middle. A path runs along the lane nearest to the middle of the
    street, one for each direction, and straight on for 130 m beyond the end of its edge, since
    houses are drawn along 90 m."""
    edges: dict[ElementTree.Element, list[ElementTree.Element]] = {}
    for edge, lane in nets.list_lanes(network):
        edges.setdefault(edge, []).append(lane)
    paths = []
    widths = []
    for lanes in edges.values():
        if not any("passenger" in nets.list_users(lane) for lane in lanes):
            continue
        line = shapely.LineString(nets.parse_shape(lanes[-1])).intersection(
            shapely.Point(0, 0).buffer(100.0)
        )
        for piece in shapely.get_parts(line):
            if piece.geom_type == "LineString" and piece.length > 10.0:
                width = round(sum(map(nets.lane_width, lanes)) - nets.lane_width(lanes[-1]) / 2, 3)
                path = shapely.get_coordinates(piece)
                ahead = (path[-1] - path[-2]) / np.hypot(*(path[-1] - path[-2]))
                paths.append(np.vstack([path, path[-1] + 130.0 * ahead]))
                widths.append((width, width))
    return paths, widths


def furnish_site(
    site: Site,
    mounts: Sequence[Mount],
    solids: Sequence[Solid],
    seed: int,
    density: Furnishing = "dense",
) -> tuple[Site, str]:
    """Furnish a site around the map's `solids`; return it and a note of the drawn things.

    Mounts get posts, except for those on the map's lamp posts. Raises ValueError for a negative
    seed."""
    if seed < 0:
        raise ValueError(f"seed must be a whole number from 0 up, got {seed}")
    rng = np.random.default_rng(seed)
    relief = replace(
        site.relief,
        amplitude=round(float(rng.uniform(0.0, MAX_ROUGHNESS_M)), 3),
        seed=int(rng.integers(2**31)),
    )
    site = replace(site, relief=relief, furnished=density)
    site = _furnish(
        replace(site, solids=f.settle(solids, relief), mounts=f.on_ground(mounts, site)), rng
    )
    counts = {
        kind: n for kind, n in surroundings.count_things(site)["drawn"].items() if kind != "pole"
    }
    note = f"drawn from seed {seed}, in no map: {surroundings.describe_things(counts)}"
    return site, f"{note}, ground within {relief.amplitude} m"


def redraw(site: Site, seed: int) -> Site:
    """Draw again, from another seed, what an import drew; the map's things, the ground and all
    mounts stay. Raises ValueError for a site that no import furnished."""
    if site.furnished == "none":
        raise ValueError(
            f"site {site.name!r} has no furnishing to draw again: coview site import draws one"
        )
    map_solids = tuple(solid for solid in site.solids if solid.origin != "drawn")
    is_mapped = np.array([origin != "drawn" for origin in site.bay_origins], bool)
    origins = tuple(origin for origin in site.bay_origins if origin != "drawn")
    bare = replace(
        site, solids=map_solids, parking=site.parking[is_mapped], parking_origins=origins
    )
    return _furnish(bare, np.random.default_rng(seed))


def _furnish(site: Site, rng: Rng) -> Site:
    """Add drawn solids and bays to a site with its mounts and the map's solids."""
    mounts = site.mounts
    solids = site.solids
    paths, widths = legs(site.network)
    road = surroundings.Road(paths, widths, site.lanes, site.footways)
    drawn, bays = surroundings.furnish(
        road, site.area, mounts, rng, light=site.furnished == "light"
    )
    map_shapes = [shapely.Point(m.position[:2]).buffer(0.5) for m in mounts if m.origin != "drawn"]
    map_shapes += [shapely.Polygon(s.footprint) for s in solids if s.kind not in ("kerb", "island")]
    map_shapes += [surroundings.outline(bay, MAP_BAY_SIZE_M) for bay in site.parking]
    apart = _keep_apart(
        [s for s in drawn if s.kind != "kerb"], shapely.union_all(map_shapes).buffer(0.2)
    )
    kerbs = [shapely.Polygon(s.footprint) for s in solids if s.kind == "kerb"]
    occupied = shapely.union_all(map_shapes + kerbs)
    free_bays_drawn = [
        bay for bay in bays if not occupied.intersects(surroundings.outline(bay, MAP_BAY_SIZE_M))
    ]
    origins = site.bay_origins + ("drawn",) * len(free_bays_drawn)
    solids += f.settle(surroundings.mark_drawn(apart), site.relief)
    parking = np.concatenate([site.parking, np.reshape(free_bays_drawn, (-1, 3))])
    return replace(site, solids=solids, parking=parking, parking_origins=origins)


def free_bays(
    bays: Sequence[surroundings.Bay],
    window: shapely.Geometry,
    solids: Sequence[Solid],
    tracks: shapely.Geometry,
) -> Float64[np.ndarray, "n 3"]:
    """Bays (x, y, yaw) in `window` without solids and traffic."""
    obstacles = nets.unite(s.footprint for s in solids if s.kind not in ("island", "kerb"))
    tracks = tracks.buffer(-0.3)
    ground = [(bay, surroundings.outline(bay, MAP_BAY_SIZE_M)) for bay in bays]
    ground = [
        (bay, shape)
        for bay, shape in ground
        if window.contains(shape) and not obstacles.intersects(shape)
    ]
    # corners of slanted bays
    free_spots = [bay for bay, shape in ground if not tracks.intersects(shape.buffer(-0.25))]
    return np.array(free_spots, np.float64).reshape(-1, 3).round(4)


def bays_along(middle: Float[np.ndarray, "k 2"]) -> list[surroundings.Bay]:
    """Bays x, y, yaw along a parking lane's middle, every 6.4 m."""
    line = shapely.LineString(middle)
    rows = surroundings.place_along(line, np.arange(3.2, line.length - 3.2, 6.4), 0.5)
    return list(map(tuple, rows.tolist()))


def _keep_apart(solids: Sequence[Solid], ours: shapely.Geometry) -> list[Solid]:
    """Solids that do not touch `ours`, even through others."""
    shapes = [shapely.Polygon(s.footprint) for s in solids]
    groups = [shape for shape, s in zip(shapes, solids, strict=True) if s.kind != "island"]
    hit = shapely.union_all(
        [g for g in shapely.get_parts(shapely.union_all(groups)) if g.intersects(ours)]
    )
    return [
        s
        for s, p in zip(solids, shapes, strict=True)
        if s.kind == "island" or not hit.intersects(p)
    ]


def _track(lane: ElementTree.Element) -> shapely.Geometry:
    """Ground that is driven on along a lane."""
    points = nets.parse_shape(lane)
    if len(points) < 2:
        return shapely.Polygon()
    half = min(nets.lane_width(lane), MAX_TRACK_M) / 2
    return shapely.LineString(points).simplify(0.05).buffer(half, cap_style="flat", quad_segs=4)


def _turning(path: Float[np.ndarray, "k 2"]) -> list[shapely.Geometry]:
    """Ground under `TURNING_BODY_M`, both ends on `path`, every half metre."""
    length, width = TURNING_BODY_M
    line = shapely.LineString(path)
    if line.length < 0.5:
        return []
    first = _normalize(path[1] - path[0])
    last = _normalize(path[-1] - path[-2])
    line = shapely.LineString([path[0] - length * first, *path, path[-1] + length * last])
    at = np.arange(0.0, line.length - length, 0.5)
    rear = shapely.get_coordinates(line.interpolate(at)).reshape(-1, 2)
    front = shapely.get_coordinates(line.interpolate(at + length)).reshape(-1, 2)
    middles = shapely.linestrings(np.stack([rear, front], axis=1))
    return list(shapely.buffer(middles, width / 2, cap_style="flat"))


def _normalize(vector: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "2"]:
    """Vector of length 1 in the same direction."""
    return vector / max(np.hypot(*vector), 1e-9)


def _open_shape(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    """Remove pieces narrower than twice `gap` (m)."""
    thick = shape.buffer(-gap, join_style="mitre", mitre_limit=2).buffer(
        gap + 0.01, join_style="mitre", mitre_limit=2
    )
    return shape.intersection(thick)


def _close_shape(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    """Fill openings narrower than twice `gap` (m)."""
    return shape.buffer(gap, join_style="mitre", mitre_limit=2).buffer(
        -gap, join_style="mitre", mitre_limit=2
    )


@dataclass(frozen=True)
class MapPiece:
    """Piece of a map file to import as a site.

    Raises FileNotFoundError for a missing file, ValueError for an empty one and for an impossible
    place.

    Attributes:
        path: map file.
        centre: in the map's coordinates (m), or longitude and latitude of OpenStreetMap.
        size: along x and y (m).
        heading: direction of x (rad counter-clockwise from the map's east).
        seed: seed of drawn surroundings, which a warning lists, for all that the map leaves open;
            None for a bare site.
        density: density of the drawn surroundings."""

    path: Path
    centre: tuple[float | int, float | int]
    size: tuple[float | int, float | int]
    heading: float = 0.0
    seed: int | None = None
    density: Furnishing = "dense"

    def __post_init__(self) -> None:
        path = self.path
        centre = self.centre
        size = self.size
        if not path.is_file():
            raise FileNotFoundError(f"no map {str(path)!r}: give an .xodr or .osm file")
        if path.stat().st_size == 0:
            raise ValueError(f"{path}: the file is empty: download the map again")
        if not (len(centre) == 2 and np.isfinite([*centre, self.heading]).all()):
            raise ValueError(
                f"centre must be two finite numbers and heading one, got {centre} and "
                f"{self.heading}"
            )
        if not (len(size) == 2 and np.isfinite(size).all() and min(size) > 0 and max(size) <= 1000):
            raise ValueError(
                f"size must be two lengths above 0 and at most 1000 m, got {size}: give --size X Y"
            )

    @property
    def area(self) -> Float64[np.ndarray, "4"]:
        """Detection area in the site's frame."""
        return np.array([-self.size[0], -self.size[1], self.size[0], self.size[1]]) / 2

    def around(self, margin: float) -> shapely.Polygon:
        """Ground up to `margin` m around the area."""
        return shapely.box(*(self.area + margin * np.array([-1, -1, 1, 1])))

    def no_road(self, nearest: tuple[float, float] | None = None, nearby: str = "") -> ValueError:
        """Error for a piece without a road.

        nearest: place on the nearest road, in the map's coordinates. nearby: what the map has here
        instead."""
        where = f"{self.centre[0]:.10g} {self.centre[1]:.10g}"
        instead = f" ({nearby})" if nearby else ""
        onto = "" if nearest is None else f", as --centre {nearest[0]:.10g} {nearest[1]:.10g}"
        return ValueError(
            f"{self.path}: no road within the area about {where}{instead}: move --centre onto a "
            f"road{onto}"
        )

    def no_carriageway(self, kinds: Sequence[str]) -> ValueError:
        """Error for a piece whose roads have no carriageway. kinds: types of their lanes."""
        listed = ", ".join(kind[:30] for kind in kinds[:12])
        where = f"{self.centre[0]:.10g} {self.centre[1]:.10g}"
        only = (
            f"the roads within the area about {where} have no carriageway, but lanes of the types "
            f"{listed}"
        )
        return ValueError(f"{self.path}: {only}: give --centre X Y on another road")


def import_opendrive(piece: MapPiece) -> Site:
    """Import a site from an OpenDRIVE file (1.4 to 1.8; docs/reference/opendrive.md lists its
    elements).

    Roads are on one plane, which slopes as they do; those more than `STOREY_GAP_M` above or below
    are left out. Traffic keeps to the side, limits and users of the map. Objects and signals become
    solids and bays, mounts are made along the kerbs. Warnings name a georeference that leads
    nowhere, what is left out or taken otherwise, and what is drawn.

    Raises ValueError in one line if the file is no OpenDRIVE map or has no road there, ImportError
    without SUMO."""
    path = piece.path
    x = float(piece.centre[0])
    y = float(piece.centre[1])
    heading = piece.heading
    with name_errors(path):
        root = opendrive.read_opendrive(path, (x, y))
        placement = opendrive.find_placement(root)
        plain = plain_map.write_plain(root)
    geo_reference = opendrive.find_projection(root, path.name)
    window = opendrive.in_map(piece.around(MAP_REACH_M), pose(x, y, yaw=heading))
    network, warned = _make_network(plain, piece)
    network = lane_shapes.align_lanes(network, plain, window)
    nearest = partial(_nearest_road, network, shapely.Point(x, y))
    level, elsewhere, is_near = _elsewhere(network, window)
    if not is_near:
        raise piece.no_road(nearest(), nearby=_describe_degrees(root, (x, y)))
    network = _cut_network(network, elsewhere, piece, lefthand=plain.lefthand)
    map_SE3_site = pose(x, y, level, yaw=heading)
    network = _in_site_frame(network, map_SE3_site)
    with name_errors(path):
        roads, other_storey = opendrive.roads_near(root, window, level, STOREY_GAP_M)
        standing_objects = opendrive.move_to_site(opendrive.read_standing(roads), map_SE3_site)
        map_lanes = [lane for road in roads for lane in opendrive.lanes(road)]
    shapes = [(lane.kind, opendrive.in_site(lane.outline, map_SE3_site)) for lane in map_lanes]
    paved = [shape for kind, shape in shapes if kind not in opendrive.UNPAVED]
    walked = [shape for kind, shape in shapes if kind in opendrive.FOOTWAY]
    if not paved:
        kinds = sorted({lane.kind for lane in map_lanes})
        raise piece.no_carriageway(kinds) if kinds else piece.no_road(nearest())
    reach = piece.around(SURROUNDINGS_M)
    tracks = find_tracks(network)
    lanes, footways = whole_road(paved, walked, tracks, reach, fillings=junction_corners(network))
    if not nets.unite(lanes).intersects(shapely.box(*piece.area)):
        raise piece.no_road(nearest())
    for lane in map_lanes:
        if lane.kind == "parking" and lane.width >= 1.8:
            middle = opendrive.in_site(shapely.LineString(lane.middle), map_SE3_site)
            standing_objects.bays.extend(bays_along(shapely.get_coordinates(middle)))
    solids, notes = opendrive.off_the_road(standing_objects, reach, lanes, tracks)
    area = opendrive.in_map(piece.around(0.0), map_SE3_site)
    slope, deviation, steepest = opendrive.find_plane(roads, area, map_SE3_site)
    rise = float(np.hypot(*slope))
    relief = Relief()
    if steepest > MIN_SLOPE and MIN_SLOPE < rise <= STEEPEST:
        relief = Relief(slope=(round(slope[0], 5), round(slope[1], 5)))
        percent = f"{100 * rise:.1f} %"
        notes.append(
            f"the site slopes by {percent} as its roads do, which leave that plane by up to "
            f"{deviation:.2f} m"
        )
    elif steepest > MIN_SLOPE:
        notes.append(
            f"the steepest road in the area rises by {100 * steepest:.1f} %; the site is level"
        )
    parking = free_bays(standing_objects.bays, reach, solids, tracks)
    if other_storey:
        notes.append(
            f"{other_storey} roads more than {STOREY_GAP_M:g} m above or below the site were left "
            "out"
        )
    notes += [
        *opendrive.describe_turn(root),
        *opendrive.describe_widths(map_lanes),
        *plain_map.describe_problems(plain, roads),
        *_describe_warnings(warned, network),
    ]
    projection_SE3_site = placement @ map_SE3_site
    make = partial(
        Site, path.stem, piece.area, map_SE3_site=projection_SE3_site, geo_reference=geo_reference
    )
    site = make(lanes=lanes, footways=footways, parking=parking, network=network, relief=relief)
    lamps = np.array(standing_objects.lamps).reshape(-1, 2)
    return _finish(site, piece, solids, lamps=lamps, notes=notes)


def _describe_degrees(root: ElementTree.Element, centre: tuple[float, float]) -> str:
    """Hint for a centre that is a place on an OpenDRIVE map if it is read as degrees, else ""."""
    inside = opendrive.locate_degrees(root, centre)
    if inside is None:
        return ""
    return f"if these are degrees, in the file it is --centre {inside[0]:.10g} {inside[1]:.10g}"


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
    path = piece.path
    centre = (float(piece.centre[0]), float(piece.centre[1]))
    heading = piece.heading
    extract = osm.read_map(path, centre, heading)
    within = piece.around(MAP_REACH_M)
    lefthand, side_notes = osm.choose_side(extract, within, lefthand)
    pieces, notes = osm.roads(extract, within, lefthand=lefthand)
    notes = [*extract.notes, *side_notes, *notes]
    if not pieces:
        raise piece.no_road(nearby=osm.describe_roadless(extract, within))
    parking = osm.find_parking(extract, osm_rules.ROADS, within, lefthand=lefthand)
    map_SE3_site = pose(yaw=heading)
    on_earth = projection(*centre)
    network, warned = _make_osm_network(pieces, extract, piece, parking)
    notes += warned
    window = piece.around(SURROUNDINGS_M)
    lanes, footways = nets.road_polygons(network, piece.area)
    paved = nets.unite(lanes)
    street = nets.unite([*lanes, *footways])
    solids, cut = osm.buildings(extract, window, street.buffer(0.1))
    houses = nets.unite(solid.footprint for solid in solids)
    squares = [
        square.difference(street).difference(houses) for square in osm.paths(extract, window)
    ]
    no_solids = street.union(houses)
    solids += osm.barriers(extract, window, no_solids) + osm.trees(extract, window, no_solids)
    posts, lamps = osm.furniture(extract, window, paved.union(houses))
    walked_polygons = footways + nets.cut_polygons(squares, window)
    walked = [shapely.Polygon(polygon).difference(paved) for polygon in walked_polygons]
    tracks = find_tracks(network)
    lanes, footways = whole_road([shapely.Polygon(p) for p in lanes], walked, tracks, window)
    solids += posts
    occupied = nets.unite(solid.footprint for solid in solids).union(nets.unite(lanes)).buffer(0.2)
    bays = np.array(osm.bays(extract, window, occupied), np.float64).reshape(-1, 3)
    at_kerbs = free_bays(osm.find_strip_bays(network, parking), window, solids, tracks)
    bays = np.concatenate([bays, at_kerbs])
    name = path.name.partition(".")[0]
    make_site = partial(Site, name, piece.area, map_SE3_site=map_SE3_site, geo_reference=on_earth)
    site = make_site(lanes=lanes, footways=footways, parking=bays, network=network)
    if not nets.unite(lanes).intersects(shapely.box(*site.area)):
        raise piece.no_road(nearby=osm.describe_roadless(extract, piece.around(0.0)))
    return _finish(site, piece, solids, lamps=lamps, notes=[*notes, *cut])


def _make_osm_network(
    pieces: Sequence[osm.Way], extract: osm.Extract, piece: MapPiece, parking: osm.Parking
) -> tuple[str, list[str]]:
    """Network of the roads of an OpenStreetMap file, in the site's frame, and notes.

    netconvert reads the roads and writes them as plain edges. If the two directions of a road have
    different rules, or vehicles park along a kerb, these are changed and read again."""
    map_SE3_site = pose(yaw=piece.heading)
    driving = ["--lefthand"] if parking.lefthand else []
    types = osm_rules.name_types(cast("osm_rules.RoadRules", way.rules) for way in pieces)
    second_options = ["--output.street-names", "--no-warnings", *driving]
    with tempfile.TemporaryDirectory() as folder:
        streets = Path(folder, "roads.osm")
        type_file = Path(folder, "types.xml")
        streets.write_text(osm.write_osm(pieces, extract), "utf-8")
        type_file.write_text(osm_rules.format_types(types), "utf-8")
        options = [
            f"--osm-files={streets}",
            f"--type-files={type_file}",
            f"--proj={projection(*extract.centre)}",
        ]
        options += [*_OSM_OPTIONS, *driving, f"--plain-output-prefix={Path(folder, 'plain')}"]
        with name_errors(piece.path):
            network, warned = nets.convert_with_warnings(options)
        if "<edge " not in network:
            raise piece.no_road(nearby=osm.describe_roadless(extract, piece.around(MAP_REACH_M)))
        notes = describe_warnings(warned)
        network = _in_site_frame(network, map_SE3_site)
        strips = osm.find_parking_strips(network, parking) if parking else {}
        if any(rules.number is not None for rules in types):
            osm.restrict_network(Path(folder), types)
            restricted = nets.convert([*osm.widen_network(Path(folder), {}), *second_options])
            network = _in_site_frame(restricted, map_SE3_site)
        if strips:
            try:
                widened = nets.convert([*osm.widen_network(Path(folder), strips), *second_options])
                network = _in_site_frame(widened, map_SE3_site)
            except ValueError as error:
                notes.append(f"parking along the kerbs was left out ({error})")
    return _ESCAPED_TWICE.sub(r"&\1;", network), notes


def _finish(
    site: Site, piece: MapPiece, solids: Sequence[Solid], *, lamps: np.ndarray, notes: Sequence[str]
) -> Site:
    """Add kerbs and mounts to a site, and furnish it if a seed is given."""
    if not nets.unite(site.lanes).intersects(shapely.box(*site.area)):
        raise piece.no_road()
    road = surroundings.Road((), (), site.lanes, site.footways)
    walls = nets.unite(s.footprint for s in solids if s.top > 2.0).buffer(0.3)
    bays = [surroundings.outline(bay, MAP_BAY_SIZE_M) for bay in site.parking]
    walls = walls.union(shapely.union_all(bays).buffer(0.3))
    mounts: list[Mount] = []
    near = shapely.box(*site.area).buffer(10.0)
    occupied = walls.buffer(-0.3)
    for lamp in lamps:  # on brackets over the road
        spot = shapely.Point(lamp)
        towards = shapely.get_coordinates(shapely.shortest_line(spot, road.carriageway))[1] - lamp
        bracket_end = lamp + BRACKET_M * towards / (np.hypot(*towards) + 1e-9)
        if near.contains(spot) and not occupied.intersects(shapely.Point(bracket_end)):
            mounts.append(
                Mount(f"lamp{len(mounts):02}", np.array([*bracket_end.round(3), 0.0]), 3.0, 8.0)
            )
    if len(mounts) < 6:
        drawn = surroundings.place_mounts(
            road, site.area, np.random.default_rng(0), spacing=12.0, avoid=walls
        )
        near = shapely.MultiPoint(lamps).buffer(2.0)
        drawn = tuple(m for m in drawn if not near.intersects(shapely.Point(m.position[:2])))
        mounts += [replace(m, price=1.0, origin="drawn") for m in drawn]
    stones = kerbstones(site.lanes, site.footways, find_turns(site.network))
    if piece.seed is None:
        feet = [m.position[:2].tolist() for m in mounts if m.origin == "drawn"]
        poles = [f.post(x, y, surroundings.POLE_HEIGHT_M) for x, y in feet]
        poles = surroundings.mark_drawn(poles)
        finished = replace(
            site,
            solids=f.settle([*solids, *poles, *stones], site.relief),
            mounts=f.on_ground(mounts, site),
        )
    else:
        finished, note = furnish_site(site, mounts, [*solids, *stones], piece.seed, piece.density)
        notes = [*notes, note]
    for note in [*notes, *_doubt_place(site)]:
        warnings.warn(f"{piece.path.name}: {note}", stacklevel=3)
    return finished


def _doubt_place(site: Site) -> list[str]:
    """Notes of what is uncertain about a site's place on earth, and its scale."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # it repeats a note of this module
            doubts = [doubt_place(site.geo_reference), doubt_scale(site)]
    except ValueError as error:
        return [f"its place on earth cannot be used: {error}"]
    return [doubt for doubt in doubts if doubt is not None]


def _convert(options: Sequence[str], piece: MapPiece) -> tuple[str, list[str]]:
    """Network with a road in it, and netconvert's warnings."""
    with name_errors(piece.path):
        network, warned = nets.convert_with_warnings(options)
    if "<edge " not in network:
        raise piece.no_road()
    return network, warned


def _describe_warnings(warned: Sequence[str], network: str) -> list[str]:
    """Notes of netconvert's warnings that concern roads and junctions of a network."""
    if not warned:
        return []
    root = ElementTree.fromstring(network)
    names = {element.get("id", "") for element in root.iter("edge")}
    names |= {element.get("id", "") for element in root.iter("junction")}
    names |= {name.strip("-").partition("#")[0] for name in names}
    return describe_warnings(
        warning for warning in warned if not names.isdisjoint(re.findall(r"'([^']*)'", warning))
    )


def _make_network(plain: plain_map.PlainMap, piece: MapPiece) -> tuple[str, list[str]]:
    """Network of a whole map, in its coordinates, and netconvert's warnings."""
    with tempfile.TemporaryDirectory() as folder:
        types = Path(folder, "types.xml")
        roads = Path(folder, "plain.xodr")
        types.write_text(
            nets.format_xml("types", (nets.format_element("type", row) for row in plain.types)),
            "utf-8",
        )
        roads.write_text(plain.text, "utf-8")
        options = [f"--opendrive-files={roads}", f"--type-files={types}", *_OPENDRIVE_OPTIONS]
        if plain.lefthand:
            options.append("--lefthand")
        return _convert(options, piece)


def _cut_network(network: str, edges: Sequence[str], piece: MapPiece, *, lefthand: bool) -> str:
    """Network without some edges, and with crossings.

    netconvert cuts networks, but not OpenDRIVE maps."""
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
        return _convert(options, piece)[0]


def _nearest_road(network: str, point: shapely.Point) -> tuple[float, float] | None:
    """Place on the nearest lane of a network that vehicles use, to 0.1 m."""
    users = ((lane, nets.list_users(lane)) for _, lane in nets.list_lanes(network))
    lines = [
        shapely.LineString(nets.parse_shape(lane))
        for lane, allowed in users
        if "passenger" in allowed
    ]
    if not lines:
        return None
    nearest = shapely.MultiLineString(lines)
    x, y = shapely.get_coordinates(shapely.shortest_line(nearest, point))[0].round(1).tolist()
    return x, y


def _elsewhere(network: str, window: shapely.Polygon) -> tuple[float, list[str], bool]:
    """Height of the nearest road, edges to remove, and True if any edge is left.

    Edges to remove are outside `window`, or on another storey than the road nearest to its
    middle."""
    lines: dict[str, list[shapely.LineString]] = {}
    nearest = np.inf
    level = 0.0
    for edge, lane in nets.list_lanes(network):
        line = shapely.LineString(_parse_heights(lane))
        lines.setdefault(edge.get("id", ""), []).append(line)
        distance = line.distance(window.centroid)
        if distance < nearest:
            nearest = distance
            level = line.interpolate(line.project(window.centroid)).z
    far = [
        name
        for name, parts in lines.items()
        if not opendrive.is_on_level(parts, window, level, STOREY_GAP_M)
    ]
    return round(level, 3), far, len(far) < len(lines)


def _parse_heights(lane: ElementTree.Element) -> list[list[float]]:
    """Points x, y, z of a lane's shape; z is 0 without heights."""
    points = [list(map(float, point.split(","))) for point in lane.get("shape", "").split()]
    return [[*point, 0.0][:3] for point in points]


def _in_site_frame(network: str, map_SE3_site: Pose) -> str:
    """Turn a net.xml text from the map's coordinates into the site's, without heights."""
    x, y = map_SE3_site[:2, 3]
    turn = map_SE3_site[:2, :2]
    root = ElementTree.fromstring(network)
    for element in root.iter():
        if "shape" in element.attrib:
            moved = (nets.parse_shape(element) - [x, y]) @ turn
            closed = element.tag == "junction" or "_w" in element.get("id", "").partition(":")[2]
            moved = _repair(moved) if closed and len(moved) > 2 else moved
            element.set("shape", " ".join(f"{a:.3f},{b:.3f}" for a, b in moved))
        if element.tag == "junction":
            place = np.array([float(element.get("x", 0)), float(element.get("y", 0))])
            a, b = (place - [x, y]) @ turn
            element.attrib |= {"x": f"{a:.3f}", "y": f"{b:.3f}"}
            element.attrib.pop("z", None)
        if element.tag == "location":
            element.set("netOffset", f"{-x:.3f},{-y:.3f}")
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _repair(ring: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "_ 2"]:
    """Largest part of an outline that crosses itself. If it has no area, it becomes a strip."""
    shape = shapely.Polygon(ring.round(3))
    if shape.is_valid:
        return ring
    valid = shapely.set_precision(shapely.make_valid(shape), 1e-3)
    polygons = [polygon for polygon in nets.list_polygons(valid) if polygon.area > 0]
    strip = (
        shapely.LineString(ring).buffer(0.05, cap_style="square", join_style="mitre").convex_hull
    )
    return shapely.get_coordinates(max(polygons, key=shapely.area, default=strip).exterior)[:-1]
