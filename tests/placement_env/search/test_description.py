"""A search's result in words."""

import numpy as np

from placement_env.objective import Score
from placement_env.search.description import described_score, described_sensors
from toolkit.geometry import look
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor


def test_sensors_are_named_and_those_that_were_moved_with_where_to():
    assert described_sensors(["a", "b"]) == ["a", "b"]
    moved = [Sensor("a", DepthCamera(), look((1.0, -2.0, 6.5), float(np.deg2rad(90)), float(np.deg2rad(10))))]
    assert described_sensors(["a"], moved) == ["a moved to x 1.00 y -2.00 z 6.50 m, heading 90.0 tilt 10.0 degrees"]


def test_all_figures_of_a_score_are_said():
    score = Score((0, 1), 0.5, 0.6, 100.0, 200.0, 2.0, 0.4, {"ap": 0.5}, "coverage", False)
    assert described_score(score) == ("AP 0.5000, recall 0.6000, 100.0 kbit per sensor, 200.0 kbit, price 2 (coverage)")
