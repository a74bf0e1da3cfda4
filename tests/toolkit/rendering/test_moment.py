"""A frame's moving bodies in one scene: what a line meets first is what the renderer draws."""

import numpy as np
import pytest

from toolkit.bodies.body import boxed, centred
from toolkit.bodies.fleet import catalogue
from toolkit.geometry import look
from toolkit.mesh import box
from toolkit.objects import VEHICLE, Objects
from toolkit.rendering.moment import Moment
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site
from toolkit.traffic.snapshots import Snapshot

CAR = centred("car", VEHICLE, *box((4.0, 2.0, 1.5)))
MIRRORED = boxed("mirrored", VEHICLE, box((4.0, 2.0, 1.5)), box((0.2, 0.4, 0.2), (1.0, 1.2, 0.2)))
BEHIND = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0], [10.0, 0, 0.75, 4, 2, 1.5, np.pi / 2]])


def lines(starts, ways):
    return np.concatenate([starts, ways], axis=1).astype(np.float32)


def test_a_line_meets_the_nearest_object_or_none():
    moment = Moment((CAR, CAR), BEHIND, threads=1)
    starts = np.array([[-10.0, 0, 0.7], [20, 0, 0.7], [0, 9, 0.7], [10, 9, 0.7]])
    ways = np.array([[1.0, 0, 0], [-2, 0, 0], [0, 1, 0], [0, -1, 0]])
    met, length = moment.met(lines(starts, ways))
    assert met.tolist() == [0, 1, -1, 1]
    np.testing.assert_allclose(length[[0, 1, 3]], [8.0, 4.5, 7.0], atol=1e-5)
    assert np.isinf(length[2])


def test_nothing_moves():
    moment = Moment((), np.zeros((0, 7)), threads=1)
    assert len(moment) == 0
    met, length = moment.met(lines(np.zeros((2, 3)), np.ones((2, 3))))
    assert met.tolist() == [-1, -1]
    assert np.isinf(length).all()
    assert moment.ground.points.shape == (0, 2)


def test_it_shows_what_the_renderer_draws():
    site, bodies = Site("plain", np.array([-30.0, -20, 30, 20])), catalogue()
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(bodies), size=12)
    cells = rng.permutation(20)[:12]
    sizes = np.array([bodies[b].size for b in chosen])
    xy = np.column_stack([cells % 5 - 2, cells // 5 - 1.5]) * [12.0, 11.0]
    boxes = np.column_stack([xy, sizes[:, 2] / 2, sizes, rng.uniform(-3, 3, 12)])
    snapshot = Snapshot(Objects(boxes, np.array([bodies[b].label for b in chosen])), chosen)
    sensor = Sensor("camera", DepthCamera(width=320, height=240), look((-28.0, -16.0, 6.0), 0.5, 0.2))
    renderer = Renderer(site, bodies, [sensor], threads=1)
    measured, hits = renderer.render(snapshot)
    rays = sensor.world_rays.T
    met, length = renderer.moment(snapshot).met(lines(np.broadcast_to(sensor.position, rays.shape), rays))
    drawn = hits[0].ravel()
    seen = drawn >= 0
    assert seen.sum() > 300
    assert (met[seen] != drawn[seen]).mean() < 0.002
    same = seen & (met == drawn)
    np.testing.assert_allclose(length[same], measured[0].ravel()[same], atol=1e-3)
    with pytest.raises(ValueError, match="simulate and render with the same bodies"):
        renderer.moment(Snapshot(Objects(boxes + np.eye(7)[3], snapshot.objects.labels), chosen))


def test_the_ground_it_covers():
    turned = np.array([[5.0, 6.0, 0.75, 4, 2, 1.5, np.pi / 2]])
    for body, across in ((CAR, (-1.0, 1.0)), (MIRRORED, (-1.0, 1.4))):
        ground = Moment((body,), turned).ground
        x, y = ground.points.T
        assert (x.min(), x.max()) == pytest.approx((5 - across[1], 5 - across[0]))
        assert (y.min(), y.max()) == pytest.approx((4.0, 8.0))
        assert (ground.low[0], ground.high[0]) == pytest.approx((0.0, 1.5))
        assert ground.first.tolist() == [0, len(x)]
        middle = 5 - sum(across) / 2
        np.testing.assert_allclose(ground.rectangles[0], [middle, 6, 2, np.ptp(across) / 2, 0, 1], atol=1e-6)


def test_on_a_slope_it_is_what_the_renderer_shows():
    steep = Site("steep", np.array([-30.0, -30, 30, 30]), relief=Relief(0.0, 0, (0.06, -0.04)))
    eye = Sensor("eye", DepthCamera(width=160, height=120, stride=1), look((-14.0, 2.0, 5.0), 0.0, 0.2))
    boxes = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0.3], [6.0, 3, 1.0, 4, 2, 1.5, 2.0]])
    renderer = Renderer(steep, (CAR,), (eye,), threads=1)
    frame = Snapshot(Objects(boxes, np.full(2, VEHICLE)), np.zeros(2, np.int64))
    depth, hits = (images[0].ravel() for images in renderer.render(frame))
    moment, rays = renderer.moment(frame), eye.world_rays.T
    met, length = moment.met(lines(np.broadcast_to(eye.position, rays.shape), rays))
    shown = hits >= 0
    assert shown.sum() > 300
    assert (met[shown] == hits[shown]).mean() > 0.995
    np.testing.assert_allclose(np.median(np.abs(length[shown] - depth[shown])), 0.0, atol=1e-4)
    points = rays[shown] * length[shown, None] + eye.position
    low, high = moment.ground.low[met[shown]], moment.ground.high[met[shown]]
    assert ((points[:, 2] > low - 1e-3) & (points[:, 2] < high + 1e-3)).all()
