"""Street furniture as solids on level ground, and `settle` for uneven ground.

Things about as big as a car, such as hedges, containers and skips, are what a detector mistakes for
one, so a drawn street holds plenty of them. They are made about the origin, lengthwise along x;
`move_solids` puts them in place."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Rng
from toolkit.mesh import Span as Span
from toolkit.sites.network import unite
from toolkit.sites.site import Mount, Relief, Site, Solid

Point = tuple[float, float]

Outlines = Iterable[Float[np.ndarray, "_ 2"]]


def rectangle(xmin: float, ymin: float, xmax: float, ymax: float) -> Float64[np.ndarray, "4 2"]:
    """Rectangle along x and y, counter-clockwise."""
    return np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]], np.float64)


def disc(x: float, y: float, radius: float, corners: int = 8) -> Float64[np.ndarray, "k 2"]:
    """Regular polygon around (x, y), on millimetres."""
    angles = np.arange(corners) * 2 * np.pi / corners
    return np.round(np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], axis=1), 3)


def bar(start: Point, end: Point, width: float) -> Float64[np.ndarray, "4 2"]:
    """Strip of `width` from start to end, on millimetres."""
    along = np.subtract(end, start)
    across = np.array([-along[1], along[0]]) / np.hypot(*along) * width / 2
    return np.round(np.array([start - across, end - across, end + across, start + across]), 3)


def block(size: Point, middle: Point = (0.0, 0.0), yaw: float = 0.0) -> Float64[np.ndarray, "4 2"]:
    """Rectangle (m) about `middle`; yaw: direction of its length."""
    ahead = size[0] / 2 * np.array([np.cos(yaw), np.sin(yaw)])
    start = float(middle[0] - ahead[0]), float(middle[1] - ahead[1])
    end = float(middle[0] + ahead[0]), float(middle[1] + ahead[1])
    return bar(start, end, size[1])


def post(x: float, y: float, height: float, radius: float = 0.08) -> Solid:
    """Lamp, sensor or sign post."""
    return Solid(disc(x, y, radius), 0.0, height, "post")


def sign(x: float, y: float, facing: float) -> list[Solid]:
    """Traffic sign on its post, its face towards `facing` (rad)."""
    plate = block((0.7, 0.06), (x, y), facing + np.pi / 2)
    return [post(x, y, 2.2, 0.04), Solid(plate, 2.2, 2.9, "sign")]


def tree(
    x: float, y: float, height: float = 7.0, crown: float = 1.6, clear: float = 2.3
) -> list[Solid]:
    """Trunk, and a crown from `clear` m up to `height`.

    crown: its radius (m), less at its foot and top."""
    low = clear + 0.25 * (height - clear)
    high = clear + 0.7 * (height - clear)
    return [
        Solid(disc(x, y, 0.16), 0.0, clear, "trunk"),
        Solid(disc(x, y, 0.75 * crown), clear, low, "tree"),
        Solid(disc(x, y, 1.0 * crown), low, high, "tree"),
        Solid(disc(x, y, 0.6 * crown), high, height, "tree"),
    ]


def litter_bin(x: float, y: float) -> Solid:
    """Litter bin."""
    return Solid(disc(x, y, 0.28), 0.0, 1.0, "bin")


def bench(x: float, y: float, along: float = 0.0) -> Solid:
    """Bench 1.8 m long. along: its direction (rad)."""
    return Solid(block((1.8, 0.5), (x, y), along), 0.0, 0.5, "bench")


def hedge(line: Sequence[Point], height: float = 1.4) -> list[Solid]:
    """Hedge along `line`."""
    return [Solid(bar(*piece, 0.7), 0.0, height, "hedge") for piece in _pieces(line, 6.0)]


def wall(line: Sequence[Point], height: float = 1.8, width: float = 0.25) -> list[Solid]:
    """Wall along `line`."""
    return [Solid(bar(*piece, width), 0.0, height, "wall") for piece in _pieces(line, 8.0)]


def railing(line: Sequence[Point], height: float = 1.1) -> list[Solid]:
    """See-through fence: posts every 2.5 m and two rails."""
    pieces = _pieces(line, 2.5)
    uprights = [Solid(disc(*start, 0.05), 0.0, height, "fence") for start, _ in pieces]
    levels = ((0.5 * height - 0.05, 0.5 * height + 0.05), (height - 0.1, height))
    return uprights + [
        Solid(bar(*piece, 0.06), *level, "fence") for piece in pieces for level in levels
    ]


def kerbs(lanes: Outlines, footways: Outlines, height: float = 0.12) -> list[Solid]:
    """Kerbstones on the footway's side of the road's edges."""
    road = unite(lanes).buffer(0.01)
    walk = unite(footways)
    if walk.is_empty:
        return []
    edge = shapely.line_merge(shapely.intersection(walk.boundary, road)).simplify(0.02)
    return set_kerbs(edge, road, (0.15, height), broken=False)


def set_kerbs(
    edge: shapely.Geometry, road: shapely.Geometry, size: Point, *, broken: bool = True
) -> list[Solid]:
    """Kerbstones of a width and height, at most 4 m long, off `road`. broken: keep the rest of one
    cut in parts."""
    (width, height), solids = size, []
    lines = [
        line
        for line in shapely.get_parts(shapely.segmentize(edge, 4.0))
        if line.geom_type == "LineString"
    ]
    for piece in (piece for line in lines for piece in pairwise(shapely.get_coordinates(line))):
        stone = shapely.LineString(piece).buffer(width, cap_style="flat").difference(road)
        stone = shapely.set_precision(stone, 1e-3)
        largest = max(shapely.get_parts(stone), key=shapely.area, default=shapely.Polygon())
        if (
            largest.area > 0.02
            and not largest.interiors
            and (broken or stone.geom_type == "Polygon")
        ):
            solids.append(
                Solid(shapely.get_coordinates(largest.exterior)[:-1], 0.0, height, "kerb")
            )
    return solids


def settle(solids: Iterable[Solid], relief: Relief) -> tuple[Solid, ...]:
    """Lift solids made for level ground onto uneven ground, by its height under their middle.

    Solids on the ground (base 0) reach 0.3 m into it, so that no gap shows."""
    solids = list(solids)
    middles = np.array([solid.footprint.mean(axis=0) for solid in solids]).reshape(-1, 2)
    lifts = Site("", np.array([0.0, 0, 1, 1]), relief=relief).ground(middles).round(3).tolist()
    return tuple(_raise_solid(solid, lift) for solid, lift in zip(solids, lifts, strict=True))


def _raise_solid(solid: Solid, lift: float) -> Solid:
    """Move a solid up by `lift` m, its base into the ground if it is on the ground."""
    base = -0.3 if solid.base == 0 else solid.base
    return replace(solid, base=round(base + lift, 3), top=round(solid.top + lift, 3))


def on_ground(mounts: Sequence[Mount], site: Site) -> tuple[Mount, ...]:
    """Set the feet of mounts on the site's ground."""
    feet = np.array([mount.position for mount in mounts]).reshape(-1, 3)
    feet[:, 2] = site.ground(feet[:, :2]).round(3)
    return tuple(replace(mount, position=foot) for mount, foot in zip(mounts, feet, strict=True))


