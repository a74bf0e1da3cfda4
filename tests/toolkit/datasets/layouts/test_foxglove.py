"""MCAP of Foxglove: written by mcap-protobuf-support, points packed by hand."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from toolkit.datasets.clock_times import UNPAIRED
from toolkit.datasets.layouts.foxglove import foxglove
from toolkit.datasets.layouts.rosbag import NO_TF
from toolkit.datasets.problem_kinds import EMPTY, NOT_FINITE_POINTS
from toolkit.datasets.recordings import guess_layout, open_recording, write_recording
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import open_writer
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose, transform
from toolkit.objects import Detections, Objects

pytestmark = pytest.mark.filterwarnings("ignore:.*is read as layout foxglove")
writer = pytest.importorskip("mcap_protobuf.writer")
mcap_writer = pytest.importorskip("mcap.writer")
SCHEMAS = "foxglove_schemas_protobuf"
FrameTransform = pytest.importorskip(f"{SCHEMAS}.FrameTransform_pb2").FrameTransform
FrameTransforms = pytest.importorskip(f"{SCHEMAS}.FrameTransforms_pb2").FrameTransforms
PointCloud = pytest.importorskip(f"{SCHEMAS}.PointCloud_pb2").PointCloud

START_NS = 1_700_000_000 * 10**9
# x y z as float32, intensity as uint8 (Foxglove's 1), ring as uint16 (3), 3 bytes of padding
FIELDS = (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 1), ("ring", 13, 3))
POINTS = ((1.0, 2.0, 3.0), (-4.0, 0.5, 6.0))


def cloud(frame="lidar", stamp_ns=START_NS, points=POINTS, fields=FIELDS, placed=None):
    rows = [struct.pack("<3fBHxxx", *point, 200 + k, 300 + k) for k, point in enumerate(points)]
    message = PointCloud(frame_id=frame, point_stride=18, data=b"".join(rows))
    for name, offset, kind in fields:
        message.fields.add(name=name, offset=offset, type=kind)
    message.timestamp.FromNanoseconds(stamp_ns)
    if placed is not None:
        message.pose.position.x = placed
        message.pose.orientation.w = 1.0
    return message


def link(child, parent, x, yaw=0.0, stamp_ns=START_NS):
    message = FrameTransform(parent_frame_id=parent, child_frame_id=child)
    message.translation.x = x
    message.rotation.z, message.rotation.w = np.sin(yaw / 2), np.cos(yaw / 2)
    message.timestamp.FromNanoseconds(stamp_ns)
    return message


def write(path, *messages):
    """Messages with their topics and log times (ns after the start)."""
    with path.open("wb") as file:
        made = writer.Writer(file)
        for topic, message, log_ns in messages:
            made.write_message(topic, message, START_NS + log_ns, START_NS + log_ns)
        made.finish()
    return path


def test_numbers_packed_by_hand(tmp_path):
    path = write(
        tmp_path / "a.mcap",
        ("/tf", link("lidar", "map", 10.0, yaw=np.pi / 2), 0),
        ("/lidar/points", cloud(placed=100.0), 0),
        ("/lidar/points", cloud(stamp_ns=START_NS + 100_000_000), 105_000_000),
    )
    assert guess_layout(path) == "foxglove"
    frames = list(open_recording(path))
    assert [frame.time for frame in frames] == pytest.approx([1.7e9, 1.7e9 + 0.1], abs=1e-6)
    first, second = frames
    assert [sensor.name for sensor in first.clouds] == ["lidar/points"]
    turned = pose(10.0, yaw=np.pi / 2)
    np.testing.assert_allclose(
        first.points(), transform(turned, np.add(POINTS, [100, 0, 0])), atol=1e-5
    )
    np.testing.assert_allclose(second.points(), transform(turned, np.array(POINTS)), atol=1e-5)
    assert first.clouds[0].intensity.tolist() == [200, 201]
    assert first.clouds[0].ring.tolist() == [300, 301]
    assert first.problems == second.problems == {}
    again = foxglove(path)
    np.testing.assert_array_equal(again[1].points(), second.points())
    np.testing.assert_array_equal(again[0].points(), first.points())


def test_topics_are_paired_by_time_and_transforms_interpolated(tmp_path):
    moved = FrameTransforms(
        transforms=[
            link("south", "map", 0.0),
            link("south", "map", 4.0, stamp_ns=START_NS + 2 * 10**8),
        ]
    )
    path = write(
        tmp_path / "a.mcap",
        ("/tf", moved, 0),
        ("/north", cloud("map"), 0),
        ("/south", cloud("south", START_NS + 2_000_000), 3_000_000),
        ("/north", cloud("map", START_NS + 10**8), 10**8),
        ("/south", cloud("south", START_NS + 10**8), 10**8),
        ("/north", cloud("elsewhere", START_NS + 2 * 10**8), 2 * 10**8),
    )
    first, second, third = open_recording(path)
    assert len(first.clouds) == len(second.clouds) == 2
    south = next(each for each in second.clouds if each.name == "south")
    assert south.world_SE3_sensor[0, 3] == pytest.approx(2.0)
    assert third.problems == {UNPAIRED: 1, NO_TF: 1}


def test_clouds_that_coview_writes_come_back(tmp_path):
    placed = pose(10.0, -3.0, 6.0, yaw=0.7, pitch=0.3)
    points = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, -6.0]], np.float32)
    sensor = SensorCloud("north", points, placed, intensity=np.array([1, 2], np.float32))
    with open_writer("mcap", tmp_path / "a.mcap") as made:
        for k in range(3):
            clouds = (sensor, replace(sensor, name="south"))
            made.write(Instant.from_detections(1.7e9 + k, Detections.empty(), clouds))
    frames = list(open_recording(tmp_path / "a.mcap"))
    assert [frame.time for frame in frames] == [1.7e9, 1.7e9 + 1, 1.7e9 + 2]
    np.testing.assert_allclose(
        frames[2].points(), np.tile(transform(placed, points.astype(float)), (2, 1)), atol=1e-6
    )
    for each in frames[2].clouds:
        np.testing.assert_allclose(each.world_SE3_sensor, placed, atol=1e-12)
    assert [frame.problems for frame in frames] == [{}, {}, {}]


def test_nan_and_no_points_are_counted(tmp_path):
    path = write(
        tmp_path / "a.mcap",
        ("/a", cloud(points=((np.nan, 0, 0), (1, 2, 3))), 0),
        ("/a", cloud(points=(), stamp_ns=START_NS + 10**9), 10**9),
    )
    first, second = open_recording(path)
    assert first.problems == {NOT_FINITE_POINTS: 1}
    assert second.problems == {EMPTY: 1}


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        (FIELDS[:2], "no x, y and z, but x, y"),
        ((*FIELDS, ("x", 0, 7)), "two fields of a cloud have one name"),
        ((*FIELDS, ("t", 16, 5)), "field t of a cloud ends at byte 20 of points of 18 bytes"),
        ((*FIELDS, ("t", 0, 0)), "field t of a cloud has the unknown type 0"),
    ],
)
def test_wrong_fields_are_named(tmp_path, fields, reason):
    path = write(tmp_path / "a.mcap", ("/a", cloud(fields=fields), 0))
    with pytest.raises(ValueError, match=reason) as raised:
        list(open_recording(path))
    assert str(path) in str(raised.value)


def test_a_stride_that_does_not_fit_is_named(tmp_path):
    message = cloud()
    message.data = message.data[:-1]
    with pytest.raises(ValueError, match="35 bytes is no whole number of points of 18 bytes"):
        list(open_recording(write(tmp_path / "a.mcap", ("/a", message, 0))))


def test_damaged_files_are_named(tmp_path):
    path = write(tmp_path / "a.mcap", ("/a", cloud(), 0), ("/a", cloud(stamp_ns=START_NS + 1), 1))
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:-30], whole[:60], b""):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.mcap is no"):
            list(open_recording(path, "foxglove"))
    spoilt = bytearray(whole)
    spoilt[200] ^= 255
    path.write_bytes(spoilt)
    with pytest.raises(ValueError, match=r"a\.mcap"):
        list(open_recording(path))


def test_other_files_are_refused_by_name(tmp_path):
    path = write(tmp_path / "a.mcap", ("/tf", link("a", "b", 1.0), 0))
    with pytest.raises(ValueError, match=r"holds no foxglove\.PointCloud"):
        open_recording(path)
    with path.open("wb") as file:
        made = mcap_writer.Writer(file)
        made.start("", "test")
        schema = made.register_schema("foxglove.PointCloud", "jsonschema", b"{}")
        made.add_message(made.register_channel("/a", "json", schema), 0, json.dumps({}).encode(), 0)
        made.finish()
    with pytest.raises(ValueError, match=r"/a is foxglove\.PointCloud in json"):
        open_recording(path)


def test_bags_of_ros_stay_bags(tmp_path):
    pytest.importorskip("rosbags")
    sensor = SensorCloud("north", np.ones((1, 3), np.float32), np.eye(4))
    frame = Frame.of_clouds("0", (sensor,), Objects.empty(), time=1.7e9)
    write_recording([frame], tmp_path / "ros", "rosbag")
    (bag,) = (tmp_path / "ros").rglob("*.mcap")
    assert guess_layout(bag) == "rosbag"
