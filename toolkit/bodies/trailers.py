"""Trailers of cars, drawn at random."""

import numpy as np

from toolkit.arrays import Float64, Rng
from toolkit.bodies.car_body import Proportions
from toolkit.bodies.mesh_parts import mound, plank
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import Mesh, flip_sides, loft, merge, tube

TRAILERS = {  # kind: ranges of length and width (m)
    "open_trailer": ((1.8, 3.4), (1.3, 2.0)),
    "box_trailer": ((2.0, 4.2), (1.4, 2.1)),
    "caravan": ((3.8, 6.6), (2.0, 2.4)),
}


def draw_trailer(shape: Proportions, rng: Rng) -> tuple[str, Mesh]:
    """Draw a trailer with its drawbar, and return its kind (a key of `TRAILERS`) and mesh.

    shape: the car in front, whose middle is at x = 0. The trailer is behind it, wheels on z = 0."""
    kind = list(TRAILERS)[int(rng.integers(3))]
    lengths, widths = TRAILERS[kind]
    length = float(rng.uniform(*lengths))
    width = float(rng.uniform(*widths))
    drawbar_length = float(rng.uniform(0.8, 1.4))
    floor = float(rng.uniform(0.4, 0.6))
    # x of the trailer's front
    front = -shape.length / 2 - drawbar_length
    wheel_radius = float(rng.uniform(0.24, 0.33))
    drawbar = tube(
        [(-shape.length / 2 + 0.1, 0.0, 0.42), (front - 0.2, 0.0, 0.46)], radii=0.05, sides=6
    )
    if kind == "open_trailer":
        bodies = _draw_open_trailer(front, length, width, floor, rng)
    else:
        bodies = [_draw_box(kind, front, length, width, floor, rng)]
    middle = front - length / 2
    inset = 0.08 if kind == "caravan" else -0.1  # wheels of other trailers are outside
    wheel = make_wheel(middle - 0.05 * length, width / 2 - inset, radius=wheel_radius, breadth=0.18)
    return kind, merge([drawbar, *bodies, wheel, flip_sides(wheel)])


def _draw_open_trailer(
    front: float, length: float, width: float, floor: float, rng: Rng
) -> list[Mesh]:
    """Draw the parts of an open trailer behind x = `front`, sometimes with a heap on it.

    floor: height of its floor (m); other lengths in m too."""
    middle = front - length / 2
    wall_height = float(rng.uniform(0.3, 0.6))
    # sizes: length, width, height
    side_wall = (length, 0.05, wall_height)
    end_wall = (0.05, width, wall_height)
    parts = [plank((length, width, 0.06), x=middle, y=0.0, z=floor)]
    for y in (-width / 2 + 0.025, width / 2 - 0.025):
        parts.append(plank(side_wall, x=middle, y=y, z=floor))
    for x in (front - 0.025, front - length + 0.025):
        parts.append(plank(end_wall, x=x, y=0.0, z=floor))
    if rng.random() < 0.5:
        heap = (0.9 * length, 0.88 * width, float(rng.uniform(0.3, 0.9)))
        parts.append(mound(heap, x=middle, z=floor + 0.06))
    return parts


def _draw_box(kind: str, front: float, length: float, width: float, floor: float, rng: Rng) -> Mesh:
    """Draw the body of a box trailer or a caravan, with sloping ends, behind x = `front`.

    kind: "box_trailer" or "caravan"; floor: height of its floor (m); other lengths in m too."""
    if kind == "box_trailer":
        top = float(rng.uniform(1.3, 2.3))
        slope = 0.02
    else:
        top = float(rng.uniform(2.3, 2.65))
        slope = float(rng.uniform(0.06, 0.16))
    # y as a part of the width, and z (m)
    corners = [[-0.5, floor], [0.5, floor], [0.5, top], [-0.5, top]]
    full_ring = np.array(corners) * [width, 1.0]
    # from the rear to the front: smaller at both ends, full in between
    rings = [
        _shrink_ring(full_ring, front - length, slope),
        _place_ring(full_ring, front + (slope * length - length)),
        _place_ring(full_ring, front + -slope * length),
        _shrink_ring(full_ring, front, slope),
    ]
    return loft(np.stack(rings))


def _place_ring(ring: Float64[np.ndarray, "4 2"], x: float) -> Float64[np.ndarray, "4 3"]:
    """Points (x, y, z) of a ring of y, z at one x (m)."""
    return np.column_stack([np.full(4, x), ring[:, 0], ring[:, 1]])


def _shrink_ring(
    ring: Float64[np.ndarray, "4 2"], x: float, slope: float
) -> Float64[np.ndarray, "4 3"]:
    """Points (x, y, z) of a ring at an end of a trailer, narrower and lower than in its middle.

    ring: y, z in the middle (m); slope: share by which heights above 0.4 m shrink."""
    middle_y, middle_z = ring.T
    z = middle_z - slope * (middle_z - 0.4)
    return np.column_stack([np.full(4, x), middle_y * 0.96, z])