def _pieces(line: Sequence[Point], length: float) -> list[tuple[Point, Point]]:
    points = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), length)).round(3)
    return list(pairwise((float(x), float(y)) for x, y in points))


Make = Callable[[Rng], list[Solid]]  # about the origin, lengthwise along x


def move_solids(solids: list[Solid], x: float, y: float, yaw: float) -> list[Solid]:
    """Turn solids by `yaw` (rad) about the origin, then move them to (x, y).

    Footprints are on millimetres."""
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return [
        replace(solid, footprint=np.round(solid.footprint @ turn + [x, y], 3)) for solid in solids
    ]


def _size(rng: Rng, *ranges: Span) -> tuple[float, ...]:
    return tuple(round(float(rng.uniform(*between)), 2) for between in ranges)


def _draw_block(kind: str, *ranges: Span) -> Make:
    """Maker of a block whose length, width and height are drawn."""

    def make(rng: Rng) -> list[Solid]:
        length, width, height = _size(rng, *ranges)
        return [Solid(block((length, width)), 0.0, height, kind)]

    return make


# clipped, up to the size of a van
hedge_block = _draw_block("hedge", (1.5, 5.5), (0.6, 2.3), (0.6, 2.2))
_cabinet = _draw_block("cabinet", (0.6, 2.4), (0.35, 1.2), (0.9, 2.3))  # power or telephone box


