"""What is looked up in panoramas is what full rendering counts, within 3 % or 8 points."""

import numpy as np
import pytest

from placement_env.fidelity.occlusion import look_at
from placement_env.fidelity.ray_table import Lookup
from placement_env.fidelity.seeing import look_round
from placement_env.fidelity.still import Still
from placement_env.fidelity.surround import ScoredItems, Surround
from placement_env.fidelity.traffic import build_renderer
from toolkit.geometry import pose
from toolkit.objects import VEHICLE
from toolkit.rendering.strips import BEYOND, OUTSIDE, WITHIN, Strips
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor

PLACES = [(-22.0, -16.0, 6.0), (22.0, 16.0, 5.0), (0.0, -17.0, 4.0), (1.0, 1.0, 9.0)]
MODELS = {"camera": DepthCamera(), "spinning": SpinningLidar(), "solid": SolidStateLidar()}


def hung(model, tilts, roll=0.0):
    """Sensors at each place, of three headings and these tilts."""
    return [
        Sensor(
            f"{p}_{h}_{t}",
            model,
            pose(*at, yaw=h * 2.1 - 2.0, pitch=tilt, roll=roll) @ model.body_SE3_sensor,
        )
        for p, at in enumerate(PLACES)
        for h in range(3)
        for t, tilt in enumerate(tilts)
    ]


def agreement(traffic, sensors, labels=(VEHICLE,)):
    """Share of what is seen at all that agrees, and both counts of points."""
    exact, found = (
        look_at(traffic, build_renderer(traffic), sensors, labels),
        look_round(traffic, sensors, labels),
    )
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


def test_a_strip_counts_for_its_object_and_for_what_is_sent():
    model = SolidStateLidar(rows=40, columns=40, horizontal_fov=1.0, vertical_fov=1.0)
    angles = [[0.8, 1.0, 1.0], [1.0, 1.2, 1.2], [-0.2, -0.2, 0.0], [0.0, 0.0, 0.2]]
    left, right, bottom, top = np.array(angles, np.float32)
    shows = np.array([WITHIN, BEYOND, OUTSIDE], np.int32)
    strips = Strips(
        np.zeros(3, np.int32), np.array([0, 1, 2], np.int32), left, right, bottom, top, shows
    )
    cells = 240 * (120 + 350 + 170)
    still = Still(np.full(cells, 125, np.uint8), np.full(cells, 0, np.uint8))
    surround = Surround.from_strips(
        strips, ScoredItems(np.arange(3), np.array([0, 1, 1]), 3, 2), {model: still}
    )
    towards, away = (
        Lookup.from_sensor(Sensor("a", model, pose(z=5.0, yaw=yaw))) for yaw in (1.0, -2.0)
    )
    np.testing.assert_allclose(still.count_background(towards), [800, 0], rtol=1e-5)
    points, sent, far = surround.seen(towards)
    each = 64.0  # rays of a fifth of the field of view both ways
    np.testing.assert_allclose(points, [each, each, 0], atol=9)
    np.testing.assert_allclose(sent, [800 + points[0] / 2, 800 + points[1] / 2 - 32], atol=5)
    np.testing.assert_allclose(far, [0, points[1]], atol=1e-3)
    for found, expected in zip(surround.seen(away), ([0, 0, 0], [800, 800], [0, 0]), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-3)
