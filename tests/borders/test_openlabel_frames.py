"""OpenLABEL 1.0.0 says in which coordinate system a cuboid is, and where each system is.

A car of 4.2 x 1.8 x 1.5 m and 300 points is 10 m before lidar1, which is at (20, 0, 5) and turned
by 90 degrees, so that the car is at (20, 10) in the world and heads along y. Clause 7.9 of the
standard defines the systems and their transforms (X_parent = pose X_child, X_dst = transform
X_src), clause 7.10.1 the cuboid of 9 and 10 numbers."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolkit.boxes import count_points
from toolkit.datasets.layouts import (
    openlabel,
    openlabel_boxes,
    openlabel_clouds,
    openlabel_systems,
    openlabel_transforms,
)
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.frame import Frame
from toolkit.geometry import pose
from toolkit.point_files.pcd import pcd_bytes

LIDAR = pose(20.0, 0.0, 5.0, yaw=np.pi / 2)
ROOT_HALF = float(np.sqrt(0.5))
IN_LIDAR = [10.0, 0.0, -4.25, 0.0, 0.0, 0.0, 1.0, 4.2, 1.8, 1.5]
IN_WORLD = [20.0, 10.0, 0.75, 0.0, 0.0, ROOT_HALF, ROOT_HALF, 4.2, 1.8, 1.5]
BOX = [20.0, 10.0, 0.75, 4.2, 1.8, 1.5, np.pi / 2]

Json = dict[str, Any]


def car() -> np.ndarray:
    """300 points on the car, in lidar1's frame."""
    rng = np.random.default_rng(1)
    return rng.uniform([8, -0.85, -4.95], [12, 0.85, -3.55], (300, 3))


def document(cuboid: Json, pose_of_lidar: Any, **more: Any) -> Json:
    """One frame, a car and an object without object_data."""
    systems = {
        "world": {"type": "scene_cs", "parent": "", "children": ["lidar1"]},
        "lidar1": {
            "type": "sensor_cs",
            "parent": "world",
            "children": [],
            "pose_wrt_parent": pose_of_lidar,
        },
    }
    objects = {"1": {"object_data": {"cuboid": [{"name": "shape", **cuboid}]}}, "2": {}}
    frame = {
        "frame_properties": {"streams": {"lidar1": {"uri": "lidar1/0.pcd"}}},
        "objects": objects,
    }
    kinds = {"1": {"name": "a", "type": "car"}, "2": {"name": "b", "type": "car"}}
    content = {
        "metadata": {"schema_version": "1.0.0"},
        "coordinate_systems": systems,
        "objects": kinds,
    }
    return {"openlabel": content | {"frames": {"0": frame}} | more}


def read(folder: Path, content: Json) -> Frame:
    (folder / "lidar1").mkdir(exist_ok=True)
    columns = dict(zip("xyz", car().astype(np.float32).T, strict=True))
    (folder / "lidar1/0.pcd").write_bytes(pcd_bytes(columns))
    (folder / "labels.json").write_text(json.dumps(content))
    (frame,) = open_recording(folder, "openlabel")
    return frame


def check(frame: Frame) -> None:
    np.testing.assert_allclose(frame.objects.boxes, [BOX], atol=1e-6)
    np.testing.assert_allclose(frame.clouds[0].world_SE3_sensor, LIDAR, atol=1e-6)
    assert frame.clouds[0].name == "lidar1"
    assert count_points(frame.points(), frame.objects.boxes).tolist() == [300]
    assert frame.problems == {}


