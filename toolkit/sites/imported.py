"""What every imported site gets beside what its map says: whole roads, kerbs, and surroundings where the map is silent.

Surroundings are drawn from a seed by the code that furnishes random sites, round everything the map does have.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites import furniture as f
from toolkit.sites.network import Polygons, enclosed, points_of, users_of, within_window
from toolkit.sites.site import Mount, Site, Solid
from toolkit.sites.street.bays import stood_along
from toolkit.sites.street.furnishing import furnish
from toolkit.sites.surroundings import Road

CRACK = 0.3  # m, half the width of cracks between polygons of a map that are closed
STUB = 1.2  # m, half the width of a slot in the carriageway that is a fault of the network's corners
OUTLINE_GRID = 1e-3  # m, on which outlines lie
SLIVER = 0.2  # m, half the width of the thinnest footway that is kept
THINNEST_ROAD = 0.5  # m, half the width of the thinnest carriageway that is kept
ISLET = 20.0  # m², of a footway in the middle of a carriageway that is a fault of the network's corners
KERB = (0.15, 0.12)  # m, width and height of kerbstones
WIDEST = 3.5  # m, of the track a vehicle follows over a junction
MAP_BAY = (5.8, 2.3)  # m, length and width of a bay of which a map says no size
CORNER_CUT = 1.2  # m beside the track of a vehicle that turns, where kerbs are lowered
BODY = (5.5, 2.6)  # m, length and width of a vehicle that turns, with room beside it
ROUGHEST = 0.12  # m, of the ground's unevenness that is drawn, as in random sites


def driven(network: str) -> shapely.Geometry:
    """The tracks of a net.xml text that motor vehicles follow, over junctions with the room that their ends need."""
    tracks = []
    for edge in ElementTree.fromstring(network).iter("edge"):
        function = edge.get("function", "normal")
        for lane in edge.iter("lane") if function in ("normal", "internal") else ():
            if "passenger" in users_of(lane):
                tracks.append(_track(lane))
                tracks += _turning(points_of(lane)) if function == "internal" else []
    return shapely.union_all(tracks)


def turning(network: str, margin: float = CORNER_CUT) -> shapely.Geometry:
    """The ground within `margin` m of the bent tracks that motor vehicles follow over junctions."""
    bent = []
    for edge in ElementTree.fromstring(network).iter("edge"):
        for lane in edge.iter("lane") if edge.get("function") == "internal" else ():
            points = points_of(lane)
            straight = shapely.LineString(points[[0, -1]])
            if "passenger" in users_of(lane) and shapely.hausdorff_distance(shapely.LineString(points), straight) > 0.3:
                bent += [_track(lane), *_turning(points)]
    return shapely.union_all(bent).buffer(margin)


def junction_corners(network: str) -> tuple[shapely.Geometry, shapely.Geometry]:
    """Where a net.xml text has carriageway and footway at the corners of its junctions."""
    root = ElementTree.fromstring(network)
    walking = [
        lane for edge in root.iter("edge") if edge.get("function") == "walkingarea" for lane in edge.iter("lane")
    ]
    footway = shapely.union_all([enclosed(lane) for lane in walking])
    junctions = [enclosed(j) for j in root.iter("junction") if j.get("type") not in ("internal", "dead_end")]
    return shapely.union_all(junctions).difference(footway), footway


def whole_road(
    lanes: Sequence[shapely.Geometry],
    footways: Sequence[shapely.Geometry],
    tracks: shapely.Geometry,
    window: shapely.Geometry,
    *,
    fillings: tuple[shapely.Geometry, shapely.Geometry] = (shapely.Polygon(), shapely.Polygon()),
) -> tuple[Polygons, Polygons]:
    """Lanes and footways within `window` without cracks, stubs and slivers: what is driven on is carriageway, and a
    footway begins where the carriageway ends. `fillings`: carriageway and footway where the map is silent of both."""
    window_of_work = window.buffer(2 * STUB)
    paved = shapely.union_all([*lanes, tracks]).intersection(window_of_work)
    walk = shapely.union_all(list(footways)).intersection(window_of_work)
    paved = paved.union(fillings[0].intersection(window_of_work).difference(walk))
    closed = _opened(_closed(paved, CRACK), THINNEST_ROAD)
    walk = _closed(walk.union(fillings[1].intersection(window_of_work)), CRACK)
    stubs = _closed(closed, STUB).difference(closed).intersection(walk)
    walk = _opened(walk.difference(closed.union(stubs)), SLIVER)
    islets = [part for part in shapely.get_parts(walk) if part.area < ISLET and _within_road(part, closed)]
    carriageway = shapely.union_all([closed, stubs, *islets])
    carriageway = shapely.set_precision(carriageway, OUTLINE_GRID)  # off the grid an overlay may lose a whole lane
    between = _opened(carriageway.difference(shapely.union_all(list(lanes))), 0.01)
    pieces = within_window([lane.intersection(carriageway) for lane in lanes] + [between], window)
    carriageway = shapely.union_all([shapely.Polygon(p) for p in pieces])
    walk = _opened(walk.difference(carriageway), SLIVER).difference(carriageway)
    return pieces, within_window([walk], window)


def kerbstones(lanes: Polygons, footways: Polygons, lowered: shapely.Geometry) -> list[Solid]:
    """Kerbstones on the footway's side of every edge between lanes and footways, in pieces of at most 4 m; none on
    ground where they are `lowered`, as at corners that vehicles cut."""
    carriageway = shapely.union_all([shapely.Polygon(p) for p in lanes]).buffer(0.01)
    walk = shapely.union_all([shapely.Polygon(p) for p in footways])
    if walk.is_empty:
        return []
    edge = shapely.intersection(walk.boundary, carriageway.buffer(0.02)).simplify(0.02)
    edge = edge.difference(lowered)
    edge = shapely.line_merge(edge) if edge.geom_type == "MultiLineString" else edge
    solids = []
    for part in shapely.get_parts(shapely.segmentize(edge, 4.0)):
        corners = shapely.get_coordinates(part) if part.geom_type == "LineString" else ()
        for piece in pairwise(corners):
            stone = shapely.LineString(piece).buffer(KERB[0], cap_style="flat").difference(carriageway)
            stones = shapely.get_parts(shapely.set_precision(stone, 1e-3))
            largest = max(stones, key=shapely.area, default=shapely.Polygon())
            if largest.area > 0.02 and not largest.interiors:
                solids.append(Solid(shapely.get_coordinates(largest.exterior)[:-1], 0.0, KERB[1], "kerb"))
    return solids


def legs(network: str, reach: float = 100.0) -> tuple[list[Float64[np.ndarray, "_ 2"]], list[tuple[float, float]]]:
    """Paths of the network's streets within `reach` m of the site's middle, and half their widths left and right (m).

    A path runs along the lane nearest to the middle of the street, each direction's has its own; it goes straight on
    for 130 m where its edge ends, since houses are drawn along 90 m.
    """
    paths, widths = [], []
    for edge in ElementTree.fromstring(network).iter("edge"):
        lanes = list(edge.iter("lane"))
        if edge.get("function", "normal") != "normal" or not any("passenger" in users_of(lane) for lane in lanes):
            continue
        line = shapely.LineString(points_of(lanes[-1])).intersection(shapely.Point(0, 0).buffer(reach))
        for part in shapely.get_parts(line):
            if part.geom_type == "LineString" and part.length > 10.0:
                inner = float(lanes[-1].get("width", "3.2")) / 2
                width = round(sum(float(lane.get("width", "3.2")) for lane in lanes) - inner, 3)
                path = shapely.get_coordinates(part)
                ahead = (path[-1] - path[-2]) / np.hypot(*(path[-1] - path[-2]))
                paths.append(np.vstack([path, path[-1] + 130.0 * ahead]))
                widths.append((width, width))
    return paths, widths


def furnished(site: Site, mounts: Sequence[Mount], solids: Sequence[Solid], seed: int) -> tuple[Site, str]:
    """`site` (with lanes, footways and bays) furnished round the map's own `solids` on uneven ground drawn from `seed`;
    and what was drawn, in words. Mounts stand on posts of their own, those on the map's lamp posts excepted.

    Raises ValueError where the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed must be a whole number from 0 up, got {seed}")
    rng = np.random.default_rng(seed)
    relief = replace(site.relief, amplitude=round(float(rng.uniform(0.0, ROUGHEST)), 3), seed=int(rng.integers(2**31)))
    paths, widths = legs(site.network)
    road = Road(paths, widths, site.lanes, site.footways)
    drawn, bays = furnish(road, site.area, mounts, rng)
    lamps = [shapely.Point(m.position[:2]).buffer(0.5) for m in mounts if m.name.startswith("lamp")]
    ours = [*lamps, *(shapely.Polygon(s.footprint) for s in solids if s.kind not in ("kerb", "island"))]
    ours += [shapely.Polygon(bay_outline(*bay)) for bay in site.parking]
    kept = _apart_from([s for s in drawn if s.kind != "kerb"], shapely.union_all(ours).buffer(0.2))
    taken = shapely.union_all([*ours, *(shapely.Polygon(s.footprint) for s in solids if s.kind == "kerb")])
    free = [b for b in bays if not taken.intersects(shapely.Polygon(bay_outline(*b)))]
    site = replace(site, relief=relief, parking=np.concatenate([site.parking, np.reshape(free, (-1, 3))]))
    said = Counter(s.kind for s in kept if s.kind not in ("trunk", "post"))
    counted = ", ".join(f"{n} {kind}" for kind, n in sorted(said.items()))
    note = f"drawn from seed {seed}, in no map: {counted} solids, {len(free)} bays, ground within {relief.amplitude} m"
    return replace(site, mounts=on_ground(mounts, site), solids=f.settle([*solids, *kept], relief)), note


