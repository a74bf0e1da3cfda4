"""Adaptive sharing: never above its budget, late fusion with little, foreground fusion with enough."""

import numpy as np
import pytest

from toolkit.calibration.empty_scene import SceneLearner
from toolkit.detection.late import Late
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.scheme import Scheme
from toolkit.detection.sharing.adaptive import Adaptive
from toolkit.detection.view import frame_view
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

AREA = (0.0, -40.0, 29.0, 40.0)
MODEL = DepthCamera(width=80, height=60, stride=1)
SENSORS = tuple(Sensor(name, MODEL, look((0.0, y, 2.0), 0.0, 0.0)) for name, y in (("a", 0.0), ("b", 1.0), ("c", -1.0)))
WALL = np.full(MODEL.shape, 30.0, np.float32)


class Seen:
    """Counts of points of one candidate in one frame."""

    sent = on_objects = far = np.ones((1, 1), np.float32)


def scene_of(sensor):
    rng, learner = np.random.default_rng(0), SceneLearner(sensor)
    for _ in range(40):
        learner.add(MODEL.noisy(WALL, rng))
    return learner.scene()


@pytest.fixture(scope="module")
def scenes():
    return [scene_of(sensor) for sensor in SENSORS]


def frame(busy=True):
    """Six bodies before each sensor, rough, so that they take bits."""
    images = []
    for k in range(3):
        rng = np.random.default_rng(k + 1)
        image = MODEL.noisy(WALL, rng)
        for body in range(6 * busy):
            image[20:32, 4 + 12 * body : 12 + 12 * body] = 12.0 + 2 * body + rng.normal(0, 0.1, (12, 8))
        images.append(image)
    return Frame(SENSORS, tuple(images), Objects.empty(), 1.0, 4)


def detector(points):
    """A box about the points of every 2 m ahead, the surer the more there are."""
    slots = np.unique(np.rint(points[:, 0] / 2).astype(int))
    groups = [points[np.rint(points[:, 0] / 2).astype(int) == slot] for slot in slots]
    boxes = [[*((p.min(0) + p.max(0)) / 2), *(np.ptp(p, axis=0) + 0.1), 0.0] for p in groups]
    return Detections(np.array(boxes).reshape(-1, 7), np.array([len(p) / (len(p) + 100) for p in groups]))


def view(scenes, seen=None):
    return frame_view(frame() if seen is None else seen, detector, AREA, codec=RangeImages(), scene=lambda k: scenes[k])


@pytest.mark.parametrize("whole_link", [False, True])
def test_no_budget_is_ever_exceeded(scenes, whole_link):
    one, spent = view(scenes), []
    for budget in range(0, 9000, 450):
        got = Adaptive(budget, whole_link).fuse(one, [0, 1, 2])
        assert (got.bits.sum() if whole_link else got.bits.max()) <= budget
        assert (got.bits % 8 == 0).all()
        spent.append(int(got.bits.sum()))
    assert spent[0] == 0
    assert len(set(spent)) > 5


def test_with_enough_it_is_foreground_fusion_bit_for_bit(scenes):
    one = view(scenes)
    got, all_of_it = Adaptive(1 << 20).fuse(one, [0, 1, 2]), Foreground().fuse(one, [0, 1, 2])
    assert got.bits.tolist() == all_of_it.bits.tolist()
    np.testing.assert_array_equal(got.detections.boxes, all_of_it.detections.boxes)
    np.testing.assert_array_equal(got.detections.scores, all_of_it.detections.scores)
    assert got.ms > 0


def test_with_little_it_is_late_fusion(scenes):
    one = view(scenes)
    late = Late().fuse(one, [0, 1, 2])
    got = Adaptive(int(late.bits.max())).fuse(one, [0, 1, 2])
    assert got.bits.tolist() == late.bits.tolist()
    np.testing.assert_array_equal(got.detections.boxes, late.detections.boxes)
    fewer = Adaptive(int(late.bits.max()) - 8).fuse(one, [0, 1, 2])
    assert 0 < fewer.bits.min() <= fewer.bits.max() < late.bits.max()
    assert fewer.detections.scores.max() == late.detections.scores.max()  # the surest stay


def test_in_between_points_come_to_the_boxes(scenes):
    one = view(scenes)
    late, everything = Late().fuse(one, [0, 1, 2]).bits, Foreground(0.08).fuse(one, [0, 1, 2]).bits
    got = Adaptive(int(late.max() + everything.min()) // 2 + 400).fuse(one, [0, 1, 2])
    assert (got.bits > late).any()
    assert got.bits.sum() < everything.sum()
    assert len(got.detections) > 0


def test_a_sensor_that_has_all_through_leaves_a_link_to_the_others(scenes):
    """One with nothing before it takes 43 bytes; what it leaves of the link goes to the others."""
    busy, idle = frame(), frame(busy=False)
    seen = Frame(SENSORS, (idle.measurements[0], *busy.measurements[1:]), Objects.empty(), 1.0, 4)
    own, shared = (Adaptive(n, whole).fuse(view(scenes, seen), [0, 1, 2]) for n, whole in ((1800, False), (5400, True)))
    assert own.bits[0] == shared.bits[0] < 800
    assert own.bits.max() <= 1800 < shared.bits.max()
    assert shared.bits.sum() <= 5400


def test_one_sensor_and_none(scenes):
    one = view(scenes)
    assert Adaptive(2000).fuse(one, [1]).bits.max() <= 2000
    nothing = Adaptive(2000, whole_link=True).fuse(one, [])
    assert (len(nothing.detections), len(nothing.bits)) == (0, 0)


def test_it_is_a_scheme_and_checks_its_parameters():
    assert isinstance(Adaptive(), Scheme)
    assert Adaptive().digest == "Adaptive(budget_bits=3000, whole_link=False, sigmas=4.0, name='adaptive')"
    for wrong in (-1, True, 1 << 32):
        with pytest.raises(ValueError, match="budget_bits must be a whole number"):
            Adaptive(wrong)
    with pytest.raises(ValueError, match="sigmas must be above 0"):
        Adaptive(sigmas=0.0)
    with pytest.raises(ValueError, match="say --fidelity detector"):
        Adaptive().sent_points(Seen())


def test_without_a_scene_it_says_so():
    with pytest.raises(ValueError, match="knows no empty scenes"):
        Adaptive().fuse(frame_view(frame(), detector, AREA), [0])
