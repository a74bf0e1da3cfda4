"""Bags as drivers and recorders write them: tf by tf2's rules, clouds by time, odd things at the
side left out.

Each bag is written message by message with rosbags' own writers; what is expected follows tf2
(BufferCore): a static transform is valid at all times, a later one replaces it, quaternions must
have length 1, and a child frame has one history
(https://docs.ros.org/en/rolling/Concepts/Intermediate/About-Tf2.html, REP 105)."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from toolkit.datasets import transform_tree
from toolkit.datasets.clock_times import UNPAIRED
from toolkit.datasets.layouts import bag_index, bag_messages, rosbag
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NS = 10**9
START = 1_700_000_000
Ros = Any
Message = tuple[str, str, float, Callable[[Ros], Ros]]


def header(store: Ros, stamp: float, frame: str) -> Ros:
    nanoseconds = round(stamp * NS)
    time = store.types["builtin_interfaces/msg/Time"](
        sec=nanoseconds // NS, nanosec=nanoseconds % NS
    )
    seq = {"seq": 0} if "seq" in str(store.fielddefs["std_msgs/msg/Header"]) else {}
    return store.types["std_msgs/msg/Header"](**seq, stamp=time, frame_id=frame)


def cloud(
    topic: str,
    stamp: float,
    frame: str = "lidar",
    *,
    recorded: float | None = None,
    points: Sequence[Sequence[float]] = ((1, 0, 0),),
    names: Sequence[str] = "xyz",
    **more: Any,
) -> Message:
    """A PointCloud2 of float32 x, y, z."""

    def build(store: Ros) -> Ros:
        table = np.array(points, "<f4").reshape(-1, 3)
        field = store.types["sensor_msgs/msg/PointField"]
        fields = [
            field(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate(names)
        ]
        shape = {
            "height": 1,
            "width": len(table),
            "point_step": 12,
            "row_step": 12 * len(table),
        } | more
        data = np.frombuffer(table.tobytes(), np.uint8)
        return store.types[bag_messages.CLOUD](
            header=header(store, stamp, frame),
            fields=fields,
            is_bigendian=False,
            is_dense=True,
            data=data,
            **shape,
        )

    return topic, bag_messages.CLOUD, stamp if recorded is None else recorded, build


def tf(
    topic: str,
    stamp: float,
    parent: str,
    child: str,
    x: float,
    *,
    recorded: float | None = None,
    wxyz: Sequence[float] = (1, 0, 0, 0),
) -> Message:
    def build(store: Ros) -> Ros:
        w, i, j, k = (float(value) for value in wxyz)
        types = {
            name: store.types[f"geometry_msgs/msg/{name}"]
            for name in ("Vector3", "Quaternion", "Transform")
        }
        moved = types["Transform"](
            translation=types["Vector3"](x=float(x), y=0.0, z=0.0),
            rotation=types["Quaternion"](x=i, y=j, z=k, w=w),
        )
        stamped = store.types["geometry_msgs/msg/TransformStamped"]
        link = stamped(header=header(store, stamp, parent), child_frame_id=child, transform=moved)
        return store.types[bag_messages.TF](transforms=[link])

    return topic, bag_messages.TF, stamp if recorded is None else recorded, build


def write(
    path: Path, messages: Sequence[Message], *, plugin: StoragePlugin = StoragePlugin.MCAP
) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        kinds = {topic: kind for topic, kind, _, _ in messages}
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in kinds.items()
        }
        for topic, kind, recorded, build in sorted(messages, key=lambda message: message[2]):
            writer.write(
                topics[topic], round(recorded * NS), store.serialize_cdr(build(store), kind)
            )
    return path


def write_ros1(path: Path, messages: Sequence[Message]) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(
        get_types_from_msg("geometry_msgs/TransformStamped[] transforms", bag_messages.TF)
    )
    with Writer1(path) as writer:
        kinds = {topic: kind for topic, kind, _, _ in messages}
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in kinds.items()
        }
        for topic, kind, recorded, build in sorted(messages, key=lambda message: message[2]):
            writer.write(
                topics[topic], round(recorded * NS), store.serialize_ros1(build(store), kind)
            )
    return path


def read(path: Path) -> list[Frame]:
    return list(open_recording(path, "rosbag"))


def list_x(frames: Sequence[Frame]) -> list[float]:
    """x of the first sensor in each frame."""
    return [round(float(frame.clouds[0].world_SE3_sensor[0, 3]), 6) for frame in frames]


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_a_static_transform_holds_until_another_replaces_it(tmp_path, kind):
    """At 10 m from the beginning, also before it was recorded; at 20 m from 10 s on. No gliding in
    between."""
    messages = [
        tf("/tf_static", START + 2, "map", "lidar", 10),
        tf("/tf_static", START + 10, "map", "lidar", 20),
    ]
    messages += [cloud("/points", START + t) for t in (1, 3, 6, 9, 11, 30)]
    path = (
        write_ros1(tmp_path / "a.bag", messages)
        if kind == "ros1"
        else write(tmp_path / "bag", messages)
    )
    frames = read(path)
    assert list_x(frames) == [10, 10, 10, 10, 20, 20]
    assert all(frame.problems == {} for frame in frames)


def test_a_static_transform_needs_no_stamp(tmp_path):
    messages = [
        tf("/tf_static", 0, "map", "lidar", 10, recorded=START),
        cloud("/points", START + 5),
    ]
    (frame,) = read(write(tmp_path / "bag", messages))
    assert list_x([frame]) == [10]


def test_static_and_moving_transforms_are_two_lists(tmp_path):
    """base moves 1 m a second in the map, the lidar is fixed to it; both topics use a stamp of the
    other's times."""
    messages = [tf("/tf", START + t, "map", "base", t) for t in range(6)]
    messages += [tf("/tf_static", START + 3, "base", "lidar", 100, recorded=START)]
    messages += [cloud("/points", START + t) for t in (0.5, 2.25, 4.75)]
    assert list_x(read(write(tmp_path / "bag", messages))) == [100.5, 102.25, 104.75]


