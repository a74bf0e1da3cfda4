"""Situations out of public reports about recordings, made by hand: read right, refused by name, or
counted.

Each test names the report's repository and number."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from toolkit.boxes import count_points
from toolkit.datasets import problem_kinds
from toolkit.datasets.clock_times import UNPAIRED
from toolkit.datasets.layouts import bag_messages, kitti, nuscenes, opv2v, rosbag
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose, transform
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

POINTS = np.array([[9.0, 0.5, -4.0], [11.0, -0.5, -4.5]], np.float32)
BOX = [10.0, 0.0, -4.25, 4.2, 1.8, 1.5, 0.0]
Content = Any


def frames(count: int = 2, **more: Any) -> list[Frame]:
    cloud = SensorCloud("lidar", POINTS, np.eye(4))
    box = Objects(np.array([BOX]), np.zeros(1, np.int64), np.array([4]))
    return [
        Frame.of_clouds(str(k), (cloud,), box, time=1.7e9 + 0.1 * k, **more) for k in range(count)
    ]


def put_cloud(path: Path, points: np.ndarray = POINTS) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pcd_bytes(dict(zip("xyz", points.T, strict=True))))


def put_json(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def change_table(path: Path, change: dict[str, object]) -> None:
    path.write_text(json.dumps([row | change for row in json.loads(path.read_text())]))


def test_nuscenes_poses_in_utm_keep_their_millimetres(tmp_path):
    """nutonomy/nuscenes-devkit#1182: points of a devkit that adds UTM translations in float32 lose
    their rings."""
    write_recording(
        frames(1, map_SE3_world=pose(692000.25, 5336000.5, 520.0, yaw=0.7)), tmp_path, "nuscenes"
    )
    (frame,) = open_recording(tmp_path, "nuscenes")
    assert count_points(frame.points(), frame.objects.boxes).tolist() == [2]
    centre = transform(frame.map_SE3_world, frame.objects.boxes[:, :3])
    expected = transform(pose(692000.25, 5336000.5, 520.0, yaw=0.7), np.array([BOX[:3]]))
    np.testing.assert_allclose(centre, expected, atol=1e-6)


@pytest.mark.parametrize("stamp", [1700000000250000, 1700000000250000000, 1700000000250])
def test_nuscenes_times_of_converters_in_other_units(tmp_path, stamp):
    """open-mmlab/mmdetection3d#976: sets in nuScenes' form made by others; nanoseconds are no year
    55,000."""
    write_recording(frames(1), tmp_path, "nuscenes")
    for name in ("sample", "sample_data"):
        change_table(tmp_path / f"v1.0-coview/{name}.json", {"timestamp": stamp})
    (frame,) = open_recording(tmp_path, "nuscenes")
    expected = 1700000000.25 if stamp > 1e15 else stamp * 1e-6
    assert frame.time == pytest.approx(expected)


def test_nuscenes_times_that_number_the_frames_are_none(tmp_path):
    """coperception/coperception#22 (V2X-Sim): `"timestamp": 6` numbers the frames, which are no
    microseconds apart."""
    write_recording(frames(3), tmp_path, "nuscenes")
    for name in ("sample", "sample_data"):
        path = tmp_path / f"v1.0-coview/{name}.json"
        rows = json.loads(path.read_text())
        path.write_text(json.dumps([row | {"timestamp": k + 6} for k, row in enumerate(rows)]))
    read = list(open_recording(tmp_path, "nuscenes"))
    assert [frame.name for frame in read] == ["000000", "000001", "000002"]
    assert np.isnan([frame.time for frame in read]).all()
    assert all(frame.clouds[0].stamp_s is None for frame in read)
    assert [frame.problems for frame in read] == [{nuscenes.NO_CLOCK: 3}, {}, {}]


def test_lidars_of_several_agents_in_nuscenes_form(tmp_path):
    """coperception/coperception#22 (V2X-Sim): channels LIDAR_TOP_id_1 and on, each with the ego
    pose of its vehicle."""
    write_recording(frames(1), tmp_path, "nuscenes")
    tables = tmp_path / "v1.0-coview"
    sensor, mount, data, ego = (
        tables / f"{n}.json" for n in ("sensor", "calibrated_sensor", "sample_data", "ego_pose")
    )
    for path, changes in (
        (sensor, {"token": "s2", "channel": "LIDAR_TOP_id_2"}),
        (mount, {"token": "m2", "sensor_token": "s2"}),
        (ego, {"token": "e2", "translation": [100.0, 0, 0]}),
        (data, {"token": "d2", "calibrated_sensor_token": "m2", "ego_pose_token": "e2"}),
    ):
        (row,) = json.loads(path.read_text())
        path.write_text(json.dumps([row, row | changes]))
    (frame,) = open_recording(tmp_path, "nuscenes")
    assert [cloud.name for cloud in frame.clouds] == ["LIDAR_lidar", "LIDAR_TOP_id_2"]
    np.testing.assert_allclose(frame.points()[2:, 0] - frame.points()[:2, 0], [100, 100], atol=1e-4)


def test_labels_of_railway_scenes_with_uuids_and_streams(tmp_path):
    """dbinfrago/raillabel#14 (OSDaR23): a quaternion and a translation, UUIDs, times as text, uri
    of streams."""
    uid = "5d669fa1-5725-4e53-956b-f1cb8673c160"
    turned = [0.0, 0.0, float(np.sin(0.1)), float(np.cos(0.1))]
    systems = {
        "base": {"type": "local", "parent": "", "children": ["lidar"]},
        "lidar": {
            "type": "sensor",
            "parent": "base",
            "pose_wrt_parent": {"quaternion": turned, "translation": [2, 0, 3]},
        },
    }
    cuboid = {
        "name": "lidar__cuboid__car",
        "coordinate_system": "lidar",
        "val": [10, 0, -4.25, 0, 0, 0, 1, 4.2, 1.8, 1.5],
    }
    sync = {"stream_properties": {"sync": {"timestamp": "1631691173.709000000"}}}
    streams = {
        "rgb_center": {"uri": "/rgb_center/012.png"},
        "lidar": {"uri": "/lidar/012_1631691173.709.pcd", **sync},
    }
    shown = {"frame_properties": {"timestamp": "1631691173.8", "streams": streams}}
    content = {
        "metadata": {"schema_version": "1.0.0"},
        "coordinate_systems": systems,
        "streams": {"rgb_center": {"type": "camera"}, "lidar": {"type": "lidar"}},
        "objects": {uid: {"name": "car0001", "type": "car"}},
        "frames": {"12": shown | {"objects": {uid: {"object_data": {"cuboid": [cuboid]}}}}},
    }
    put_json(tmp_path / "labels.json", {"openlabel": content})
    put_cloud(tmp_path / "lidar/012_1631691173.709.pcd")
    (frame,) = open_recording(tmp_path, "openlabel")
    assert count_points(frame.points(), frame.objects.boxes).tolist() == [2]
    assert [cloud.name for cloud in frame.clouds] == ["lidar"]
    assert frame.clouds[0].stamp_s == 1631691173.709
    assert frame.time == 1631691173.8
    assert frame.problems == {}


def test_angles_of_railway_cuboids_tilt_the_box_but_not_its_heading(tmp_path):
    """Vicomtech/SOSDaR24#2: nine numbers, whose rotation is not about z alone."""
    write_recording(frames(1), tmp_path, "openlabel")
    path = tmp_path / "labels_point_clouds/000000.json"
    content = json.loads(path.read_text())
    (shown,) = content["openlabel"]["frames"]["0"]["objects"].values()
    shown["object_data"]["cuboid"][0]["val"] = [10, 0, -4.25, 0.02, -0.03, 0.5, 4.2, 1.8, 1.5]
    put_json(path, content)
    (frame,) = open_recording(tmp_path, "openlabel")
    assert frame.objects.boxes[0, 6] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(
    "layout", ["folder", "kitti", "dair", "sustech", "openlabel", "opv2v", "argoverse"]
)
def test_files_that_macos_adds_to_archives_are_no_frames(tmp_path, layout):
    """bids-standard/pybids#1069, python/cpython#113356: `._NAME` and __MACOSX next to the data."""
    pytest.importorskip("pyarrow" if layout == "argoverse" else "numpy")
    write_recording(frames(), tmp_path, layout)
    for file in [file for file in tmp_path.rglob("*") if file.is_file()]:
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\x16\7")
    shutil.copytree(tmp_path, tmp_path.parent / "copy")
    shutil.move(tmp_path.parent / "copy", tmp_path / "__MACOSX")
    read = list(open_recording(tmp_path, layout))
    assert [len(frame.points()) for frame in read] == [2, 2]
    kinds = {kind for frame in read for kind in frame.problems}
    assert kinds <= {kitti.NONE_SHOWN}  # the box is below the image of the camera that is written


