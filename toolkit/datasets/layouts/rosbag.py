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

import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from os.path import lexists
from pathlib import Path

import numpy as np

from toolkit.datasets.clock_times import UNPAIRED, group_by_time
from toolkit.datasets.cloud_records import build_cloud, get_intensity
from toolkit.datasets.folders import list_bags
from toolkit.datasets.frame_times import clock_time, cloud_time
from toolkit.datasets.layouts.bag_index import (
    find_other_clocks,
    index_messages,
    moving_times,
    refuse_bag,
)
from toolkit.datasets.layouts.bag_messages import (
    CLOUD,
    TF,
    BagMessage,
    RosObject,
    clean_frame,
    enter_bag_folder,
    name_bag_damage,
    read_messages,
    stamp_ns,
)
from toolkit.datasets.layouts.nuscenes import compute_quaternion
from toolkit.datasets.layouts.point_cloud2 import parse_columns
from toolkit.datasets.origins import Middles
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.datasets.transform_tree import NS_PER_S, TransformTree
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects
from toolkit.point_columns import name_attributes
from toolkit.sites.site import Site

NO_TF = "clouds in a frame that no tf mentions"
OTHER_TREE = "clouds whose frames have another root in tf than the first cloud's"
FAR_TF = "clouds a second or more from the nearest transform of a moving frame"
UNREADABLE = "clouds that cannot be read"
NO_XYZ = "topics of PointCloud2 without x, y and z"
NO_STAMP = "clouds without a stamp, of the time of their recording"
SAME_SENSOR = "clouds of one frame and stamp on another topic too: one sensor's, counted twice"
REPLAYED = "clouds with a stamp that their topic has already, as of a bag played twice"
MAX_TF_GAP_S = 1.0


