"""Trucks drawn at random, rigid and articulated."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Rng
from toolkit.bodies.mesh_parts import DrawnMesh, mound, plank
from toolkit.bodies.shells import ShellSection, loft_shell
from toolkit.bodies.wheels import make_axles
from toolkit.mesh import Mesh, box, flip_sides, merge, tube

SUPERSTRUCTURES = {  # share of trucks with each kind of load; shares add up to 1
    "box": 0.32,
    "curtain": 0.12,
    "flatbed": 0.16,
    "tipper": 0.13,
    "tank": 0.07,
    "refuse": 0.07,
    "container": 0.08,
    "mixer": 0.05,
}
CONTAINER_WIDTH_M = 2.44
MAX_TRUCK_HEIGHT_M = 4.0
SHELL_RADIUS_M = 0.06  # radius of the rounded edges of cabs and boxes


class _LoadSpace(NamedTuple):
    """Room for the load of a truck (m).

    Attributes:
        front: x of its front end.
        rear: x of its rear end.
        width: its breadth.
        floor: height of its floor.
        cab_height: height of the cab ahead of it."""

    front: float
    rear: float
    width: float
    floor: float
    cab_height: float

    @property
    def length(self) -> float:
        """Distance from the rear end to the front (m)."""
        return self.front - self.rear

    @property
    def middle(self) -> float:
        """x of its middle."""
        return (self.front + self.rear) / 2


def draw_truck(rng: Rng) -> DrawnMesh:
    """Draw a rigid truck. x forward, wheels on z = 0, lengths in m."""
    length = float(rng.uniform(5.2, 11.5))
    # width and cab grow with the length, from the shortest truck of 5.2 m on
    width = float(np.clip(1.95 + 0.075 * (length - 5.2) + rng.normal(0, 0.1), 1.85, 2.55))
    cab_height = float(np.clip(2.1 + 0.16 * (length - 5.2) + rng.normal(0, 0.2), 2.0, 3.3))
    cab_length = float(rng.uniform(1.5, 2.3))
    cab, mirrors = _draw_cab(
        front=length / 2, width=width, height=cab_height, length=cab_length, rng=rng
    )
    # between cab and load
    gap = float(rng.uniform(0.05, 0.3))
    # height of the load's floor
    floor = float(rng.uniform(0.85, 1.2))
    # x of the load's front
    front = length / 2 - cab_length - gap
    space = _LoadSpace(
        front=front, rear=-length / 2, width=width, floor=floor, cab_height=cab_height
    )
    load_kind, load = _draw_superstructure(space, rng)
    chassis = _draw_chassis(length, width, floor, rng)
    return DrawnMesh(f"{load_kind}_truck", merge([cab, load, *chassis]), outside=mirrors)


def draw_semi_trailer(rng: Rng) -> DrawnMesh:
    """Draw an articulated truck, its trailer straight behind. x forward, wheels on z = 0.

    Lengths are in m."""
    length = float(rng.uniform(12.5, 17.0))
    width = float(rng.uniform(2.4, 2.58))
    cab_height = float(rng.uniform(2.9, 3.9))
    cab_length = float(rng.uniform(1.9, 2.5))
    cab_width = width - float(rng.uniform(0, 0.1))
    cab, mirrors = _draw_cab(
        front=length / 2, width=cab_width, height=cab_height, length=cab_length, rng=rng
    )
    # x of the trailer's front
    front = length / 2 - cab_length - float(rng.uniform(0.5, 1.0))
    # height of the load's floor
    floor = float(rng.uniform(1.1, 1.3))
    space = _LoadSpace(
        front=front, rear=-length / 2, width=width, floor=floor, cab_height=cab_height
    )
    load_kind, load = _draw_superstructure(space, rng)
    wheel_radius = float(rng.uniform(0.46, 0.53))
    tractor_axles = [length / 2 - 1.4, front - 0.6]
    # three axles of the trailer, 1.35 m apart, from a random overhang behind them on
    trailer_axles = [-length / 2 + float(rng.uniform(1.6, 2.6)) + 1.35 * k for k in range(3)]
    wheels = make_axles(
        [*tractor_axles, *trailer_axles], width=width - 0.04, radius=wheel_radius, sides=12
    )
    frame = plank((length - 1.2, 0.9, 0.3), x=-0.3, y=0.0, z=floor - 0.3)
    return DrawnMesh(
        f"articulated_{load_kind}", merge([cab, load, frame, *wheels]), outside=mirrors
    )


def _draw_cab(
    front: float, width: float, height: float, length: float, rng: Rng
) -> tuple[Mesh, Mesh]:
    """Draw the meshes of a cab and of its wing mirrors.

    front: x of its front end; width, height, length: its size without a bonnet (all m)."""
    bottom = float(rng.uniform(0.3, 0.6))
    rake = float(rng.uniform(0.04, 0.35))
    bonnet = float(rng.uniform(0.8, 1.3)) if rng.random() < 0.12 else 0.0
    screen = front - bonnet  # x of the foot of the windscreen
    corner = float(rng.uniform(0.03, 0.15))
    sill = bottom + 0.45 * (height - bottom)
    # from the rear to the front, m; the screen leans back by the rake
    sections = [
        ShellSection(x=screen - length + bonnet, width=width, bottom=bottom, top=height),
        ShellSection(x=screen - 0.6 * rake - corner, width=width, bottom=bottom, top=height),
        ShellSection(
            x=screen - 0.3 * rake,
            width=width - corner,
            bottom=bottom,
            top=height - 0.3 * (height - sill),
        ),
        ShellSection(x=screen, width=width - 2 * corner, bottom=bottom, top=sill),
    ]
    parts = [loft_shell(sections, corner=SHELL_RADIUS_M, points=2)]
    if bonnet:
        bonnet_sections = [
            ShellSection(x=screen - 0.3, width=0.9 * width, bottom=bottom, top=sill),
            ShellSection(x=front, width=0.75 * width, bottom=bottom, top=sill - 0.25),
        ]
        parts.append(loft_shell(bonnet_sections, corner=SHELL_RADIUS_M, points=2))
    if rng.random() < 0.25:
        deflector = (0.5 * length, 0.8 * width, float(rng.uniform(0.3, 0.6)))
        parts.append(plank(deflector, x=screen - 0.6 * length, y=0.0, z=height - 0.03))
    mirror_height = float(rng.uniform(0.25, 0.5))
    overhang = float(rng.uniform(0.1, 0.28))
    mirror_size = (float(rng.uniform(0.06, 0.2)), overhang + 0.04, mirror_height)
    mirror_place = (screen - 0.2, width / 2 + overhang / 2 - 0.02, 0.68 * height)
    mirror = box(mirror_size, centre=mirror_place)
    return merge(parts), merge([mirror, flip_sides(mirror)])


def _draw_superstructure(space: _LoadSpace, rng: Rng) -> tuple[str, Mesh]:
    """Draw the load of a truck, and return its kind (a key of `SUPERSTRUCTURES`) and mesh.

    space: room for it behind the cab."""
    kind = str(rng.choice(list(SUPERSTRUCTURES), p=list(SUPERSTRUCTURES.values())))
    deck = plank((space.length, space.width, 0.14), x=space.middle, y=0.0, z=space.floor - 0.02)
    unlimited_top = space.cab_height + rng.uniform(-0.2, 1.0)
    top = float(np.clip(unlimited_top, space.floor + 1.0, MAX_TRUCK_HEIGHT_M))
    if kind in ("box", "curtain", "container"):
        load = _make_box(space, top, is_container=kind == "container")
    elif kind == "refuse":
        load = _make_refuse_body(space, top)
    elif kind == "tank":
        load = _draw_tank(space, rng)
    elif kind == "mixer":
        load = _make_mixer(space)
    else:
        load = _draw_open_bed(space, is_tipper=kind == "tipper", rng=rng)
    return kind, merge([deck, load])


def _make_box(space: _LoadSpace, top: float, *, is_container: bool) -> Mesh:
    """Mesh of a box, curtain-sider or container on a truck; a container is narrower.

    space: room for it behind the cab; top: height of its roof (m)."""
    width = min(space.width, CONTAINER_WIDTH_M) if is_container else space.width
    sections = [  # x, width, bottom and top of each (m)
        ShellSection(x=space.rear, width=width, bottom=space.floor, top=top),
        ShellSection(x=space.front, width=width, bottom=space.floor, top=top),
    ]
    return loft_shell(sections, corner=SHELL_RADIUS_M, points=2)


def _make_refuse_body(space: _LoadSpace, top: float) -> Mesh:
    """Mesh of the body of a refuse truck, lower and narrower at its tail.

    top: height of its roof (m)."""
    floor = space.floor
    sections = [  # x, width, bottom and top of each (m)
        ShellSection(x=space.rear, width=0.9 * space.width, bottom=floor - 0.2, top=floor + 1.2),
        ShellSection(x=space.rear + 0.2 * space.length, width=space.width, bottom=floor, top=top),
        ShellSection(x=space.front, width=space.width, bottom=floor, top=top - 0.15),
    ]
    return loft_shell(sections, corner=SHELL_RADIUS_M, points=2)


def _draw_tank(space: _LoadSpace, rng: Rng) -> Mesh:
    """Draw a tank as broad as the truck."""
    radius = min(space.width / 2, float(rng.uniform(0.75, 1.2)))
    stations = (space.rear, space.rear + 0.15, space.front - 0.15, space.front)
    axis = [(x, 0.0, space.floor + radius) for x in stations]
    radii = [0.7 * radius, radius, radius, 0.7 * radius]
    return tube(axis, radii=radii, sides=14, flat=space.width / 2 / radius)


def _make_mixer(space: _LoadSpace) -> Mesh:
    """Mesh of the drum of a concrete mixer, sloping down to the front."""
    axis = [  # x, y, z from the rear to the front
        (space.rear, 0.0, space.floor + 1.5),
        (space.middle, 0.0, space.floor + 1.25),
        (space.front - 0.1, 0.0, space.floor + 1.0),
    ]
    return tube(axis, radii=[0.45, min(1.15, space.width / 2), 0.6], sides=14)


def _draw_open_bed(space: _LoadSpace, is_tipper: bool, rng: Rng) -> Mesh:
    """Draw a bed with low walls, and a heap, crates or nothing on it.

    space: room for it behind the cab; is_tipper: with higher walls, and always a heap."""
    floor = space.floor
    wall_height = float(rng.uniform(0.8, 1.5) if is_tipper else rng.uniform(0.3, 0.7))
    # sizes: length, width, height (m)
    side_wall_size = (space.length, 0.06, wall_height)
    end_wall_size = (0.06, space.width, wall_height)
    parts = []
    for y in (-space.width / 2 + 0.03, space.width / 2 - 0.03):
        parts.append(plank(side_wall_size, x=space.middle, y=y, z=floor))
    for x in (space.rear + 0.03, space.front - 0.03):
        parts.append(plank(end_wall_size, x=x, y=0.0, z=floor))
    chance = rng.random()
    if is_tipper or chance < 0.3:
        heap_height = wall_height * float(rng.uniform(0.6, 1.35))
        heap_size = (0.92 * space.length, 0.9 * space.width, heap_height)
        parts.append(mound(heap_size, x=space.middle, z=floor + 0.12))
    elif chance < 0.75:
        # three crates: length and width as parts of the bed, height in m
        shares = rng.uniform((0.15, 0.5, 0.4), (0.3, 0.95, 1.6), (3, 3))
        sizes = shares * [space.length, space.width - 0.15, 1.0]
        for k, (length, width, height) in enumerate(sizes.tolist()):
            x = space.rear + space.length * (0.2 + 0.3 * k)
            parts.append(plank((length, width, height), x=x, y=0.0, z=floor))
    return merge(parts)


def _draw_chassis(length: float, width: float, floor: float, rng: Rng) -> list[Mesh]:
    """Draw frame, rear guard and wheels of a rigid truck.

    length, width: size of the truck; floor: height of its load's floor (all m)."""
    usual_radius = 0.36 + 0.03 * (length - 5.2)
    wheel_radius = float(np.clip(usual_radius + rng.uniform(-0.03, 0.03), 0.34, 0.53))
    rear_axle = -length / 2 + float(rng.uniform(0.9, 0.28 * length))
    axles = [length / 2 - float(rng.uniform(1.0, 1.45)), rear_axle]
    # a long truck has two rear axles
    if length > 8.5:
        axles.append(rear_axle + 2.3 * wheel_radius + 0.2)
    frame = plank((length - 0.8, 0.85, 0.28), x=-0.3, y=0.0, z=floor - 0.3)
    guard_size = (0.12, 0.93 * width, 0.14)
    guard = plank(guard_size, x=-length / 2 + 0.1, y=0.0, z=float(rng.uniform(0.4, 0.55)))
    return [frame, guard, *make_axles(axles, width=width - 0.04, radius=wheel_radius, sides=12)]
