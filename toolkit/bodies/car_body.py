"""Bodies of cars, lofted from their proportions.

A car is a row of cross-sections along x, all worked out together. The side profile gives each its
top, the plan outline its width; above the belt line the sides lean in (tumblehome), windscreen and
tail bow in plan, and the wheel arches cut into the flanks."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import Mesh, flip_sides, loft, merge, place

Profile = tuple[tuple[float, float], ...]  # see `Proportions.profile`

ARCH_FACTOR = 1.13  # radius of a wheel arch, as a part of the wheel's
MIN_SHOULDER_M = 0.035  # from the belt line to the top of the body

# distances from the middle of an axle at which sections are dense, as parts of the arch's radius
_ARCH_STATIONS = (-1.001, -0.98, -0.55, 0.55, 0.98, 1.001)
_ROOF_SHARES = (1.0, 0.9, 0.7, 0.38, 0.0)  # points across half the roof, 1 its edge


def spread_stations(count: int, step: int = 1) -> Float64[np.ndarray, " n"]:
    """Stations from 0 (front) to 1 (rear) along a car, dense at both ends.

    2 * count of them are made, and every `step`-th is kept."""
    even = np.linspace(0, 1, count)
    return np.concatenate([even**1.6 / 2, 1 - even**1.6 / 2])[::step]


class Bed(NamedTuple):
    """Open bed of a pick-up.

    Attributes:
        start: station of its front end.
        end: station of its rear end.
        width: as a part of the roof's."""

    start: float
    end: float
    width: float


