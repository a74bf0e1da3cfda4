"""Sites from pieces of OpenDRIVE or OpenStreetMap files.

SUMO's netconvert makes their roads. The site frame is centred at the given place, x along
`heading`; `map_SE3_site` leads back to the map's coordinates: those of the OpenDRIVE file's
projection, which its header's offset leads to, or metres of a transverse Mercator map of WGS84
(`geo_reference`) about the centre. The site has no sensors yet; mounts on lamp posts are real,
mounts along the kerbs are suggestions, all at the price of one. Where the map is silent,
surroundings are drawn from a seed."""

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
from toolkit.runtime.files import name_errors
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

CRACK = 0.3  # m, half the width of cracks between polygons of a map that are closed
STUB = (
    1.2  # m, half the width of a slot in the carriageway that is a fault of the network's corners
)
OUTLINE_GRID = 1e-3  # m, grid of outlines
SLIVER = 0.2  # m, half the width of the thinnest footway that is kept
THINNEST_ROAD = 0.5  # m, half the width of the thinnest carriageway that is kept
ISLET = (
    20.0  # m², of a footway in the middle of a carriageway that is a fault of the network's corners
)
KERB = (0.15, 0.12)  # m, width and height of kerbstones
WIDEST = 3.5  # m, of the track a vehicle follows over a junction
MAP_BAY = (5.8, 2.3)  # m, length and width of a bay without a size in the map
CORNER_CUT = 1.2  # m beside the track of a vehicle that turns, where kerbs are lowered
BODY = (5.5, 2.6)  # m, length and width of a vehicle that turns, with room beside it
ROUGHEST = 0.12  # m, of the ground's unevenness that is drawn, as in random sites


def find_tracks(network: str) -> shapely.Geometry:
    """Tracks of motor vehicles in a net.xml text. Over junctions with the room that both ends of a
    vehicle need."""
    tracks = []
    for edge, lane in nets.list_lanes(network, "normal", "internal"):
        if "passenger" in nets.list_users(lane):
            tracks.append(_track(lane))
            tracks += _turning(nets.parse_shape(lane)) if edge.get("function") == "internal" else []
    return shapely.union_all(tracks)


def find_turns(network: str) -> shapely.Geometry:
    """Ground within `CORNER_CUT` of bent tracks over junctions."""
    bent = []
    for _, lane in nets.list_lanes(network, "internal"):
        if "passenger" in nets.list_users(lane):
            line = shapely.LineString(points := nets.parse_shape(lane))
            if line.hausdorff_distance(shapely.LineString(points[[0, -1]])) > 0.3:
                bent += [_track(lane), *_turning(points)]
    return shapely.union_all(bent).buffer(CORNER_CUT)


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
    """Lanes and footways within `window` without cracks, stubs and slivers. Driven ground is
    carriageway, and a footway begins where the carriageway ends. fillings: carriageway and footway
    where the map is silent of both."""
    around = window.buffer(2 * STUB)
    paved = shapely.union_all([*lanes, tracks]).intersection(around)
    walk = shapely.union_all(list(footways)).intersection(around)
    paved = paved.union(fillings[0].intersection(around).difference(walk))
    closed = _open_shape(_close_shape(paved, CRACK), THINNEST_ROAD)
    walk = _close_shape(walk.union(fillings[1].intersection(around)), CRACK)
    stubs = _close_shape(closed, STUB).difference(closed).intersection(walk)
    walk = _open_shape(walk.difference(closed.union(stubs)), SLIVER)
    border = closed.buffer(0.1)
    small = [part for part in shapely.get_parts(walk) if part.area < ISLET]
    islets = [s for s in small if s.boundary.intersection(border).length > 0.85 * s.boundary.length]
    carriageway = shapely.union_all([closed, stubs, *islets])
    # off the grid an overlay may lose a whole lane
    carriageway = shapely.set_precision(carriageway, OUTLINE_GRID)
    if carriageway.geom_type == "GeometryCollection":  # whose overlays are slow
        carriageway = shapely.union_all(nets.list_polygons(carriageway))
    between = _open_shape(carriageway.difference(shapely.union_all(list(lanes))), 0.01)
    near = [lane for lane in lanes if lane.intersects(window)]
    pieces = nets.cut_polygons(
        [lane.intersection(carriageway) for lane in near] + [between], window
    )
    carriageway = nets.unite(pieces)
    walk = _open_shape(walk.difference(carriageway), SLIVER).difference(carriageway)
    return pieces, nets.cut_polygons([walk], window)


