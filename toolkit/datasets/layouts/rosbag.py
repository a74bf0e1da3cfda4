"""ROS bags: PointCloud2 topics with tf.

They are ROS 1 (.bag) or ROS 2 (a folder with metadata.yaml, or one .mcap or .db3 file).

World frame: the root of the tf tree that the clouds' frames hang from. A cloud whose frame no tf mentions stays in its
own, and is counted.

- All of tf is read first: static transforms come once, and tf of a cloud's time may be recorded after the cloud.
- Between two transforms of a moving frame the pose is interpolated; before the first and after the last it is theirs.
- A frame is one round of the topics: it ends when a topic comes again. Its time is that of its first cloud.
- A point's fields lie anywhere in its point_step bytes, in either byte order; `t`, `time` or `timestamp` is its time.
- There are no labels in a bag. Reading needs the package rosbags.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.cloud_files import quaternion_pose
from toolkit.datasets.layouts.nuscenes import compute_quaternion
from toolkit.datasets.records import add_problem, build_cloud, get_intensity
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, transform
from toolkit.objects import Objects
from toolkit.point_files import name_attributes
from toolkit.runtime.files import writing_together
from toolkit.sites.site import Site

CLOUD = "sensor_msgs/msg/PointCloud2"
TF, OLD_TF = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
NO_TF = "clouds in a frame that no tf mentions"
MOST_LINKS = 64  # from a sensor's frame to the root; longer chains run in a circle
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(frozen=True)
class Bag:
    """Frames of a bag. The bag is read from its beginning each time they are asked for."""

    path: Path
    rounds: int
    frames: Mapping[str, _Moving]
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

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_reading": []}

    def __iter__(self) -> Iterator[Frame]:
        clouds: dict[str, Any] = {}
        number = 0
        for topic, message in _messages(self.path, CLOUD):
            if topic in clouds:
                yield self._sample(number, clouds)
                clouds, number = {}, number + 1
            clouds[topic] = message
        if clouds:
            yield self._sample(number, clouds)

    def _sample(self, number: int, messages: dict[str, Any]) -> Frame:
        problems: dict[str, int] = {}
        clouds = []
        with _damage(self.path):
            stamps = [_stamp(message.header) for message in messages.values()]
            for (topic, message), stamp in sorted(
                zip(messages.items(), stamps, strict=True), key=lambda each: each[0][0]
            ):
                frame = str(message.header.frame_id).lstrip("/")
                add_problem(problems, NO_TF, int(bool(self.frames) and frame not in self.frames))
                attributes = name_attributes(parse_columns(message))
                clouds.append(
                    build_cloud(attributes, topic.strip("/"), find_frame_pose(self.frames, frame, stamp), problems)
                )
        return Frame.of_clouds(
            f"{number:06d}", tuple(clouds), Objects.empty(), time=stamps[0] * 1e-9, problems=problems
        )


@dataclass(frozen=True, eq=False)
class _Moving:
    """One coordinate frame's poses in its parent. It has poses at some times (ns); a static frame has a single one."""

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
    for topic in _topics(path, CLOUD):
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
                pose = quaternion_pose(
                    np.array([turned.w, turned.x, turned.y, turned.z]), np.array([where.x, where.y, where.z])
                )
                child = str(each.child_frame_id).lstrip("/")
                moving.setdefault(child, {})[_stamp(each.header)] = str(each.header.frame_id).lstrip("/"), pose
    frames = {}
    for child, by_time in moving.items():
        times = sorted(by_time)
        poses = np.stack([by_time[time][1] for time in times])
        frames[child] = _Moving(by_time[times[-1]][0], np.array(times, np.int64), poses)
    roots = {each.parent for each in frames.values()} - frames.keys()
    return frames | {root: _Moving("", np.zeros(1, np.int64), np.eye(4)[None]) for root in roots}


def find_frame_pose(frames: Mapping[str, _Moving], frame: str, time: int) -> Float64[np.ndarray, "4 4"]:
    """Pose of a frame in its tree's root. time is in ns. Raises ValueError if tf runs in a circle."""
    pose = np.eye(4)
    for _ in range(MOST_LINKS):
        if frame not in frames:
            return pose
        pose, frame = frames[frame].at(time) @ pose, frames[frame].parent
    raise ValueError(f"its tf runs in a circle, through {frame!r}")


def between(a: Float64[np.ndarray, "4 4"], b: Float64[np.ndarray, "4 4"], share: float) -> Float64[np.ndarray, "4 4"]:
    """Interpolate between two poses.

    `share` is the part of the way from a to b: along the line, and turning evenly.

    >>> between(np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0]), 0.5)[1, 0].round(6).item()
    1.0
    """
    first, last = compute_quaternion(a), compute_quaternion(b)
    if first @ last < 0:
        last = -last
    angle = float(np.arccos(np.clip(first @ last, -1, 1)))
    if angle < 1e-9:
        turned = last
    else:
        turned = (np.sin((1 - share) * angle) * first + np.sin(share * angle) * last) / np.sin(angle)
    return quaternion_pose(turned, a[:3, 3] + share * (b[:3, 3] - a[:3, 3]))


