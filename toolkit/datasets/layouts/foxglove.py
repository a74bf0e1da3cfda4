"""MCAP files of Foxglove: PointCloud messages in protobuf, with FrameTransform.

World frame: the root of the clouds' frames by FrameTransform(s), or the only frame of all clouds.
Else a cloud whose frame no transform mentions stays in its frame, and is counted.

- A cloud's points are in its `pose` in `frame_id`, which transforms place in the root. A pose that
  is not set, as protobuf leaves it, is the identity; a quaternion of another length than 1 is
  refused.
- Numeric types of fields are Foxglove's: 1 to 8 are UINT8, INT8, UINT16, INT16, UINT32, INT32,
  FLOAT32 and FLOAT64, little-endian. They differ from ROS, in which 2 is UINT8.
- A cloud's time is its `timestamp`, else the log's. Clouds of several topics are paired by
  time (`toolkit.datasets.clock_times`).
- Channels in JSON or FlatBuffers are refused by name. A file without an index was cut off: `mcap
  recover` repairs it.
- There are no labels. Reading needs mcap and foxglove-schemas-protobuf."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import listing
from toolkit.datasets.clock_times import UNPAIRED, group_by_time
from toolkit.datasets.cloud_records import build_cloud
from toolkit.datasets.folders import list_bags
from toolkit.datasets.layouts.rosbag import FAR_TF, MAX_TF_GAP_S, NO_TF, OTHER_TREE
from toolkit.datasets.origins import Middles
from toolkit.datasets.pose_files import quaternion_pose
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.datasets.record_values import name_damage
from toolkit.datasets.transform_tree import NS_PER_S, TransformLink, TransformTree, parse_link_pose
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.point_columns import name_attributes
from toolkit.runtime.array_files import MAX_CLOUD_BYTES, check_unpacked
from toolkit.runtime.reading import plain_file

POINT_CLOUD = "foxglove.PointCloud"
TRANSFORM = "foxglove.FrameTransform"
TRANSFORMS = "foxglove.FrameTransforms"
PROTOBUF = "protobuf"
# NumPy's types by Foxglove's PackedElementField.NumericType
FOXGLOVE_TYPES = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}
_Message = Any  # generated classes of protobuf have no types


class CloudKey(NamedTuple):
    """Place of a message in a file.

    Attributes:
        topic: its topic.
        log_ns: time of its log.
        number: number among the topic's messages of this time.
        stamp_ns: time of the cloud.
    """

    topic: str
    log_ns: int
    number: int
    stamp_ns: int


@dataclass
class _Index:
    """Clouds of each topic in the order of the file, their frames, and all transforms."""

    clouds: dict[str, list[CloudKey]] = field(default_factory=dict)
    frames: set[str] = field(default_factory=set)
    links: list[TransformLink] = field(default_factory=list)


def foxglove(path: Path) -> listing.Listing:
    """Open an MCAP file of Foxglove's, or a folder with one.

    Raises ImportError without the packages, FileNotFoundError and ValueError for a file that is
    damaged or has no clouds."""
    file = _find_file(path)
    index = _index(file)
    if not index.clouds:
        raise ValueError(f"{file} holds no {POINT_CLOUD}, so there are no clouds to read")
    tree = TransformTree.from_links(index.links)
    # times of each topic's clouds (s) since the first of all
    start_ns = min(key.stamp_ns for keys in index.clouds.values() for key in keys)
    times = {}
    for topic, keys in index.clouds.items():
        times[topic] = np.array([(key.stamp_ns - start_ns) / NS_PER_S for key in keys])
    # keys of the clouds of each frame, by its name
    groups = {}
    for number, group in enumerate(group_by_time(times)):
        groups[f"{number:06d}"] = [index.clouds[topic][row] for topic, row in group.items()]
    # without transforms, clouds that share one coordinate frame are placed already
    is_one_frame = len(index.frames) == 1 and not index.links
    source = _Source(file, topic_count=len(index.clouds), tree=tree, is_one_frame=is_one_frame)
    load = partial(_load, source, groups)
    return listing.Listing(tuple(groups), load, noted=tree.problems)


def _find_file(path: Path) -> Path:
    """Return the only MCAP file of a folder, or the file itself."""
    if not path.is_dir():
        return plain_file(path)
    files = [file for file in list_bags(path) if file.suffix.lower() == ".mcap"]
    if len(files) != 1:
        names = ", ".join(file.name for file in files[:6]) or "no .mcap"
        raise FileNotFoundError(f"{path} must hold one .mcap, got {names}: give the file")
    return plain_file(files[0])


@contextmanager
def _open_reader(file: Path) -> Iterator[Any]:
    """Open the reader of a file for a block; damage becomes a ValueError that names the file."""
    try:
        import foxglove_schemas_protobuf.PointCloud_pb2  # noqa: F401
        from mcap.reader import SeekingReader
    except ImportError:
        raise ImportError(
            "reading Foxglove's MCAP needs mcap and foxglove-schemas-protobuf: pip install "
            "coview[exchange]"
        ) from None
    with file.open("rb") as stream, name_damage(file, "MCAP file", (Exception,)):
        yield SeekingReader(stream, validate_crcs=True)


def _parse(name: str, content: bytes) -> _Message:
    """Parse the bytes of a message; name: name of its type, one of the three that are read."""
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

    # class by name of the type; `Any`, as type checkers know the classes only if the package that
    # has them is installed
    kinds: dict[str, Any] = {
        POINT_CLOUD: PointCloud,
        TRANSFORM: FrameTransform,
        TRANSFORMS: FrameTransforms,
    }
    message: _Message = kinds[name].FromString(content)
    return message


def _index(file: Path) -> _Index:
    """Read the times of all clouds of a file by topic, their frames, and all transforms.

    The points stay unread. Raises ValueError for a file that was cut off, and for messages in
    another encoding than protobuf."""
    index = _Index()
    with _open_reader(file) as reader:
        summary = reader.get_summary()
        if summary is None:
            raise ValueError("it has no index, so it was cut off: make a whole one by mcap recover")
        wanted_types = (POINT_CLOUD, TRANSFORM, TRANSFORMS)
        topics = []
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            if schema is None or schema.name not in wanted_types:
                continue
            if channel.message_encoding != PROTOBUF:
                raise ValueError(
                    f"{channel.topic} is {schema.name} in {channel.message_encoding}: record it in "
                    f"{PROTOBUF}"
                )
            topics.append(channel.topic)
        counts: Counter[tuple[str, int]] = Counter()
        messages = reader.iter_messages(topics=topics) if topics else ()
        for schema, channel, message in messages:
            content = _parse(schema.name, message.data)
            log_ns = int(message.log_time)  # time of its recording
            if schema.name == POINT_CLOUD:
                # among the clouds of the topic that were recorded at this very time
                number = counts[channel.topic, log_ns]
                counts[channel.topic, log_ns] += 1
                stamp_ns = _stamp_ns(content.timestamp) or log_ns
                key = CloudKey(channel.topic, log_ns, number, stamp_ns)
                index.clouds.setdefault(channel.topic, []).append(key)
                index.frames.add(content.frame_id)
            else:
                transforms = content.transforms if schema.name == TRANSFORMS else [content]
                index.links += [_link(transform, log_ns) for transform in transforms]
    return index


def _link(transform: _Message, log_ns: int) -> TransformLink:
    """Convert a FrameTransform message.

    log_ns: time of its recording, which also stands in for a missing stamp."""
    turn = transform.rotation
    place = transform.translation
    return TransformLink(
        child=transform.child_frame_id,
        parent=transform.parent_frame_id,
        parent_SE3_child=parse_link_pose(
            np.array([turn.w, turn.x, turn.y, turn.z]), np.array([place.x, place.y, place.z])
        ),
        stamp_ns=_stamp_ns(transform.timestamp) or log_ns,
        recorded_ns=log_ns,
        is_static=False,
    )


def _stamp_ns(stamp: _Message) -> int:
    """Return a Timestamp (ns), 0 if it is not set."""
    return int(stamp.seconds) * NS_PER_S + int(stamp.nanos)


@dataclass(frozen=True, eq=False)
class _Source:
    """File of clouds.

    Attributes:
        file: its path.
        topic_count: number of its topics of clouds.
        tree: frames of coordinates.
        is_one_frame: True if all clouds are in one frame and nothing else is placed.
        middles: middles of the sensors' first clouds.
    """

    file: Path
    topic_count: int
    tree: TransformTree
    is_one_frame: bool
    middles: Middles = field(default_factory=Middles)


def _load(source: _Source, groups: Mapping[str, list[CloudKey]], name: str) -> Frame:
    """Read a frame by its name; groups: keys of the clouds of each frame, by its name.

    The frame's time is its earliest cloud's."""
    problems: Problems = {}
    keys = groups[name]
    add_problem(problems, UNPAIRED, int(len(keys) < source.topic_count))
    clouds = []
    roots: list[str] = []  # root frames of the clouds' transform trees, which `_place` adds
    with _open_reader(source.file) as reader:
        for key in keys:
            message = _parse(POINT_CLOUD, _read(reader, key))
            world_SE3_sensor = _place(message, key, source.tree, roots, problems)
            is_placed = source.is_one_frame or source.tree.knows(message.frame_id)
            add_problem(problems, NO_TF, int(not is_placed))
            cloud = build_cloud(
                name_attributes(parse_fields(message)),
                key.topic.strip("/"),
                world_SE3_sensor,
                problems,
                stamp_s=key.stamp_ns / NS_PER_S,
                middles=source.middles,
            )
            clouds.append(cloud)
    add_problem(problems, OTHER_TREE, len(set(roots)) - 1 if roots else 0)
    time = min(key.stamp_ns for key in keys) / NS_PER_S
    return Frame.of_clouds(name, clouds, Objects.empty(), time=time, problems=problems)


def _read(reader: Any, key: CloudKey) -> bytes:
    """Read the bytes of a cloud's message.

    reader: reader of the file; key: topic and times of the message."""
    messages = reader.iter_messages(
        topics=[key.topic], start_time=key.log_ns, end_time=key.log_ns + 1
    )
    for number, (_, _, message) in enumerate(messages):
        if number == key.number:
            return bytes(message.data)
    raise ValueError(f"the cloud of {key.topic} at {key.log_ns} ns is gone")


def _place(
    message: _Message, key: CloudKey, tree: TransformTree, roots: list[str], problems: Problems
) -> Pose:
    """Return the pose of a cloud in the root of its frame.

    roots: the root is added to it; problems: counts are added to it."""
    placed_frame = tree.find(message.frame_id, key.stamp_ns, key.log_ns)
    roots.append(placed_frame.root)
    add_problem(problems, FAR_TF, int(placed_frame.gap_s >= MAX_TF_GAP_S))
    if not message.HasField("pose"):
        return placed_frame.root_SE3_frame
    turn = message.pose.orientation
    place = message.pose.position
    wxyz = np.array([turn.w, turn.x, turn.y, turn.z])
    if not message.pose.HasField("orientation"):
        wxyz = np.array([1.0, 0.0, 0.0, 0.0])
    frame_SE3_cloud = quaternion_pose(wxyz, np.array([place.x, place.y, place.z]))
    return placed_frame.root_SE3_frame @ frame_SE3_cloud


def parse_fields(message: _Message) -> dict[str, np.ndarray]:
    """Return the columns of a PointCloud by name. Raises ValueError for a malformed one.

    Fields may overlap or leave gaps; x, y and z must be among them."""
    # bytes of a point
    stride = int(message.point_stride)
    size = len(message.data)
    check_unpacked(size, MAX_CLOUD_BYTES)
    names = [entry.name for entry in message.fields]
    if stride < 1 or size % stride:
        raise ValueError(f"a cloud of {size} bytes is no whole number of points of {stride} bytes")
    if len(set(names)) < len(names):
        raise ValueError(f"two fields of a cloud have one name: {', '.join(names)}")
    formats = []
    for entry in message.fields:
        if entry.type not in FOXGLOVE_TYPES:
            raise ValueError(f"field {entry.name} of a cloud has the unknown type {entry.type}")
        kind = np.dtype(FOXGLOVE_TYPES[entry.type])
        if entry.offset + kind.itemsize > stride:
            raise ValueError(
                f"field {entry.name} of a cloud ends at byte {entry.offset + kind.itemsize} of "
                f"points of {stride} bytes"
            )
        formats.append(kind)
    offsets = [int(entry.offset) for entry in message.fields]
    point = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": stride})
    table = np.frombuffer(message.data, point)
    # copies in the byte order of this machine
    columns = {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name in names}
    if not {"x", "y", "z"} <= columns.keys():
        raise ValueError(f"a cloud has no x, y and z, but {', '.join(names) or 'no fields'}")
    return columns