def test_topics_of_tf_may_have_a_namespace_and_frames_a_slash(tmp_path):
    messages = [
        tf("/robot/tf_static", START, "/map", "/lidar", 10),
        tf("/robot/tf_static", START + 9, "map", "lidar", 30),
    ]
    messages += [cloud("/points", START + 1, "/lidar"), cloud("/points", START + 10, "lidar")]
    assert list_x(read(write(tmp_path / "bag", messages))) == [10, 30]


def test_a_frame_that_both_topics_place_is_static_and_counted(tmp_path):
    messages = [
        tf("/tf_static", START, "map", "lidar", 10),
        tf("/tf", START + 1, "map", "lidar", 50),
    ]
    messages += [cloud("/points", START + t) for t in (1, 2)]
    frames = read(write(tmp_path / "bag", messages))
    assert list_x(frames) == [10, 10]
    assert [frame.problems for frame in frames] == [{transform_tree.TWICE_PLACED: 1}, {}]


def test_a_frame_that_changes_its_parent_does_not_glide(tmp_path):
    """On the lift until 1 s, on the floor from 2 s on: between, tf2 takes the older one."""
    messages = [
        tf("/tf_static", START, "map", "lift", 100),
        tf("/tf_static", START, "map", "floor", 0),
    ]
    messages += [
        tf("/tf", START + 1, "lift", "lidar", 1),
        tf("/tf", START + 2, "floor", "lidar", 2),
    ]
    messages += [cloud("/points", START + t) for t in (1, 1.5, 2)]
    frames = read(write(tmp_path / "bag", messages))
    assert list_x(frames) == [101, 101, 2]


def test_moving_transforms_far_from_a_cloud_are_counted(tmp_path):
    messages = [tf("/tf", START + t, "map", "lidar", t) for t in (0, 1)]
    messages += [cloud("/points", START + t) for t in (0.5, 1.5, 60)]
    frames = read(write(tmp_path / "bag", messages))
    assert list_x(frames) == [0.5, 1, 1]
    assert [frame.problems for frame in frames] == [{}, {}, {rosbag.FAR_TF: 1}]


def test_clouds_of_two_trees_are_counted(tmp_path):
    """Nothing connects map and odom: the second lidar's place by the first is unknown."""
    messages = [tf("/tf_static", START, "map", "a", 10), tf("/b/tf_static", START, "odom", "b", 5)]
    messages += [cloud("/a", START + 1, "a"), cloud("/b", START + 1, "b")]
    (frame,) = read(write(tmp_path / "bag", messages))
    assert frame.problems == {rosbag.OTHER_TREE: 1}
    without_tf = [cloud("/a", START + 1, "a"), cloud("/b", START + 1, "b")]
    (frame,) = read(write(tmp_path / "none", without_tf))
    assert frame.problems == {rosbag.NO_TF: 2}


