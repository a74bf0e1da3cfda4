"""Street furniture as solids on level ground, and `raise_onto_ground` for uneven ground.

Things about as big as a car, such as hedges, containers and skips, are what a detector mistakes for
one, so a street that coview makes up holds plenty. They are made about the origin,
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

# function that draws an object: its solids on level ground about the origin, lengthwise along x
Make = Callable[[Rng], list[Solid]]

MAX_KERBSTONE_M = 4.0  # length of a kerbstone
MIN_KERBSTONE_M2 = 0.02  # ground that a kerbstone covers
_FOUNDATION_M = 0.3  # depth in uneven ground of what is built on the ground


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
    along_x, along_y = np.subtract(end, start)
    # vector to the left of the line, half a width long
    left = np.array([-along_y, along_x]) / np.hypot(along_x, along_y) * width / 2
    return np.round(np.array([start - left, end - left, end + left, start + left]), 3)


def block(size: Point, middle: Point = (0.0, 0.0), yaw: float = 0.0) -> Float64[np.ndarray, "4 2"]:
    """Corners of a rectangle about `middle` (x, y), rounded to millimetres.

    size: length and width (m); yaw: direction of its length (rad, counter-clockwise from +x)."""
    length, width = size
    x, y = middle
    # vector from the middle to the middle of the front side
    ahead_x, ahead_y = length / 2 * np.array([np.cos(yaw), np.sin(yaw)])
    start = float(x - ahead_x), float(y - ahead_y)
    end = float(x + ahead_x), float(y + ahead_y)
    return bar(start, end, width=width)


def post(x: float, y: float, height: float, radius: float = 0.08) -> Solid:
    """Post of a lamp, sensor or sign at (x, y), from the ground up to `height` (m)."""
    return Solid(disc(x, y, radius), base=0.0, top=height, kind="post")


def sign(x: float, y: float, facing: float) -> list[Solid]:
    """Post and plate of a traffic sign at (x, y), its face towards `facing`.

    facing: rad, counter-clockwise from +x, at a right angle to the plate."""
    plate = block((0.7, 0.06), middle=(x, y), yaw=facing + np.pi / 2)
    return [post(x, y, height=2.2, radius=0.04), Solid(plate, base=2.2, top=2.9, kind="sign")]


def tree(
    x: float, y: float, height: float = 7.0, crown: float = 1.6, clear: float = 2.3
) -> list[Solid]:
    """Trunk of a tree at (x, y), and its crown in three layers, all discs on level ground.

    height: top of the crown (m above the ground); clear: bottom of the crown and top of the trunk
    (m); crown: largest radius of the crown (m), which it has in its middle layer."""
    middle_base = clear + 0.25 * (height - clear)
    middle_top = clear + 0.7 * (height - clear)
    return [
        Solid(disc(x, y, radius=0.16), base=0.0, top=clear, kind="trunk"),
        Solid(disc(x, y, radius=0.75 * crown), base=clear, top=middle_base, kind="tree"),
        Solid(disc(x, y, radius=1.0 * crown), base=middle_base, top=middle_top, kind="tree"),
        Solid(disc(x, y, radius=0.6 * crown), base=middle_top, top=height, kind="tree"),
    ]


def litter_bin(x: float, y: float) -> Solid:
    """Litter bin at (x, y), 1 m high."""
    return Solid(disc(x, y, 0.28), base=0.0, top=1.0, kind="bin")


def bench(x: float, y: float, along: float = 0.0) -> Solid:
    """Bench 1.8 m long about (x, y). along: direction of its length (rad from +x)."""
    return Solid(block((1.8, 0.5), middle=(x, y), yaw=along), base=0.0, top=0.5, kind="bench")


def hedge(line: Sequence[Point], height: float = 1.4) -> list[Solid]:
    """Hedge 0.7 m wide along the points of `line`, in pieces of at most 6 m, up to `height` (m)."""
    return [
        Solid(bar(*piece, width=0.7), base=0.0, top=height, kind="hedge")
        for piece in _split_line(line, 6.0)
    ]


def wall(line: Sequence[Point], height: float = 1.8, width: float = 0.25) -> list[Solid]:
    """Wall about the points of `line`, in pieces of at most 8 m; height and width in m."""
    return [
        Solid(bar(*piece, width=width), base=0.0, top=height, kind="wall")
        for piece in _split_line(line, 8.0)
    ]


def railing(line: Sequence[Point], height: float = 1.1) -> list[Solid]:
    """Fence that can be seen through: posts at most 2.5 m apart, and two rails between them.

    line: points x, y (m) that the fence follows; height: top of the posts and the upper rail (m).
    The end of the line has no post."""
    solids = []
    pieces = _split_line(line, 2.5)  # start and end of each piece between two posts
    for (x, y), _ in pieces:
        solids.append(Solid(disc(x, y, radius=0.05), base=0.0, top=height, kind="fence"))
    middle = 0.5 * height  # height of the lower rail
    for start, end in pieces:
        rail = bar(start, end, width=0.06)
        solids.append(Solid(rail, base=middle - 0.05, top=middle + 0.05, kind="fence"))
        solids.append(Solid(rail, base=height - 0.1, top=height, kind="fence"))
    return solids


def kerbs(lanes: Outlines, footways: Outlines, height: float = 0.12) -> list[Solid]:
    """Kerbstones on the footways, along the edges at which they meet the lanes.

    lanes, footways: polygons of the road's surface; height: their height (m)."""
    road = unite(lanes).buffer(0.01)  # a little wider, so that it overlaps footways that touch it
    footway = unite(footways)
    if footway.is_empty:
        return []
    edge = shapely.line_merge(shapely.intersection(footway.boundary, road)).simplify(0.02)
    return set_kerbs(edge, road, size=(0.15, height), broken=False)  # size: width and height


