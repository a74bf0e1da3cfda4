"""What the standing scene sends: as when every ray is cast."""

import numpy as np
import pytest

from placement_env.fidelity.occlusion import look_at
from placement_env.fidelity.ray_table import Lookup
from placement_env.fidelity.still import Still
from placement_env.fidelity.traffic import Traffic, build_renderer
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.traffic.snapshots import Snapshot

CAMERA, LIDAR = DepthCamera(width=200, height=150), SpinningLidar(channels=32, azimuth_step=0.02)
AT = (-21.0, -15.0, 5.0)


@pytest.fixture(scope="module")
def empty(small_traffic):
    nothing = Snapshot(Objects(np.zeros((0, 7)), np.zeros(0, np.int64)), np.zeros(0, np.int64))
    return Traffic(small_traffic.site, small_traffic.bodies, (nothing,))


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor("near", CAMERA, look(AT, 0.7, 0.5)),
        Sensor("far", CAMERA, look(AT, 0.6, 0.1)),
        Sensor("lidar", LIDAR, pose(3.0, 9.0, 3.5, yaw=2.0)),
    ],
    ids=lambda sensor: sensor.name,
)
def test_it_is_what_rays_see(empty, sensor):
    exact = look_at(empty, build_renderer(empty), [sensor])
    sent, far = Still.from_renderer(
        build_renderer(empty), empty.site, sensor.position, sensor.model
    ).count_background(Lookup.from_sensor(sensor))
    assert exact.sent[0, 0] > 150
    assert sent == pytest.approx(exact.sent[0, 0], rel=0.05)
    assert far == pytest.approx(exact.far[0, 0], rel=0.05, abs=20)


def test_behind_strips_it_is_that_of_the_direction(empty):
    still = Still.from_renderer(
        build_renderer(empty), empty.site, np.array((0.0, -10.0, 4.0)), LIDAR
    )
    azimuth, elevation = np.meshgrid(
        np.arange(240) * np.deg2rad(1.5) - np.pi + 0.01, np.deg2rad([-60.2, -20.05, 40.3])
    )
    azimuth, elevation = (each.ravel().astype(np.float32) for each in (azimuth, elevation))
    sent, far = still.behind(azimuth, elevation)
    for turn in (2, -2):
        np.testing.assert_array_equal(
            still.behind(azimuth + np.float32(turn * np.pi), elevation)[0], sent
        )
    # half degrees from -90, tenths from -30, half degrees from 5 on
    rows = [59, 120 + 99, 120 + 350 + 70]
    np.testing.assert_allclose(sent, still.sent.reshape(240, 640)[:, rows].T.ravel() / 250)
    assert sent[240:480].max() > 0.8
    assert (far <= sent).all()
    assert (far > 0).any() == (still.far.reshape(240, 640)[:, rows] > 0).any()
    assert (still.far <= still.sent).all()
    assert still.far.max() > 0
    assert still.sent.dtype == np.uint8
