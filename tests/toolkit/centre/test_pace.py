"""How often a centre detects follows from the time that detection takes."""

import itertools
from threading import Semaphore

import numpy as np
import pytest

from toolkit.centre.pace import WORK_FRAMES, PaceKeeper
from toolkit.objects import Detections

FRAMES = 120


def keep(pace, works_s):
    """Events of a row of frames, and the frames in which detection was due."""
    events = []
    due = []
    works = iter(works_s)
    for k in range(len(works_s)):
        if pace.is_due():
            due.append(k)
            events.append(pace.add_work(next(works), 0.1 * k))
    return [event for event in events if event], due


def test_detection_that_fits_takes_place_in_every_frame():
    events, due = keep(PaceKeeper(0.1), [0.08] * FRAMES)
    assert events == []
    assert due == list(range(FRAMES))


@pytest.mark.parametrize(("work_s", "every"), [(0.1, 2), (0.17, 2), (0.2, 3), (0.5, 6)])
def test_slow_detection_takes_place_less_often(work_s, every):
    pace = PaceKeeper(0.1)
    (event,), due = keep(pace, [work_s] * FRAMES)
    assert pace.detect_every == every
    assert (event.detect_every, event.needed_every) == (every, every)
    assert due[WORK_FRAMES:] == list(range(WORK_FRAMES, FRAMES, every))
    assert f"one frame in {every} is detected, tracks are predicted between" in str(event)
    assert event.as_dict()["work_ms"] == pytest.approx(1e3 * work_s)


def test_it_takes_place_more_often_again_once_there_is_time_to_spare():
    pace = PaceKeeper(0.1)
    keep(pace, [0.15] * FRAMES)
    assert pace.detect_every == 2
    keep(pace, [0.085] * FRAMES)  # fits, but with little to spare
    assert pace.detect_every == 2
    (event,), _ = keep(pace, [0.05] * FRAMES)
    assert pace.detect_every == 1
    assert str(event).endswith("every frame is detected again")


def test_a_few_slow_frames_change_nothing():
    works_s = [0.3 if k % 4 == 0 else 0.06 for k in range(FRAMES)]
    assert keep(PaceKeeper(0.1), works_s)[0] == []


def test_a_fixed_rate_stays_and_is_reported_once_if_it_cannot_be_kept():
    pace = PaceKeeper(0.1, detect_every=1)
    (event,), due = keep(pace, [0.13] * FRAMES)
    assert due == list(range(FRAMES))
    assert "a frame takes 130 ms, and the next comes after 100 ms" in str(event)
    assert "set detect_every = 2 in the configuration" in str(event)


def test_tracks_of_other_frames_are_predicted(scripted, message, car):
    messages = [message(name, k) for k in range(12) for name in "abc"]
    run = scripted(messages, lambda points: Detections(car, np.array([0.9])), detect_every=3)
    detected = [frame.detections is not None for frame in run.frames]
    assert detected == [True, False, False] * 4
    assert run.centre.predicted_frames == 8
    assert run.written == [frame.frame.time for frame in run.frames]
    assert {tuple(frame.tracks.ids.tolist()) for frame in run.frames} == {(0,)}
    assert list(run.frames[1].stage_ms) == ["wait", "fuse", "track", "write"]


def test_a_slow_centre_predicts_instead_of_dropping(scripted, message, manual_clock, car):
    clock = manual_clock()

    def detect_slowly(points):
        clock.time_s += 0.15
        return Detections(car, np.array([0.9]))

    messages = [message(name, k) for k in range(FRAMES) for name in "abc"]
    run = scripted(messages, detect_slowly, clock)
    later = run.frames[-30:]
    assert run.pace_events[0].detect_every == 2
    assert [frame.detections is not None for frame in later].count(True) == 15
    assert max(frame.latency_ms for frame in later) < 151.0
    times = [frame.frame.time for frame in later]
    assert times == pytest.approx([0.1 * k for k in range(FRAMES - 30, FRAMES)])


def test_parallel_detections_share_the_time():
    assert keep(PaceKeeper(0.1, parallel=2), [0.17] * FRAMES)[0] == []
    (event,), _ = keep(PaceKeeper(0.1, parallel=2), [0.2] * FRAMES)
    assert event.detect_every == 2


def test_parallel_detections_come_out_in_order(scripted, message, car):
    """The first detection ends after the second one has begun."""
    begun = Semaphore(0)
    numbers = itertools.count()

    def detect(points):
        begun.release()
        if next(numbers) == 0:
            assert begun.acquire(timeout=30.0)
            assert begun.acquire(timeout=30.0)
        return Detections(car, np.array([0.9]))

    run = scripted([message(name, k) for k in range(4) for name in "abc"], detect, parallel=2)
    assert [frame.frame.index for frame in run.frames] == [0, 1, 2, 3]
    assert [frame.tracks.ids.tolist() for frame in run.frames] == [[0]] * 4
    assert run.centre.dropped_frames == 0
