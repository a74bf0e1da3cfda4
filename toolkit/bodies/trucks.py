"""Trucks and buses: what hides the rest of the traffic from a sensor."""

from __future__ import annotations

import numpy as np

from toolkit.bodies.cars import wheel_at
from toolkit.mesh import Mesh, box, ellipsoid, loft, merge, mirrored, tube


def trucks() -> dict[str, tuple[Mesh, Mesh]]:
    """Box trucks, a tipper and buses, x forward, wheels on z = 0, each with its wing mirrors beside it."""
    return {
        "box_truck": (
            merge([_cab(7.6, 2.35, 2.5), _cargo(7.6, 5.6, 2.45, 3.35), *_axles(7.6, 2.4, 0.45, (1.3, 5.6))]),
            _cab_mirrors(7.6, 2.35, 2.5),
        ),
        "small_box_truck": (
            merge([_cab(6.3, 2.05, 2.25, 1.7), _cargo(6.3, 4.35, 2.15, 2.95), *_axles(6.3, 2.1, 0.37, (1.1, 4.7))]),
            _cab_mirrors(6.3, 2.05, 2.25),
        ),
        "tipper": (
            merge([_cab(7.9, 2.4, 2.75), _skip(7.9, 5.5), *_axles(7.9, 2.45, 0.50, (1.35, 5.3, 6.6))]),
            _cab_mirrors(7.9, 2.4, 2.75),
        ),
        "city_bus": (
            merge([_bus(12.0, 2.55, 3.0), *_axles(12.0, 2.5, 0.48, (2.7, 8.6))]),
            _bus_mirrors(12.0, 2.55, 3.0),
        ),
        "midibus": (merge([_bus(8.9, 2.35, 2.85), *_axles(8.9, 2.3, 0.42, (2.2, 6.6))]), _bus_mirrors(8.9, 2.35, 2.85)),
    }


def _outline(width: float, z0: float, z1: float, corner: float) -> np.ndarray:
    """A closed rounded rectangle in (y, z), counter-clockwise seen from the front."""
    y, r = width / 2, corner
    quarter = np.linspace(0, np.pi / 2, 3)
    arcs = [
        np.stack([cy + r * np.cos(start + quarter), cz + r * np.sin(start + quarter)], axis=1)
        for cy, cz, start in (
            (y - r, z1 - r, 0.0), (r - y, z1 - r, np.pi / 2), (r - y, z0 + r, np.pi), (y - r, z0 + r, 1.5 * np.pi)
        )
    ]  # fmt: skip
    return np.concatenate(arcs)


def _shell(stations: list[tuple[float, float, float, float]], corner: float) -> Mesh:
    """A loft through rounded rectangles given as (x, width, floor, roof)."""
    rings = [_outline(width, z0, z1, corner) for _, width, z0, z1 in stations]
    return loft(np.stack([np.column_stack([np.full(len(r), s[0]), r]) for s, r in zip(stations, rings, strict=True)]))


def _cab(length: float, width: float, height: float, deep: float = 2.0) -> Mesh:
    """A forward-control cab whose front is at length / 2."""
    front = length / 2
    return _shell(
        [
            (front - deep, width, 0.55, height), (front - 0.55, width, 0.45, height),
            (front - 0.25, width, 0.40, height - 0.12),
            (front - 0.07, width * 0.96, 0.40, height - 0.75), (front, width * 0.88, 0.45, height - 1.25),
        ],
        0.09,
    )  # fmt: skip


def _cab_mirrors(length: float, width: float, height: float) -> Mesh:
    mirror = box((0.12, 0.16, 0.42), (length / 2 - 0.15, width / 2 + 0.12, height * 0.72))
    return merge([mirror, mirrored(mirror)])


def _cargo(length: float, deep: float, width: float, top: float) -> Mesh:
    rear = -length / 2
    load = _shell([(rear, width, 0.95, top), (rear + deep, width, 0.95, top)], 0.04)
    return merge(
        [load, box((length - 0.9, 0.85, 0.28), (-0.35, 0, 0.80)), box((0.12, width * 0.95, 0.14), (rear + 0.1, 0, 0.5))]
    )


def _skip(length: float, deep: float) -> Mesh:
    """An open tipper body with a heap in it."""
    rear = -length / 2
    middle = rear + deep / 2
    walls = [box((deep, 0.08, 1.35), (middle, y, 1.75)) for y in (-1.2, 1.2)]
    walls += [box((0.08, 2.45, 1.35), (x, 0, 1.75)) for x in (rear + 0.04, rear + deep)]
    heap = ellipsoid((middle, 0, 1.6), (deep * 0.46, 1.12, 0.85), 5, 12)
    return merge(
        [*walls, heap, box((deep, 2.4, 0.12), (middle, 0, 1.1)), box((length - 0.9, 0.85, 0.3), (-0.35, 0, 0.85))]
    )


def _bus(length: float, width: float, height: float) -> Mesh:
    """A city bus: window band set 4 cm in, roof units, rounded front and rear."""
    x, belt = length / 2, 1.05
    body = _shell(
        [
            (-x, width * 0.9, 0.4, height - 0.25), (-x + 0.12, width, 0.32, height - 0.06),
            (-x + 0.4, width, 0.30, height),
            (x - 0.5, width, 0.30, height), (x - 0.12, width * 0.98, 0.30, height - 0.10),
            (x, width * 0.90, 0.35, height - 0.45),
        ],
        0.13,
    )  # fmt: skip
    pillars = [
        box((0.14, width + 0.04, height - belt - 0.45), (p, 0, (belt + height - 0.25) / 2))
        for p in np.arange(-x + 0.8, x - 0.7, 1.45)
    ]
    skirt = box((length - 0.9, width + 0.04, belt - 0.4), (0, 0, (belt + 0.4) / 2 + 0.02))
    units = [box((1.8, 1.5, 0.22), (p, 0, height + 0.08)) for p in (-x * 0.5, x * 0.35)]
    return merge([body, *pillars, skirt, *units])


def _bus_mirrors(length: float, width: float, height: float) -> Mesh:
    x = length / 2
    mirror = tube(
        [
            (x - 0.15, width / 2, height - 0.35),
            (x + 0.12, width / 2 + 0.14, height - 0.5),
            (x + 0.12, width / 2 + 0.14, height - 0.95),
        ],
        [0.03, 0.05, 0.09],
        6,
    )
    return merge([mirror, mirrored(mirror)])


def _axles(length: float, width: float, radius: float, behind_front: tuple[float, ...]) -> list[Mesh]:
    breadth = 0.3
    wheels = [wheel_at(length / 2 - d, width / 2 - breadth / 2, radius, breadth, 14) for d in behind_front]
    return wheels + [mirrored(wheel) for wheel in wheels]
