"""Clouds are one frame if they were measured together: by time, not by count or order."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.datasets.clock_times import BY_ORDER, MAX_PERIOD_S, UNPAIRED, group_by_time
from toolkit.datasets.layouts.folder import OTHER_NAME
from toolkit.datasets.listing import Listing
from toolkit.datasets.recordings import open_recording
from toolkit.frame import APART, Frame

START_S = 1_700_000_000.0
STEPS = np.arange(8)
NORTH = START_S + 0.1 * STEPS[STEPS != 2]
SOUTH = START_S + 0.1 * STEPS[STEPS != 5] + 0.004


def put(folder: Path, times: np.ndarray, form: str = "{:.3f}", scale: float = 1.0) -> None:
    """A cloud of one point for each time, whose x is its number."""
    folder.mkdir(parents=True)
    for k, time in enumerate(times):
        np.save(
            folder / f"{form.format(round(time * scale, 3))}.npy", np.array([[k + 1.0, 1.0, 0.0]])
        )


def list_stamps(frame: Frame) -> list[float]:
    return [cloud.stamp_s for cloud in frame.clouds if cloud.stamp_s is not None]


FORMS = {"s": ("{:.3f}", 1.0), "ms": ("{:.0f}", 1e3), "us": ("{:.0f}", 1e6), "ns": ("{:.0f}", 1e9)}


@pytest.mark.parametrize("unit", FORMS)
def test_two_lidars_that_each_lost_a_cloud(tmp_path, unit):
    """north/T for T = 1700000000.000 + 0.1 k without 2, south/T + 0.004 without 5, in any unit."""
    put(tmp_path / "north", NORTH, *FORMS[unit])
    put(tmp_path / "south", SOUTH, *FORMS[unit])
    recording = open_recording(tmp_path)
    frames = list(recording)
    assert [len(frame.clouds) for frame in frames] == [2, 2, 1, 2, 2, 1, 2, 2]
    for frame in frames:
        stamps = list_stamps(frame)
        assert max(stamps) - min(stamps) < 0.02
        assert frame.time == pytest.approx(stamps[0], abs=1e-6)
    np.testing.assert_allclose([frame.time for frame in frames], START_S + 0.1 * STEPS, atol=0.005)
    assert [frame.problems.get(UNPAIRED, 0) for frame in frames] == [0, 0, 1, 0, 0, 1, 0, 0]
    assert [cloud.name for cloud in frames[2].clouds] == ["south"]
    assert [cloud.name for cloud in frames[5].clouds] == ["north"]


@pytest.mark.parametrize(("lag", "counted"), [(0.004, 0), (0.019, 0), (0.03, 1), (-0.045, 1)])
def test_lidars_that_run_freely_are_paired_and_their_lag_is_counted(tmp_path, lag, counted):
    put(tmp_path / "north", START_S + 0.1 * STEPS)
    put(tmp_path / "south", START_S + 0.1 * STEPS + lag)
    frames = list(open_recording(tmp_path))
    assert [len(frame.clouds) for frame in frames] == [2] * 8
    assert {frame.problems.get(APART, 0) for frame in frames} == {counted}


def test_labels_by_the_name_of_any_cloud_of_a_frame(tmp_path):
    put(tmp_path / "north", NORTH)
    put(tmp_path / "south", SOUTH)
    row = {
        "label": "vehicle",
        "x": 1,
        "y": 1,
        "z": 0,
        "length": 4,
        "width": 2,
        "height": 2,
        "yaw_deg": 0,
    }
    names = [
        "1700000000.000",
        "1700000000.104",
        "1700000000.204",
        "1700000000.300",
        "1700000000.304",
    ]
    samples = [{"name": name, "objects": [row]} for name in names]
    (tmp_path / "labels.json").write_text(
        json.dumps({"coview": "boxes", "version": 1, "samples": samples})
    )
    recording = open_recording(tmp_path)
    assert [len(frame.objects) for frame in recording] == [1, 1, 1, 1, 0, 0, 0, 0]
    assert recording[3].problems == {OTHER_NAME: 1}
    assert isinstance(recording, Listing)
    assert not recording.strays


def test_names_that_are_no_times_go_by_order_and_say_so(tmp_path):
    put(tmp_path / "north", np.arange(100.0, 103), "{:.0f}")
    put(tmp_path / "south", np.arange(201.0, 204), "{:.0f}")
    frames = list(open_recording(tmp_path))
    assert [len(frame.clouds) for frame in frames] == [2, 2, 2]
    assert [frame.problems for frame in frames] == [{BY_ORDER: 1}] * 3
    put(tmp_path / "west", np.arange(201.0, 203), "{:.0f}")
    frames = list(open_recording(tmp_path))
    assert [len(frame.clouds) for frame in frames] == [1, 1, 1, 2, 2, 1]
    assert all(frame.problems == {UNPAIRED: 1} for frame in frames)


def test_clocks_an_hour_apart_pair_nothing(tmp_path):
    """Equally many clouds are no reason: nothing says which belong together."""
    put(tmp_path / "north", START_S + 0.1 * STEPS)
    put(tmp_path / "south", START_S + 3600 + 0.1 * STEPS)
    frames = list(open_recording(tmp_path))
    assert [len(frame.clouds) for frame in frames] == [1] * 16
    assert all(frame.problems == {UNPAIRED: 1} for frame in frames)


def test_two_rates_pair_every_second_cloud():
    fast, slow = START_S + 0.05 * np.arange(40), START_S + 0.1 * np.arange(20) + 0.01
    groups = group_by_time({"fast": fast, "slow": slow})
    assert [len(group) for group in groups] == [2, 1] * 20


@pytest.mark.parametrize("lag", [0.0, 0.02, 0.048, 0.09, -0.03])
def test_sensors_that_run_freely_keep_their_lag(lag):
    """Half a period apart and jittering by milliseconds, each cloud still follows the same one."""
    rng = np.random.default_rng(3)
    north = START_S + 0.1 * np.arange(200) + rng.normal(0, 0.002, 200)
    south = START_S + 0.1 * np.arange(200) + lag + rng.normal(0, 0.002, 200)
    groups = group_by_time({"north": north, "south": south})
    pairs = np.array([[group["north"], group["south"]] for group in groups if len(group) == 2])
    assert len(pairs) >= 199
    assert np.abs(np.diff(pairs[:, 0] - pairs[:, 1])).max() == 0


def test_single_clouds_seconds_apart_are_two_frames():
    assert group_by_time({"a": np.array([START_S]), "b": np.array([START_S + 0.05])}) == [
        {"a": 0, "b": 0}
    ]
    assert len(group_by_time({"a": np.array([START_S]), "b": np.array([START_S + 5])})) == 2
    every_five = START_S + 5.0 * np.arange(6)
    groups = group_by_time({"a": every_five, "b": every_five[1:] + 2.0})
    assert [len(group) for group in groups] == [1] * 11
    assert group_by_time({}) == group_by_time({"a": np.zeros(0)}) == []


times = st.lists(st.floats(0, 3, allow_nan=False), max_size=12).map(
    lambda each: np.array(each, np.float64)
)


@settings(max_examples=60, deadline=None)
@given(st.fixed_dictionaries({"a": times, "b": times, "c": times}))
def test_every_cloud_is_in_one_group_and_none_is_far_from_its_partners(times_s):
    groups = group_by_time(times_s)
    for sensor, values in times_s.items():
        assert sorted(group[sensor] for group in groups if sensor in group) == list(
            range(len(values))
        )
    for group in groups:
        within = [times_s[sensor][row] for sensor, row in group.items()]
        assert max(within) - min(within) <= 2 * MAX_PERIOD_S


def test_rcooper_pairs_by_time(tmp_path):
    """Agents' names differ by milliseconds, and the second lost a cloud."""
    from toolkit.point_files.pcd import pcd_bytes

    for agent, stamps in (("106", [44.4, 44.5, 44.6]), ("105", [44.41, 44.61])):
        where = tmp_path / "data/106-105" / agent / "seq-1/lidar"
        where.mkdir(parents=True)
        for stamp in stamps:
            columns = dict(zip("xyz", np.ones((3, 2), np.float32), strict=True))
            (where / f"16926853{stamp:.2f}.pcd").write_bytes(pcd_bytes(columns))
        calib = tmp_path / "calib/lidar2world"
        calib.mkdir(parents=True, exist_ok=True)
        level = {"rotation": np.eye(3).tolist(), "translation": [0, 0, 6]}
        (calib / f"{agent}.json").write_text(json.dumps(level))
    frames = list(open_recording(tmp_path, "rcooper"))
    assert [[cloud.name for cloud in frame.clouds] for frame in frames] == [
        ["106", "105"],
        ["106"],
        ["106", "105"],
    ]
    assert [frame.problems for frame in frames] == [{}, {UNPAIRED: 1}, {}]
    assert list_stamps(frames[2]) == [1692685344.6, 1692685344.61]
