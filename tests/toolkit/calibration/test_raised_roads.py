"""Ground under road users on embankments, bridges, ramps, in dips and next to kerbs, ray cast from
plain meshes."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import open3d as o3d
import pytest

from toolkit.calibration.ground import level
from toolkit.calibration.levels import GroundLevel, describe_levels
from toolkit.calibration.place import DETECTION_REACH_M, Place
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects

REACH_M = 80.0
STEP_M = 0.5
CAR_M, VAN_M = (4.4, 1.8, 1.5), (6.0, 2.1, 2.6)
NOISE_M = 0.02
MIN_POINTS = 5


class Uneven(NamedTuple):
    """Height of the terrain, decks above it, the lanes' middles with their heights, and where the
    lidar is."""

    terrain: Callable[[np.ndarray, np.ndarray], np.ndarray]
    lanes: Callable[[np.random.Generator], np.ndarray]
    lidar: tuple[float, float, float]
    decks: tuple[np.ndarray, ...] = ()


def bank(distance: np.ndarray, half: float, height: float, run: float = 1.5) -> np.ndarray:
    """Height of a bank at a distance from its middle, falling by 1 in `run`."""
    return np.clip(
        height - (np.abs(distance) - half) / run * np.sign(height), min(height, 0), max(height, 0)
    )


def places(
    rng: np.random.Generator, heights: Callable[[np.ndarray], np.ndarray], lanes=(-1.9, 1.9)
) -> np.ndarray:
    along = np.concatenate([np.arange(-45, 46, 11.0) + rng.uniform(-2, 2) for _ in lanes])
    across = np.repeat(lanes, len(along) // len(lanes))
    return np.column_stack([along, across, heights(along)])


def embankment(height: float) -> Uneven:
    def lanes(rng: np.random.Generator) -> np.ndarray:
        return places(rng, lambda along: np.full(len(along), height))

    return Uneven(lambda x, y: bank(y, 6.0, height), lanes, (0.0, -5.5, height + 5.0))


def profile(x: np.ndarray, top: float, slope: float, half: float) -> np.ndarray:
    """Height of a road that climbs to `top`, level over 2 `half`, with crests and sags of 16 m."""
    along = np.asarray(x)[..., None] + np.linspace(-8.0, 8.0, 17)
    plain = np.clip(top - (np.abs(along) - half) * slope * np.sign(top), min(top, 0), max(top, 0))
    return plain.mean(axis=-1)


def ramp() -> Uneven:
    """A slip road that leaves a main road at its level and climbs at 6 % to 6 m."""

    def climb(x: np.ndarray) -> np.ndarray:
        return np.clip((x + 40.0) * 0.06, 0.0, 6.0)

    def terrain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.maximum(
            np.clip(climb(x) - np.maximum(np.abs(y - 14.0) - 4.0, 0) / 1.5, 0.0, None), 0.0
        )

    def lanes(rng: np.random.Generator) -> np.ndarray:
        slip = places(rng, climb, (12.5, 15.5))
        return np.concatenate([slip, places(rng, lambda along: np.zeros(len(along)))])

    return Uneven(terrain, lanes, (0.0, -5.0, 6.0))


def dip() -> Uneven:
    """A road that goes down to -4.5 m at 7 % between walls."""

    def fall(x: np.ndarray) -> np.ndarray:
        return profile(x, -4.5, 0.07, 8.0)

    def terrain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(np.abs(y) < 5.0, fall(x), 0.0)

    return Uneven(terrain, lambda rng: places(rng, fall), (0.0, -5.6, 6.0))


def bridge() -> Uneven:
    """A deck at 5.5 m with approaches at 6 % over a level road, which runs along y."""

    def rise(x: np.ndarray) -> np.ndarray:
        return profile(x, 5.5, 0.06, 14.0)

    def terrain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        approach = np.clip(rise(x) - np.maximum(np.abs(y) - 5.5, 0) / 1.5, 0.0, None)
        return np.where(np.abs(x) < 13.0, 0.0, approach)

    def lanes(rng: np.random.Generator) -> np.ndarray:
        above = places(rng, rise)
        below = places(rng, lambda along: np.zeros(len(along)))[:, [1, 0, 2]]
        return np.concatenate([above, below[np.abs(below[:, 1]) > 8.0]])

    deck = np.array([-14.0, -5.5, 4.6, 14.0, 5.5, 5.5])
    return Uneven(terrain, lanes, (-12.0, -5.2, 10.5), (deck,))


def kerb() -> Uneven:
    def terrain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(np.abs(y) > 4.5, 0.15, 0.0) + 0.02 * x

    def lanes(rng: np.random.Generator) -> np.ndarray:
        return places(rng, lambda along: 0.02 * along)

    return Uneven(terrain, lanes, (0.0, -5.5, 6.0))


def grid_mesh(
    terrain: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    side = np.arange(-REACH_M, REACH_M + STEP_M, STEP_M)
    x, y = np.meshgrid(side, side, indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), terrain(x, y).ravel()])
    index = np.arange(len(vertices)).reshape(x.shape)
    one, two, three, four = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    corners = np.stack([one, two, three, one, three, four], axis=-1)
    return vertices, corners.reshape(-1, 3)


def add_box(scene: o3d.t.geometry.RaycastingScene, low: np.ndarray, high: np.ndarray) -> None:
    box = o3d.geometry.TriangleMesh.create_box(*(high - low).tolist()).translate(low.tolist())
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(box))


def cast(
    scene: o3d.t.geometry.RaycastingScene, lidar: tuple[float, ...], rng: np.random.Generator
) -> np.ndarray:
    rows, columns = (
        np.deg2rad(np.linspace(-25, 10, 64)),
        np.linspace(-np.pi, np.pi, 1200, endpoint=False),
    )
    up, round_ = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
    ways = np.column_stack([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])
    rays = np.column_stack([np.tile(lidar, (len(ways), 1)), ways]).astype(np.float32)
    far = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy().astype(np.float64)
    hit = far < 120.0
    return (far[hit] + NOISE_M * rng.standard_normal(hit.sum()))[:, None] * ways[hit]


def look_at(road: Uneven, seed: int, *, furniture: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Points in the lidar's frame, and the middles of the bottoms of road users that have
    points."""
    rng = np.random.default_rng(seed)
    scene = o3d.t.geometry.RaycastingScene()
    vertices, corners = grid_mesh(road.terrain)
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(corners.astype(np.uint32))
    )
    for deck in road.decks:
        add_box(scene, deck[:3], deck[3:])
    feet = road.lanes(rng)
    feet = feet[rng.random(len(feet)) < 0.6]
    sizes = np.array([VAN_M if rng.random() < 0.2 else CAR_M for _ in feet])
    for foot, size in zip(feet, sizes, strict=True):
        low = foot - [*size[:2] / 2, -0.25]
        add_box(scene, low, low + size)
    if furniture:
        for _ in range(8):
            x, y = rng.uniform(-60, 60), rng.choice([-1, 1]) * rng.uniform(24, 60)
            foot = np.array([x, y, float(road.terrain(np.array(x), np.array(y)))])
            add_box(scene, foot, foot + rng.uniform([6, 6, 3], [16, 12, 9]))
    points = cast(scene, road.lidar, rng)
    feet = feet - np.array(road.lidar)
    near = [
        (np.abs(points[:, :2] - foot[:2]) < size[:2] / 2).all(axis=1)
        & (points[:, 2] > foot[2] + 0.3)
        for foot, size in zip(feet, sizes, strict=True)
    ]
    seen = np.array([mask.sum() for mask in near]) >= MIN_POINTS
    seen &= np.abs(feet[:, :2]).max(axis=1) < DETECTION_REACH_M
    return points, feet[seen]