def kerbstones(
    lanes: nets.Polygons, footways: nets.Polygons, lowered: shapely.Geometry
) -> list[Solid]:
    """Kerbstones between lanes and footways, none on ground where they are `lowered`, as at corners
    vehicles cut."""
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
    return f.set_kerbs(edge, carriageway, KERB)


def legs(network: str) -> tuple[list[Float64[np.ndarray, "_ 2"]], list[tuple[float, float]]]:
    """Paths of the network's streets within 100 m of the site's middle, with half their widths left
    and right (m).

    A path runs along the lane nearest to the middle of the street, one for each direction, and
    straight on for 130 m where its edge ends, since houses are drawn along 90 m."""
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
        for part in shapely.get_parts(line):
            if part.geom_type == "LineString" and part.length > 10.0:
                width = round(sum(map(nets.lane_width, lanes)) - nets.lane_width(lanes[-1]) / 2, 3)
                path = shapely.get_coordinates(part)
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
    """Furnish a site around the map's own `solids`; return a note of what was drawn too. Mounts
    stand on posts of their own, except for those on the map's lamp posts. Raises ValueError for a
    negative seed."""
    if seed < 0:
        raise ValueError(f"seed must be a whole number from 0 up, got {seed}")
    rng = np.random.default_rng(seed)
    relief = replace(
        site.relief,
        amplitude=round(float(rng.uniform(0.0, ROUGHEST)), 3),
        seed=int(rng.integers(2**31)),
    )
    site = replace(site, relief=relief, furnished=density)
    site = _furnish(
        replace(site, solids=f.settle(solids, relief), mounts=f.on_ground(mounts, site)), rng
    )
    counted = {
        kind: n for kind, n in surroundings.count_things(site)["drawn"].items() if kind != "pole"
    }
    said = f"drawn from seed {seed}, in no map: {surroundings.describe_things(counted)}"
    return site, f"{said}, ground within {relief.amplitude} m"


def redraw(site: Site, seed: int) -> Site:
    """Draw again, from another seed, what an import drew; the map's things, the ground and all
    mounts stay. Raises ValueError for a site that no import furnished."""
    if site.furnished == "none":
        raise ValueError(
            f"site {site.name!r} has no furnishing to draw again: coview site import draws one"
        )
    kept = tuple(solid for solid in site.solids if solid.origin != "drawn")
    mapped = np.array([origin != "drawn" for origin in site.bay_origins], bool)
    origins = tuple(origin for origin in site.bay_origins if origin != "drawn")
    bare = replace(site, solids=kept, parking=site.parking[mapped], parking_origins=origins)
    return _furnish(bare, np.random.default_rng(seed))


def _furnish(site: Site, rng: Rng) -> Site:
    """Add drawn solids and bays to a site with its mounts and the map's solids."""
    mounts = site.mounts
    solids = site.solids
    road = surroundings.Road(*legs(site.network), site.lanes, site.footways)
    drawn, bays = surroundings.furnish(
        road, site.area, mounts, rng, light=site.furnished == "light"
    )
    ours = [shapely.Point(m.position[:2]).buffer(0.5) for m in mounts if m.origin != "drawn"]
    ours += [shapely.Polygon(s.footprint) for s in solids if s.kind not in ("kerb", "island")]
    ours += [surroundings.outline(bay, MAP_BAY) for bay in site.parking]
    kept = _keep_apart([s for s in drawn if s.kind != "kerb"], shapely.union_all(ours).buffer(0.2))
    taken = shapely.union_all(
        [*ours, *(shapely.Polygon(s.footprint) for s in solids if s.kind == "kerb")]
    )
    free = [bay for bay in bays if not taken.intersects(surroundings.outline(bay, MAP_BAY))]
    origins = (*site.bay_origins, *(("drawn",) * len(free)))
    solids = (*solids, *f.settle(surroundings.mark_drawn(kept), site.relief))
    parking = np.concatenate([site.parking, np.reshape(free, (-1, 3))])
    return replace(site, solids=solids, parking=parking, parking_origins=origins)


