import json

import numpy as np
import pytest

from toolkit.datasets.clock_times import parse_epoch
from toolkit.datasets.folders import list_files
from toolkit.datasets.layouts.folder import folder
from toolkit.geometry import pose


def put(path, points=((1.0, 0, 0),)):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, np.array(points))


def test_sensors_share_names_or_go_by_order(tmp_path):
    put(tmp_path / "b.npy")
    put(tmp_path / "a.npy")
    samples = list(folder(tmp_path))
    assert [sample.name for sample in samples] == ["a", "b"]
    assert [[cloud.name for cloud in sample.clouds] for sample in samples] == [["lidar"], ["lidar"]]
    assert len(samples[0].objects) == 0
    for name in ("north/0.npy", "south/0.npy", "south/1.npy"):
        put(tmp_path / "same" / name)
    samples = list(folder(tmp_path / "same"))
    assert [[cloud.name for cloud in sample.clouds] for sample in samples] == [
        ["north", "south"],
        ["south"],
    ]
    for name in ("north/100.npy", "north/200.npy", "south/101.npy", "south/201.npy"):
        put(tmp_path / "order" / name)
    assert [(sample.name, len(sample.clouds)) for sample in folder(tmp_path / "order")] == [
        ("100", 2),
        ("200", 2),
    ]
    put(tmp_path / "one.npy")
    put(tmp_path / "two.npy")
    assert [sample.name for sample in folder(tmp_path / "one.npy")] == ["one"]


def test_a_name_may_go_on_with_a_number(tmp_path):
    for name in ("scan10.npy", "scan2.npy", "scan.npy", "scan2a.npy"):
        put(tmp_path / name)
    assert [sample.name for sample in folder(tmp_path)] == ["scan", "scan2", "scan2a", "scan10"]
    for name in ("a.npy", "a1.npy", "a/b.npy"):
        put(tmp_path / "deep" / name)
    files = [
        file.relative_to(tmp_path / "deep")
        for file in list_files(tmp_path / "deep", recursive=True)
    ]
    assert [str(file) for file in files] == ["a", "a.npy", "a/b.npy", "a1.npy"]


def test_poses_of_sensors_and_of_moving_ones(tmp_path):
    for name in ("north/0.npy", "car/0.npy", "car/1.npy"):
        put(tmp_path / name)
    poses = {
        "north": pose(10.0).ravel().tolist(),
        "car/0": pose(20.0).ravel().tolist(),
        "1": pose(30.0).ravel().tolist(),
    }
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    first, second = folder(tmp_path)
    assert first.points()[:, 0].tolist() == [21, 11]
    assert second.points()[:, 0].tolist() == [31]


def test_pose_files_may_be_others_inverted_or_missing(tmp_path):
    put(tmp_path / "clouds/0.npy")
    (tmp_path / "p.json").write_text(json.dumps({"lidar": pose(10.0).ravel().tolist()}))
    (sample,) = folder(tmp_path / "clouds", poses=tmp_path / "p.json")
    assert sample.points()[0, 0] == 11
    (sample,) = folder(tmp_path / "clouds", poses=tmp_path / "p.json", inverted=True)
    assert sample.points()[0, 0] == -9
    (tmp_path / "q.json").write_text(json.dumps({"other": pose(10.0).ravel().tolist()}))
    with pytest.raises(ValueError, match="has poses other, but the sensors are lidar"):
        folder(tmp_path / "clouds", poses=tmp_path / "q.json")
    put(tmp_path / "two/north/0.npy")
    put(tmp_path / "two/south/0.npy")
    (tmp_path / "two/poses.json").write_text(json.dumps({"north": pose(1.0).ravel().tolist()}))
    with pytest.raises(ValueError, match="no pose of south/0: the pose file has north"):
        list(folder(tmp_path / "two"))


def test_labels_beside_the_clouds(tmp_path):
    put(tmp_path / "0.npy")
    row = {
        "label": "cyclist",
        "x": 1,
        "y": 2,
        "z": 3,
        "length": 2,
        "width": 1,
        "height": 1.5,
        "yaw_deg": 90,
        "points": 4,
    }
    labels = {"coview": "boxes", "version": 1, "samples": [{"name": "0", "objects": [row]}]}
    (tmp_path / "labels.json").write_text(json.dumps(labels))
    (sample,) = folder(tmp_path)
    np.testing.assert_allclose(sample.objects.boxes, [[1, 2, 3, 2, 1, 1.5, np.pi / 2]])
    assert sample.objects.labels.tolist() == [1]
    assert sample.counts.tolist() == [4]


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("1646667310.044", 1646667310.044),
        ("1646667310044", 1646667310.044),
        ("1646667310044000000", 1646667310.044),
    ],
)
def test_names_that_are_times(name, time):
    assert parse_epoch(name) == pytest.approx(time)


@pytest.mark.parametrize("name", ["000017", "17", "a", "1e30", "nan"])
def test_names_that_are_none(name):
    assert np.isnan(parse_epoch(name))
