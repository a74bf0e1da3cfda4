"""A centre says when detection takes longer than there is time for it."""

import numpy as np
import pytest

from toolkit.centre.pace import WORK_FRAMES, PaceWatch
from toolkit.objects import Detections

FRAMES = 60


def watch_works(pace, works_ms):
    """Events of a row of detections."""
    events = [pace.add_work(work_ms, 0.1 * k) for k, work_ms in enumerate(works_ms)]
    return [event for event in events if event]


def test_detection_that_fits_is_not_reported():
    assert watch_works(PaceWatch(100.0), [99.0] * FRAMES) == []
    assert watch_works(PaceWatch(100.0, parallel=2), [199.0] * FRAMES) == []


@pytest.mark.parametrize("parallel", [1, 2])
def test_slow_detection_is_reported_once(parallel):
    (event,) = watch_works(PaceWatch(100.0, parallel), [parallel * 131.0] * FRAMES)
    assert event.time_s == pytest.approx(0.1 * (WORK_FRAMES - 1))
    assert event.as_dict() == {"time_s": 1.9, "is_slow": True, "work_ms": 131.0, "due_ms": 100.0}
    assert str(event) == (
        "1.90 s: detection takes 131 ms a frame and is due every 100 ms: some frames are not "
        "detected, their tracks are predicted"
    )


def test_its_end_is_reported_once_there_is_time_to_spare():
    pace = PaceWatch(100.0)
    assert len(watch_works(pace, [131.0] * FRAMES)) == 1
    assert watch_works(pace, [95.0] * FRAMES) == []
    (event,) = watch_works(pace, [80.0] * FRAMES)
    assert not event.is_slow
    assert str(event).endswith("no frame is left out any more")


def test_a_few_slow_frames_change_nothing():
    assert watch_works(PaceWatch(100.0), [300.0 if k % 4 == 0 else 60.0 for k in range(60)]) == []


def test_a_slow_centre_reports_it(scripted, message):
    messages = [message(name, k) for k in range(FRAMES) for name in "abc"]
    assert scripted(messages, detect_s=0.08).pace_events == []
    (event,) = scripted(messages, detect_s=0.13).pace_events
    assert (event.is_slow, event.work_ms, event.due_ms) == (True, pytest.approx(130), 100)
    assert scripted(messages, detect_s=0.13, detect_every=2).pace_events == []


def test_tracks_of_other_frames_are_predicted(scripted, message, car):
    messages = [message(name, k) for k in range(12) for name in "abc"]
    run = scripted(messages, lambda points: Detections(car, np.array([0.9])), detect_every=3)
    detected = [frame.detections is not None for frame in run.frames]
    assert detected == [True, False, False] * 4
    assert run.centre.predicted_frames == 8
    assert run.centre.late_detections == 0
    assert run.written == [frame.frame.time for frame in run.frames]
    assert {tuple(frame.tracks.ids.tolist()) for frame in run.frames} == {(0,)}
    assert list(run.frames[1].stage_ms) == ["wait", "fuse", "hold", "track", "write"]
    ages_s = [frame.detection_age_s for frame in run.frames[:4]]
    assert ages_s == pytest.approx([0.0, 0.1, 0.2, 0.0])
