"""Frames come out at their deadline, and detections that come later update what follows."""

from itertools import pairwise

import numpy as np
import pytest

from toolkit.objects import Detections

FRAMES = 40
DEADLINE_MS = 90.0


def street(message, frames=FRAMES):
    return [message(name, k) for k in range(frames) for name in "abc"]


def list_times(frames):
    return [frame.frame.time for frame in frames]


class MovingCar:
    """Detector that sees a car drive 1 m a frame, and counts the frames.

    fails_at: number of the frame in which it raises an error."""

    def __init__(self, car, fails_at=None):
        self.frames = 0
        self._car = car
        self._fails_at = fails_at

    def __call__(self, points):
        if self.frames == self._fails_at:
            raise ZeroDivisionError("detector is broken")
        box = self._car + np.array([self.frames - 10.0, 0, 0, 0, 0, 0, 0])
        self.frames += 1
        return Detections(box, np.array([0.9]))


def test_a_detection_before_the_deadline_is_waited_for(scripted, message, car):
    run = scripted(street(message), MovingCar(car), detect_s=0.08)
    assert [frame.latency_ms for frame in run.frames] == pytest.approx([80.0] * FRAMES)
    assert all(frame.detections is not None for frame in run.frames)
    assert {frame.detection_age_s for frame in run.frames} == {0.0}
    assert run.centre.late_detections == run.centre.predicted_frames == 0


@pytest.mark.parametrize("detect_s", [0.095, 0.15, 0.25, 1.0])
def test_every_frame_is_out_at_its_deadline(scripted, message, car, detect_s):
    run = scripted(street(message), MovingCar(car), detect_s=detect_s)
    assert list_times(run.frames) == pytest.approx([0.1 * k for k in range(FRAMES)])
    assert max(frame.latency_ms for frame in run.frames) == pytest.approx(DEADLINE_MS)
    predicted = [frame for frame in run.frames if frame.detections is None]
    assert len(predicted) == run.centre.predicted_frames > FRAMES / 2
    assert run.centre.dropped_frames == 0


def test_a_late_detection_is_in_the_next_frame(scripted, message, car):
    run = scripted(street(message), MovingCar(car), detect_s=0.095)
    assert run.frames[0].detection_age_s is None
    assert len(run.frames[0].tracks) == 0
    for before, frame in pairwise(run.frames):
        (late,) = frame.late_detections
        assert late.frame is before.frame
        assert frame.detection_age_s == pytest.approx(0.1)
    # the car's tracks are those of detections in every frame, a frame on
    x = [frame.tracks.boxes[0, 0] for frame in run.frames[10:]]
    assert x == pytest.approx([3.0 - 10.0 + k for k in range(10, FRAMES)], abs=0.05)
    assert {tuple(frame.tracks.ids.tolist()) for frame in run.frames[1:]} == {(0,)}
    assert run.centre.late_detections == FRAMES


@pytest.mark.parametrize("detect_s", [0.03, 0.095, 0.13, 0.25, [0.05, 0.3, 0.05, 0.12]])
@pytest.mark.parametrize("parallel", [1, 2])
@pytest.mark.parametrize("tail_s", [0.0, 1.0])
def test_no_detection_is_lost(scripted, message, car, detect_s, parallel, tail_s):
    """Not at the end of the run either, when detections are still in work."""
    detector = MovingCar(car)
    run = scripted(street(message), detector, detect_s=detect_s, parallel=parallel, tail_s=tail_s)
    assert list_times(run.frames) == pytest.approx([0.1 * k for k in range(FRAMES)])
    in_time = sum(frame.detections is not None for frame in run.frames)
    assert in_time + run.centre.late_detections == detector.frames
    assert in_time + run.centre.predicted_frames == FRAMES
    late_times = [result.frame.time for frame in run.frames for result in frame.late_detections]
    assert late_times == sorted(set(late_times))
    for frame in run.frames:
        assert all(result.frame.time < frame.frame.time for result in frame.late_detections)


def test_detection_takes_place_as_often_as_it_can(scripted, message, car):
    detector = MovingCar(car)
    run = scripted(street(message), detector, detect_s=0.13, tail_s=0.0)
    assert detector.frames == pytest.approx(FRAMES * 0.1 / 0.13, abs=1.5)
    # the newest frame is detected, so what is predicted is never old
    ages_s = [frame.detection_age_s for frame in run.frames[2:]]
    assert max(ages_s) == pytest.approx(0.2)


def test_a_long_deadline_waits_for_detection(scripted, message, car):
    run = scripted(street(message), MovingCar(car), detect_s=0.13, deadline_s=10.0)
    assert list_times(run.frames) == pytest.approx([0.1 * k for k in range(FRAMES)])
    assert max(frame.latency_ms for frame in run.frames) > 150.0
    assert run.centre.late_detections == 0
    detected = [frame.detections is not None for frame in run.frames]
    assert detected.count(True) == pytest.approx(FRAMES * 0.1 / 0.13, abs=2)


def test_a_frame_without_time_to_wait_is_out_at_once(scripted, message, car):
    run = scripted(street(message), MovingCar(car), detect_s=0.05, deadline_s=0.0)
    assert max(frame.latency_ms for frame in run.frames) == pytest.approx(0.0, abs=1e-3)
    assert run.centre.late_detections == FRAMES


@pytest.mark.parametrize("speed", [0.5, 4.0])
def test_a_deadline_is_in_seconds_of_the_machine(scripted, message, manual_clock, car, speed):
    clock = manual_clock(speed=speed)
    run = scripted(street(message), MovingCar(car), clock, detect_s=1.0)
    assert max(frame.latency_ms for frame in run.frames) == pytest.approx(DEADLINE_MS)
    assert len(run.frames) == FRAMES


def test_detections_of_two_threads_are_used_in_the_order_of_time(scripted, message, car):
    """The first detection takes longer than the second one."""
    run = scripted(street(message, 4), MovingCar(car), detect_s=[0.3, 0.05, 0.05], parallel=2)
    assert [frame.frame.index for frame in run.frames] == [0, 1, 2, 3]
    assert [frame.detections is None for frame in run.frames] == [True, True, True, False]
    late = [result.frame.index for frame in run.frames for result in frame.late_detections]
    assert late == sorted(late)


@pytest.mark.parametrize("detect_s", [0.05, 0.3])
def test_errors_of_the_detector_are_raised(scripted, message, car, detect_s):
    """In a frame that waits, and in one that is out already."""
    with pytest.raises(ZeroDivisionError, match="detector is broken"):
        scripted(street(message), MovingCar(car, fails_at=3), detect_s=detect_s)


def test_an_error_in_the_last_detection_is_raised(scripted, message, car):
    with pytest.raises(ZeroDivisionError):
        scripted(street(message, 4), MovingCar(car, fails_at=3), detect_s=0.095, tail_s=0.0)