def test_a_cloud_under_two_endings_is_taken_once_and_counted(tmp_path):
    """naurril/SUSTechPOINTS#100: clouds converted from .bin to .pcd, both left in the folder."""
    write_recording(frames(), tmp_path, "folder")
    for name in ("000000", "000001"):
        np.save(tmp_path / f"lidar/{name}.npy", 2 * POINTS)
    first, second = open_recording(tmp_path, "folder")
    assert first.problems == {problem_kinds.DOUBLED_CLOUDS: 2}
    assert second.problems == {}
    np.testing.assert_allclose(first.points(), POINTS, atol=1e-6)


def test_an_agent_without_its_yaml_at_one_tick_is_counted(tmp_path):
    """DerrickXuNu/OpenCOOD#167: a scenario that lacks files of one sensor."""
    cloud = frames()[0].clouds[0]
    two = (cloud, SensorCloud("second", POINTS, pose(5.0)))
    write_recording([frame.with_clouds(two) for frame in frames()], tmp_path, "opv2v")
    (tmp_path / "scenario/1/00001.yaml").unlink()
    first, second = open_recording(tmp_path, "opv2v")
    assert first.problems == {opv2v.NO_YAML: 1}
    assert second.problems == {UNPAIRED: 1}
    assert [len(frame.clouds) for frame in (first, second)] == [2, 1]


