"""Cars of the catalogue."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from toolkit.bodies.car_body import Bed, Profile, Proportions, loft_parts, spread_stations
from toolkit.mesh import Mesh, ellipsoid, flip_sides, merge, tube
from toolkit.runtime.text_values import read_own_table

CAR_SHAPES = read_own_table(__file__, "cars.toml")
CAR_PROFILES: dict[str, Profile] = {
    style: tuple(map(tuple, corners)) for style, corners in CAR_SHAPES["profiles"].items()
}
CAR_NAMES = tuple(CAR_SHAPES["catalogue"])
FRONT_OVERHANG_SHARE = 0.44  # share of the front overhang in both overhangs
PICKUP_FRONT_OVERHANG_SHARE = 0.4


@dataclass(frozen=True)
class _CatalogueRow:
    """Row of the catalogue, see `cars.toml`; lengths in metres.

    Attributes:
        style: name of a side profile.
        length: length of the car.
        width: without mirrors.
        height: height of the car.
        wheelbase: between the axles.
        wheel: radius.
        clearance: height of the floor.
        belt: see `Proportions`.
        lean: see `Proportions`.
        rounding: see `Proportions`, at both ends.
        rake: stations by which the roof is farther back.
        has_rails: True for rails on the roof."""

    style: str
    length: float
    width: float
    height: float
    wheelbase: float
    wheel: float
    clearance: float
    belt: float
    lean: float
    rounding: float
    rake: float
    has_rails: bool

    @classmethod
    def parse(cls, values: Sequence[Any]) -> Self:
        """Make a row from the values of `cars.toml`; a twelfth value stands for roof rails."""
        return cls(*(*values[:11], len(values) > 11))


def cars() -> dict[str, tuple[Mesh, Mesh]]:
    """Cars with their wing mirrors, x forward, wheels on z = 0."""
    rows = {name: _CatalogueRow.parse(row) for name, row in CAR_SHAPES["catalogue"].items()}
    return {name: _loft_car(row) for name, row in rows.items()}


def _loft_car(row: _CatalogueRow) -> tuple[Mesh, Mesh]:
    """Meshes of a car and of its wing mirrors, wheels on z = 0."""
    parts = [loft_parts(_make_proportions(row))]
    if row.has_rails:
        parts += _make_rails(row)
    screen_foot, _ = CAR_PROFILES[row.style][2]  # station of the third corner of the profile
    # mirrors are 3.5 % of the length behind the foot of the windscreen
    mirror_x = row.length * (0.5 - screen_foot - max(row.rake, 0.0) - 0.035)
    mirror_place = (mirror_x, row.width / 2 + 0.005, row.belt * row.height + 0.04)
    mirror = ellipsoid(mirror_place, radii=(0.09, 0.10, 0.075), rings=3, sides=6)
    return merge(parts), merge([mirror, flip_sides(mirror)])


def _make_proportions(row: _CatalogueRow) -> Proportions:
    """Proportions of a car of the catalogue."""
    is_pickup = row.style == "pickup"
    # rows of station, a part of the length from the front, and part of the height
    profile = np.array(CAR_PROFILES[row.style])
    profile[2:-2, 0] += row.rake  # stations of all but the two first and the two last rows
    share = PICKUP_FRONT_OVERHANG_SHARE if is_pickup else FRONT_OVERHANG_SHARE
    # from the front to the first axle (m)
    overhang = (row.length - row.wheelbase) * share
    # what a row does not hold is equal for all cars
    return Proportions(
        kind=row.style,
        length=row.length,
        width=row.width,
        height=row.height,
        profile=profile,
        axles=(overhang, overhang + row.wheelbase),
        wheel=row.wheel,
        clearance=row.clearance,
        belt=row.belt,
        lean=row.lean,
        rounding=(row.rounding, row.rounding),
        ends=(0.62, 0.62),
        bow=0.035,
        camber=0.055,
        soft=0.018,
        samples=7,
        barrel=0.06,
        tail=0.14,
        tyre=0.12,
        bed=Bed(start=0.625 + row.rake, end=0.985, width=0.8) if is_pickup else None,
        spread=spread_stations(20, 2),
    )


def _make_rails(row: _CatalogueRow) -> list[Mesh]:
    """Meshes of the left and right rail on a car's roof, as tubes."""
    # `lean`: share of the width by which both sides lean in, 0.48 keeps the rail on the roof's edge
    y = row.width * (0.5 - 0.48 * row.lean)
    # the height is that of the rail's top, nearly: heights of the feet and of the tube's axis (m)
    low = row.height - 0.08
    high = row.height - 0.08 + 0.05
    points = [  # x, y, z from the front to the rear
        (0.08 * row.length, y, low),
        (0.02 * row.length, y, high),
        (-0.3 * row.length, y, high),
        (-0.36 * row.length, y, low),
    ]
    rail = tube(points, radii=0.02, sides=4)
    return [rail, flip_sides(rail)]
