"""The ground that sensors see: shadows worked out by hand, rings of a lidar, relief, ponds, roofs,
and the figures."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from placement_env.handover.ground import (
    MIN_POLYGON_M2,
    TARGET_HEIGHT_M,
    GroundGrid,
    GroundShares,
    blind_polygons,
    ground_shares,
    visible_ground,
    visible_polygons,
)
from toolkit.geometry import invert, look, pose, transform
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site, Solid

LIDAR = SpinningLidar(channels=33, fov_up=0.0, fov_down=-1.4, azimuth_step=float(np.deg2rad(0.5)))
HIGH = Sensor("high", LIDAR, pose(-7.03, 0.11, 5.0))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def middles(ground: GroundGrid) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid(ground.x, ground.y)


def field(**settings) -> Site:
    return Site("field", np.array([-12.0, -8, 12, 8]), **settings)


def test_the_grid_covers_the_area():
    ground = visible_ground(field(), [], cell=0.5)
    assert ground.cell == 0.5
    assert (ground.x[0], ground.x[-1], len(ground.x)) == (-11.75, 11.75, 48)
    assert (ground.y[0], ground.y[-1], len(ground.y)) == (-7.75, 7.75, 32)
    uneven = visible_ground(field(), [], cell=0.7)
    assert uneven.cell == pytest.approx(0.7)
    assert (uneven.x[0] + uneven.x[-1], uneven.y[0] + uneven.y[-1]) == pytest.approx((0, 0))
    assert (len(uneven.x), len(uneven.y)) == (34, 23)


def test_without_a_sensor_all_ground_is_blind():
    ground = visible_ground(field(), [])
    assert ground.seen.shape == ground.density.shape == (0, 32, 48)
    assert ground.open_ground.all()
    assert not ground.lanes.any()
    assert ground.views.tolist() == np.zeros((32, 48)).tolist()
    assert visible_polygons(ground) == []
    assert [part.area for part in blind_polygons(ground)] == [24 * 16]


def test_walls_cast_shadows():
    wall = Solid(rectangle(-2.1, -2.2, -1.9, 3.1), -0.5, 2.05, "wall")
    ground = visible_ground(field(solids=(wall,)), [HIGH])
    x, y = middles(ground)
    sx, sy, sz = HIGH.position

    def in_the_way(face: float) -> np.ndarray:
        share = np.clip((face - sx) / (x - sx), 0, None)  # of the way from the sensor to the target
        height, side = sz + share * (TARGET_HEIGHT_M - sz), sy + share * (y - sy)
        return (x > face) & (height < 2.05) & (side > -2.2) & (side < 3.1)

    expected = ~(in_the_way(-2.1) | in_the_way(-1.9))
    elevation = np.arctan2(TARGET_HEIGHT_M - sz, np.hypot(x - sx, y - sy))
    expected &= (elevation >= -1.4) & ground.open_ground
    assert np.array_equal(ground.seen[0], expected)
    assert 60 < (~expected[elevation >= -1.4]).sum() < 400
    sensors = [
        Sensor(
            "camera",
            DepthCamera(width=160, height=120, fov=1.1, max_range=14.0),
            look((-9.0, -5.0, 4.0), 0.6, 0.4),
        ),
        Sensor("solid", SolidStateLidar(), pose(5.0, 6.0, 3.0, yaw=-2.0, pitch=0.3)),
        Sensor("near", replace(LIDAR, max_range=6.0), pose(0.0, 0.0, 3.0)),
    ]
    ground = visible_ground(field(), sensors, cell=0.4)
    x, y = middles(ground)
    targets = np.stack([x, y, np.full_like(x, TARGET_HEIGHT_M)], axis=-1)
    for sensor, seen in zip(sensors, ground.seen, strict=True):
        assert np.array_equal(seen, sensor.model.in_view(transform(invert(sensor.pose), targets)))
        assert 0.02 < seen.mean() < 0.9
    near = np.hypot(np.hypot(x, y), 3.0 - TARGET_HEIGHT_M) < 6.0
    assert np.array_equal(
        ground.seen[2], near & (np.arctan2(TARGET_HEIGHT_M - 3.0, np.hypot(x, y)) >= -1.4)
    )


@pytest.mark.parametrize("cell", [0.0, -1.0, np.nan, np.inf, 11.0, 1e-5])
def test_a_cell_must_fit(cell):
    with pytest.raises(ValueError, match="cell"):
        visible_ground(field(), [], cell=cell)


def test_rings_of_a_lidar_are_counted_in_cells():
    ground = visible_ground(field(), [HIGH], cell=0.5)
    down = -np.linspace(0.0, -1.4, 33)[1:]
    turn = (np.arange(720) - 359.5) * np.deg2rad(0.5)
    radius = (5.0 / np.tan(down))[np.hypot(5.0 / np.tan(down), 5.0) < LIDAR.max_range]
    x, y = (
        HIGH.position[:2, None, None]
        + radius[:, None] * np.stack([np.cos(turn), np.sin(turn)])[:, None]
    )
    edges = (np.linspace(-12, 12, 49), np.linspace(-8, 8, 33))
    counts, *_ = np.histogram2d(x.ravel(), y.ravel(), edges)
    assert (
        np.abs(ground.density[0] * 0.25 - counts.T).max() <= 3
    )  # a point on an edge falls to either side
    assert ground.density[0].sum() * 0.25 == pytest.approx(counts.sum(), abs=3)
    assert np.corrcoef(ground.density[0].ravel(), counts.T.ravel())[0, 1] > 0.999


def test_nothing_is_seen_within_a_wall():
    house = Solid(rectangle(0.0, -4, 6, 4), -0.3, 3.0)
    ground = visible_ground(field(solids=(house,)), [HIGH])
    x, y = middles(ground)
    inside = (x > 0) & (x < 6) & (np.abs(y) < 4)
    assert np.array_equal(ground.open_ground, ~inside)
    assert not ground.seen[0][inside].any()
    assert not ground.density[0][inside].any()
    # what stands behind adds nothing before it
    before = (x < 0) | (np.hypot(x - HIGH.position[0], y) < 7)
    assert np.array_equal(
        ground.density[0][before], visible_ground(field(), [HIGH]).density[0][before]
    )
    behind = (x > 6) & (np.abs(y) < 4)
    assert not ground.density[0][behind & (x < 9)].any()


def test_crowns_are_seen_the_same_each_time():
    crown = Solid(rectangle(-1.0, -2, 3, 2), 2.0, 4.0, "tree")
    one, other = (visible_ground(field(solids=(crown,)), [HIGH]) for _ in range(2))
    assert all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("seen", "density", "open_ground")
    )
    assert blind_polygons(one) == blind_polygons(other)


def test_trees_and_ponds_are_no_ground():
    crown = Solid(rectangle(-1.0, -2, 3, 2), 2.0, 4.0, "tree")
    roof = Solid(rectangle(5.0, -7, 9, -4), 2.3, 2.5, "shelter")
    bush = Solid(rectangle(5.0, 4, 9, 7), 0.5, 2.5, "tree")
    ground = visible_ground(field(solids=(crown, roof, bush)), [HIGH])
    x, y = middles(ground)
    assert np.array_equal(ground.open_ground, ~((x > 5) & (x < 9) & (y > 4) & (y < 7)))
    behind = (x > 4) & (np.abs(y) < 1.5)
    assert 0.2 < 1 - ground.seen[0][behind].mean() < 1
    pond = Solid(rectangle(2.0, 1, 6, 5), -1.5, -0.05, "pond")
    ground = visible_ground(field(solids=(pond,)), [HIGH])
    x, y = middles(ground)
    assert np.array_equal(ground.open_ground, ~((x > 2) & (x < 6) & (y > 1) & (y < 5)))
    assert not ground.seen[0][~ground.open_ground].any()
    assert not ground.density[0][~ground.open_ground].any()
    relief = Relief(0.3, 2)
    slab = Solid(rectangle(-8.0, -6, 8, 6), -1.0, 0.1, "island")
    site = field(relief=relief, solids=(slab,))
    ground = visible_ground(site, [])
    x, y = middles(ground)
    height = site.ground(np.stack([x, y], axis=-1))
    on_slab = (np.abs(x) < 8) & (np.abs(y) < 6)
    assert np.array_equal(ground.open_ground, ~(on_slab & (height + TARGET_HEIGHT_M <= 0.1)))
    assert 0.1 < ground.open_ground[on_slab].mean() < 0.9
    lanes = (rectangle(-12.0, -2, 1, 2), rectangle(-1.0, -2, 12, 2))
    ground = visible_ground(field(lanes=lanes, footways=(rectangle(-12.0, 2, 12, 4),)), [])
    _, y = middles(ground)
    assert np.array_equal(ground.lanes, np.abs(y) < 2)
    assert np.array_equal(ground.footways, (y > 2) & (y < 4))


@pytest.mark.parametrize("seed", [1, 5])
def test_relief_shifts_targets_and_points_with_it(seed):
    ground = visible_ground(field(relief=Relief(0.25, seed)), [HIGH])
    level = visible_ground(field(), [HIGH])
    assert (ground.seen != level.seen).mean() < 0.05
    assert ground.seen[0].mean() > 0.9
    assert ground.density.sum() == pytest.approx(level.density.sum(), rel=0.05)


GRID = np.arange(4) + 0.5
VIEWS = np.array(
    [[[1, 1, 1, 0], [1, 1, 0, 0], [1, 1, 0, 0]], [[1, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]]], bool
)
OPEN = np.array([[1, 1, 1, 1], [1, 1, 1, 1], [0, 1, 1, 1]], bool)
LANES = np.array([[1, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 0]], bool)
SMALL = GroundGrid(GRID, GRID[:3], VIEWS, VIEWS.astype(np.float32), OPEN, LANES, ~LANES)


def test_shares_are_of_open_ground():
    shares = ground_shares(SMALL, ["a", "b"])
    assert shares == GroundShares(
        (6 / 11, 3 / 11, 0.0), 5 / 11, 1 / 4, {"a": 6, "b": 3}, open_m2=11.0, blind_m2=5.0
    )
    third = replace(SMALL, seen=VIEWS[[0, 1, 1]], density=SMALL.density[[0, 1, 1]])
    assert ground_shares(third, ["a", "b", "c"]).seen_by == (6 / 11, 3 / 11, 3 / 11)
    assert ground_shares(replace(SMALL, lanes=LANES & False), ["a", "b"]).blind_lanes == 0.0
    with pytest.raises(ValueError, match="no open ground"):
        ground_shares(replace(SMALL, open_ground=OPEN & False), ["a", "b"])


def test_polygons_leave_out_what_is_not_open():
    one, other = visible_polygons(SMALL)
    assert sum(part.area for part in one) == pytest.approx(6, abs=1.2)
    assert shapely.union_all(one).covers(shapely.Point(0.5, 0.5))
    assert not shapely.union_all(one).covers(shapely.Point(0.5, 2.5))  # a solid stands there
    assert sum(part.area for part in other) == pytest.approx(3, abs=1)
    (blind,) = blind_polygons(SMALL)
    assert blind.is_valid
    assert blind.covers(shapely.Point(3.5, 1.5))


def test_small_holes_and_specks_belong_to_what_is_around_them():
    open_ground = np.ones((40, 60), bool)
    seen = np.zeros((1, 40, 60), bool)
    seen[0, 5:35, 5:40] = True
    seen[0, 10:20, 10:20] = False  # a hole of 25 m²
    seen[0, 30, 30] = False  # and one of 0.25 m²
    seen[0, 20, 50] = True  # a speck of 0.25 m²
    x, y = np.arange(60) * 0.5 + 100.25, np.arange(40) * 0.5 - 49.75
    nothing = np.zeros((40, 60), bool)
    ground = GroundGrid(x, y, seen, seen.astype(np.float32), open_ground, nothing, nothing)
    ((part,),) = visible_polygons(ground)
    assert part.bounds == pytest.approx((102.5, -47.5, 120.0, -32.5))
    assert [shapely.Polygon(ring).area for ring in part.interiors] == [pytest.approx(25.0)]
    assert part.area == pytest.approx(15 * 17.5 - 25)
    blind = blind_polygons(ground)
    assert sorted(round(each.area) for each in blind) == [25, 30 * 20 - 262]
    assert min(each.area for each in blind) >= MIN_POLYGON_M2


@pytest.mark.parametrize("names", [[], ["a"], ["a", "a"], ["a", "b", "c"]])
def test_every_sensor_needs_a_name(names):
    with pytest.raises(ValueError, match="a name of its own"):
        ground_shares(SMALL, names)
