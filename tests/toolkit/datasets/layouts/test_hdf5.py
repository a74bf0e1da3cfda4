from dataclasses import replace

import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.layouts import hdf5_layout
from toolkit.datasets.layouts.hdf5 import hdf5
from toolkit.datasets.readings import read_frame
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


def test_sensors_with_errors_are_believed_elsewhere(recording):
    (plain,), (crooked,) = hdf5(recording), hdf5(recording, errors="typical", noise_seed=4)
    frame = read_frame(CoopDataset(recording), 0, errors="typical", noise_seed=4)
    np.testing.assert_array_equal(crooked.objects.boxes, plain.objects.boxes)
    for own, sensor, true in zip(crooked.clouds, frame.sensors, plain.clouds, strict=True):
        np.testing.assert_array_equal(own.world_SE3_sensor, sensor.world_SE3_body)
        assert 0.001 < np.abs(own.world_SE3_sensor - true.world_SE3_sensor).max() < 0.2
    (again,) = hdf5(recording, errors="typical", noise_seed=4)
    np.testing.assert_array_equal(again.clouds[0].points, crooked.clouds[0].points)
    with pytest.raises(ValueError, match="drawn from a seed"):
        hdf5(recording, errors="typical")[0]


def test_clouds_are_in_the_body_frame_of_their_sensors(recording):
    (sample,) = hdf5(recording)
    for cloud in sample.clouds:
        assert cloud.frame == "sensor"
        assert (cloud.points[:, 0] > 0).all()  # a camera sees what is ahead of it


def test_points_off_their_rays_are_where_they_were_measured(recording, monkeypatch):
    frame = CoopDataset(recording)[0]
    shift = np.full((*frame.measurements[1].shape, 3), [0.5, 0.0, -0.25], np.float32)
    shifted = replace(frame, shifts=(None, shift, *(None for _ in frame.sensors[2:])))
    (plain,) = hdf5(recording)
    monkeypatch.setattr(hdf5_layout, "read_frame", lambda *_, **__: shifted)
    (moved,) = hdf5(recording)
    for k, (own, other) in enumerate(zip(moved.clouds, plain.clouds, strict=True)):
        by = [0.5, 0.0, -0.25] if k == 1 else [0.0, 0.0, 0.0]
        np.testing.assert_allclose(own.in_world() - other.in_world(), np.tile(by, (len(own.points), 1)), atol=1e-4)
