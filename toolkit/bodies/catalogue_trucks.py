"""Trucks and buses of the catalogue."""

import numpy as np

from toolkit.bodies.shells import ShellSection, VehicleSize, loft_shell
from toolkit.bodies.wheels import make_axles
from toolkit.mesh import Mesh, box, ellipsoid, flip_sides, merge, place, tube

BELT_M = 1.05  # height of the lower edge of a bus's windows
FRAME_END_M = 0.9  # a truck's frame is shorter than the truck by this much


LARGE_TRUCK = VehicleSize(length=7.6, width=2.35, height=2.5)
SMALL_TRUCK = VehicleSize(length=6.3, width=2.05, height=2.25)
TIPPER = VehicleSize(length=7.9, width=2.4, height=2.75)
CITY_BUS = VehicleSize(length=12.0, width=2.55, height=3.0)
MIDIBUS = VehicleSize(length=8.9, width=2.35, height=2.85)


def trucks() -> dict[str, tuple[Mesh, Mesh]]:
    """Trucks and buses with their wing mirrors, x forward, wheels on z = 0."""
    # boxes: lengths of truck and box, width and height of the roof; axles: x of each (m)
    return {
        "box_truck": _join(
            [
                _make_cab(LARGE_TRUCK),
                _make_box(LARGE_TRUCK.length, length=5.6, width=2.45, top=3.35),
                *make_axles((2.5, -1.8), width=2.4, radius=0.45),
            ],
            _make_cab_mirror(LARGE_TRUCK),
        ),
        "small_box_truck": _join(
            [
                _make_cab(SMALL_TRUCK, 1.7),
                _make_box(SMALL_TRUCK.length, length=4.35, width=2.15, top=2.95),
                *make_axles((2.05, -1.55), width=2.1, radius=0.37),
            ],
            _make_cab_mirror(SMALL_TRUCK),
        ),
        "tipper": _join(
            [
                _make_cab(TIPPER),
                _make_tipper_bed(TIPPER.length, 5.5),
                *make_axles((2.6, -1.35, -2.65), width=2.45, radius=0.50),
            ],
            _make_cab_mirror(TIPPER),
        ),
        "city_bus": _join(
            [_make_bus(CITY_BUS), *make_axles((3.3, -2.6), width=2.5, radius=0.48)],
            _make_bus_mirror(CITY_BUS),
        ),
        "midibus": _join(
            [_make_bus(MIDIBUS), *make_axles((2.25, -2.15), width=2.3, radius=0.42)],
            _make_bus_mirror(MIDIBUS),
        ),
    }


def _join(parts: list[Mesh], mirror: Mesh) -> tuple[Mesh, Mesh]:
    """Merge a vehicle's parts, and make its mirrors on both sides from the left one."""
    return merge(parts), merge([mirror, flip_sides(mirror)])


def _make_cab(size: VehicleSize, cab_length: float = 2.0) -> Mesh:
    """Mesh of a cab without bonnet at the front of a truck.

    size: length of the truck, width and height of the cab; cab_length: m."""
    front = size.length / 2
    width = size.width
    height = size.height
    sections = [  # x, width, bottom and top of each (m)
        ShellSection(x=front - cab_length, width=width, bottom=0.55, top=height),
        ShellSection(x=front - 0.55, width=width, bottom=0.45, top=height),
        ShellSection(x=front - 0.25, width=width, bottom=0.40, top=height - 0.12),
        ShellSection(x=front - 0.07, width=width * 0.96, bottom=0.40, top=height - 0.75),
        ShellSection(x=front, width=width * 0.88, bottom=0.45, top=height - 1.25),
    ]
    return loft_shell(sections, corner=0.09)


def _make_cab_mirror(size: VehicleSize) -> Mesh:
    """Mesh of the left wing mirror of a cab."""
    middle = (size.length / 2 - 0.15, size.width / 2 + 0.12, size.height * 0.72)
    return box((0.12, 0.16, 0.42), centre=middle)


