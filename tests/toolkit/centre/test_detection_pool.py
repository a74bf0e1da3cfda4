"""Threads that detect: in the newest frame, and taken in the order of time."""

import itertools
from threading import Event, Semaphore, get_ident

import numpy as np
import pytest

from toolkit.calibration.place import Place
from toolkit.centre.detection_pool import Detection, DetectionPool
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Detections, Objects

TIMEOUT_S = 30.0


class Gate:
    """Detector whose calls wait until they are let through."""

    def __init__(self):
        self.threads = []
        self.begun = Semaphore(0)
        self._may_end = Semaphore(0)

    def __call__(self, points):
        self.threads.append(get_ident())
        self.begun.release()
        assert self._may_end.acquire(timeout=TIMEOUT_S)
        return Detections.empty()

    def open(self, count=1):
        self._may_end.release(count)


def make_frame(k):
    cloud = SensorCloud("north", np.ones((3, 3), np.float32), np.eye(4))
    return Frame.of_clouds(f"{k}", [cloud], Objects.empty(), time=float(k))


def take_all(pool, woken):
    """Times of the frames whose detections are taken, until none is expected."""
    times = []
    while pool.is_expected(np.inf):
        assert woken.wait(TIMEOUT_S)
        woken.clear()
        times += [result.frame.time for result in pool.take(np.inf)]
    return times


@pytest.fixture
def open_pool():
    """Opens a pool, and its event that a thread is done."""
    pools = []

    def open_pool(detector, **detection):
        woken = Event()
        place = Place("none", area=(-20.0, -20.0, 20.0, 20.0))
        pools.append(DetectionPool(Detection(detector, place, **detection), woken.set))
        return pools[-1], woken

    yield open_pool
    for pool in pools:
        pool.close()


def test_another_thread_detects_and_wakes(open_pool):
    gate = Gate()
    pool, woken = open_pool(gate)
    pool.add(make_frame(0))
    assert pool.take(np.inf) == []
    assert pool.is_expected(0.0)
    assert not pool.is_expected(-1.0)
    assert not woken.is_set()
    gate.open()
    assert woken.wait(TIMEOUT_S)
    (result,) = pool.take(np.inf)
    assert result.frame.time == 0.0
    assert not pool.is_expected(np.inf)
    assert get_ident() not in gate.threads


def test_a_newer_frame_takes_the_place_of_one_that_waits(open_pool):
    gate = Gate()
    pool, woken = open_pool(gate)
    for k in range(4):
        pool.add(make_frame(k))
    gate.open(2)
    assert take_all(pool, woken) == [0.0, 3.0]


def test_a_newer_detection_waits_for_an_older_one(open_pool):
    begun = Semaphore(0)
    numbers = itertools.count()

    def detect(points):
        begun.release()
        if next(numbers) == 0:
            assert begun.acquire(timeout=TIMEOUT_S)
            assert begun.acquire(timeout=TIMEOUT_S)
            assert may_end.wait(TIMEOUT_S)
        return Detections.empty()

    may_end = Event()
    pool, woken = open_pool(detect, parallel=2)
    pool.add(make_frame(0))
    pool.add(make_frame(1))
    assert woken.wait(TIMEOUT_S)
    assert pool.take(np.inf) == []
    may_end.set()
    assert take_all(pool, woken) == [0.0, 1.0]


def test_detections_are_taken_up_to_a_time(open_pool):
    pool, woken = open_pool(lambda points: Detections.empty(), parallel=2)
    pool.add(make_frame(0))
    assert woken.wait(TIMEOUT_S)
    assert pool.take(-1.0) == []
    assert len(pool.take(0.0)) == 1


def test_the_error_of_a_detector_is_raised_where_it_is_taken(open_pool):
    def fail(points):
        raise ValueError("no network")

    pool, woken = open_pool(fail)
    pool.add(make_frame(0))
    assert woken.wait(TIMEOUT_S)
    with pytest.raises(ValueError, match="no network"):
        pool.take(np.inf)