ROADS = {
    "raised by 3.3 m": embankment(3.3),
    "raised by 2 m": embankment(2.0),
    "raised by 6 m": embankment(6.0),
    "bridge": bridge(),
    "dip": dip(),
    "ramp": ramp(),
    "kerb": kerb(),
}

MIN_SHARE = 0.95


@pytest.mark.one_in(4)
@pytest.mark.parametrize("name", ROADS)
def test_the_ground_is_where_road_users_are(name: str) -> None:
    errors = []
    for seed in range(3):
        points, feet = look_at(ROADS[name], seed)
        errors.append(level(points).height(feet[:, :2]) - feet[:, 2])
    off = np.abs(np.concatenate(errors))
    assert len(off) >= 20
    assert (off < 0.15).mean() >= MIN_SHARE, np.sort(off)[-5:]


def test_the_ground_of_an_area_is_that_of_its_road() -> None:
    """A road 3.3 m above the land, in a plane; without the area the plane is that of the land."""
    points, _ = look_at(ROADS["raised by 3.3 m"], 0)
    narrow = Place("plane", area=(-40.0, -1.0, 40.0, 11.0))
    near = points - [*narrow.find_middle(frame_of(points)), 0.0]
    assert narrow.find_ground(near, "plane").plane[2] == pytest.approx(-5.0, abs=0.05)
    assert Place("plane").find_ground(points, "plane").plane[2] == pytest.approx(-8.3, abs=0.05)
    tiny = Place("plane", area=(-1.0, 5.0, 1.0, 7.0))
    ((_, stand),) = tiny.stands([frame_of(points)])
    assert stand.ground is not None


