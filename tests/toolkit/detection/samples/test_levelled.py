import numpy as np
import pytest

from toolkit.datasets.sample import Rectangle, Sample, SensorCloud
from toolkit.detection.samples.levelled import level_samples
from toolkit.geometry import pose
from toolkit.objects import Objects


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
