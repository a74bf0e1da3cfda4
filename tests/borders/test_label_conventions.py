"""Labels in each format's convention, packed by hand: one car, one box; what says another
convention is refused.

The car is 4.5 m long, 1.8 m wide and 1.5 m high, 12 m ahead of the lidar and 3 m to its left, and
turned by 30 degrees to the left. Its centre is 1 m below the lidar."""

import json
from pathlib import Path

import numpy as np
import pytest

from toolkit.datasets.layouts import openlabel
from toolkit.datasets.problem_kinds import FULL_TURNS
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

YAW = np.deg2rad(30)
BOX = np.array([[12.0, 3.0, -1.0, 4.5, 1.8, 1.5, YAW]])
POINTS = np.array([[12.0, 3.0, -1.0], [11.0, 2.5, -0.5]], np.float32)


def recording(tmp_path: Path, layout: str) -> Path:
    cloud = SensorCloud("lidar", POINTS, np.eye(4))
    write_recording([Frame.of_clouds("0", (cloud,), Objects(BOX), time=1.7e9)], tmp_path, layout)
    return tmp_path


def read(path: Path, layout: str) -> Frame:
    (frame,) = open_recording(path, layout)
    return frame


def test_kitti_has_the_floors_centre_in_the_camera_and_turns_about_its_y(tmp_path):
    """Camera x right, y down, z forward: (-3, 1 + 0.75, 12); h w l; ry is 0 to the right, so -(90 +
    30) degrees."""
    path = recording(tmp_path, "kitti")
    row = f"Car 0 0 0 500 150 600 250 1.5 1.8 4.5 -3 1.75 12 {-np.pi / 2 - YAW:.9f}\n"
    (path / "training/label_2/000000.txt").write_text(row)
    np.testing.assert_allclose(read(path, "kitti").objects.boxes, BOX, atol=1e-6)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0 1 Car 0 0 0 500 150 600 250 1.5 1.8 4.5 -3 1.75 12 -1\n", "17: it is KITTI's tracking"),
        ("Car 0 0 0 500 150 600 250 1.5 1.8 4.5 -3 1.75\n", "15 or 16 entries, got 13$"),
    ],
)
def test_kitti_rows_of_other_lengths_are_refused_by_name(tmp_path, row, message):
    path = recording(tmp_path, "kitti")
    (path / "training/label_2/000000.txt").write_text(row)
    with pytest.raises(ValueError, match=rf"000000\.txt is no list of labels .*{message}"):
        read(path, "kitti")


def test_kitti_labels_without_a_calibration_are_refused_by_name(tmp_path):
    """Their boxes are in the camera's frame, and only calib/ says where the camera is."""
    path = recording(tmp_path, "kitti")
    (path / "training/calib/000000.txt").unlink()
    with pytest.raises(
        FileNotFoundError, match=r"no calibration .*calib/000000\.txt: the boxes .* camera's frame"
    ):
        read(path, "kitti")


def test_dair_has_the_boxs_centre_strings_and_radians(tmp_path):
    path = recording(tmp_path, "dair")
    row = {"type": "Car", "3d_location": {"x": "12", "y": "3", "z": "-1"}, "rotation": str(YAW)}
    row["3d_dimensions"] = {"h": "1.5", "w": "1.8", "l": "4.5"}
    (path / "label/virtuallidar/000000.json").write_text(json.dumps([row]))
    np.testing.assert_allclose(read(path, "dair").objects.boxes, BOX, atol=1e-9)
    (path / "label/virtuallidar/000000.json").write_text(json.dumps([row | {"rotation": "30"}]))
    assert read(path, "dair").problems == {FULL_TURNS: 1}


