"""ROS bags: PointCloud2 topics with tf.

They are of ROS 1 (.bag) or ROS 2 (a folder with metadata.yaml, .mcap or .db3 files).

World frame: the root of the clouds' frames in tf. A cloud whose frame no tf mentions stays in its
frame, and is counted.

- All of tf is read first: static transforms come once, and tf of a cloud's time may be recorded
  after the cloud (`toolkit.datasets.transform_tree`).
- Clouds of one time are one frame (`toolkit.datasets.clock_times`). Their time is the header's
  stamp; if the stamps of two topics are of different clocks, or missing, it is the time of
  recording. A frame's time is its first cloud's.
- A point's fields may be anywhere in its point_step bytes, in either order of bytes; `t`, `time` or
  `timestamp` is its time.
- A cloud that cannot be read, and a topic of clouds without x, y and z, is left out and counted.
- Several files of a folder without metadata.yaml are read as one recording.
- There are no labels in a bag. Reading needs the package rosbags."""

import struct
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from heapq import merge
from itertools import islice
from os.path import lexists
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from toolkit.datasets.clock_times import UNPAIRED, group_by_time
from toolkit.datasets.layouts.nuscenes import compute_quaternion
from toolkit.datasets.origins import Middles
from toolkit.datasets.records import (
    BAG_ENDINGS,
    Problems,
    add_problem,
    build_cloud,
    clock_time,
    cloud_time,
    get_intensity,
    list_bags,
    named_damage,
)
from toolkit.datasets.transform_tree import NS_PER_S, TransformLink, TransformTree, parse_link_pose
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects
from toolkit.point_columns import name_attributes
from toolkit.runtime.files import parse_yaml, plain_file, read_text, resolve_below
from toolkit.sites.site import Site

CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
OLD_TF = "tf/msg/tfMessage"
NO_TF = "clouds in a frame that no tf mentions"
OTHER_TREE = "clouds whose frames have another root in tf than the first cloud's"
FAR_TF = "clouds a second or more from the nearest transform of a moving frame"
UNREADABLE = "clouds that cannot be read"
NO_XYZ = "topics of PointCloud2 without x, y and z"
NO_STAMP = "clouds without a stamp, of the time of their recording"
SAME_SENSOR = "clouds of one frame and stamp on another topic too: one sensor's, counted twice"
REPLAYED = "clouds with a stamp that their topic has already, as of a bag played twice"
OTHER_CLOCKS = (
    "clouds of the time of their recording: stamps of clouds and tf are of different clocks"
)
RosObject = Any  # object of rosbags, which has no types
MAX_TF_GAP_S = 1.0
MAX_CLOCK_OFFSET_S = 1.0  # that one topic's stamps are further from their recording than another's
OTHER_PROFILE = "Profile is not ros2."  # rosbags' words for an .mcap of ROS 1
FIRST_ENDING = ".bag"  # of ROS 1
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


class _Message(NamedTuple):
    """A message of a bag, not parsed.

    Attributes:
        topic: its topic.
        kind: its message type.
        recorded_ns: time of its recording.
        data: its bytes.
        has_seq: ROS 1, whose headers begin with a number.
        parser: parses the bytes.
    """

    topic: str
    kind: str
    recorded_ns: int
    data: bytes
    has_seq: bool
    parser: Callable[[bytes], RosObject]

    def parse(self) -> RosObject:
        """Return the message's object. Raises errors of any kind for a damaged one."""
        return self.parser(self.data)

    def read_stamp(self) -> int:
        """Stamp (ns) of the header that the message begins with."""
        if self.has_seq:
            seconds, nanoseconds = struct.unpack_from("<II", self.data, 4)
        else:
            order = "<" if self.data[1] & 1 else ">"
            seconds, nanoseconds = struct.unpack_from(f"{order}iI", self.data, 4)
        return int(seconds) * NS_PER_S + int(nanoseconds)


