"""Clouds as images send what the images they were made of send, and the centre has the same points
of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.ground import Ground
from toolkit.calibration.place import Stand
from toolkit.calibration.recording_scenes import Scenes
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.messages import Message
from toolkit.detection.paper_schemes import Hybrid
from toolkit.detection.schemes import SCHEMES
from toolkit.detection.view import View, frame_view, stand_view, suppress, together
from toolkit.frame import Frame, SensorCloud, unproject
from toolkit.geometry import invert, look, pose, transform
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import DepthCamera, RowLidar
from toolkit.sensors.sensor import Sensor

SENSORS = tuple(Sensor(name, DepthCamera(), np.eye(4)) for name in "ab")


class Halved:
    digest = "halved"

    def encode_points(self, points, /):
        return Message(points[::2], 10 * len(points))

    def decode_points(self, message, /):
        return message.content

    def encode_boxes(self, detections, origin, /):
        return Message(detections, 7)

    def decode_boxes(self, message, sensor, /):
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
        return View((-10.0, -10.0, 10.0, 10.0), SENSORS, measure=measure, run=run, **options), calls

    return view


def test_each_step_is_done_once_and_ready_after_its_inputs(watched):
    view, calls = watched()
    for _ in range(2):
        clouds = [
            view.part(view.cloud(s), "first", lambda points, _: np.arange(len(points)) == 0)
            for s in (0, 1)
        ]
        view.detect([view.send_points(clouds[0]).arrived])
        view.send_boxes(view.detect([view.cloud(1)]))
    assert calls.measured == [0, 1]
    assert calls.run == [[(0, ("first",))], [(1, ())]]
    assert [len(cloud.points) for cloud in clouds] == [1, 1]
    view, _ = watched()
    clouds = [view.cloud(0), view.cloud(1)]
    last = max(cloud.ms for cloud in clouds)
    boxes = view.detect(clouds)
    assert 0 < last < boxes.ms
    assert view.suppress([boxes, view.detect([clouds[0]])]).ms > boxes.ms
    assert view.suppress([]).ms >= 0
    view, _ = watched(codec=Dimmed())
    assert view.send_points(view.cloud(1)).bits == 60
    with pytest.raises(ValueError, match="points alone, no images"):
        view.captured(0)
    with pytest.raises(ValueError, match="no empty scenes"):
        view.scene(0)


def test_a_cloud_that_lost_points_on_the_way_is_another_and_else_the_same(watched):
    view, calls = watched(codec=Halved())
    sent = view.send_points(view.cloud(1))
    assert (len(sent.arrived.points), sent.bits, sent.arrived.history) == (3, 60, ("halved",))
    assert view.detect([sent.arrived]) is not view.detect([view.cloud(1)])
    assert view.send_boxes(view.detect([view.cloud(1)])).bits == 7
    assert calls.run == [[(1, ("halved",))], [(1, ())]]
    view, calls = watched()
    assert view.detect([view.send_points(view.cloud(0)).arrived]) is view.detect([view.cloud(0)])
    assert calls.run[2:] == [[(0, ())]]


def test_surer_boxes_suppress_others_of_their_label():
    boxes = np.array(
        [[0.0, 0, 1, 4, 2, 1.5, 0], [0.5, 0, 1, 4, 2, 1.5, 0], [9, 0, 1, 4, 2, 1.5, 0]]
    )
    kept = suppress(Detections(boxes, np.array([0.4, 0.6, 0.5])))
    assert kept.boxes[:, 0].tolist() == [0.5, 9]
    kept = suppress(
        Detections(boxes[[0] * 4], np.array([0.5, 0.9, 0.7, 0.6]), np.array([0, 3, 0, 2]))
    )
    assert (kept.labels.tolist(), kept.scores.tolist()) == ([3, 0, 2], [0.9, 0.7, 0.6])
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        found = Detections(boxes[[0] * 3], np.full(3, 0.5), np.array([2, 0, 3]))[order]
        assert suppress(found).labels.tolist() == [0, 2, 3]


def test_points_of_one_cell_share_a_pixel():
    behind = sample()
    cloud = behind.clouds[0]
    doubled = np.concatenate([cloud.points, 1.01 * cloud.points[:7]]).astype(np.float32)
    behind = Frame.of_clouds(
        "3", (SensorCloud("a", doubled, cloud.world_SE3_sensor),), Objects.empty()
    )
    imaged = stand_view(
        replace(behind, index=9), Seen(), Stand(AREA_IMAGED, np.zeros(2)), scenes=given()
    )
    points, captured = imaged.cloud(0).points, imaged.captured(0)
    assert len(points) == len(captured.pixels) == len(np.unique(captured.pixels))
    assert (captured.frame.time, captured.frame.index) == (0.0, 9)
    assert imaged.scene(0) is SCENES[0]
    assert imaged.sensors[0].model == MODEL
    np.testing.assert_allclose(
        captured.points(captured.sending(captured.pixels).measurement),
        points[np.argsort(captured.pixels)],
        atol=1e-4,
    )


def test_views_are_counted_from_the_middle():
    made = view(Counts())
    assert made.cloud(0).points.tolist() == [[1, 0, 1]] * 30
    assert made.cloud(1).points.tolist() == [[10, 40, 1]] * 20
    assert made.cloud(0).points.dtype == np.float32
    assert made.sensors[1].position.tolist() == [10, 0, 4]
    detector = Counts()
    assert Hybrid(radius=15.0).fuse(view(detector), [0, 1]).bits.tolist() == [256, 256 + 20 * 96]
    assert [len(points) for points in detector.seen] == [20, 30, 20]
    detector = Counts()
    # points are at x = 101 and 110, z = 11
    nothing = stand_view(far_sample(), detector, Stand(AREA_VIEWS, np.zeros(2)))
    assert SCHEMES["late"].fuse(nothing, [0, 1]).kbit_per_sensor == 0
    assert detector.seen == []


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
    part = view.part(
        view.part(cloud, "far", far), "second", lambda points, _: np.arange(len(points)) == 1
    )
    for each, rows in ((cloud, None), (part, [1])):
        sent = view.send_points(each)
        half = (each.points + frame.sensors[0].position - (shifted and [0, 0.5, 0])) / 2 + (
            shifted and [0, 0.5, 0]
        )
        np.testing.assert_allclose(sent.arrived.points, half, atol=1e-5)
        assert sent.bits == 5
        assert (each.rows is None) == (rows is None)
    assert [np.count_nonzero(image.measurement) for image in codec.sent] == [len(cloud.points), 1]
    assert part.rows.tolist() == [np.flatnonzero(far(cloud.points, None))[1]]
    assert (codec.sent[0].time, codec.sent[0].number, codec.sent[0].sensor.name) == (2.0, 9, "a")


def test_links_remember_and_transmit_once(watched):
    memory = {}
    for expected in ([1], [1, 1]):
        view = watched(memory=memory)[0]
        kept = view.remember(0, "link", list)
        kept.append(1)
        assert kept == expected
        assert view.remember(1, "link", list) == []
    assert watched()[0].remember(0, "link", list) == []
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


AREA_IMAGED = np.array([-30.0, -30, 30, 30])
MODEL = RowLidar(tuple(np.deg2rad(np.linspace(-5, -40, 20))), columns=180)
SENSORS_IMAGED = (
    Sensor("a", MODEL, pose(-8.0, 0.0, 5.0, yaw=0.3)),
    Sensor("b", MODEL, pose(8.0, 1.0, 4.0, yaw=2.0)),
)
FLOOR = 0.05  # m that the ground lies above zero, so that the crop keeps it


def empty(sensor):
    """Flat ground, to the millimetre as float32 has it."""
    down = -sensor.model.rays()[..., 2].astype(np.float64)
    return ((sensor.pose[2, 3] - FLOOR) / down).astype(np.float32)


def occupied(sensor):
    """Somebody in 5 x 8 pixels, a metre before the ground."""
    image = empty(sensor)
    image[6:11, 40:48] -= 1.0
    image[15, 100] = 0  # nothing returned
    return image


FRAME = Frame(
    SENSORS_IMAGED, tuple(occupied(sensor) for sensor in SENSORS_IMAGED), Objects.empty(), 2.5, 3
)
SCENES = tuple(EmptyScene.from_render(sensor, empty(sensor)) for sensor in SENSORS_IMAGED)


class Seen:
    """Keeps the points it is shown."""

    def __init__(self):
        self.points = []

    def __call__(self, points):
        self.points.append(points)
        return Detections(np.array([[0.0, 0, 1, 4, 2, 1.5, 0]]), np.array([0.5]))


def sample(height=0.0, order=None):
    """The clouds of the frame, in a world whose origin is `height` below."""
    clouds = []
    for sensor, image in zip(FRAME.sensors, FRAME.images, strict=True):
        xyz, valid = unproject(sensor, image)
        own = transform(invert(sensor.pose), xyz.T[valid].astype(np.float64)).astype(np.float32)
        rows = np.random.default_rng(0).permutation(len(own)) if order is None else order
        clouds.append(SensorCloud(sensor.name, own[rows], pose(z=height) @ sensor.pose))
    return Frame.of_clouds("3", tuple(clouds), Objects.empty(), time=2.5)


def given():
    return Scenes([], SCENES)


def by_place(points):
    return points[np.lexsort(points.T.round(3))]


@pytest.mark.parametrize("name", ["foreground", "early", "late"])
def test_schemes_send_and_detect_as_on_a_frame_of_images(name):
    scheme, codec, ours, theirs = SCHEMES[name], RangeImages(), Seen(), Seen()
    view = stand_view(
        sample(), ours, Stand(AREA_IMAGED, np.zeros(2), None), codec=codec, scenes=given()
    )
    of_frame = frame_view(
        FRAME, theirs, AREA_IMAGED, height=4.0, codec=codec, scene=lambda k: SCENES[k]
    )
    mine, theirs_fused = scheme.fuse(view, [0, 1]), scheme.fuse(of_frame, [0, 1])
    np.testing.assert_allclose(
        mine.bits, theirs_fused.bits, atol=16 if name in ("early", "foreground") else 400
    )
    assert len(ours.points) == len(theirs.points)
    for own, other in zip(ours.points, theirs.points, strict=True):
        assert own.dtype == np.float32
        np.testing.assert_allclose(by_place(own), by_place(other), atol=0.025)


def test_foreground_is_a_fraction_of_the_image_above_level_ground():
    seen = Seen()
    view = stand_view(sample(), seen, Stand(AREA_IMAGED, np.zeros(2), None), scenes=given())
    fused = Foreground().fuse(view, [0, 1])
    whole = SCHEMES["early"].fuse(
        stand_view(
            sample(),
            Seen(),
            Stand(AREA_IMAGED, np.zeros(2), None),
            codec=RangeImages(),
            scenes=given(),
        ),
        [0, 1],
    )
    assert (fused.bits < whole.bits / 2).all()
    pixels = sum(int((view.captured(k).measurement > 0).sum()) for k in (0, 1))
    inside = sum(len(view.cloud(k).points) for k in (0, 1))
    assert inside <= pixels
    assert len(seen.points[0]) >= inside
    ground, seen = Ground(np.array([0.0, 0.0, 100.0])), Seen()
    view = stand_view(
        sample(height=100.0), seen, Stand(AREA_IMAGED, np.zeros(2), ground), scenes=given()
    )
    Foreground().fuse(view, [0, 1])
    upright = Seen()
    Foreground().fuse(
        stand_view(sample(), upright, Stand(AREA_IMAGED, np.zeros(2), None), scenes=given()), [0, 1]
    )
    assert len(seen.points[0]) == pytest.approx(len(upright.points[0]), abs=3)
    heights = seen.points[0][:, 2]
    assert np.median(heights) == pytest.approx(FLOOR, abs=0.005)
    assert heights.max() < 4


AREA_VIEWS = np.array([-50.0, -50, 50, 50])


class Counts:
    def __init__(self):
        self.seen = []

    def __call__(self, points):
        self.seen.append(points)
        return Detections(
            np.array([[*points.mean(axis=0), 4, 2, 1.5, 0.0]]), np.array([len(points) / 100])
        )


def far_sample():
    """Two sensors in a world whose ground lies 10 m up; 30 points beside the first, 20 points 40 m
    from both."""
    near, far = np.tile([1.0, 0, -3.0], (30, 1)), np.tile([0.0, 40, -3.0], (20, 1))
    clouds = (
        SensorCloud("a", near.astype(np.float32), pose(100.0, 0.0, 14.0)),
        SensorCloud("b", far.astype(np.float32), pose(110.0, 0.0, 14.0)),
    )
    return Frame.of_clouds("0", clouds, Objects.empty())


def view(detector):
    return stand_view(
        far_sample(),
        detector,
        Stand(AREA_VIEWS, np.array([100.0, 0]), Ground(np.array([0.0, 0, 10.0]))),
    )


@pytest.mark.parametrize(("scheme", "kbit"), [("early", 96 * 25 / 1000), ("late", 0.256)])
def test_fusion_as_on_simulated_frames(scheme, kbit):
    detector = Counts()
    fused = SCHEMES[scheme].fuse(view(detector), [0, 1])
    assert fused.kbit_per_sensor == pytest.approx(kbit)
    assert [len(points) for points in detector.seen] == ([50] if scheme == "early" else [30, 20])
    assert len(fused.detections) == (1 if scheme == "early" else 2)
