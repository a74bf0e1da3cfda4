import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.layouts.hdf5 import hdf5
from toolkit.datasets.sample import Rectangle
from toolkit.datasets.simulation import simulate_dataset
from toolkit.points import frame_points
from toolkit.sites.files import load_site


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "r.hdf5"
    simulate_dataset(load_site("tjunction"), frames=1, seed=1, out=path, workers=1)
    return path


def test_frames_are_samples_with_all_returns(recording):
    (sample,) = hdf5(recording)
    frame = CoopDataset(recording)[0]
    assert [cloud.name for cloud in sample.clouds] == [sensor.name for sensor in frame.sensors]
    np.testing.assert_array_equal(sample.objects.boxes, frame.objects.boxes)
    assert isinstance(sample.complete, Rectangle)
    np.testing.assert_array_equal(sample.map_SE3_world, CoopDataset(recording).site.map_SE3_site)
    in_crop = sum(map(len, frame_points(frame, area=CoopDataset(recording).site)))
    xmin, ymin, xmax, ymax = sample.complete.area
    points = sample.points()
    inside = (points[:, 0] >= xmin) & (points[:, 0] <= xmax) & (points[:, 1] >= ymin) & (points[:, 1] <= ymax)
    assert (inside & (points[:, 2] > 0) & (points[:, 2] < 4)).sum() == in_crop
    assert count_points(points, sample.objects.boxes).max() > 50
