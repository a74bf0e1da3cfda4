"""What stands beside a road, drawn at random: places for sensors, houses, street furniture, gardens and parked cars.

Nothing stands on a lane. On a footway stand only slim things near the kerb.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely.ops import substring

from toolkit.arrays import Float, Float64
from toolkit.sites import furniture as f
from toolkit.sites.site import Mount, Solid

Draw = Callable[[float, float, float], list[Solid]]  # x, y and the direction along the road (rad)

LANE_CLEARANCE = 0.25  # m between a lane and what stands beside it
MOUNT_CLEARANCE = 0.5  # m of air around a mount's axis
POLE = 2.8  # m, height of a mount's own pole: sensors hang above it
BAY = (5.8, 2.6)  # m, length and width of a parking bay


@dataclass(frozen=True, eq=False)
class Road:
    """A road's surface, and the `paths` (k, 2) of its legs with half their widths, left and right (m)."""

    paths: Sequence[Float64[np.ndarray, "_ 2"]]
    half_widths: Sequence[tuple[float, float]]
    lanes: f.Outlines
    footways: f.Outlines

    @cached_property
    def carriageway(self) -> shapely.Geometry:
        """All lanes, cracks between them closed."""
        return _closed(self.lanes, 0.02)

    @cached_property
    def surface(self) -> shapely.Geometry:
        """All lanes and footways, and the slivers between them."""
        return _closed([*self.lanes, *self.footways], 1.2)

    @cached_property
    def islands(self) -> list[shapely.Polygon]:
        """The ground that the road encloses."""
        return [shapely.Polygon(ring) for part in shapely.get_parts(self.surface) for ring in part.interiors]


class Plot:
    """The ground around a road on which things are placed one by one, none on a lane or in another.

    solids: what stands there so far; open: beside the road; lanes: what must stay clear, with LANE_CLEARANCE.
    """

    def __init__(self, road: Road, window: shapely.Geometry, mounts: Iterable[Mount]) -> None:
        self.road, self.window = road, window
        self.solids: list[Solid] = []
        self.open = window.difference(shapely.union_all([road.surface, *road.islands]).buffer(0.3))
        self.lanes = road.carriageway.buffer(LANE_CLEARANCE)
        self._taken = [shapely.Point(m.position[:2]).buffer(MOUNT_CLEARANCE) for m in mounts]
        for geometry in (self.lanes, self.open):
            shapely.prepare(geometry)

    def claim(self, ground: shapely.Geometry, *, footway: bool = False) -> bool:
        """Whether `ground` is free, off the lanes and, unless `footway`, off the footways too; it is taken from now."""
        allowed = not self.lanes.intersects(ground) if footway else self.open.contains(ground)
        if not allowed or shapely.intersects(np.array(self._taken, object), ground).any():
            return False
        self._taken.append(ground)
        return True

    def place(self, solids: Sequence[Solid], *, footway: bool = False) -> bool:
        """Put `solids` there together, if there is room for all of them."""
        ground = shapely.union_all([shapely.Polygon(solid.footprint) for solid in solids])
        if not self.claim(ground, footway=footway):
            return False
        self.solids += solids
        return True


def place_mounts(
    road: Road,
    area: Float[np.ndarray, "4"],
    rng: np.random.Generator,
    *,
    at_least: int = 12,
    spacing: float = 5.0,
    avoid: shapely.Geometry | None = None,
) -> tuple[Mount, ...]:
    """`at_least` to twice as many mounts in and just around `area` and out of `avoid`, most at the kerb and some behind
    the footway, at least `spacing` apart where there is room. Their feet are at z = 0."""
    window = shapely.box(*area).buffer(5.0)
    kerb = _along(road.carriageway.buffer(0.7).boundary.intersection(window), 1.0)
    behind = _along(road.surface.buffer(0.6).boundary.intersection(window), 1.0)
    behind = behind[rng.random(len(behind)) < 0.5]
    candidates = rng.permutation(np.concatenate([kerb, behind]))[:, :2]
    kept_clear = road.carriageway.buffer(0.6).union(avoid or shapely.Polygon())
    clear = ~shapely.intersects_xy(kept_clear, candidates)
    candidates, wanted = candidates[clear], int(rng.integers(at_least, 2 * at_least + 1))
    chosen = _apart(candidates, spacing, wanted)
    while len(chosen) < at_least and spacing > 0.5:
        spacing *= 0.7
        chosen = _apart(candidates, spacing, wanted)
    return tuple(
        Mount(f"pole{i:02}", np.round([x, y, 0.0], 3), 3.0, 10.0, round(float(rng.uniform(0.5, 2.0)), 2))
        for i, (x, y) in enumerate(chosen)
    )


