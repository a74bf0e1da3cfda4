import os
from pathlib import Path

import numpy as np
import pytest

from toolkit.clouds import positions, sensor_numbers
from toolkit.datasets.argoverse import LASERS, count_labels, fuse_sweep, read_calibration, split_sweep, sweep_times

SHARED = Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[4] / "shared"))
LOG = SHARED / "real" / "av2_two_lidars"
recorded = pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")


@recorded
def test_every_cuboid_holds_the_points_that_the_recording_says():
    pytest.importorskip("pyarrow")
    agreed = []
    for time in sweep_times(LOG):
        labels, counts = count_labels(LOG, time)
        assert len(labels.boxes) == len(labels.categories) == len(counts)
        agreed.extend(counts == labels.interior_points)
    assert len(agreed) == 162
    assert all(agreed)


@recorded
def test_the_two_lidars_are_apart_and_come_together_again():
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


def test_a_folder_that_is_no_log_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no Argoverse 2 log"):
        sweep_times(tmp_path)
