import numpy as np

from toolkit.datasets.records.clouds import cloud_of, one_cloud, read_cloud, write_cloud
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects


def cloud(points, **columns):
    problems = {}
    return cloud_of({"positions": np.array(points, np.float64), **columns}, "s", np.eye(4), problems), problems


def test_points_that_are_none_are_counted_apart():
    made, problems = cloud([[1, 2, 3], [np.inf, 0, 0], [0, 0, 0], [2e5, 0, 0]], intensity=np.arange(4.0)[:, None])
    assert made.points.tolist() == [[1, 2, 3]]
    assert made.intensity.tolist() == [0]
    assert problems == {"points with NaN or infinite numbers": 2, "points of no return": 1}


def test_the_origin_of_a_world_frame_is_a_point():
    problems = {}
    made = cloud_of({"positions": np.zeros((1, 3))}, "s", np.eye(4), problems, frame="world")
    assert len(made.points) == 1
    assert problems == {}


def test_times_are_seconds_from_the_first():
    times = cloud([[1, 0, 0], [2, 0, 0]], t=np.array([500, 300], np.uint32))[0].time
    np.testing.assert_allclose(times, [2e-7, 0], atol=1e-15)
    times = cloud([[1, 0, 0], [2, 0, 0]], timestamp=np.array([1.6e9, 1.6e9 + 0.5]))[0].time
    np.testing.assert_allclose(times, [0, 0.5])
    assert cloud([[1, 0, 0]])[0].time is None
    assert cloud([[1, 0, 0]])[0].intensity is None


def test_colours_hold_intensity_in_the_red():
    made, _ = cloud([[1, 0, 0]], colors=np.array([[7, 0, 0]], np.uint8))
    assert made.intensity.tolist() == [7]


def test_a_cloud_there_and_back(tmp_path):
    placed = pose(1.0, 2.0, 3.0, yaw=1.0)
    sensor = SensorCloud("s", np.array([[4.0, 5, 6]], np.float32), placed, intensity=np.array([0.5], np.float32))
    write_cloud(tmp_path / "a.pcd", sensor)
    problems = {}
    back = read_cloud(tmp_path / "a.pcd", "s", placed, problems)
    assert back.points.tolist() == sensor.points.tolist()
    assert back.intensity.tolist() == [0.5]
    write_cloud(tmp_path / "b.pcd", sensor, in_world=True)
    np.testing.assert_allclose(
        read_cloud(tmp_path / "b.pcd", "s", np.eye(4), problems).points, sensor.in_world(), atol=1e-6
    )


def test_clouds_as_one():
    placed = pose(10.0)
    some = SensorCloud("a", np.ones((1, 3), np.float32), placed, intensity=np.ones(1, np.float32))
    other = SensorCloud("b", np.ones((2, 3), np.float32), np.eye(4))
    together = one_cloud(Sample("0", (some, other), Objects.empty()))
    assert together.points[:, 0].tolist() == [11, 1, 1]
    assert together.intensity is None
    assert one_cloud(Sample("0", (some,), Objects.empty())).intensity.tolist() == [1]


def test_rings_are_read_and_written(tmp_path):
    assert cloud([[1, 0, 0]])[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([2.5]))[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([np.nan]))[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([1e6]))[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([31.0], np.float32))[0].ring.tolist() == [31]
    made, _ = cloud([[1, 0, 0], [0, 0, 0], [2, 0, 0]], laser_number=np.array([[31], [4], [7]], np.uint8))
    assert made.ring.tolist() == [31, 7]
    write_cloud(tmp_path / "a.pcd", made)
    assert read_cloud(tmp_path / "a.pcd", "s", np.eye(4), {}).ring.tolist() == [31, 7]
