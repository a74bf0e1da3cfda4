import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolkit.calibration import (
    ground,
    ground_plane,
    height_map,
    level_warning as level_warning_room,
)
from toolkit.calibration.ground import Ground, level, plain_points
from toolkit.calibration.ground_plane import fit_plane, heights_above_plane
from toolkit.calibration.height_map import HeightMap, fit_map, low_points, lowest_mask, support_mask
from toolkit.calibration.level_warning import level_warning
from toolkit.clouds import from_points
from toolkit.datasets.layouts.argoverse import argoverse, read_labels
from toolkit.geometry import invert, pose, transform


def scattered(rng, low, high, height, count, noise=0.0):
    xy = rng.uniform(low, high, (count, 2))
    return np.column_stack(
        [xy, np.broadcast_to(height, count) + noise * rng.standard_normal(count)]
    )


def sloped(points, a, b, c):
    return points + np.column_stack([np.zeros((len(points), 2)), points[:, :2] @ [a, b] + c])


@pytest.mark.parametrize(
    "plane", [(0.0, 0.0, -1.7), (0.06, 0.0, -6.0), (-0.1, 0.18, -1.7), (0.0, -0.05, 12.0)]
)
def test_the_plane_is_that_of_the_ground_to_a_centimetre(plane):
    street = scattered(np.random.default_rng(0), -40, 40, 0.0, 6000, noise=0.02)
    assert (np.abs(fit_plane(sloped(street, *plane)) - plane) < [2e-3, 2e-3, 0.01]).all()


def test_roofs_walls_cars_and_reflections_are_not_the_ground():
    rng = np.random.default_rng(1)
    street, roof = (
        scattered(rng, [-30, -4], [30, 4], 0.0, 2000),
        scattered(rng, [-30, 5], [30, 30], 5.0, 20000),
    )
    np.testing.assert_allclose(fit_plane(np.concatenate([roof, street])), 0.0, atol=0.01)
    rng = np.random.default_rng(2)
    street = scattered(rng, [-30, -6], [30, 6], -6.0, 1500, noise=0.02)
    wall = np.column_stack(
        [rng.uniform(-30, 30, 20000), np.full(20000, 6.5), rng.uniform(-6, 4, 20000)]
    )
    hedge = scattered(rng, [-30, -8], [30, -6], -4.8, 5000, noise=0.1)
    cars = scattered(rng, [-10, -2], [10, 2], rng.uniform(-5.8, -4.5, 6000), 6000)
    np.testing.assert_allclose(
        fit_plane(np.concatenate([street, wall, hedge, cars])), [0, 0, -6.0], atol=0.02
    )
    rng = np.random.default_rng(3)
    street = scattered(rng, -30, 30, -1.7, 3000, noise=0.02)
    below = scattered(rng, -30, 30, rng.uniform(-9, -3, 30), 30)
    np.testing.assert_allclose(fit_plane(np.concatenate([street, below])), [0, 0, -1.7], atol=0.01)


def test_planes_are_of_ground_alone_and_repeat_with_their_seed():
    rng = np.random.default_rng(4)
    ahead = sloped(scattered(rng, [3, -10], [40, 10], 0.0, 3000, noise=0.02), 0.15, -0.1, -6.0)
    assert (np.abs(fit_plane(ahead) - [0.15, -0.1, -6.0]) < [2e-3, 2e-3, 0.03]).all()
    rng = np.random.default_rng(5)
    near = scattered(rng, -3, 3, -1.7, 50000, noise=0.05)
    far = scattered(rng, -40, 40, -1.7, 2000, noise=0.02)
    np.testing.assert_allclose(fit_plane(np.concatenate([near, far])), [0, 0, -1.7], atol=0.01)
    street = scattered(np.random.default_rng(7), -20, 20, -1.7, 2000)
    street[::7, 1] = np.nan
    np.testing.assert_allclose(fit_plane(street), [0, 0, -1.7], atol=1e-6)
    steep = sloped(scattered(np.random.default_rng(6), -20, 20, 0.0, 2000), 0.5, 0.0, 0.0)
    street = scattered(np.random.default_rng(6), -20, 20, 0.0, 2000, noise=0.05)
    assert fit_plane(street, seed=3).tobytes() == fit_plane(street, seed=3).tobytes()
    assert np.hypot(*fit_plane(steep, max_tilt=0.1)[:2]) <= np.tan(0.1)
    with pytest.raises(ValueError, match="no ground found in 2 points"):
        fit_plane(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="no ground found in 0 points"):
        fit_plane(np.zeros((0, 3), np.float32))
    patch = np.random.default_rng(0).uniform([-5, -5, 0], [5, 5, 0.1], (200, 3))
    far = np.concatenate([patch, patch + np.array([[3000.0, 3000.0, 0.0]])])
    with pytest.raises(ValueError, match=r"points cover 30[01]. by 30[01]. m: crop them"):
        fit_plane(far)


