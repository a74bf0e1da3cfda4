import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from toolkit.datasets.clock_times import UNPAIRED
from toolkit.datasets.layouts.rosbag import CLOUD, TF, rosbag, write_rosbag
from toolkit.datasets.transform_tree import TransformTree, between
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose, transform
from toolkit.objects import Objects

pytest.importorskip("rosbags")


NS = 10**9
# 4 bytes of padding at 0 and 16
FIELDS = (("x", 4, 7), ("y", 8, 7), ("z", 12, 7), ("intensity", 20, 7), ("t", 24, 6))


def point_cloud(store, stamp, frame, points, order="<", ros1=False):
    types = store.types
    formats = [f"{order}f4"] * 4 + [f"{order}u4"]
    row = {
        "names": ["x", "y", "z", "intensity", "t"],
        "formats": formats,
        "offsets": [4, 8, 12, 20, 24],
        "itemsize": 32,
    }
    table = np.zeros(len(points), row)
    for k, axis in enumerate("xyz"):
        table[axis] = np.array(points)[:, k]
    table["intensity"], table["t"] = 5.0, np.arange(len(points)) * 1000
    fields = [
        types["sensor_msgs/msg/PointField"](name=n, offset=o, datatype=d, count=1)
        for n, o, d in FIELDS
    ]
    return types[CLOUD](
        header=header(store, stamp, frame, ros1),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=order == ">",
        point_step=32,
        row_step=32 * len(points),
        data=np.frombuffer(table.tobytes(), np.uint8),
        is_dense=True,
    )


def header(store, stamp, frame, ros1=False):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // NS, nanosec=stamp % NS)
    return store.types["std_msgs/msg/Header"](
        **({"seq": 0} if ros1 else {}), stamp=time, frame_id=frame
    )


def transforms(store, stamp, links, ros1=False):
    types = store.types
    each = []
    for parent, child, x, yaw in links:
        turned = types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
        )
        moved = types["geometry_msgs/msg/Vector3"](x=float(x), y=0.0, z=0.0)
        where = types["geometry_msgs/msg/Transform"](translation=moved, rotation=turned)
        stamped = types["geometry_msgs/msg/TransformStamped"]
        each.append(
            stamped(
                header=header(store, stamp, parent, ros1), child_frame_id=child, transform=where
            )
        )
    return types[TF](transforms=each)


