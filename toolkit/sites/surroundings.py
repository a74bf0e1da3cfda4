"""Ground around a road, parking bays, sensor places, and drawn things next to the road.

Things are placed on the ground one by one, never on driven ground. A footway holds only slim things
near the kerb. Bays are along kerbs, in line, at an angle or at right angles, and on forecourts
behind the footways.

Furnishing of a street and its sides: whatever is drawn first gets its ground first.

A tree's crown is several clumps of leaves with gaps between them. It keeps clear of walls and
places for sensors, and traffic passes below it: only the trunk takes ground. Islands are kerbed,
planted and signed. Road works are off the lanes that are driven, closed off by cones, barriers or a
fence.

Things of a site have an origin: taken from a map, surveyed, or drawn by coview because the map
leaves them open."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import shapely
from shapely.ops import substring

from toolkit.arrays import Float, Float64, Points, Rng
from toolkit.sites import furniture as f
from toolkit.sites.furniture import (
    BUILT,
    PLANTED,
    Make,
    bushes,
    container,
    digger,
    heap,
    move_solids,
    skip,
)
from toolkit.sites.network import unite
from toolkit.sites.site import ORIGINS, Mount, Site, Solid

LANE_CLEARANCE_M = 0.25  # between a lane and solids next to it
MOUNT_CLEARANCE_M = 0.5  # of air around a mount's axis
MIN_MOUNTS = 12  # of a site
POLE_HEIGHT_M = 2.8  # of a mount's pole: sensors are above it
BAY_SIZE_M = (5.8, 2.6)  # length and width of a parking bay
# angle between bay and kerb (degrees): width of a strip of such bays
BAY_DEPTHS_M = {0: 2.3, 45: 4.8, 60: 5.1, 90: 5.2}
_JUNCTION_CLEARANCE_M = 6.0  # between a junction and the first bay
_BAY_REACH_M = 75.0  # from a junction; bays are drawn up to it
_EDGE_CLEARANCE_M = 15.0  # from the edge of the furnished ground; without bays on the road
UNDERSIDE_M = (2.5, 5.0)  # range above the ground, of a crown over lanes or bays
CROWN_WIDTH_M = (3.0, 9.0)  # range of such a crown
_TRIMMED_UNDERSIDE_M = 4.2  # underside of crowns over tall vehicles
_MOUNT_AIR_M = 1.0  # between a crown and a mount's axis
_MIN_CROWN_RADIUS_M = 1.0  # of a crown that is planted
_MIN_ISLAND_M2 = 30.0  # of an island with solids on it
CLOSED_LANE_M = (2.6, 3.6)  # range of the width of a lane closed for works
_BARRIER_EDGE_M = 0.45  # between the edge of the strip and its barrier
POST_AIR_M = 0.2  # from the top of a mount's post to the lowest sensor on it
_PART_OF = {"trunk": "tree"}
_TOUCHING_M = 0.15  # between parts of one thing
_INSIDE: tuple[Make, ...] = (container, skip, digger, digger, heap, heap, bushes)

Extent = Float[np.ndarray, "4"]
Strip = tuple[Float[np.ndarray, "_ 2"], float]  # middle line as traffic goes, width (m)
Bay = tuple[float, float, float]  # x, y, yaw
Bays = Float64[np.ndarray, "n 3"]
Draw = Callable[[float, float, float], list[Solid]]  # x, y and the direction along the road (rad)


@dataclass(frozen=True, eq=False)
class Road:
    """Surface of a road, and the paths of its legs.

    Attributes:
        paths: middle lines of the legs.
        half_widths: width to the left and right of each path (m).
        lanes: everything with a kerb, including `strips`.
        footways: footways next to the lanes.
        strips: shoulders without traffic, by edge.
        angles: angles of the bays on strips that have bays (degrees), by edge."""

    paths: Sequence[Float64[np.ndarray, "_ 2"]]
    half_widths: Sequence[tuple[float, float]]
    lanes: f.Outlines
    footways: f.Outlines
    strips: Mapping[str, Strip] = field(default_factory=dict)
    angles: Mapping[str, int] = field(default_factory=dict)

    @cached_property
    def carriageway(self) -> shapely.Geometry:
        """Union of the lanes, cracks between them closed."""
        return _close_gaps(self.lanes, 0.02)

    @cached_property
    def driven(self) -> shapely.Geometry:
        """Carriageway without its shoulders."""
        lines = [(shapely.LineString(line), width / 2) for line, width in self.strips.values()]
        strips = [line.buffer(half, cap_style="flat", join_style="mitre") for line, half in lines]
        return self.carriageway.difference(
            shapely.union_all(strips).buffer(0.02, join_style="mitre")
        )

    @cached_property
    def surface(self) -> shapely.Geometry:
        """Union of lanes and footways, slivers between them closed."""
        return _close_gaps([*self.lanes, *self.footways], 1.2)

    @cached_property
    def islands(self) -> list[shapely.Polygon]:
        """Ground that the road encloses."""
        return [
            shapely.Polygon(ring)
            for polygon in shapely.get_parts(self.surface)
            for ring in polygon.interiors
        ]


class Plot:
    """Ground around a road, on which solids are placed one by one.

    Attributes:
        road: the road.
        window: all the ground.
        solids: solids placed so far.
        open: ground next to the road.
        lanes: lanes to keep clear, with `LANE_CLEARANCE_M`.
        driven: part of the lanes to keep clear even of solids on shoulders.
        mounts: (n, 2) places of sensors."""

    def __init__(self, road: Road, window: shapely.Geometry, mounts: Iterable[Mount]) -> None:
        self.road = road
        self.window = window
        self.solids: list[Solid] = []
        self.open = window.difference(shapely.union_all([road.surface, *road.islands]).buffer(0.3))
        self.lanes = road.carriageway.buffer(LANE_CLEARANCE_M)
        self.driven = road.driven.buffer(LANE_CLEARANCE_M)
        self.mounts = np.array([m.position[:2] for m in mounts]).reshape(-1, 2)
        self._taken = [shapely.Point(foot).buffer(MOUNT_CLEARANCE_M) for foot in self.mounts]
        shapely.prepare([self.lanes, self.open, self.driven])

    def claim(
        self, ground: shapely.Geometry, *, footway: bool = False, shoulder: bool = False
    ) -> bool:
        """Take `ground` off the lanes if it is free; return success.

        footway: the ground may be on footways; shoulder: it may be on any ground that is not
        driven."""
        if shoulder:
            allowed = not self.driven.intersects(ground)
        else:
            allowed = not self.lanes.intersects(ground) if footway else self.open.contains(ground)
        if not allowed or shapely.intersects(np.array(self._taken, object), ground).any():
            return False
        self._taken.append(ground)
        return True

    def place(
        self, solids: Sequence[Solid], *, footway: bool = False, shoulder: bool = False
    ) -> bool:
        """Place solids together if there is room for all; return success."""
        ground = unite(solid.footprint for solid in solids)
        if not self.claim(ground, footway=footway, shoulder=shoulder):
            return False
        self.solids += solids
        return True


def place_mounts(
    road: Road,
    area: Extent,
    rng: Rng,
    *,
    spacing: float = 5.0,
    avoid: shapely.Geometry | None = None,
) -> tuple[Mount, ...]:
    """Choose sensor places at the kerb and behind the footway, their feet at z = 0.

    There are `MIN_MOUNTS` to twice as many mounts in and just around `area`, out of `avoid`. They
    are `spacing` m apart, or less if there is no room."""
    window = shapely.box(*area).buffer(5.0)
    kerb = along(road.carriageway.buffer(0.7).boundary.intersection(window), 1.0)
    behind = along(road.surface.buffer(0.6).boundary.intersection(window), 1.0)
    behind = behind[rng.random(len(behind)) < 0.5]
    candidates = rng.permutation(np.concatenate([kerb, behind]))[:, :2]
    kept_clear = road.carriageway.buffer(0.6).union(avoid or shapely.Polygon())
    candidates = candidates[~shapely.intersects_xy(kept_clear, candidates)]
    max_mounts = int(rng.integers(MIN_MOUNTS, 2 * MIN_MOUNTS + 1))
    while True:
        feet = np.zeros((0, 2))
        for point in candidates:
            if len(feet) < max_mounts and (np.hypot(*(feet - point).T) >= spacing).all():
                feet = np.vstack([feet, point])
        if len(feet) >= MIN_MOUNTS or spacing <= 0.5:
            break
        spacing *= 0.7
    feet = np.column_stack([feet, np.zeros(len(feet))]).round(3)
    return tuple(
        Mount(f"pole{i:02}", foot, 3.0, 10.0, round(float(rng.uniform(0.5, 2.0)), 2))
        for i, foot in enumerate(feet)
    )


def along(lines: shapely.Geometry, step: float) -> Float64[np.ndarray, "n 3"]:
    """Points x, y and direction (rad) every `step` m along `lines`."""
    rows = [np.zeros((0, 3))]
    for line in shapely.get_parts(shapely.line_merge(lines)):
        if line.geom_type == "LineString" and line.length >= 2 * step:
            at = np.arange(step / 2, line.length - step / 2, step)
            points = shapely.get_coordinates(line.interpolate(at))
            ahead = shapely.get_coordinates(line.interpolate(at + step / 2))
            rows.append(np.column_stack([points, np.arctan2(*(ahead - points).T[::-1])]))
    return np.concatenate(rows)


def _close_gaps(polygons: f.Outlines, gap: float) -> shapely.Geometry:
    """Union of polygons, gaps up to twice `gap` (m) filled."""
    union = unite(polygons)
    return union.buffer(gap, join_style="mitre", quad_segs=2).buffer(
        -gap, join_style="mitre", quad_segs=2
    )


def kerb_bays(plot: Plot, strips: Mapping[str, Strip], angles: Mapping[str, int], rng: Rng) -> Bays:
    """Draw bays x, y, yaw on the strips that have an angle (degrees, 0 in line with the kerb).

    The junction is at the end of a strip of an edge `in...`, and at the start of the others."""
    rows = [np.zeros((0, 3))]
    seen = plot.window.buffer(-_EDGE_CLEARANCE_M, join_style="mitre")
    size = BAY_SIZE_M[0] - 0.2, BAY_SIZE_M[1] - 0.2
    for edge, angle in angles.items():
        if edge in strips:
            bays = stations(strips[edge], angle, at_end=edge.startswith("in"))
            bays = bays[rng.random(len(bays)) < rng.uniform(0.35, 1.0)]
            # parts that reach into the lane or to neighbours do not count
            ground = [outline(bay, size).difference(plot.driven).buffer(-0.02) for bay in bays]
            is_free = [bool(seen.contains(g) and plot.claim(g, shoulder=True)) for g in ground]
            rows.append(bays[is_free].reshape(-1, 3))
    return np.concatenate(rows)


def stations(strip: Strip, angle: int, *, at_end: bool) -> Bays:
    """Middles x, y and headings of all bays on a strip, from the junction on."""
    line = shapely.LineString(strip[0])
    at = np.arange(
        _JUNCTION_CLEARANCE_M + BAY_SIZE_M[0] / 2,
        min(line.length - BAY_SIZE_M[0] / 2, _BAY_REACH_M),
        _spacing(angle),
    )
    if at_end:
        at = line.length - at
    # the kerb is to the right
    return (place_along(line, at, 0.25) - [0.0, 0.0, np.deg2rad(angle)]).round(4)


def bays_between(line: shapely.LineString, angle: int, *, kerb_left: bool = False) -> Bays:
    """Middles x, y and headings of bays on a strip between junctions. line: as traffic goes."""
    at = np.arange(
        _JUNCTION_CLEARANCE_M + BAY_SIZE_M[0] / 2,
        line.length - _JUNCTION_CLEARANCE_M - BAY_SIZE_M[0] / 2,
        _spacing(angle),
    )
    slant = np.deg2rad(-angle if kerb_left else angle)
    return (place_along(line, at, 0.25) - [0.0, 0.0, slant]).round(4)


def _spacing(angle: int) -> float:
    """Distance from bay to bay along the kerb (m)."""
    return BAY_SIZE_M[0] + 0.4 if angle == 0 else BAY_SIZE_M[1] / float(np.sin(np.deg2rad(angle)))


def place_along(line: shapely.LineString, at: Float[np.ndarray, " n"], half: float) -> Bays:
    """Places x, y and headings `at` metres along a line.

    Both ends, `half` m from each middle, are on the line."""
    rear = shapely.get_coordinates(line.interpolate(at - half)).reshape(-1, 2)
    front = shapely.get_coordinates(line.interpolate(at + half)).reshape(-1, 2)
    return np.column_stack([(rear + front) / 2, np.arctan2(*(front - rear).T[::-1])])


def forecourts(plot: Plot, rng: Rng) -> Bays:
    """Parking bays behind the footways, along the road or across."""
    bays: list[Bay] = []
    across = rng.random() < 0.5
    edge = plot.road.surface.buffer(0.7 + BAY_SIZE_M[not across] / 2).boundary
    line = along(edge.intersection(plot.window), 1.0)
    for x, y, direction in rng.permutation(line)[: rng.integers(0, 14)]:
        yaw = direction + (np.pi / 2 if across else 0.0) + np.pi * rng.integers(2)
        if plot.claim(outline((x, y, yaw))):
            bays.append((round(float(x), 3), round(float(y), 3), round(float(yaw), 4)))
    return np.array(bays, np.float64).reshape(-1, 3)


def outline(bay: Iterable[float], size: tuple[float, float] = BAY_SIZE_M) -> shapely.Polygon:
    """Ground of a bay x, y, yaw."""
    x, y, yaw = bay
    return shapely.Polygon(f.block(size, (x, y), yaw))


def avenues(plot: Plot, kerb: Points, rng: Rng) -> None:
    """Plant rows of trees with crowns over the road, at most sites.

    kerb: x, y, direction every 0.5 m."""
    if rng.random() > 0.6 or not len(kerb):
        return
    planted_share = rng.uniform(0.3, 0.9)
    spacing = rng.uniform(5.0, 13.0)
    wide = rng.uniform(*CROWN_WIDTH_M)
    tall = rng.uniform(2.5, 6.0)
    if rng.random() < 0.5:
        low = rng.uniform(_TRIMMED_UNDERSIDE_M, UNDERSIDE_M[1])
    else:
        low = rng.uniform(UNDERSIDE_M[0], _TRIMMED_UNDERSIDE_M)
    step = max(1, round(spacing / 0.5))
    for row in kerb[int(rng.integers(step)) :: step]:
        if rng.random() > planted_share:
            continue
        width = float(np.clip(wide * rng.uniform(0.8, 1.2), *CROWN_WIDTH_M))
        underside = float(np.clip(low + rng.normal(0.0, 0.3), *UNDERSIDE_M))
        plant(plot, row[:2], width / 2, (underside, underside + tall * rng.uniform(0.8, 1.2)), rng)


def plant(
    plot: Plot, foot: np.ndarray, radius: float, levels: f.Span, rng: Rng, *, footway: bool = True
) -> bool:
    """Plant a tree at `foot`; return False if there is no room.

    radius: radius of the crown, less near walls and mounts, and off the road if it is too low;
    levels: ends of the crown (m)."""
    x = round(float(foot[0]), 3)
    y = round(float(foot[1]), 3)
    spot = shapely.Point(x, y)
    houses = [shapely.Polygon(solid.footprint) for solid in plot.solids if solid.kind == "building"]
    limits = [radius]
    limits += (np.hypot(*(plot.mounts - [x, y]).T) - _MOUNT_AIR_M).tolist()
    limits += shapely.distance(spot, np.array(houses, object)).tolist()
    if levels[0] < UNDERSIDE_M[0]:
        limits.append(shapely.distance(spot, plot.lanes))
    radius = float(min(limits))
    trunk = f.disc(x, y, round(float(rng.uniform(0.1, 0.16 + 0.04 * radius)), 2))
    if radius < _MIN_CROWN_RADIUS_M or not plot.claim(shapely.Polygon(trunk), footway=footway):
        return False
    low = round(levels[0], 2)
    high = round(levels[1], 2)
    plot.solids += [Solid(trunk, 0.0, round(low + 0.3 * (high - low), 2), "trunk")]
    plot.solids += clumps(x, y, radius, (low, high), rng)
    return True


def clumps(x: float, y: float, radius: float, levels: f.Span, rng: Rng) -> list[Solid]:
    """Draw a crown of 3 to 8 overlapping clumps."""
    low, high = levels
    number = int(rng.integers(3, 9))
    around = (
        rng.uniform(0, 2 * np.pi)
        + np.arange(number) * 2 * np.pi / number
        + rng.normal(0.0, 0.3, number)
    )
    solids = []
    for k, angle in enumerate(around):
        size = radius * rng.uniform(0.4, 0.65)
        offset = (radius - size) * rng.uniform(0.7, 1.0)
        bottom = low if k == 0 else low + (high - low) * rng.uniform(0.0, 0.4)
        top = high if k == 1 else bottom + (high - bottom) * rng.uniform(0.5, 1.0)
        outline = f.disc(
            x + float(offset * np.cos(angle)), y + float(offset * np.sin(angle)), float(size), 7
        )
        solids.append(Solid(outline, round(float(bottom), 2), round(float(top), 2), "tree"))
    return solids


def plant_islands(plot: Plot, rng: Rng) -> None:
    """Put a centre piece, rings of hedges, bushes and signs on every large enough island."""
    for ground in plot.road.islands:
        parts = shapely.get_parts(ground.buffer(-0.3).simplify(0.05).difference(plot.lanes))
        island = max(parts, key=shapely.area, default=shapely.Polygon())
        if island.geom_type != "Polygon" or island.area < _MIN_ISLAND_M2:
            continue
        plot.solids.append(
            Solid(shapely.get_coordinates(island.exterior)[:-1].round(3), 0.0, 0.15, "island")
        )
        x, y = shapely.get_coordinates(island.centroid)[0].tolist()
        middle = (x, y)
        radius = float(np.sqrt(island.area / np.pi))
        if rng.random() < 0.5:
            size = rng.uniform(0.15, 0.4) * radius
            height = round(float(rng.uniform(0.5, 2.5)), 2)
            kind = ("hedge", "wall", "heap", "bush")[rng.integers(4)]
            plot.place([Solid(f.disc(x, y, float(size), 12), 0.0, height, kind)], footway=True)
        for out in np.sort(rng.uniform(0.35, 0.92, rng.integers(0, 4))) * radius:
            _ring(plot, middle, float(out), rng)
        makes = PLANTED + PLANTED + BUILT
        for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 14)):
            at = _around(middle, radius * rng.uniform(0.2, 0.95), angle)
            thing = makes[rng.integers(len(makes))](rng)
            plot.place(move_solids(thing, *at, float(rng.uniform(0, np.pi))), footway=True)
        for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 8)):
            low = rng.uniform(1.5, 4.0)
            levels = low, low + rng.uniform(2.0, 5.0)
            foot = np.array(_around(middle, radius * rng.uniform(0.0, 0.9), angle))
            plant(plot, foot, rng.uniform(1.0, 3.5), levels, rng)
        for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 6)):
            plot.place(f.sign(*_around(middle, 0.9 * radius, angle), float(angle)), footway=True)


def _ring(plot: Plot, middle: tuple[float, float], ring_radius: float, rng: Rng) -> None:
    """Place hedges or bushes in a ring with gaps."""
    length = float(rng.uniform(1.0, 5.0))
    width = float(rng.uniform(0.6, 2.2))
    height = float(rng.uniform(0.5, 1.8))
    step = (length + rng.uniform(0.1, 4.0)) / ring_radius
    turn = rng.uniform(0, 2 * np.pi)
    placed_share = rng.uniform(0.4, 1.0)
    is_round = rng.random() < 0.4
    for angle in np.arange(turn, turn + 2 * np.pi - step / 2, step)[:60]:
        at = _around(middle, ring_radius, angle)
        tall = round(height * float(rng.uniform(0.8, 1.2)), 2)
        if rng.random() > placed_share:
            continue
        shape = f.block((length, width), at, angle + np.pi / 2)
        kind = "hedge"
        if is_round:
            shape = f.disc(*at, 0.35 * length, 9)
            kind = ("hedge", "bush")[rng.integers(2)]
        plot.place([Solid(shape, 0.0, tall, kind)], footway=True)


def _around(middle: tuple[float, float], out: float, angle: float) -> tuple[float, float]:
    """Place `out` m from a middle in a direction (rad)."""
    return float(middle[0] + out * np.cos(angle)), float(middle[1] + out * np.sin(angle))


def lane_works(plot: Plot, strips: Mapping[str, Strip], rng: Rng) -> None:
    """Put road works on a stretch of each strip, near the junction. Traffic passes on the left."""
    for edge, (line, width) in strips.items():
        path = shapely.LineString(line)
        length = min(float(rng.uniform(10.0, 32.0)), path.length - 10.0)
        start = float(rng.uniform(4.0, 22.0))
        first = path.length - start - length if edge.startswith("in") else start
        if first > 0 and length > 6.0:
            _put_works(plot, path, (first, first + length), width, rng, shoulder=True)


def verge_works(plot: Plot, rng: Rng) -> None:
    """Put up to three small works next to the footways."""
    edge = along(plot.road.surface.buffer(2.0).boundary.intersection(plot.window), 2.0)
    for x, y, direction in rng.permutation(edge)[: rng.integers(0, 4)]:
        ahead = 9.0 * np.array([np.cos(direction), np.sin(direction)])
        path = shapely.LineString([(x, y), (x + ahead[0], y + ahead[1])])
        span = (0.0, float(rng.uniform(4.0, 9.0)))
        width = float(rng.uniform(2.0, 3.0))
        _put_works(plot, path, span, width, rng, shoulder=False)


def _put_works(
    plot: Plot, path: shapely.LineString, span: f.Span, width: float, rng: Rng, *, shoulder: bool
) -> None:
    """Put barriers round a stretch of a strip, and machines and heaps inside.

    span: start and end of the stretch along `path` (m); width: width of the strip (m)."""
    start, end = span

    def place_solids(solids: list[Solid], s: float, left: float, turn: float = 0.0) -> None:
        x, y = shapely.get_coordinates(path.interpolate(s))[0]
        ahead = shapely.get_coordinates(path.interpolate(s + 0.5))[0]
        yaw = float(np.arctan2(ahead[1] - y, ahead[0] - x))
        spot = float(x - left * np.sin(yaw)), float(y + left * np.cos(yaw))
        plot.place(move_solids(solids, *spot, yaw + turn), shoulder=shoulder)

    for s in (start, end):
        place_solids(barrier(width - 2 * _BARRIER_EDGE_M - 0.3, rng), s, 0.0, np.pi / 2)
    side = width / 2 - _BARRIER_EDGE_M
    closing, spacing = _CLOSINGS[rng.integers(len(_CLOSINGS))]
    for s in np.arange(start + 1.0, end - 0.5, spacing + rng.uniform(0.05, 1.5)):
        place_solids(closing(rng), float(s), side)
    s = start + rng.uniform(1.0, 3.0)
    while s < end - 1.5:
        thing = _INSIDE[rng.integers(len(_INSIDE))](rng)
        length, across = np.ptp(np.concatenate([solid.footprint for solid in thing]), axis=0)
        if across < width - _BARRIER_EDGE_M - 0.3 and s + length < end - 0.5:
            place_solids(thing, s + float(length) / 2, -0.2)
        s += length + rng.uniform(0.5, 5.0)


def barrier(length: float, rng: Rng) -> list[Solid]:
    """Barrier of two boards on feet, along x."""
    top = float(rng.uniform(0.9, 1.2))
    foot_top = round(top - 0.62, 2)
    feet = [
        Solid(f.block((0.1, 0.4), (x, 0.0)), 0.0, foot_top, "barrier")
        for x in (-0.4 * length, 0.4 * length)
    ]
    planks = [
        Solid(f.block((length, 0.06)), low, round(low + 0.2, 2), "barrier")
        for low in (round(top - 0.2, 2), round(top - 0.6, 2))
    ]
    return feet + planks


def cone(rng: Rng) -> list[Solid]:
    """Traffic cone."""
    height = float(rng.choice([0.5, 0.75, 1.0]))
    steps = []
    base = 0.0
    for radius, top_share in ((0.19, 0.05), (0.13, 0.4), (0.07, 0.8), (0.04, 1.0)):
        top = round(top_share * height, 3)
        steps.append(Solid(f.disc(0.0, 0.0, radius, 8), base, top, "cone"))
        base = top
    return steps


def beacon(rng: Rng) -> list[Solid]:
    """Guide board on its foot, across the way."""
    top = round(float(rng.uniform(1.0, 1.3)), 2)
    return [
        Solid(f.block((0.4, 0.3)), 0.0, 0.12, "cone"),
        Solid(f.block((0.06, 0.25)), 0.12, top, "cone"),
    ]


def concrete(rng: Rng) -> list[Solid]:
    """Piece of a concrete barrier."""
    top = round(float(rng.uniform(0.75, 0.95)), 2)
    return [
        Solid(f.block((2.0, 0.5)), 0.0, 0.3, "barrier"),
        Solid(f.block((2.0, 0.25)), 0.3, top, "barrier"),
    ]


def fence(rng: Rng) -> list[Solid]:
    """Panel of a see-through site fence."""
    height = round(float(rng.uniform(1.2, 2.0)), 2)
    bars = [
        Solid(f.disc(x, 0.0, 0.03, 6), 0.0, height, "fence") for x in np.linspace(-1.15, 1.15, 9)
    ]
    feet = [Solid(f.block((0.2, 0.5), (x, 0.0)), 0.0, 0.14, "fence") for x in (-1.15, 1.15)]
    rails = [
        Solid(f.block((2.3, 0.05)), low, round(low + 0.05, 2), "fence")
        for low in (0.2, height - 0.05)
    ]
    return bars + feet + rails


_CLOSINGS: tuple[tuple[Make, float], ...] = (
    (cone, 1.5),
    (beacon, 2.0),
    (concrete, 2.1),
    (fence, 2.5),
)


def furnish(
    road: Road, area: Extent, mounts: Sequence[Mount], rng: Rng, *, light: bool = False
) -> tuple[list[Solid], Bays]:
    """Draw solids on level ground, and parking bays x, y, yaw, in and around `area`.

    Strips of the road without bays have road works.

    light: draw islands, trees along kerbs and street furniture only."""
    plot = Plot(road, shapely.box(*area).buffer(25.0, join_style="mitre"), mounts)
    for mount in mounts:
        x, y, _ = mount.position.tolist()
        plot.solids.append(f.post(x, y, round(mount.min_height - POST_AIR_M, 2)))
    kerb = along(road.carriageway.buffer(0.8).boundary.intersection(plot.window), 0.5)
    bays = kerb_bays(plot, road.strips, road.angles, rng)
    if light:
        plant_islands(plot, rng)
        avenues(plot, kerb, rng)
        _furniture(plot, rng)
        return plot.solids, bays
    strips = {edge: strip for edge, strip in road.strips.items() if edge not in road.angles}
    lane_works(plot, strips, rng)
    plant_islands(plot, rng)
    _houses(plot, rng)
    bays = np.concatenate([bays, forecourts(plot, rng)])
    bays = _fill_bays(plot, bays, rng)
    verge_works(plot, rng)
    avenues(plot, kerb, rng)
    _bulky(plot, rng)
    _furniture(plot, rng)
    _gardens(plot, rng)
    if rng.random() < 0.8:
        plot.solids += f.kerbs(road.lanes, road.footways, round(float(rng.uniform(0.06, 0.16)), 2))
    # of the hedges: rays go in, as into bushes
    leafy = rng.random() if rng.random() < 0.75 else 0.0
    solids = [
        replace(s, kind="bush") if s.kind == "hedge" and rng.random() < leafy else s
        for s in plot.solids
    ]
    low_crowns = [s for s in solids if s.kind == "tree" and s.base < UNDERSIDE_M[0]]
    return solids, _free_of(low_crowns, bays)


def _fill_bays(plot: Plot, bays: Bays, rng: Rng) -> Bays:
    """Put skips, containers and the like in some bays, close to vehicles that park.

    Returns the bays that are still free."""
    filled = rng.random(len(bays)) < rng.uniform(0.0, 0.3)
    things = list[Solid]()
    for x, y, yaw in bays[filled]:
        thing = move_solids(
            _INSIDE[rng.integers(len(_INSIDE))](rng), float(x), float(y), float(yaw)
        )
        if unite(solid.footprint for solid in thing).disjoint(plot.driven):
            things += thing
    plot.solids += things
    return _free_of(things, bays[~filled])


def _free_of(solids: Sequence[Solid], bays: Bays) -> Bays:
    """Bays that are free of the solids."""
    if not len(bays):
        return bays
    obstacles = unite(solid.footprint for solid in solids)
    return bays[[obstacles.disjoint(outline(bay).buffer(-0.1)) for bay in bays]]


def _bulky(plot: Plot, rng: Rng) -> None:
    """Place up to 30 car-sized things next to the footway."""
    outer_edge = plot.road.surface.buffer(rng.uniform(1.2, 3.5)).boundary
    behind = along(outer_edge.intersection(plot.window), 0.5)
    kerb_edge = plot.road.carriageway.buffer(rng.uniform(0.9, 1.6)).boundary
    kerb = along(kerb_edge.intersection(plot.window), 0.5)
    green = rng.uniform(0.2, 0.8)
    for at_kerb, rows in ((False, rng.permutation(behind)), (True, rng.permutation(kerb))):
        for x, y, direction in rows[: rng.integers(0, 5 if at_kerb else 26)]:
            makes = PLANTED if rng.random() < green else BUILT
            turn = rng.choice(
                [0.0, np.pi, np.pi / 2, rng.uniform(0.0, np.pi)], p=[0.4, 0.3, 0.15, 0.15]
            )
            thing = makes[rng.integers(len(makes))](rng)
            plot.place(
                move_solids(thing, float(x), float(y), float(direction + turn)), footway=at_kerb
            )


def _houses(plot: Plot, rng: Rng) -> None:
    """Place rows of houses along every leg."""
    density = rng.uniform(0.3, 0.95)
    usual_height = rng.uniform(4.5, 16.0)
    for path, widths in zip(plot.road.paths, plot.road.half_widths, strict=True):
        line = shapely.LineString(path)
        for side, half_width in zip((1, -1), widths, strict=True):
            setback = rng.uniform(0.5, 8.0)
            at = rng.uniform(4.0, 16.0)
            while at < 90.0:
                front = rng.uniform(7.0, 22.0)
                depth = rng.uniform(7.0, 14.0)
                if rng.random() > density:
                    at += front
                    continue
                start = shapely.get_coordinates(line.interpolate(at))[0]
                end = shapely.get_coordinates(line.interpolate(at + front))[0]
                ahead = (end - start) / (np.hypot(*(end - start)) + 1e-9)
                across = np.array([-ahead[1], ahead[0]])
                near = side * (half_width + setback) * across
                far = side * (half_width + setback + depth) * across
                wall = front * ahead
                outline = np.round(
                    [start + near, start + wall + near, start + wall + far, start + far], 3
                )
                height = np.clip(usual_height * rng.lognormal(0.0, 0.3), 4.0, 25.0)
                house = Solid(outline, 0.0, round(float(height), 2), "building")
                if not plot.place([house]):
                    at += 1.5
                    continue
                gap = 0.05 if rng.random() < 0.4 else rng.uniform(1.0, 9.0)
                at += front + gap


def _furniture(plot: Plot, rng: Rng) -> None:
    """Place trees, lamp posts, signs, bins, benches and bollards."""
    kerb = along(plot.road.carriageway.buffer(0.5).boundary.intersection(plot.window), 0.5)
    behind = along(plot.road.surface.buffer(0.9).boundary.intersection(plot.window), 0.5)
    deep = along(plot.road.surface.buffer(2.4).boundary.intersection(plot.window), 0.5)
    lamp = rng.uniform(4.5, 9.0)
    crown = rng.uniform(0.9, 2.2)
    tall = rng.uniform(4.0, 10.0)
    for row in deep[rng.random(len(deep)) < 0.5 / rng.uniform(6, 40)]:
        levels = rng.uniform(1.8, 2.8), tall * rng.uniform(0.8, 1.2)
        plant(plot, row[:2], crown * rng.uniform(0.8, 1.2), levels, rng, footway=False)
    lines: tuple[tuple[np.ndarray, bool, Draw, float], ...] = (
        (
            kerb if rng.random() < 0.6 else behind,
            True,
            lambda x, y, _: [f.post(x, y, lamp, 0.09)],
            rng.uniform(14, 30),
        ),
        (kerb, True, lambda x, y, a: f.sign(x, y, a), rng.uniform(20, 60)),
        (kerb, True, lambda x, y, _: [f.post(x, y, 0.9, 0.07)], rng.uniform(10, 80)),
        (behind, False, lambda x, y, _: [f.litter_bin(x, y)], rng.uniform(20, 60)),
        (behind, False, lambda x, y, a: [f.bench(x, y, a)], rng.uniform(30, 90)),
    )
    for rows, footway, draw, spacing in lines:
        for x, y, direction in rows[rng.random(len(rows)) < 0.5 / spacing]:
            plot.place(draw(float(x), float(y), float(direction)), footway=footway)


def _gardens(plot: Plot, rng: Rng) -> None:
    """Place hedges, walls and fences behind footways, and trees."""
    boundary = plot.road.surface.buffer(rng.uniform(0.8, 2.0)).boundary
    edge = boundary.simplify(0.1).intersection(plot.window)
    kinds = rng.permutation(3)[: rng.integers(1, 4)]
    height = rng.uniform(0.9, 2.2)
    for edge_line in shapely.get_parts(shapely.line_merge(edge)):
        at = rng.uniform(0.0, 15.0)
        while at < edge_line.length - 2.0:
            length = rng.uniform(5.0, 18.0)
            stretch = substring(edge_line, at, min(at + length, edge_line.length)).simplify(0.1)
            points = [(float(x), float(y)) for x, y in shapely.get_coordinates(stretch)]
            draw = (f.hedge, f.wall, f.railing)[rng.choice(kinds)]
            for solid in draw(points, round(height, 2)) if len(points) > 1 else ():
                plot.place([solid])
            at += length + rng.uniform(1.0, 25.0)
    xmin, ymin, xmax, ymax = plot.window.bounds
    for x, y in rng.uniform((xmin, ymin), (xmax, ymax), (rng.integers(5, 60), 2)):
        low = rng.uniform(1.2, 3.0)
        radius = rng.uniform(1.2, 2.8)
        levels = low, low + rng.uniform(2.5, 8.0)
        plant(plot, np.array([x, y]), radius, levels, rng, footway=False)


def count_things(site: Site) -> dict[str, dict[str, int]]:
    """Count the things of a site by origin, then by kind.

    Solids of a kind that touch are one thing: a fence has many. A tree counts once, by its trunk. A
    pole is a mount, and its post counts for nothing more. A drawn road is one thing."""
    counts: dict[str, Counter[str]] = {origin: Counter() for origin in ORIGINS}
    trunks = unite(s.footprint for s in site.solids if s.kind == "trunk").buffer(6.0)
    feet = shapely.MultiPoint([mount.position[:2] for mount in site.mounts]).buffer(0.3)
    grouped: dict[tuple[str, str], list[shapely.Polygon]] = {}
    for solid in site.solids:
        grouped.setdefault((solid.origin, solid.kind), []).append(shapely.Polygon(solid.footprint))
    for (origin, kind), shapes in grouped.items():
        joined = shapely.union_all(shapes)
        if kind != "trunk":
            joined = joined.buffer(_TOUCHING_M / 2)
        parts = shapely.get_parts(joined)
        if kind == "tree":
            parts = parts[~shapely.intersects(parts, trunks)]
        if kind == "post":
            parts = parts[~shapely.intersects(parts, feet)]
        counts[origin][_PART_OF.get(kind, kind)] += len(parts)
    counts[site.road_origin]["road"] += bool(site.lanes)
    for origin in site.bay_origins:
        counts[origin]["bay"] += 1
    for mount in site.mounts:
        counts[mount.origin]["pole"] += 1
    return {origin: dict(sorted((+kinds).items())) for origin, kinds in counts.items()}


def describe_things(counts: Mapping[str, int]) -> str:
    """List counted things in words."""
    return ", ".join(f"{count} {_pluralize(kind, count)}" for kind, count in counts.items())


def _pluralize(kind: str, count: int) -> str:
    """Name of a kind of thing, as many as `count`."""
    if count == 1:
        return kind
    return kind + ("es" if kind.endswith(("sh", "ch")) else "s")


def mark_drawn(solids: Sequence[Solid]) -> list[Solid]:
    """Mark solids as drawn."""
    return [replace(solid, origin="drawn") for solid in solids]


def draw_everything(site: Site) -> Site:
    """Mark everything of a site as drawn."""
    solids = tuple(mark_drawn(site.solids))
    bays = ("drawn",) * len(site.parking)
    mounts = tuple(replace(mount, origin="drawn") for mount in site.mounts)
    return replace(site, solids=solids, mounts=mounts, parking_origins=bays, road_origin="drawn")
