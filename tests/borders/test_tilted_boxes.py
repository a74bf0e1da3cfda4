"""Boxes keep their heading whatever frame their rotation is given in, and a rotation that no road
has is counted.

Rotations in full: OpenLABEL 1.0.0 clause 7.10 (quaternion x y z w), nuScenes and Argoverse 2 (w x y
z), SUSTechPOINTS (angles about x, the turned y, the turned z, as three.js has them)."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolkit.boxes import count_points
from toolkit.datasets.layouts.argoverse import argoverse
from toolkit.datasets.layouts.nuscenes import nuscenes
from toolkit.datasets.layouts.openlabel import openlabel
from toolkit.datasets.layouts.sustech import sustech
from toolkit.datasets.problem_kinds import DOUBLED_CLOUDS, TILTED
from toolkit.datasets.recordings import write_recording
from toolkit.doctor.diagnosis import diagnose
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, pose, transform
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

YAW = np.deg2rad(30)
SIZE = np.array([4.2, 1.8, 1.5])
CAR = np.array([10.0, 3.0, 0.75, *SIZE, YAW])
COUNT = 300


def car_points() -> np.ndarray:
    inside = np.random.default_rng(4).uniform(-0.49, 0.49, (COUNT, 3)) * SIZE
    return transform(pose(*CAR[:3], yaw=YAW), inside)


def put_cloud(path: Path, points: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pcd_bytes(dict(zip("xyz", points.astype(np.float32).T, strict=True))))


LOOKING_DOWN = pose(1.0, 2.0, 6.0, yaw=0.7, pitch=np.deg2rad(40), roll=np.deg2rad(15))
CAMERA = pose(1.0, 2.0, 6.0) @ np.array(
    [[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
)


@pytest.mark.parametrize("sensor_pose", [LOOKING_DOWN, CAMERA])
def test_cuboid_in_the_frame_of_a_tilted_lidar_or_a_camera(tmp_path, sensor_pose):
    """A cuboid of OpenLABEL turns in full: level in the world, it is tilted in its sensor's
    axes."""
    placed = invert(sensor_pose) @ pose(*CAR[:3], yaw=YAW)
    turned = Rotation.from_matrix(placed[:3, :3]).as_quat().tolist()
    cuboid = {
        "name": "b",
        "coordinate_system": "tilted",
        "val": [*placed[:3, 3].tolist(), *turned, *SIZE],
    }
    put_cloud(tmp_path / "lidar.pcd", car_points())
    systems = {
        "world": {"type": "scene_cs", "parent": ""},
        "lidar": {
            "type": "sensor_cs",
            "parent": "world",
            "pose_wrt_parent": {"matrix4x4": np.eye(4).ravel().tolist()},
        },
        "tilted": {
            "type": "sensor_cs",
            "parent": "world",
            "pose_wrt_parent": {"matrix4x4": sensor_pose.ravel().tolist()},
        },
    }
    frame = {
        "frame_properties": {"point_cloud_file_names": ["lidar.pcd"]},
        "objects": {"1": {"object_data": {"cuboid": [cuboid]}}},
    }
    content = {
        "metadata": {},
        "coordinate_systems": systems,
        "objects": {"1": {"name": "c", "type": "car"}},
    }
    (tmp_path / "a.json").write_text(json.dumps({"openlabel": content | {"frames": {"0": frame}}}))
    (read,) = openlabel(tmp_path)
    np.testing.assert_allclose(read.objects.boxes, [CAR], atol=1e-6)
    assert not read.problems


def write_one(tmp_path: Path, layout: str, points: np.ndarray) -> Path:
    cloud = SensorCloud("lidar", points.astype(np.float32), np.eye(4))
    write_recording(
        [Frame.of_clouds("0", (cloud,), Objects(CAR[None]), time=1.7e9)], tmp_path, layout
    )
    return tmp_path


def test_nuscenes_quaternions_with_w_last_are_counted(tmp_path):
    """nutonomy/nuscenes-devkit#652: rotations are w x y z; scipy and ROS write x y z w."""
    root = write_one(tmp_path, "nuscenes", car_points())
    table = root / "v1.0-coview/sample_annotation.json"
    rows = json.loads(table.read_text())
    w, x, y, z = rows[0]["rotation"]
    rows[0]["rotation"] = [x, y, z, w]
    table.write_text(json.dumps(rows))
    (frame,) = nuscenes(root)
    assert frame.problems[TILTED] == 1
    assert any(finding.suspected == TILTED for finding in diagnose(root, "nuscenes").findings)


def test_nuscenes_ego_pose_of_a_lidar_that_looks_down(tmp_path):
    """A roadside set may name its tilted lidar as the ego frame: boxes, which have only a heading,
    need a level one."""
    root = write_one(tmp_path, "nuscenes", transform(invert(LOOKING_DOWN), car_points()))
    table = root / "v1.0-coview/ego_pose.json"
    w, x, y, z = Rotation.from_matrix(LOOKING_DOWN[:3, :3]).as_quat()[[3, 0, 1, 2]].tolist()
    rows = json.loads(table.read_text())
    rows[0] |= {"rotation": [w, x, y, z], "translation": LOOKING_DOWN[:3, 3].tolist()}
    table.write_text(json.dumps(rows))
    (frame,) = nuscenes(root)
    assert count_points(frame.points(), frame.objects.boxes).tolist() == [COUNT]


def test_argoverse_counts_the_points_of_boxes_that_it_writes(tmp_path):
    """av2's evaluation leaves out cuboids whose num_interior_pts is 0, so 0 must not stand for
    unknown."""
    root = write_one(tmp_path, "argoverse", car_points())
    (frame,) = argoverse(root)
    assert frame.counts is not None
    assert frame.counts.tolist() == [COUNT]


def test_sustech_box_that_is_turned_over(tmp_path):
    """rotation (pi, 0, -30 degrees) is a box upside down whose front points 30 degrees to the
    left."""
    put_cloud(tmp_path / "lidar/0.pcd", car_points())
    (tmp_path / "lidar/0.bin").write_bytes(np.zeros((1, 4), "<f4").tobytes())
    (tmp_path / "label").mkdir()
    psr = {
        "position": dict(zip("xyz", CAR[:3].tolist(), strict=True)),
        "scale": dict(zip("xyz", SIZE.tolist(), strict=True)),
        "rotation": {"x": np.pi, "y": 0, "z": -YAW},
    }
    labels = [{"obj_id": "1", "obj_type": "Car", "psr": psr}]
    (tmp_path / "label/0.json").write_text(json.dumps(labels))
    (frame,) = sustech(tmp_path)
    np.testing.assert_allclose(frame.objects.boxes, [CAR], atol=1e-9)
    assert frame.problems == {DOUBLED_CLOUDS: 1, TILTED: 1}
