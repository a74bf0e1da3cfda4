"""Recorded clouds in one HDF5 file: what is written comes back to the bit, whatever a sample
has."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.layouts.hdf5 import hdf5, hdf5_clouds, holds_clouds, write_hdf5
from toolkit.datasets.recording_views import ReadRecording, Reads, read_frame
from toolkit.datasets.simulation import simulate_dataset
from toolkit.frame import Frame, ImageWedge, OtherObjects, Rectangle, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.points import frame_points
from toolkit.runtime.run import Run


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "r.hdf5"
    simulate_dataset("tjunction", path, run=Run(frames=1, seed=1))
    return path


def test_frames_are_samples_with_all_returns_in_the_frames_of_sensors(recording):
    (sample,) = hdf5(recording)
    frame = CoopDataset(recording)[0]
    assert [cloud.name for cloud in sample.clouds] == [sensor.name for sensor in frame.sensors]
    np.testing.assert_array_equal(sample.objects.boxes, frame.objects.boxes)
    assert isinstance(sample.complete, Rectangle)
    np.testing.assert_array_equal(sample.map_SE3_world, CoopDataset(recording).site.map_SE3_site)
    in_crop = sum(map(len, frame_points(frame, area=CoopDataset(recording).site)))
    xmin, ymin, xmax, ymax = sample.complete.area
    points = sample.points()
    inside = (
        (points[:, 0] >= xmin)
        & (points[:, 0] <= xmax)
        & (points[:, 1] >= ymin)
        & (points[:, 1] <= ymax)
    )
    assert (inside & (points[:, 2] > 0) & (points[:, 2] < 4)).sum() == in_crop
    assert count_points(points, sample.objects.boxes).max() > 50
    (sample,) = hdf5(recording)
    for cloud in sample.clouds:
        assert cloud.frame == "sensor"
        assert (cloud.points[:, 0] > 0).all()  # a camera sees what is ahead of it


def test_sensors_with_errors_and_points_off_their_rays_keep_their_places(recording):
    (plain,), (crooked,) = hdf5(recording), ReadRecording(hdf5(recording), Reads("typical", 4))
    frame = read_frame(CoopDataset(recording), 0, errors="typical", noise_seed=4)
    np.testing.assert_array_equal(crooked.objects.boxes, plain.objects.boxes)
    for own, sensor, true in zip(crooked.clouds, frame.sensors, plain.clouds, strict=True):
        np.testing.assert_array_equal(own.world_SE3_sensor, sensor.world_SE3_body)
        assert 0.001 < np.abs(own.world_SE3_sensor - true.world_SE3_sensor).max() < 0.2
    (again,) = ReadRecording(hdf5(recording), Reads("typical", 4))
    np.testing.assert_array_equal(again.clouds[0].points, crooked.clouds[0].points)
    with pytest.raises(ValueError, match="drawn from a seed"):
        ReadRecording(hdf5(recording), Reads("typical", None))[0]
    frame = CoopDataset(recording)[0]
    shift = np.full((*frame.images[1].shape, 3), [0.5, 0.0, -0.25], np.float32)
    shifted = replace(frame, shifts=(None, shift, *(None for _ in frame.sensors[2:])))
    (plain,) = hdf5(recording)
    for k, (own, other) in enumerate(zip(shifted.clouds, plain.clouds, strict=True)):
        by = [0.5, 0.0, -0.25] if k == 1 else [0.0, 0.0, 0.0]
        np.testing.assert_allclose(
            own.in_world() - other.in_world(), np.tile(by, (len(own.points), 1)), atol=1e-4
        )


BOXES = np.array([[1.0, 2, 0.8, 4.2, 1.8, 1.6, 3.1], [5.0, -2, 0.9, 0.6, 0.5, 1.7, -0.2]])
AREA = Rectangle((-1.0, -2.5, 3.0, 4.0))


def sample(name="1646667310.044", time=1646667310.0440001, complete=AREA):
    rng = np.random.default_rng(2)
    full = SensorCloud(
        "north",
        rng.normal(0, 20, (500, 3)).astype(np.float32),
        pose(1.0, 2.0, 6.0, yaw=0.3, pitch=0.1),
        time=rng.uniform(0, 0.1, 500),
        intensity=rng.uniform(0, 255, 500).astype(np.float32),
        ring=rng.integers(0, 32, 500),
    )
    plain = SensorCloud(
        "south/2", rng.normal(0, 9, (7, 3)).astype(np.float32), pose(5.0, 0.1, 4.0), "world"
    )
    none = SensorCloud("dark", np.zeros((0, 3), np.float32), np.eye(4))
    others = OtherObjects(BOXES[:1] + 0.5, ("Animal",), np.array([4]))
    return Frame.of_clouds(
        name,
        (full, plain, none),
        Objects(BOXES, np.array([0, 2]), np.array([7, 2**60])),
        ("Van", "walker"),
        np.array([12, 3]),
        others,
        complete=complete,
        time=time,
        map_SE3_world=pose(500.0, -3.0, 2.0, yaw=1.0),
        problems={"doubled labels": 2},
    )


def equal(a, b):
    assert (a.name, a.categories, dict(a.problems)) == (b.name, b.categories, dict(b.problems))
    assert a.complete.record() == b.complete.record()
    assert a.others.categories == b.others.categories
    np.testing.assert_array_equal(a.time, b.time)
    assert [(c.name, c.frame) for c in a.clouds] == [(c.name, c.frame) for c in b.clouds]
    columns = [
        *(
            (a.objects.boxes, b.objects.boxes),
            (a.objects.labels, b.objects.labels),
            (a.objects.ids, b.objects.ids),
        ),
        *(
            (a.counts, b.counts),
            (a.others.boxes, b.others.boxes),
            (a.others.counts, b.others.counts),
        ),
        (a.map_SE3_world, b.map_SE3_world),
    ]
    for one, two in zip(a.clouds, b.clouds, strict=True):
        names = ("points", "world_SE3_sensor", "time", "intensity", "ring")
        columns += [(getattr(one, name), getattr(two, name)) for name in names]
    for one, two in columns:
        assert (one is None) == (two is None)
        if one is not None:
            assert one.dtype == two.dtype
            np.testing.assert_array_equal(one, two)


def test_files_are_written_whole_without_loss_or_not_at_all(tmp_path):
    wedge = ImageWedge(np.arange(12.0).reshape(3, 4) / 7, 1242, 375, ((1.0, 2.0, 3.0, 4.5),))
    some = [sample(), sample("b", float("nan"), wedge), Frame.of_clouds("", (), Objects.empty())]
    write_hdf5(some, tmp_path / "r.hdf5")
    back = hdf5_clouds(tmp_path / "r.hdf5")
    assert len(back) == 3
    for before, after in zip(some, back, strict=True):
        equal(before, after)
    assert holds_clouds(tmp_path / "r.hdf5")
    equal(next(iter(hdf5(tmp_path / "r.hdf5"))), some[0])
    write_hdf5([sample()], tmp_path / "r.hdf5")
    with pytest.raises(ValueError, match=r"recorded clouds, not images: give --layout hdf5"):
        CoopDataset(tmp_path / "r.hdf5")

    def breaks():
        yield sample()
        raise OSError("the bag ends here")

    (tmp_path / "r.hdf5").unlink()
    with pytest.raises(OSError, match="ends here"):
        write_hdf5(breaks(), tmp_path / "r.hdf5")
    with pytest.raises(ValueError, match="different names"):
        write_hdf5([sample(), sample()], tmp_path / "r.hdf5")
    assert list(tmp_path.iterdir()) == []
    write_hdf5([], tmp_path / "r.hdf5")
    assert len(hdf5_clouds(tmp_path / "r.hdf5")) == 0
    write_hdf5([sample()], tmp_path / "r.hdf5")
    assert len(hdf5(tmp_path / "r.hdf5")) == 1
    with pytest.raises(ValueError, match="have errors of their own"):
        ReadRecording(hdf5(tmp_path / "r.hdf5"), Reads("typical"))[0]


def changed(file, name, value):
    del file[name]
    file[name] = value


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (
            lambda file: changed(file, "samples/0/boxes", np.zeros((2, 7))),
            "boxes must be finite boxes",
        ),
        (
            lambda file: changed(file, "samples/0/boxes", np.zeros((2, 6))),
            "boxes must be finite boxes",
        ),
        (lambda file: changed(file, "samples/0/labels", np.array([0, 9])), "label"),
        (
            lambda file: changed(file, "samples/0/clouds/0/points", np.full((500, 3), np.nan)),
            "points must be finite",
        ),
        (
            lambda file: changed(file, "samples/0/clouds/0/time", np.zeros(3)),
            "clouds/0/time must be of 500 points, got 3",
        ),
        (
            lambda file: changed(file, "samples/0/clouds/1/pose", np.ones((4, 4))),
            "must turn by a rotation",
        ),
        (lambda file: changed(file, "samples/0/counts", np.array([1])), "2 objects but 1 counts"),
        (lambda file: changed(file, "samples/0/about", "{}"), "no entry sensors"),
        (lambda file: changed(file, "names", '["a", "a"]'), "the same name"),
        (lambda file: file.attrs.__setitem__("version", 2), "version is 2"),
        (lambda file: file.__delitem__("samples/0/ids"), "ids"),
    ],
)
def test_damage_is_named_in_one_line(tmp_path, damage, says):
    path = tmp_path / "r.hdf5"
    write_hdf5([sample()], path)
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(ValueError, match=says) as refused:
        list(hdf5_clouds(path))
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)