def test_numbers_of_yaml_that_are_text_are_numbers(tmp_path):
    """yaml/pyyaml#173: 1e-05 is a text by YAML 1.1, as OPV2V's files have it."""
    write_recording(frames(1), tmp_path, "opv2v")
    path = tmp_path / "scenario/0/00000.yaml"
    content = yaml.safe_load(path.read_text())
    content["lidar_pose"] = [0, 0, 0, "1e-05", "0", "-1e-05"]
    path.write_text(yaml.safe_dump(content))
    (frame,) = open_recording(tmp_path, "opv2v")
    np.testing.assert_allclose(frame.points(), POINTS, atol=1e-4)


def test_poses_and_labels_in_utm_are_written_in_full(tmp_path):
    """koide3/hdl_graph_slam#182: 5572094.155411 written as 5.57209e+06 moves a map by metres."""
    place = np.array([691234.1554, 5572094.155411, 333.125])
    cloud = SensorCloud("lidar", POINTS, pose(*place))
    box = Objects(np.array([[*(place + BOX[:3]), *BOX[3:]]]))
    write_recording([Frame.of_clouds("0", (cloud,), box)], tmp_path, "folder")
    (frame,) = open_recording(tmp_path, "folder")
    assert frame.clouds[0].world_SE3_sensor[:3, 3].tolist() == place.tolist()
    np.testing.assert_allclose(frame.objects.boxes[0, :3], place + BOX[:3], rtol=0, atol=1e-9)


def test_clouds_of_a_map_grid_of_100_km_keep_their_centimetres(tmp_path):
    """autowarefoundation/autoware_universe#3090: MGRS coordinates of (88096, 48996) in float, 8 mm
    apart."""
    put_cloud(tmp_path / "map/0.pcd", POINTS + np.array([88096.0, 48996.0, 30.0], np.float32))
    (frame,) = open_recording(tmp_path, "folder")
    assert frame.problems == {problem_kinds.UNPLACED: 1}
    np.testing.assert_allclose(frame.points(), POINTS + np.array([88096, 48996, 30]), atol=0.005)
    np.testing.assert_allclose(frame.sensors[0].position[:2], [88106, 48996], atol=1)


def test_times_of_labels_in_milliseconds_are_milliseconds(tmp_path):
    """segments-ai/segments-ai#188: exports with timestamps in other units than seconds."""
    write_recording(frames(), tmp_path, "folder")
    path = tmp_path / "labels.json"
    content = json.loads(path.read_text())
    for k, sample in enumerate(content["samples"]):
        sample["time"] = 1700000000004 + 100 * k
        sample["clouds"] = {"lidar": str(1700000000004000000 + 10**8 * k)}
    put_json(path, content)
    read = list(open_recording(tmp_path, "folder"))
    np.testing.assert_allclose(
        [frame.time for frame in read], [1700000000.004, 1700000000.104], atol=1e-6
    )
    assert [frame.clouds[0].stamp_s for frame in read] == pytest.approx(
        [1700000000.004, 1700000000.104]
    )