@dataclass(frozen=True)
class Bag:
    """Frames of a bag, which is read from its beginning for each iteration.

    Attributes:
        path: file or folder.
        groups: number of each topic's cloud in each frame.
        tree: coordinate frames.
        topics: topics of the clouds.
        recorded: topics whose clouds have the time of their recording.
        problems: problems of the whole bag, by kind; the first frame counts them.
        site: the site, None if unknown.
    """

    path: Path
    groups: tuple[Mapping[str, int], ...]
    tree: TransformTree
    topics: tuple[str, ...]
    recorded: Mapping[str, str]
    problems: Mapping[str, int]
    site: Site | None = None
    _middles: Middles = field(default_factory=Middles, compare=False, repr=False)
    _reading: list[tuple[int, Iterator[Frame]]] = field(
        default_factory=list, compare=False, repr=False
    )

    def __len__(self) -> int:
        return len(self.groups)

    def __getitem__(self, index: int) -> Frame:
        """Return the frame with this number, reading on from the last frame or again from the
        beginning."""
        if not 0 <= index < len(self):
            raise IndexError(
                f"there is no frame {index}: {self.path} has {len(self)}, counted from 0"
            )
        following, frames = self._reading.pop() if self._reading else (0, iter(self))
        if index < following:
            following = 0
            frames = iter(self)
        frame = next(islice(frames, index - following, None))
        self._reading.append((index + 1, frames))
        return frame

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_reading": []}

    def __iter__(self) -> Iterator[Frame]:
        group_of = {
            (topic, k): number
            for number, group in enumerate(self.groups)
            for topic, k in group.items()
        }
        counts = dict.fromkeys(self.topics, 0)
        waiting: dict[int, dict[str, _Message]] = {}
        number = 0
        for message in _messages(self.path, CLOUD):
            if message.topic not in counts:
                continue
            group = group_of.get((message.topic, counts[message.topic]))
            counts[message.topic] += 1
            if group is None:
                continue
            waiting.setdefault(group, {})[message.topic] = message
            while number < len(self.groups) and len(waiting.get(number, ())) == len(
                self.groups[number]
            ):
                yield self._frame(number, waiting.pop(number))
                number += 1

    def _frame(self, number: int, messages: Mapping[str, _Message]) -> Frame:
        problems: Problems = dict(self.problems) if number == 0 else {}
        add_problem(problems, UNPAIRED, int(len(messages) < len(self.topics)))
        clouds: list[SensorCloud] = []
        roots: list[str] = []
        sources: set[tuple[str, int]] = set()
        for _, message in sorted(messages.items()):
            try:
                cloud = message.parse()
                attributes = name_attributes(parse_columns(cloud))
            except Exception:  # rosbags and its parsers raise errors of any kind
                add_problem(problems, UNREADABLE, 1)
                continue
            source = clean_frame(cloud.header.frame_id), _stamp(cloud.header)
            add_problem(problems, SAME_SENSOR, int(source in sources and source[1] != 0))
            sources.add(source)
            with _damage(self.path):
                clouds.append(self._cloud(message, cloud, attributes, roots, problems))
        time = min(self._time(message) for message in messages.values())
        return Frame.of_clouds(
            f"{number:06d}", clouds, Objects.empty(), time=time, problems=problems
        )

    def _time(self, message: _Message) -> float:
        """Time of a cloud (s): its stamp, or the time of its recording."""
        stamp = 0 if message.topic in self.recorded else message.read_stamp()
        return (stamp or message.recorded_ns) / NS_PER_S

    def _cloud(
        self,
        message: _Message,
        cloud: RosObject,
        attributes: Mapping[str, np.ndarray],
        roots: list[str],
        problems: Problems,
    ) -> SensorCloud:
        """A topic's cloud in the world.

        roots: roots of the frame's clouds before it, and afterwards of this one too."""
        frame = clean_frame(cloud.header.frame_id)
        stamp = _stamp(cloud.header)
        measured = (
            message.recorded_ns if message.topic in self.recorded else stamp or message.recorded_ns
        )
        placed = self.tree.find(frame, measured, message.recorded_ns)
        is_placed = self.tree.knows(frame)
        is_alone = not self.tree.static and not self.tree.moving and len(self.topics) == 1
        add_problem(problems, NO_TF, int(not is_placed and not is_alone))
        add_problem(
            problems, OTHER_TREE, int(is_placed and bool(roots) and placed.root != roots[0])
        )
        add_problem(problems, FAR_TF, int(placed.gap_s >= MAX_TF_GAP_S))
        roots += [placed.root] * is_placed
        why = self.recorded.get(message.topic) or (
            "" if stamp or not message.recorded_ns else NO_STAMP
        )
        add_problem(problems, why, int(bool(why)))
        seconds = self._time(message)
        name = message.topic.strip("/")
        return build_cloud(
            attributes,
            name,
            placed.root_SE3_frame,
            problems,
            stamp_s=seconds,
            middles=self._middles,
        )


