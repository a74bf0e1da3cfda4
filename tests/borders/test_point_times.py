"""Times of points: in the unit that the column's name or numbers tell, or left out and counted."""

import numpy as np
import pytest

from toolkit.datasets.cloud_records import build_cloud
from toolkit.datasets.point_times import parse_point_times
from toolkit.datasets.problem_kinds import UNTIMED

COUNT = 1000
SWEEP_S = np.linspace(0, 0.1, COUNT)
START_S = 1_700_000_000


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("offset_ns", np.round(SWEEP_S * 1e9).astype(np.int32)),  # Argoverse 2
        ("t", np.round(SWEEP_S * 1e9).astype(np.uint32)),  # ouster_ros
        ("offset_time", np.round(SWEEP_S * 1e9).astype(np.uint32)),  # livox_ros_driver
        ("time", SWEEP_S.astype(np.float32)),  # velodyne_pointcloud
        ("time", (SWEEP_S - 0.1).astype(np.float32)),  # the same, counted from the last point
        ("timestamp", START_S + SWEEP_S),  # Hesai and RoboSense
        ("timestamp", START_S * 10**9 + np.round(SWEEP_S * 1e9).astype(np.int64)),
        (
            "timestamp",
            START_S * 10**6 + np.round(SWEEP_S * 1e6).astype(np.int64),
        ),  # microseconds, whole
        ("timestamp", START_S * 1e6 + SWEEP_S * 1e6),  # microseconds as floats
        ("time_us", np.round(SWEEP_S * 1e6).astype(np.int32)),
        ("timestamp_ms", SWEEP_S * 1e3),
    ],
)
def test_units(name, times):
    np.testing.assert_allclose(parse_point_times(name, times), SWEEP_S, rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    "times",
    [np.round(SWEEP_S * 1e6).astype(np.int32), SWEEP_S * 1e3, SWEEP_S * 1e9],
    ids=["whole microseconds", "milliseconds as floats", "nanoseconds as floats"],
)
def test_unknown_units_are_left_out_and_counted(times):
    problems: dict[str, int] = {}
    points = np.random.default_rng(0).uniform(-9, 9, (COUNT, 3))
    cloud = build_cloud({"positions": points, "time": times[:, None]}, "a", np.eye(4), problems)
    assert cloud.time is None
    assert problems[UNTIMED] == 1


def test_flash_sensors_have_one_time():
    assert not parse_point_times("t", np.full(COUNT, 7, np.uint32)).any()