def test_cells_have_low_ends_that_nothing_lifts():
    column = np.column_stack([np.full(31, 0.5), np.full(31, 0.5), np.arange(31.0)])
    assert low_points(column, 1.0).tolist() == [[0.5, 0.5, 3.0]]
    assert low_points(column, 1.0, share=0.5).tolist() == [[0.5, 0.5, 15.0]]
    assert low_points(column[:0], 1.0).shape == (0, 3)
    assert heights_above_plane(
        np.array([0.5, -1.0, 2.0]), np.array([[2.0, 1.0, 7.0]])
    ).tolist() == [5.0]
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2) + 0.5
    cells = np.column_stack([grid, np.zeros(400)])
    cells[210, 2], cells[37, 2] = 1.5, -3.0
    ground = support_mask(cells, 0.25, 0.1, min_supporters=2)
    assert np.flatnonzero(~ground).tolist() == [37, 210]
    cells[37, 2] = 0.0
    assert np.flatnonzero(~lowest_mask(cells, 0.1, 0.25, window=5.0)).tolist() == [210]
    assert lowest_mask(cells[:0], 0.1, 0.25).shape == (0,)
    rng = np.random.default_rng(1)
    street = hilly(rng, 20000)
    standing = []
    for x, y in rng.uniform(-30, 30, (12, 2)):
        under = (np.abs(street[:, 0] - x) < 2.2) & (np.abs(street[:, 1] - y) < 0.9)
        street = street[~under]
        car = np.column_stack(
            [rng.uniform(x - 2.2, x + 2.2, 400), rng.uniform(y - 0.9, y + 0.9, 400), np.zeros(400)]
        )
        standing.append(
            car
            + np.column_stack([np.zeros((400, 2)), height_at(car) + rng.uniform(0.25, 1.5, 400)])
        )
    hedge = np.column_stack(
        [rng.uniform(-30, 30, 4000), rng.uniform(20, 21.5, 4000), rng.uniform(0.3, 1.2, 4000)]
    )
    hedge[:, 2] += height_at(hedge)
    points = np.concatenate([street, *standing, hedge])
    places = rng.uniform(-30, 30, (500, 2))
    assert np.abs(fit_map(points).at(places) - height_at(places)).max() < 0.1


def hilly(rng, count, reach=40.0):
    """Points of a street that falls away 1.2 m to the west, smoothly, and its height."""
    xy = rng.uniform(-reach, reach, (count, 2))
    return np.column_stack([xy, height_at(xy)])


def height_at(xy):
    return -1.2 / (1 + np.exp((xy[:, 0] + 20) / 6))


def test_maps_follow_hills_kerbs_and_not_stray_points():
    rng = np.random.default_rng(0)
    street = hilly(rng, 30000) + [0, 0, 1] * (0.02 * rng.standard_normal((30000, 1)))
    places = rng.uniform(-36, 36, (500, 2))
    error = fit_map(street).at(places) - height_at(places)
    assert abs(np.median(error)) < 0.01
    assert np.abs(error).max() < 0.08
    rng = np.random.default_rng(2)
    street = np.column_stack([rng.uniform(-20, 20, (8000, 2)), np.zeros(8000)])
    stray = np.column_stack([rng.uniform(-20, 20, (12, 2)), np.full(12, -1.5)])
    alone = np.column_stack([rng.uniform(70, 71, (30, 2)), rng.uniform(0.5, 1.9, 30)])
    surface = fit_map(np.concatenate([street, stray, alone]))
    assert np.abs(surface.at(rng.uniform(-20, 20, (300, 2)))).max() < 0.02
    assert np.abs(surface.at(np.array([[70.0, 70.0]]))).max() < 0.02
    rng = np.random.default_rng(3)
    xy = rng.uniform(-20, 20, (20000, 2))
    street = np.column_stack([xy, np.where(xy[:, 1] > 4, 0.15, 0.0)])
    surface = fit_map(street)
    along = np.linspace(-15, 15, 50)
    assert np.abs(surface.at(np.column_stack([along, np.full(50, 2.0)]))).max() < 0.03
    np.testing.assert_allclose(
        surface.at(np.column_stack([along, np.full(50, 12.0)])), 0.15, atol=0.03
    )
    heights = HeightMap(
        np.array([10.0, 20.0]), np.array([[0.0, 1.0, 2.0], [4.0, 5.0, 6.0]]), cell=2.0
    )
    places = np.array([[10.0, 20.0], [11.0, 21.0], [12.0, 24.0], [-5.0, 22.0], [99.0, 99.0]])
    assert heights.at(places).tolist() == [0.0, 2.5, 6.0, 1.0, 6.0]
    assert HeightMap(np.zeros(2), np.full((1, 1), 0.3)).at(places).tolist() == [0.3] * 5
    assert fit_map(np.full((10, 3), 50.0)).at(np.zeros((1, 2))).tolist() == [0.0]
    with pytest.raises(ValueError, match="reach must be above 0 m, got -1"):
        fit_map(np.zeros((10, 3)), reach=-1.0)


