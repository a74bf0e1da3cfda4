"""ROS 2 bag of vision_msgs/Detection3DArray, one message per instant on /detections.

- The messages are version 4's of vision_msgs: `results[].hypothesis.class_id` and score, and `bbox`
  with the pose of its centre and its size. `id` is the track number.
- Both header and each detection are in the frame `world`, at the time of the instant.
- The message has no place for velocities; they are counted as left out.
- The bag is a folder: bag/metadata.yaml and bag/bag.mcap."""

from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.exchange.instant import Instant
from toolkit.exchange.writer import nanoseconds
from toolkit.objects import LABELS

ARRAY = "vision_msgs/msg/Detection3DArray"
DETECTIONS_TOPIC = "/detections"
NO_VELOCITY = "velocities that Detection3DArray has no place for"
_FRAME = "world"
_COVARIANCE_NUMBERS = 36
# vision_msgs 4.1, by message name
VISION_MESSAGES = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    ARRAY: "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}


class DetectionArrayWriter:
    """Writer of one bag, in a new folder."""

    def __init__(self, path: Path) -> None:
        """Open a new bag for messages of detections. path: folder of the format."""
        from rosbags.rosbag2 import StoragePlugin, Writer as BagWriter
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.problems: Problems = {}
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in VISION_MESSAGES.items():
            self._store.register(get_types_from_msg(text, name))
        self._writer = BagWriter(path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connection = self._writer.add_connection(
            DETECTIONS_TOPIC, ARRAY, typestore=self._store
        )

    def write(self, instant: Instant) -> None:
        """Write the message of an instant."""
        time_ns = nanoseconds(instant.time_s)
        header = self._header(time_ns)
        ids = instant.list_ids()
        detections = [
            self._detection(header, instant, row, track_id=ids[row]) for row in range(len(ids))
        ]
        message = self._store.types[ARRAY](header=header, detections=detections)
        self._writer.write(self._connection, time_ns, self._store.serialize_cdr(message, ARRAY))
        # the message has no field for velocities
        velocities = [velocity for velocity in instant.known_velocities() if velocity is not None]
        add_problem(self.problems, NO_VELOCITY, len(velocities))

    def close(self) -> None:
        """Complete the bag."""
        self._writer.close()

    def _detection(self, header: Any, instant: Instant, row: int, track_id: int) -> Any:
        """Return a row of an instant as message Detection3D.

        header: message Header of the instant; track_id: id of the row's road user."""
        types = self._store.types
        box = instant.boxes[row].tolist()  # x y z length width height yaw
        half_yaw = box[6] / 2
        orientation = types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=float(np.sin(half_yaw)), w=float(np.cos(half_yaw))
        )
        centre = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](*box[:3]), orientation=orientation
        )
        bounds = types["vision_msgs/msg/BoundingBox3D"](
            center=centre, size=types["geometry_msgs/msg/Vector3"](*box[3:6])
        )
        hypothesis = types["vision_msgs/msg/ObjectHypothesis"](
            class_id=LABELS[instant.labels[row]], score=float(instant.scores[row])
        )
        # zeros, as the covariance is unknown
        centre_with_covariance = types["geometry_msgs/msg/PoseWithCovariance"](
            pose=centre, covariance=np.zeros(_COVARIANCE_NUMBERS)
        )
        result = types["vision_msgs/msg/ObjectHypothesisWithPose"](
            hypothesis=hypothesis, pose=centre_with_covariance
        )
        return types["vision_msgs/msg/Detection3D"](
            header=header, results=[result], bbox=bounds, id=str(track_id)
        )

    def _header(self, time_ns: int) -> Any:
        """Return the message Header of an instant at `time_ns` since 1970."""
        types = self._store.types
        seconds, nanoseconds_left = divmod(time_ns, 10**9)
        time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds_left)
        return types["std_msgs/msg/Header"](stamp=time, frame_id=_FRAME)
