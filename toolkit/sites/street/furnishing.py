"""All that stands in and beside a drawn street, in the order in which it is given its ground."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import shapely
from shapely.ops import substring

from toolkit.arrays import Float, Float64
from toolkit.sites import furniture as f
from toolkit.sites.site import Mount, Solid
from toolkit.sites.street.bays import Strip, forecourts, kerb_bays
from toolkit.sites.street.bulky import BUILT, PLANTED, put_at
from toolkit.sites.street.islands import plant_islands
from toolkit.sites.street.trees import avenues, plant
from toolkit.sites.street.works import lane_works, verge_works
from toolkit.sites.surroundings import Plot, Road, along

FOOT_AIR = 0.2  # m from the top of a mount's own post to the lowest sensor on it
Draw = Callable[[float, float, float], list[Solid]]  # x, y and the direction along the road (rad)


def furnish(
    road: Road,
    area: Float[np.ndarray, "4"],
    mounts: Sequence[Mount],
    rng: np.random.Generator,
    *,
    strips: Mapping[str, Strip] | None = None,
    angles: Mapping[str, int] | None = None,
) -> tuple[list[Solid], Float64[np.ndarray, "n 3"]]:
    """Solids on level ground in and around `area`, and parking bays x, y, yaw in the road and beside it.

    strips: shoulders of the road by edge; angles: of the bays on those that have bays (degrees), road works are on the
    others.
    """
    strips, angles = strips or {}, angles or {}
    plot = Plot(road, shapely.box(*area).buffer(25.0, join_style="mitre"), mounts)
    posts = [(*(float(c) for c in m.position[:2]), round(m.min_height - FOOT_AIR, 2)) for m in mounts]
    plot.solids += [f.post(x, y, height) for x, y, height in posts]
    kerb = along(road.carriageway.buffer(0.8).boundary.intersection(plot.window), 0.5)
    bays = kerb_bays(plot, strips, angles, rng)
    lane_works(plot, {edge: strip for edge, strip in strips.items() if edge not in angles}, rng)
    plant_islands(plot, rng)
    _houses(plot, rng)
    bays = np.concatenate([bays, forecourts(plot, rng)])
    verge_works(plot, rng)
    avenues(plot, kerb, rng)
    _bulky(plot, rng)
    _furniture(plot, rng)
    _gardens(plot, rng)
    if rng.random() < 0.8:
        plot.solids += f.kerbs(road.lanes, road.footways, round(float(rng.uniform(0.06, 0.16)), 2))
    return plot.solids, bays


def _bulky(plot: Plot, rng: np.random.Generator) -> None:
    """Up to 30 things as big as cars at the back of the footway or at its kerb, most of them along the road."""
    behind = along(plot.road.surface.buffer(rng.uniform(1.2, 3.5)).boundary.intersection(plot.window), 0.5)
    kerb = along(plot.road.carriageway.buffer(rng.uniform(0.9, 1.6)).boundary.intersection(plot.window), 0.5)
    green = rng.uniform(0.2, 0.8)
    for at_kerb, rows in ((False, rng.permutation(behind)), (True, rng.permutation(kerb))):
        for x, y, direction in rows[: rng.integers(0, 5 if at_kerb else 26)]:
            makes = PLANTED if rng.random() < green else BUILT
            turn = rng.choice([0.0, np.pi, np.pi / 2, rng.uniform(0.0, np.pi)], p=[0.4, 0.3, 0.15, 0.15])
            thing = makes[rng.integers(len(makes))](rng)
            plot.place(put_at(thing, float(x), float(y), float(direction + turn)), footway=at_kerb)


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
    """Trees, lamp posts, signs, bins, benches and bollards along the kerb and behind the footway."""
    kerb = along(plot.road.carriageway.buffer(0.5).boundary.intersection(plot.window), 0.5)
    behind = along(plot.road.surface.buffer(0.9).boundary.intersection(plot.window), 0.5)
    deep = along(plot.road.surface.buffer(2.4).boundary.intersection(plot.window), 0.5)
    lamp, crown, tall = rng.uniform(4.5, 9.0), rng.uniform(0.9, 2.2), rng.uniform(4.0, 10.0)
    trees = deep[rng.random(len(deep)) < 0.5 / rng.uniform(6, 40)]
    for row in trees:
        levels = rng.uniform(1.8, 2.8), tall * rng.uniform(0.8, 1.2)
        plant(plot, row[:2], crown * rng.uniform(0.8, 1.2), levels, rng, footway=False)

    def bench(x: float, y: float, along: float) -> list[Solid]:
        half = 0.9 * np.array([np.cos(along), np.sin(along)])
        ends = np.array([x, y]) + np.stack([-half, half])
        return [Solid(f.bar(tuple(ends[0]), tuple(ends[1]), 0.5), 0.0, 0.5, "bench")]

    lines: tuple[tuple[np.ndarray, bool, Draw, float], ...] = (
        (kerb if rng.random() < 0.6 else behind, True, lambda x, y, _: [f.post(x, y, lamp, 0.09)], rng.uniform(14, 30)),
        (kerb, True, lambda x, y, a: f.sign(x, y, a), rng.uniform(20, 60)),
        (kerb, True, lambda x, y, _: [f.post(x, y, 0.9, 0.07)], rng.uniform(10, 80)),
        (behind, False, lambda x, y, _: [f.litter_bin(x, y)], rng.uniform(20, 60)),
        (behind, False, bench, rng.uniform(30, 90)),
    )
    for rows, footway, draw, every in lines:
        chosen = rows[rng.random(len(rows)) < 0.5 / every]
        for x, y, direction in chosen:
            plot.place(draw(float(x), float(y), float(direction)), footway=footway)


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
        low = rng.uniform(1.2, 3.0)
        plant(plot, np.array([x, y]), rng.uniform(1.2, 2.8), (low, low + rng.uniform(2.5, 8.0)), rng, footway=False)


def _stretch(line: shapely.LineString, start: float, end: float) -> shapely.LineString:
    return substring(line, start, min(end, line.length)).simplify(0.1)
