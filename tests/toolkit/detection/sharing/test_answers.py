"""Requests to a sensor and what it answers."""

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene, SceneLearner
from toolkit.detection.link.foreground import decode_foreground
from toolkit.detection.sharing.answers import LEAST_ANSWER, answered, requested, restored, unanswered, whole_foreground
from toolkit.detection.sharing.requests import Request, decode_request, encode_request
from toolkit.detection.sharing.wants import Wants
from toolkit.detection.view import Captured
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

AREA = (-40.0, -40.0, 40.0, 40.0)
SENSOR = Sensor("s", DepthCamera(width=80, height=60, stride=1), look((0.0, 0.0, 2.0), 0.0, 0.0))


@pytest.fixture(scope="module")
def seen() -> tuple[Captured, EmptyScene]:
    """A wall 30 m ahead, someone on the left at 10 m, someone on the right at 20 m."""
    wall = np.full(SENSOR.model.shape, 30.0, np.float32)
    rng, learner = np.random.default_rng(0), SceneLearner(SENSOR)
    for _ in range(40):
        learner.add(SENSOR.model.noisy(wall, rng))
    image = SENSOR.model.noisy(wall, rng)
    rough = np.random.default_rng(1).normal(0, 0.1, (10, 12))
    image[25:35, 10:22] = 10.0 + rough
    image[28:34, 60:64] = 20.0 + rough[:6, :4]
    return Captured(Frame((SENSOR,), (image,), Objects.empty(), 2.5, 3), 0, AREA), learner.scene()


LEFT, RIGHT = (10.0, 6.0, 2.0), (20.0, -11.0, 2.0)  # as seen: x ahead, y left


def ask(grant, *places):
    rows = np.array(places).reshape(-1, 3)
    return encode_request(Request(grant, rows, np.ones(len(rows))), "s")


def sent(answer, scene):
    mask = decode_foreground(answer, scene).sent
    return int(mask[:, :40].sum()), int(mask[:, 40:].sum())


def test_the_whole_in_the_finest_step_that_fits(seen):
    fine = whole_foreground(seen[0], seen[1], 1 << 30)
    assert decode_foreground(fine, seen[1]).header.step == 0.02
    assert sent(fine, seen[1]) == (120, 24)
    coarser = whole_foreground(seen[0], seen[1], 8 * len(fine) - 1)
    assert decode_foreground(coarser, seen[1]).header.step == 0.04
    coarsest = whole_foreground(seen[0], seen[1], 8 * len(coarser) - 1)
    assert decode_foreground(coarsest, seen[1]).header.step == 0.08
    assert whole_foreground(seen[0], seen[1], 8 * len(coarsest)) == coarsest
    assert whole_foreground(seen[0], seen[1], 8 * len(coarsest) - 1) is None


def test_the_answer_is_what_was_asked_for_and_never_more_than_granted(seen):
    whole = 8 * len(whole_foreground(seen[0], seen[1], 1 << 30))
    assert sent(answered(seen[0], seen[1], ask(whole, RIGHT), Detections.empty()), seen[1]) == (120, 24)
    sides = set()
    for grant in range(340, whole, 40):
        for place in (LEFT, RIGHT):
            answer = answered(seen[0], seen[1], ask(grant, place), Detections.empty())
            if answer is None:
                continue
            assert 8 * len(answer) <= grant
            assert decode_foreground(answer, seen[1]).header.number == 3
            sides.add((place, sent(answer, seen[1])))
    assert (RIGHT, (0, 24)) in sides
    assert (LEFT, (120, 0)) in sides
    assert answered(seen[0], seen[1], ask(300, LEFT), Detections.empty()) is None


def test_what_no_box_explains_goes_before_what_one_does(seen):
    near = Detections(np.array([[10.0, 6.0, 2.0, 4.0, 8.0, 6.0, 0.0]]), np.array([0.9]))
    whole = 8 * len(whole_foreground(seen[0], seen[1], 1 << 30))
    assert sent(answered(seen[0], seen[1], ask(whole // 2), near), seen[1]) == (0, 24)


def wants(bits):
    n = len(bits)
    places = np.column_stack([np.arange(n) * 5.0, np.zeros(n), np.ones(n)])
    return Wants(
        places, np.full(n, 0.5), np.array([bits, bits], float), np.array([[True] * n, [False] + [True] * (n - 1)])
    )


def test_a_request_and_its_grant_are_what_is_left_together(seen):
    request = requested(wants([100.0] * 6), 0, 2400, seen[0])
    got = decode_request(request, "s")
    assert got.grant + 8 * len(request) == 2400
    assert got.places[:, 0].tolist() == [0, 5, 10, 15, 20, 25]
    assert decode_request(requested(wants([100.0] * 6), 1, 2400, seen[0]), "s").places[:, 0].tolist() == [
        5,
        10,
        15,
        20,
        25,
    ]


def test_a_request_holds_what_an_answer_can(seen):
    got = decode_request(requested(wants([1500.0] * 6), 0, 2000, seen[0]), "s")
    assert got.places[:, 0].tolist() == [0, 5]  # up to twice of what is left
    small = requested(wants([1.0] * 60), 0, 1800, seen[0])
    assert 8 * len(small) <= 450
    assert requested(wants([1.0]), 0, LEAST_ANSWER + 8 * 50, seen[0]) is not None
    assert requested(wants([1.0]), 0, LEAST_ANSWER + 8 * 50 - 1, seen[0]) is None


def test_points_stand_for_the_boxes_they_lie_in(seen):
    measured = restored(seen[0], seen[1], answered(seen[0], seen[1], ask(100000), Detections.empty()))[1]
    assert len(measured) == 144
    assert len(restored(seen[0], seen[1], None)[1]) == 0
    assert len(restored(seen[0], seen[1], None)[0]) == 400
    boxes = np.array([[10.0, 6.0, 2.0, 4.0, 8.0, 6.0, 0.0], [-10.0, 6.0, 2.0, 4.0, 8.0, 6.0, 0.0]])
    own = Detections(boxes, np.array([0.9, 0.8]))
    assert unanswered(own, measured).scores.tolist() == [0.8]
    assert unanswered(own, measured[:0]).scores.tolist() == [0.9, 0.8]