POSES = {
    "matrix": {"matrix4x4": LIDAR.ravel().tolist()},
    "quaternion": {"quaternion": [0.0, 0.0, ROOT_HALF, ROOT_HALF], "translation": [20.0, 0.0, 5.0]},
    "quaternion of length 2": {
        "quaternion": [0.0, 0.0, 2 * ROOT_HALF, 2 * ROOT_HALF],
        "translation": [20, 0, 5],
    },
    "angles": {"euler_angles": [np.pi / 2, 0.0, 0.0], "translation": [20.0, 0.0, 5.0]},
    "angles XYZ": {
        "euler_angles": [0.0, 0.0, np.pi / 2],
        "sequence": "XYZ",
        "translation": [20.0, 0.0, 5.0],
    },
    "bare matrix": LIDAR.ravel().tolist(),
    "bare rows": LIDAR.tolist(),
}
CUBOIDS = {
    "in lidar1": {"val": IN_LIDAR, "coordinate_system": "lidar1"},
    "in lidar1, angles": {
        "val": [10.0, 0, -4.25, 0, 0, 0, 4.2, 1.8, 1.5],
        "coordinate_system": "lidar1",
    },
    "in world": {"val": IN_WORLD, "coordinate_system": "world"},
    "in world, angles": {
        "val": [20.0, 10, 0.75, 0, 0, np.pi / 2, 4.2, 1.8, 1.5],
        "coordinate_system": "world",
    },
    "in world, quaternion of length 3": {
        "val": [20.0, 10, 0.75, 0, 0, 3 * ROOT_HALF, 3 * ROOT_HALF, 4.2, 1.8, 1.5],
        "coordinate_system": "world",
    },
}


@pytest.mark.parametrize("form", POSES)
@pytest.mark.parametrize("cuboid", CUBOIDS)
def test_300_points_are_in_the_box_in_every_form(tmp_path, form, cuboid):
    check(read(tmp_path, document(CUBOIDS[cuboid], POSES[form])))


def test_an_object_may_name_the_system_for_its_cuboids(tmp_path):
    content = document({"val": IN_LIDAR}, POSES["matrix"])
    content["openlabel"]["objects"]["1"]["coordinate_system"] = "lidar1"
    check(read(tmp_path, content))


def test_poses_go_through_all_parents(tmp_path):
    """world > mast at (20, 0) > lidar1 at height 5, turned; and a tilt that is undone below."""
    content = document(CUBOIDS["in lidar1"], {})
    tilt = Rotation.from_euler("ZYX", [0.3, 0.2, 0.1]).as_quat().tolist()
    untilted = np.linalg.inv(_matrix(Rotation.from_quat(tilt), [20.0, 0, 0])) @ LIDAR
    content["openlabel"]["coordinate_systems"] = {
        "world": {"type": "scene_cs", "parent": "", "children": ["mast"]},
        "mast": {
            "type": "local_cs",
            "parent": "world",
            "children": ["lidar1"],
            "pose_wrt_parent": {"quaternion": tilt, "translation": [20.0, 0, 0]},
        },
        "lidar1": {
            "type": "sensor_cs",
            "parent": "mast",
            "children": [],
            "pose_wrt_parent": {"matrix4x4": untilted.ravel().tolist()},
        },
    }
    check(read(tmp_path, content))