@pytest.fixture
def bags():
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2, typesys

    return rosbag1, rosbag2, typesys


def make_cloud(
    store: Content, stamp: int, fields: list[tuple[str, int, int]], row: np.dtype, table: np.ndarray
) -> Content:
    types = store.types
    time = types["builtin_interfaces/msg/Time"](sec=stamp, nanosec=0)
    seq = {"seq": 0} if "seq" in str(store.fielddefs["std_msgs/msg/Header"]) else {}
    head = types["std_msgs/msg/Header"](**seq, stamp=time, frame_id="lidar")
    made = [
        types["sensor_msgs/msg/PointField"](name=n, offset=o, datatype=d, count=1)
        for n, o, d in fields
    ]
    shape = {
        "height": 1,
        "width": len(table),
        "point_step": row.itemsize,
        "row_step": row.itemsize * len(table),
    }
    data = np.frombuffer(table.tobytes(), np.uint8)
    return types[bag_messages.CLOUD](
        header=head, fields=made, is_bigendian=False, is_dense=True, data=data, **shape
    )


def make_rows(kind: str = "<f4") -> tuple[list[tuple[str, int, int]], np.dtype]:
    """Fields x, y and z of 4 or 8 bytes, after two bytes of another field."""
    size, code = (4, 7) if kind == "<f4" else (8, 8)
    offsets = [8, 8 + size, 8 + 2 * size]
    row = np.dtype(
        {
            "names": ["ring", *"xyz"],
            "formats": ["<u2", *[kind] * 3],
            "offsets": [2, *offsets],
            "itemsize": 48,
        }
    )
    return [
        ("ring", 2, 4),
        *((axis, offset, code) for axis, offset in zip("xyz", offsets, strict=True)),
    ], row


def fill(row: np.dtype, points: np.ndarray) -> np.ndarray:
    table = np.zeros(len(points), row)
    for k, axis in enumerate("xyz"):
        table[axis] = points[:, k]
    table["ring"] = [7, 65535]
    return table


def test_fields_of_a_cloud_are_read_at_their_offsets(tmp_path, bags):
    """rerun-io/rerun#12797: further fields that all have the values of x."""
    _, rosbag2, typesys = bags
    fields, row = make_rows()
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with rosbag2.Writer(
        tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP
    ) as writer:
        topic = writer.add_connection("/points", bag_messages.CLOUD, typestore=store)
        message = make_cloud(store, 5, fields, row, fill(row, POINTS))
        writer.write(topic, 5 * 10**9, store.serialize_cdr(message, bag_messages.CLOUD))
    (frame,) = open_recording(tmp_path / "bag", "rosbag")
    assert frame.points().tolist() == POINTS.tolist()
    assert frame.clouds[0].ring.tolist() == [7, 65535]


def test_clouds_of_double_coordinates_in_utm(tmp_path, bags):
    """PointCloudLibrary/pcl#4756: coordinates of seven places before the point need double."""
    _, rosbag2, typesys = bags
    fields, row = make_rows("<f8")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    far = POINTS.astype(np.float64) + np.array([692000.125, 5336000.25, 520.0])
    with rosbag2.Writer(
        tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP
    ) as writer:
        topic = writer.add_connection("/points", bag_messages.CLOUD, typestore=store)
        for k in (5, 6):
            message = make_cloud(store, k, fields, row, fill(row, far + 100.0 * (k - 5)))
            writer.write(topic, k * 10**9, store.serialize_cdr(message, bag_messages.CLOUD))
    first, second = open_recording(tmp_path / "bag", "rosbag")
    np.testing.assert_allclose(first.points(), far, atol=1e-4)
    np.testing.assert_allclose(second.points(), far + 100, atol=1e-4)
    assert first.sensors[0].position.tolist() == second.sensors[0].position.tolist()
    assert first.problems == {problem_kinds.UNPLACED: 1}


