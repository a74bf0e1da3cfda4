"""Carriageways, footways and kerbs of an imported site."""

from collections.abc import Sequence
from xml.etree import ElementTree

import shapely

from toolkit.sites import furniture, network as nets
from toolkit.sites.site import Solid

CRACK_M = 0.3  # half the width of cracks between polygons of a map that are closed
# half the width of a slot in the carriageway that is a fault of the network's corners
STUB_M = 1.2
OUTLINE_GRID_M = 1e-3  # grid of outlines
SLIVER_M = 0.2  # half the width of the thinnest footway that is kept
MIN_ROAD_M = 0.5  # half the width of the thinnest carriageway that is kept
# a smaller footway in the middle of a carriageway is a fault of the network's corners
MAX_ISLET_M2 = 20.0
MIN_ISLET_SHARE = 0.85  # share of its border that is next to the carriageway
KERB_SIZE_M = (0.15, 0.12)  # width and height of kerbstones


def junction_corners(network: str) -> tuple[shapely.Geometry, shapely.Geometry]:
    """Ground of a network's junctions: carriageway, and footway (SUMO's walking areas).

    network: net.xml text."""
    walking_areas = [nets.enclose(lane) for _, lane in nets.list_lanes(network, "walkingarea")]
    footway = shapely.union_all(walking_areas)
    junction_shapes = [
        nets.enclose(junction)
        for junction in ElementTree.fromstring(network).iter("junction")
        if junction.get("type") not in ("internal", "dead_end")
    ]
    return shapely.union_all(junction_shapes).difference(footway), footway


def whole_road(
    lanes: Sequence[shapely.Geometry],
    footways: Sequence[shapely.Geometry],
    tracks: shapely.Geometry,
    window: shapely.Geometry,
    *,
    fillings: tuple[shapely.Geometry, shapely.Geometry] = (shapely.Polygon(), shapely.Polygon()),
) -> tuple[nets.Polygons, nets.Polygons]:
    """Polygons of lanes and of footways within `window`, without cracks, stubs and slivers.

    Driven ground is carriageway, and a footway begins at the end of the carriageway.

    lanes, footways: ground of single lanes and footways; tracks: ground that vehicles drive on;
    fillings: carriageway and footway at places that the map leaves open. Returns the polygons of
    the lanes, and of the carriageway between them, then the polygons of the footways."""
    wide_window = window.buffer(2 * STUB_M)
    more_lanes, more_footways = (filling.intersection(wide_window) for filling in fillings)
    all_lanes = shapely.union_all(list(lanes))
    driven_ground = shapely.union_all([*lanes, tracks]).intersection(wide_window)
    walked_ground = shapely.union_all(list(footways)).intersection(wide_window)
    driven_ground = driven_ground.union(more_lanes.difference(walked_ground))
    walked_ground = _close_shape(walked_ground.union(more_footways), CRACK_M)
    carriageway, footway = _part_ground(driven_ground, walked_ground)
    # the carriageway, lane by lane
    between_lanes = _open_shape(carriageway.difference(all_lanes), 0.01)
    near_lanes = [lane.intersection(carriageway) for lane in lanes if lane.intersects(window)]
    lane_polygons = nets.cut_polygons([*near_lanes, between_lanes], window)
    carriageway = nets.unite(lane_polygons)
    footway = _open_shape(footway.difference(carriageway), SLIVER_M).difference(carriageway)
    return lane_polygons, nets.cut_polygons([footway], window)


def _part_ground(
    driven_ground: shapely.Geometry, walked_ground: shapely.Geometry
) -> tuple[shapely.Geometry, shapely.Geometry]:
    """Divide ground into carriageway and footway, both without cracks, stubs and slivers.

    driven_ground: the carriageway so far; walked_ground: footways, which may overlap it."""
    whole_driven = _open_shape(_close_shape(driven_ground, CRACK_M), MIN_ROAD_M)
    # slots in the carriageway that are footway become carriageway
    stubs = _close_shape(whole_driven, STUB_M).difference(whole_driven).intersection(walked_ground)
    footway = _open_shape(walked_ground.difference(whole_driven.union(stubs)), SLIVER_M)
    islets = _find_islets(footway, whole_driven)
    carriageway = shapely.union_all([whole_driven, stubs, *islets])
    # off the grid an overlay may lose a whole lane
    carriageway = shapely.set_precision(carriageway, OUTLINE_GRID_M)
    if carriageway.geom_type == "GeometryCollection":  # whose overlays are slow
        carriageway = shapely.union_all(nets.list_polygons(carriageway))
    return carriageway, footway


def _find_islets(
    footway: shapely.Geometry, carriageway: shapely.Geometry
) -> list[shapely.Geometry]:
    """List pieces of footway below `MAX_ISLET_M2` that are surrounded by carriageway."""
    border = carriageway.buffer(0.1)
    small_pieces = [piece for piece in shapely.get_parts(footway) if piece.area < MAX_ISLET_M2]
    return [
        piece
        for piece in small_pieces
        if piece.boundary.intersection(border).length > MIN_ISLET_SHARE * piece.boundary.length
    ]


def kerbstones(
    lanes: nets.Polygons, footways: nets.Polygons, lowered: shapely.Geometry
) -> list[Solid]:
    """Make kerbstones between lanes and footways, on the side of the footways.

    lowered: ground without kerbstones, as at corners that vehicles cut."""
    carriageway = nets.unite(lanes).buffer(0.01)  # wider, so that it overlaps the footways' edges
    footway = nets.unite(footways)
    if footway.is_empty:
        return []
    edge = shapely.intersection(footway.boundary, carriageway.buffer(0.02))
    edge = edge.simplify(0.02).difference(lowered)
    if edge.geom_type == "MultiLineString":
        edge = shapely.line_merge(edge)
    return furniture.set_kerbs(edge, carriageway, KERB_SIZE_M)


def _open_shape(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    """Return a shape without the pieces narrower than twice `gap` (m)."""
    core = shape.buffer(-gap, join_style="mitre", mitre_limit=2)
    thick = core.buffer(gap + 0.01, join_style="mitre", mitre_limit=2)
    return shape.intersection(thick)


def _close_shape(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    """Return a shape with openings narrower than twice `gap` (m) filled."""
    swollen = shape.buffer(gap, join_style="mitre", mitre_limit=2)
    return swollen.buffer(-gap, join_style="mitre", mitre_limit=2)