def free_bays(
    bays: Sequence[surroundings.Bay],
    window: shapely.Geometry,
    solids: Sequence[Solid],
    tracks: shapely.Geometry,
) -> Float64[np.ndarray, "n 3"]:
    """Bays (x, y, yaw) in `window` without solids and traffic."""
    standing = nets.unite(s.footprint for s in solids if s.kind not in ("island", "kerb"))
    tracks = tracks.buffer(-0.3)
    ground = [(bay, surroundings.outline(bay, MAP_BAY)) for bay in bays]
    ground = [
        (bay, shape)
        for bay, shape in ground
        if window.contains(shape) and not standing.intersects(shape)
    ]
    # corners of slanted bays
    free = [bay for bay, shape in ground if not tracks.intersects(shape.buffer(-0.25))]
    return np.array(free, np.float64).reshape(-1, 3).round(4)


def bays_along(middle: Float[np.ndarray, "k 2"]) -> list[surroundings.Bay]:
    """Bays x, y, yaw along a parking lane's middle, every 6.4 m."""
    line = shapely.LineString(middle)
    rows = surroundings.place_along(line, np.arange(3.2, line.length - 3.2, 6.4), 0.5).tolist()
    return [(x, y, yaw) for x, y, yaw in rows]


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
    if len(points := nets.parse_shape(lane)) < 2:
        return shapely.Polygon()
    half = min(nets.lane_width(lane), WIDEST) / 2
    return shapely.LineString(points).simplify(0.05).buffer(half, cap_style="flat", quad_segs=4)


def _turning(path: Float[np.ndarray, "k 2"]) -> list[shapely.Geometry]:
    """Ground under `BODY`, both ends on `path`, every half metre."""
    length, width = BODY
    line = shapely.LineString(path)
    if line.length < 0.5:
        return []
    first, last = (d / max(np.hypot(*d), 1e-9) for d in (path[1] - path[0], path[-1] - path[-2]))
    line = shapely.LineString([path[0] - length * first, *path, path[-1] + length * last])
    at = np.arange(0.0, line.length - length, 0.5)
    rear, front = (
        shapely.get_coordinates(line.interpolate(s)).reshape(-1, 2) for s in (at, at + length)
    )
    return list(
        shapely.buffer(
            shapely.linestrings(np.stack([rear, front], axis=1)), width / 2, cap_style="flat"
        )
    )


