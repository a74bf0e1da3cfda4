"""Furnishing of a street and its sides: whatever is drawn first gets its ground first.

A tree's crown is several clumps of leaves with gaps between them. It keeps clear of walls and places for sensors, and
traffic passes below it: only the trunk takes ground. Islands are kerbed, planted and signed. Road works lie off the
lanes that are driven, closed off by cones, barriers or a fence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import shapely
from shapely.ops import substring

from toolkit.arrays import Points, Rng
from toolkit.sites import furniture as f
from toolkit.sites.furniture import BUILT, PLANTED, Make, bushes, container, digger, heap, move_solids, skip
from toolkit.sites.network import unite
from toolkit.sites.site import Mount, Solid
from toolkit.sites.surroundings import Bays, Extent, Plot, Road, Strip, along, forecourts, kerb_bays

UNDERSIDE = (2.5, 5.0)  # m above the ground, of a crown over lanes or bays, from .. to
OVER_ROAD = (3.0, 9.0)  # m, how wide such a crown is, from .. to
_TRIMMED = 4.2  # m, underside where tall vehicles are expected
_MOUNT_AIR = 1.0  # m between a crown and a mount's axis
_SLIMMEST = 1.0  # m, radius of the smallest crown that is planted


def avenues(plot: Plot, kerb: Points, rng: Rng) -> None:
    """Plant rows of trees with crowns over the road along `kerb` (x, y, direction every 0.5 m), at most sites."""
    if rng.random() > 0.6 or not len(kerb):
        return
    planted, every = rng.uniform(0.3, 0.9), rng.uniform(5.0, 13.0)
    wide, tall = rng.uniform(*OVER_ROAD), rng.uniform(2.5, 6.0)
    low = rng.uniform(_TRIMMED, UNDERSIDE[1]) if rng.random() < 0.5 else rng.uniform(UNDERSIDE[0], _TRIMMED)
    step = max(1, round(every / 0.5))
    for row in kerb[int(rng.integers(step)) :: step]:
        if rng.random() > planted:
            continue
        width = float(np.clip(wide * rng.uniform(0.8, 1.2), *OVER_ROAD))
        underside = float(np.clip(low + rng.normal(0.0, 0.3), *UNDERSIDE))
        plant(plot, row[:2], width / 2, (underside, underside + tall * rng.uniform(0.8, 1.2)), rng)


def plant(plot: Plot, foot: np.ndarray, radius: float, levels: f.Span, rng: Rng, *, footway: bool = True) -> bool:
    """Plant a tree at `foot`; return False if there is no room.

    radius: of the crown, less near walls and mounts, and off the road if it hangs too low; levels: its ends (m).
    """
    x, y = (round(float(c), 3) for c in foot)
    spot = shapely.Point(x, y)
    houses = [shapely.Polygon(solid.footprint) for solid in plot.solids if solid.kind == "building"]
    gaps = [*(np.hypot(*(plot.mounts - [x, y]).T) - _MOUNT_AIR), *shapely.distance(spot, np.array(houses, object))]
    gaps += [] if levels[0] >= UNDERSIDE[0] else [shapely.distance(spot, plot.lanes)]
    radius = float(min([radius, *gaps]))
    trunk = f.disc(x, y, round(float(rng.uniform(0.1, 0.16 + 0.04 * radius)), 2))
    if radius < _SLIMMEST or not plot.claim(shapely.Polygon(trunk), footway=footway):
        return False
    low, high = (round(level, 2) for level in levels)
    plot.solids += [Solid(trunk, 0.0, round(low + 0.3 * (high - low), 2), "trunk")]
    plot.solids += clumps(x, y, radius, (low, high), rng)
    return True


def clumps(x: float, y: float, radius: float, levels: f.Span, rng: Rng) -> list[Solid]:
    """Draw a crown of 3 to 8 overlapping clumps."""
    low, high = levels
    number = int(rng.integers(3, 9))
    around = rng.uniform(0, 2 * np.pi) + np.arange(number) * 2 * np.pi / number + rng.normal(0.0, 0.3, number)
    made = []
    for k, angle in enumerate(around):
        size = radius * rng.uniform(0.4, 0.65)
        out = (radius - size) * rng.uniform(0.7, 1.0)
        bottom = low if k == 0 else low + (high - low) * rng.uniform(0.0, 0.4)
        top = high if k == 1 else bottom + (high - bottom) * rng.uniform(0.5, 1.0)
        outline = f.disc(x + float(out * np.cos(angle)), y + float(out * np.sin(angle)), float(size), 7)
        made.append(Solid(outline, round(float(bottom), 2), round(float(top), 2), "tree"))
    return made


_SMALLEST = 30.0  # m², smallest island with solids on it


def plant_islands(plot: Plot, rng: Rng) -> None:
    """Put a centre piece, rings of hedges, bushes and signs on every large enough island of the road."""
    for ground in plot.road.islands:
        parts = shapely.get_parts(ground.buffer(-0.3).simplify(0.05).difference(plot.lanes))
        island = max(parts, key=shapely.area, default=shapely.Polygon())
        if island.geom_type != "Polygon" or island.area < _SMALLEST:
            continue
        plot.solids.append(Solid(shapely.get_coordinates(island.exterior)[:-1].round(3), 0.0, 0.15, "island"))
        x, y = (float(c) for c in shapely.get_coordinates(island.centroid)[0])
        middle, radius = (x, y), float(np.sqrt(island.area / np.pi))
        if rng.random() < 0.5:
            size, height = rng.uniform(0.15, 0.4) * radius, round(float(rng.uniform(0.5, 2.5)), 2)
            kind = ("hedge", "wall", "heap", "bush")[rng.integers(4)]
            plot.place([Solid(f.disc(x, y, float(size), 12), 0.0, height, kind)], footway=True)
        for out in np.sort(rng.uniform(0.35, 0.92, rng.integers(0, 4))) * radius:
            _ring(plot, middle, float(out), rng)
        makes = (*PLANTED, *PLANTED, *BUILT)
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


def _ring(plot: Plot, middle: tuple[float, float], out: float, rng: Rng) -> None:
    """Place hedges or bushes in a ring with gaps."""
    length, width, height = (float(rng.uniform(*between)) for between in ((1.0, 5.0), (0.6, 2.2), (0.5, 1.8)))
    step = (length + rng.uniform(0.1, 4.0)) / out
    turn, kept = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.0)
    is_round = rng.random() < 0.4
    for angle in np.arange(turn, turn + 2 * np.pi - step / 2, step)[:60]:
        at, tall = _around(middle, out, angle), round(height * float(rng.uniform(0.8, 1.2)), 2)
        if rng.random() > kept:
            continue
        shape = f.disc(*at, 0.35 * length, 9) if is_round else f.block((length, width), at, angle + np.pi / 2)
        kind = ("hedge", "bush")[rng.integers(2)] if is_round else "hedge"
        plot.place([Solid(shape, 0.0, tall, kind)], footway=True)


def _around(middle: tuple[float, float], out: float, angle: float) -> tuple[float, float]:
    return float(middle[0] + out * np.cos(angle)), float(middle[1] + out * np.sin(angle))


CLOSED_LANE = (2.6, 3.6)  # m, how wide a lane closed for works is, from .. to
_EDGE = 0.45  # m between the edge of the strip and its barrier
_INSIDE: tuple[Make, ...] = (container, skip, digger, digger, heap, heap, bushes)


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
    """Put up to three small works beside the footways."""
    edge = along(plot.road.surface.buffer(2.0).boundary.intersection(plot.window), 2.0)
    for x, y, direction in rng.permutation(edge)[: rng.integers(0, 4)]:
        ahead = 9.0 * np.array([np.cos(direction), np.sin(direction)])
        path = shapely.LineString([(x, y), (x + ahead[0], y + ahead[1])])
        _put_works(plot, path, (0.0, float(rng.uniform(4.0, 9.0))), float(rng.uniform(2.0, 3.0)), rng, shoulder=False)


def _put_works(
    plot: Plot, path: shapely.LineString, stretch: f.Span, width: float, rng: Rng, *, shoulder: bool
) -> None:
    start, end = stretch

    def put(solids: list[Solid], s: float, left: float, turn: float = 0.0) -> None:
        (x, y), ahead = (shapely.get_coordinates(path.interpolate(at))[0] for at in (s, s + 0.5))
        yaw = float(np.arctan2(ahead[1] - y, ahead[0] - x))
        spot = float(x - left * np.sin(yaw)), float(y + left * np.cos(yaw))
        plot.place(move_solids(solids, *spot, yaw + turn), shoulder=shoulder)

    for s in (start, end):
        put(barrier(width - 2 * _EDGE - 0.3, rng), s, 0.0, np.pi / 2)
    side = width / 2 - _EDGE
    closing, every = _CLOSINGS[rng.integers(len(_CLOSINGS))]
    for s in np.arange(start + 1.0, end - 0.5, every + rng.uniform(0.05, 1.5)):
        put(closing(rng), float(s), side)
    s = start + rng.uniform(1.0, 3.0)
    while s < end - 1.5:
        thing = _INSIDE[rng.integers(len(_INSIDE))](rng)
        length, across = np.ptp(np.concatenate([solid.footprint for solid in thing]), axis=0)
        if across < width - _EDGE - 0.3 and s + length < end - 0.5:
            put(thing, s + float(length) / 2, -0.2)
        s += length + rng.uniform(0.5, 5.0)


def barrier(length: float, rng: Rng) -> list[Solid]:
    """Barrier of two boards on feet, along x."""
    top = float(rng.uniform(0.9, 1.2))
    levels = [round(top - below, 2) for below in (0.2, 0.6)]
    feet = [Solid(f.block((0.1, 0.4), (k * 0.4 * length, 0.0)), 0.0, round(top - 0.62, 2), "barrier") for k in (-1, 1)]
    return feet + [Solid(f.block((length, 0.06)), low, round(low + 0.2, 2), "barrier") for low in levels]


def cone(rng: Rng) -> list[Solid]:
    """Traffic cone."""
    height = float(rng.choice([0.5, 0.75, 1.0]))
    steps = [(0.19, 0.0, 0.05), (0.13, 0.05, 0.4), (0.07, 0.4, 0.8), (0.04, 0.8, 1.0)]
    return [Solid(f.disc(0.0, 0.0, r, 8), round(a * height, 3), round(b * height, 3), "cone") for r, a, b in steps]


def beacon(rng: Rng) -> list[Solid]:
    """Guide board on its foot, across the way."""
    top = round(float(rng.uniform(1.0, 1.3)), 2)
    return [Solid(f.block((0.4, 0.3)), 0.0, 0.12, "cone"), Solid(f.block((0.06, 0.25)), 0.12, top, "cone")]


def concrete(rng: Rng) -> list[Solid]:
    """Piece of a concrete barrier."""
    top = round(float(rng.uniform(0.75, 0.95)), 2)
    return [Solid(f.block((2.0, 0.5)), 0.0, 0.3, "barrier"), Solid(f.block((2.0, 0.25)), 0.3, top, "barrier")]


def fence(rng: Rng) -> list[Solid]:
    """Panel of a see-through site fence."""
    height = round(float(rng.uniform(1.2, 2.0)), 2)
    bars = [Solid(f.disc(x, 0.0, 0.03, 6), 0.0, height, "fence") for x in np.linspace(-1.15, 1.15, 9)]
    feet = [Solid(f.block((0.2, 0.5), (x, 0.0)), 0.0, 0.14, "fence") for x in (-1.15, 1.15)]
    return [*bars, *feet, *(Solid(f.block((2.3, 0.05)), z, round(z + 0.05, 2), "fence") for z in (0.2, height - 0.05))]


_CLOSINGS: tuple[tuple[Make, float], ...] = ((cone, 1.5), (beacon, 2.0), (concrete, 2.1), (fence, 2.5))


FOOT_AIR = 0.2  # m from the top of a mount's own post to the lowest sensor on it
Draw = Callable[[float, float, float], list[Solid]]  # x, y and the direction along the road (rad)


def furnish(
    road: Road, area: Extent, mounts: Sequence[Mount], rng: Rng, *, light: bool = False
) -> tuple[list[Solid], Bays]:
    """Draw solids on level ground, and parking bays x, y, yaw, in and around `area`.

    Strips of the road without bays have road works. light: draw islands, trees along kerbs and street furniture only.
    """
    plot = Plot(road, shapely.box(*area).buffer(25.0, join_style="mitre"), mounts)
    for mount in mounts:
        x, y, _ = mount.position.tolist()
        plot.solids.append(f.post(x, y, round(mount.min_height - FOOT_AIR, 2)))
    kerb = along(road.carriageway.buffer(0.8).boundary.intersection(plot.window), 0.5)
    bays = kerb_bays(plot, road.strips, road.angles, rng)
    if light:
        plant_islands(plot, rng)
        avenues(plot, kerb, rng)
        _furniture(plot, rng)
        return plot.solids, bays
    lane_works(plot, {edge: strip for edge, strip in road.strips.items() if edge not in road.angles}, rng)
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
    leafy = rng.random() if rng.random() < 0.75 else 0.0  # of the hedges: rays go in, as into bushes
    solids = [replace(s, kind="bush") if s.kind == "hedge" and rng.random() < leafy else s for s in plot.solids]
    return solids, bays


def _fill_bays(plot: Plot, bays: Bays, rng: Rng) -> Bays:
    """Put skips, containers and the like in some bays, close to vehicles that park; return the bays left."""
    filled = rng.random(len(bays)) < rng.uniform(0.0, 0.3)
    for x, y, yaw in bays[filled]:
        thing = move_solids(_INSIDE[rng.integers(len(_INSIDE))](rng), float(x), float(y), float(yaw))
        if unite(solid.footprint for solid in thing).disjoint(plot.driven):
            plot.solids += thing
    return bays[~filled]


def _bulky(plot: Plot, rng: Rng) -> None:
    """Place up to 30 car-sized things beside the footway."""
    behind = along(plot.road.surface.buffer(rng.uniform(1.2, 3.5)).boundary.intersection(plot.window), 0.5)
    kerb = along(plot.road.carriageway.buffer(rng.uniform(0.9, 1.6)).boundary.intersection(plot.window), 0.5)
    green = rng.uniform(0.2, 0.8)
    for at_kerb, rows in ((False, rng.permutation(behind)), (True, rng.permutation(kerb))):
        for x, y, direction in rows[: rng.integers(0, 5 if at_kerb else 26)]:
            makes = PLANTED if rng.random() < green else BUILT
            turn = rng.choice([0.0, np.pi, np.pi / 2, rng.uniform(0.0, np.pi)], p=[0.4, 0.3, 0.15, 0.15])
            thing = makes[rng.integers(len(makes))](rng)
            plot.place(move_solids(thing, float(x), float(y), float(direction + turn)), footway=at_kerb)


def _houses(plot: Plot, rng: Rng) -> None:
    """Place rows of houses along every leg."""
    density, usual_height = rng.uniform(0.3, 0.95), rng.uniform(4.5, 16.0)
    for path, widths in zip(plot.road.paths, plot.road.half_widths, strict=True):
        line = shapely.LineString(path)
        for side, half_width in zip((1, -1), widths, strict=True):
            setback = rng.uniform(0.5, 8.0)
            at = rng.uniform(4.0, 16.0)
            while at < 90.0:
                front, depth = rng.uniform(7.0, 22.0), rng.uniform(7.0, 14.0)
                if rng.random() > density:
                    at += front
                    continue
                start, end = (shapely.get_coordinates(line.interpolate(s))[0] for s in (at, at + front))
                ahead = (end - start) / (np.hypot(*(end - start)) + 1e-9)
                across = np.array([-ahead[1], ahead[0]])
                near, far = side * (half_width + setback) * across, side * (half_width + setback + depth) * across
                wall = front * ahead
                outline = np.round([start + near, start + wall + near, start + wall + far, start + far], 3)
                height = np.clip(usual_height * rng.lognormal(0.0, 0.3), 4.0, 25.0)
                placed = plot.place([Solid(outline, 0.0, round(float(height), 2), "building")])
                at += front + (0.05 if rng.random() < 0.4 else rng.uniform(1.0, 9.0)) if placed else 1.5


def _furniture(plot: Plot, rng: Rng) -> None:
    """Place trees, lamp posts, signs, bins, benches and bollards."""
    kerb = along(plot.road.carriageway.buffer(0.5).boundary.intersection(plot.window), 0.5)
    behind = along(plot.road.surface.buffer(0.9).boundary.intersection(plot.window), 0.5)
    deep = along(plot.road.surface.buffer(2.4).boundary.intersection(plot.window), 0.5)
    lamp, crown, tall = rng.uniform(4.5, 9.0), rng.uniform(0.9, 2.2), rng.uniform(4.0, 10.0)
    for row in deep[rng.random(len(deep)) < 0.5 / rng.uniform(6, 40)]:
        levels = rng.uniform(1.8, 2.8), tall * rng.uniform(0.8, 1.2)
        plant(plot, row[:2], crown * rng.uniform(0.8, 1.2), levels, rng, footway=False)
    lines: tuple[tuple[np.ndarray, bool, Draw, float], ...] = (
        (kerb if rng.random() < 0.6 else behind, True, lambda x, y, _: [f.post(x, y, lamp, 0.09)], rng.uniform(14, 30)),
        (kerb, True, lambda x, y, a: f.sign(x, y, a), rng.uniform(20, 60)),
        (kerb, True, lambda x, y, _: [f.post(x, y, 0.9, 0.07)], rng.uniform(10, 80)),
        (behind, False, lambda x, y, _: [f.litter_bin(x, y)], rng.uniform(20, 60)),
        (behind, False, lambda x, y, a: [f.bench(x, y, a)], rng.uniform(30, 90)),
    )
    for rows, footway, draw, every in lines:
        for x, y, direction in rows[rng.random(len(rows)) < 0.5 / every]:
            plot.place(draw(float(x), float(y), float(direction)), footway=footway)


def _gardens(plot: Plot, rng: Rng) -> None:
    """Place hedges, walls and fences behind footways, and trees."""
    edge = plot.road.surface.buffer(rng.uniform(0.8, 2.0)).boundary.simplify(0.1).intersection(plot.window)
    kinds = rng.permutation(3)[: rng.integers(1, 4)]
    height = rng.uniform(0.9, 2.2)
    for part in shapely.get_parts(shapely.line_merge(edge)):
        at = rng.uniform(0.0, 15.0)
        while at < part.length - 2.0:
            length = rng.uniform(5.0, 18.0)
            stretch = substring(part, at, min(at + length, part.length)).simplify(0.1)
            points = [(float(x), float(y)) for x, y in shapely.get_coordinates(stretch)]
            draw = (f.hedge, f.wall, f.railing)[rng.choice(kinds)]
            for solid in draw(points, round(height, 2)) if len(points) > 1 else ():
                plot.place([solid])
            at += length + rng.uniform(1.0, 25.0)
    xmin, ymin, xmax, ymax = plot.window.bounds
    for x, y in rng.uniform((xmin, ymin), (xmax, ymax), (rng.integers(5, 60), 2)):
        low = rng.uniform(1.2, 3.0)
        plant(plot, np.array([x, y]), rng.uniform(1.2, 2.8), (low, low + rng.uniform(2.5, 8.0)), rng, footway=False)
