"""One odd thing at the side of a recording is left out and counted; a remedy names what was
found."""

import json
from pathlib import Path

import numpy as np
import pytest

from toolkit.datasets import cloud_records, problem_kinds
from toolkit.datasets.layouts import dair, nuscenes, openlabel
from toolkit.datasets.recordings import guess_layout, open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

POINTS = np.array([[1.0, 2.0, 0.5], [3.0, -1.0, 0.25]], np.float32)


def frames(count: int = 2) -> list[Frame]:
    objects = Objects(
        np.array([[2.0, 1, 0.5, 4, 2, 1.5, 0.3]]), np.zeros(1, np.int64), np.array([4])
    )
    cloud = SensorCloud("lidar", POINTS, pose(z=1.0))
    return [Frame.of_clouds(str(k), (cloud,), objects, time=1.7e9 + 0.1 * k) for k in range(count)]


def put_cloud(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pcd_bytes(dict(zip("xyz", POINTS.T, strict=True))))


def put_json(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def test_a_camera_of_nuscenes_without_calibration_is_counted(tmp_path):
    """nutonomy/nuscenes-devkit: subsets often lack rows of sensors that nobody uses."""
    write_recording(frames(), tmp_path, "nuscenes")
    table = tmp_path / "v1.0-coview/sample_data.json"
    rows = json.loads(table.read_text())
    camera = rows[0] | {
        "token": "camera",
        "calibrated_sensor_token": "lost",
        "filename": "samples/CAM/0.jpg",
    }
    table.write_text(json.dumps([*rows, camera]))
    first, second = open_recording(tmp_path, "nuscenes")
    assert first.problems == {nuscenes.NO_SENSOR: 1}
    assert second.problems == {}
    assert len(first.clouds) == 1


def test_sweeps_of_nuscenes_that_do_not_say_whether_they_are_key_frames(tmp_path):
    """Ten sweeps belong to one sample; the one at its time is the sample's."""
    write_recording(frames(1), tmp_path, "nuscenes")
    table = tmp_path / "v1.0-coview/sample_data.json"
    (row,) = json.loads(table.read_text())
    del row["is_key_frame"]
    sweeps = [
        row | {"token": f"s{k}", "timestamp": row["timestamp"] + 50_000 * k} for k in (2, 1, 0, -1)
    ]
    table.write_text(json.dumps(sweeps))
    (frame,) = open_recording(tmp_path, "nuscenes")
    assert frame.clouds[0].stamp_s == pytest.approx(1.7e9)
    assert frame.problems == {nuscenes.SWEEPS_BETWEEN: 3}


def test_pairs_of_dair_that_were_not_downloaded_are_counted(tmp_path):
    """AIR-THU/DAIR-V2X: data_info.json lists the whole set, the example set has a few pairs of
    it."""
    level = {"rotation": np.eye(3).tolist(), "translation": [[0], [0], [0]]}
    pairs = []
    for k in range(3):
        name = f"{k:06d}"
        pair = {"infrastructure_pointcloud_path": f"infrastructure-side/velodyne/{name}.pcd"}
        pairs.append(
            pair
            | {
                "vehicle_pointcloud_path": f"vehicle-side/velodyne/{name}.pcd",
                "system_error_offset": "",
            }
        )
        put_json(
            tmp_path / "infrastructure-side/calib/virtuallidar_to_world" / f"{name}.json", level
        )
        for kind in ("lidar_to_novatel", "novatel_to_world"):
            put_json(tmp_path / "vehicle-side/calib" / kind / f"{name}.json", level)
        put_cloud(tmp_path / "infrastructure-side/velodyne" / f"{name}.pcd")
        if k:
            put_cloud(tmp_path / "vehicle-side/velodyne" / f"{name}.pcd")
    put_json(tmp_path / "cooperative/data_info.json", pairs)
    stamps = [
        {"pointcloud_path": f"velodyne/{k:06d}.pcd", "pointcloud_timestamp": f"162615512{k}027000"}
        for k in (1, 2)
    ]
    put_json(tmp_path / "infrastructure-side/data_info.json", stamps)
    late = [
        row | {"pointcloud_timestamp": row["pointcloud_timestamp"][:-6] + "041000"}
        for row in stamps
    ]
    put_json(tmp_path / "vehicle-side/data_info.json", late)
    first, second = open_recording(tmp_path, "dair")
    assert [first.name, second.name] == ["000001", "000002"]
    assert first.problems == {dair.NO_PARTNER: 1}
    assert [cloud.stamp_s for cloud in first.clouds] == [1626155121.027, 1626155121.041]
    assert first.time == 1626155121.027


def test_two_vehicles_by_one_pole_are_two_frames(tmp_path):
    """A pole's cloud that is paired with two vehicles: the second pair must not replace the
    first."""
    level = {"rotation": np.eye(3).tolist(), "translation": [[0], [0], [0]]}
    for vehicle in ("20", "21"):
        put_cloud(tmp_path / f"vehicle-side/velodyne/{vehicle}.pcd")
        for kind in ("lidar_to_novatel", "novatel_to_world"):
            put_json(tmp_path / f"vehicle-side/calib/{kind}/{vehicle}.json", level)
    put_cloud(tmp_path / "infrastructure-side/velodyne/10.pcd")
    put_json(tmp_path / "infrastructure-side/calib/virtuallidar_to_world/10.json", level)
    pairs = [{"infrastructure_frame": "10", "vehicle_frame": vehicle} for vehicle in ("20", "21")]
    put_json(tmp_path / "cooperative/data_info.json", pairs)
    assert [frame.name for frame in open_recording(tmp_path, "dair")] == ["10-20", "10-21"]


def test_json_files_of_another_kind_below_openlabel_are_counted(tmp_path):
    """TUM Traffic keeps calibrations in JSON files next to the labels."""
    write_recording(frames(1), tmp_path, "openlabel")
    put_json(tmp_path / "calib/s110.json", {"intrinsic": [1, 2, 3]})
    (frame,) = open_recording(tmp_path, "openlabel")
    assert frame.problems == {openlabel.NOT_OPENLABEL: 1}
    assert len(frame.objects) == 1
    for name in ("a", "b"):
        put_json(tmp_path / f"none/{name}.json", {"x": 1})
    with pytest.raises(
        ValueError, match=r"no OpenLABEL files, but 2 other \*\.json, such as a\.json"
    ):
        open_recording(tmp_path / "none", "openlabel")


def test_openlabel_in_a_file_called_labels_is_openlabel(tmp_path):
    put_cloud(tmp_path / "labels.pcd")
    put_json(
        tmp_path / "labels.json",
        {"openlabel": {"metadata": {"schema_version": "1.0.0"}, "frames": {"0": {}}}},
    )
    assert guess_layout(tmp_path) == "openlabel"
    write_recording(frames(1), tmp_path / "ours", "folder")
    assert guess_layout(tmp_path / "ours") == "folder"


def test_times_of_points_in_another_unit_are_left_out_and_counted():
    """A sweep takes a tenth of a second; microseconds as floats (velodyne_pointcloud of some forks)
    would be a day."""
    problems: problem_kinds.Problems = {}
    columns = {"positions": POINTS.astype(np.float64), "time": np.array([0.0, 99_000.0])}
    assert cloud_records.build_cloud(columns, "a", np.eye(4), problems).time is None
    assert problems == {problem_kinds.UNTIMED: 1}
    problems = {}
    columns["time"] = np.array([1_700_000_000.0, 1_700_000_000.099])
    time = cloud_records.build_cloud(columns, "a", np.eye(4), problems).time
    assert time is not None
    np.testing.assert_allclose(time, [0, 0.099], atol=1e-6)
    assert problems == {}


@pytest.mark.parametrize(
    ("files", "found"),
    [
        (["a.pts", "b.pts"], r"it holds 2 of \.pts, such as a\.pts: convert them"),
        (["scan/a.PTX"], r"it holds \.PTX, such as scan/a\.PTX: convert them"),
        (["drive.pcap"], r"give the recording in it, .*drive\.pcap"),
        (["a.txt"], r"a\.txt: call them \.xyz or \.csv"),
        (["x/a.e57"], r"a\.e57: convert them"),
        (
            ["a.txt.jpg", "b.jpg", "notes"],
            r"it holds 2 \.jpg, 1 notes: give --layout, or another folder",
        ),
        (["one.hdf5", "two.hdf5"], r"give the recording in it, .*one\.hdf5 or another of its 2"),
        ([], "it holds no files: give --layout, or another folder"),
    ],
)
def test_the_remedy_names_what_a_folder_holds(tmp_path, files, found):
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1.0 -2 3e0 7\n")
    with pytest.raises(FileNotFoundError, match=f"holds no clouds, .*{found}"):
        open_recording(tmp_path)
