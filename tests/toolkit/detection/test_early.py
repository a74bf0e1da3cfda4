"""Early fusion of a view."""

from types import SimpleNamespace

import numpy as np

from toolkit.detection.early import Early
from toolkit.detection.scheme import Scheme
from toolkit.detection.view import View, together
from toolkit.geometry import look
from toolkit.objects import Detections
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

AREA = (-40.0, -20.0, 40.0, 20.0)
SENSORS = tuple(Sensor(name, DepthCamera(), look((x, 0.0, 5.0), 0.0)) for name, x in (("a", -10.0), ("b", 10.0)))
POINTS = [np.array([[x, y, 1.0] for y in (0.0, 3.0, 15.0)], np.float32) for x in (-9.0, 9.0)]


def one_box(clouds):
    """A box at the mean of all points, the surer the more there are; none without points."""
    points = together(clouds)
    boxes = np.array([[*points.mean(axis=0), 4, 2, 1.5, 0]], np.float64) if len(points) else np.zeros((0, 7))
    return Detections(boxes, np.full(len(boxes), len(points) / 10))


def view():
    return View(AREA, SENSORS, measure=lambda sensor: POINTS[sensor], run=one_box)


def test_one_detection_in_the_points_of_all():
    fused = Early().fuse(view(), [0, 1])
    np.testing.assert_allclose(fused.detections.boxes[:, :3], [[0.0, 6.0, 1.0]])
    assert fused.detections.scores.tolist() == [0.6]
    assert fused.bits.tolist() == [3 * 96, 3 * 96]


def test_nobody_sends_nothing():
    fused = Early().fuse(view(), [])
    assert len(fused.detections) == len(fused.bits) == 0


def test_points_in_the_crop_are_sent_and_no_boxes():
    ten, four = (np.full((2, 3), number, np.float32) for number in (10, 4))
    counts = SimpleNamespace(sent=ten, on_objects=four, far=four)
    assert Early().sent_points(counts) is counts.sent
    assert (Early().sends_points, Early().sends_boxes) == (True, False)
    scheme: Scheme = Early()
    assert scheme.pooled_beside(np.zeros((2, 3), np.float32), 20.0) is None
