"""What the files of a recording say of one another: tokens, numbers of objects, paths, versions and
stamps.

nuScenes' schema has a unique token in each table (https://www.nuscenes.org/nuscenes#data-format);
OpenCOOD merges the agents' objects by their number; a 4x4 pose ends with the row 0 0 0 1."""

import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
import yaml

from toolkit.datasets import frame_labels, problem_kinds, record_values
from toolkit.datasets.layouts import openlabel_transforms, opv2v, rosbag
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

POINTS = np.array([[9.0, 0.5, -4.0], [11.0, -0.5, -4.5]], np.float32)
BOX = [10.0, 0.0, -4.25, 4.2, 1.8, 1.5, 0.0]
START = 1_700_000_000


def write_tables(folder: Path) -> Path:
    """Two frames as nuScenes, the ego vehicle 10 m farther in the second. Returns the tables'
    folder."""
    cloud = SensorCloud("lidar", POINTS, np.eye(4))
    box = Objects(np.array([BOX]), np.zeros(1, np.int64), np.array([4]))
    shown = []
    for k in range(2):
        place = pose(10.0 * k, 0.0, 0.0)
        shown.append(
            Frame.of_clouds(str(k), (cloud,), box, time=START + 0.5 * k, map_SE3_world=place)
        )
    write_recording(shown, folder, "nuscenes")
    return folder / "v1.0-coview"


def change(path: Path, **more: object) -> None:
    path.write_text(json.dumps([row | more for row in json.loads(path.read_text())]))


def test_poses_of_nuscenes_with_one_token_are_refused(tmp_path):
    """tier4/tier4_perception_dataset#296: doubled ego poses; the last one moved every frame."""
    tables = write_tables(tmp_path)
    change(tables / "ego_pose.json", token="a")
    change(tables / "sample_data.json", ego_pose_token="a")
    with pytest.raises(
        ValueError, match=r"ego_pose\.json .* two rows that differ have the token 'a'"
    ):
        open_recording(tmp_path, "nuscenes")
    change(tables / "ego_pose.json", translation=[5.0, 0.0, 0.0], timestamp=0)
    frames = list(open_recording(tmp_path, "nuscenes"))
    assert [frame.map_SE3_world[0, 3] for frame in frames] == [5.0, 5.0]


def test_labels_and_clouds_of_nuscenes_with_one_token_are_all_read(tmp_path):
    """No table refers to their tokens."""
    tables = write_tables(tmp_path)
    for name in ("sample_annotation", "sample_data"):
        change(tables / f"{name}.json", token="a")
    frames = list(open_recording(tmp_path, "nuscenes"))
    assert [(len(frame.clouds), len(frame.objects)) for frame in frames] == [(1, 1), (1, 1)]


def test_of_two_versions_of_nuscenes_the_one_that_is_read_is_said(tmp_path):
    """nutonomy/nuscenes-devkit#977: v1.0-mini next to v1.0-trainval."""
    tables = write_tables(tmp_path)
    shutil.copytree(tables, tmp_path / "v1.0-mini")
    change(tmp_path / "v1.0-mini/ego_pose.json", translation=[7.0, 0.0, 0.0])
    with pytest.warns(
        UserWarning, match=r"v1\.0-coview is read, and not v1\.0-mini: give the folder"
    ):
        open_recording(tmp_path, "nuscenes")
    frames = list(open_recording(tmp_path / "v1.0-mini", "nuscenes"))
    assert [frame.map_SE3_world[0, 3] for frame in frames] == [7.0, 7.0]


@pytest.mark.parametrize("modality", ["LIDAR", "camera"])
def test_modality_of_nuscenes_without_a_lidar_is_refused_with_what_it_has(tmp_path, modality):
    change(write_tables(tmp_path) / "sensor.json", modality=modality)
    if modality == "LIDAR":
        assert len(list(open_recording(tmp_path, "nuscenes"))) == 2
        return
    with pytest.raises(
        ValueError, match="no row of a sensor whose modality is lidar, but of camera"
    ):
        open_recording(tmp_path, "nuscenes")


