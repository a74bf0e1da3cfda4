"""Velodyne lidars on the network: their packets, received by UDP and decoded sweep by sweep.

The times of a sweep are those of this computer, at which its packets were received, so that the
lidar's clock does not matter."""

from collections.abc import Iterator
from dataclasses import dataclass
from threading import Event
from typing import Any

import numpy as np

from toolkit.arrays import Pose
from toolkit.centre.packet_port import PacketPort
from toolkit.centre.sensor_message import SensorMessage
from toolkit.datasets.cloud_records import build_cloud
from toolkit.datasets.layouts.velodyne_packets import (
    VELODYNE_MODELS,
    VELODYNE_PACKET_BYTES,
    list_sweep_columns,
    make_velodyne_decoder,
)
from toolkit.frame import SensorCloud
from toolkit.sensors.models import SpinningLidar
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True, eq=False)
class VelodyneInput:
    """Velodyne lidar that sends to a port of this computer.

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
        return (Sensor(self.name, SpinningLidar(), self._pose),)

    @property
    def _pose(self) -> Pose:
        """World_SE3_sensor."""
        return np.eye(4) if self.pose is None else self.pose

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        """Yield a message for every turn of the lidar.

        Raises ImportError without velodyne-decoder, OSError for a port that is taken, ValueError
        for a lidar of an unknown model."""
        decoder = None
        for time_s, data in self.port.receive(VELODYNE_PACKET_BYTES, stop):
            if decoder is None:
                decoder = self._open_decoder(data[-1])
            decoded = decoder.decode(time_s, data, True)
            if decoded is not None:
                yield self._make_message(*decoded)

    def _open_decoder(self, last_byte: int) -> Any:
        """Make the decoder of a model by the last byte of its packets."""
        if last_byte not in VELODYNE_MODELS:
            raise ValueError(
                f"the packets at port {self.port.number} end in {last_byte:#04x}, not in the byte "
                f"of a known model ({', '.join(VELODYNE_MODELS.values())}): record and decode "
                "them with the sensor's driver"
            )
        try:
            return make_velodyne_decoder(last_byte)
        except ImportError:
            raise ImportError(
                "live Velodyne lidars need velodyne-decoder: pip install coview[scans]"
            ) from None

    def _make_message(self, stamp: Any, table: Any) -> SensorMessage:
        """Return a decoded turn as a message.

        stamp: time of the turn, of velodyne-decoder; table: its points, a row for each."""
        columns = list_sweep_columns(np.array(table))
        cloud: SensorCloud = build_cloud(
            columns, self.name, self._pose, {}, stamp_s=float(stamp.host)
        )
        last_s = 0.0 if cloud.time is None else float(cloud.time.max(initial=0.0))
        time_s = float(stamp.host) + last_s
        return SensorMessage(sensor=self.name, time_s=time_s, arrival_s=time_s, measurement=cloud)