def test_a_database_without_definitions_of_its_messages(tmp_path, bags):
    """mbpeterson70/robotdatapy#30: "Bag contains no type definitions"; bags of ROS 2 up to Humble
    have none."""
    _, rosbag2, typesys = bags
    fields, row = make_rows()
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with rosbag2.Writer(
        tmp_path / "bag", version=8, storage_plugin=rosbag2.StoragePlugin.SQLITE3
    ) as writer:
        topic = writer.add_connection("/points", bag_messages.CLOUD, typestore=store)
        message = make_cloud(store, 5, fields, row, fill(row, POINTS))
        writer.write(topic, 5 * 10**9, store.serialize_cdr(message, bag_messages.CLOUD))
    import sqlite3

    (file,) = (tmp_path / "bag").glob("*.db3")
    with sqlite3.connect(file) as database:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
        if "message_definitions" in tables:
            database.execute("DELETE FROM message_definitions")
    database.close()
    (frame,) = open_recording(tmp_path / "bag", "rosbag")
    assert frame.points().tolist() == POINTS.tolist()


def test_packets_with_an_empty_definition_do_no_harm(tmp_path, bags):
    """RoboSense-LiDAR/rslidar_sdk#38: topics of packets whose definition and md5sum are those of an
    empty text."""
    rosbag1, _, typesys = bags
    fields, row = make_rows()
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    with rosbag1.Writer(tmp_path / "a.bag") as writer:
        empty = "d41d8cd98f00b204e9800998ecf8427e"
        packets = writer.add_connection(
            "/packets", "rslidar_msgs/msg/rslidarPacket", msgdef="x y\n", md5sum=empty
        )
        writer.write(packets, 4 * 10**9, b"\0" * 8)
        topic = writer.add_connection("/points", bag_messages.CLOUD, typestore=store)
        message = make_cloud(store, 5, fields, row, fill(row, POINTS))
        writer.write(topic, 5 * 10**9, store.serialize_ros1(message, bag_messages.CLOUD))
    (frame,) = open_recording(tmp_path / "a.bag", "rosbag")
    assert frame.points().tolist() == POINTS.tolist()


def test_compressed_clouds_are_refused_with_their_type(tmp_path, bags):
    """facontidavide/cloudini#22: bags that hold point_cloud_interfaces/msg/CompressedPointCloud2
    only."""
    _, rosbag2, _ = bags
    kind = "point_cloud_interfaces/msg/CompressedPointCloud2"
    with rosbag2.Writer(
        tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP
    ) as writer:
        topic = writer.add_connection(
            "/lidar/points", kind, msgdef="uint8[] data\n", rihs01="RIHS01_0"
        )
        writer.write(topic, 10**9, b"\0\1\0\0\0\0\0\0")
    with pytest.raises(
        ValueError,
        match=rf"but /lidar/points \({kind}\): convert its lidar's messages to PointCloud2",
    ):
        open_recording(tmp_path / "bag", "rosbag")


def test_a_lidar_on_two_topics_is_counted_twice_and_said(tmp_path, bags):
    """Krishtof-Korda/pcap-to-bag#5 and others: bags of a sensor with raw and derived topics."""
    _, rosbag2, typesys = bags
    fields, row = make_rows()
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with rosbag2.Writer(
        tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP
    ) as writer:
        for name in ("/points_raw", "/filtered_points"):
            topic = writer.add_connection(name, bag_messages.CLOUD, typestore=store)
            message = make_cloud(store, 5, fields, row, fill(row, POINTS))
            writer.write(topic, 5 * 10**9, store.serialize_cdr(message, bag_messages.CLOUD))
    (frame,) = open_recording(tmp_path / "bag", "rosbag")
    assert frame.problems[rosbag.SAME_SENSOR] == 1


def test_a_cloud_of_no_points_among_others(tmp_path, bags):
    """leggedrobotics/open3d_slam#76: clouds of no points among others, width and row_step 0."""
    _, rosbag2, typesys = bags
    fields, row = make_rows()
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with rosbag2.Writer(
        tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP
    ) as writer:
        topic = writer.add_connection("/points", bag_messages.CLOUD, typestore=store)
        for k, table in ((5, fill(row, POINTS)[:0]), (6, fill(row, POINTS))):
            message = make_cloud(store, k, fields, row, table)
            writer.write(topic, k * 10**9, store.serialize_cdr(message, bag_messages.CLOUD))
    first, second = open_recording(tmp_path / "bag", "rosbag")
    assert first.problems == {problem_kinds.EMPTY: 1}
    assert len(second.points()) == 2