def _open_shape(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    """Remove what is narrower than twice `gap` (m)."""
    thick = shape.buffer(-gap, join_style="mitre", mitre_limit=2).buffer(
        gap + 0.01, join_style="mitre", mitre_limit=2
    )
    return shape.intersection(thick)


def _close_shape(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    return shape.buffer(gap, join_style="mitre", mitre_limit=2).buffer(
        -gap, join_style="mitre", mitre_limit=2
    )


REACH = 80.0  # m of road kept around the area, for traffic to enter
SURROUNDINGS = 30.0  # m around the area where buildings and furniture are kept
LEAST_SLOPE = 0.005  # m per m; flatter ground counts as level
SAME_LEVEL = 3.5  # m; a road higher or lower than that is another storey, and left out
BRACKET = 0.45  # m from a lamp post's axis to the sensor it carries

_OPENDRIVE_OPTIONS = (
    "--opendrive.import-all-lanes",
    "--opendrive.curve-resolution=1",
    "--junctions.endpoint-shape",
)
_CROSSINGS = ("--crossings.guess", "--crossings.guess.speed-threshold=100")  # whatever the limit is
_OSM_OPTIONS = (
    *(
        "--osm.sidewalks",
        "--crossings.guess",
        "--geometry.remove",
        "--roundabouts.guess",
        "--junctions.join",
    ),
    *("--tls.guess-signals", "--tls.discard-simple", "--tls.join", "--output.street-names"),
)
# as netconvert writes the names of OpenStreetMap's streets
_ESCAPED_TWICE = re.compile(r"&amp;(amp|lt|gt|quot|apos);")


@dataclass(frozen=True)
class MapPiece:
    """Piece of a map file to import as a site.

    centre: in the map's coordinates (m), or longitude and latitude of OpenStreetMap; size: along x
    and y (m); heading: of x (rad counter-clockwise from the map's east); seed: draws what the map
    is silent of, which a warning lists, None leaves it bare; density: how much is drawn.

    Raises FileNotFoundError for a missing file, ValueError for an empty one and for an impossible
    place."""

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

    Roads lie on one plane, which slopes as they do; those more than SAME_LEVEL m above or below are
    left out. Traffic keeps to the side, limits and users of the map. Objects and signals become
    solids and bays, mounts are made along the kerbs. Warnings name a georeference that leads
    nowhere, what is left out or taken otherwise, and what is drawn.

    Raises ValueError in one line if the file is no OpenDRIVE map or has no road there, ImportError
    without SUMO."""
    path, (x, y), heading = piece.path, map(float, piece.centre), piece.heading
    with name_errors(path):
        root = opendrive.read_opendrive(path, (x, y))
        placement = opendrive.find_placement(root)
        plain = plain_map.write_plain(root)
    geo_reference = opendrive.find_projection(root, path.name)
    window = opendrive.in_map(piece.around(REACH), pose(x, y, yaw=heading))
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
        roads, others = opendrive.roads_near(root, window, level, SAME_LEVEL)
        there = opendrive.move_to_site(opendrive.read_standing(roads), map_SE3_site)
        found = [lane for road in roads for lane in opendrive.lanes(road)]
    shapes = [(lane.kind, opendrive.in_site(lane.outline, map_SE3_site)) for lane in found]
    paved = [shape for kind, shape in shapes if kind not in opendrive.UNPAVED]
    walked = [shape for kind, shape in shapes if kind in opendrive.FOOTWAY]
    if not paved:
        kinds = sorted({lane.kind for lane in found})
        raise piece.no_carriageway(kinds) if kinds else piece.no_road(nearest())
    reach = piece.around(SURROUNDINGS)
    tracks = find_tracks(network)
    lanes, footways = whole_road(paved, walked, tracks, reach, fillings=junction_corners(network))
    if not nets.unite(lanes).intersects(shapely.box(*piece.area)):
        raise piece.no_road(nearest())
    for lane in found:
        if lane.kind == "parking" and lane.width >= 1.8:
            middle = opendrive.in_site(shapely.LineString(lane.middle), map_SE3_site)
            there.bays.extend(bays_along(shapely.get_coordinates(middle)))
    solids, notes = opendrive.off_the_road(there, reach, lanes, tracks)
    area = opendrive.in_map(piece.around(0.0), map_SE3_site)
    slope, off, steepest = opendrive.find_plane(roads, area, map_SE3_site)
    rise = float(np.hypot(*slope))
    relief = Relief()
    if steepest > LEAST_SLOPE and LEAST_SLOPE < rise <= STEEPEST:
        relief = Relief(slope=(round(slope[0], 5), round(slope[1], 5)))
        percent = f"{100 * rise:.1f} %"
        notes.append(
            f"the site slopes by {percent} as its roads do, which leave that plane by up to "
            f"{off:.2f} m"
        )
    elif steepest > LEAST_SLOPE:
        notes.append(
            f"the steepest road in the area rises by {100 * steepest:.1f} %; the site is level"
        )
    parking = free_bays(there.bays, reach, solids, tracks)
    if others:
        notes.append(
            f"{others} roads more than {SAME_LEVEL:g} m above or below the site were left out"
        )
    notes += [
        *opendrive.describe_turn(root),
        *opendrive.describe_widths(found),
        *plain_map.describe_problems(plain, roads),
        *_describe_warnings(warned, network),
    ]
    placed = placement @ map_SE3_site
    make = partial(Site, path.stem, piece.area, map_SE3_site=placed, geo_reference=geo_reference)
    site = make(lanes=lanes, footways=footways, parking=parking, network=network, relief=relief)
    lamps = np.array(there.lamps).reshape(-1, 2)
    return _finish(site, piece, solids, lamps=lamps, notes=notes)


def _describe_degrees(root: ElementTree.Element, centre: tuple[float, float]) -> str:
    """Hint for a centre that is a place on an OpenDRIVE map if it is read as degrees; empty if it
    is none."""
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
    place = (float(piece.centre[0]), float(piece.centre[1]))
    heading = piece.heading
    extract = osm.read_map(path, place, heading)
    within = piece.around(REACH)
    lefthand, side_notes = osm.choose_side(extract, within, lefthand)
    pieces, notes = osm.roads(extract, within, lefthand=lefthand)
    notes = [*extract.notes, *side_notes, *notes]
    if not pieces:
        raise piece.no_road(nearby=osm.describe_roadless(extract, within))
    parking = osm.find_parking(extract, osm_rules.ROADS, within, lefthand=lefthand)
    map_SE3_site = pose(yaw=heading)
    on_earth = projection(*place)
    network, warned = _make_osm_network(pieces, extract, piece, parking)
    notes += warned
    window = piece.around(SURROUNDINGS)
    lanes, footways = nets.road_polygons(network, piece.area)
    paved = nets.unite(lanes)
    street = nets.unite([*lanes, *footways])
    solids, cut = osm.buildings(extract, window, street.buffer(0.1))
    houses = nets.unite(solid.footprint for solid in solids)
    squares = [each.difference(street).difference(houses) for each in osm.paths(extract, window)]
    beside = street.union(houses)
    solids += osm.barriers(extract, window, beside) + osm.trees(extract, window, beside)
    posts, lamps = osm.furniture(extract, window, paved.union(houses))
    walked = [
        shapely.Polygon(p).difference(paved)
        for p in (*footways, *nets.cut_polygons(squares, window))
    ]
    tracks = find_tracks(network)
    lanes, footways = whole_road([shapely.Polygon(p) for p in lanes], walked, tracks, window)
    solids += posts
    taken = nets.unite(solid.footprint for solid in solids).union(nets.unite(lanes)).buffer(0.2)
    bays = np.array(osm.bays(extract, window, taken), np.float64).reshape(-1, 3)
    at_kerbs = free_bays(osm.find_strip_bays(network, parking), window, solids, tracks)
    bays = np.concatenate([bays, at_kerbs])
    name = path.name.partition(".")[0]
    make = partial(Site, name, piece.area, map_SE3_site=map_SE3_site, geo_reference=on_earth)
    site = make(lanes=lanes, footways=footways, parking=bays, network=network)
    if not nets.unite(lanes).intersects(shapely.box(*site.area)):
        raise piece.no_road(nearby=osm.describe_roadless(extract, piece.around(0.0)))
    return _finish(site, piece, solids, lamps=lamps, notes=[*notes, *cut])


def _make_osm_network(
    pieces: Sequence[osm.Way], extract: osm.Extract, piece: MapPiece, parking: osm.Parking
) -> tuple[str, list[str]]:
    """Network of the roads of an OpenStreetMap file, in the site's frame, and notes.

    netconvert reads the roads and writes them as plain edges. Where the two directions of a road
    have rules of their own, or vehicles park along a kerb, these are changed and read again."""
    map_SE3_site = pose(yaw=piece.heading)
    driving = ["--lefthand"] if parking.lefthand else []
    types = osm_rules.name_types(cast("osm_rules.RoadRules", way.rules) for way in pieces)
    again = ["--output.street-names", "--no-warnings", *driving]
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
            raise piece.no_road(nearby=osm.describe_roadless(extract, piece.around(REACH)))
        notes = describe_warnings(warned)
        network = _in_site_frame(network, map_SE3_site)
        strips = osm.find_parking_strips(network, parking) if parking else {}
        if any(rules.number is not None for rules in types):
            osm.restrict_network(Path(folder), types)
            network = _in_site_frame(
                nets.convert([*osm.widen_network(Path(folder), {}), *again]), map_SE3_site
            )
        if strips:
            try:
                wide = nets.convert([*osm.widen_network(Path(folder), strips), *again])
                network = _in_site_frame(wide, map_SE3_site)
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
    walls = walls.union(
        shapely.union_all([surroundings.outline(bay, MAP_BAY) for bay in site.parking]).buffer(0.3)
    )
    mounts: list[Mount] = []
    near = shapely.box(*site.area).buffer(10.0)
    occupied = walls.buffer(-0.3)
    for lamp in lamps:  # on brackets over the road
        spot = shapely.Point(lamp)
        towards = shapely.get_coordinates(shapely.shortest_line(spot, road.carriageway))[1] - lamp
        place = lamp + BRACKET * towards / (np.hypot(*towards) + 1e-9)
        if near.contains(spot) and not occupied.intersects(shapely.Point(place)):
            mounts.append(
                Mount(f"lamp{len(mounts):02}", np.array([*place.round(3), 0.0]), 3.0, 8.0)
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
        feet = [m.position.tolist() for m in mounts if m.origin == "drawn"]
        poles = surroundings.mark_drawn([f.post(x, y, surroundings.POLE) for x, y, _ in feet])
        made = replace(
            site,
            solids=f.settle([*solids, *poles, *stones], site.relief),
            mounts=f.on_ground(mounts, site),
        )
    else:
        made, note = furnish_site(site, mounts, [*solids, *stones], piece.seed, piece.density)
        notes = [*notes, note]
    for note in [*notes, *_doubt_place(site)]:
        warnings.warn(f"{piece.path.name}: {note}", stacklevel=3)
    return made


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
    with name_errors(piece.path):
        network, warned = nets.convert_with_warnings(options)
    if "<edge " not in network:
        raise piece.no_road()
    return network, warned


def _describe_warnings(warned: Sequence[str], network: str) -> list[str]:
    """Notes of what netconvert warns of on roads and junctions of a network."""
    if not warned:
        return []
    root = ElementTree.fromstring(network)
    names = {element.get("id", "") for kind in ("edge", "junction") for element in root.iter(kind)}
    names |= {name.strip("-").partition("#")[0] for name in names}
    return describe_warnings(
        warning
        for warning in warned
        if any(name in names for name in re.findall(r"'([^']*)'", warning))
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
        return _convert([*options, *(["--lefthand"] if plain.lefthand else [])], piece)


def _cut_network(network: str, edges: Sequence[str], piece: MapPiece, *, lefthand: bool) -> str:
    """Network without some edges, and with crossings; netconvert cuts networks, but not OpenDRIVE
    maps."""
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder, "net.xml")
        cut = Path(folder, "edges.txt")
        whole.write_text(network, "utf-8")
        cut.write_text("".join(f"edge:{edge}\n" for edge in edges), "utf-8")
        options = [
            f"--sumo-net-file={whole}",
            f"--remove-edges.input-file={cut}",
            *_CROSSINGS,
            "--no-warnings",
        ]
        options += ["--junctions.endpoint-shape", *(["--lefthand"] if lefthand else [])]
        return _convert(options, piece)[0]


def _nearest_road(network: str, place: shapely.Point) -> tuple[float, float] | None:
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
    x, y = shapely.get_coordinates(shapely.shortest_line(nearest, place))[0].round(1).tolist()
    return x, y


def _elsewhere(network: str, window: shapely.Polygon) -> tuple[float, list[str], bool]:
    """Height of the nearest road, edges to remove, and True if any edge is left. Edges to remove
    lie outside `window`, or on another storey than the road nearest to its middle."""
    lines: dict[str, list[shapely.LineString]] = {}
    nearest = np.inf
    level = 0.0
    for edge, lane in nets.list_lanes(network):
        points = [(*map(float, p.split(",")), 0.0)[:3] for p in lane.get("shape", "").split()]
        line = shapely.LineString(points)
        lines.setdefault(edge.get("id", ""), []).append(line)
        distance = line.distance(window.centroid)
        if distance < nearest:
            nearest = distance
            level = line.interpolate(line.project(window.centroid)).z
    far = [
        name
        for name, parts in lines.items()
        if not opendrive.is_on_level(parts, window, level, SAME_LEVEL)
    ]
    return round(level, 3), far, len(far) < len(lines)


def _in_site_frame(network: str, map_SE3_site: Pose) -> str:
    """Turn a net.xml text from the map's coordinates into the site's, without heights."""
    (x, y), turn = map_SE3_site[:2, 3], map_SE3_site[:2, :2]
    root = ElementTree.fromstring(network)
    for element in root.iter():
        if "shape" in element.attrib:
            moved = (nets.parse_shape(element) - [x, y]) @ turn
            closed = element.tag == "junction" or "_w" in element.get("id", "").partition(":")[2]
            moved = _repair(moved) if closed and len(moved) > 2 else moved
            element.set("shape", " ".join(f"{a:.3f},{b:.3f}" for a, b in moved))
        if element.tag == "junction":
            a, b = (
                np.array([float(element.get("x", 0)), float(element.get("y", 0))]) - [x, y]
            ) @ turn
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
    polygons = [
        p
        for p in nets.list_polygons(shapely.set_precision(shapely.make_valid(shape), 1e-3))
        if p.area > 0
    ]
    strip = (
        shapely.LineString(ring).buffer(0.05, cap_style="square", join_style="mitre").convex_hull
    )
    return shapely.get_coordinates(max(polygons, key=shapely.area, default=strip).exterior)[:-1]