def set_kerbs(
    edge: shapely.Geometry, road: shapely.Geometry, size: Point, *, broken: bool = True
) -> list[Solid]:
    """Kerbstones along the lines of `edge`, cut off where they would cover `road`.

    edge: lines, cut in stones of at most `MAX_KERBSTONE_M`; parts of other types are ignored; road:
    ground that stones must not cover; size: width and height of a stone (m); broken: keep the
    largest part of a stone that the road cuts in several, else leave such stones out. Stones of
    `MIN_KERBSTONE_M2` and less, or with holes, are left out."""
    width, height = size
    solids = []
    for line in shapely.get_parts(shapely.segmentize(edge, MAX_KERBSTONE_M)):
        if line.geom_type != "LineString":
            continue
        for ends in pairwise(shapely.get_coordinates(line)):
            # a strip on both sides of the edge, less the side on the road
            strip = shapely.LineString(ends).buffer(width, cap_style="flat")
            stone = shapely.set_precision(strip.difference(road), 1e-3)
            largest_part = max(
                shapely.get_parts(stone), key=shapely.area, default=shapely.Polygon()
            )
            is_usable = broken or stone.geom_type == "Polygon"
            if largest_part.area > MIN_KERBSTONE_M2 and not largest_part.interiors and is_usable:
                # the last corner is the first
                corners = shapely.get_coordinates(largest_part.exterior)[:-1]
                solids.append(Solid(corners, base=0.0, top=height, kind="kerb"))
    return solids


def raise_onto_ground(solids: Iterable[Solid], relief: Relief) -> tuple[Solid, ...]:
    """Lift solids made for level ground onto uneven ground, by its height under their middle.

    Solids on the ground (base 0) reach `_FOUNDATION_M` into it, so that no gap shows. relief: gives
    the ground's height. Returns new solids in the same order."""
    solids = list(solids)
    middles = np.array([solid.footprint.mean(axis=0) for solid in solids]).reshape(-1, 2)
    # a site made only to read the height of the ground; its area does not matter
    site = Site("", area=np.array([0.0, 0, 1, 1]), relief=relief)
    lifts = site.ground(middles).round(3).tolist()
    return tuple(_raise_solid(solid, lift) for solid, lift in zip(solids, lifts, strict=True))


