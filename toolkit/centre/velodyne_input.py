"""Velodyne lidars on the network: their packets, received by UDP and decoded sweep by sweep.

The times of a sweep are those of this computer, at which its packets were received, so that the
lidar's clock does not matter."""

from collections.abc import Iterator
from threading import Event
from typing import Any

import numpy as np

from toolkit.centre.network_lidar import NetworkLidar
from toolkit.centre.sensor_message import SensorMessage
from toolkit.datasets.layouts.velodyne_packets import (
    VELODYNE_MODELS,
    VELODYNE_PACKET_BYTES,
    list_sweep_columns,
    make_velodyne_decoder,
)


class VelodyneInput(NetworkLidar):
    """Velodyne lidar that sends to a port of this computer."""

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
                stamp, table = decoded
                yield self.make_message(list_sweep_columns(np.array(table)), float(stamp.host))

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