def bushes(rng: Rng) -> list[Solid]:
    """One to five bushes in a row, grown together."""
    radius = float(rng.uniform(0.4, 1.2))
    number = int(rng.integers(1, 6))
    solids = []
    for k in range(number):
        size, height = _size(rng, (0.8 * radius, 1.2 * radius), (0.6, 2.0))
        middle = (k - (number - 1) / 2) * 1.3 * radius
        solids.append(
            Solid(disc(middle, float(rng.normal(0.0, 0.15)), size, 9), 0.0, height, "bush")
        )
    return solids


def _planter(rng: Rng) -> list[Solid]:
    length, width, height, green = _size(rng, (0.8, 3.0), (0.6, 1.4), (0.4, 0.9), (0.2, 0.9))
    grown = Solid(block((0.8 * length, 0.8 * width)), height, round(height + green, 2), "bush")
    return [Solid(block((length, width)), 0.0, height, "planter"), grown]


def container(rng: Rng) -> list[Solid]:
    """Freight, site or recycling container."""
    length = float(rng.choice([1.8, 2.4, 3.0, 4.5, 6.06]))
    width, height = _size(rng, (1.5, 2.5), (1.4, 2.7))
    return [Solid(block((length, width)), 0.0, height, "container")]


def skip(rng: Rng) -> list[Solid]:
    """Open skip, narrower at its foot, more or less full."""
    length, width, height, full = _size(rng, (2.8, 4.8), (1.6, 2.1), (1.0, 1.7), (0.4, 1.15))
    middle = round(0.45 * height, 2)
    walls = [((0.0, side * (width - 0.12) / 2), (length, 0.12)) for side in (-1, 1)]
    walls += [((side * (length - 0.12) / 2, 0.0), (0.12, width - 0.24)) for side in (-1, 1)]
    foot = Solid(block((0.65 * length, 0.9 * width)), 0.0, middle, "container")
    sides = [Solid(block(size, at), middle, height, "container") for at, size in walls]
    load_top = round(middle + full * (height - middle), 2)
    load = Solid(block((0.8 * length, 0.7 * width)), middle, load_top, "container")
    return [foot, *sides, load]


def _bus_shelter(rng: Rng) -> list[Solid]:
    length, width = _size(rng, (2.5, 6.0), (1.2, 2.0))
    xmin = -length / 2
    ymin = -width / 2
    xmax = length / 2
    ymax = width / 2
    back = Solid(rectangle(xmin, ymax - 0.1, xmax, ymax), 0.0, 2.3, "shelter")
    side = Solid(rectangle(xmin, ymin, xmin + 0.1, ymax - 0.1), 0.0, 2.3, "shelter")
    roof = Solid(rectangle(xmin, ymin, xmax, ymax), 2.3, 2.45, "shelter")
    return [back, side, roof]


def _bins(rng: Rng) -> list[Solid]:
    number = int(rng.integers(1, 6))
    length, width, height = _size(rng, (0.6, 1.4), (0.7, 1.1), (1.0, 1.5))
    at = (np.arange(number) - (number - 1) / 2) * (length + 0.12)
    return [Solid(block((length, width), (float(x), 0.0)), 0.0, height, "bin") for x in at]