def _raise_solid(solid: Solid, lift: float) -> Solid:
    """Return a solid moved up by `lift` (m), its base a little into the ground if it was at 0."""
    base = -_FOUNDATION_M if solid.base == 0 else solid.base
    return replace(solid, base=round(base + lift, 3), top=round(solid.top + lift, 3))


def on_ground(mounts: Sequence[Mount], site: Site) -> tuple[Mount, ...]:
    """Return mounts with their feet (z) set on the site's ground, in the same order."""
    feet = np.array([mount.position for mount in mounts]).reshape(-1, 3)
    feet[:, 2] = site.ground(feet[:, :2]).round(3)
    return tuple(replace(mount, position=foot) for mount, foot in zip(mounts, feet, strict=True))


def _split_line(line: Sequence[Point], length: float) -> list[tuple[Point, Point]]:
    """Both ends of equal pieces of a line's segments, at most `length` m long, on millimetres."""
    points = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), length)).round(3)
    return list(pairwise((float(x), float(y)) for x, y in points))


def move_solids(solids: list[Solid], x: float, y: float, yaw: float) -> list[Solid]:
    """Return solids turned by `yaw` about the origin, then moved by (x, y) (m).

    yaw: rad, counter-clockwise. Footprints are rounded to millimetres, heights remain."""
    # transpose of the rotation, for rows of points
    rotation = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return [
        replace(solid, footprint=np.round(solid.footprint @ rotation + [x, y], 3))
        for solid in solids
    ]


def _draw_lengths(rng: Rng, *ranges: Span) -> tuple[float, ...]:
    # A length (m, on centimetres) drawn from each range (low, high), in their order.
    return tuple(round(float(rng.uniform(*limits)), 2) for limits in ranges)


def _draw_block(kind: str, *ranges: Span) -> Make:
    """Return a function that draws a block of any size within limits.

    kind: kind of solid, one of `KINDS`; ranges: three pairs (low, high) in m for the block's
    length, width and height."""

    def make(rng: Rng) -> list[Solid]:
        length, width, height = _draw_lengths(rng, *ranges)
        return [Solid(block((length, width)), base=0.0, top=height, kind=kind)]

    return make


# hedge clipped to a block, up to the size of a van
hedge_block = _draw_block("hedge", (1.5, 5.5), (0.6, 2.3), (0.6, 2.2))
power_box = _draw_block("cabinet", (0.6, 2.4), (0.35, 1.2), (0.9, 2.3))  # or a telephone box


def bushes(rng: Rng) -> list[Solid]:
    """Draw one to five bushes in a row along x about the origin, grown together; lengths in m."""
    mean_radius = float(rng.uniform(0.4, 1.2))
    number = int(rng.integers(1, 6))
    spacing = 1.3 * mean_radius  # less than a diameter, so that neighbours overlap
    solids = []
    for k in range(number):
        radius, height = _draw_lengths(rng, (0.8 * mean_radius, 1.2 * mean_radius), (0.6, 2.0))
        x = (k - (number - 1) / 2) * spacing
        y = float(rng.normal(0.0, 0.15))
        solids.append(Solid(disc(x, y, radius, corners=9), base=0.0, top=height, kind="bush"))
    return solids


def planter(rng: Rng) -> list[Solid]:
    """Draw a box, and the plants in it as a smaller block on top."""
    length, width, height = _draw_lengths(rng, (0.8, 3.0), (0.6, 1.4), (0.4, 0.9))
    (plants_height,) = _draw_lengths(rng, (0.2, 0.9))  # height of the plants above the box
    box = Solid(block((length, width)), base=0.0, top=height, kind="planter")
    plant_size = 0.8 * length, 0.8 * width
    plants = Solid(
        block(plant_size), base=height, top=round(height + plants_height, 2), kind="bush"
    )
    return [box, plants]


