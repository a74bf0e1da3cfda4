import numpy as np
import pytest

from toolkit.datasets.sample import Rectangle, Sample, SensorCloud
from toolkit.detection.detect import detect_samples, level_samples, middle_of
from toolkit.geometry import pose, transform
from toolkit.objects import Detections, Objects


def street(rng, count=6000):
    """Ground, and a block of 4 × 2 × 1.5 m that stands on it at (10, 5)."""
    ground = np.column_stack([rng.uniform(-30, 30, (count, 2)), rng.normal(0, 0.01, count)])
    block = np.column_stack([rng.uniform(8, 12, 400), rng.uniform(4, 6, 400), rng.uniform(0, 1.5, 400)])
    return np.concatenate([ground, block])


class Blocks:
    """Detects the mean of what stands 0.3 to 2 m above z = 0, as a box."""

    def __init__(self):
        self.seen = []

    def __call__(self, points):
        self.seen.append(points)
        high = points[(points[:, 2] > 0.3) & (points[:, 2] < 2)]
        if not len(high):
            return Detections.empty()
        x, y, _ = high.mean(axis=0)
        return Detections(np.array([[x, y, 0.75, 4, 2, 1.5, 0.0]]), np.array([0.9]))


def samples(world, count=1):
    """Clouds of the street as a lidar 3 m above its middle measured it, in a world where the street lies at `world`."""
    made = []
    for k in range(count):
        place = world @ pose(0.0, 0.0, 3.0)
        points = transform(pose(0.0, 0.0, -3.0), street(np.random.default_rng(k)))
        made.append(Sample(str(k), (SensorCloud("s", points.astype(np.float32), place),), Objects.empty()))
    return made


@pytest.mark.parametrize("levelling", ["map", "plane"])
def test_a_street_that_leans_far_from_the_origin_is_detected_in(levelling):
    """A kilometre away, 120 m up, and leaning by 3 degrees: boxes are where they stand in that world."""
    world = pose(1000.0, 2000.0, 120.0, yaw=0.5, pitch=np.deg2rad(3))
    (found,) = detect_samples(samples(world), Blocks(), levelling=levelling)
    expected = transform(world, np.array([[10.0, 5.0, 0.75]]))[0]
    np.testing.assert_allclose(found.detections.boxes[0, :3], expected, atol=0.15)
    assert found.warning is None
    assert found.ground.tilt == pytest.approx(np.deg2rad(3), abs=0.003)
    assert found.middle.tolist() == np.round(transform(world, np.array([[0.0, 0, 3]]))[0, :2]).tolist()
    assert found.level_ms > 0
    assert found.detect_ms > 0


def test_a_raw_cloud_is_warned_of():
    (found,) = detect_samples(samples(pose(0.0, 0.0, -1.7)), Blocks(), levelling="none")
    assert "ground seems to lie at z = -1.70 m" in str(found.warning)
    assert found.ground is None


def test_points_are_counted_from_the_middle():
    detector = Blocks()
    (found,) = detect_samples(samples(pose(5000.0)), detector, levelling="none", middle=(5005.0, 2.0))
    assert detector.seen[0].dtype == np.float32
    assert detector.seen[0][:, 0].min() == pytest.approx(-35, abs=0.1)
    np.testing.assert_allclose(found.detections.boxes[0, :2], [5010, 5], atol=0.1)


def test_sensors_that_stand_still_have_one_ground():
    found = list(detect_samples(samples(np.eye(4), 2), Blocks(), still=True))
    assert found[0].ground is found[1].ground
    other = list(detect_samples(samples(np.eye(4), 2), Blocks()))
    assert other[0].ground is not other[1].ground


def test_clouds_without_points_or_without_ground():
    nothing = Sample("0", (SensorCloud("s", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty())
    few = Sample("1", (SensorCloud("s", np.array([[1, 1, 1.0]], np.float32), np.eye(4)),), Objects.empty())
    first, second = detect_samples([nothing, few], Blocks())
    assert len(first.detections) == 0
    assert first.warning is None
    assert str(second.warning).startswith("not levelled: no ground found in 1 points")
    assert len(second.detections) == 1


def test_some_sensors_only():
    clouds = tuple(SensorCloud(name, np.ones((2, 3), np.float32), pose(k)) for k, name in ((0.0, "a"), (9.0, "b")))
    detector = Blocks()
    sample = Sample("0", clouds, Objects.empty())
    list(detect_samples([sample], detector, levelling="none", middle=(0.0, 0.0), sensors=["b"]))
    assert detector.seen[0].tolist() == [[10, 1, 1]] * 2
    assert middle_of(sample).tolist() == [4, 0]


def test_an_unknown_levelling():
    with pytest.raises((ValueError, TypeError), match=r"one of map, plane, none|Type-check"):
        list(detect_samples([], Blocks(), levelling="flat"))


def sample(complete=None, lift=20.0):
    """Ground `lift` m up, sensors at (100, 0), a car 10 m ahead, one 53 m away and one 80 m away."""
    rng = np.random.default_rng(0)
    street = np.column_stack([rng.uniform(60, 140, 6000), rng.uniform(-40, 40, 6000), rng.normal(lift, 0.005, 6000)])
    post = np.tile([110.0, 0.0, lift + 1.0], (30, 1))
    cloud = SensorCloud("s", np.concatenate([street, post]).astype(np.float32), pose(100.0, 0.0, lift + 5), "world")
    boxes = np.array([[x, 0, lift + 0.75, 4, 2, 1.5, 0.3] for x in (110.0, 153.0, 180.0)])
    return Sample("0", (cloud,), Objects(boxes), **({} if complete is None else {"complete": complete}))


@pytest.mark.parametrize("levelling", ["map", "plane"])
def test_points_and_boxes_stand_on_the_ground(levelling):
    (made,) = level_samples([sample()], levelling=levelling)
    assert made.area == (-50, -50, 50, 50)
    assert made.sensors == ("s",)
    np.testing.assert_allclose(made.objects.boxes[0], [10, 0, 0.75, 4, 2, 1.5, 0.3], atol=0.03)
    assert len(made.objects) == 2  # the one on the edge is kept, the far one is not
    high = made.clouds[0][made.clouds[0][:, 2] > 0.5]
    np.testing.assert_allclose(high.mean(axis=0), [10, 0, 1], atol=0.03)
    assert made.clouds[0].dtype == np.float32
    assert made.clouds[0][:, 2].min() > 0


def test_what_nobody_labelled_is_no_background():
    (made,) = level_samples([sample(Rectangle((100.0, -5.0, 120.0, 5.0)))], levelling="plane")
    assert (made.clouds[0][:, 0] >= 0).all()
    assert (np.abs(made.clouds[0][:, 1]) <= 5).all()


def test_an_area_of_ones_own_and_one_ground_for_all():
    first, second = level_samples([sample(), sample(lift=20.4)], middle=(110.0, 0.0), half=(8.0, 6.0), still=True)
    assert first.area == (-8, -6, 8, 6)
    assert first.objects.boxes[0, 0] == pytest.approx(0, abs=0.01)
    assert second.objects.boxes[0, 2] == pytest.approx(1.15, abs=0.03)


def test_samples_without_ground_are_left_out():
    nothing = Sample("0", (SensorCloud("s", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty())
    one = Sample("0", (SensorCloud("s", np.ones((1, 3), np.float32), np.eye(4)),), Objects.empty())
    assert list(level_samples([nothing, one])) == []
    assert len(list(level_samples([one], levelling="none"))) == 1