@dataclass(frozen=True)
class Bag:
    """Frames of a bag, which is read from its beginning for each iteration.

    Attributes:
        path: file or folder.
        groups: for each frame, the topics of its clouds and each cloud's index in its topic.
        tree: coordinate frames.
        topics: topics of the clouds.
        recorded: topics whose clouds get the time of their recording, with the reason.
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
        """Return a frame by its index, reading on from the last one or again from the beginning."""
        if not 0 <= index < len(self):
            raise IndexError(
                f"there is no frame {index}: {self.path} has {len(self)}, counted from 0"
            )
        # `_reading` holds at most one pair, the number of the next frame and an iterator that gives
        # it, and none while a frame is being read
        next_number, frames = self._reading.pop() if self._reading else (0, iter(self))
        if index < next_number:
            next_number, frames = 0, iter(self)
        frame = next(islice(frames, index - next_number, None))  # skips those before
        self._reading.append((index + 1, frames))
        return frame

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_reading": []}

    def __iter__(self) -> Iterator[Frame]:
        """Read the bag once; yield the frames in order, each as soon as it has all its clouds."""
        # frame number of each cloud, by topic and index in the topic
        frame_of_cloud = {
            (topic, index): number
            for number, group in enumerate(self.groups)
            for topic, index in group.items()
        }
        counts = dict.fromkeys(self.topics, 0)  # messages read so far
        waiting: dict[int, dict[str, BagMessage]] = {}  # clouds by frame number and topic
        # number of the frame to yield next
        next_frame = 0
        for message in read_messages(self.path, CLOUD):
            if message.topic not in counts:
                continue
            number = frame_of_cloud.get((message.topic, counts[message.topic]))
            counts[message.topic] += 1
            # a cloud that is in no frame
            if number is None:
                continue
            waiting.setdefault(number, {})[message.topic] = message
            while next_frame < len(self.groups) and len(waiting.get(next_frame, ())) == len(
                self.groups[next_frame]
            ):
                yield self._make_frame(next_frame, waiting.pop(next_frame))
                next_frame += 1

    def _make_frame(self, number: int, messages: Mapping[str, BagMessage]) -> Frame:
        """Make the frame of a number from its clouds' messages, by topic.

        Clouds that cannot be read are left out and counted in the frame's problems."""
        problems: Problems = dict(self.problems) if number == 0 else {}
        add_problem(problems, UNPAIRED, int(len(messages) < len(self.topics)))
        clouds: list[SensorCloud] = []
        roots: list[str] = []  # root frames of the clouds so far
        sources: set[tuple[str, int]] = set()  # coordinate frames and stamps of the clouds so far
        for _, message in sorted(messages.items()):
            try:
                cloud = message.parse()
                attributes = name_attributes(parse_columns(cloud))
            except Exception:  # rosbags and its parsers raise errors of any kind
                add_problem(problems, UNREADABLE, 1)
                continue
            stamp = stamp_ns(cloud.header)
            source = clean_frame(cloud.header.frame_id), stamp
            # two topics with one cloud; a stamp of 0 means that none was set
            add_problem(problems, SAME_SENSOR, int(source in sources and stamp != 0))
            sources.add(source)
            with name_bag_damage(self.path):
                clouds.append(self._cloud(message, cloud, attributes, roots, problems))
        time = min(self._time(message) for message in messages.values())
        return Frame.of_clouds(
            f"{number:06d}", clouds, Objects.empty(), time=time, problems=problems
        )

    def _time(self, message: BagMessage) -> float:
        """Time of a cloud (s): its stamp, or the time of its recording."""
        stamp = 0 if message.topic in self.recorded else message.read_stamp()
        return (stamp or message.recorded_ns) / NS_PER_S

    def _cloud(
        self,
        message: BagMessage,
        cloud: RosObject,
        attributes: Mapping[str, np.ndarray],
        roots: list[str],
        problems: Problems,
    ) -> SensorCloud:
        """Build the cloud of one message at its pose in the world.

        cloud: the parsed message; attributes: its columns; roots: root frames of the clouds before
        it in this frame, to which its root is added; problems: counts are added to it."""
        frame = clean_frame(cloud.header.frame_id)
        stamp = stamp_ns(cloud.header)
        has_other_clock = message.topic in self.recorded
        measured_ns = message.recorded_ns if has_other_clock else stamp or message.recorded_ns
        placed = self.tree.find(frame, measured_ns, message.recorded_ns)
        if self.tree.knows(frame):
            add_problem(problems, OTHER_TREE, int(bool(roots) and placed.root != roots[0]))
            roots.append(placed.root)
        else:
            # a single sensor needs no tf
            is_alone = not self.tree.static and not self.tree.moving and len(self.topics) == 1
            add_problem(problems, NO_TF, int(not is_alone))
        add_problem(problems, FAR_TF, int(placed.gap_s >= MAX_TF_GAP_S))
        if has_other_clock:
            add_problem(problems, self.recorded[message.topic], 1)
        elif not stamp and message.recorded_ns:
            add_problem(problems, NO_STAMP, 1)
        return build_cloud(
            attributes,
            name=message.topic.strip("/"),
            world_SE3_sensor=placed.root_SE3_frame,
            problems=problems,
            stamp_s=self._time(message),
            middles=self._middles,
        )


def rosbag(path: Path) -> Bag:
    """Open a bag: its frames, without labels.

    Raises FileNotFoundError, and ValueError for a bag that is damaged or has no PointCloud2."""
    path = enter_bag_folder(path)
    is_bare = path.is_dir() and not lexists(path / "metadata.yaml")
    files = list_bags(path) if is_bare else []
    if len(files) > 1:
        names = ", ".join(file.name for file in files[:6])
        warnings.warn(
            f"{path}: {names} are read as one recording: give one of them to read no other",
            stacklevel=2,
        )
    index = index_messages(path)
    topics = tuple(topic for topic in index.stamps_ns if index.with_points.get(topic, True))
    if not any(index.with_points.values()):
        refuse_bag(path, bool(index.with_points), index.reason)
    stamps = {topic: np.array(index.stamps_ns[topic], np.int64) for topic in topics}
    recorded_ns = {topic: np.array(index.recorded_ns[topic], np.int64) for topic in topics}
    tree = TransformTree.from_links(index.links)
    instead = find_other_clocks(
        {topic: (stamps[topic], recorded_ns[topic]) for topic in topics},
        moving_times(index.links, tree),
    )
    times = {}
    for topic in topics:
        if topic in instead:
            times[topic] = recorded_ns[topic]
        else:
            times[topic] = np.where(stamps[topic] == 0, recorded_ns[topic], stamps[topic])
    start = min(int(times_ns.min()) for times_ns in times.values())
    groups = group_by_time(
        {topic: (times_ns - start) / NS_PER_S for topic, times_ns in times.items()}
    )
    problems = dict(tree.problems)
    if not instead:
        nonzero_stamps = [stamps_ns[stamps_ns != 0] for stamps_ns in stamps.values()]
        replayed_count = sum(
            len(stamps_ns) - len(np.unique(stamps_ns)) for stamps_ns in nonzero_stamps
        )
        add_problem(problems, REPLAYED, replayed_count)
    add_problem(problems, NO_XYZ, len(index.stamps_ns) - len(topics))
    return Bag(
        path, groups=tuple(groups), tree=tree, topics=topics, recorded=instead, problems=problems
    )