LOG = (
    Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[4] / "shared"))
    / "real"
    / "av2_two_lidars"
)
TILTED = Ground(
    np.array([0.1, -0.2, -6.0]),
    HeightMap(np.array([-9.0, -9]), np.array([[0.0, 0.4], [0.2, -0.3]]), 18.0),
)


def warned(points):
    return level_warning(points) or ""


def street(rng, count=6000):
    """A street in the world with cars upon it, a wall beside it, and where its ground is: z = 0."""
    flat = np.column_stack(
        [rng.uniform([-40, -10], [40, 10], (count, 2)), 0.02 * rng.standard_normal(count)]
    )
    car = rng.uniform([-2, -1, 0.2], [2, 1, 1.5], (800, 3)) + np.array([[8.0, 3, 0]])
    wall = np.column_stack(
        [rng.uniform(-40, 40, count), np.full(count, 10.0), rng.uniform(0, 8, count)]
    )
    return np.concatenate([flat, car, wall])


@pytest.mark.parametrize("method", ["plane", "map"])
@pytest.mark.parametrize(("height", "tilt"), [(1.7, 0.0), (1.8, 5.0), (6.0, 12.0)])
def test_a_cloud_in_a_crooked_sensors_frame_is_put_on_its_ground(method, height, tilt):
    rng = np.random.default_rng(0)
    world_SE3_sensor = pose(
        1.0, 2.0, height, yaw=0.4, pitch=np.deg2rad(tilt) * 0.6, roll=np.deg2rad(tilt) * 0.8
    )
    world = street(rng)
    ground = level(transform(invert(world_SE3_sensor), world), method=method)
    assert np.rad2deg(ground.tilt) == pytest.approx(tilt, abs=0.2)
    box = np.array([[8.0, 3.0, 0.85, 4.0, 2.0, 1.3, 0.3]])
    centre = transform(invert(world_SE3_sensor), box[:, :3])
    assert ground.points(centre)[0, 2] == pytest.approx(0.85, abs=0.02)
    flat = np.column_stack([rng.uniform([-30, -8], [30, 8], (200, 2)), np.zeros(200)])
    assert np.abs(ground.points(transform(invert(world_SE3_sensor), flat))[:, 2]).max() < 0.06


def test_points_and_boxes_return_from_a_tilted_ground():
    rng = np.random.default_rng(1)
    points = rng.uniform(-12, 12, (500, 3))
    np.testing.assert_allclose(TILTED.points_back(TILTED.points(points)), points, atol=1e-12)
    assert TILTED.points(points.astype(np.float32)).dtype == np.float32
    boxes = np.column_stack([points, rng.uniform(1, 4, (500, 3)), rng.uniform(-3.1, 3.1, 500)])
    np.testing.assert_allclose(TILTED.boxes_back(TILTED.boxes(boxes)), boxes, atol=1e-9)
    assert TILTED.boxes(np.zeros((0, 7))).shape == (0, 7)


def test_boxes_turn_with_a_tilted_ground():
    # A car along the fall line of a plane that leans about the diagonal keeps to that line.
    ground = Ground(np.array([0.3, 0.3, 0.0]))
    turned = ground.boxes(np.array([[0, 0, 1, 4, 2, 1, np.pi / 4], [0, 0, 1, 4, 2, 1, 0.0]]))
    assert turned[0, 6] == pytest.approx(np.pi / 4)
    along = np.array([1.0, 0.0, 0.3]) @ ground.level_SE3_frame[:3, :3].T
    assert turned[1, 6] == pytest.approx(np.arctan2(along[1], along[0]))
    assert turned[:, 3:6].tolist() == [[4, 2, 1], [4, 2, 1]]


def test_clouds_and_arrays_have_the_same_ground():
    points = street(np.random.default_rng(3)).astype(np.float32) - np.float32([0, 0, 1.7])
    one, other = level(points), level(from_points(points))
    assert one.plane.tobytes() == other.plane.tobytes()
    assert one.deviation.heights.tobytes() == other.deviation.heights.tobytes()


def test_a_tilted_ground_has_a_rigid_motion_to_level():
    motion = TILTED.level_SE3_frame
    np.testing.assert_allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(motion) == pytest.approx(1.0)
    np.testing.assert_allclose(motion[:2, 3], 0.0)
    xy = np.array([[0.0, 0.0], [3.0, -5.0], [-7.0, 2.0]])
    on_plane = np.column_stack([xy, xy @ [0.1, -0.2] - 6.0])
    np.testing.assert_allclose(transform(motion, on_plane)[:, 2], 0.0, atol=1e-12)
    assert TILTED.tilt == pytest.approx(np.arctan(np.hypot(0.1, 0.2)))


