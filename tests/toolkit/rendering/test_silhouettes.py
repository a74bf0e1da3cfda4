"""Which pixels meet a body: those that a rendered picture of it shows, of every sensor and
model."""

import numpy as np
import pytest

from placement_env.fidelity import occlusion
from placement_env.fidelity.occlusion import SensorRays
from toolkit.bodies.body import make_body
from toolkit.boxes import count_points
from toolkit.geometry import level_rows, look, pose
from toolkit.mesh import box
from toolkit.objects import VEHICLE, Objects
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site, Solid
from toolkit.traffic.snapshots import Snapshot

CAR = make_body("car", VEHICLE, *box((4.0, 2.0, 1.5)))
WALL = Solid(np.array([[8.0, -3], [8.4, -3], [8.4, 3], [8, 3]]), 0.0, 4.0)
SITE = Site("walled", np.array([-30.0, -20, 30, 20]), solids=(WALL,))
SENSORS = (
    Sensor("camera", DepthCamera(width=80, height=60), look((-14.0, 0.0, 5.0), 0.0, 0.25)),
    Sensor("lidar", SpinningLidar(channels=24, azimuth_step=0.02), pose(0.0, 12.0, 4.0, yaw=-1.0)),
    Sensor("solid", SolidStateLidar(rows=30, columns=90), pose(0.0, -14.0, 3.0, yaw=1.5)),
)
PLACES = [(0.0, 0.0, 0.3), (5.0, -4.0, -2.0), (-6.0, 6.0, 1.2)]


@pytest.fixture(scope="module")
def renderer():
    return Renderer(SITE, (CAR,), SENSORS, threads=1)


@pytest.fixture(scope="module")
def rays(renderer):
    return SensorRays(renderer, SENSORS)


def upright(x, y, yaw):
    return np.array([x, y, 0.75, 4.0, 2.0, 1.5, yaw])


def test_what_is_hidden_or_out_of_sight_has_no_pixels(rays, renderer):
    pixels = [int(np.prod(sensor.model.shape)) for sensor in SENSORS]
    assert np.diff(rays.first).tolist() == pixels
    assert rays.rays.shape == (sum(pixels), 3)
    np.testing.assert_array_equal(
        rays.still, np.concatenate([image.ravel() for image in renderer.background])
    )
    behind = rays.silhouette(0, upright(11.0, 0.0, np.pi / 2))
    assert 0 not in behind.sensors
    assert 0 in rays.silhouette(0, upright(4.0, 0.0, np.pi / 2)).sensors
    assert len(rays.silhouette(0, upright(500.0, 0.0, 0.0)).pixels) == 0


@pytest.mark.parametrize(("x", "y", "yaw"), PLACES)
def test_silhouettes_are_what_a_picture_shows_on_the_body(rays, renderer, x, y, yaw):
    row = upright(x, y, yaw)
    snapshot = Snapshot(Objects(row[None], np.array([VEHICLE])), np.zeros(1, np.int64))
    measurements, hits = renderer.render(snapshot)
    shown = np.flatnonzero(np.concatenate([hit.ravel() for hit in hits]) == 0)
    found = rays.silhouette(0, row)
    assert len(found.pixels) > 100
    np.testing.assert_array_equal(np.sort(found.pixels), shown)
    depth = np.concatenate([image.ravel() for image in measurements])
    np.testing.assert_allclose(found.depth, depth[found.pixels], atol=1e-3)
    assert set(found.sensors.tolist()) == {0, 1, 2}
    np.testing.assert_array_equal(
        found.sensors, np.searchsorted(rays.first, found.pixels, side="right") - 1
    )
    points = rays.silhouette(0, upright(x, y, yaw)).points.astype(np.float64)
    local = np.abs((points - [x, y, 0.75]) @ pose(0.0, 0.0, 0.0, yaw=yaw)[:3, :3]) / [
        2.0,
        1.0,
        0.75,
    ]
    np.testing.assert_allclose(local.max(axis=1), 1.0, atol=0.02)


def test_on_a_slope_too():
    steep = Site("steep", SITE.area, solids=(WALL,), relief=Relief(0.0, 0, (0.06, -0.04)))
    renderer = Renderer(steep, (CAR,), SENSORS, threads=1)
    row = upright(0.0, 0.0, 0.3)
    snapshot = Snapshot(Objects(row[None], np.array([VEHICLE])), np.zeros(1, np.int64))
    shown = np.flatnonzero(
        np.concatenate([hit.ravel() for hit in renderer.render(snapshot).hits]) == 0
    )
    found = SensorRays(renderer, SENSORS).silhouette(0, row)
    np.testing.assert_array_equal(np.sort(found.pixels), shown)
    local = level_rows(found.points.astype(np.float64), (0.06, -0.04))
    assert count_points(local, [[*row[:3], 4.02, 2.02, 1.52, 0.3]]).tolist() == [len(local)]
    assert len(local) > 100


def test_windows_of_many_boxes_are_those_of_each(rays):
    boxes = np.array([upright(*place) for place in PLACES] + [upright(500.0, 0.0, 0.0)])
    together = rays.windows(np.zeros(4, np.int64), boxes)
    assert sum(len(each.rows) for each in together) > 5
    for each, box_there in zip(together, boxes, strict=True):
        (alone,) = rays.windows(np.zeros(1, np.int64), box_there[None])
        np.testing.assert_array_equal(each.rows, alone.rows)
        np.testing.assert_allclose(each.least, alone.least)
        given, found = rays.silhouette(0, box_there, each), rays.silhouette(0, box_there)
        for one, other in zip(given, found, strict=True):
            np.testing.assert_array_equal(one, other)
    assert rays.windows(np.zeros(0, np.int64), np.zeros((0, 7))) == []


def test_more_boxes_than_are_looked_at_at_once(rays, limits):
    boxes = np.array([upright(*place) for place in PLACES])
    whole = rays.windows(np.zeros(3, np.int64), boxes)
    limits(occlusion, BOXES_TOGETHER=2)
    for one, other in zip(whole, rays.windows(np.zeros(3, np.int64), boxes), strict=True):
        np.testing.assert_array_equal(one.rows, other.rows)
