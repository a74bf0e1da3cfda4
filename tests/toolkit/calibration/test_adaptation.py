"""An empty scene that moves with slow changes, and is frozen by who parks."""

import numpy as np
import pytest

from toolkit.calibration.adaptation import SceneAdaptation
from toolkit.calibration.empty_scene import SceneLearner
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

CAMERA = Sensor("cam", DepthCamera(width=8, height=6), np.eye(4))
WALL = np.full((3, 4), 20.0, np.float32)


def scene():
    learner = SceneLearner(CAMERA)
    image = WALL.copy()
    image[0] = 0
    for _ in range(3):
        learner.add(image)
    return learner.scene()


def image(row=20.0, spot=None):
    out = np.full((3, 4), row, np.float32)
    out[0] = 0
    if spot is not None:
        out[1, 1] = spot
    return out


def after(images, **times):
    """The scene after images at these times."""
    adapting = SceneAdaptation(scene(), **times)
    for time, each in images:
        adapting.update(each, time)
    return adapting.scene


def test_what_shows_the_scene_moves_it_by_the_time_constant():
    moved = after([(0.0, image()), (300.0, image(20.05)), (900.0, image(20.05))])
    first = 0.05 * (1 - np.exp(-0.5))
    np.testing.assert_allclose(moved.first[1:], 20 + first + (0.05 - first) * (1 - np.exp(-1)), atol=1e-5)
    assert (moved.first[0] == 0).all()
    assert (moved.spread[1:] > 0.015).all()
    assert (moved.frames, moved.name) == (6, "cam")


def test_the_spread_follows_the_noise_and_never_falls_below_the_models():
    rng = np.random.default_rng(0)
    noisy = [(10.0 * k, (image() + rng.normal(0, 0.03, (3, 4)) * (image() > 0)).astype(np.float32)) for k in range(400)]
    np.testing.assert_allclose(after(noisy).spread[1:], 0.03, rtol=0.25)
    assert after([(10.0 * k, image()) for k in range(400)]).spread[1:].min() == pytest.approx(0.015)


def test_who_parks_freezes_it_and_a_day_later_is_the_scene():
    parked = [(600.0 * k, image(spot=8.0)) for k in range(144)]
    frozen = after(parked)
    assert frozen.first[1, 1] == 20
    np.testing.assert_array_equal(frozen.spread[1, 1], scene().spread[1, 1])
    taken = after([*parked, (86_400.0, image(spot=8.02))])
    assert taken.first[1, 1] == 8
    assert taken.spread[1, 1] == pytest.approx(0.015)
    assert (taken.first[1:] != 20).sum() == 1


def test_another_car_begins_anew_and_one_that_passes_before_it_does_not():
    day = [(3600.0 * k, image(spot=8.0)) for k in range(24)]
    another = [*day[:12], (43_000.0, image(spot=12.0)), *day[12:], (86_400.0, image(spot=8.0))]
    assert after(another).first[1, 1] == 20  # what lies farther was seen through where it stood
    left = [*day[:12], (43_000.0, image()), *day[12:], (86_400.0, image(spot=8.0))]
    assert after(left).first[1, 1] == 20
    passed = [*day[:12], (43_000.0, image(spot=5.0)), *day[12:], (86_400.0, image(spot=8.0))]
    assert after(passed).first[1, 1] == 8
    only_passed_now = [*day, (86_400.0, image(spot=5.0))]
    assert after(only_passed_now).first[1, 1] == 20


def test_what_has_gone_is_learnt_within_a_minute():
    farther = [(10.0 * k, image(spot=30.0)) for k in range(7)]
    assert after(farther[:6]).first[1, 1] == 20
    assert after(farther).first[1, 1] == 30
    gone = [(10.0 * k, image(spot=0.0)) for k in range(7)]
    assert after(gone[:6]).first[1, 1] == 20
    assert after(gone).first[1, 1] == 0
    assert after(gone).spread[1, 1] == 0
    assert after(farther, reveal=70.0).first[1, 1] == 20


def test_nonsense_is_refused():
    adapting = SceneAdaptation(scene())
    adapting.update(image(), 5.0)
    with pytest.raises(ValueError, match=r"got 4\.0 s after 5\.0 s"):
        adapting.update(image(), 4.0)
    with pytest.raises(ValueError, match="got an image of \\(2, 2\\)"):
        adapting.update(np.ones((2, 2), np.float32), 6.0)
    for name in ("seconds", "settle", "reveal"):
        with pytest.raises(ValueError, match=f"{name} must be above 0"):
            SceneAdaptation(scene(), **{name: 0.0})