def test_heights_are_on_the_ground():
    xy = np.random.default_rng(2).uniform(-5, 5, (50, 2))
    level_plane = Ground(np.array([0.0, 0.0, -1.7]), TILTED.deviation)
    on_ground = np.column_stack([xy, level_plane.height(xy)])
    np.testing.assert_allclose(level_plane.points(on_ground)[:, 2], 0.0, atol=1e-12)
    assert Ground(np.array([0.5, 0.0, 1.0])).height(np.array([[2.0, 9.0]])).tolist() == [2.0]


def test_wrong_arguments_are_refused_and_heights_warned_of():
    points = street(np.random.default_rng(0))
    for arguments, message in (
        *(
            ({"method": "spline"}, "method"),
            ({"max_tilt": 1.0}, "max_tilt must lie in 0..45 degrees, got 57.3"),
        ),
    ):
        with pytest.raises((ValueError, TypeError), match=message):
            level(points, **arguments)
    for wrong, message in (
        (np.zeros((3, 5)), r"shape \(n, 3\), got \(3, 5\): pass points.T\?"),
        (np.full((50, 3), np.nan), "no ground found"),
    ):
        with pytest.raises(ValueError, match=message):
            level(wrong)
    rng = np.random.default_rng(4)
    world = street(rng)
    assert level_warning(world) is None
    assert "z = -1.70 m, tilted by 0.0°" in warned(world - [0, 0, 1.7])
    assert "z = 0.30 m" in warned(world - [0, 0, -0.3])
    assert "0% of 12800 points lie between 0 and 4 m" in warned(world - [0, 0, 20.0])
    assert level_warning(transform(pose(pitch=0.1), world)) is not None
    rng = np.random.default_rng(5)
    world = street(rng)
    assert level_warning(world[(world[:, 2] > 0) & (world[:, 2] < 4)]) is None
    assert level_warning(world[:50] - [0, 0, -9.0]) is None
    assert level_warning(np.zeros((0, 3))) is None
    nowhere = np.column_stack([np.zeros((500, 2)), np.linspace(-90, -50, 500)])
    assert "no ground is found" in warned(nowhere)


@pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")
def test_labelled_cars_of_a_real_street_stand_on_its_ground():
    pytest.importorskip("pyarrow")

    sweep = argoverse(LOG)[0]
    labels, points = read_labels(LOG, int(sweep.name)), sweep.points()
    near = (np.abs(labels.boxes[:, :2]) < 50).all(axis=1) & (
        np.array(labels.categories) == "REGULAR_VEHICLE"
    )
    boxes = level(points).boxes(labels.boxes[near])
    floors = boxes[:, 2] - boxes[:, 5] / 2
    assert near.sum() > 10
    assert abs(np.median(floors)) < 0.05
    assert np.percentile(np.abs(floors), 90) < 0.2
    assert "their ground seems to lie at z = -0." in warned(points)


def test_a_slope_is_found_from_afar_though_a_flat_place_lies_at_its_middle():
    """Without slopes to start from, the search would stay on the flat place, at the median
    height."""
    rng = np.random.default_rng(0)
    parts = [
        scattered(rng, [low, -15], [low + 30, 15], 0.0, 3000, noise=0.02) for low in (460, 510)
    ]
    ground = sloped(np.concatenate(parts), 0.15, 0.0, -75.0)
    flat = scattered(rng, [496, -4], [504, 4], 0.0, 1000, noise=0.02)
    assert (
        np.abs(fit_plane(np.concatenate([ground, flat])) - [0.15, 0.0, -75.0]) < [2e-3, 2e-3, 1.0]
    ).all()


def heights_of_one_cell(height, *, kept=0.25, kerb=np.inf, at=(0.0, 0.0), size=60):
    """A map of zeros, drawn again through a single cell."""
    surface = HeightMap(np.zeros(2), np.zeros((size, size)))
    return height_map.redraw_map(surface, np.array([[*at, height]]), kept, kerb).heights


def test_one_cell_counts_as_one_in_a_map_also_at_its_edge():
    """Of each of four means, every finer one, half is the cell's and half what was known: 15/16 of
    its height."""
    for at in ((0.0, 0.0), (30.0, 31.0)):
        heights = heights_of_one_cell(0.2, at=at)
        assert heights[int(at[0]), int(at[1])] == pytest.approx(0.2 * 15 / 16, rel=0.01)
    corner = heights_of_one_cell(0.2)
    assert corner[36, 0] > 0.0
    assert not corner[37:].any()  # three deviations of the widest mean
    half = heights_of_one_cell(0.09, kerb=0.09)[0, 0]  # as high as a kerb: it counts half
    assert half == pytest.approx(0.09 * 65 / 81, rel=0.01)
    assert heights_of_one_cell(-0.09, kerb=0.09)[0, 0] == pytest.approx(
        -0.09 * 15 / 16, rel=0.01
    )  # not below


@pytest.mark.parametrize(
    ("height", "counts"),
    [(0.24, True), (0.25, False), (0.26, False), (-0.49, True), (-0.5, False), (-0.51, False)],
)
def test_cells_far_above_a_map_and_twice_as_far_below_are_left_out(height, counts):
    assert heights_of_one_cell(height).any() == counts