def _matrix(rotation: Rotation, place: list[float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), place
    return matrix


@pytest.mark.parametrize("inverse", [False, True])
def test_a_frames_own_transform_replaces_the_static_pose(tmp_path, inverse):
    """lidar1_to_world as in clause 7.9.2, or the other way round; the static pose is of another
    day."""
    content = document(CUBOIDS["in lidar1"], {"quaternion": [0, 0, 0, 1], "translation": [1, 2, 3]})
    ends = ("world", "lidar1") if inverse else ("lidar1", "world")
    moved = np.linalg.inv(LIDAR) if inverse else LIDAR
    transform = {
        "src": ends[0],
        "dst": ends[1],
        "transform_src_to_dst": {"matrix4x4": moved.ravel().tolist()},
    }
    content["openlabel"]["frames"]["0"]["frame_properties"]["transforms"] = {"a": transform}
    check(read(tmp_path, content))


def test_transforms_may_be_all_that_places_a_sensor(tmp_path):
    """TUMTraf V2X: vehicle_lidar_robosense_to_s110_lidar_ouster_south, without
    coordinate_systems."""
    content = document({"val": IN_WORLD, "coordinate_system": "s110"}, {})
    del content["openlabel"]["coordinate_systems"]
    transform = {
        "src": "lidar1",
        "dst": "s110",
        "transform_src_to_dst": {"matrix4x4": LIDAR.tolist()},
    }
    content["openlabel"]["frames"]["0"]["frame_properties"]["transforms"] = {
        "lidar1_to_s110": transform
    }
    check(read(tmp_path, content))


def test_cuboids_at_the_top_hold_in_their_frame_intervals(tmp_path):
    """Clause 7.5.2: static object data is at the top, with frame_intervals or for all frames."""
    content = document(CUBOIDS["in lidar1"], POSES["matrix"])
    static = content["openlabel"]["frames"]["0"]["objects"].pop("1")["object_data"]
    about = content["openlabel"]["objects"]["1"]
    about["object_data"] = static
    check(read(tmp_path, content))
    about["frame_intervals"] = [{"frame_start": 0, "frame_end": 3}]
    check(read(tmp_path, content))
    about["frame_intervals"] = [{"frame_start": 1, "frame_end": 3}]
    assert len(read(tmp_path, content).objects) == 0


def test_what_the_file_leaves_open_is_counted(tmp_path):
    unnamed = read(tmp_path, document({"val": IN_WORLD}, POSES["matrix"]))
    assert unnamed.problems == {openlabel.NO_FRAME: 1}
    np.testing.assert_allclose(unnamed.objects.boxes, [BOX], atol=1e-6)
    unknown = read(
        tmp_path, document({"val": IN_WORLD, "coordinate_system": "radar"}, POSES["matrix"])
    )
    assert unknown.problems == {openlabel_boxes.UNKNOWN_FRAME: 1}
    assert len(unknown.objects) == 0
    unplaced = read(tmp_path, document(CUBOIDS["in lidar1"], None))
    assert unplaced.problems == {openlabel_systems.NO_POSE: 1}
    content = document(CUBOIDS["in world"], POSES["matrix"])
    content["openlabel"]["coordinate_systems"]["other"] = content["openlabel"][
        "coordinate_systems"
    ].pop("lidar1")
    assert read(tmp_path, content).problems == {openlabel.UNPLACED_SENSOR: 1}
    content = document({"val": IN_WORLD, "coordinate_system": "world"}, POSES["matrix"])
    content["openlabel"]["frames"]["0"]["objects"]["2"] = {
        "object_data": {"poly3d": [{"name": "p", "val": [0, 0, 0]}]}
    }
    assert read(tmp_path, content).problems == {openlabel_boxes.OTHER_SHAPES: 1}
    zero = read(
        tmp_path, document({"val": [*IN_WORLD[:3], 0, 0, 0, 0, 4.2, 1.8, 1.5]}, POSES["matrix"])
    )
    assert zero.problems == {openlabel.NO_FRAME: 1, "labels with NaN or infinite numbers": 1}


@pytest.mark.parametrize(
    ("pose_of_lidar", "message"),
    [
        ({"rodrigues": [0, 0, 1]}, "pose of lidar1"),
        ({"quaternion": [0, 0, 0, 1]}, "no entry translation"),
        (
            {"quaternion": [0, 0, 0, 0], "translation": [0, 0, 0]},
            "pose of lidar1 must turn by a rotation",
        ),
        (
            {"euler_angles": [0, 0, 0], "sequence": "ABC", "translation": [0, 0, 0]},
            "a sequence of X, Y and Z",
        ),
        ({"matrix4x4": [1, 2, 3]}, "pose of lidar1 must be 12 numbers"),
    ],
)
def test_poses_of_other_forms_are_refused_by_name(tmp_path, pose_of_lidar, message):
    with pytest.raises(
        ValueError, match=rf"labels\.json is no OpenLABEL file that can be read: .*{message}"
    ):
        read(tmp_path, document(CUBOIDS["in lidar1"], pose_of_lidar))


@pytest.mark.parametrize(
    "camera", [{"matrix4x4": [[2.0, 0, 0, 0]] * 4}, {"rodrigues": [1]}, [1.0] * 9, "none"]
)
def test_a_camera_whose_pose_cannot_be_read_refuses_nothing(tmp_path, camera):
    """TUM Traffic lists cameras with projections for poses; no cloud and no cuboid is in theirs."""
    content = document(CUBOIDS["in lidar1"], POSES["matrix"])
    systems = content["openlabel"]["coordinate_systems"]
    systems["camera1"] = {
        "type": "sensor_cs",
        "parent": "lidar1",
        "children": [],
        "pose_wrt_parent": camera,
    }
    frame = read(tmp_path, content)
    assert frame.problems == {openlabel_systems.UNREADABLE_POSE: 1}
    np.testing.assert_allclose(frame.objects.boxes, [BOX], atol=1e-6)
    content = document({"val": IN_LIDAR, "coordinate_system": "camera1"}, POSES["matrix"])
    content["openlabel"]["coordinate_systems"]["camera1"] = systems["camera1"]
    with pytest.raises(ValueError, match="camera1"):
        read(tmp_path, content)


def test_transforms_of_vcd_4_have_their_matrix_under_another_name(tmp_path):
    """Vicomtech/video-content-description-VCD, schema 4.3.0: transform_src_to_dst_4x4."""
    content = document(CUBOIDS["in lidar1"], {"quaternion": [0, 0, 0, 1], "translation": [1, 2, 3]})
    transform = {
        "src": "lidar1",
        "dst": "world",
        "transform_src_to_dst_4x4": LIDAR.ravel().tolist(),
    }
    content["openlabel"]["frames"]["0"]["frame_properties"]["transforms"] = {
        "lidar1_to_world": transform
    }
    check(read(tmp_path, content))


def test_types_may_be_those_of_the_frames_objects(tmp_path):
    content = document(CUBOIDS["in lidar1"], POSES["matrix"])
    del content["openlabel"]["objects"]
    content["openlabel"]["frames"]["0"]["objects"]["1"]["type"] = "car"
    check(read(tmp_path, content))


def test_systems_in_a_circle_are_refused_by_name(tmp_path):
    content = document(CUBOIDS["in lidar1"], POSES["matrix"])
    content["openlabel"]["coordinate_systems"]["world"]["parent"] = "lidar1"
    with pytest.raises(ValueError, match="run in a circle"):
        read(tmp_path, content)


def test_angles_are_about_the_axes_as_they_turn():
    """ZYX: first about z, then about the turned y, then about the turned x: R = Rz Ry Rx."""
    angles = [0.4, -0.3, 0.2]
    about = dict(zip("ZYX", angles, strict=True))
    expected = np.eye(3)
    for axis in "ZYX":
        expected = (
            expected @ Rotation.from_rotvec(about[axis] * np.eye(3)["XYZ".index(axis)]).as_matrix()
        )
    found = openlabel_transforms.parse_transform(
        {"euler_angles": angles, "translation": [0, 0, 0]}, "t"
    )
    np.testing.assert_allclose(found[:3, :3], expected, atol=1e-12)
    np.testing.assert_allclose(
        found[:3, :3], pose(yaw=0.4, pitch=-0.3, roll=0.2)[:3, :3], atol=1e-12
    )


def test_a_clouds_sensor_is_told_by_uri_folder_or_name_and_not_by_order(tmp_path):
    """A camera is the first stream, the second lidar is listed first."""
    content = document(CUBOIDS["in world"], POSES["matrix"])
    other = {
        **content["openlabel"]["coordinate_systems"]["lidar1"],
        "pose_wrt_parent": {"matrix4x4": np.eye(4).tolist()},
    }
    content["openlabel"]["coordinate_systems"]["lidar2"] = other
    properties = content["openlabel"]["frames"]["0"]["frame_properties"]
    (tmp_path / "lidar2").mkdir()
    columns = dict(zip("xyz", np.ones((3, 2), np.float32), strict=True))
    (tmp_path / "lidar2/0.pcd").write_bytes(pcd_bytes(columns))
    properties["streams"] = {
        "camera1": {"type": "camera", "uri": "0.png"},
        "lidar2": {"uri": "lidar2/0.pcd"},
        "lidar1": {"uri": "lidar1/0.pcd"},
    }
    frame = read(tmp_path, content)
    assert [(cloud.name, len(cloud.points)) for cloud in frame.clouds] == [
        ("lidar2", 2),
        ("lidar1", 300),
    ]
    content["openlabel"]["streams"] = {
        "camera1": {"type": "camera"},
        "lidar2": {"type": "lidar"},
        "lidar1": {},
    }
    properties["streams"] = {"camera1": {}, "lidar2": {}, "lidar1": {}}
    properties["point_cloud_file_names"] = ["lidar1/0.pcd", "lidar2/0.pcd"]
    frame = read(tmp_path, content)
    assert [(cloud.name, len(cloud.points)) for cloud in frame.clouds] == [
        ("lidar1", 300),
        ("lidar2", 2),
    ]
    assert frame.problems == {}
    properties["streams"] = {"a": {}, "b": {}}
    del content["openlabel"]["coordinate_systems"], content["openlabel"]["streams"]
    frame = read(tmp_path, content)
    assert [(cloud.name, len(cloud.points)) for cloud in frame.clouds] == [("a", 300), ("b", 2)]
    assert frame.problems == {openlabel_clouds.STREAM_BY_ORDER: 2}


def test_a_cloud_beside_its_labels_is_of_the_files_only_sensor(tmp_path):
    content = document(CUBOIDS["in lidar1"], POSES["matrix"])
    content["openlabel"]["frames"]["0"]["frame_properties"] = {}
    columns = dict(zip("xyz", car().astype(np.float32).T, strict=True))
    (tmp_path / "7.pcd").write_bytes(pcd_bytes(columns))
    (tmp_path / "7.json").write_text(json.dumps(content))
    (frame,) = open_recording(tmp_path, "openlabel")
    assert frame.clouds[0].name == "lidar1"
    assert count_points(frame.points(), frame.objects.boxes).tolist() == [300]
    assert frame.problems == {openlabel_clouds.ONLY_SENSOR: 1}


def test_what_is_written_is_the_standards_own_form(tmp_path):
    """Read by hand: type at the top, a list of cuboids that name their system, and only members of
    the schema."""
    frame = read(tmp_path, document(CUBOIDS["in lidar1"], POSES["matrix"]))
    write_recording([frame], tmp_path / "out", "openlabel")
    content = json.loads((tmp_path / "out/labels_point_clouds/000000.json").read_text())[
        "openlabel"
    ]
    assert content["objects"]["1"] == {"name": "CAR_1", "type": "CAR"}
    assert content["coordinate_systems"]["world"] == {
        "type": "scene_cs",
        "parent": "",
        "children": ["lidar1"],
    }
    matrix = content["coordinate_systems"]["lidar1"]["pose_wrt_parent"]["matrix4x4"]
    np.testing.assert_allclose(np.reshape(matrix, (4, 4)), LIDAR, atol=1e-12)
    shown = content["frames"]["0"]
    assert set(shown["objects"]["1"]["object_data"]) == {"cuboid"}
    (cuboid,) = shown["objects"]["1"]["object_data"]["cuboid"]
    assert cuboid["coordinate_system"] == "world"
    np.testing.assert_allclose(cuboid["val"], IN_WORLD, atol=1e-6)
    uri = shown["frame_properties"]["streams"]["lidar1"]["uri"]
    assert (tmp_path / "out/labels_point_clouds" / uri).is_file()
    check(next(iter(open_recording(tmp_path / "out", "openlabel"))))