def furnish(
    road: Road, area: Float[np.ndarray, "4"], mounts: Sequence[Mount], rng: np.random.Generator
) -> tuple[list[Solid], Float64[np.ndarray, "n 3"]]:
    """Solids on level ground in and around `area`, and parking bays x, y, yaw beside the road."""
    plot = Plot(road, shapely.box(*area).buffer(25.0, join_style="mitre"), mounts)
    plot.solids += [f.post(float(m.position[0]), float(m.position[1]), POLE) for m in mounts]
    _islands(plot, rng)
    _houses(plot, rng)
    bays = _forecourts(plot, rng)
    _furniture(plot, rng)
    _gardens(plot, rng)
    if rng.random() < 0.8:
        plot.solids += f.kerbs(road.lanes, road.footways, round(float(rng.uniform(0.06, 0.16)), 2))
    return plot.solids, bays


def _houses(plot: Plot, rng: np.random.Generator) -> None:
    """Rows of houses along both sides of every leg, from the corner outwards."""
    density, usual_height = rng.uniform(0.3, 0.95), rng.uniform(4.5, 16.0)
    for path, widths in zip(plot.road.paths, plot.road.half_widths, strict=True):
        for side, half_width in zip((1, -1), widths, strict=True):
            setback = rng.uniform(0.5, 8.0)
            at = rng.uniform(4.0, 16.0)
            while at < 90.0:
                front, depth = rng.uniform(7.0, 22.0), rng.uniform(7.0, 14.0)
                outline = _beside(path, at, front, side * (half_width + setback), side * depth)
                if rng.random() > density:
                    at += front
                    continue
                height = np.clip(usual_height * rng.lognormal(0.0, 0.3), 4.0, 25.0)
                placed = plot.place([Solid(outline, 0.0, round(float(height), 2), "building")])
                at += front + (0.05 if rng.random() < 0.4 else rng.uniform(1.0, 9.0)) if placed else 1.5


def _beside(path: np.ndarray, at: float, length: float, offset: float, depth: float) -> Float64[np.ndarray, "4 2"]:
    """The rectangle along `path` from arc length `at` on, between `offset` and `offset` + `depth` to its left."""
    line = shapely.LineString(path)
    start, end = (shapely.get_coordinates(line.interpolate(s))[0] for s in (at, at + length))
    along = (end - start) / (np.hypot(*(end - start)) + 1e-9)
    across = np.array([-along[1], along[0]])
    near, far = offset * across, (offset + depth) * across
    return np.round([start + near, start + length * along + near, start + length * along + far, start + far], 3)


def _furniture(plot: Plot, rng: np.random.Generator) -> None:
    """Lamp posts, trees, signs, bins, benches and bollards along the kerb and behind the footway."""
    kerb = _along(plot.road.carriageway.buffer(0.5).boundary.intersection(plot.window), 0.5)
    behind = _along(plot.road.surface.buffer(0.9).boundary.intersection(plot.window), 0.5)
    deep = _along(plot.road.surface.buffer(2.4).boundary.intersection(plot.window), 0.5)
    lamp, crown, tall = rng.uniform(4.5, 9.0), rng.uniform(0.9, 2.2), rng.uniform(4.0, 10.0)

    def tree(x: float, y: float, _: float) -> list[Solid]:
        return f.tree(x, y, tall * rng.uniform(0.8, 1.2), crown * rng.uniform(0.8, 1.2), rng.uniform(1.8, 2.8))

    def bench(x: float, y: float, along: float) -> list[Solid]:
        half = 0.9 * np.array([np.cos(along), np.sin(along)])
        ends = np.array([x, y]) + np.stack([-half, half])
        return [Solid(f.bar(tuple(ends[0]), tuple(ends[1]), 0.5), 0.0, 0.5, "bench")]

    lines: tuple[tuple[np.ndarray, bool, Draw, float], ...] = (
        (kerb if rng.random() < 0.6 else behind, True, lambda x, y, _: [f.post(x, y, lamp, 0.09)], rng.uniform(14, 30)),
        (deep, False, tree, rng.uniform(6, 40)),
        (kerb, True, lambda x, y, a: f.sign(x, y, a), rng.uniform(20, 60)),
        (kerb, True, lambda x, y, _: [f.post(x, y, 0.9, 0.07)], rng.uniform(10, 80)),
        (behind, False, lambda x, y, _: [f.litter_bin(x, y)], rng.uniform(20, 60)),
        (behind, False, bench, rng.uniform(30, 90)),
    )
    for rows, footway, draw, every in lines:
        chosen = rows[rng.random(len(rows)) < 0.5 / every]
        for x, y, along in chosen:
            plot.place(draw(float(x), float(y), float(along)), footway=footway)