def heap(rng: Rng) -> list[Solid]:
    """Heap of earth or gravel, steep and rough."""
    radius, height = _size(rng, (0.8, 2.0), (0.6, 1.8))
    layers = []
    base = 0.0
    for radius_share, top_share in ((1.0, 0.35), (0.75, 0.6), (0.5, 0.82), (0.25, 1.0)):
        top = round(top_share * height, 2)
        layers.append(Solid(disc(0.0, 0.0, round(radius_share * radius, 3), 9), base, top, "heap"))
        base = top
    return layers


def _column(rng: Rng) -> list[Solid]:
    radius, height, length = _size(rng, (0.5, 0.8), (2.4, 3.6), (1.2, 3.6))
    if rng.random() < 0.5:
        return [Solid(disc(0.0, 0.0, radius, 12), 0.0, height, "sign")]
    feet = [post(side * 0.4 * length, 0.0, 0.7, 0.06) for side in (-1, 1)]
    return [*feet, Solid(block((length, 0.15)), 0.7, height - 0.4, "sign")]


def digger(rng: Rng) -> list[Solid]:
    """Digger: tracks, a house with a cab, an arm."""
    length, width, height, swing = _size(rng, (2.0, 3.6), (1.4, 2.3), (2.2, 2.9), (-0.4, 0.4))
    track = round(0.2 * height, 2)
    deck = round(0.55 * height, 2)
    sides = [
        Solid(block((length, 0.22 * width), (0.0, k * 0.39 * width)), 0.0, track, "machine")
        for k in (-1, 1)
    ]
    house = Solid(block((0.8 * length, 0.9 * width), (-0.1 * length, 0.0)), track, deck, "machine")
    cab = Solid(
        block((0.4 * length, 0.45 * width), (0.05 * length, 0.2 * width)), deck, height, "machine"
    )
    boom = Solid(
        block((0.45 * length, 0.3), (0.5 * length, swing / 2)),
        round(0.6 * deck, 2),
        height,
        "machine",
    )
    stick = Solid(block((0.3, 0.35), (0.8 * length, swing)), 0.0, round(0.9 * height, 2), "machine")
    return [*sides, house, cab, boom, stick]


def bicycles(rng: Rng) -> list[Solid]:
    """One to eight parked bicycles side by side: things, since nobody rides them."""
    solids = []
    spacing = float(rng.uniform(0.4, 0.9))
    number = int(rng.integers(1, 9))
    for k in range(number):
        scale = float(rng.uniform(0.75, 1.05))
        turn = float(rng.normal(0.0, 0.1))
        wheels = [block((0.64 * scale, 0.05), (x * scale, 0.0)) for x in (-0.52, 0.52)]
        parts = [Solid(wheel, 0.0, 0.64 * scale, "bicycle") for wheel in wheels]
        heights = (
            ((0.85, 0.05), 0.0, 0.4, 0.6),
            ((0.22, 0.15), -0.25, 0.8, 0.9),
            ((0.06, 0.56), 0.4, 0.93, 1.02),
        )
        for size, x, low, high in heights:
            parts.append(
                Solid(
                    block(size, (x * scale, 0.0)),
                    round(low * scale, 2),
                    round(high * scale, 2),
                    "bicycle",
                )
            )
        if rng.random() < 0.25:
            parts.append(Solid(block((0.36, 0.3), (-0.6 * scale, 0.0)), 0.68, 1.0, "bicycle"))
        solids += move_solids(
            parts, float(rng.normal(0.0, 0.1)), (k - (number - 1) / 2) * spacing, turn
        )
    return solids


PLANTED: tuple[Make, ...] = (hedge_block, hedge_block, bushes, bushes, _planter)
BUILT: tuple[Make, ...] = (_cabinet, container, skip, _bus_shelter, _bins, heap, _column, bicycles)
