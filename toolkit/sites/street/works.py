"""Road works off the lanes that are driven: a strip closed by cones, barriers or a fence, and what is left in it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import shapely

from toolkit.sites import furniture as f
from toolkit.sites.site import Solid
from toolkit.sites.street.bays import Strip
from toolkit.sites.street.bulky import Make, bushes, container, digger, heap, put_at, skip
from toolkit.sites.surroundings import Plot, along

CLOSED_LANE = (2.6, 3.6)  # m, how wide a lane closed for works is, from .. to
_EDGE = 0.45  # m between the edge of the strip and what closes it off
_INSIDE: tuple[Make, ...] = (container, skip, digger, digger, heap, heap, bushes)


def lane_works(plot: Plot, strips: Mapping[str, Strip], rng: np.random.Generator) -> None:
    """Works on a stretch of each of `strips`, near the junction; its traffic passes on the left."""
    for edge, (line, width) in strips.items():
        path = shapely.LineString(line)
        length = min(float(rng.uniform(10.0, 32.0)), path.length - 10.0)
        start = float(rng.uniform(4.0, 22.0))
        first = path.length - start - length if edge.startswith("in") else start
        if first > 0 and length > 6.0:
            _work(plot, path, (first, first + length), width, rng, shoulder=True)


def verge_works(plot: Plot, rng: np.random.Generator) -> None:
    """Up to three small works beside the footways."""
    edge = along(plot.road.surface.buffer(2.0).boundary.intersection(plot.window), 2.0)
    for x, y, direction in rng.permutation(edge)[: rng.integers(0, 4)]:
        ahead = 9.0 * np.array([np.cos(direction), np.sin(direction)])
        path = shapely.LineString([(x, y), (x + ahead[0], y + ahead[1])])
        _work(plot, path, (0.0, float(rng.uniform(4.0, 9.0))), float(rng.uniform(2.0, 3.0)), rng, shoulder=False)


def _work(
    plot: Plot,
    path: shapely.LineString,
    stretch: tuple[float, float],
    width: float,
    rng: np.random.Generator,
    *,
    shoulder: bool,
) -> None:
    start, end = stretch

    def put(solids: list[Solid], s: float, left: float, turn: float = 0.0) -> bool:
        x, y, yaw = _at(path, s, left)
        return plot.place(put_at(solids, x, y, yaw + turn), shoulder=shoulder)

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


def barrier(length: float, rng: np.random.Generator) -> list[Solid]:
    """Two boards one over the other on feet, `length` (m) along x."""
    top = float(rng.uniform(0.9, 1.2))
    levels = [round(top - below, 2) for below in (0.2, 0.6)]
    feet = [Solid(f.block((0.1, 0.4), (k * 0.4 * length, 0.0)), 0.0, round(top - 0.62, 2), "barrier") for k in (-1, 1)]
    return feet + [Solid(f.block((length, 0.06)), low, round(low + 0.2, 2), "barrier") for low in levels]


def cone(rng: np.random.Generator) -> list[Solid]:
    """A traffic cone."""
    height = float(rng.choice([0.5, 0.75, 1.0]))
    steps = [(0.19, 0.0, 0.05), (0.13, 0.05, 0.4), (0.07, 0.4, 0.8), (0.04, 0.8, 1.0)]
    return [Solid(f.disc(0.0, 0.0, r, 8), round(a * height, 3), round(b * height, 3), "cone") for r, a, b in steps]


def beacon(rng: np.random.Generator) -> list[Solid]:
    """A guide board on its foot, across the way."""
    return [
        Solid(f.block((0.4, 0.3)), 0.0, 0.12, "cone"),
        Solid(f.block((0.06, 0.25)), 0.12, round(float(rng.uniform(1.0, 1.3)), 2), "cone"),
    ]


def concrete(rng: np.random.Generator) -> list[Solid]:
    """A piece of concrete barrier."""
    return [
        Solid(f.block((2.0, 0.5)), 0.0, 0.3, "barrier"),
        Solid(f.block((2.0, 0.25)), 0.3, round(float(rng.uniform(0.75, 0.95)), 2), "barrier"),
    ]


def fence(rng: np.random.Generator) -> list[Solid]:
    """A panel of a site fence one can look through."""
    height = round(float(rng.uniform(1.2, 2.0)), 2)
    bars = [Solid(f.disc(x, 0.0, 0.03, 6), 0.0, height, "fence") for x in np.linspace(-1.15, 1.15, 9)]
    feet = [Solid(f.block((0.2, 0.5), (x, 0.0)), 0.0, 0.14, "fence") for x in (-1.15, 1.15)]
    return [*bars, *feet, *(Solid(f.block((2.3, 0.05)), z, round(z + 0.05, 2), "fence") for z in (0.2, height - 0.05))]


_CLOSINGS: tuple[tuple[Make, float], ...] = ((cone, 1.5), (beacon, 2.0), (concrete, 2.1), (fence, 2.5))


def _at(path: shapely.LineString, s: float, left: float) -> tuple[float, float, float]:
    """The point `left` m beside the path at arc length s, and the direction there."""
    (x, y), ahead = (shapely.get_coordinates(path.interpolate(at))[0] for at in (s, s + 0.5))
    yaw = float(np.arctan2(ahead[1] - y, ahead[0] - x))
    return float(x - left * np.sin(yaw)), float(y + left * np.cos(yaw)), yaw
