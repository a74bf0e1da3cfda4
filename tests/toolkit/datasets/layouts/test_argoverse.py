import os
from pathlib import Path

import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.clouds import positions, sensor_numbers
from toolkit.datasets.layouts.argoverse import (
    LASERS,
    argoverse,
    count_labels,
    fuse_sweep,
    read_calibration,
    split_sweep,
    sweep_times,
    write_argoverse,
)
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects

SHARED = Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[5] / "shared"))
LOG = SHARED / "real" / "av2_two_lidars"
recorded = pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")


@recorded
def test_every_cuboid_holds_its_points_of_two_lidars():
    pytest.importorskip("pyarrow")
    agreed = []
    for time in sweep_times(LOG):
        labels, counts = count_labels(LOG, time)
        assert len(labels.boxes) == len(labels.categories) == len(counts)
        agreed.extend(counts == labels.interior_points)
    assert len(agreed) == 162
    assert all(agreed)
    pytest.importorskip("pyarrow")
    time = sweep_times(LOG)[0]
    parts, calibration, fused = split_sweep(LOG, time), read_calibration(LOG), fuse_sweep(LOG, time)
    assert parts.keys() == LASERS.keys()
    for number, (name, part) in enumerate(parts.items()):
        # A spinning lidar's frame is its own: each laser sweeps a cone about the axis, so nothing lies near the axis.
        assert np.hypot(part[:, 0], part[:, 1]).min() > 0.5
        back = part @ calibration[name][:3, :3].T + calibration[name][:3, 3]
        np.testing.assert_allclose(positions(fused)[sensor_numbers(fused) == number], back, atol=1e-9)
    assert sum(map(len, parts.values())) == len(positions(fused))
    agreed = []
    for sample in argoverse(LOG):
        points = sample.points()
        agreed += (count_points(points, sample.objects.boxes) == sample.counts).tolist()
        agreed += (count_points(points, sample.others.boxes) == sample.others.counts).tolist()
    assert len(agreed) == 162
    assert all(agreed)
    sample = argoverse(LOG)[0]
    assert [cloud.name for cloud in sample.clouds] == ["up_lidar", "down_lidar"]
    for cloud in sample.clouds:
        assert cloud.time.min() == 0
        assert 0.09 < cloud.time.max() < 0.11
        assert 1 < cloud.world_SE3_sensor[2, 3] < 2
    assert sample.time == pytest.approx(315966265.26)


def test_logs_without_labels_and_folders_that_are_none(tmp_path):
    with pytest.raises(FileNotFoundError, match="no Argoverse 2 log"):
        sweep_times(tmp_path)
    clouds = tuple(SensorCloud(name, np.ones((1, 3), np.float32), np.eye(4)) for name in "abc")
    with pytest.raises(ValueError, match="has two lidars, but '0' has 3"):
        write_argoverse([Frame.of_clouds("0", clouds, Objects.empty())], tmp_path)
    cloud = SensorCloud("a", np.ones((1, 3), np.float32), np.eye(4))
    write_argoverse([Frame.of_clouds("0", (cloud,), Objects.empty(), time=2.0)], tmp_path)
    (tmp_path / "annotations.feather").unlink()
    (tmp_path / "city_SE3_egovehicle.feather").unlink()
    (sample,) = argoverse(tmp_path)
    assert len(sample.objects) == 0
    assert sample.time == 2.0
    assert sample.map_SE3_world.tolist() == np.eye(4).tolist()


pytest.importorskip("pyarrow")