def parse_columns(message: Any) -> dict[str, np.ndarray]:
    """Parse the fields of a PointCloud2, a row per point. Raises ValueError if they do not fit its bytes."""
    order = ">" if message.is_bigendian else "<"
    count, step = int(message.width) * int(message.height), int(message.point_step)
    data = np.asarray(message.data, np.uint8)
    names, formats, offsets = [], [], []
    for each in message.fields:
        if each.datatype not in _TYPES or each.name in names or each.count not in (0, 1):
            continue  # padding, or a each of several numbers
        kind = np.dtype(order + _TYPES[each.datatype])
        if not 0 <= each.offset <= step - kind.itemsize:
            raise ValueError(f"field {each.name} does not fit a point of {step} bytes")
        names.append(str(each.name))
        formats.append(kind)
        offsets.append(int(each.offset))
    if (
        step < 1
        or int(message.row_step) < int(message.width) * step
        or len(data) < int(message.height) * int(message.row_step)
    ):
        raise ValueError(f"a cloud of {message.height} rows of {message.width} points has {len(data)} bytes only")
    rows = data[: int(message.height) * int(message.row_step)].reshape(int(message.height), int(message.row_step))
    packed = np.ascontiguousarray(rows[:, : int(message.width) * step]).reshape(-1)
    point = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    table = np.frombuffer(packed.tobytes(), point, count)
    columns = {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name in names}
    if not {"x", "y", "z"} <= columns.keys():
        raise ValueError(f"a cloud has no x, y and z, but {', '.join(names)}")
    return columns


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ImportError("reading bags needs rosbags: pip install rosbags") from None
    with _damage(path):
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Turn errors on damaged bags into errors of ours.

    rosbags, and the parsers it uses, raise errors of any kind on damaged bags.
    """
    try:
        yield
    except OSError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(f"{path} is no bag that can be read: {reason}") from None


def _messages(path: Path, *kinds: str) -> Iterator[tuple[str, Any]]:
    return _each(path, kinds, lambda reader, connection, data: reader.deserialize(data, connection.msgtype))


def _topics(path: Path, kind: str) -> Iterator[str]:
    return (topic for topic, _ in _each(path, (kind,), lambda *_: None))


def _each(path: Path, kinds: tuple[str, ...], made: Callable[[Any, Any, bytes], Any]) -> Iterator[tuple[str, Any]]:
    with _reader(path) as reader:
        wanted = [each for each in reader.connections if each.msgtype in kinds]
        if not wanted:
            return
        messages = reader.messages(connections=wanted)
        while True:
            with _damage(path):
                try:
                    connection, _, data = next(messages)
                except StopIteration:
                    return
                message = made(reader, connection, data)
            yield connection.topic, message


def write_rosbag(samples: Iterable[Frame], folder: Path) -> int:
    """Write the clouds of frames for ROS 2.

    Returns how many frames were written. They go to recording.mcap, a topic per sensor with tf. A bag cannot hold
    labels, and a warning says so.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    connections: dict[str, Any] = {}
    written = labels = 0
    with (
        writing_together(folder) as unfinished,
        Writer(unfinished / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        tf = writer.add_connection("/tf", TF, typestore=store)
        for written, sample in enumerate(samples, 1):
            labels += len(sample.objects)
            stamp = round((sample.time if np.isfinite(sample.time) else 0.1 * written) * 1e9)
            writer.write(tf, stamp, store.serialize_cdr(_transforms(store, sample, stamp), TF))
            for cloud in sample.clouds:
                if cloud.name not in connections:
                    connections[cloud.name] = writer.add_connection(f"/{cloud.name}", CLOUD, typestore=store)
                writer.write(connections[cloud.name], stamp, store.serialize_cdr(_message(store, cloud, stamp), CLOUD))
    if labels:
        warnings.warn(f"{folder}: a bag has no place for labels, {labels} are not in it", stacklevel=2)
    return written


def _header(store: Any, stamp: int, frame: str) -> Any:
    types = store.types
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _transforms(store: Any, sample: Frame, stamp: int) -> Any:
    types, each = store.types, []
    for cloud in sample.clouds:
        pose = cloud.world_SE3_sensor
        w, x, y, z = compute_quaternion(pose).tolist()
        transform = types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](*pose[:3, 3].tolist()),
            rotation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        )
        stamped = types["geometry_msgs/msg/TransformStamped"]
        each.append(stamped(_header(store, stamp, "world"), child_frame_id=cloud.name, transform=transform))
    return types[TF](transforms=each)


def _message(store: Any, cloud: SensorCloud, stamp: int) -> Any:
    types = store.types
    points = transform(invert(cloud.world_SE3_sensor), cloud.in_world())
    table = np.column_stack([points, get_intensity(cloud)]).astype("<f4")
    field = types["sensor_msgs/msg/PointField"]
    fields = [
        field(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate(("x", "y", "z", "intensity"))
    ]
    return types[CLOUD](
        header=_header(store, stamp, cloud.name), height=1, width=len(table), fields=fields, is_bigendian=False,
        point_step=16, row_step=16 * len(table), data=np.frombuffer(table.tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip
