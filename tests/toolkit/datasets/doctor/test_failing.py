"""Sensors that freeze or go blind in the middle of a recording."""

import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.datasets.doctor.failing import blind_frames, failing_sensors, frozen_frames
from toolkit.datasets.doctor.hypotheses import SensorImages
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SITE = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
SENSORS = [
    Sensor(name, DepthCamera(width=40, height=30, stride=1), look((x, 0.0, 8.0), 0.0, 0.6))
    for name, x in (("a", -12.0), ("b", -10.0))
]


def image(sensor, centre):
    """Flat ground, and the top of a car about a centre, 1.5 m up."""
    rays = sensor.world_rays
    down = np.minimum(rays[2], -0.05)
    top, ground = (1.5 - 8.0) / down, (0.05 - 8.0) / down
    x, y = sensor.position[0] + rays[0] * top, rays[1] * top
    on = (np.abs(x - centre) < 2) & (np.abs(y) < 1)
    return np.where(on, top, np.where(rays[2] < -0.05, ground, 0)).astype(np.float32)


def rows(centres):
    """As published, a frame each."""
    boxes = [np.array([[x, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]]) for x in centres]
    return [published.rows_of(Objects(b, np.zeros(1, int), np.arange(1)), SITE.map_SE3_site) for b in boxes]


CENTRES = [-4.0, -3.0, 3.0, 9.0, 9.0, 2.0]


def views(shown=CENTRES):
    rays = DepthCamera(width=40, height=30, stride=1).rays().reshape(-1, 3)
    return [SensorImages(each, rays, np.stack([image(each, x) for x in shown])) for each in SENSORS]


def test_a_healthy_recording_and_one_in_which_nobody_moves():
    assert not any(frozen_frames(each, rows(CENTRES), SITE).any() for each in views())  # 9 twice: parked
    assert not blind_frames(views()).any()
    assert list(failing_sensors(views(), rows(CENTRES), SITE, range(6))) == []


def test_an_image_that_shows_who_has_gone_is_frozen():
    frozen = views([-4.0, -3.0, -3.0, -3.0, 9.0, 2.0])[0]
    assert frozen_frames(frozen, rows(CENTRES), SITE).tolist() == [False, False, True, True, False, False]
    both = [frozen, views()[1]]
    assert list(failing_sensors(both, rows(CENTRES), SITE, [0, 7, 14, 21, 28, 35])) == [
        (
            "sensor a", "it is frozen",
            "2 of 6 frames that were looked at, the first is 14, show objects where nobody is any more",
            "leave these frames out, or the sensor",
        )
    ]  # fmt: skip
    nearby = rows([-4.0, -3.0, -1.0, 9.0, 9.0, 2.0])  # has moved, but stands still where it was
    assert not frozen_frames(frozen, nearby, SITE)[2]


def test_half_of_what_is_usual_is_blind_unless_all_are():
    images = views()
    dark = images[0].depth.copy()
    there = np.flatnonzero(dark[3] > 0)
    dark[3, there[: int(0.45 * len(there))]] = 0
    dark[4, there[: int(0.55 * len(there))]] = 0
    dark[5] = 0
    other = images[1].depth.copy()
    other[5] = 0
    changed = [SensorImages(each.sensor, each.rays, depth) for each, depth in zip(images, (dark, other), strict=True)]
    assert blind_frames(changed).tolist() == [[False, False, False, False, True, False], [False] * 6]
    (found,) = failing_sensors(changed, rows(CENTRES), SITE, range(6))
    assert found[:2] == ("sensor a", "it goes blind")
    assert found[2].startswith("1 of 6 frames that were looked at, the first is 4, return less than half")


def test_nothing_to_look_at():
    assert list(failing_sensors([], [], SITE, [])) == []
