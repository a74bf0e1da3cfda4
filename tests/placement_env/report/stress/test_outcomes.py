"""Detections of frames counted together."""

import numpy as np
import pytest

from placement_env.report.stress.conditions import Condition
from placement_env.report.stress.outcomes import Run
from placement_env.report.stress.systems import systems_of
from toolkit.detection.early import Early
from toolkit.frame import Frame
from toolkit.objects import Detections, Objects
from toolkit.sites.site import Site

SITE = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
TRUTH = np.array([[0.0, 0, 1, 4, 2, 2, 0], [10, 0, 1, 4, 2, 2, 0], [30, 0, 1, 4, 2, 2, 0]])


def run(ious=(0.7,)):
    return Run(systems_of([Early()], "pose")[0], "vehicle", ious)


def frame(time=0.0):
    return Frame((), (), Objects(TRUTH, np.zeros(3, int), np.arange(3)), time, 0)


def test_figures_of_all_frames_at_each_iou():
    counted = run((0.5, 0.9))
    shifted = TRUTH[:2] + np.array([0.4, 0, 0, 0, 0, 0, 0])  # IoU 0.82
    for boxes, scores in ((shifted, [0.9, 0.8]), (TRUTH[:1], [0.7])):
        counted.add(frame(), SITE, Detections(boxes, np.array(scores)), 2.0 * len(boxes), 0.1 * len(boxes))
    loose, strict = counted.rows(Condition("pose", "some", amount=0.2), 0)
    assert (loose.iou, strict.iou, loose.kind, loose.level, loose.amount) == (0.5, 0.9, "pose", "some", 0.2)
    assert (loose.judged.ap, loose.judged.recall, loose.judged.precision) == (0.75, 0.75, 1)
    assert strict.judged.ap == pytest.approx(1 / 12)  # the third best of three is true, of four to find
    assert (loose.judged.vehicles, loose.judged.frames) == (4, 2)  # what stands outside the area does not count
    assert (loose.kbit_per_sensor, loose.age) == (3, pytest.approx(0.15))
    assert (loose.judged.low, loose.judged.high) == loose.tally.interval(seed=0)
    assert loose.tally.truths.tolist() == [2, 2]
    assert "tally" not in loose.as_dict()
    assert loose.as_dict()["judged"]["ap"] == 0.75


def test_tracks_begin_anew_with_traffic_and_an_unknown_age_changes_nothing():
    counted, here = run(), Detections(TRUTH[:1], np.array([0.9]))
    for k in range(10):
        moved = Detections(TRUTH[:1] + np.array([1.0 * k, 0, 0, 0, 0, 0, 0]), np.array([0.9]))
        last = counted.tracked(moved, 0.1 * k + 0.2, 0.2, begins=k == 0)
    assert last.boxes[0, 0] == pytest.approx(9 + 2, abs=0.3)
    assert counted.tracked(here, 1.2, np.nan, begins=False) is here
    assert counted.tracked(here, 0.2, 0.2, begins=True).boxes[0, 0] == 0