def on_ground(mounts: Sequence[Mount], site: Site) -> tuple[Mount, ...]:
    """The mounts with their feet on the ground of the site."""
    feet = np.array([mount.position for mount in mounts]).reshape(-1, 3)
    feet[:, 2] = site.ground(feet[:, :2]).round(3)
    return tuple(replace(mount, position=foot) for mount, foot in zip(mounts, feet, strict=True))


def bay_outline(x: float, y: float, yaw: float) -> Float64[np.ndarray, "4 2"]:
    """The corners of a parking bay."""
    return f.block(MAP_BAY, (x, y), yaw)


def free_bays(
    bays: Sequence[tuple[float, float, float]],
    window: shapely.Geometry,
    solids: Sequence[Solid],
    tracks: shapely.Geometry,
) -> Float64[np.ndarray, "n 3"]:
    """The bays x, y, yaw within `window` in which nothing stands and through which nobody drives."""
    standing = shapely.union_all([shapely.Polygon(s.footprint) for s in solids if s.kind not in ("island", "kerb")])
    tracks = tracks.buffer(-0.3)
    outlines = [(bay, shapely.Polygon(bay_outline(*bay))) for bay in bays]
    outlines = [(bay, shape) for bay, shape in outlines if window.contains(shape) and not standing.intersects(shape)]
    free = [bay for bay, shape in outlines if not tracks.intersects(shape.buffer(-0.25))]  # corners of slanted bays
    return np.array(free, np.float64).reshape(-1, 3).round(4)