def container(rng: Rng) -> list[Solid]:
    """Draw a freight, site or recycling container, one block."""
    length = float(rng.choice([1.8, 2.4, 3.0, 4.5, 6.06]))
    width, height = _draw_lengths(rng, (1.5, 2.5), (1.4, 2.7))
    return [Solid(block((length, width)), base=0.0, top=height, kind="container")]


def skip(rng: Rng) -> list[Solid]:
    """Draw an open skip, narrower at its foot, with a load that may rise above its walls.

    Returns the foot, four walls and the load, all of kind `container`, about the origin with the
    length along x."""
    length, width, height = _draw_lengths(rng, (2.8, 4.8), (1.6, 2.1), (1.0, 1.7))
    # share of the walls' height that the load fills, more than 1 for a heaped load
    (load_share,) = _draw_lengths(rng, (0.4, 1.15))
    foot_top = round(0.45 * height, 2)
    wall_width = 0.12
    long_y = (width - wall_width) / 2
    short_x = (length - wall_width) / 2
    # corners of the two long walls, then of the two short ones between them
    walls = [block((length, wall_width), middle=(0.0, side * long_y)) for side in (-1, 1)]
    walls += [
        block((wall_width, width - 2 * wall_width), middle=(side * short_x, 0.0))
        for side in (-1, 1)
    ]
    foot = Solid(block((0.65 * length, 0.9 * width)), base=0.0, top=foot_top, kind="container")
    sides = [Solid(corners, base=foot_top, top=height, kind="container") for corners in walls]
    load_top = round(foot_top + load_share * (height - foot_top), 2)
    load = Solid(block((0.8 * length, 0.7 * width)), base=foot_top, top=load_top, kind="container")
    return [foot, *sides, load]


def bus_shelter(rng: Rng) -> list[Solid]:
    """Draw a bus shelter about the origin: back wall, a side wall and a roof, open towards -y."""
    length, width = _draw_lengths(rng, (2.5, 6.0), (1.2, 2.0))
    xmin = -length / 2
    ymin = -width / 2
    xmax = length / 2
    ymax = width / 2
    back = Solid(rectangle(xmin, ymax - 0.1, xmax, ymax), base=0.0, top=2.3, kind="shelter")
    side = Solid(rectangle(xmin, ymin, xmin + 0.1, ymax - 0.1), base=0.0, top=2.3, kind="shelter")
    roof = Solid(rectangle(xmin, ymin, xmax, ymax), base=2.3, top=2.45, kind="shelter")
    return [back, side, roof]


def bin_row(rng: Rng) -> list[Solid]:
    """Draw one to five large bins of one size in a row along x, 0.12 m apart."""
    number = int(rng.integers(1, 6))
    length, width, height = _draw_lengths(rng, (0.6, 1.4), (0.7, 1.1), (1.0, 1.5))
    middles_x = (np.arange(number) - (number - 1) / 2) * (length + 0.12)
    return [
        Solid(block((length, width), middle=(float(x), 0.0)), base=0.0, top=height, kind="bin")
        for x in middles_x
    ]


def heap(rng: Rng) -> list[Solid]:
    """Draw a heap of earth or gravel: four discs, one upon the other, smaller upwards."""
    foot_radius, height = _draw_lengths(rng, (0.8, 2.0), (0.6, 1.8))
    layers = []
    base = 0.0
    # share of the foot's radius, and of the height at the layer's top
    for radius_share, top_share in ((1.0, 0.35), (0.75, 0.6), (0.5, 0.82), (0.25, 1.0)):
        top = round(top_share * height, 2)
        outline = disc(0.0, 0.0, round(radius_share * foot_radius, 3), corners=9)
        layers.append(Solid(outline, base=base, top=top, kind="heap"))
        base = top
    return layers


