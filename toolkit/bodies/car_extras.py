"""Wing mirrors and loads of drawn cars."""

import numpy as np

from toolkit.arrays import Rng
from toolkit.bodies.car_body import Bed, Proportions
from toolkit.bodies.mesh_parts import NOTHING, mound, plank
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import Mesh, box, ellipsoid, flip_sides, loft, merge, place, tube

# kinds of loads that a car's name may end in
CARRIED = ("taxi", "light_bar", "roof_box", "rack", "rails", "spare_wheel", "hard_top", "load")
NO_MIRROR_SHARE = 0.3
SINGLE_MIRROR_SHARE = 0.02
_TAXIS = ("sedan", "estate", "minivan", "hatchback", "suv")
_RACKS = ("van", "minivan", "pickup")
_RAILS = ("estate", "suv", "minivan")
_RACK_STATIONS = (-0.4, 0.0, 0.4)  # cross bars, as parts of the rack's length


def draw_mirrors(shape: Proportions, rng: Rng) -> Mesh:
    """Draw the wing mirrors of a car, which stick out 8 to 25 cm.

    3 cars in 10 have no mirrors, 1 in 50 has one."""
    # below `NO_MIRROR_SHARE`: no mirrors; above 1 - `SINGLE_MIRROR_SHARE`: only the left one
    chance = rng.random()
    if chance < NO_MIRROR_SHARE:
        return NOTHING
    scale = 1.6 if shape.kind == "van" else 1.0
    half_height = rng.uniform(0.06, 0.09) * scale
    half_depth = rng.uniform(0.05, 0.11)
    overhang = rng.uniform(0.08, 0.19 + 0.04 * scale)
    stations, tops = shape.profile.T  # parts of the length, and of the height
    # mirrors are 3 % of the length ahead of the first station of the windscreen's upper part
    is_screen = (tops > 0.75) & (stations < 0.6)
    screen_station = float(stations[is_screen][0])
    x = shape.length * (0.5 - screen_station + 0.03)
    z = shape.belt * shape.height + half_height + rng.uniform(-0.03, 0.06)
    # from 4 cm inside the side of the car to the overhang outside it
    y = shape.width / 2 + overhang / 2 - 0.02
    half_breadth = overhang / 2 + 0.02
    if rng.random() < 0.4:
        housing = box((half_depth, 2 * half_breadth, 2 * half_height), centre=(x, y, z))
    else:
        housing = ellipsoid(
            (x, y, z), radii=(half_depth, half_breadth, half_height), rings=3, sides=8
        )
    arm_z = z - 0.6 * half_height
    arm = tube([(x, 0.75 * shape.width / 2, arm_z), (x, y, arm_z)], radii=0.025, sides=4)
    mirror = merge([housing, arm])
    return mirror if chance > 1 - SINGLE_MIRROR_SHARE else merge([mirror, flip_sides(mirror)])


def draw_load(shape: Proportions, rng: Rng) -> tuple[str, Mesh]:
    """Draw a load on a car's roof or bed, or no load; return its kind and mesh.

    The kind is one of `CARRIED`, or "" with an empty mesh."""
    chance = rng.random()
    if shape.bed is not None:
        return _draw_bed_load(shape, shape.bed, rng)
    roof_stations = shape.profile[shape.profile[:, 1] > 0.965, 0]
    front = shape.length * (0.5 - float(roof_stations[0]))
    rear = shape.length * (0.5 - float(roof_stations[-1]))
    middle = (front + rear) / 2
    roof_length = front - rear
    roof_width = shape.width * (1 - shape.lean)
    z = shape.height
    if shape.kind in _TAXIS and chance < 0.06:
        size = (rng.uniform(0.1, 0.28), rng.uniform(0.25, 0.7), rng.uniform(0.09, 0.18))
        x = middle + 0.2 * roof_length * rng.uniform(-1, 1)
        return "taxi", plank(size, x=x, y=0.0, z=z - 0.02)
    if chance < 0.075 and shape.kind != "coupe":
        size = (0.3, 0.62 * roof_width, 0.13)
        return "light_bar", plank(size, x=middle + 0.2 * roof_length, y=0.0, z=z - 0.02)
    if shape.kind in _TAXIS and chance < 0.135:
        return "roof_box", _draw_roof_box(middle, roof_width, z, rng)
    if shape.kind in _RACKS and chance < 0.2:
        return "rack", _draw_rack(
            x=middle, length=0.8 * roof_length, roof_width=roof_width, z=z, rng=rng
        )
    if shape.kind in _RAILS and chance < 0.5:
        return "rails", _make_rails(front, rear, 0.42 * roof_width, z)
    if shape.kind == "offroader" and chance < 0.6:
        breadth = rng.uniform(0.16, 0.24)
        spare_wheel = make_wheel(0.0, 0.0, radius=0.92 * shape.wheel, breadth=breadth)
        x = -shape.length / 2 - 0.08
        return "spare_wheel", place(spare_wheel, x=x, y=0.0, z=0.36 * shape.height, yaw=np.pi / 2)
    return "", NOTHING