def frame_of(points: np.ndarray) -> Frame:
    cloud = SensorCloud("lidar", points.astype(np.float32), np.eye(4))
    return Frame.of_clouds("0", (cloud,), Objects.empty())


def test_a_raised_road_is_said_with_its_figure() -> None:
    points, _ = look_at(ROADS["raised by 3.3 m"], 1)
    ((_, stand),) = Place("map").stands([frame_of(points)])
    assert stand.warning is not None
    assert (
        "% of the points are 3.3 m above the ground found: they are levelled as further ground"
        in stand.warning
    )
    points, _ = look_at(ROADS["kerb"], 1)
    ((_, stand),) = Place("map").stands([frame_of(points)])
    assert stand.warning is None


def flat_grid(low: list[float], high: list[float], height: float, step: float = 0.4) -> np.ndarray:
    sides = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    x, y = (side.ravel() for side in sides)
    return np.column_stack([x, y, np.full(len(x), height)])


def test_roofs_and_canopies_are_doubted_but_are_no_ground() -> None:
    """A roof of 12 by 12 m, and one over a filling station, below which the ground is seen."""
    land = flat_grid([-40, -40], [40, 40], 0.0)
    hidden = (np.abs(land[:, :2] - [20.0, 20.0]) < 6.0).all(axis=1)
    roof = flat_grid([14, 14], [26, 26], 3.0, 0.15)
    ground = level(np.concatenate([land[~hidden], roof]) - [0.0, 0.0, 5.0])
    assert [one.is_ground for one in ground.levels] == [False]
    doubt = describe_levels(ground.levels)
    assert doubt is not None
    assert doubt.startswith(
        "13% of the points are 3.0 m above the ground found: give the road's own --area"
    )
    canopy = flat_grid([-30, 10], [10, 30], 5.0)
    ground = level(np.concatenate([land, canopy]) - [0.0, 0.0, 5.0])
    assert ground.height(np.array([[-10.0, 20.0]])) == pytest.approx(-5.0, abs=0.02)
    assert not any(one.is_ground for one in ground.levels)


def test_small_surfaces_are_not_doubted() -> None:
    assert describe_levels(()) is None
    assert describe_levels((GroundLevel(3.0, 0.02, False), GroundLevel(2.0, 0.02, False))) is None
    both = (
        GroundLevel(3.0, 0.04, False),
        GroundLevel(2.0, 0.03, False),
        GroundLevel(-4.0, 0.5, True),
    )
    assert describe_levels(both) == (
        "7% of the points are 3.0 m above the ground found: give the road's own --area if they "
        "are a road; a roof needs nothing"
    )
    assert "50% of the points are 4.0 m below the ground found" in str(describe_levels(both[2:]))
