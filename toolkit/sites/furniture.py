"""Street furniture as solids on level ground, and `settle` for uneven ground.

Things about as big as a car, such as hedges, containers and skips, are what a detector mistakes for
one, so a street that coview makes up holds plenty of them. They are made about the origin,
lengthwise along x; `move_solids` puts them in place."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Rng
from toolkit.mesh import Span as Span
from toolkit.sites.network import unite
from toolkit.sites.site import Mount, Relief, Site, Solid

Point = tuple[float, float]  # x, y, or two lengths (m)

Outlines = Iterable[Float[np.ndarray, "_ 2"]]  # polygons of corners x, y (m)


def rectangle(xmin: float, ymin: float, xmax: float, ymax: float) -> Float64[np.ndarray, "4 2"]:
    """Corners of a rectangle along x and y, counter-clockwise from (xmin, ymin)."""
    return np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]], np.float64)


def disc(x: float, y: float, radius: float, corners: int = 8) -> Float64[np.ndarray, "k 2"]:
    """Corners of a regular polygon around (x, y), rounded to millimetres.

    radius: distance of the corners from (x, y) (m); corners: their number."""
    angles = np.arange(corners) * 2 * np.pi / corners
    return np.round(np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], axis=1), 3)


def bar(start: Point, end: Point, width: float) -> Float64[np.ndarray, "4 2"]:
    """Corners of a strip of `width` (m) about the line from start to end.

    They run counter-clockwise from the right of the start and are rounded to millimetres."""
    along = np.subtract(end, start)
    across = np.array([-along[1], along[0]]) / np.hypot(*along) * width / 2
    return np.round(np.array([start - across, end - across, end + across, start + across]), 3)


def block(size: Point, middle: Point = (0.0, 0.0), yaw: float = 0.0) -> Float64[np.ndarray, "4 2"]:
    """Corners of a rectangle about `middle`, rounded to millimetres.

    size: length and width (m); yaw: direction of its length (rad, counter-clockwise from +x)."""
    ahead = size[0] / 2 * np.array([np.cos(yaw), np.sin(yaw)])
    start = float(middle[0] - ahead[0]), float(middle[1] - ahead[1])
    end = float(middle[0] + ahead[0]), float(middle[1] + ahead[1])
    return bar(start, end, size[1])


def post(x: float, y: float, height: float, radius: float = 0.08) -> Solid:
    """Post of a lamp, sensor or sign at (x, y), from the ground up to `height` (m)."""
    return Solid(disc(x, y, radius), 0.0, height, "post")


def sign(x: float, y: float, facing: float) -> list[Solid]:
    """Post and plate of a traffic sign at (x, y), its face towards `facing`.

    facing: rad, counter-clockwise from +x, at a right angle to the plate."""
    plate = block((0.7, 0.06), (x, y), facing + np.pi / 2)
    return [post(x, y, 2.2, 0.04), Solid(plate, 2.2, 2.9, "sign")]


def tree(
    x: float, y: float, height: float = 7.0, crown: float = 1.6, clear: float = 2.3
) -> list[Solid]:
    """Trunk of a tree at (x, y), and its crown in three layers from `clear` up to `height` (m).

    crown: largest radius of the crown (m), which it has in its middle layer."""
    low = clear + 0.25 * (height - clear)
    high = clear + 0.7 * (height - clear)
    return [
        Solid(disc(x, y, 0.16), 0.0, clear, "trunk"),
        Solid(disc(x, y, 0.75 * crown), clear, low, "tree"),
        Solid(disc(x, y, 1.0 * crown), low, high, "tree"),
        Solid(disc(x, y, 0.6 * crown), high, height, "tree"),
    ]


def litter_bin(x: float, y: float) -> Solid:
    """Litter bin at (x, y), 1 m high."""
    return Solid(disc(x, y, 0.28), 0.0, 1.0, "bin")


def bench(x: float, y: float, along: float = 0.0) -> Solid:
    """Bench 1.8 m long about (x, y). along: direction of its length (rad from +x)."""
    return Solid(block((1.8, 0.5), (x, y), along), 0.0, 0.5, "bench")


def hedge(line: Sequence[Point], height: float = 1.4) -> list[Solid]:
    """Hedge 0.7 m wide along the points of `line`, in pieces of at most 6 m, up to `height` (m)."""
    return [Solid(bar(*piece, 0.7), 0.0, height, "hedge") for piece in _pieces(line, 6.0)]


def wall(line: Sequence[Point], height: float = 1.8, width: float = 0.25) -> list[Solid]:
    """Wall about the points of `line`, in pieces of at most 8 m; height and width in m."""
    return [Solid(bar(*piece, width), 0.0, height, "wall") for piece in _pieces(line, 8.0)]


def railing(line: Sequence[Point], height: float = 1.1) -> list[Solid]:
    """Fence that can be seen through, along `line`: posts every 2.5 m at most, and two rails.

    height: of the posts and the upper rail (m). The end of the line has no post."""
    pieces = _pieces(line, 2.5)
    uprights = [Solid(disc(*start, 0.05), 0.0, height, "fence") for start, _ in pieces]
    # bottom and top of the rail at half height and of the upper rail (m)
    levels = ((0.5 * height - 0.05, 0.5 * height + 0.05), (height - 0.1, height))
    return uprights + [
        Solid(bar(*piece, 0.06), *level, "fence") for piece in pieces for level in levels
    ]


def kerbs(lanes: Outlines, footways: Outlines, height: float = 0.12) -> list[Solid]:
    """Kerbstones on the footways, along the edges at which they meet the lanes.

    lanes, footways: polygons of the road's surface; height: how high the stones are (m)."""
    road = unite(lanes).buffer(0.01)
    walk = unite(footways)
    if walk.is_empty:
        return []
    edge = shapely.line_merge(shapely.intersection(walk.boundary, road)).simplify(0.02)
    return set_kerbs(edge, road, (0.15, height), broken=False)