def test_points_on_the_lines_of_a_grid_begin_a_cell():
    points = np.array([[0.5, 0.5, 1.0], [1.0, 0.5, 2.0], [0.5, 1.0, 3.0], [-0.5, 0.5, 4.0]])
    assert sorted(low_points(points, 1.0)[:, 2].tolist()) == [1.0, 2.0, 3.0, 4.0]
    for two in (
        [(0.5, 1.5), (1.5, -0.5)],
        [(0.5, 1.5), (1.5, 0.5)],
    ):  # none is at the grid's corner
        assert low_points(np.column_stack([two, [5.0, 6.0]]), 1.0)[:, 2].tolist() == [5.0, 6.0]
    wide = np.array([[0.5, 0.5, 1.0], [1.5, 1.5, 2.0], [2.5, 0.5, 3.0], [2.5, 2.5, 4.0]])
    assert low_points(wide, 2.0)[:, 2].tolist() == [1.0, 3.0, 4.0]
    assert low_points(wide, 2.0, share=0.5)[:, 2].tolist() == [1.0, 3.0, 4.0]  # the lower of two
    column = np.column_stack([np.zeros((11, 2)), np.arange(11.0)[::-1]])
    assert [low_points(column, 1.0, share=share)[0, 2] for share in (0.0, 0.1, 0.5, 1.0)] == [
        0.0,
        1.0,
        5.0,
        10.0,
    ]


def test_the_steepest_slope_is_handed_on(spy):
    levelled, warned_of = (spy(room, "fit_plane") for room in (ground, level_warning_room))
    street = np.column_stack(
        [np.random.default_rng(0).uniform(-20, 20, (400, 2)), np.full(400, -1.7)]
    )
    level(street, method="plane", max_tilt=0.1)
    level_warning(street)
    assert [call.named for call in levelled] == [{"max_tilt": 0.1}]
    assert [call.named for call in warned_of] == [{}]


def slowly_lowest(cells, slope, step, window, edge=1.0):
    """Whether none within the window lies lower by more than the way there explains, cell by
    cell."""
    places = np.floor(cells[:, :2] / edge)
    allowed = []
    for at, (_, _, height) in zip(places, cells, strict=True):
        near = np.abs(places - at).max(axis=1) <= round(window / edge)
        rise = slope * edge * np.abs(places - at).sum(axis=1)
        allowed.append(height <= (cells[:, 2] + rise)[near].min() + step)
    return allowed


def test_lowest_cells_are_an_oracles(limits):
    rng = np.random.default_rng(2)
    every = np.argwhere(np.ones((30, 25), bool))
    chosen = every[rng.permutation(len(every))[:400]]
    cells = np.column_stack(
        [chosen + rng.random((400, 2)) + np.array([-7, 5]), rng.choice([0.0, 0.3, 0.6, 2.0], 400)]
    )
    for slope, step, window in ((0.1, 0.25, 12.0), (0.02, 0.1, 3.0)):
        found = lowest_mask(cells, slope, step, window=window)
        assert found.tolist() == slowly_lowest(cells, slope, step, window)
    assert 0 < found.sum() < 400
    for seed in range(60):  # strips narrower than the window
        rng = np.random.default_rng(seed)
        shape = rng.permutation([int(rng.integers(1, 4)), int(rng.integers(1, 30))])
        narrow = np.argwhere(rng.random(shape) < 0.8)
        strip = np.column_stack([narrow + 0.5, rng.normal(0, 1, len(narrow))])
        assert lowest_mask(strip, 0.2, 0.1).tolist() == slowly_lowest(strip, 0.2, 0.1, 12.0)
    limits(height_map, MAX_MAP_CELLS=30 * 25)
    assert lowest_mask(cells, 0.1, 0.25).tolist() == slowly_lowest(cells, 0.1, 0.25, 12.0)
    limits(height_map, MAX_MAP_CELLS=30 * 25 - 1)
    with pytest.raises(ValueError, match="the points cover 30 by 25 m"):
        lowest_mask(cells, 0.1, 0.25)
    small = cells * [0.5, 0.5, 1.0]
    limits(height_map, MAX_MAP_CELLS=30 * 25)
    limits(height_map, GROUND_CELL_M=0.5)
    for window in (6.0, 2.0):
        found = lowest_mask(small, 0.1, 0.1, window=window)
        assert found.tolist() == slowly_lowest(small, 0.1, 0.1, window, edge=0.5)
    limits(height_map, MAX_MAP_CELLS=30 * 25 - 1)
    with pytest.raises(ValueError, match="the points cover 15 by 12 m"):
        lowest_mask(small, 0.1, 0.25)