def advertisement(rng: Rng) -> list[Solid]:
    """Draw an advertising column, or a board along x on two posts, each for half the draws."""
    radius, height, length = _draw_lengths(rng, (0.5, 0.8), (2.4, 3.6), (1.2, 3.6))
    if rng.random() < 0.5:
        return [Solid(disc(0.0, 0.0, radius, corners=12), base=0.0, top=height, kind="sign")]
    feet = [post(side * 0.4 * length, 0.0, height=0.7, radius=0.06) for side in (-1, 1)]
    return [*feet, Solid(block((length, 0.15)), base=0.7, top=height - 0.4, kind="sign")]


def digger(rng: Rng) -> list[Solid]:
    """Draw a digger about the origin: two tracks, a house with a cab, and an arm, ahead along +x.

    The solids overlap in part. Their proportions are shares of a length, width and height."""
    length, width, height = _draw_lengths(rng, (2.0, 3.6), (1.4, 2.3), (2.2, 2.9))
    (swing,) = _draw_lengths(rng, (-0.4, 0.4))  # how far the end of the arm is to the left
    track_top = round(0.2 * height, 2)
    deck = round(0.55 * height, 2)  # top of the house
    track_size = length, 0.22 * width
    tracks = [block(track_size, middle=(0.0, side * 0.39 * width)) for side in (-1, 1)]
    house = block((0.8 * length, 0.9 * width), middle=(-0.1 * length, 0.0))
    cab = block((0.4 * length, 0.45 * width), middle=(0.05 * length, 0.2 * width))
    boom = block((0.45 * length, 0.3), middle=(0.5 * length, swing / 2))  # upper part of the arm
    stick = block((0.3, 0.35), middle=(0.8 * length, swing))  # its end, which reaches down
    boom_base = round(0.6 * deck, 2)
    stick_top = round(0.9 * height, 2)
    return [
        *(Solid(track, base=0.0, top=track_top, kind="machine") for track in tracks),
        Solid(house, base=track_top, top=deck, kind="machine"),
        Solid(cab, base=deck, top=height, kind="machine"),
        Solid(boom, base=boom_base, top=height, kind="machine"),
        Solid(stick, base=0.0, top=stick_top, kind="machine"),
    ]


def bicycles(rng: Rng) -> list[Solid]:
    """Draw one to eight parked bicycles side by side along y, ahead along +x.

    They are solids, not road users, since nobody rides them. Some have a box on the carrier."""
    solids = []
    spacing = float(rng.uniform(0.4, 0.9))
    number = int(rng.integers(1, 9))
    for k in range(number):
        scale = float(rng.uniform(0.75, 1.05))
        yaw = float(rng.normal(0.0, 0.1))  # nearly parallel
        parts = _bicycle_parts(scale)
        if rng.random() < 0.25:
            box = block((0.36, 0.3), middle=(-0.6 * scale, 0.0))
            parts.append(Solid(box, base=0.68, top=1.0, kind="bicycle"))
        x = float(rng.normal(0.0, 0.1))
        y = (k - (number - 1) / 2) * spacing
        solids += move_solids(parts, x=x, y=y, yaw=yaw)
    return solids


def _bicycle_parts(scale: float) -> list[Solid]:
    """Wheels, frame, saddle and handlebar of a bicycle about the origin, ahead along +x.

    scale: size of the bicycle, 1 for an adult's."""
    wheels = [block((0.64 * scale, 0.05), middle=(x * scale, 0.0)) for x in (-0.52, 0.52)]
    parts = [Solid(wheel, base=0.0, top=0.64 * scale, kind="bicycle") for wheel in wheels]
    # frame, saddle and handlebar: length and width, x of the middle, bottom and top (m)
    rows = (
        ((0.85, 0.05), 0.0, 0.4, 0.6),
        ((0.22, 0.15), -0.25, 0.8, 0.9),
        ((0.06, 0.56), 0.4, 0.93, 1.02),
    )
    for size, x, low, high in rows:
        outline = block(size, middle=(x * scale, 0.0))
        base = round(low * scale, 2)
        top = round(high * scale, 2)
        parts.append(Solid(outline, base=base, top=top, kind="bicycle"))
    return parts
