from types import SimpleNamespace

import numpy as np
import pytest

from toolkit.detection.codec import Message
from toolkit.detection.view import View, frame_view, suppress, together
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

AREA = (-10.0, -10.0, 10.0, 10.0)
SENSORS = tuple(Sensor(name, DepthCamera(), np.eye(4)) for name in "ab")


class Halved:
    """Every other point arrives, every box."""

    digest = "halved"

    def encode_points(self, points, /):
        return Message(points[::2], 10 * len(points))

    def decode_points(self, message, /):
        return message.content

    def encode_boxes(self, detections, /):
        return Message(detections, 7)

    def decode_boxes(self, message, /):
        return message.content

    def bits(self, *, points=0, boxes=0, messages=1):
        return 10 * points + 7 * messages


@pytest.fixture
def watched():
    """A view of two sensors with 4 and 6 points, what it measured and what it detected in."""
    calls = SimpleNamespace(measured=[], run=[])

    def measure(sensor):
        calls.measured.append(sensor)
        return np.full((4 + 2 * sensor, 3), sensor, np.float32)

    def run(clouds):
        calls.run.append([(cloud.sensor, cloud.history) for cloud in clouds])
        return Detections(np.array([[len(together(clouds)), 0, 1, 4, 2, 1.5, 0]]), np.array([0.5]))

    def view(**options):
        return View(AREA, SENSORS, measure=measure, run=run, **options), calls

    return view


def test_each_step_is_done_once(watched):
    view, calls = watched()
    for _ in range(2):
        clouds = [view.part(view.cloud(s), "first", lambda points, _: np.arange(len(points)) == 0) for s in (0, 1)]
        view.detect([view.send_points(clouds[0]).arrived])
        view.send_boxes(view.detect([view.cloud(1)]))
    assert calls.measured == [0, 1]
    assert calls.run == [[(0, ("first",))], [(1, ())]]
    assert [len(cloud.points) for cloud in clouds] == [1, 1]


def test_a_cloud_that_lost_points_on_the_way_is_another(watched):
    view, calls = watched(codec=Halved())
    sent = view.send_points(view.cloud(1))
    assert (len(sent.arrived.points), sent.bits, sent.arrived.history) == (3, 60, ("halved",))
    assert view.detect([sent.arrived]) is not view.detect([view.cloud(1)])
    assert view.send_boxes(view.detect([view.cloud(1)])).bits == 7
    assert calls.run == [[(1, ("halved",))], [(1, ())]]


def test_without_loss_what_arrives_is_the_same_cloud(watched):
    view, calls = watched()
    assert view.detect([view.send_points(view.cloud(0)).arrived]) is view.detect([view.cloud(0)])
    assert len(calls.run) == 1


def test_a_step_is_ready_after_the_last_of_its_inputs(watched):
    view, _ = watched()
    clouds = [view.cloud(0), view.cloud(1)]
    last = max(cloud.ms for cloud in clouds)
    boxes = view.detect(clouds)
    assert 0 < last < boxes.ms
    assert view.suppressed([boxes, view.detect([clouds[0]])]).ms > boxes.ms
    assert view.suppressed([]).ms >= 0


def test_of_boxes_that_overlap_the_surest_stays():
    boxes = np.array([[0.0, 0, 1, 4, 2, 1.5, 0], [0.5, 0, 1, 4, 2, 1.5, 0], [9, 0, 1, 4, 2, 1.5, 0]])
    kept = suppress(Detections(boxes, np.array([0.4, 0.6, 0.5])))
    assert kept.boxes[:, 0].tolist() == [0.5, 9]


def test_boxes_of_different_classes_do_not_suppress_each_other():
    box = np.array([0.0, 0, 1, 4, 2, 1.5, 0])
    found = Detections(np.stack([box] * 4), np.array([0.5, 0.9, 0.7, 0.6]), np.array([0, 3, 0, 2]))
    kept = suppress(found)
    assert [(label, score) for label, score in zip(kept.labels, kept.scores, strict=True)] == [
        (3, 0.9),
        (0, 0.7),
        (2, 0.6),
    ]


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0], [1, 2, 0]])
def test_the_order_of_equal_boxes_of_different_classes_makes_no_difference(order):
    box = np.array([0.0, 0, 1, 4, 2, 1.5, 0])
    found = Detections(np.stack([box] * 3), np.full(3, 0.5), np.array([2, 0, 3]))[order]
    assert suppress(found).labels.tolist() == [0, 2, 3]


class Dimmed(Halved):
    """Images half as far; what is sent is remembered."""

    digest = "dimmed"

    def __init__(self):
        self.sent = []

    def encode_image(self, image, /):
        self.sent.append(image)
        return Message(image.measurement / 2, 5)

    def decode_image(self, message, sensor, /):
        return message.content


def seen(shifts=()):
    sensor = Sensor("a", DepthCamera(width=8, height=6, stride=2), look((0.0, 0.0, 1.5), 0.0))
    return Frame((sensor,), (np.full((3, 4), 4.0, np.float32),), Objects.empty(), 2.0, 9, shifts)


def far(points, _):
    return points[:, 2] > 1.5


@pytest.mark.parametrize("shifted", [False, True])
def test_a_codec_of_images_gets_the_pixels_of_the_points(shifted):
    shift = np.tile(np.array([0.0, 0.5, 0.0], np.float32), (3, 4, 1))
    frame, codec = seen((shift,) if shifted else ()), Dimmed()
    view = frame_view(frame, lambda points: None, (0.0, -10.0, 10.0, 10.0), codec=codec)
    cloud = view.cloud(0)
    part = view.part(view.part(cloud, "far", far), "second", lambda points, _: np.arange(len(points)) == 1)
    for each, rows in ((cloud, None), (part, [1])):
        arrived, bits = view.send_points(each)
        half = (each.points + frame.sensors[0].position - (shifted and [0, 0.5, 0])) / 2 + (shifted and [0, 0.5, 0])
        np.testing.assert_allclose(arrived.points, half, atol=1e-5)
        assert bits == 5
        assert (each.rows is None) == (rows is None)
    assert [np.count_nonzero(image.measurement) for image in codec.sent] == [len(cloud.points), 1]
    assert part.rows.tolist() == [np.flatnonzero(far(cloud.points, None))[1]]
    assert (codec.sent[0].time, codec.sent[0].number, codec.sent[0].sensor.name) == (2.0, 9, "a")


def test_where_there_are_points_alone_it_gets_them(watched):
    view, _ = watched(codec=Dimmed())
    assert view.send_points(view.cloud(1)).bits == 60
    with pytest.raises(ValueError, match="points alone, no images"):
        view.captured(0)
    with pytest.raises(ValueError, match="no empty scenes"):
        view.scene(0)


def test_what_links_remember_goes_from_view_to_view(watched):
    memory = {}
    for expected in ([1], [1, 1]):
        view = watched(memory=memory)[0]
        kept = view.remembered(0, "link", list)
        kept.append(1)
        assert kept == expected
        assert view.remembered(1, "link", list) == []
    assert watched()[0].remembered(0, "link", list) == []


def test_what_is_transmitted_by_a_name_is_so_once(watched):
    view, calls = watched()
    made = []

    def through():
        made.append(1)
        return np.zeros((2, 3), np.float32), 77

    for _ in range(2):
        sent = view.transmit(0, "mine", through)
        view.detect([sent.arrived])
    assert (sent.bits, made, sent.arrived.history) == (77, [1], ("mine",))
    assert calls.run == [[(0, ("mine",))]]
    assert sent.arrived.ms >= view.cloud(0).ms