@pytest.mark.parametrize("folder", ["label_world", "label"])
def test_pairs_of_dair_are_labelled_in_the_world_and_those_of_v2x_seq_in_the_vehicles_lidar(
    tmp_path, folder
):
    """AIR-THU/DAIR-V2X-Seq#23: cooperative labels are in the vehicle's lidar frame. It is 30 m
    north of the pole."""
    level = np.eye(3).tolist()
    places = {
        "infrastructure-side/calib/virtuallidar_to_world/10.json": [1000.0, 2000.0, 20.0],
        "vehicle-side/calib/novatel_to_world/20.json": [1000.0, 2030.0, 18.0],
        "vehicle-side/calib/lidar_to_novatel/20.json": [0.0, 0.0, 2.0],
    }
    pair = {
        "infrastructure_frame": "10",
        "vehicle_frame": "20",
        "system_error_offset": {"delta_x": 0, "delta_y": 0},
    }
    centre = (
        {"x": 1012.0, "y": 2003.0, "z": 19.0}
        if folder == "label_world"
        else {"x": 12, "y": -27, "z": -1}
    )
    row = {
        "type": "Car",
        "3d_location": centre,
        "rotation": YAW,
        "3d_dimensions": {"h": 1.5, "w": 1.8, "l": 4.5},
    }
    contents: dict[str, object] = {
        name: {"rotation": level, "translation": [[x] for x in place]}
        for name, place in places.items()
    }
    contents |= {"cooperative/data_info.json": [pair], f"cooperative/{folder}/20.json": [row]}
    for name, content in contents.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(json.dumps(content))
    for name in ("infrastructure-side/velodyne/10.pcd", "vehicle-side/velodyne/20.pcd"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_bytes(pcd_bytes(dict(zip("xyz", POINTS.T, strict=True))))
    np.testing.assert_allclose(read(tmp_path, "dair").objects.boxes, BOX, atol=1e-9)


def test_nuscenes_has_width_first_and_w_first(tmp_path):
    """A quarter turn more about z would be (0.7071, 0, 0, 0.7071) as w x y z."""
    path = recording(tmp_path, "nuscenes")
    table = path / "v1.0-coview/sample_annotation.json"
    (row,) = json.loads(table.read_text())
    turned = [float(np.cos(YAW / 2)), 0.0, 0.0, float(np.sin(YAW / 2))]
    table.write_text(
        json.dumps(
            [row | {"size": [1.8, 4.5, 1.5], "rotation": turned, "translation": [12, 3, -1]}]
        )
    )
    np.testing.assert_allclose(read(path, "nuscenes").objects.boxes, BOX, atol=1e-9)


def test_sustech_has_length_first_and_radians(tmp_path):
    path = recording(tmp_path, "sustech")
    psr = {
        "position": {"x": 12, "y": 3, "z": -1},
        "scale": {"x": 4.5, "y": 1.8, "z": 1.5},
        "rotation": {"x": 0, "y": 0, "z": YAW},
    }
    row = {"obj_id": "1", "obj_type": "Car", "psr": psr}
    (path / "label/000000.json").write_text(json.dumps([row]))
    np.testing.assert_allclose(read(path, "sustech").objects.boxes, BOX, atol=1e-9)
    psr["rotation"] = {"x": 0, "y": 0, "z": 30}
    (path / "label/000000.json").write_text(json.dumps([row]))
    assert read(path, "sustech").problems == {FULL_TURNS: 1}


@pytest.mark.parametrize(("layout", "side"), [("opv2v", -1), ("v2xset", -1), ("v2xreal", 1)])
def test_opencood_has_halves_degrees_and_its_own_hand(tmp_path, layout, side):
    """CARLA is left-handed: y and yaw change their signs. V2X-Real is measured, right-handed."""
    import yaml

    path = recording(tmp_path, layout)
    file = path / "scenario/0/00000.yaml"
    content = yaml.safe_load(file.read_text())
    vehicle = {
        "angle": [0, side * 30.0, 0],
        "center": [0, 0, 0.75],
        "location": [12, side * 3.0, -1.75],
    }
    content["vehicles"] = {7: vehicle | {"extent": [2.25, 0.9, 0.75], "obj_type": "Car"}}
    file.write_text(yaml.safe_dump(content))
    np.testing.assert_allclose(read(path, layout).objects.boxes, BOX, atol=1e-9)


def test_argoverse_has_w_first_and_length_first(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import feather

    path = recording(tmp_path, "argoverse")
    columns = feather.read_table(path / "annotations.feather").to_pydict()
    pose = {
        "qw": np.cos(YAW / 2),
        "qx": 0.0,
        "qy": 0.0,
        "qz": np.sin(YAW / 2),
        "tx_m": 12.0,
        "ty_m": 3.0,
        "tz_m": -1.0,
    }
    sizes = {"length_m": 4.5, "width_m": 1.8, "height_m": 1.5}
    columns |= {name: [value] for name, value in (pose | sizes).items()}
    feather.write_feather(pyarrow.table(columns), path / "annotations.feather")
    np.testing.assert_allclose(read(path, "argoverse").objects.boxes, BOX, atol=1e-9)


def test_labels_json_has_degrees_and_only_the_world_frame(tmp_path):
    path = recording(tmp_path, "folder")
    labels = path / "labels.json"
    content = json.loads(labels.read_text())
    (row,) = content["samples"][0]["objects"]
    assert row["yaw_deg"] == pytest.approx(30)
    labels.write_text(json.dumps(content | {"frame": "lidar"}))
    with pytest.raises(
        ValueError,
        match=r"labels\.json .* must be in the frame world, got 'lidar': move them by poses",
    ):
        read(path, "folder")
    del row["yaw_deg"]
    row["yaw"] = 0.5
    labels.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="no entry yaw_deg"):
        read(path, "folder")


def test_angles_of_openlabel_in_degrees_are_counted(tmp_path):
    path = recording(tmp_path, "openlabel")
    file = path / "labels_point_clouds/000000.json"
    content = json.loads(file.read_text())
    (shown,) = content["openlabel"]["frames"]["0"]["objects"].values()
    (cuboid,) = shown["object_data"]["cuboid"]
    cuboid["val"] = [12, 3, -1, 0, 0, YAW, 4.5, 1.8, 1.5]
    file.write_text(json.dumps(content))
    np.testing.assert_allclose(read(path, "openlabel").objects.boxes, BOX, atol=1e-9)
    cuboid["val"][5] = 30
    file.write_text(json.dumps(content))
    assert read(path, "openlabel").problems == {FULL_TURNS: 1}
    assert openlabel.NO_FRAME not in read(path, "openlabel").problems