def clean_frame(name: object) -> str:
    """Name of a coordinate frame without the slash that tf of ROS 1 puts before it."""
    return str(name).strip("/")


def rosbag(path: Path) -> Bag:
    """Frames of a bag.

    Raises FileNotFoundError, and ValueError for a bag that is damaged or has no PointCloud2."""
    path = _enter_bag_folder(path)
    is_bare = path.is_dir() and not lexists(path / "metadata.yaml")
    files = list_bags(path) if is_bare else []
    if len(files) > 1:
        names = ", ".join(file.name for file in files[:6])
        warnings.warn(
            f"{path}: {names} are read as one recording: give one of them to read no other",
            stacklevel=2,
        )
    index = _index_messages(path)
    topics = tuple(topic for topic in index.stamps_ns if index.with_points.get(topic, True))
    if not any(index.with_points.values()):
        _refuse(path, bool(index.with_points), index.reason)
    stamps = {topic: np.array(index.stamps_ns[topic], np.int64) for topic in topics}
    recorded = {topic: np.array(index.recorded_ns[topic], np.int64) for topic in topics}
    tree = TransformTree.from_links(index.links)
    instead = _find_other_clocks(
        {topic: (stamps[topic], recorded[topic]) for topic in topics},
        _moving_times(index.links, tree),
    )
    times = {}
    for topic in topics:
        if topic in instead:
            times[topic] = recorded[topic]
        else:
            times[topic] = np.where(stamps[topic] == 0, recorded[topic], stamps[topic])
    start = min(int(times_ns.min()) for times_ns in times.values())
    groups = group_by_time(
        {topic: (times_ns - start) / NS_PER_S for topic, times_ns in times.items()}
    )
    problems = dict(tree.problems)
    if not instead:
        stamped = [stamps_ns[stamps_ns != 0] for stamps_ns in stamps.values()]
        replayed = sum(len(stamps_ns) - len(np.unique(stamps_ns)) for stamps_ns in stamped)
        add_problem(problems, REPLAYED, replayed)
    add_problem(problems, NO_XYZ, len(index.stamps_ns) - len(topics))
    return Bag(path, tuple(groups), tree, topics, instead, problems)


@dataclass
class _Index:
    """Contents of a bag, without the points.

    Attributes:
        stamps_ns: stamps of each topic's clouds.
        recorded_ns: times of recording of each topic's clouds.
        with_points: whether a topic's first readable cloud has x, y and z.
        links: transforms of tf.
        reason: error of the last cloud that cannot be read.
    """

    stamps_ns: dict[str, list[int]] = field(default_factory=dict)
    recorded_ns: dict[str, list[int]] = field(default_factory=dict)
    with_points: dict[str, bool] = field(default_factory=dict)
    links: list[TransformLink] = field(default_factory=list)
    reason: Exception | None = None


def _index_messages(path: Path) -> _Index:
    """Read stamps and transforms of a bag."""
    index = _Index()
    for message in _messages(path, CLOUD, TF, OLD_TF):
        topic = message.topic
        if message.kind != CLOUD:
            index.links += _parse_links(path, message)
            continue
        if topic not in index.with_points:
            try:
                names = {str(column.name) for column in message.parse().fields}
                index.with_points[topic] = {"x", "y", "z"} <= names
            except Exception as error:  # rosbags and its parsers raise errors of any kind
                index.reason = error
        with _damage(path):
            index.stamps_ns.setdefault(topic, []).append(message.read_stamp())
        index.recorded_ns.setdefault(topic, []).append(message.recorded_ns)
    return index