def test_cells_that_others_support_are_an_oracles():
    rng = np.random.default_rng(3)
    cells = np.column_stack([rng.uniform(0, 40, (150, 2)), rng.choice([0.0, 0.2, 0.5], 150)])
    for others in (3, 6):
        found = support_mask(cells, 0.1, 0.08, min_supporters=others)
        for row, cell in enumerate(cells):
            apart = np.hypot(*(cells[:, :2] - cell[:2]).T)
            nearest = np.argsort(apart)[1:13]
            alike = np.abs(cells[nearest, 2] - cell[2]) < 0.1 + 0.08 * apart[nearest]
            assert found[row] == ((alike & (apart[nearest] < 8.0)).sum() >= others)
        assert 0 < found.sum() < 150
    assert (
        support_mask(cells[:3], 0.1, 0.08, min_supporters=3).tolist() == [True] * 3
    )  # too few to tell
    far = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 0]])
    assert support_mask(far, 0.1, 0.08, min_supporters=2).tolist() == [True, True, True, False]
    line = np.column_stack([np.arange(5) * 8.0, np.zeros((5, 2))])
    assert not support_mask(line, 0.1, 0.08, min_supporters=1).any()  # eight metres are too far
    assert support_mask(line * 0.99, 0.1, 0.08, min_supporters=1).all()
    stairs = np.column_stack([np.arange(5.0), np.zeros(5), [0.0, 0.25, 0.0, 0.25, 0.0]])
    assert not support_mask(stairs[:2], 0.25, 0.0, min_supporters=1).any()
    assert support_mask(stairs[:2], 0.26, 0.0, min_supporters=1).all()


def test_level_grounds_turn_to_the_plane_and_back_by_the_book():
    """The turn takes the plane's normal to z by the least angle, as SciPy has it."""
    tilted = ground.Ground(
        np.array([0.1, -0.2, 1.5]), HeightMap(np.zeros(2), np.full((3, 3), 0.25))
    )
    normal = np.array([-0.1, 0.2, 1.0]) / np.sqrt(1.05)
    axis = np.cross(normal, [0, 0, 1])
    turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arccos(normal[2])).as_matrix()
    assert tilted.level_SE3_frame[:3, :3] == pytest.approx(turn)
    assert tilted.tilt == pytest.approx(np.arccos(normal[2]))
    on = np.array([[3.0, 4.0, 0.1 * 3 - 0.2 * 4 + 1.5]])
    assert tilted.points(on)[0, 2] == pytest.approx(-0.25)
    assert tilted.height(on[:, :2]) == pytest.approx(on[:, 2] + 0.25)
    assert tilted.points_back(tilted.points(on)) == pytest.approx(on)
    box = np.array([[3.0, 4.0, 2.0, 4.0, 2.0, 1.5, 0.7]])
    ahead = turn @ [np.cos(0.7), np.sin(0.7), 0.1 * np.cos(0.7) - 0.2 * np.sin(0.7)]
    found = tilted.boxes(box)
    assert found[0, 6] == pytest.approx(np.arctan2(ahead[1], ahead[0]))
    assert found[:, :3] == pytest.approx(tilted.points(box[:, :3]))
    assert tilted.boxes_back(found) == pytest.approx(box)


def test_planes_and_maps_look_for_low_cells_as_far_about_as_said(spy):
    (of_plane, low_of_plane), (of_map, low_of_map) = (
        [spy(room, name) for name in ("support_mask", "lowest_mask")]
        for room in (ground_plane, height_map)
    )
    street = np.column_stack([np.random.default_rng(0).uniform(-20, 20, (4000, 2)), np.zeros(4000)])
    fit_map(street)
    supporters = [(*call.args[1:], call.named["min_supporters"]) for call in of_map]
    assert supporters == [(0.1, 0.08, 4), (0.1, 0.08, 6)]
    assert [call.args[1:] for call in low_of_map] == [(0.08, 0.1)]
    assert [call.named.get("window", height_map.STEP_WINDOW_M) for call in low_of_map] == [8.0]
    assert not of_plane
    fit_plane(street, max_tilt=0.2)
    assert [call.named for call in of_plane] == [{"step": 0.25, "slope": 0.3, "min_supporters": 3}]
    assert [call.args[1:] for call in low_of_plane] == [(np.tan(0.2), 0.25)]
    windows = [call.named.get("window", height_map.STEP_WINDOW_M) for call in low_of_plane]
    assert windows == [12.0]


def test_maps_cover_the_points_in_reach_of_their_middle():
    """Ground at 5 and 35 m: a reach of 10 m from the middle, at 5 m, has the first alone."""
    rng = np.random.default_rng(1)
    near, far = rng.uniform([0, 0], [10, 10], (3000, 2)), rng.uniform([30, 0], [40, 10], (500, 2))
    street = np.column_stack([np.concatenate([near, far]), np.zeros(3500)])
    whole, part = fit_map(street), fit_map(street, reach=10.0)
    assert whole.heights.shape == (41, 11)  # one beyond the last cell's middle
    assert part.heights.shape == (11, 11)
    assert part.origin.tolist() == [0.5, 0.5]
    high = fit_map(street + np.array([0, 0, 2.5]))
    assert (high.heights.tolist(), high.origin.tolist()) == (
        [[0.0]],
        [0.0, 0.0],
    )  # nothing near zero
    for lift in (-2.0, 2.0):
        assert fit_map(street + np.array([0, 0, lift])).heights.shape == (1, 1)
    for reach in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match="reach must be above 0 m"):
            fit_map(street, reach=reach)
    line = np.column_stack([np.arange(41.0), np.zeros((41, 2))])  # about 20 m
    assert [len(fit_map(line, reach=reach).heights) for reach in (20.0, 19.9, 0.5)] == [41, 39, 1]