def _gardens(plot: Plot, rng: np.random.Generator) -> None:
    """Hedges, walls and fences behind the footways, and trees on open ground."""
    edge = plot.road.surface.buffer(rng.uniform(0.8, 2.0)).boundary.simplify(0.1).intersection(plot.window)
    kinds = rng.permutation(3)[: rng.integers(1, 4)]
    height = rng.uniform(0.9, 2.2)
    for part in shapely.get_parts(shapely.line_merge(edge)):
        at = rng.uniform(0.0, 15.0)
        while at < part.length - 2.0:
            length = rng.uniform(5.0, 18.0)
            points = [(float(x), float(y)) for x, y in shapely.get_coordinates(_stretch(part, at, at + length))]
            draw = (f.hedge, f.wall, f.railing)[rng.choice(kinds)]
            for solid in draw(points, round(height, 2)) if len(points) > 1 else ():
                plot.place([solid])
            at += length + rng.uniform(1.0, 25.0)
    xmin, ymin, xmax, ymax = plot.window.bounds
    for x, y in rng.uniform((xmin, ymin), (xmax, ymax), (rng.integers(5, 60), 2)):
        plot.place(f.tree(float(x), float(y), rng.uniform(4.0, 12.0), rng.uniform(1.2, 2.8), rng.uniform(1.2, 3.0)))


def _islands(plot: Plot, rng: np.random.Generator) -> None:
    """Islands enclosed by lanes: kerbed, planted in the middle."""
    for ground in plot.road.islands:
        parts = shapely.get_parts(ground.buffer(-0.3).simplify(0.05).difference(plot.lanes))
        island = max(parts, key=shapely.area, default=shapely.Polygon())
        if island.geom_type != "Polygon" or island.area < 30.0:
            continue
        plot.solids.append(Solid(shapely.get_coordinates(island.exterior)[:-1].round(3), 0.0, 0.15, "island"))
        radius = 0.6 * np.sqrt(island.area / np.pi)
        x, y = (float(c) for c in shapely.get_coordinates(island.centroid)[0])
        if rng.random() < 0.5:
            middle = Solid(f.disc(x, y, radius / 2, 12), 0.0, round(rng.uniform(0.5, 1.5), 2), "hedge")
            plot.place([middle], footway=True)
        for angle in rng.uniform(0, 2 * np.pi, rng.integers(0, 8)):
            reach = radius * rng.uniform(0.3, 1.2)
            at = (x + float(reach * np.cos(angle)), y + float(reach * np.sin(angle)))
            plot.place(f.tree(*at, crown=1.2), footway=True)


def _forecourts(plot: Plot, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """Parking bays behind the footways, along the road or at right angles to it."""
    bays: list[tuple[float, float, float]] = []
    across = rng.random() < 0.5
    line = _along(plot.road.surface.buffer(0.7 + BAY[not across] / 2).boundary.intersection(plot.window), 1.0)
    for x, y, along in rng.permutation(line)[: rng.integers(0, 14)]:
        yaw = along + (np.pi / 2 if across else 0.0) + np.pi * rng.integers(2)
        ahead = BAY[0] / 2 * np.array([np.cos(yaw), np.sin(yaw)])
        bay = f.bar((float(x - ahead[0]), float(y - ahead[1])), (float(x + ahead[0]), float(y + ahead[1])), BAY[1])
        if plot.claim(shapely.Polygon(bay)):
            bays.append((round(float(x), 3), round(float(y), 3), round(float(yaw), 4)))
    return np.array(bays, np.float64).reshape(-1, 3)


def _along(lines: shapely.Geometry, step: float) -> Float64[np.ndarray, "n 3"]:
    """Points every `step` m along `lines` with the direction there: x, y, rad."""
    rows = [np.zeros((0, 3))]
    for part in shapely.get_parts(shapely.line_merge(lines)):
        if part.geom_type != "LineString" or part.length < 2 * step:
            continue
        at = np.arange(step / 2, part.length - step / 2, step)
        here, ahead = (shapely.get_coordinates(part.interpolate(s)) for s in (at, at + step / 2))
        rows.append(np.column_stack([here, np.arctan2(*(ahead - here).T[::-1])]))
    return np.concatenate(rows)


def _apart(points: np.ndarray, spacing: float, wanted: int) -> Float64[np.ndarray, "n 2"]:
    """The first `wanted` of `points` that are `spacing` m or more from those before them."""
    chosen = np.zeros((0, 2))
    for point in points:
        if len(chosen) < wanted and (np.hypot(*(chosen - point).T) >= spacing).all():
            chosen = np.vstack([chosen, point])
    return chosen


def _stretch(line: shapely.LineString, start: float, end: float) -> shapely.LineString:
    return substring(line, start, min(end, line.length)).simplify(0.1)


def _closed(polygons: f.Outlines, gap: float) -> shapely.Geometry:
    """The union of `polygons`, gaps up to twice `gap` (m) filled."""
    union = shapely.union_all([shapely.Polygon(p) for p in polygons])
    return union.buffer(gap, join_style="mitre", quad_segs=2).buffer(-gap, join_style="mitre", quad_segs=2)
