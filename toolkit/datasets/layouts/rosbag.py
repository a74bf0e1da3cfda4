"""ROS bags: PointCloud2 topics with tf, of ROS 1 (.bag) or ROS 2 (a folder with metadata.yaml, one .mcap or .db3 file).

World frame: the root of the tf tree that the clouds' frames hang from. A cloud whose frame no tf mentions stays in its
own, and is counted.

- All of tf is read first: static transforms come once, and tf of a cloud's time may be recorded after the cloud.
- Between two transforms of a moving frame the pose is interpolated; before the first and after the last it is theirs.
- A frame is one round of the topics: it ends when a topic comes again. Its time is that of its first cloud.
- A point's fields lie anywhere in its point_step bytes, in either byte order; `t`, `time` or `timestamp` is its time.
- There are no labels in a bag. Reading needs the package rosbags."""

import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets.cloud_files import quaternion_pose
from toolkit.datasets.layouts.nuscenes import compute_quaternion
from toolkit.datasets.records import (
    Problems,
    add_problem,
    build_cloud,
    clock_time,
    cloud_time,
    get_intensity,
    named_damage,
)
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects
from toolkit.point_columns import name_attributes
from toolkit.runtime.files import parse_yaml, plain_file, read_text, resolve_below
from toolkit.sites.site import Site

CLOUD = "sensor_msgs/msg/PointCloud2"
TF, OLD_TF = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
NO_TF = "clouds in a frame that no tf mentions"
RosObject = Any  # of rosbags, which has no types
MOST_LINKS = 64  # from a sensor's frame to the root; longer chains run in a circle
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(frozen=True)
class Bag:
    """Frames of a bag. The bag is read from its beginning each time they are asked for."""

    path: Path
    rounds: int
    frames: "Mapping[str, _Moving]"
    site: Site | None = None
    _reading: list[tuple[int, Iterator[Frame]]] = field(default_factory=list, compare=False, repr=False)

    def __len__(self) -> int:
        return self.rounds

    def __getitem__(self, index: int) -> Frame:
        """Frame of this number. The bag is read on from the last frame, or again from its beginning."""
        if not 0 <= index < self.rounds:
            raise IndexError(f"there is no frame {index}: {self.path} has {self.rounds}, counted from 0")
        following, frames = self._reading.pop() if self._reading else (0, iter(self))
        if index < following:
            following, frames = 0, iter(self)
        frame = next(islice(frames, index - following, None))
        self._reading.append((index + 1, frames))
        return frame

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_reading": []}

    def __iter__(self) -> Iterator[Frame]:
        clouds: dict[str, RosObject] = {}
        number = 0
        for topic, message in _messages(self.path, CLOUD):
            if topic in clouds:
                yield self._sample(number, clouds)
                clouds, number = {}, number + 1
            clouds[topic] = message
        if clouds:
            yield self._sample(number, clouds)

    def _sample(self, number: int, messages: Mapping[str, RosObject]) -> Frame:
        problems: Problems = {}
        clouds = []
        with _damage(self.path):
            stamps = {topic: _stamp(message.header) for topic, message in messages.items()}
            for topic, message in sorted(messages.items(), key=lambda each: each[0]):
                frame = str(message.header.frame_id).lstrip("/")
                add_problem(problems, NO_TF, int(bool(self.frames) and frame not in self.frames))
                attributes = name_attributes(parse_columns(message))
                pose = find_frame_pose(self.frames, frame, stamps[topic])
                stamp = stamps[topic] * 1e-9
                clouds.append(build_cloud(attributes, topic.strip("/"), pose, problems, stamp_s=stamp))
        time = next(iter(stamps.values())) * 1e-9
        return Frame.of_clouds(f"{number:06d}", clouds, Objects.empty(), time=time, problems=problems)