def set_kerbs(
    edge: shapely.Geometry, road: shapely.Geometry, size: Point, *, broken: bool = True
) -> list[Solid]:
    """Kerbstones along the lines of `edge`, at most 4 m long, only on the side off `road`.

    edge: lines; road: ground that stones must not cover; size: width and height of a stone (m);
    broken: keep the largest part of a stone that the road cuts in several, else leave such stones
    out. Stones of 0.02 m² and less, or with holes, are left out."""
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

    Solids on the ground (base 0) reach 0.3 m into it, so that no gap shows. Returns new solids in
    the same order."""
    solids = list(solids)
    # a site whose only purpose is its relief
    middles = np.array([solid.footprint.mean(axis=0) for solid in solids]).reshape(-1, 2)
    lifts = Site("", np.array([0.0, 0, 1, 1]), relief=relief).ground(middles).round(3).tolist()
    return tuple(_raise_solid(solid, lift) for solid, lift in zip(solids, lifts, strict=True))


def _raise_solid(solid: Solid, lift: float) -> Solid:
    """Return a solid moved up by `lift` (m), its base 0.3 m into the ground if it was at 0."""
    base = -0.3 if solid.base == 0 else solid.base
    return replace(solid, base=round(base + lift, 3), top=round(solid.top + lift, 3))


def on_ground(mounts: Sequence[Mount], site: Site) -> tuple[Mount, ...]:
    """Return mounts with their feet (z) set on the site's ground, in the same order."""
    feet = np.array([mount.position for mount in mounts]).reshape(-1, 3)
    feet[:, 2] = site.ground(feet[:, :2]).round(3)
    return tuple(replace(mount, position=foot) for mount, foot in zip(mounts, feet, strict=True))


def _pieces(line: Sequence[Point], length: float) -> list[tuple[Point, Point]]:
    # Ends of equal pieces of each segment of a line, at most `length` m long, on millimetres.
    points = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), length)).round(3)
    return list(pairwise((float(x), float(y)) for x, y in points))


# draws one thing: its solids on level ground about the origin, lengthwise along x
Make = Callable[[Rng], list[Solid]]


def move_solids(solids: list[Solid], x: float, y: float, yaw: float) -> list[Solid]:
    """Return solids turned by `yaw` about the origin, then moved by (x, y).

    yaw: rad, counter-clockwise. Footprints are rounded to millimetres, heights remain."""
    # transpose of the rotation, for rows of points
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return [
        replace(solid, footprint=np.round(solid.footprint @ turn + [x, y], 3)) for solid in solids
    ]


def _size(rng: Rng, *ranges: Span) -> tuple[float, ...]:
    # A length (m, on centimetres) drawn from each range (low, high), in their order.
    return tuple(round(float(rng.uniform(*between)), 2) for between in ranges)


def _draw_block(kind: str, *ranges: Span) -> Make:
    """Return a function that draws a block of a kind, one of `KINDS`.

    ranges: three pairs (low, high) in m for the block's length, width and height."""

    def make(rng: Rng) -> list[Solid]:
        # ranges: length, width, height
        length, width, height = _size(rng, *ranges)
        return [Solid(block((length, width)), 0.0, height, kind)]

    return make


# hedge clipped to a block, up to the size of a van
hedge_block = _draw_block("hedge", (1.5, 5.5), (0.6, 2.3), (0.6, 2.2))
_cabinet = _draw_block("cabinet", (0.6, 2.4), (0.35, 1.2), (0.9, 2.3))  # power or telephone box