def _moving_times(
    links: Sequence[TransformLink], tree: TransformTree
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Stamps and times of recording (ns) of moving transforms, under the topic of tf."""
    moving = [
        link for link in links if not link.is_static and link.stamp_ns and link.child in tree.moving
    ]
    if not moving:
        return {}
    stamps = np.array([link.stamp_ns for link in moving])
    recorded = np.array([link.recorded_ns for link in moving])
    return {TF: (stamps, recorded)}


def _find_other_clocks(
    clouds: Mapping[str, tuple[np.ndarray, np.ndarray]],
    moving: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> dict[str, str]:
    """Topics whose clouds have the time of their recording, and why.

    These are all topics if stamps are of different clocks. clouds: stamps and times of recording
    (ns) by topic; moving: the same of moving transforms."""
    offsets_s = []
    for stamps, recorded in (*clouds.values(), *moving.values()):
        is_stamped = stamps != 0
        late = recorded[is_stamped] - stamps[is_stamped]
        offsets_s.append(float(np.median(late)) / NS_PER_S if len(late) else 0.0)
    if max(offsets_s) - min(offsets_s) <= MAX_CLOCK_OFFSET_S:
        return {}
    return dict.fromkeys(clouds, OTHER_CLOCKS)


def _refuse(path: Path, has_clouds: bool, reason: Exception | None) -> None:
    """Raise ValueError with the reason that a bag has no clouds of points."""
    if reason is not None:
        with _damage(path):
            raise reason
    if has_clouds:
        raise ValueError(
            f"{path} holds {CLOUD} without fields x, y and z only: convert them to points first"
        )
    kinds: dict[str, str] = {}
    with _open(path) as readers:
        for connection in (
            connection_info for reader in readers for connection_info in reader.connections
        ):
            kinds[str(connection.topic)] = str(connection.msgtype)
    content = (
        ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items())[:6]) or "no topics"
    )
    raise ValueError(
        f"{path} holds no messages of {CLOUD}, but {content}: convert its lidar's messages to "
        "PointCloud2"
    )


def _parse_links(path: Path, message: _Message) -> list[TransformLink]:
    with _damage(path):
        content = message.parse()
        links = []
        for link in content.transforms:
            translation = link.transform.translation
            rotation = link.transform.rotation
            wxyz = np.array([rotation.w, rotation.x, rotation.y, rotation.z])
            pose = parse_link_pose(wxyz, np.array([translation.x, translation.y, translation.z]))
            names = clean_frame(link.child_frame_id), clean_frame(link.header.frame_id)
            is_static = message.topic.rstrip("/").endswith("tf_static")
            links.append(
                TransformLink(*names, pose, _stamp(link.header), message.recorded_ns, is_static)
            )
    return links


def parse_columns(message: RosObject) -> dict[str, np.ndarray]:
    """Parse the fields of a PointCloud2, a row per point.

    Raises ValueError if they do not fit its bytes."""
    order = ">" if message.is_bigendian else "<"
    width = int(message.width)
    height = int(message.height)
    step = int(message.point_step)
    row_step = int(message.row_step)
    data = np.asarray(message.data, np.uint8)
    names = []
    formats = []
    offsets = []
    for point_field in message.fields:
        if (
            point_field.datatype not in _TYPES
            or point_field.name in names
            or point_field.count not in (0, 1)
        ):
            continue  # padding, or several numbers
        kind = np.dtype(order + _TYPES[point_field.datatype])
        if not 0 <= point_field.offset <= step - kind.itemsize:
            raise ValueError(f"field {point_field.name} does not fit a point of {step} bytes")
        names.append(str(point_field.name))
        formats.append(kind)
        offsets.append(int(point_field.offset))
    packed_step = width * step
    if row_step < packed_step <= len(data) // max(height, 1) or (
        height * row_step > len(data) == height * packed_step
    ):
        # some drivers leave it 0, or do not change it with the width: rows follow one another
        row_step = packed_step
    if step < 1 or row_step < width * step or len(data) < height * row_step:
        raise ValueError(f"a cloud of {height} rows of {width} points has {len(data)} bytes only")
    packed = np.ascontiguousarray(
        data[: height * row_step].reshape(height, row_step)[:, : width * step]
    )
    point = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    table = np.frombuffer(packed.tobytes(), point, width * height)
    columns = {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name in names}
    if not {"x", "y", "z"} <= columns.keys():
        raise ValueError(f"a cloud has no x, y and z, but {', '.join(names)}")
    return columns


def _stamp(header: RosObject) -> int:
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


# rosbags and its parsers raise errors of any kind
_damage = partial(named_damage, what="bag", kinds=(Exception,))


@contextmanager
def _open(path: Path) -> Iterator[list[RosObject]]:
    """Open the readers of a bag's files."""
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError:
        raise ImportError("reading bags needs rosbags: pip install rosbags") from None
    with ExitStack() as stack:
        readers = []
        with _damage(path):
            for file in _list_files(path):
                kind = rosbag1.Reader if _is_first_ros(file) else rosbag2.Reader
                try:
                    readers.append(stack.enter_context(kind(file)))
                except rosbag2.ReaderError as error:
                    if str(error) != OTHER_PROFILE:
                        raise
                    remedy = "give the .bag it was made of, or convert that with rosbags-convert"
                    raise ValueError(
                        f"its messages are not of ROS 2 (its profile tells): {remedy}"
                    ) from None
        yield readers


def _enter_bag_folder(path: Path) -> Path:
    """Folder of the only bag in a folder without bag files, as writing makes it, else `path`."""
    if not path.is_dir() or lexists(path / "metadata.yaml") or list_bags(path):
        return path
    folders = [folder for folder in sorted(path.iterdir()) if lexists(folder / "metadata.yaml")]
    return folders[0] if len(folders) == 1 else path


def _is_first_ros(path: Path) -> bool:
    """Return whether a bag is of ROS 1: a file, since a folder named *.bag is of ROS 2."""
    return path.suffix.lower() == FIRST_ENDING and not path.is_dir()


def _list_files(path: Path) -> list[Path]:
    """Files of a bag, or its folder if that has metadata."""
    if lexists(described := path / "metadata.yaml"):
        content = parse_yaml(read_text(plain_file(described)))
        for name in content["rosbag2_bagfile_information"]["relative_file_paths"]:
            plain_file(resolve_below(path, str(name)))
        return [path]
    if not path.is_dir():
        return [plain_file(path)]
    files = list_bags(path)
    if not files:
        raise ValueError(f"it holds no file of {', '.join(BAG_ENDINGS)}")
    if len({file.suffix.lower() for file in files}) > 1:
        raise ValueError(
            f"it holds bags of several kinds, {', '.join(file.name for file in files[:6])}: give "
            "one file"
        )
    return [plain_file(file) for file in files]


def _make_parser(
    kind: str, readers: Iterable[RosObject], has_seq: bool
) -> Callable[[bytes], RosObject]:
    """Parser of one message type, by its definition in the bag, else by ROS 2 Humble's."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    connections = [
        connection
        for reader in readers
        for connection in reader.connections
        if connection.msgtype == kind
    ]
    definitions = [
        connection.msgdef
        for connection in connections
        if connection.msgdef.format != MessageDefinitionFormat.NONE
    ]
    store = get_typestore(Stores.EMPTY if definitions else Stores.ROS2_HUMBLE)
    if definitions and definitions[0].format == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definitions[0].data, kind))
    elif definitions:
        for text in definitions[0].data.split(f"{'=' * 80}\n"):
            store.register(
                get_types_from_idl(text.split("\n", 1)[1] if text.startswith("IDL: ") else text)
            )
    parse = store.deserialize_ros1 if has_seq else store.deserialize_cdr
    return partial(_call, parse, kind)


def _call(parse: Callable[[bytes, str], RosObject], kind: str, data: bytes) -> RosObject:
    return parse(data, kind)


def _messages(path: Path, *kinds: str) -> Iterator[_Message]:
    """Yield the messages of some kinds, of all files together, by the time of their recording."""
    with _open(path) as readers:
        has_seq = any(map(_is_first_ros, _list_files(path)))
        with _damage(path):
            message_types = {
                connection_info.msgtype
                for reader in readers
                for connection_info in reader.connections
            } & set(kinds)
            parsers = {kind: _make_parser(kind, readers, has_seq) for kind in message_types}
            streams = []
            for reader in readers:
                connections = [
                    connection_info
                    for connection_info in reader.connections
                    if connection_info.msgtype in message_types
                ]
                streams += [reader.messages(connections=connections)] if connections else []
            messages = merge(*streams, key=lambda connection_info: connection_info[1])
        while True:
            with _damage(path):
                following = next(messages, None)
                if following is None:
                    return
                connection, recorded_ns, data = following
            kind = connection.msgtype
            yield _Message(str(connection.topic), kind, recorded_ns, data, has_seq, parsers[kind])


def write_rosbag(samples: Iterable[Frame], folder: Path) -> None:
    """Write clouds for ROS 2: recording.mcap, a topic per sensor with tf, without labels.

    A warning names the labels that are left out."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    connections: dict[str, RosObject] = {}
    labels = 0
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        tf = writer.add_connection("/tf", TF, typestore=store)
        for number, sample in enumerate(samples, 1):
            labels += len(sample.objects)
            seconds = clock_time(sample, number)
            stamp = round(seconds * 1e9)
            stamps = {
                cloud.name: round(cloud_time(cloud, seconds) * 1e9) for cloud in sample.clouds
            }
            links = store.types[TF](
                transforms=[_link(store, cloud, stamps[cloud.name]) for cloud in sample.clouds]
            )
            writer.write(tf, stamp, store.serialize_cdr(links, TF))
            for cloud in sample.clouds:
                if cloud.name not in connections:
                    connections[cloud.name] = writer.add_connection(
                        f"/{cloud.name}", CLOUD, typestore=store
                    )
                message = _message(store, cloud, stamps[cloud.name])
                writer.write(connections[cloud.name], stamp, store.serialize_cdr(message, CLOUD))
    if labels:
        warnings.warn(f"a bag has no place for labels, {labels} are not in it", stacklevel=2)


def _header(store: RosObject, stamp: int, frame: str) -> RosObject:
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _link(store: RosObject, cloud: SensorCloud, stamp: int) -> RosObject:
    package = "geometry_msgs/msg"
    w, x, y, z = compute_quaternion(cloud.world_SE3_sensor).tolist()
    position = store.types[f"{package}/Vector3"](*cloud.world_SE3_sensor[:3, 3].tolist())
    rotation = store.types[f"{package}/Quaternion"](x=x, y=y, z=z, w=w)
    transform = store.types[f"{package}/Transform"](translation=position, rotation=rotation)
    make = store.types[f"{package}/TransformStamped"]
    return make(_header(store, stamp, "world"), child_frame_id=cloud.name, transform=transform)


def _message(store: RosObject, cloud: SensorCloud, stamp: int) -> RosObject:
    table = np.column_stack([cloud.in_sensor(), get_intensity(cloud)]).astype("<f4")
    make = store.types["sensor_msgs/msg/PointField"]
    names = enumerate(("x", "y", "z", "intensity"))
    fields = [make(name=name, offset=4 * k, datatype=7, count=1) for k, name in names]
    sizes = {"height": 1, "width": len(table), "point_step": 16, "row_step": 16 * len(table)}
    data = np.frombuffer(table.tobytes(), np.uint8)
    header = _header(store, stamp, cloud.name)
    return store.types[CLOUD](
        header=header, fields=fields, is_bigendian=False, data=data, is_dense=True, **sizes
    )