@pytest.mark.parametrize(
    ("wxyz", "parent"),
    [
        ((0, 0, 0, 0), "base"),
        ((float("nan"), 0, 0, 0), "base"),
        ((1, 0, 0, 0), "camera"),
        ((1, 0, 0, 0), ""),
    ],
)
def test_a_transform_of_an_unused_camera_never_refuses_the_bag(tmp_path, wxyz, parent):
    """tf2 ignores malformed quaternions, frames without a name and frames in themselves, with an
    error."""
    messages = [
        tf("/tf_static", START, "map", "lidar", 10),
        tf("/c/tf_static", START, parent, "camera", 1, wxyz=wxyz),
    ]
    messages += [cloud("/points", START + t) for t in (1, 2)]
    frames = read(write(tmp_path / "bag", messages))
    assert list_x(frames) == [10, 10]
    assert [frame.problems for frame in frames] == [{transform_tree.MALFORMED: 1}, {}]


def test_rows_without_a_step_follow_one_another(tmp_path):
    """ros-drivers/velodyne#279, realsenseai/realsense-ros#1664: a row_step of 0, or of another
    width."""
    points = [(1, 2, 3), (4, 5, 6)]
    messages = [
        cloud("/a", START + 1, points=points, row_step=0),
        cloud("/a", START + 2, points=points, row_step=0, height=2, width=1),
        cloud("/a", START + 3, points=points, row_step=24, height=2, width=1),
        cloud("/a", START + 4, points=points, row_step=12),
    ]
    for frame in read(write(tmp_path / "bag", messages)):
        assert frame.points().tolist() == [[1, 2, 3], [4, 5, 6]]
        assert frame.problems == {}


def test_a_cloud_that_cannot_be_read_is_left_out_and_counted(tmp_path):
    messages = [cloud("/a", START + 1), cloud("/a", START + 2, width=99), cloud("/a", START + 3)]
    frames = read(write(tmp_path / "bag", messages))
    assert [len(frame.clouds) for frame in frames] == [1, 0, 1]
    assert [frame.problems for frame in frames] == [{}, {rosbag.UNREADABLE: 1}, {}]


def test_a_radars_clouds_without_xyz_are_left_out_and_counted(tmp_path):
    messages = [
        cloud("/a", START + 1),
        cloud("/radar", START + 1, "radar", names=("range", "azimuth", "v")),
    ]
    (frame,) = read(write(tmp_path / "bag", messages))
    assert [each.name for each in frame.clouds] == ["a"]
    assert frame.problems == {rosbag.NO_XYZ: 1}
    with pytest.raises(ValueError, match="without fields x, y and z only"):
        read(write(tmp_path / "radar", messages[1:]))


def test_two_topics_that_each_lost_a_cloud(tmp_path):
    """10 Hz each, 4 ms apart; recorded with 30 ms of delay, the second one's late."""
    north = [START + 0.1 * k for k in range(8) if k != 2]
    south = [START + 0.1 * k + 0.004 for k in range(8) if k != 5]
    messages = [tf("/tf_static", START, "map", "lidar", 0)]
    messages += [cloud("/north", stamp, recorded=stamp + 0.03) for stamp in north]
    messages += [cloud("/south", stamp, recorded=stamp + 0.12) for stamp in south]
    frames = read(write(tmp_path / "bag", messages))
    assert [len(frame.clouds) for frame in frames] == [2, 2, 1, 2, 2, 1, 2, 2]
    for frame in frames:
        stamps = [each.stamp_s for each in frame.clouds if each.stamp_s is not None]
        assert max(stamps) - min(stamps) < 0.02
    assert sum(frame.problems.get(UNPAIRED, 0) for frame in frames) == 2
    bag = open_recording(tmp_path / "bag", "rosbag")
    assert [bag[k].time for k in (5, 0, 7)] == [frames[k].time for k in (5, 0, 7)]


def test_a_sensor_with_a_clock_that_counts_from_its_start(tmp_path):
    """Stamps of two clocks say nothing about one another: the time of recording does."""
    messages = [cloud("/a", START + 0.1 * k, recorded=START + 0.1 * k + 0.01) for k in range(4)]
    messages += [cloud("/b", 12.0 + 0.1 * k, recorded=START + 0.1 * k + 0.03) for k in range(4)]
    frames = read(write(tmp_path / "bag", messages))
    assert [len(frame.clouds) for frame in frames] == [2] * 4
    assert all(frame.problems[bag_index.OTHER_CLOCKS] == 2 for frame in frames)
    np.testing.assert_allclose(
        [frame.time for frame in frames], [START + 0.1 * k + 0.01 for k in range(4)], atol=1e-6
    )


