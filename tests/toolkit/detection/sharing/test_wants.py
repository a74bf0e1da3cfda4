"""What the fusion centre asks for: gains, expected bits, their order, and how a link is shared."""

import numpy as np
import pytest

from toolkit.detection.sharing.wants import LONE, expected_pixels, granted, wanted
from toolkit.geometry import look, pose
from toolkit.objects import Detections
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.spinning_lidar import SpinningLidar

CAMERA = Sensor("a", DepthCamera(width=200, height=150, stride=1), look((0.0, 0.0, 1.0), 0.0, 0.0))
BESIDE = Sensor("b", DepthCamera(width=200, height=150, stride=1), look((0.0, 1.0, 1.0), 0.0, 0.0))
BEHIND = Sensor("c", DepthCamera(width=200, height=150, stride=1), look((0.0, 0.0, 1.0), np.pi, 0.0))


def box(x, y=0.0, size=1.0):
    return [x, y, 1.0, size, size, size, 0.0]


def test_pixels_of_a_cube_ahead():
    """f = 100 pixels; a cube shows a quarter of its surface, 1.5 m2, at 10 m: 100^2 / 10^2 * 1.5."""
    pixels = expected_pixels(CAMERA, np.array([box(10), box(20), box(-10), box(10, 30), box(10, size=2)]))
    np.testing.assert_allclose(pixels[[0, 1]], [150, 37.5], rtol=0.02)
    assert pixels[2:4].tolist() == [0, 0]
    assert pixels[4] == pytest.approx(4 * pixels[0])
    assert len(expected_pixels(CAMERA, np.zeros((0, 7)))) == 0


def test_a_spinning_lidar_sees_all_round_up_to_its_range():
    model = SpinningLidar(channels=16, azimuth_step=np.deg2rad(1.0), fov_up=0.2, fov_down=-0.2, max_range=50.0)
    pixels = expected_pixels(
        Sensor("s", model, pose(0.0, 0.0, 1.0)), np.array([box(10), box(-10), box(0, 10), box(60)])
    )
    each = 1.5 / 100 / (np.deg2rad(1.0) * 0.4 / 15)
    np.testing.assert_allclose(pixels, [each, each, each, 0], rtol=0.03)


def said(*rows):
    return Detections(np.array([row[:7] for row in rows]).reshape(-1, 7), np.array([row[7] for row in rows]))


def test_gains_are_doubt_and_disagreement_by_bits():
    near, far = [*box(10), 0.9], [*box(20, 3.0), 0.6]
    aside = [*box(10.5), 0.8]  # IoU 1/3 with the near one
    wants = wanted(said(near, far), [said(near, far), said(aside)], [CAMERA, BESIDE], same_iou=0.1)
    # the far one, reported once, seen by both: 0.4 + LONE; the near one: 0.1 + 2/3, but four times the pixels
    np.testing.assert_allclose(wants.gains, [0.4 + LONE, 0.1 + 2 / 3])
    np.testing.assert_allclose(wants.places, [[20, 3, np.sqrt(0.5)], [10, 0, np.sqrt(0.5)]])
    assert wants.of.all()
    np.testing.assert_allclose(wants.bits[0], 5 * expected_pixels(CAMERA, np.array([far[:7], near[:7]])))


def test_what_one_sensor_alone_can_see_is_not_asked_for():
    alone = [*box(10), 0.5]
    assert len(wanted(said(alone), [said(alone), said()], [CAMERA, BEHIND], same_iou=0.1).gains) == 0
    both = wanted(said(alone), [said(alone), said(), said()], [CAMERA, BEHIND, BESIDE], same_iou=0.1)
    assert both.of[:, 0].tolist() == [True, False, True]
    assert both.bits[1].tolist() == [0]


def test_of_nothing_nothing_is_wanted():
    assert len(wanted(said(), [said(), said()], [CAMERA, BESIDE], same_iou=0.1).gains) == 0
    assert len(wanted(said(), [], [], same_iou=0.1).gains) == 0


@pytest.mark.parametrize(
    ("most", "wishes", "shares"),
    [
        (1000, [100, 300], [250, 750]),
        (10, [1, 1, 1], [3, 3, 3]),
        (7, [0, 0], [3, 3]),
        (-5, [1, 1], [0, 0]),
        (9, [], []),
    ],
)
def test_grants_never_exceed_what_is_there(most, wishes, shares):
    assert granted(most, np.array(wishes, float)).tolist() == shares