def test_paths_of_windows_in_nuscenes(tmp_path):
    """open-mmlab/mmdetection3d#2454: converters on Windows join paths with backslashes."""
    table = write_tables(tmp_path) / "sample_data.json"
    rows = json.loads(table.read_text())
    table.write_text(
        json.dumps([row | {"filename": row["filename"].replace("/", "\\")} for row in rows])
    )
    frames = list(open_recording(tmp_path, "nuscenes"))
    assert [len(frame.points()) for frame in frames] == [2, 2]
    table.write_text(json.dumps([row | {"filename": "..\\..\\cloud.bin"} for row in rows]))
    with pytest.raises(ValueError, match="leads out of"):
        list(open_recording(tmp_path, "nuscenes"))


@pytest.mark.parametrize("uri", ["..\\clouds\\lidar1\\7.pcd", "../clouds/lidar1/7.pcd"])
def test_paths_of_windows_in_openlabel(tmp_path, uri):
    for sensor, x in (("lidar1", 3.0), ("lidar2", 9.0)):
        put_cloud(tmp_path / f"clouds/{sensor}/7.pcd", np.array([[x, 0.0, 0.0]], np.float32))
    frame = {
        "frame_properties": {"streams": {"lidar1": {"type": "lidar", "uri": uri}}},
        "objects": {},
    }
    document = {
        "openlabel": {
            "metadata": {"schema_version": "1.0.0"},
            "objects": {},
            "frames": {"0": frame},
        }
    }
    (tmp_path / "labels").mkdir()
    (tmp_path / "labels/a.json").write_text(json.dumps(document))
    (read,) = open_recording(tmp_path, "openlabel")
    assert read.points().tolist() == [[3.0, 0.0, 0.0]]


def put_cloud(path: Path, points: np.ndarray = POINTS) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pcd_bytes(dict(zip("xyz", points.T, strict=True))))


def put_agent(folder: Path, name: str, **vehicle: object) -> None:
    car = {
        "location": [10.0, 0.0, 0.0],
        "center": [0.0, 0.0, 0.7],
        "extent": [2.0, 0.9, 0.7],
        "angle": [0, 0, 0],
    }
    content = {"lidar_pose": [0.0, 0.0, 2.0, 0.0, 0.0, 0.0], "vehicles": {5: car | vehicle}}
    put_cloud(folder / "scene" / name / "00001.pcd")
    (folder / "scene" / name / "00001.yaml").write_text(yaml.safe_dump(content))


@pytest.mark.parametrize(("x", "problems"), [(10.5, {}), (50.0, {opv2v.SAME_NUMBER: 1})])
def test_agents_that_give_two_cars_one_number_are_counted(tmp_path, x, problems):
    """Each agent of a measured set may number its objects anew: car 5 of both is not one car 40 m
    away."""
    put_agent(tmp_path, "1")
    put_agent(tmp_path, "2", location=[x, 0.0, 0.0])
    (frame,) = open_recording(tmp_path, "v2xreal")
    assert frame.problems == problems
    assert frame.objects.boxes[:, 0].tolist() == [10.0]


def test_a_yaw_in_the_place_of_the_pitch_is_counted(tmp_path):
    """DerrickXuNu/v2x-vit#14: angle is roll, yaw, pitch, and not roll, pitch, yaw."""
    put_agent(tmp_path, "1", angle=[0.0, 0.0, 90.0])
    (frame,) = open_recording(tmp_path, "opv2v")
    assert frame.problems == {problem_kinds.TILTED: 1}


