"""Recordings in which one car waits for hundreds of frames."""

from dataclasses import dataclass

import numpy as np
import pytest

from placement_env.fidelity.detector import Detected
from placement_env.fidelity.table import best_sets, make_table
from placement_env.fidelity.way_frames import WayFrame, draw_way_frames, is_continuous
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SITE = Site("street", np.array([-40.0, -20.0, 40.0, 20.0]))
CAR = np.array([0.0, 0, 0.75, 4, 2, 1.5, 0])
QUEUED = 7
PASSING = (11, 12, 13, 14, 15)


def place(x, y):
    box = CAR.copy()
    box[:2] = x, y
    return box


def street():
    """300 frames: a car waits at y = 10 throughout, five drive past at y = -10 for 20 frames each,
    and one is outside."""
    frames = []
    for k in range(300):
        boxes, ids = [place(0, 10), place(60, 0)], [QUEUED, 99]
        number = k // 50
        if number < len(PASSING) and k % 50 < 20:
            boxes.append(place(4.0 * (k % 50) - 38, -10))
            ids.append(PASSING[number])
        frames.append(Objects(np.array(boxes), ids=np.array(ids)))
    return frames


def test_frames_below_a_second_apart_are_continuous():
    assert is_continuous(np.arange(5) * 0.1)
    assert is_continuous(np.array([0, 0.5, 1.0, 500, 500.5, 501]))
    assert not is_continuous(np.arange(5) * 5.0)
    assert not is_continuous(np.arange(5) * 1.0)
    assert not is_continuous(np.array([0.0]))
    assert not is_continuous(None)


def test_each_road_user_counts_once_in_a_frame_of_its_way():
    objects = street()
    ways = draw_way_frames(objects, SITE, [0])
    assert sorted(number for way in ways for number in way.ids) == [QUEUED, *PASSING]
    assert [way.number for way in ways] == sorted({way.number for way in ways})
    for way in ways:
        assert set(way.ids) <= set(objects[way.number].ids.tolist())
    assert draw_way_frames(objects, SITE, [0]) == ways
    assert draw_way_frames(objects, SITE, [2]) == ()
    # every frame of a way is as likely
    drawn = [draw_way_frames(objects, SITE, [0], seed) for seed in range(300)]
    indices = [way.number for ways in drawn for way in ways if PASSING[1] in way.ids]
    assert set(indices) == set(range(50, 70))


@dataclass
class Recorded:
    """Sensor 0 sees the car that waits, sensor 1 those that pass, exactly and nothing else."""

    ways: tuple[WayFrame, ...] | None
    site = SITE
    sensors = tuple(Sensor(f"s{c}", DepthCamera(), np.eye(4)) for c in range(2))
    digest = "queue"

    def __post_init__(self):
        self.all = street()
        self.frames = len(self.all) if self.ways is None else len(self.ways)

    def objects(self, k):
        return self.all[k if self.ways is None else self.ways[k].number]

    def counted(self, k):
        objects = self.objects(k)
        if self.ways is None:
            return np.ones(len(objects), bool)
        return np.isin(objects.ids, self.ways[k].ids)

    def clouds(self, k, c):
        boxes = self.objects(k).boxes
        is_seen = boxes[:, 1] > 5 if c == 0 else boxes[:, 1] < -5
        return boxes[is_seen, :3].astype(np.float32)


class Reader:
    digest = "reader"

    def __call__(self, points):
        boxes = np.array([place(x, y) for x, y, _ in points]).reshape(-1, 7)
        return Detections(boxes, np.ones(len(points)))


def test_a_queue_does_not_decide_which_set_is_best(tmp_path):
    """300 of 400 boxes are one car in a queue; of six road users, five drive past."""
    naive = make_table(Recorded(None), Reader(), tmp_path / "naive.npz")
    (best, other) = best_sets(naive)[1]
    assert (best.sensors, other.sensors) == ((0,), (1,))
    assert [best.ap, other.ap] == pytest.approx([300 / 400, 100 / 400])
    ways = draw_way_frames(street(), SITE, [0])
    table = make_table(Recorded(ways), Reader(), tmp_path / "table.npz")
    (best, other) = best_sets(table)[1]
    assert (best.sensors, other.sensors) == ((1,), (0,))
    assert [best.ap, other.ap] == pytest.approx([5 / 6, 1 / 6])
    assert table.origin.objects == 6
    assert table.origin.frames == len(ways)


def test_detections_of_those_that_do_not_count_are_no_false_alarms():
    ways = draw_way_frames(street(), SITE, [0])
    detected = Detected(Recorded(ways), Reader(), "early")
    both = np.array([[True, True]])
    estimate = detected(both)
    assert (estimate.ap[0], estimate.recall[0]) == (1.0, 1.0)