def bays_along(middle: Float[np.ndarray, "k 2"], every: float = 6.4) -> list[tuple[float, float, float]]:
    """Bays x, y, yaw one behind the other along the middle of a parking lane."""
    line = shapely.LineString(middle)
    rows = stood_along(line, np.arange(every / 2, line.length - every / 2, every), 0.5)
    return [(float(x), float(y), float(a)) for x, y, a in rows]


def _apart_from(solids: Sequence[Solid], ours: shapely.Geometry) -> list[Solid]:
    """The solids that neither touch `ours` nor hang together with one that does."""
    shapes = [shapely.Polygon(s.footprint) for s in solids]
    groups = shapely.get_parts(
        shapely.union_all([p for p, s in zip(shapes, solids, strict=True) if s.kind != "island"])
    )
    hit = shapely.union_all([group for group in groups if group.intersects(ours)])
    return [s for s, p in zip(solids, shapes, strict=True) if s.kind == "island" or not hit.intersects(p)]


def _track(lane: ElementTree.Element) -> shapely.Geometry:
    half = min(float(lane.get("width", "3.2")), WIDEST) / 2
    points = points_of(lane)
    if len(points) < 2:
        return shapely.Polygon()
    return shapely.LineString(points).simplify(0.05).buffer(half, cap_style="flat", quad_segs=4)


def _turning(path: Float[np.ndarray, "k 2"]) -> list[shapely.Geometry]:
    """The ground under `BODY`, both of its ends on `path` or straight on from it, every half metre."""
    length, width = BODY
    line = shapely.LineString(path)
    if line.length < 0.5:
        return []
    first, last = (d / max(np.hypot(*d), 1e-9) for d in (path[1] - path[0], path[-1] - path[-2]))
    line = shapely.LineString([path[0] - length * first, *path, path[-1] + length * last])
    at = np.arange(0.0, line.length - length, 0.5)
    ends = zip(_interpolated(line, at), _interpolated(line, at + length), strict=True)
    return [shapely.LineString(both).buffer(width / 2, cap_style="flat") for both in ends]


def _interpolated(line: shapely.LineString, at: np.ndarray) -> Float64[np.ndarray, "n 2"]:
    return shapely.get_coordinates(shapely.line_interpolate_point(line, at)).reshape(-1, 2)


def _within_road(part: shapely.Geometry, carriageway: shapely.Geometry) -> bool:
    """Whether most of the border of `part` is shared with the carriageway."""
    shared = part.boundary.intersection(carriageway.buffer(0.1)).length
    return bool(shared > 0.85 * part.boundary.length)


def _opened(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    """`shape` without what is narrower than twice `gap` (m)."""
    thick = shape.buffer(-gap, join_style="mitre", mitre_limit=2).buffer(gap + 0.01, join_style="mitre", mitre_limit=2)
    return shape.intersection(thick)


def _closed(shape: shapely.Geometry, gap: float) -> shapely.Geometry:
    return shape.buffer(gap, join_style="mitre", mitre_limit=2).buffer(-gap, join_style="mitre", mitre_limit=2)