def _make_rails(front: float, rear: float, y: float, z: float) -> Mesh:
    """Rails on both sides of a roof, at y and -y, between x = rear and front, at height z (m)."""
    length = front - rear
    points = [  # x, y, z of the left rail, its ends sunk into the roof
        (rear + 0.1 * length, y, z - 0.03),
        (rear + 0.15 * length, y, z + 0.03),
        (front - 0.15 * length, y, z + 0.03),
        (front - 0.1 * length, y, z - 0.03),
    ]
    rail = tube(points, radii=0.02, sides=4)
    return merge([rail, flip_sides(rail)])


def _draw_bed_load(shape: Proportions, bed: Bed, rng: Rng) -> tuple[str, Mesh]:
    """Draw a load on a pick-up's bed, a hard top over it, or nothing; return kind and mesh.

    The kind is "hard_top", "load", or "" with an empty mesh."""
    # x and z (m) of the bed
    front = shape.length * (0.5 - bed.start)
    rear = shape.length * (0.5 - bed.end)
    middle = (front + rear) / 2
    belt = shape.belt * shape.height
    floor = belt - 0.43
    # sizes (m) of the room for a load, and of the roof
    room = 0.9 * (front - rear)
    roof_width = shape.width * (1 - shape.lean)
    width = 0.78 * shape.width * (1 - shape.lean)
    chance = rng.random()
    if chance < 0.15:
        z = belt - 0.05
        size = (front - rear, roof_width, shape.height - z - 0.02)
        return "hard_top", plank(size, x=middle, y=0.0, z=z)
    if chance < 0.3:
        return "load", mound((room, width, float(rng.uniform(0.4, 0.9))), x=middle, z=floor)
    if chance < 0.45:
        # two crates: length and width as parts of the room, height in m
        shares = rng.uniform((0.3, 0.3, 0.4), (0.6, 0.9, 1.1), (2, 3))
        sizes = (shares * [room, width, 1.0]).tolist()
        crates = []
        for size, end in zip(sizes, (-1, 1), strict=True):  # end: -1 at the rear, 1 at the front
            crate_length, crate_width, crate_height = size
            x = middle + end * (room - crate_length) / 2
            y = rng.uniform(-1, 1) * (width - crate_width) / 2
            crates.append(plank((crate_length, crate_width, crate_height), x=x, y=y, z=floor))
        return "load", merge(crates)
    return "", NOTHING


def _draw_roof_box(x: float, roof_width: float, z: float, rng: Rng) -> Mesh:
    """Draw a roof box on two bars.

    x: middle of the roof; roof_width: its width; z: height of the roof (all m)."""
    length = rng.uniform(1.3, 2.2)
    width = rng.uniform(0.5, 0.85)
    height = rng.uniform(0.26, 0.42)
    y = float(rng.uniform(-0.5, 0.5)) * max(roof_width - width - 0.2, 0.0)
    # y and z of a cross-section's six corners, as parts of width and height
    corners = [[-0.5, 0.1], [0.5, 0.1], [0.5, 0.6], [0.4, 1.0], [-0.4, 1.0], [-0.5, 0.6]]
    ring = np.array(corners) * [width, height]
    # place along the box as a part of its length, and share of its height
    sections = ((-0.5, 0.75), (-0.42, 1.0), (0.3, 1.0), (0.5, 0.4))
    rings = [
        np.column_stack([np.full(6, x + length * station), y + ring[:, 0], z + ring[:, 1] * share])
        for station, share in sections
    ]
    # length, width, height (m)
    bar = (0.06, 0.9 * roof_width, 0.05 + 0.1 * height)
    bars = [plank(bar, x=x + side * 0.3 * length, y=0.0, z=z - 0.03) for side in (-1, 1)]
    return merge([loft(np.stack(rings)), *bars])


def _draw_rack(x: float, length: float, roof_width: float, z: float, rng: Rng) -> Mesh:
    """Draw a roof rack: cross bars on feet and, mostly, a ladder on them.

    x: middle of the roof; length: length of the rack; roof_width: width of the roof;
    z: height of the roof (all m)."""
    # height of the bars above the roof (m)
    height = float(rng.uniform(0.05, 0.14))
    # sizes: length, width, height (m)
    bar_size = (0.05, 0.9 * roof_width, 0.04)
    foot_size = (0.04, 0.04, height + 0.05)
    parts = [
        plank(bar_size, x=x + station * length, y=0.0, z=z + height - 0.02)
        for station in _RACK_STATIONS
    ]
    for station in _RACK_STATIONS:
        for y in (-0.42 * roof_width, 0.42 * roof_width):
            parts.append(plank(foot_size, x=x + station * length, y=y, z=z - 0.05))
    if rng.random() < 0.7:
        y = float(rng.uniform(-0.2, 0.2)) * roof_width
        half_length = 0.5 * length * float(rng.uniform(0.9, 1.1))
        beam_z = z + height + 0.05
        for beam_y in (y - 0.2, y + 0.2):
            beam = [(x - half_length, beam_y, beam_z), (x + half_length, beam_y, beam_z)]
            parts.append(tube(beam, radii=0.035, sides=5))
        for station in np.linspace(-0.9, 0.9, 7).tolist():
            rung_size = (0.04, 0.4, 0.04)
            parts.append(plank(rung_size, x=x + station * half_length, y=y, z=z + height + 0.03))
    return merge(parts)
