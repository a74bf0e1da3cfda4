"""Cars drawn at random: their proportions and their meshes.

Within a kind the length is drawn first; width and height follow it on average, each with a spread
of a decimetre and more, so that a car's width cannot be inferred from its length. Block-built cars
have no arches, no rounding and few triangles, as many models of others do. Every mesh is stretched
to the length, width and height that were drawn."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Rng
from toolkit.bodies.car_body import Bed, Profile, Proportions, loft_parts
from toolkit.bodies.car_kind import CarKind
from toolkit.bodies.catalogue_cars import CAR_PROFILES, CAR_SHAPES
from toolkit.bodies.mesh_parts import stretch
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import Mesh, Span, flip_sides, loft, merge, stand

# m, of the body without mirrors and roof loads
CAR_LENGTHS_M = (3.0, 6.0)
CAR_WIDTHS_M = (1.45, 2.2)
CAR_HEIGHTS_M = (1.25, 2.6)
CAR_KINDS = tuple(
    CarKind(name, profile=CAR_PROFILES[name], **row) for name, row in CAR_SHAPES["kinds"].items()
)
MIN_WHEELBASE_SHARE = 0.5  # share of the length
MAX_PROFILE_MIX = 0.2  # share of another kind's profile

_KIND_SHARES = np.array([kind.share for kind in CAR_KINDS]) / sum(kind.share for kind in CAR_KINDS)
_PROFILE_STATIONS = np.linspace(0, 1, 61)
# ranges of a drawn car: see `Proportions`; rounding and ends at front and rear
_FRONT_ROUNDING: Span = (0.03, 0.2)
_REAR_ROUNDING: Span = (0.02, 0.15)
_FRONT_END: Span = (0.5, 0.88)
_REAR_END: Span = (0.6, 0.95)
_BOW: Span = (0.0, 0.05)
_CAMBER_M: Span = (0.015, 0.06)
_SOFT: Span = (0.004, 0.03)


class _Level(NamedTuple):
    """Rectangle through which a block is lofted upwards.

    Attributes:
        z: its height (m).
        front: x of its front end, as a part of the length.
        rear: x of its rear end, as a part of the length.
        half_width: m."""

    z: float
    front: float
    rear: float
    half_width: float


def draw_proportions(rng: Rng) -> Proportions:
    """Draw the proportions of a car of any kind."""
    kind = CAR_KINDS[int(rng.choice(len(CAR_KINDS), p=_KIND_SHARES))]
    rank = rng.uniform()  # 0 for the shortest of its kind, 1 for the longest
    length = float(np.interp(rank, (0, 1), kind.length))
    # width and height follow the length in part only
    width = np.interp(0.6 * rank + 0.4 * rng.uniform(), (0, 1), kind.width)
    width += 0.085 * np.clip(rng.standard_normal(), -2, 2)
    height = np.interp(0.75 * rng.uniform() + 0.25 * rank, (0, 1), kind.height)
    profile = _draw_profile(kind, rng)
    wheel = float(rng.uniform(*kind.wheel))
    axles = _draw_axles(kind, length, wheel, rng)
    bed = None
    if kind.name == "pickup":
        # stations of the profile's low part behind the cabin; the bed has start, end and width
        low = profile[(profile[:, 1] < 0.7) & (profile[:, 0] > 0.45), 0]
        bed = Bed(start=float(low[0]) + 0.012, end=0.982, width=0.84)
    return Proportions(
        kind=kind.name,
        length=length,
        width=float(np.clip(width, *CAR_WIDTHS_M)),
        height=float(np.clip(height, *CAR_HEIGHTS_M)),
        profile=profile,
        axles=axles,
        wheel=wheel,
        clearance=float(rng.uniform(*kind.clearance)),
        belt=float(rng.uniform(*kind.belt)),
        lean=float(rng.uniform(*kind.lean)),
        rounding=(float(rng.uniform(*_FRONT_ROUNDING)), float(rng.uniform(*_REAR_ROUNDING))),
        ends=(float(rng.uniform(*_FRONT_END)), float(rng.uniform(*_REAR_END))),
        bow=float(rng.uniform(*_BOW)),
        camber=float(rng.uniform(*_CAMBER_M)),
        soft=float(rng.uniform(*_SOFT)),
        bed=bed,
    )


def _draw_axles(kind: CarKind, length: float, wheel: float, rng: Rng) -> tuple[float, float]:
    """Draw the distances of front and rear axle from the front of a car (m).

    kind: kind of car, as vans and pick-ups may have longer rears; length: length of the car (m);
    wheel: radius of its wheels (m)."""
    # from the axle to the end of the car (m); 4.3 and 4.6 m are usual lengths
    front_overhang = float(wheel + rng.uniform(0.32, 0.6) * min(1.0, length / 4.3))
    max_rear = 1.0 if kind.name in ("van", "pickup") else 0.75
    rear_overhang = float(wheel + rng.uniform(0.22, max_rear) * length / 4.6)
    # shorten both by a fifth of what is in front of or behind the wheel, until the axles are apart
    while length - front_overhang - rear_overhang < MIN_WHEELBASE_SHARE * length:
        front_overhang = wheel + 0.8 * (front_overhang - wheel)
        rear_overhang = wheel + 0.8 * (rear_overhang - wheel)
    return front_overhang, length - rear_overhang


def _draw_profile(kind: CarKind, rng: Rng) -> Float64[np.ndarray, "k 2"]:
    """Draw a side profile of a kind, with a little of another kind's mixed in.

    Rows are stations from 0 (front) to 1 (rear) and heights of the top, the highest of them 1."""
    profile = _jitter_corners(kind.profile, rng)
    other_kind = CAR_KINDS[int(rng.integers(len(CAR_KINDS)))]
    other_profile = _jitter_corners(other_kind.profile, rng)
    other_share = 0.0
    if kind.name != "pickup":
        other_share = float(np.clip(rng.exponential(0.06), 0, MAX_PROFILE_MIX))
    stations = np.unique(np.concatenate([profile[:, 0], _PROFILE_STATIONS]))
    heights = np.interp(stations, *profile.T)
    other_heights = np.interp(stations, *other_profile.T)
    mixed_heights = (1 - other_share) * heights + other_share * other_heights
    return np.column_stack([stations, mixed_heights / mixed_heights.max()])


def _jitter_corners(profile: Profile, rng: Rng) -> Float64[np.ndarray, "k 2"]:
    """Return a profile with its corners moved at random, the ends and the top less.

    Rows are station and height, sorted by station."""
    corners = np.array(profile)
    # views: changes of these columns change `corners`
    stations, heights = corners.T
    # all inner corners move together, and each a little more
    stations[2:-2] += rng.normal(0, 0.012) + rng.normal(0, 0.012, len(corners) - 4)
    rises = np.clip(rng.normal(0, 0.02, len(corners)), -0.04, 0.04)
    heights += rises * (heights < 0.93)  # the top of the roof stays
    stations[1:-1] = np.clip(stations[1:-1], 0.004, 0.996)
    return corners[np.argsort(stations, kind="stable")]


def loft_car(shape: Proportions) -> Mesh:
    """Loft a car without mirrors, x forward, wheels on z = 0."""
    return stretch(loft_parts(shape), (shape.length, shape.width, shape.height))


def build_block_car(shape: Proportions, rng: Rng) -> Mesh:
    """Build a car from a lower body, a cabin with slanted screens, and wheels or none.

    shape: gives its size and the places of cabin and axles; x forward, wheels on z = 0."""
    half_width = shape.width / 2
    floor = float(rng.choice([0.02, shape.clearance], p=[0.25, 0.75]))
    chamfer = float(rng.uniform(0.0, 0.06))
    lower_levels = _list_lower_levels(shape, floor, chamfer)
    cabin_levels = _list_cabin_levels(shape, chamfer)
    # the wheels' outline and breadth (m)
    sides = int(rng.choice([4, 8, 12]))
    breadth = float(rng.uniform(0.15, 0.26))
    wheels = []
    if floor > 0.05 or rng.random() < 0.5:
        for axle in shape.axles:
            y = half_width - breadth / 2 - 0.005
            wheel = make_wheel(
                shape.length / 2 - axle, y, radius=shape.wheel, breadth=breadth, sides=sides
            )
            wheels += [wheel, flip_sides(wheel)]
    blocks = [_loft_levels(levels, shape.length) for levels in (lower_levels, cabin_levels)]
    mesh = stand(merge([*blocks, *wheels]))
    return stretch(mesh, (shape.length, shape.width, shape.height))


def _list_lower_levels(shape: Proportions, floor: float, chamfer: float) -> list[_Level]:
    """Levels of the lower body from floor to belt line.

    floor: height of its floor (m); chamfer: breadth of its slanted edges (m)."""
    half_width = shape.width / 2
    belt = shape.belt * shape.height
    return [  # height, front, rear and half width of each
        _Level(z=floor, front=0.5 - 0.01, rear=-0.49, half_width=half_width - chamfer),
        _Level(z=floor + chamfer + 0.01, front=0.5, rear=-0.5, half_width=half_width),
        _Level(z=belt - chamfer - 0.01, front=0.5, rear=-0.5, half_width=half_width),
        _Level(z=belt, front=0.5 - 0.02, rear=-0.49, half_width=half_width - chamfer),
    ]


def _list_cabin_levels(shape: Proportions, chamfer: float) -> list[_Level]:
    """Levels of the cabin: its foot on the lower body, and the roof.

    chamfer: breadth of the slanted edges (m)."""
    # parts of the length from the front, and of the height
    stations, tops = shape.profile.T
    roof_stations = stations[tops >= 0.93]
    foot_stations = stations[tops >= 0.7]
    # x as parts of the length, from 0.5 at the front to -0.5 at the rear
    roof_front = 0.5 - roof_stations[0]
    roof_rear = 0.5 - roof_stations[-1]
    foot_front = max(0.5 - foot_stations[0] + 0.03, roof_front)
    foot_rear = min(0.5 - foot_stations[-1] - 0.02, roof_rear)
    half_width = shape.width / 2
    belt = shape.belt * shape.height
    return [  # height, front, rear and half width of each
        _Level(z=belt - 0.02, front=foot_front, rear=foot_rear, half_width=half_width - chamfer),
        _Level(
            z=shape.height,
            front=roof_front,
            rear=roof_rear,
            half_width=half_width * (1 - shape.lean),
        ),
    ]


def _loft_levels(levels: list[_Level], length: float) -> Mesh:
    """Mesh that is lofted upwards through rectangles.

    levels: rectangles from below upwards, their front and rear as parts of the length; length:
    length of the car (m)."""
    rings = []
    for level in levels:
        front_x = length * level.front
        rear_x = length * level.rear
        y = level.half_width
        z = level.z
        rings.append([(rear_x, -y, z), (front_x, -y, z), (front_x, y, z), (rear_x, y, z)])
    return loft(np.array(rings))