@dataclass(frozen=True, eq=False)
class _Moving:
    """Poses of a coordinate frame in its parent at some times (ns); a static frame has a single one."""

    parent: str
    times: np.ndarray
    poses: np.ndarray

    def at(self, time: int) -> np.ndarray:
        later = int(np.searchsorted(self.times, time))
        if later == 0 or later == len(self.times):
            return self.poses[min(later, len(self.times) - 1)]
        share = (time - self.times[later - 1]) / max(1, self.times[later] - self.times[later - 1])
        return between(self.poses[later - 1], self.poses[later], float(share))


def rosbag(path: Path) -> Bag:
    """Frames of a bag. Raises FileNotFoundError, and ValueError for a bag that is damaged or has no PointCloud2."""
    last: set[str] = set()
    rounds = 0
    for topic, _ in _messages(path, CLOUD, parse=False):
        if topic in last or not rounds:
            rounds, last = rounds + 1, set()
        last.add(topic)
    if not rounds:
        raise ValueError(f"{path} holds no messages of {CLOUD}: is it the right bag?")
    return Bag(path, rounds, _frames(path))


def _frames(path: Path) -> dict[str, _Moving]:
    moving: dict[str, dict[int, tuple[str, np.ndarray]]] = {}
    for _, message in _messages(path, TF, OLD_TF):
        with _damage(path):
            for each in message.transforms:
                where, turned = each.transform.translation, each.transform.rotation
                unit = np.array([turned.w, turned.x, turned.y, turned.z])
                pose = quaternion_pose(unit, np.array([where.x, where.y, where.z]))
                child = str(each.child_frame_id).lstrip("/")
                moving.setdefault(child, {})[_stamp(each.header)] = str(each.header.frame_id).lstrip("/"), pose
    frames = {}
    for child, by_time in moving.items():
        times = sorted(by_time)
        poses = np.stack([by_time[time][1] for time in times])
        frames[child] = _Moving(by_time[times[-1]][0], np.array(times, np.int64), poses)
    roots = {each.parent for each in frames.values()} - frames.keys()
    return frames | {root: _Moving("", np.zeros(1, np.int64), np.eye(4)[None]) for root in roots}


def find_frame_pose(frames: Mapping[str, _Moving], frame: str, time: int) -> Pose:
    """Pose of a frame in its tree's root. time is in ns. Raises ValueError if tf runs in a circle."""
    pose = np.eye(4)
    for _ in range(MOST_LINKS):
        if frame not in frames:
            return pose
        pose, frame = frames[frame].at(time) @ pose, frames[frame].parent
    raise ValueError(f"its tf runs in a circle, through {frame!r}")


def between(a: Pose, b: Pose, share: float) -> Pose:
    """Pose at a share of the way from a to b: along the line, and turning evenly."""
    from scipy.spatial.transform import Rotation, Slerp

    pose = np.eye(4)
    pose[:3, :3] = Slerp([0, 1], Rotation.from_matrix(np.stack([a[:3, :3], b[:3, :3]])))(share).as_matrix()
    pose[:3, 3] = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
    return pose


def parse_columns(message: RosObject) -> dict[str, np.ndarray]:
    """Parse the fields of a PointCloud2, a row per point. Raises ValueError if they do not fit its bytes."""
    order = ">" if message.is_bigendian else "<"
    width, height, step, row_step = map(int, (message.width, message.height, message.point_step, message.row_step))
    data = np.asarray(message.data, np.uint8)
    names, formats, offsets = [], [], []
    for each in message.fields:
        if each.datatype not in _TYPES or each.name in names or each.count not in (0, 1):
            continue  # padding, or several numbers
        kind = np.dtype(order + _TYPES[each.datatype])
        if not 0 <= each.offset <= step - kind.itemsize:
            raise ValueError(f"field {each.name} does not fit a point of {step} bytes")
        names.append(str(each.name))
        formats.append(kind)
        offsets.append(int(each.offset))
    if step < 1 or row_step < width * step or len(data) < height * row_step:
        raise ValueError(f"a cloud of {height} rows of {width} points has {len(data)} bytes only")
    packed = np.ascontiguousarray(data[: height * row_step].reshape(height, row_step)[:, : width * step])
    point = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    table = np.frombuffer(packed.tobytes(), point, width * height)
    columns = {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name in names}
    if not {"x", "y", "z"} <= columns.keys():
        raise ValueError(f"a cloud has no x, y and z, but {', '.join(names)}")
    return columns


