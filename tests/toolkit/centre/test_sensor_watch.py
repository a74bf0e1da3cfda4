"""Arrival times of messages against the faults that they show."""

import numpy as np
import pytest

from toolkit.centre.sensor_message import SensorMessage
from toolkit.centre.sensor_watch import SensorWatch
from toolkit.geometry import pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

LOOK_EVERY_S = 0.01
CAMERA = Sensor("a", DepthCamera(width=8, height=6, stride=1), pose())


def watch_arrivals(interval_s, delays_s):
    """Faults of a sensor that begin or end, and their times (s); a message for each delay (s)."""
    watch = SensorWatch({"a": CAMERA}, start_s=0.0, interval_s=interval_s)
    image = np.zeros(CAMERA.model.shape, np.float32)
    waiting = [
        SensorMessage("a", interval_s * k, interval_s * k + delay_s, image)
        for k, delay_s in enumerate(delays_s)
    ]
    waiting.sort(key=lambda message: message.arrival_s)
    events = []
    for now_s in np.arange(0.0, interval_s * len(delays_s), LOOK_EVERY_S):
        while waiting and waiting[0].arrival_s <= now_s + 1e-9:
            watch.hear(waiting.pop(0))
        events += watch.look(now_s)
    return [(event.fault and event.fault.value, round(event.time_s, 2)) for event in events]


@pytest.mark.parametrize("interval_s", [0.1, 0.2])
def test_a_delayed_sensor_is_late_within_half_a_second_and_until_it_is_in_time(interval_s):
    onset = 10
    events = watch_arrivals(interval_s, [0.02] * onset + [0.3] * 20 + [0.02] * 10)
    names = [name for name, _ in events]
    assert names[-2:] == ["late", None]
    assert set(names[:-2]) <= {"late", "silent"}  # until the first delayed message is there
    assert events[-2][1] <= onset * interval_s + 0.3 + 2 * LOOK_EVERY_S
    assert events[-1][1] == pytest.approx((onset + 20) * interval_s + 0.02, abs=0.02)


@pytest.mark.parametrize("interval_s", [0.1, 0.2])
def test_messages_that_are_a_little_late_are_no_fault(interval_s):
    delays_s = np.random.default_rng(0).uniform(0.0, 0.14, 500)
    assert watch_arrivals(interval_s, delays_s) == []


def test_a_message_that_others_overtook_is_no_fault():
    assert watch_arrivals(0.1, [0.02, 0.02, 0.215, 0.02, 0.02, 0.02]) == []


@pytest.mark.parametrize("interval_s", [0.1, 0.2])
def test_one_look_after_all_arrivals_is_no_fault_though_they_came_late(interval_s):
    """A centre that was busy itself hears messages late, but none that it missed is overdue."""
    watch = SensorWatch({"a": CAMERA}, start_s=0.0, interval_s=interval_s)
    image = np.zeros(CAMERA.model.shape, np.float32)
    for k in range(50):
        now_s = interval_s * k + 0.2
        watch.hear(SensorMessage("a", interval_s * k, now_s, image))
        assert watch.look(now_s) == []
