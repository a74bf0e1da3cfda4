"""Messages of sensors in groups of one moment."""

import numpy as np
import pytest

from toolkit.centre.centre_run import CentreParts
from toolkit.centre.detection_pool import Detection
from toolkit.centre.sensor_message import SensorMessage
from toolkit.centre.synchroniser import Synchroniser
from toolkit.objects import Detections

IMAGE = np.zeros((2, 2), np.float32)


def message(sensor, time_s, arrival_s=None):
    return SensorMessage(sensor, time_s, time_s if arrival_s is None else arrival_s, IMAGE)


def detect_nothing(points):
    return Detections.empty()


def members(groups):
    return ["".join(sorted(group.messages)) for group in groups]


def test_a_group_is_out_as_soon_as_it_is_complete():
    synchroniser = Synchroniser(0.1, 0.05)
    synchroniser.add(message("a", 1.0))
    assert synchroniser.take(1.0, "ab") == []
    synchroniser.add(message("b", 1.02))
    (group,) = synchroniser.take(1.02, "ab")
    assert group.time_s == 1.02


def test_a_missing_sensor_is_waited_for_a_while_only():
    synchroniser = Synchroniser(0.1, 0.05)
    synchroniser.add(message("a", 1.0))
    assert synchroniser.take(1.04, "ab") == []
    assert members(synchroniser.take(1.05, "ab")) == ["a"]
    synchroniser.add(message("b", 1.0, 1.06))
    assert synchroniser.late == {"b": 1}
    assert synchroniser.take(2.0, "ab") == []


def test_a_centre_waits_half_an_interval_longer_than_its_sensors_are_apart():
    parts = CentreParts((), Detection(detect_nothing), interval_s=0.1, spread_s=0.06)
    synchroniser = parts.make_synchroniser()
    synchroniser.add(message("a", 1.0))
    assert synchroniser.take(1.1, "ab") == []
    assert members(synchroniser.take(1.12, "ab")) == ["a"]  # 1 + .06 + .1 / 2 is over


def test_a_sensor_that_has_gone_on_is_not_waited_for():
    synchroniser = Synchroniser(0.1, 10.0)
    synchroniser.add(message("a", 1.0))
    synchroniser.add(message("a", 1.1))
    synchroniser.add(message("b", 1.1))
    assert members(synchroniser.take(1.1, "ab")) == ["a", "ab"]


def test_sensors_that_turn_freely_make_whole_groups():
    rng = np.random.default_rng(3)
    phases = {"a": 0.0, "b": 0.031, "c": 0.064, "d": 0.092}
    messages = [
        message(name, phase + 0.1 * k + rng.uniform(-0.002, 0.002))
        for name, phase in phases.items()
        for k in range(100)
    ]
    synchroniser = Synchroniser(0.1, 0.1)
    groups = []
    for received in sorted(messages, key=lambda received: received.arrival_s):
        synchroniser.add(received)
        groups += synchroniser.take(received.arrival_s, phases)
    groups += synchroniser.flush()
    assert sum(map(len, members(groups))) == len(messages)
    assert members(groups)[3:-3] == ["abcd"] * (len(groups) - 6)
    times = [group.time_s for group in groups]
    assert times == sorted(times)
    assert not synchroniser.late


def test_a_second_message_of_one_moment_is_left_out():
    synchroniser = Synchroniser(0.1, 0.05)
    for _ in range(2):
        synchroniser.add(message("a", 1.0))
    assert synchroniser.late == {"a": 1}


def test_an_interval_must_be_a_time():
    with pytest.raises(ValueError, match="seconds above 0"):
        Synchroniser(0.0, 0.05)