def _stamp(header: RosObject) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


_damage = partial(named_damage, what="bag", kinds=(Exception,))  # rosbags and its parsers raise errors of any kind


def _messages(path: Path, *kinds: str, parse: bool = True) -> Iterator[tuple[str, RosObject]]:
    """Yield topics and messages, None where they are not to be parsed, of some kinds."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ImportError("reading bags needs rosbags: pip install rosbags") from None
    with _damage(path):
        if lexists(described := path / "metadata.yaml"):
            content = parse_yaml(read_text(plain_file(described)))
            for name in content["rosbag2_bagfile_information"]["relative_file_paths"]:
                plain_file(resolve_below(path, str(name)))
        reader = AnyReader([plain_file(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        wanted = [each for each in reader.connections if each.msgtype in kinds]
        messages = reader.messages(connections=wanted) if wanted else iter(())
        while True:
            with _damage(path):
                following = next(messages, None)
                if following is None:
                    return
                connection, _, data = following
                message = reader.deserialize(data, connection.msgtype) if parse else None
            yield connection.topic, message
    finally:
        reader.close()


def write_rosbag(samples: Iterable[Frame], folder: Path) -> None:
    """Write clouds for ROS 2: recording.mcap, a topic per sensor with tf, without labels, as a warning says."""
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
            stamps = {cloud.name: round(cloud_time(cloud, seconds) * 1e9) for cloud in sample.clouds}
            links = store.types[TF](transforms=[_link(store, cloud, stamps[cloud.name]) for cloud in sample.clouds])
            writer.write(tf, stamp, store.serialize_cdr(links, TF))
            for cloud in sample.clouds:
                if cloud.name not in connections:
                    connections[cloud.name] = writer.add_connection(f"/{cloud.name}", CLOUD, typestore=store)
                message = _message(store, cloud, stamps[cloud.name])
                writer.write(connections[cloud.name], stamp, store.serialize_cdr(message, CLOUD))
    if labels:
        warnings.warn(f"a bag has no place for labels, {labels} are not in it", stacklevel=2)


def _header(store: RosObject, stamp: int, frame: str) -> RosObject:
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _link(store: RosObject, cloud: SensorCloud, stamp: int) -> RosObject:
    names = ("Transform", "Vector3", "Quaternion", "TransformStamped")
    make, vector, quaternion, stamped = (store.types[f"geometry_msgs/msg/{name}"] for name in names)
    w, x, y, z = compute_quaternion(cloud.world_SE3_sensor).tolist()
    place = vector(*cloud.world_SE3_sensor[:3, 3].tolist())
    moved = make(translation=place, rotation=quaternion(x=x, y=y, z=z, w=w))
    return stamped(_header(store, stamp, "world"), child_frame_id=cloud.name, transform=moved)


def _message(store: RosObject, cloud: SensorCloud, stamp: int) -> RosObject:
    table = np.column_stack([cloud.in_sensor(), get_intensity(cloud)]).astype("<f4")
    make = store.types["sensor_msgs/msg/PointField"]
    names = enumerate(("x", "y", "z", "intensity"))
    fields = [make(name=name, offset=4 * k, datatype=7, count=1) for k, name in names]
    sizes = {"height": 1, "width": len(table), "point_step": 16, "row_step": 16 * len(table)}
    data, header = np.frombuffer(table.tobytes(), np.uint8), _header(store, stamp, cloud.name)
    return store.types[CLOUD](header=header, fields=fields, is_bigendian=False, data=data, is_dense=True, **sizes)
