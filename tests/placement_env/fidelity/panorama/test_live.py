"""Sensors on mounts: what they see at any height, heading and tilt is what full rendering says,
nearly."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.candidates import Axes, Candidates
from placement_env.fidelity.panorama import TrafficView
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import Traffic
from toolkit.geometry import pose
from toolkit.rendering.strips import SuccessiveStrips
from toolkit.runtime.cache import Cache
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Mount

CAMERA, LIDAR = DepthCamera(width=200, height=150), SpinningLidar(channels=32, azimuth_step=0.02)
MOUNTS = (
    Mount("a", np.array([-22.0, -15.0, 0.1]), 4.0, 5.0),
    Mount("b", np.array([19.0, 13.0, -0.2]), 3.0, 4.2),
)


def hung(*aims, models=(CAMERA,)):
    """Sensors of mount, height, heading, tilt and number of a model."""
    sensors = []
    for k, (m, h, yaw, tilt, model) in enumerate(aims):
        x, y, z = MOUNTS[m].position.tolist()
        at = pose(x, y, z + h, yaw=yaw, pitch=tilt)
        sensors.append(Sensor(str(k), models[model], at @ models[model].body_SE3_sensor))
    mount = np.array([each[0] for each in aims])
    factors = np.column_stack(
        [mount, *[np.zeros(len(aims), np.int64)] * 3, [each[4] for each in aims]]
    )
    return Candidates(
        tuple(sensors), MOUNTS, factors, Axes(np.zeros(1), np.zeros(1), np.zeros(1), models)
    )


@pytest.fixture(scope="module")
def traffic(small_traffic):
    return Traffic(small_traffic.site, small_traffic.bodies, small_traffic.snapshots[:2])


@pytest.fixture(scope="module")
def view(traffic):
    return TrafficView(traffic)


def agreeing(found, exact):
    off, seen = np.abs(found.points - exact.points), np.maximum(found.points, exact.points) > 0
    return (off <= np.maximum(0.03 * exact.points, 8))[seen].mean()


def test_it_agrees_with_rendering_and_panoramas_at_any_aim(traffic, view):
    rng = np.random.default_rng(0)
    aims = [
        (
            m,
            rng.uniform(4.0, 4.2),
            (0.7, -2.4)[m] + rng.uniform(-0.4, 0.4),
            rng.uniform(0.1, 0.6),
            0,
        )
        for m in (0, 1)
        for _ in range(6)
    ]
    some = hung(*aims)
    found, exact = view.see(some), see(traffic, some, rendering="full")
    assert exact.points.max() > 80
    assert agreeing(found, exact) > 0.97
    assert np.abs(found.sent - exact.sent).mean() < 0.04 * exact.sent.mean()
    for name in ("distance", "frame", "boxes", "labels"):
        np.testing.assert_array_equal(getattr(found, name), getattr(exact, name))
    some = hung((0, 4.5, 0.7, 0.3, 0), (0, 4.5, 0.2, np.deg2rad(20.4), 0))
    found, looked = view.see(some), see(traffic, some, rendering="panorama")
    np.testing.assert_array_equal(found.points, looked.points)
    np.testing.assert_array_equal(found.sent, looked.sent)
    low, middle, high = (view.see(hung((0, h, 0.7, 0.3, 0))) for h in (4.0, 4.15, 4.5))
    for name in ("points", "sent", "far"):
        expected = 0.7 * getattr(low, name) + 0.3 * getattr(high, name)
        np.testing.assert_allclose(getattr(middle, name), expected, rtol=1e-4, atol=1e-3)


def test_panoramas_of_a_mount_are_made_once(traffic, monkeypatch):
    asked = []
    made = SuccessiveStrips.find_next

    def counted(self, moment, fine):
        asked.append(self._viewpoints[:, 2].round(6).tolist())
        return made(self, moment, fine)

    monkeypatch.setattr(SuccessiveStrips, "find_next", counted)
    view = TrafficView(traffic)
    view.see(hung((0, 4.3, 0.7, 0.3, 0)))
    assert asked == [[4.1, 4.6, 5.1]] * 2  # the foot stands at 0.1
    view.see(hung((0, 4.9, 2.7, 0.1, 0), (0, 4.0, 0.7, 0.3, 0)))
    assert len(asked) == 2
    view.see(hung((1, 4.1, -2.4, 0.3, 0)))
    assert asked[2:] == [[2.8, 3.3, 3.8, 4.3]] * 2
    view.see(hung((1, 4.2, -2.4, 0.3, 1), models=(CAMERA, LIDAR)))  # another model there
    assert len(asked) == 6
    view.see(hung((1, 6.6, -2.4, 0.3, 0)))  # higher than its mount says
    assert asked[6:] == [[6.3, 6.8]] * 2
    view.limit(10)
    # what is made anew drops what is old
    view.see(hung((0, 4.0, 0.7, 0.3, 1), models=(CAMERA, LIDAR)))
    assert list(view.surrounds) == [(-22.0, -15.0, 4.1)]


def test_panoramas_are_kept_on_disk_and_shared(traffic, view, tmp_path, fail):
    cache, some = (
        Cache(tmp_path / "cache.sqlite"),
        hung((0, 4.3, 0.7, 0.3, 0), (0, 5.0, 0.1, 0.2, 0)),
    )
    first = TrafficView(traffic, cache=cache).see(some)
    assert len(cache) == 3
    fail(SuccessiveStrips, "find_next")
    for one in (TrafficView(traffic, cache=cache).see(some), view.see(some)):
        np.testing.assert_array_equal(one.points, first.points)
        np.testing.assert_array_equal(one.sent, first.sent)
    others = replace(traffic, snapshots=traffic.snapshots[::-1])
    with pytest.raises(AssertionError, match="find_next was called"):
        TrafficView(others, cache=cache).see(some)


def test_classes_are_those_asked_for_and_nothing_may_move(traffic):
    some, labels = hung((0, 4.5, 0.7, 0.3, 0)), (0, 1, 2)
    found = TrafficView(traffic, labels).see(some)
    exact = see(traffic, some, labels=labels, rendering="full")
    np.testing.assert_array_equal(found.labels, exact.labels)
    assert agreeing(found, exact) > 0.97
    empty = replace(
        traffic.snapshots[0], objects=traffic.snapshots[0].objects[:0], bodies=np.zeros(0, np.int64)
    )
    found = TrafficView(replace(traffic, snapshots=(empty,))).see(hung((0, 4.5, 0.7, 0.5, 0)))
    assert found.points.shape == (1, 0)
    assert found.sent[0, 0] > 0
