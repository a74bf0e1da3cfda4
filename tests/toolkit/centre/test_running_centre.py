"""A centre on a clock that takes no time: what comes out, what is dropped, who is named."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.objects import Detections

NAMES = "abc"
FRAMES = 40
ONSET = 15  # frame from which a sensor fails
ONSET_S = 1.5


def everybody(message, leaves_out=lambda name, k: False, frames=FRAMES):
    return [message(name, k) for k in range(frames) for name in NAMES if not leaves_out(name, k)]


def test_every_frame_comes_out_whole_and_in_order(scripted, message):
    run = scripted(everybody(message))
    times = [frame.frame.time for frame in run.frames]
    assert times == pytest.approx(0.1 * np.arange(FRAMES))
    assert run.written == times
    assert all(len(frame.frame.sensors) == 3 for frame in run.frames)
    assert run.named() == []
    assert run.centre.dropped_frames == 0
    assert max(frame.latency_ms for frame in run.frames) < 1.0


def test_stages_are_timed(scripted, message):
    frame = scripted(everybody(message, frames=3)).frames[-1]
    assert list(frame.stage_ms) == ["wait", "fuse", "hold", "level", "detect", "track", "write"]
    assert all(ms > -1e-6 for ms in frame.stage_ms.values())


def test_tracks_keep_their_numbers(scripted, message, car):
    def detect(points):
        return Detections(car, np.array([0.9]))

    run = scripted(everybody(message), detect)
    assert {tuple(frame.tracks.ids.tolist()) for frame in run.frames} == {(0,)}


def test_a_silent_sensor_is_named_and_the_rest_goes_on(scripted, message):
    run = scripted(everybody(message, lambda name, k: name == "b" and k >= ONSET))
    ((sensor, fault, time_s), (_, last_fault, last_s)) = run.named()
    assert sensor == "b"
    assert fault == "late"
    assert last_fault == "silent"
    assert ONSET_S <= time_s < last_s <= ONSET_S + 0.5
    assert len(run.frames) == FRAMES
    assert [len(frame.frame.sensors) for frame in run.frames[ONSET + 4 :]] == [2] * 21
    # while the sensor is not known to fail, frames wait half an interval for it
    assert max(frame.latency_ms for frame in run.frames) <= 75.0
    assert max(frame.latency_ms for frame in run.frames[ONSET + 4 :]) < 1.0


def test_a_sensor_that_returns_works_again(scripted, message):
    run = scripted(everybody(message, lambda name, k: name == "b" and 10 <= k < 20))
    assert [row[:2] for row in run.named()] == [("b", "late"), ("b", "silent"), ("b", None)]
    assert len(run.frames[-1].frame.sensors) == 3


def test_a_late_sensor_is_named_and_the_rest_goes_on(scripted, message):
    messages = [
        message(name, k, delay_s=0.3 if name == "b" and k >= ONSET else 0.0)
        for k in range(FRAMES)
        for name in NAMES
    ]
    run = scripted(messages)
    assert run.named()[0][:2] == ("b", "late")
    assert run.named()[0][2] <= ONSET_S + 0.5
    assert run.named()[-1][:2] == ("b", "late")
    assert len(run.frames) == FRAMES
    assert run.synchroniser.late["b"] > 15


def test_a_clock_that_is_behind_shows_as_late(scripted, message):
    messages = everybody(message)
    messages = [
        replace(m, time_s=m.time_s - 0.3) if m.sensor == "b" and m.time_s >= ONSET_S else m
        for m in messages
    ]
    run = scripted(messages)
    assert ("b", "late") in [row[:2] for row in run.named()]


@pytest.mark.parametrize("fault", ["blinded", "frozen", "shifted"])
def test_contents_show_a_fault(scripted, message, empty_image, fault):
    images = {
        "blinded": np.zeros_like(empty_image),
        "frozen": empty_image,
        "shifted": np.where(empty_image > 0, empty_image + 4.0, 0).astype(np.float32),
    }
    messages = everybody(message, lambda name, k: name == "c" and k >= ONSET)
    for k in range(ONSET, FRAMES):
        last = message("c", ONSET - 1 if fault == "frozen" else k, images[fault])
        messages.append(replace(last, time_s=0.1 * k, arrival_s=0.1 * k))
    run = scripted(messages)
    ((sensor, name, time_s),) = run.named()
    assert (sensor, name) == ("c", fault)
    assert ONSET_S <= time_s <= ONSET_S + 0.5
    assert len(run.frames) == FRAMES


def test_a_message_of_a_time_that_was_given_out_is_left_out(scripted, message):
    messages = everybody(message)
    messages.append(replace(message("a", 3), arrival_s=2.0))
    run = scripted(messages)
    assert run.synchroniser.late == {"a": 1}
    assert len(run.frames) == FRAMES
