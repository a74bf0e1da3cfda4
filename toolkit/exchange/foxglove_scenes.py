"""MCAP for Foxglove: a SceneUpdate of boxes per instant, and a PointCloud per sensor.

- Topics are /objects and /points/SENSOR. Every frame_id is `world`; a cloud's `pose` is its
  sensor's, so that points keep the sensor's frame and float32 holds them.
- An entity is one road user, by its id: a cube in the colour of its class, a text above it, and
  label, score, speed (m/s) and velocity as metadata. An entity that is gone is deleted by its id.
- Messages of an instant are logged and published at its time. A cloud's `timestamp` is the time of
  its measurement, if that is known.
- Numeric types of fields are Foxglove's (FLOAT32 is 7) and differ from ROS.
- Python reads it with mcap-protobuf-support."""

from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.layouts.nuscenes import compute_quaternions
from toolkit.datasets.problem_kinds import Problems
from toolkit.exchange.instant import Instant
from toolkit.exchange.writer import nanoseconds
from toolkit.frame import SensorCloud
from toolkit.geometry import pose
from toolkit.objects import LABELS
from toolkit.plots.palette import CLASS

ROOT_FRAME = "world"
OBJECTS_TOPIC = "/objects"
POINTS_TOPIC = "/points"
_OPACITY_SHARE = 0.5
_TEXT_HEIGHT_M = 0.5
_NS_PER_S = 10**9
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])  # quaternion w x y z of a body that is not turned
_Message = Any  # generated classes of protobuf have no types


class FoxgloveWriter:
    """Writer of one MCAP file."""

    def __init__(self, path: Path) -> None:
        """Open an MCAP file to write road users and clouds as Foxglove shows them."""
        from mcap.writer import Writer as McapWriter

        self.problems: Problems = {}
        self._file = path.open("wb")
        self._writer = McapWriter(self._file)
        self._writer.start(profile="", library="coview")
        self._schemas: dict[str, int] = {}  # MCAP's number of each schema, by message name
        self._channels: dict[str, int] = {}  # MCAP's number of each channel, by topic
        self._last_ids: set[int] = set()  # road users of the instant written last

    def write(self, instant: Instant) -> None:
        """Write the boxes and clouds of an instant; boxes of road users that left are deleted."""
        time_ns = nanoseconds(instant.time_s)
        for cloud in instant.clouds:
            stamp_ns = time_ns if cloud.stamp_s is None else nanoseconds(cloud.stamp_s)
            self._send(f"{POINTS_TOPIC}/{cloud.name}", cloud_message(cloud, stamp_ns), time_ns)
        ids = set(instant.list_ids())
        gone_ids = sorted(self._last_ids - ids)
        self._last_ids = ids
        self._send(OBJECTS_TOPIC, scene_message(instant, gone_ids, time_ns), time_ns)

    def close(self) -> None:
        """Write the index and complete the file."""
        self._writer.finish()  # type: ignore[no-untyped-call, unused-ignore]
        self._file.close()

    def _send(self, topic: str, message: _Message, time_ns: int) -> None:
        """Log a message at `time_ns`; register its topic and its schema the first time."""
        if topic not in self._channels:
            schema_name = message.DESCRIPTOR.full_name
            if schema_name not in self._schemas:
                self._schemas[schema_name] = self._writer.register_schema(
                    schema_name, "protobuf", describe_message(message)
                )
            self._channels[topic] = self._writer.register_channel(
                topic, "protobuf", self._schemas[schema_name]
            )
        self._writer.add_message(
            self._channels[topic],
            log_time=time_ns,
            publish_time=time_ns,
            data=message.SerializeToString(),
        )