def test_maps_of_smaller_cells_and_elsewhere_are_as_good(limits, monkeypatch):
    def half(origin, heights):
        return HeightMap(origin, heights, 0.5)

    rng = np.random.default_rng(5)
    street, middle = hilly(rng, 40000, reach=20.0), rng.uniform(-18, 18, (200, 2))
    limits(height_map, GROUND_CELL_M=0.5)
    monkeypatch.setattr(height_map, "HeightMap", half)
    found = fit_map(street - [10.0, -30.0, 0.0])
    assert np.abs(found.at(middle - [10.0, -30.0]) - height_at(middle)).max() < 0.05
    assert found.origin.tolist() == [-29.75, 10.25]
    assert found.heights.shape == (81, 81)
    placed = height_map.redraw_map(
        half(np.array([10.0, 20.0]), np.zeros((90, 90))), np.array([[30.0, 40, 0.2]]), 0.25, np.inf
    )
    assert np.argwhere(placed.heights == placed.heights.max()).tolist() == [[40, 40]]
    assert placed.heights[40, 40] == pytest.approx(0.2 * 15 / 16, rel=0.01)
    wide = HeightMap(np.array([10.0, 20.0]), np.zeros((60, 60)), 2.0)
    redrawn = height_map.redraw_map(wide, np.array([[10.0, 20.0, 0.2]]), 0.25, np.inf)
    assert redrawn.cell == 2.0
    heights = redrawn.heights
    assert heights[18, 0] > 0.0
    assert not heights[19:].any()


def test_the_last_drawing_is_through_the_middle_of_what_lies_on_the_ground(spy):
    """In every cell three points at 0, four at 10 cm and eight at 20: those within 12 cm count."""
    calls = spy(height_map, "redraw_map")
    places = (
        np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 1, 2) + 0.5
    )
    heights = np.repeat([0.0, 0.1, 0.2], [3, 4, 8])
    points = np.concatenate(
        [np.broadcast_to(places, (400, 15, 2)), np.tile(heights[:, None], (400, 1, 1))], axis=2
    )
    fit_map(points.reshape(-1, 3))
    asked = [
        (np.unique(cells[:, 2].round(3)).tolist(), kept, kerb)
        for (_, cells, kept, kerb), _ in calls
    ]
    first = [(0.25, np.inf)] * 2 + [(0.2, np.inf)] + [(0.2, 0.09)] * 3 + [(0.12, 0.09)]
    assert asked == [*(([0.0], *each) for each in first), ([0.1], 0.12, 0.09)]


def test_three_cells_are_enough_and_pulled_a_little_towards_level():
    """By a thousandth of the weight of a cell for each: the least squares with that penalty."""
    cells = np.array([[0.5, 0.5, 0.0], [6.5, 0.5, 0.6], [0.5, 6.5, -1.2]])
    middle = cells.mean(axis=0)
    flat = cells[:, :2] - middle[:2]
    slopes = np.linalg.solve(flat.T @ flat + 3e-3 * np.eye(2), flat.T @ cells[:, 2])
    wanted = [*slopes, middle[2] - slopes @ middle[:2]]
    assert fit_plane(cells) == pytest.approx(wanted, abs=1e-6)
    assert abs(wanted[1] + 0.2) > 1e-5


def test_only_level_planes_are_found_where_no_tilt_is_allowed():
    street = sloped(
        scattered(np.random.default_rng(3), -20, 20, 0.0, 3000, noise=0.02), 0.01, 0.0, 3.0
    )
    assert fit_plane(street, max_tilt=0.0).tolist() == [0.0, 0.0, pytest.approx(3.0, abs=0.1)]
    assert level(street, method="plane", max_tilt=0.0).tilt == 0.0
    assert level(street, method="plane", max_tilt=0.1).tilt == pytest.approx(0.01, abs=1e-3)
    with pytest.raises(ValueError, match=r"max_tilt must lie in 0\.\.45 degrees, got 45\.0"):
        level(street, max_tilt=np.pi / 4)


@pytest.mark.parametrize("way", [(0.5, 0.0), (0.0, 0.5)])
def test_no_plane_leans_more_than_allowed(way):
    steep = sloped(scattered(np.random.default_rng(6), -20, 20, 0.0, 2000), way[0], way[1], 0.0)
    assert np.hypot(*fit_plane(steep, max_tilt=0.1)[:2]) <= np.tan(0.1)