def bushes(rng: Rng) -> list[Solid]:
    """Draw one to five bushes in a row along x, grown together."""
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
    # A box and the plants in it, which rise `green` m above its edge.
    length, width, height, green = _size(rng, (0.8, 3.0), (0.6, 1.4), (0.4, 0.9), (0.2, 0.9))
    grown = Solid(block((0.8 * length, 0.8 * width)), height, round(height + green, 2), "bush")
    return [Solid(block((length, width)), 0.0, height, "planter"), grown]


def container(rng: Rng) -> list[Solid]:
    """Draw a freight, site or recycling container, one block."""
    length = float(rng.choice([1.8, 2.4, 3.0, 4.5, 6.06]))
    width, height = _size(rng, (1.5, 2.5), (1.4, 2.7))
    return [Solid(block((length, width)), 0.0, height, "container")]


def skip(rng: Rng) -> list[Solid]:
    """Draw an open skip, narrower at its foot, with a load that may rise above its walls.

    Returns the foot, four walls and the load, all of kind `container`."""
    # full: share of the walls' height that the load fills, more than 1 for a heaped load
    length, width, height, full = _size(rng, (2.8, 4.8), (1.6, 2.1), (1.0, 1.7), (0.4, 1.15))
    middle = round(0.45 * height, 2)
    # middle, and size, of the two long walls, then of the two short ones between them
    walls = [((0.0, side * (width - 0.12) / 2), (length, 0.12)) for side in (-1, 1)]
    walls += [((side * (length - 0.12) / 2, 0.0), (0.12, width - 0.24)) for side in (-1, 1)]
    foot = Solid(block((0.65 * length, 0.9 * width)), 0.0, middle, "container")
    sides = [Solid(block(size, at), middle, height, "container") for at, size in walls]
    load_top = round(middle + full * (height - middle), 2)
    load = Solid(block((0.8 * length, 0.7 * width)), middle, load_top, "container")
    return [foot, *sides, load]


def _bus_shelter(rng: Rng) -> list[Solid]:
    # Back wall, a side wall and a roof, open towards -y.
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
    # One to five large bins of one size in a row along x, 0.12 m apart.
    number = int(rng.integers(1, 6))
    length, width, height = _size(rng, (0.6, 1.4), (0.7, 1.1), (1.0, 1.5))
    at = (np.arange(number) - (number - 1) / 2) * (length + 0.12)
    return [Solid(block((length, width), (float(x), 0.0)), 0.0, height, "bin") for x in at]


def heap(rng: Rng) -> list[Solid]:
    """Draw a heap of earth or gravel: four discs, one upon the other, smaller upwards."""
    radius, height = _size(rng, (0.8, 2.0), (0.6, 1.8))
    layers = []
    base = 0.0
    for radius_share, top_share in ((1.0, 0.35), (0.75, 0.6), (0.5, 0.82), (0.25, 1.0)):
        top = round(top_share * height, 2)
        layers.append(Solid(disc(0.0, 0.0, round(radius_share * radius, 3), 9), base, top, "heap"))
        base = top
    return layers


def _column(rng: Rng) -> list[Solid]:
    # Advertising column, or a board on two posts, each for half the draws.
    radius, height, length = _size(rng, (0.5, 0.8), (2.4, 3.6), (1.2, 3.6))
    if rng.random() < 0.5:
        return [Solid(disc(0.0, 0.0, radius, 12), 0.0, height, "sign")]
    feet = [post(side * 0.4 * length, 0.0, 0.7, 0.06) for side in (-1, 1)]
    return [*feet, Solid(block((length, 0.15)), 0.7, height - 0.4, "sign")]


def digger(rng: Rng) -> list[Solid]:
    """Draw a digger: two tracks, a house with a cab, and an arm, ahead along +x.

    The solids overlap in part. Their proportions are shares of a length, width and height."""
    # swing: how far (m) the end of the arm is to the left
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
    """Draw one to eight parked bicycles side by side along y, ahead along +x.

    They are solids, not road users, since nobody rides them. Some have a box on the carrier."""
    solids = []
    spacing = float(rng.uniform(0.4, 0.9))
    number = int(rng.integers(1, 9))
    for k in range(number):
        scale = float(rng.uniform(0.75, 1.05))
        turn = float(rng.normal(0.0, 0.1))
        wheels = [block((0.64 * scale, 0.05), (x * scale, 0.0)) for x in (-0.52, 0.52)]
        parts = [Solid(wheel, 0.0, 0.64 * scale, "bicycle") for wheel in wheels]
        # frame, saddle and handlebar: length and width, x of the middle, bottom and top (m)
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


# makers to choose from; one that is there twice is drawn twice as often
PLANTED: tuple[Make, ...] = (hedge_block, hedge_block, bushes, bushes, _planter)
BUILT: tuple[Make, ...] = (_cabinet, container, skip, _bus_shelter, _bins, heap, _column, bicycles)
