import os
import re
from pathlib import Path

import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.datasets.layouts.argoverse import (
    LASERS,
    NO_CALIBRATION,
    argoverse,
    check_log,
    sweep_times,
    write_argoverse,
)
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects

LOG = (
    Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[5] / "shared"))
    / "real"
    / "av2_two_lidars"
)
recorded = pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")


@recorded
def test_every_cuboid_holds_the_points_that_the_recording_says():
    pytest.importorskip("pyarrow")
    rows = check_log(LOG)
    assert len(rows) == 162
    assert {row.sweep for row in rows} <= set(sweep_times(LOG))
    assert all(row.points == row.recorded for row in rows)


@recorded
def test_the_two_lidars_are_apart():
    pytest.importorskip("pyarrow")
    clouds = argoverse(LOG)[0].clouds
    assert [cloud.name for cloud in clouds] == list(LASERS)
    for cloud in clouds:
        # A spinning lidar's frame is its own: each laser sweeps a cone about the axis, so nothing
        # lies near the axis.
        assert np.hypot(*cloud.in_sensor()[:, :2].T).min() > 0.5


def test_folders_that_are_no_log_and_three_lidars_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no Argoverse 2 log"):
        sweep_times(tmp_path)
    clouds = tuple(SensorCloud(name, np.ones((1, 3), np.float32), np.eye(4)) for name in "abc")
    with pytest.raises(ValueError, match="has two lidars, but '0' has 3"):
        write_argoverse([Frame.of_clouds("0", clouds, Objects.empty())], tmp_path)


pyarrow = pytest.importorskip("pyarrow")
feather = pytest.importorskip("pyarrow.feather")


@recorded
def test_every_cuboid_holds_the_points_that_the_recording_says_as_a_sample():
    agreed = []
    for sample in argoverse(LOG):
        points = sample.points()
        agreed += (count_points(points, sample.objects.boxes) == sample.counts).tolist()
        agreed += (count_points(points, sample.others.boxes) == sample.others.counts).tolist()
    assert len(agreed) == 162
    assert all(agreed)


@recorded
def test_the_lidars_are_two_and_say_when_each_point_was_measured():
    sample = argoverse(LOG)[0]
    assert [cloud.name for cloud in sample.clouds] == ["up_lidar", "down_lidar"]
    for cloud in sample.clouds:
        assert cloud.time.min() == 0
        assert 0.09 < cloud.time.max() < 0.11
        assert 1 < cloud.world_SE3_sensor[2, 3] < 2
    assert sample.time == pytest.approx(315966265.26)


def test_a_log_without_calibration_is_in_the_vehicles_frame_anyway(tmp_path):
    cloud = SensorCloud("a", np.ones((1, 3), np.float32), np.eye(4))
    write_argoverse([Frame.of_clouds("0", (cloud,), Objects.empty(), time=2.0)], tmp_path)
    (before,) = argoverse(tmp_path)
    (tmp_path / "calibration" / "egovehicle_SE3_sensor.feather").unlink()
    (sample,) = argoverse(tmp_path)
    assert sample.points().tolist() == before.points().tolist()
    assert sample.problems == {**before.problems, NO_CALIBRATION: 1}


def test_a_lidar_that_the_calibration_lacks_is_refused_by_name(tmp_path):
    cloud = SensorCloud("a", np.ones((1, 3), np.float32), np.eye(4))
    write_argoverse([Frame.of_clouds("0", (cloud,), Objects.empty(), time=2.0)], tmp_path)
    calibration = tmp_path / "calibration" / "egovehicle_SE3_sensor.feather"
    table = feather.read_table(calibration)
    names = pyarrow.array(["ring_front_center"])
    column = table.column_names.index("sensor_name")
    feather.write_feather(table.set_column(column, "sensor_name", names), calibration)
    sweep = tmp_path / "sensors" / "lidar" / "2000000000.feather"
    reason = f"it has points of up_lidar, which {calibration} lacks: add its row"
    with pytest.raises(
        ValueError, match=re.escape(f"{sweep} is no sweep that can be read: {reason}")
    ):
        argoverse(tmp_path)[0]


def test_a_log_without_labels(tmp_path):
    cloud = SensorCloud("a", np.ones((1, 3), np.float32), np.eye(4))
    write_argoverse([Frame.of_clouds("0", (cloud,), Objects.empty(), time=2.0)], tmp_path)
    (tmp_path / "annotations.feather").unlink()
    (tmp_path / "city_SE3_egovehicle.feather").unlink()
    (sample,) = argoverse(tmp_path)
    assert len(sample.objects) == 0
    assert sample.time == 2.0
    assert sample.map_SE3_world.tolist() == np.eye(4).tolist()