@pytest.mark.parametrize("height", [-0.09, 0.09])
def test_cells_hardly_within_the_band_hardly_count(height):
    """A fifth of the cells lie 9 of 10 cm above the others, or below: a mean would move by
    1.8 cm."""
    rng = np.random.default_rng(7)
    places = np.stack(np.meshgrid(np.arange(30.0), np.arange(30.0)), axis=-1).reshape(-1, 2) + 0.5
    cells = np.column_stack([places, np.where(rng.random(900) < 0.2, height, 0.0)])
    a, b, c = fit_plane(cells)
    assert abs(c + 15 * (a + b)) < 0.002


@pytest.mark.parametrize(
    ("share", "lower", "hole", "height"),
    [(0.02, -0.45, -0.75, 0.0), (0.15, -0.45, -0.75, -0.45), (0.15, -0.3, -0.5, 0.0)],
)
def test_a_few_cells_below_a_plane_cost_nothing_and_more_do(share, lower, hole, height):
    """Stripes of two streets, equally wide, one above the other, which has some cells still lower.
    Cells half a metre below the upper street do not lie well below it.
    """
    places = np.stack(np.meshgrid(np.arange(80.0), np.arange(30.0)), axis=-1).reshape(-1, 2) + 0.5
    along = places[:, 0] % 20
    heights = np.where(along < 10, 0.0, lower)
    inner = np.flatnonzero((along > 12) & (along < 18))
    heights[inner[np.random.default_rng(0).permutation(len(inner))[: round(share * 2400)]]] = hole
    a, b, c = fit_plane(np.column_stack([places, heights]))
    assert c + 40 * a + 15 * b == pytest.approx(height, abs=0.03)


def test_points_that_are_not_finite_count_for_nothing():
    rng = np.random.default_rng(8)
    points = street(rng) - [0, 0, 1.7]
    bad = np.array([[np.inf, 0.0, 1.0], [0.0, np.nan, 1.0], [1.0, 2.0, -np.inf]])
    one, other = level(points), level(np.concatenate([points, bad]))
    assert one.plane.tobytes() == other.plane.tobytes()
    assert one.deviation.heights.tobytes() == other.deviation.heights.tobytes()
    assert level_warning(np.concatenate([points, bad])) == level_warning(points) is not None


def test_warnings_are_of_clouds_that_reach_beyond_the_slice_and_have_enough_points(monkeypatch):
    flat = np.column_stack([np.random.default_rng(9).uniform(-9, 9, (400, 2)), np.full(400, 0.5)])
    assert level_warning(flat) is None
    for height in (0.0, 4.0):  # ends of the slice do not belong to it
        flat[0, 2] = height
        assert "z = 0.50 m" in warned(flat)
    low = flat - [0, 0, 3.0]
    assert "z = -2.50 m" in warned(low[:200])
    assert level_warning(low[:199]) is None
    column = np.column_stack([np.zeros((500, 2)), np.linspace(-90, -50, 500)])
    column[:10, 2] = 1.0
    assert "2% of 500 points lie between 0 and 4 m, and no ground is found" in warned(column)
    column[10, 2] = 1.0
    assert level_warning(column) is None  # more than hardly any
    monkeypatch.setattr(
        level_warning_room, "fit_plane", lambda points, **_: np.array([0.0, 0.0, 0.12])
    )
    halves = np.column_stack([np.zeros((400, 2)), np.repeat([0.1, 0.2], 200)])
    halves[0, 2] = 9.0
    assert level_warning(halves[1:]) is None  # all lie in the slice
    assert "z = 0.20 m" in warned(halves)
    assert (
        level_warning(np.concatenate([halves, [[0, 0, 0.1]]])) is None
    )  # half of them lie near zero


def test_points_are_plain_whatever_cloud_they_are_in():
    points = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert plain_points(points.astype(np.float32)).dtype == np.float32
    assert plain_points(points.astype(np.int64)).tolist() == points.tolist()
    assert plain_points(points.astype(np.int64)).dtype == np.float64
    four = np.column_stack([points, [0.1, 0.2]])
    assert plain_points(four).tolist() == points.tolist()
    assert plain_points(SimpleNamespace(points=points)).tolist() == points.tolist()
    held = SimpleNamespace(cpu=lambda: SimpleNamespace(numpy=lambda: points))

    class Tensors(dict):
        positions = held

    assert plain_points(SimpleNamespace(point=Tensors(positions=held))).tolist() == points.tolist()
    assert plain_points(SimpleNamespace(point=Tensors())).shape == (0, 3)
    for wrong, said in (
        *(
            (np.zeros((3, 5)), r"got \(3, 5\): pass points\.T\?"),
            (np.zeros((5, 5)), r"got \(5, 5\)$"),
        ),
        *(
            (np.zeros(3), r"got \(3,\)$"),
            (np.zeros((4, 2)), r"got \(4, 2\)$"),
            (np.ones((4, 3), bool), r"got \(4, 3\)$"),
        ),
    ):
        with pytest.raises(ValueError, match=said):
            plain_points(wrong)