def scene_message(instant: Instant, gone_ids: list[int], time_ns: int) -> _Message:
    """Return an instant's boxes, each with a text above it, as message SceneUpdate.

    gone_ids: ids of the previous instant that this one lacks; time_ns: time of the instant."""
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    for track_id in gone_ids:
        deletion = update.deletions.add(id=str(track_id), type=SceneEntityDeletion.MATCHING_ID)
        _set_time(deletion.timestamp, time_ns)
    velocities = instant.known_velocities()
    rotations = [pose(yaw=yaw)[:3, :3] for yaw in instant.boxes[:, 6]]
    quaternions = compute_quaternions(np.reshape(rotations, (-1, 3, 3)))
    for row, track_id in enumerate(instant.list_ids()):
        label = LABELS[instant.labels[row]]
        score = float(instant.scores[row])
        entity = update.entities.add(id=str(track_id), frame_id=ROOT_FRAME)
        _set_time(entity.timestamp, time_ns)
        box = instant.boxes[row]  # x y z length width height yaw
        entity.cubes.add(
            pose=_pose_message(box[:3], quaternions[row]),
            size=_vector(box[3:6]),
            color=_colour(CLASS[label], _OPACITY_SHARE),
        )
        metadata = {"label": label, "score": f"{score:.6g}"}
        caption = f"{label} {track_id} {score:.2f}"
        velocity = velocities[row]
        if velocity is not None:
            speed_m_s = float(np.linalg.norm(velocity))
            metadata["speed"] = f"{speed_m_s:.6g}"
            metadata["velocity"] = " ".join(f"{value:.6g}" for value in velocity)
            caption += f" {3.6 * speed_m_s:.0f} km/h"
        for key, value in metadata.items():
            entity.metadata.add(key=key, value=value)
        above = np.array([box[0], box[1], box[2] + box[5] / 2 + _TEXT_HEIGHT_M])
        entity.texts.add(
            pose=_pose_message(above, _UPRIGHT),
            text=caption,
            billboard=True,
            font_size=_TEXT_HEIGHT_M,
            color=_colour(CLASS[label], 1.0),
        )
    return update


def cloud_message(cloud: SensorCloud, stamp_ns: int) -> _Message:
    """Return message PointCloud of one sensor: x y z, and intensity if the sensor gives it.

    stamp_ns: time of the cloud."""
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

    columns = [cloud.in_sensor()]
    names = ["x", "y", "z"]
    if cloud.intensity is not None:
        columns.append(cloud.intensity[:, None])
        names.append("intensity")
    table = np.column_stack(columns).astype("<f4")  # 4 bytes a number
    message = PointCloud(frame_id=ROOT_FRAME, point_stride=4 * len(names), data=table.tobytes())
    _set_time(message.timestamp, stamp_ns)
    world_SE3_sensor = cloud.world_SE3_sensor
    (quaternion,) = compute_quaternions(world_SE3_sensor[None, :3, :3])
    message.pose.CopyFrom(_pose_message(world_SE3_sensor[:3, 3], quaternion))
    for column, name in enumerate(names):
        message.fields.add(name=name, offset=4 * column, type=PackedElementField.FLOAT32)
    return message


def describe_message(message: _Message) -> bytes:
    """Return the schema of a message: its file and all that it needs, as a FileDescriptorSet."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    file_set = FileDescriptorSet()
    queue = [message.DESCRIPTOR.file]
    names: set[str] = set()  # files that the set holds
    while queue:
        file = queue.pop()
        if file.name in names:
            continue
        names.add(file.name)
        file.CopyToProto(file_set.file.add())
        queue.extend(file.dependencies)
    return file_set.SerializeToString()


def _set_time(stamp: _Message, time_ns: int) -> None:
    """Set message Timestamp, in place, to nanoseconds since 1970."""
    stamp.seconds = time_ns // _NS_PER_S
    stamp.nanos = time_ns % _NS_PER_S


def _pose_message(
    position: Float64[np.ndarray, "3"], quaternion: Float64[np.ndarray, "4"]
) -> _Message:
    """Return a Pose. position: m, world frame; quaternion: w x y z."""
    from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseMessage
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion

    turn = dict(zip("wxyz", quaternion.tolist(), strict=True))
    return PoseMessage(position=_vector(position), orientation=Quaternion(**turn))


def _vector(numbers: Float64[np.ndarray, "3"]) -> _Message:
    """Return three numbers as message Vector3."""
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

    x, y, z = numbers.tolist()
    return Vector3(x=x, y=y, z=z)


def _colour(code: str, opacity_share: float) -> _Message:
    """Return message Color; code: #rrggbb; opacity_share: 0 to 1."""
    from foxglove_schemas_protobuf.Color_pb2 import Color

    red_green_blue = [int(code[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return Color(r=red_green_blue[0], g=red_green_blue[1], b=red_green_blue[2], a=opacity_share)