def test_vehicles_in_a_list_are_refused_by_name(tmp_path):
    put_agent(tmp_path, "1")
    file = tmp_path / "scene/1/00001.yaml"
    file.write_text(yaml.safe_dump({"lidar_pose": [0.0] * 6, "vehicles": [{"id": 5}]}))
    with pytest.raises(ValueError, match="vehicles must be a mapping of ids to vehicles, got"):
        list(open_recording(tmp_path, "opv2v"))


def test_angles_of_an_openlabel_pose_in_degrees_are_refused():
    """Clause 7.9 of OpenLABEL 1.0.0: euler_angles are radians; 90 of them turned a lidar by 116.6
    degrees."""
    placed = {"euler_angles": [90.0, 0.0, 0.0], "translation": [20.0, 0.0, 5.0]}
    with pytest.raises(ValueError, match="euler_angles of lidar1 must be radians, got"):
        openlabel_transforms.parse_transform(placed, "lidar1")


def test_a_pose_given_by_columns_is_refused(tmp_path):
    """DerrickXuNu/OpenCOOD#170, ucla-mobility/V2V4Real#19: poses are matrices; by columns, the
    place was lost."""
    by_columns = pose(100.0, 50.0, 2.0, yaw=0.3).T
    with pytest.raises(
        ValueError, match=r"lidar_pose must end with the row 0 0 0 1, got \[100.0, 50.0, 2.0, 1.0\]"
    ):
        record_values.rigid_matrix(by_columns.ravel().tolist(), "lidar_pose")
    np.testing.assert_allclose(
        record_values.rigid_matrix(by_columns.T.tolist()), by_columns.T, atol=1e-12
    )


def test_mcap_of_ros_1_names_the_way_out(tmp_path):
    """foxglove/mcap#389, leggedrobotics/kleinkram#1250: `mcap convert` keeps the messages of ROS 1
    as they are."""
    profile, library, data_end, footer = (
        b"ros1",
        b"go",
        struct.pack("<I", 0),
        struct.pack("<QQI", 0, 0, 0),
    )
    header = struct.pack("<I", len(profile)) + profile + struct.pack("<I", len(library)) + library
    parts = [
        struct.pack("<BQ", code, len(body)) + body
        for code, body in ((1, header), (15, data_end), (2, footer))
    ]
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + b"".join(parts) + b"\x89MCAP0\r\n")
    with pytest.raises(ValueError, match=r"not of ROS 2 .* give the \.bag it was made of"):
        open_recording(path, "rosbag")


@pytest.mark.filterwarnings("ignore:.*no place for labels")
def test_clouds_of_a_bag_that_was_played_twice_are_counted(tmp_path):
    cloud = SensorCloud("lidar", POINTS, np.eye(4))
    stamps = [START + 0.5 * (k % 2) for k in range(4)]
    shown = [
        Frame.of_clouds(str(k), (cloud,), Objects.empty(), time=time)
        for k, time in enumerate(stamps)
    ]
    write_recording(shown, tmp_path, "rosbag")
    frames = list(open_recording(tmp_path / "bag", "rosbag"))
    assert len(frames) == 4
    assert frames[0].problems == {rosbag.REPLAYED: 2}


def test_doubled_labels_are_the_same_in_every_number():
    """Against a comparison of every row with every earlier one that is kept."""
    rng = np.random.default_rng(3)
    boxes = np.tile(BOX, (60, 1))
    boxes[:, :2] = rng.integers(0, 4, (60, 2)) * 0.0007
    names = rng.choice(["car", "van"], 60).tolist()
    kept: list[int] = []
    for row, name in enumerate(names):
        same = [
            k
            for k in kept
            if names[k] == name
            and np.abs(boxes[k] - boxes[row]).max() <= frame_labels.MAX_DOUBLED_GAP
        ]
        kept += [] if same else [row]
    problems: problem_kinds.Problems = {}
    found = frame_labels.make_labels(boxes, names, None, problems)
    assert found.objects.ids.tolist() == kept
    assert problems == {problem_kinds.DOUBLED: 60 - len(kept)}
