"""What is looked up in strips is what full rendering counts, within 3 % or 8 points."""

import numpy as np
import pytest

from placement_env.fidelity.occlusion import look_at
from placement_env.fidelity.panorama.looking import Sight, Views, alone, look_through
from placement_env.fidelity.panorama.panoramas import look_round
from placement_env.fidelity.panorama.ray_table import PER_STEEP, PER_TURN
from placement_env.fidelity.panorama.still import Still
from placement_env.fidelity.traffic import build_renderer
from toolkit.geometry import look, pose
from toolkit.objects import VEHICLE
from toolkit.rendering.strips import BEYOND, OUTSIDE, WITHIN, Strips
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor

PLACES = [(-22.0, -16.0, 6.0), (22.0, 16.0, 5.0), (0.0, -17.0, 4.0), (1.0, 1.0, 9.0)]
MODELS = {"camera": DepthCamera(), "spinning": SpinningLidar(), "solid": SolidStateLidar()}


def hung(model, tilts, roll=0.0):
    """Sensors at each place, of three headings and these tilts."""
    return [
        Sensor(f"{p}_{h}_{t}", model, pose(*at, yaw=h * 2.1 - 2.0, pitch=tilt, roll=roll) @ model.body_SE3_sensor)
        for p, at in enumerate(PLACES) for h in range(3) for t, tilt in enumerate(tilts)
    ]  # fmt: skip


def agreement(traffic, sensors, labels=(VEHICLE,)):
    """Share of what is seen at all that agrees, and both counts of points."""
    exact, found = look_at(traffic, build_renderer(traffic), sensors, labels), look_round(traffic, sensors, labels)
    both = np.maximum(exact.points, found.points) > 0
    off = np.abs(found.points - exact.points)
    return (off <= np.maximum(0.03 * exact.points, 8))[both].mean(), exact, found


@pytest.mark.parametrize("model", MODELS)
def test_points_agree_with_full_rendering(small_traffic, model):
    share, exact, found = agreement(small_traffic, hung(MODELS[model], (0.1, 0.35, 0.77)))
    assert share > 0.985
    assert found.points.sum() == pytest.approx(exact.points.sum(), rel=0.005)
    assert np.abs(found.sent - exact.sent).mean() < 0.03 * exact.sent.mean()
    assert np.abs(found.far - exact.far).mean() < 0.03 * exact.sent.mean()


def test_rolled_and_downward_sensors_and_other_classes(small_traffic):
    labels = (0, 1, 2, 3, 4)
    for sensors in (hung(DepthCamera(), (0.3,), roll=0.5), hung(DepthCamera(), (np.pi / 2,))):
        share, exact, found = agreement(small_traffic, sensors, labels)
        assert exact.points.max() > 50
        assert share > 0.98
        assert found.points.sum() == pytest.approx(exact.points.sum(), rel=0.01)


def test_views_group_sensors_by_table_and_place():
    camera, lidar = DepthCamera(), SpinningLidar()
    sensors = [
        Sensor("a", camera, look(PLACES[0], 0.5, np.deg2rad(15.0))),
        Sensor("b", camera, look(PLACES[0], -0.5, np.deg2rad(15.0))),
        Sensor("c", camera, look(PLACES[1], 0.5, np.deg2rad(15.4))),
        Sensor("d", lidar, pose(*PLACES[1], yaw=1.0)),
    ]
    views = Views.of(sensors)
    assert len(views.viewpoints) == 2
    assert views.viewpoint.tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(views.heading / PER_TURN, [0.5, -0.5, 0.5, 1.0], atol=1e-5)
    np.testing.assert_allclose(views.more / PER_STEEP, [0, 0, np.deg2rad(0.4), 0], atol=1e-5)
    assert [sorted(members.tolist()) for _, members in views.groups] == [[0, 2], [1], [3]]
    assert [(model, roll) for (model, _, roll), _ in views.groups] == [(camera, 0.0), (camera, 0.0), (lidar, 0.0)]
    assert [tilt for (_, tilt, _), _ in views.groups] == pytest.approx([*[np.deg2rad(15.0)] * 2, 0.0])


def test_a_strip_counts_for_its_object_and_for_what_is_sent():
    model = SolidStateLidar(rows=40, columns=40, horizontal_fov=1.0, vertical_fov=1.0)
    views = Views.of([Sensor("a", model, pose(z=5.0, yaw=1.0)), Sensor("b", model, pose(z=5.0, yaw=-2.0))])
    angles = [[0.8, 1.0, 1.0], [1.0, 1.2, 1.2], [-0.2, -0.2, 0.0], [0.0, 0.0, 0.2]]
    left, right, bottom, top = np.array(angles, np.float32)
    shows = np.array([WITHIN, BEYOND, OUTSIDE], np.int32)
    strips = Strips(np.zeros(3, np.int32), np.array([0, 1, 2], np.int32), left, right, bottom, top, shows)
    shape = (1, 240, 120 + 350 + 170)
    stills = {model: Still(np.full(shape, 125, np.uint8), np.full(shape, 0, np.uint8))}
    sight = Sight.of(strips, np.array([0, 1, 1]))
    empty = alone(views, stills)
    np.testing.assert_allclose(empty, [[800, 800], [0, 0]], rtol=1e-5)
    seen = look_through(views, sight, stills, empty, (3, 2))
    each = 64.0  # rays of a fifth of the field of view both ways
    np.testing.assert_allclose(seen.points, [[each, each, 0], [0, 0, 0]], atol=9)
    first, second = seen.points[0, :2]
    np.testing.assert_allclose(seen.sent, [[800 + first / 2, 800 + second / 2 - 32], [800, 800]], atol=5)
    np.testing.assert_allclose(seen.far, [[0, second], [0, 0]], atol=1e-3)