def write_rosbag(samples: Iterable[Frame], folder: Path) -> None:
    """Write clouds for ROS 2: recording.mcap, a topic per sensor with tf, without labels.

    A warning names the labels that are left out."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    connections: dict[str, RosObject] = {}
    label_count = 0
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        tf = writer.add_connection("/tf", TF, typestore=store)
        for number, sample in enumerate(samples, 1):
            label_count += len(sample.objects)
            seconds = clock_time(sample, number)
            frame_ns = round(seconds * 1e9)
            cloud_ns = [round(cloud_time(cloud, seconds) * 1e9) for cloud in sample.clouds]
            stamped_clouds = list(zip(sample.clouds, cloud_ns, strict=True))
            links = [make_link(store, cloud, stamp) for cloud, stamp in stamped_clouds]
            tf_message = store.types[TF](transforms=links)
            writer.write(tf, frame_ns, store.serialize_cdr(tf_message, TF))
            for cloud, stamp in stamped_clouds:
                if cloud.name not in connections:
                    connections[cloud.name] = writer.add_connection(
                        f"/{cloud.name}", CLOUD, typestore=store
                    )
                message = make_cloud_message(store, cloud, stamp)
                writer.write(connections[cloud.name], frame_ns, store.serialize_cdr(message, CLOUD))
    if label_count:
        warnings.warn(f"a bag has no place for labels, {label_count} are not in it", stacklevel=2)


def _make_header(store: RosObject, stamp_ns: int, frame: str) -> RosObject:
    """Make the header of a ROS message. store: rosbags' message types."""
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    time = store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def make_link(store: RosObject, cloud: SensorCloud, stamp_ns: int) -> RosObject:
    """Make the transform from a cloud's sensor to the frame "world". store: types of rosbags."""
    package = "geometry_msgs/msg"
    w, x, y, z = compute_quaternion(cloud.world_SE3_sensor).tolist()
    rotation = store.types[f"{package}/Quaternion"](x=x, y=y, z=z, w=w)
    coordinates = dict(zip("xyz", cloud.world_SE3_sensor[:3, 3].tolist(), strict=True))
    position = store.types[f"{package}/Vector3"](**coordinates)
    return store.types[f"{package}/TransformStamped"](
        header=_make_header(store, stamp_ns, frame="world"),
        child_frame_id=cloud.name,
        transform=store.types[f"{package}/Transform"](translation=position, rotation=rotation),
    )


def make_cloud_message(store: RosObject, cloud: SensorCloud, stamp_ns: int) -> RosObject:
    """Make the PointCloud2 of a cloud, float32 in its sensor's frame. store: types of rosbags."""
    table = np.column_stack([cloud.in_sensor(), get_intensity(cloud)]).astype("<f4")
    make_field = store.types["sensor_msgs/msg/PointField"]
    # four numbers of 4 bytes; 7 is float32
    fields = [
        make_field(name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate(("x", "y", "z", "intensity"))
    ]
    return store.types[CLOUD](
        header=_make_header(store, stamp_ns, frame=cloud.name),
        height=1,
        width=len(table),
        fields=fields,
        is_bigendian=False,
        point_step=16,
        row_step=16 * len(table),
        data=np.frombuffer(table.tobytes(), np.uint8),
        is_dense=True,
    )