def write_ros2(path, messages, plugin=StoragePlugin.MCAP):
    """messages: topic, type, time, a function of the type store."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        kinds = {topic: kind for topic, kind, _, _ in messages}
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in kinds.items()
        }
        for topic, kind, stamp, made in messages:
            writer.write(topics[topic], stamp, store.serialize_cdr(made(store), kind))
    return path


def recording(frame="os_sensor"):
    """Two rounds of two lidars; the second one's tf comes after its clouds, the base moves 4 m a
    second."""
    still = [("base", "os_sensor", 1.0, 0.0)]
    return [
        ("/tf_static", TF, NS, lambda s: transforms(s, NS, still)),
        ("/tf", TF, NS, lambda s: transforms(s, NS, [("map", "base", 10.0, 0.0)])),
        ("/north", CLOUD, NS, lambda s: point_cloud(s, NS, frame, [(1, 2, 3), (4, 5, 6)])),
        ("/south", CLOUD, NS, lambda s: point_cloud(s, NS, "base", [(1, 2, 3)])),
        (
            "/north",
            CLOUD,
            NS + NS // 2,
            lambda s: point_cloud(s, NS + NS // 2, frame, [(0, 0, 1), (np.nan, 0, 0)]),
        ),
        ("/tf", TF, 2 * NS, lambda s: transforms(s, 2 * NS, [("map", "base", 14.0, 0.0)])),
    ]


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_of_ros2(tmp_path, plugin):
    samples = rosbag(write_ros2(tmp_path / "bag", recording(), plugin))
    assert len(samples) == 2
    first, second = samples
    assert [cloud.name for cloud in first.clouds] == ["north", "south"]
    np.testing.assert_allclose(first.points(), [[12, 2, 3], [15, 5, 6], [11, 2, 3]])
    assert first.clouds[0].intensity.tolist() == [5, 5]
    np.testing.assert_allclose(first.clouds[0].time, [0, 1e-6])
    assert (first.time, second.time) == (1.0, 1.5)
    # half way between 10 and 14, and the sensor's 1
    np.testing.assert_allclose(second.points(), [[13, 0, 1]])
    assert second.problems == {"points with NaN or infinite numbers": 1, UNPAIRED: 1}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("- bag.mcap", "- ../bag/bag.mcap", "leads out of"),
        ("- bag.mcap", "- /dev/zero", "leads out of"),
        ("version:", f"deep: {'[' * 5000}{']' * 5000}\n  version:", "nested too deep"),
        ("version:", "version: 5\n  version:", "twice"),
    ],
)
def test_a_description_that_leads_elsewhere_or_is_a_bomb_is_refused(tmp_path, old, new, says):
    description = write_ros2(tmp_path / "bag", recording()) / "metadata.yaml"
    description.write_text(description.read_text().replace(old, new, 1))
    with pytest.raises(ValueError, match=says) as refused:
        rosbag(tmp_path / "bag")
    assert "\n" not in str(refused.value)


def test_the_file_of_a_bag_alone(tmp_path):
    (file,) = write_ros2(tmp_path / "bag", recording()).glob("*.mcap")
    assert len(list(rosbag(file))) == 2


def test_a_bag_of_ros1(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    with Writer1(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/velodyne", CLOUD, typestore=store)
        tf = writer.add_connection("/tf", TF, typestore=store)
        message = transforms(store, NS, [("/map", "/velodyne", 2.0, np.pi / 2)], ros1=True)
        writer.write(tf, NS, store.serialize_ros1(message, TF))
        cloud = point_cloud(store, NS, "velodyne", [(1, 0, 0)], order=">", ros1=True)
        writer.write(connection, NS, store.serialize_ros1(cloud, CLOUD))
    (sample,) = rosbag(tmp_path / "a.bag")
    np.testing.assert_allclose(sample.points(), [[2, 1, 0]], atol=1e-6)


def test_bags_without_tf_or_clouds(tmp_path):
    first, _ = rosbag(write_ros2(tmp_path / "bag", recording(frame="elsewhere")))
    assert first.problems == {"clouds in a frame that no tf mentions": 1}
    assert first.clouds[0].world_SE3_sensor.tolist() == np.eye(4).tolist()
    with pytest.raises(ValueError, match="no messages of sensor_msgs"):
        rosbag(write_ros2(tmp_path / "none", recording()[:2]))
    (tmp_path / "text.bag").write_text("no bag")
    with pytest.raises(ValueError, match=r"text.bag is no bag that can be read"):
        rosbag(tmp_path / "text.bag")
    cloud = SensorCloud("lidar", np.ones((1, 3), np.float32), np.eye(4))
    with pytest.warns(UserWarning, match="no place for labels, 1 are not in it"):
        write_rosbag(
            [Frame.of_clouds("0", (cloud,), Objects(np.array([[0, 0, 0, 1, 1, 1, 0.0]])))],
            tmp_path / "out",
        )


def test_transforms_in_a_circle_and_between_two_times(tmp_path):
    links = [("a", "b", 1.0, 0.0), ("b", "a", 1.0, 0.0)]
    messages = [
        ("/tf", TF, NS, lambda s: transforms(s, NS, links)),
        ("/north", CLOUD, NS, lambda s: point_cloud(s, NS, "a", [(1, 2, 3)])),
    ]
    samples = rosbag(write_ros2(tmp_path / "bag", messages))
    with pytest.raises(ValueError, match="circle"):
        list(samples)
    a, b = pose(1.0, yaw=3.0), pose(3.0, yaw=-3.0)
    half = between(a, b, 0.5)  # the short way, through pi
    np.testing.assert_allclose(transform(half, np.array([[1.0, 0, 0]])), [[1.0, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(between(a, b, 0.0), a, atol=1e-12)
    np.testing.assert_allclose(between(a, a, 0.3), a, atol=1e-12)
    assert TransformTree().find("anything", 0, 0).root_SE3_frame.tolist() == np.eye(4).tolist()


pytest.importorskip("rosbags")


def test_clouds_in_the_world_are_written_in_their_sensors_frame(tmp_path):
    placed = pose(5.0, 1.0, 2.0, yaw=0.5, pitch=0.2)
    cloud = SensorCloud("lidar", np.array([[7.0, 1, 0]], np.float32), placed, "world")
    write_rosbag([Frame.of_clouds("0", (cloud,), Objects.empty(), time=3.5)], tmp_path)
    (back,) = rosbag(tmp_path / "bag")
    (outer,) = rosbag(tmp_path)  # the folder that was written opens too
    np.testing.assert_array_equal(outer.points(), back.points())
    np.testing.assert_allclose(back.clouds[0].world_SE3_sensor, placed, atol=1e-12)
    np.testing.assert_allclose(back.points(), [[7, 1, 0]], atol=1e-6)
    assert back.time == 3.5
    (named,) = rosbag((tmp_path / "bag").rename(tmp_path / "junction.bag"))  # a folder of ROS 2
    np.testing.assert_array_equal(named.points(), back.points())