@dataclass(frozen=True, eq=False)
class Proportions:
    """Proportions of one car; lengths in metres, stations from 0 (front) to 1 (rear).

    Attributes:
        kind: kind of car.
        length: m.
        width: m, without mirrors.
        height: m.
        profile: station and height of the body's top, as a part of the height.
        axles: distances from the front (m).
        wheel: radius (m).
        clearance: height of the floor (m).
        belt: height of the belt line, as a part of the height.
        lean: how far the sides lean in above the belt line, as a part of the half width.
        rounding: depth of the plan's corners at front and rear, as parts of the length.
        ends: width of the very front and rear, as parts of the width.
        bow: stations by which screens bulge forward in plan.
        camber: rise of the roof's middle (m).
        soft: half the length over which the profile is smoothed (stations).
        samples: places at which the profile is smoothed.
        barrel: part of the width by which both ends are narrower.
        tail: rise of the floor at the rear (m).
        tyre: width of a wheel, as a part of the car's.
        bed: open bed of a pick-up, None for other cars.
        spread: stations of the sections, without those at the wheel arches."""

    kind: str
    length: float
    width: float
    height: float
    profile: Float64[np.ndarray, "k 2"]
    axles: tuple[float, float]
    wheel: float
    clearance: float
    belt: float
    lean: float
    rounding: tuple[float, float]
    ends: tuple[float, float]
    bow: float
    camber: float
    soft: float
    samples: int = 5
    barrel: float = 0.05
    tail: float = 0.12
    tyre: float = 0.115
    bed: Bed | None = None
    spread: Float64[np.ndarray, " n"] = field(default_factory=lambda: spread_stations(13))

    def half_width(self, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Half the width (m) at stations s, 0 at the front and 1 at the rear.

        The flanks are nearly parallel, the corners at both ends superelliptic."""
        front_rounding, rear_rounding = self.rounding
        front_end, rear_end = self.ends
        # all as parts of the full width
        front = _narrow_corner(s, depth=front_rounding, end_width=front_end)
        rear = _narrow_corner(1 - s, depth=rear_rounding, end_width=rear_end)
        flanks = 1 - self.barrel * (2 * s - 1.05) ** 2
        return self.width / 2 * flanks * np.minimum(front, rear)


def _narrow_corner(
    distance: Float64[np.ndarray, " n"], depth: float, end_width: float
) -> Float64[np.ndarray, " n"]:
    """Width at stations along a car, as parts of its full width.

    distance: from one end of the car to each station; depth: station at which the corner ends and
    the width is full; end_width: width at the end."""
    # superellipse with exponent 2.6; 0 from the corner on, 1 at the end
    to_end = np.maximum(0.0, 1 - distance / depth)
    return end_width + (1 - end_width) * (1 - to_end**2.6) ** (1 / 2.6)


def loft_parts(shape: Proportions) -> Mesh:
    """Mesh of body and wheels of a car, x forward from its middle, wheels on z = 0.

    Stations are parts of the length, from 0 at the front to 1 at the rear."""
    arch_radius = shape.wheel * ARCH_FACTOR / shape.length  # in stations
    arch_stations = [
        axle / shape.length + arch_radius * share
        for axle in shape.axles
        for share in _ARCH_STATIONS
    ]
    stations = np.clip(np.concatenate([shape.spread, arch_stations]), 0, 1)
    stations = np.unique(np.round(stations, 4))  # sorted, from front to rear
    # axes: section from rear to front, point, xyz
    left = _make_half_sections(shape, stations[::-1])
    # mirrored and in reverse, without the two points at y = 0, to close each ring
    right = left[:, -2:0:-1] * [1.0, -1.0, 1.0]
    parts = [loft(np.concatenate([left, right], axis=1))]
    breadth = shape.tyre * shape.width
    wheel = make_wheel(0.0, 0.0, radius=shape.wheel, breadth=breadth)
    # distance from the front (m)
    for axle in shape.axles:
        (half_width,) = shape.half_width(np.array([axle / shape.length]))
        # y of the wheel's outer side, just inside the body
        outer_side = float(half_width) * 0.985
        left_wheel = place(wheel, x=shape.length / 2 - axle, y=outer_side - breadth / 2)
        parts += [left_wheel, flip_sides(left_wheel)]
    return merge(parts)


def _make_half_sections(
    shape: Proportions, s: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 13 3"]:
    """Left halves of the cross-sections at stations s.

    The result is (section, 13 points, x y z) in m, points from the middle of the floor round the
    flank to the middle of the roof."""
    half_width = shape.half_width(s)
    roof = _find_roof(shape, s)
    floor = shape.clearance + np.interp(s, [0, 0.1, 0.85, 1], [0.06, 0, 0, shape.tail])
    arch = _find_arches(shape, s)
    crown = roof[:, 0]
    shoulder = np.minimum(shape.belt * shape.height, crown - MIN_SHOULDER_M)
    sill = np.maximum(np.minimum(arch, shoulder - 0.07), floor + 0.02)
    flank = np.maximum(sill + 0.01, floor + 0.45 * (shoulder - floor))
    glass_height = crown - shoulder
    lean = shape.lean * np.clip(glass_height / (shape.height * (1 - shape.belt)), 0, 1)
    roof_edge = half_width * (0.965 - lean)
    middle = np.zeros_like(s)
    # seven points up to the shoulder at the belt line, one on the glass, five from the roof's edge
    # to its middle
    points = [  # y and z, from the middle of the floor to the middle of the roof
        (middle, floor),
        (0.74 * half_width, floor),
        (0.74 * half_width, np.where(arch > floor, sill, floor)),
        (0.965 * half_width, sill),
        (1.0 * half_width, flank),
        (0.995 * half_width, flank + 0.6 * (shoulder - flank)),
        (0.965 * half_width, shoulder),
        (0.4775 * half_width + 0.5 * roof_edge + 0.012, shoulder + 0.52 * glass_height),
        (roof_edge, crown - 0.25 * np.minimum(0.16, glass_height)),
        (0.93 * roof_edge, roof[:, 1]),
        (0.72 * roof_edge, roof[:, 2]),
        (0.38 * roof_edge, roof[:, 3]),
        (middle, roof[:, 4]),
    ]
    y = np.stack([point_y for point_y, _ in points], axis=1)
    z = np.stack([point_z for _, point_z in points], axis=1)
    x = shape.length * (0.5 - s)[:, None]
    sections = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    if shape.bed is not None:
        # along the bed its floor takes the place of the roof's last three points
        is_bed = (s > shape.bed.start) & (s < shape.bed.end)
        bed_floor = np.maximum(shoulder - 0.42, sill + 0.02)
        sections[is_bed, -3:, 1] = roof_edge[is_bed, None] * [shape.bed.width, 0.4, 0.0]
        sections[is_bed, -3:, 2] = bed_floor[is_bed, None]
    return sections


def _find_roof(shape: Proportions, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 5"]:
    """Heights (m) of the roof: one row per station s, one column per place of `_ROOF_SHARES`.

    The heights are of the side profile, smoothed along the car; screens bulge forward and
    backward in their middle, and the roof's edges are lower than its middle."""
    across = np.array(_ROOF_SHARES)  # 0 in the middle of the roof, 1 at its edge
    # shift of the station whose height is taken: forward in the front half (-1), backward behind
    # (1), most at the edges
    bow = shape.bow * across**2 * np.clip((s[:, None] - 0.55) * 6, -1, 1)
    offsets = np.linspace(-1, 1, shape.samples) * shape.soft
    stations = np.clip((s[:, None] + bow)[..., None] + offsets, 0, 1)  # (station, place, sample)
    roof = shape.height * np.interp(stations, *shape.profile.T).mean(axis=-1)
    fade = np.clip(4 * np.minimum(s, 1 - s) + 0.3, 0, 1)  # less camber at both ends
    roof -= shape.camber * across**2 * fade[:, None]
    return roof


def _find_arches(shape: Proportions, s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Heights (m) of the upper edge of the wheel arches at stations s, 0 between the arches."""
    radius = ARCH_FACTOR * shape.wheel
    distance = np.abs(s[:, None] * shape.length - np.array(shape.axles)).min(axis=1)
    rise = np.sqrt(np.maximum(radius**2 - distance**2, 0))
    return np.where(radius > distance, shape.wheel + rise, 0.0)
