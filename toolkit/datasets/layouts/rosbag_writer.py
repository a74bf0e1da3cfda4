"""Samples as a bag of ROS 2 in MCAP, for those who play and look at bags."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.layouts.nuscenes import quaternion_of
from toolkit.datasets.layouts.rosbag import CLOUD, TF
from toolkit.datasets.records.clouds import intensity_of
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.geometry import invert, transform
from toolkit.runtime.files import writing_together


def write_rosbag(samples: Iterable[Sample], folder: Path) -> int:
    """Write the clouds of samples as recording.mcap of ROS 2, a topic per sensor with tf; labels have no place in a
    bag, and a warning says so. How many were written."""
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


def _transforms(store: Any, sample: Sample, stamp: int) -> Any:
    types, each = store.types, []
    for cloud in sample.clouds:
        pose = cloud.world_SE3_sensor
        w, x, y, z = quaternion_of(pose).tolist()
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
    table = np.column_stack([points, intensity_of(cloud)]).astype("<f4")
    field = types["sensor_msgs/msg/PointField"]
    fields = [
        field(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate(("x", "y", "z", "intensity"))
    ]
    return types[CLOUD](
        header=_header(store, stamp, cloud.name), height=1, width=len(table), fields=fields, is_bigendian=False,
        point_step=16, row_step=16 * len(table), data=np.frombuffer(table.tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip
