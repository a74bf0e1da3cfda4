"""`NetworkLidar`: what inputs of lidars on the network have in common, whatever the maker."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Pose
from toolkit.centre.packet_port import PacketPort
from toolkit.centre.sensor_message import SensorMessage
from toolkit.datasets.cloud_records import build_cloud
from toolkit.sensors.models import SpinningLidar
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True, eq=False)
class NetworkLidar:
    """Lidar that sends to a port of this computer.

    Attributes:
        name: Name of the sensor.
        port: Port at which the packets arrive.
        pose: World_SE3_sensor, None for the origin.
    """

    name: str
    port: PacketPort
    pose: Pose | None = None
    is_live = True

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The lidar, with a model that stands for any."""
        return (Sensor(self.name, SpinningLidar(), self._world_SE3_sensor),)

    @property
    def _world_SE3_sensor(self) -> Pose:
        return np.eye(4) if self.pose is None else self.pose

    def make_message(self, columns: Mapping[str, np.ndarray], start_s: float) -> SensorMessage:
        """Return a turn as a message, which arrives with its last point.

        columns: arrays by name: positions (n, 3; m), intensity, ring, and time_s (s since the first
        point); start_s: time of the turn's first packet (s)."""
        cloud = build_cloud(
            columns, self.name, self._world_SE3_sensor, problems={}, stamp_s=start_s
        )
        last_s = 0.0 if cloud.time is None else float(cloud.time.max(initial=0.0))
        time_s = start_s + last_s
        return SensorMessage(sensor=self.name, time_s=time_s, arrival_s=time_s, measurement=cloud)
