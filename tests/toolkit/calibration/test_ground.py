import os
from pathlib import Path

import numpy as np
import pytest

from toolkit.calibration.ground import Ground, level, level_warning
from toolkit.calibration.height_map import HeightMap
from toolkit.clouds import from_points
from toolkit.geometry import invert, pose, transform

SHARED = Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[4] / "shared"))
LOG = SHARED / "real" / "av2_two_lidars"
TILTED = Ground(np.array([0.1, -0.2, -6.0]), HeightMap(np.array([-9.0, -9]), np.array([[0.0, 0.4], [0.2, -0.3]]), 18.0))


def warned(points):
    return level_warning(points) or ""


def street(rng, count=6000):
    """A street in the world with cars upon it, a wall beside it, and where its ground is: z = 0."""
    flat = np.column_stack([rng.uniform([-40, -10], [40, 10], (count, 2)), 0.02 * rng.standard_normal(count)])
    car = rng.uniform([-2, -1, 0.2], [2, 1, 1.5], (800, 3)) + np.array([[8.0, 3, 0]])
    wall = np.column_stack([rng.uniform(-40, 40, count), np.full(count, 10.0), rng.uniform(0, 8, count)])
    return np.concatenate([flat, car, wall])


@pytest.mark.parametrize("method", ["plane", "map"])
@pytest.mark.parametrize(("height", "tilt"), [(1.7, 0.0), (1.8, 5.0), (6.0, 12.0)])
def test_a_cloud_in_a_crooked_sensors_frame_is_put_on_its_ground(method, height, tilt):
    rng = np.random.default_rng(0)
    world_SE3_sensor = pose(1.0, 2.0, height, yaw=0.4, pitch=np.deg2rad(tilt) * 0.6, roll=np.deg2rad(tilt) * 0.8)
    world = street(rng)
    ground = level(transform(invert(world_SE3_sensor), world), method=method)
    assert np.rad2deg(ground.tilt) == pytest.approx(tilt, abs=0.2)
    box = np.array([[8.0, 3.0, 0.85, 4.0, 2.0, 1.3, 0.3]])
    centre = transform(invert(world_SE3_sensor), box[:, :3])
    assert ground.points(centre)[0, 2] == pytest.approx(0.85, abs=0.02)
    flat = np.column_stack([rng.uniform([-30, -8], [30, 8], (200, 2)), np.zeros(200)])
    assert np.abs(ground.points(transform(invert(world_SE3_sensor), flat))[:, 2]).max() < 0.06


def test_points_and_boxes_go_there_and_back():
    rng = np.random.default_rng(1)
    points = rng.uniform(-12, 12, (500, 3))
    np.testing.assert_allclose(TILTED.points_back(TILTED.points(points)), points, atol=1e-12)
    assert TILTED.points(points.astype(np.float32)).dtype == np.float32
    boxes = np.column_stack([points, rng.uniform(1, 4, (500, 3)), rng.uniform(-3.1, 3.1, 500)])
    np.testing.assert_allclose(TILTED.boxes_back(TILTED.boxes(boxes)), boxes, atol=1e-9)
    assert TILTED.boxes(np.zeros((0, 7))).shape == (0, 7)


def test_the_rigid_part_levels_the_plane_about_the_frames_origin():
    motion = TILTED.level_SE3_frame
    np.testing.assert_allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(motion) == pytest.approx(1.0)
    np.testing.assert_allclose(motion[:2, 3], 0.0)
    xy = np.array([[0.0, 0.0], [3.0, -5.0], [-7.0, 2.0]])
    on_plane = np.column_stack([xy, xy @ [0.1, -0.2] - 6.0])
    np.testing.assert_allclose(transform(motion, on_plane)[:, 2], 0.0, atol=1e-12)
    assert TILTED.tilt == pytest.approx(np.arctan(np.hypot(0.1, 0.2)))


def test_height_is_where_points_have_height_zero():
    xy = np.random.default_rng(2).uniform(-5, 5, (50, 2))
    level_plane = Ground(np.array([0.0, 0.0, -1.7]), TILTED.deviation)
    on_ground = np.column_stack([xy, level_plane.height(xy)])
    np.testing.assert_allclose(level_plane.points(on_ground)[:, 2], 0.0, atol=1e-12)
    assert Ground(np.array([0.5, 0.0, 1.0])).height(np.array([[2.0, 9.0]])).tolist() == [2.0]


def test_the_heading_of_a_box_stays_in_the_plane():
    """A car along the fall line of a plane that leans about the diagonal keeps to that line."""
    ground = Ground(np.array([0.3, 0.3, 0.0]))
    turned = ground.boxes(np.array([[0, 0, 1, 4, 2, 1, np.pi / 4], [0, 0, 1, 4, 2, 1, 0.0]]))
    assert turned[0, 6] == pytest.approx(np.pi / 4)
    along = np.array([1.0, 0.0, 0.3]) @ ground.level_SE3_frame[:3, :3].T
    assert turned[1, 6] == pytest.approx(np.arctan2(along[1], along[0]))
    assert turned[:, 3:6].tolist() == [[4, 2, 1], [4, 2, 1]]


def test_an_open3d_cloud_and_its_points_have_the_same_ground():
    points = street(np.random.default_rng(3)).astype(np.float32) - np.float32([0, 0, 1.7])
    one, other = level(points), level(from_points(points))
    assert one.plane.tobytes() == other.plane.tobytes()
    assert one.deviation.heights.tobytes() == other.deviation.heights.tobytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "spline"}, "method"),
        ({"max_tilt": 1.0}, "max_tilt must lie in 0..45 degrees, got 57.3"),
        ({"reach": 0.0}, "reach must be a length above 0 m, got 0"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises((ValueError, TypeError), match=message):
        level(street(np.random.default_rng(0)), **arguments)


def test_wrong_points_are_refused():
    with pytest.raises(ValueError, match=r"shape \(n, 3\), got \(3, 5\): pass points.T\?"):
        level(np.zeros((3, 5)))
    with pytest.raises(ValueError, match="no ground to be found"):
        level(np.full((50, 3), np.nan))


def test_a_warning_names_the_height_of_the_ground():
    rng = np.random.default_rng(4)
    world = street(rng)
    assert level_warning(world) is None
    assert "z = -1.70 m, tilted by 0.0°" in warned(world - [0, 0, 1.7])
    assert "z = 0.30 m" in warned(world - [0, 0, -0.3])
    assert "0% of 12800 points lie between 0 and 4 m" in warned(world - [0, 0, 20.0])
    assert level_warning(transform(pose(pitch=0.1), world)) is not None


def test_clouds_that_say_nothing_of_the_ground_make_no_warning():
    rng = np.random.default_rng(5)
    world = street(rng)
    cropped = world[(world[:, 2] > 0) & (world[:, 2] < 4)]
    assert level_warning(cropped) is None
    assert level_warning(world[:50] - [0, 0, -9.0]) is None
    assert level_warning(np.zeros((0, 3))) is None
    nowhere = np.column_stack([np.zeros((500, 2)), np.linspace(-90, -50, 500)])
    assert "no ground is to be found" in warned(nowhere)


@pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")
def test_labelled_cars_of_a_real_street_stand_on_its_ground():
    pytest.importorskip("pyarrow")
    from toolkit.clouds import positions
    from toolkit.datasets.argoverse import fuse_sweep, read_labels, sweep_times

    time = sweep_times(LOG)[0]
    labels, points = read_labels(LOG, time), positions(fuse_sweep(LOG, time))
    near = (np.abs(labels.boxes[:, :2]) < 50).all(axis=1) & (np.array(labels.categories) == "REGULAR_VEHICLE")
    ground = level(points)
    boxes = ground.boxes(labels.boxes[near])
    floors = boxes[:, 2] - boxes[:, 5] / 2
    assert near.sum() > 10
    assert abs(np.median(floors)) < 0.05
    assert np.percentile(np.abs(floors), 90) < 0.2
    assert "their ground seems to lie at z = -0." in warned(points)