def _make_box(truck_length: float, length: float, width: float, top: float) -> Mesh:
    """Mesh of the box at the rear of a truck, with the truck's frame and rear guard.

    truck_length: length of the truck; length, width: size of the box; top: height of its roof (all
    m)."""
    rear = -truck_length / 2
    sections = [  # x, width, bottom and top of each (m)
        ShellSection(x=rear, width=width, bottom=0.95, top=top),
        ShellSection(x=rear + length, width=width, bottom=0.95, top=top),
    ]
    guard = box((0.12, width * 0.95, 0.14), centre=(rear + 0.1, 0, 0.5))
    frame = box((truck_length - FRAME_END_M, 0.85, 0.28), centre=(-0.35, 0, 0.80))
    return merge([loft_shell(sections, corner=0.04), frame, guard])


def _make_tipper_bed(truck_length: float, length: float) -> Mesh:
    """Mesh of an open tipper bed with a heap in it, and of the truck's frame.

    truck_length: length of the truck; length: length of the bed (both m)."""
    rear = -truck_length / 2
    middle = rear + length / 2
    walls = [box((length, 0.08, 1.35), centre=(middle, y, 1.75)) for y in (-1.2, 1.2)]
    walls += [box((0.08, 2.45, 1.35), centre=(x, 0, 1.75)) for x in (rear + 0.04, rear + length)]
    heap = ellipsoid((middle, 0, 1.6), radii=(length * 0.46, 1.12, 0.85), rings=5, sides=12)
    floor = box((length, 2.4, 0.12), centre=(middle, 0, 1.1))
    frame = box((truck_length - FRAME_END_M, 0.85, 0.3), centre=(-0.35, 0, 0.85))
    return merge([*walls, heap, floor, frame])


def _make_bus(size: VehicleSize) -> Mesh:
    """Mesh of a city bus with roof units and rounded ends; windows are set in by 2 cm.

    x forward from its middle, z = 0 on the ground."""
    front = size.length / 2
    rear = -front
    width = size.width
    height = size.height
    sections = [  # x, width, bottom and top of each (m)
        ShellSection(x=rear, width=width * 0.9, bottom=0.4, top=height - 0.25),
        ShellSection(x=rear + 0.12, width=width, bottom=0.32, top=height - 0.06),
        ShellSection(x=rear + 0.4, width=width, bottom=0.30, top=height),
        ShellSection(x=front - 0.5, width=width, bottom=0.30, top=height),
        ShellSection(x=front - 0.12, width=width * 0.98, bottom=0.30, top=height - 0.10),
        ShellSection(x=front, width=width * 0.90, bottom=0.35, top=height - 0.45),
    ]
    body = loft_shell(sections, corner=0.13)
    outer_width = width + 0.04  # pillars and skirt, next to the window band
    pillar_size = (0.14, outer_width, height - BELT_M - 0.45)
    pillar = box(pillar_size, centre=(0, 0, (BELT_M + height - 0.25) / 2))
    pillars = [place(pillar, x=x) for x in np.arange(rear + 0.8, front - 0.7, 1.45)]
    skirt_size = (size.length - 0.9, outer_width, BELT_M - 0.4)
    skirt = box(skirt_size, centre=(0, 0, (BELT_M + 0.4) / 2 + 0.02))
    unit_size = (1.8, 1.5, 0.22)
    roof_units = [
        box(unit_size, centre=(x, 0, height + 0.08)) for x in (-front * 0.5, front * 0.35)
    ]
    return merge([body, *pillars, skirt, *roof_units])


def _make_bus_mirror(size: VehicleSize) -> Mesh:
    """Mesh of the left wing mirror of a bus, on an arm ahead of it."""
    front = size.length / 2
    side = size.width / 2
    path = [  # x, y, z (m): along the arm, then down the mirror, which is thicker
        (front - 0.15, side, size.height - 0.35),
        (front + 0.12, side + 0.14, size.height - 0.5),
        (front + 0.12, side + 0.14, size.height - 0.95),
    ]
    return tube(path, radii=[0.03, 0.05, 0.09], sides=6)