def test_a_lidar_that_stamps_from_its_start_moves_with_tf(tmp_path):
    """ouster-lidar/ouster-sdk#48, #74: stamps of 3,484 s, tf in seconds since 1970. Not the first
    pose for ever."""
    messages = [tf("/tf", START + t, "map", "lidar", t) for t in range(6)]
    messages += [cloud("/points", 3484.0 + t, recorded=START + t) for t in (1.25, 4.5)]
    frames = read(write(tmp_path / "bag", messages))
    assert list_x(frames) == [1.25, 4.5]
    assert [frame.problems for frame in frames] == [{bag_index.OTHER_CLOCKS: 1}] * 2


def test_a_simulated_clock_is_one_clock(tmp_path):
    """use_sim_time: clouds and tf count from the start of the simulation, the recorder from
    1970."""
    messages = [tf("/tf", t, "map", "lidar", t, recorded=START + 2 * t) for t in (1.0, 2.0, 3.0)]
    messages += [cloud("/points", t, recorded=START + 2 * t) for t in (1.5, 2.25)]
    frames = read(write(tmp_path / "bag", messages))
    assert list_x(frames) == [1.5, 2.25]
    assert [frame.time for frame in frames] == [1.5, 2.25]


@pytest.mark.filterwarnings("ignore:.*no place for labels")
def test_a_simulation_that_begins_at_0_has_a_stamp(tmp_path):
    still = SensorCloud("lidar", np.ones((1, 3), np.float32), np.eye(4))
    shown = [Frame.of_clouds(str(k), (still,), Objects.empty(), time=0.5 * k) for k in range(2)]
    write_recording(shown, tmp_path, "rosbag")
    assert [(frame.time, frame.problems) for frame in read(tmp_path / "bag")] == [
        (0.0, {}),
        (0.5, {}),
    ]


def test_clouds_without_a_stamp_have_the_time_of_their_recording(tmp_path):
    messages = [cloud("/a", 0.0, recorded=START + 1.5)]
    (frame,) = read(write(tmp_path / "bag", messages))
    assert frame.time == START + 1.5
    assert frame.problems == {rosbag.NO_STAMP: 1}


def test_several_files_without_metadata_are_read_in_order(tmp_path):
    """As ros2 bag record splits them, with metadata.yaml lost."""
    folder = tmp_path / "drive"
    folder.mkdir()
    for k, name in enumerate(("drive_1", "drive_0")):
        messages = [tf("/tf_static", START, "map", "lidar", 10)] if name == "drive_0" else []
        messages += [cloud("/points", START + 10 * (1 - k) + t) for t in range(3)]
        shutil.move(next(write(tmp_path / name, messages).glob("*.mcap")), folder / f"{name}.mcap")
    with pytest.warns(UserWarning, match="drive_0.mcap, drive_1.mcap are read as one recording"):
        frames = list(open_recording(folder))
    assert [frame.time - START for frame in frames] == [0, 1, 2, 10, 11, 12]
    assert list_x(frames) == [10] * 6


def test_bags_of_several_kinds_are_refused_with_their_names(tmp_path):
    shutil.move(
        next(write(tmp_path / "a", [cloud("/a", START)]).glob("*.mcap")), tmp_path / "a.mcap"
    )
    write_ros1(tmp_path / "b.bag", [cloud("/a", START)])
    with pytest.raises(ValueError, match=r"bags of several kinds, a\.mcap, b\.bag: give one file"):
        open_recording(tmp_path, "rosbag")


def test_a_bag_without_clouds_names_what_it_holds(tmp_path):
    with pytest.raises(
        ValueError,
        match=r"no messages of sensor_msgs/msg/PointCloud2, but /tf \(tf2_msgs/msg/TFMessage\)",
    ):
        read(write(tmp_path / "bag", [tf("/tf", START, "map", "lidar", 0)]))


def test_definitions_of_topics_that_are_not_read_do_no_harm(tmp_path):
    """A topic whose message type refers to one that the bag does not define."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    _, kind, recorded, build = cloud("/a", START)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        odd = writer.add_connection(
            "/odd", "our_msgs/msg/Odd", msgdef="other_msgs/Lost lost\n", rihs01="RIHS01_0"
        )
        writer.write(odd, round(recorded * NS), b"\0\1\0\0")
        points = writer.add_connection("/a", kind, typestore=store)
        writer.write(points, round(recorded * NS), store.serialize_cdr(build(store), kind))
    (frame,) = read(tmp_path / "bag")
    assert frame.points().tolist() == [[1, 0, 0]]
