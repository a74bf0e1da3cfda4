"""Ouster lidars on the network: their packets, received by UDP and decoded turn by turn.

The time of a turn is this computer's, at which its first packet was received; only differences of
the lidar's own times count, between the columns of a turn."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from toolkit.centre.network_lidar import NetworkLidar
from toolkit.centre.sensor_message import SensorMessage
from toolkit.datasets.layouts.ouster_packets import convert_frame, import_ouster
from toolkit.datasets.record_values import name_damage
from toolkit.runtime.reading import read_bytes

_NS_PER_S = 10**9


@dataclass(frozen=True, eq=False)
class OusterInput(NetworkLidar):
    """Ouster lidar that sends to a port of this computer.

    Attributes:
        metadata: File of the sensor's metadata (JSON), as ouster-cli saves it: it says how packets
            are laid out and where beams point.
    """

    metadata: Path = field(kw_only=True)

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        """Yield a message for every turn of the lidar, after its last packet.

        Raises ImportError without ouster-sdk, OSError for a port that is taken or metadata that
        cannot be opened, ValueError for damaged metadata."""
        core = import_ouster("a live Ouster")
        info = load_ouster_metadata(self.metadata)
        positions_by_range = core.XYZLut(info)
        for number, frame in enumerate(self._batch_frames(core, info, stop)):
            sweep = convert_frame(frame, positions_by_range(frame), self.name, number)
            yield self.make_message(sweep.columns, sweep.time_s)

    def _batch_frames(self, core: Any, info: Any, stop: Event) -> Iterator[Any]:
        """Yield the lidar's turns as ouster-sdk's frames; core: its module, info: its metadata."""
        layout = core.PacketFormat(info)
        add_packet = core.FrameBatcher(info).batch
        frame = core.LidarFrame(info)
        sizes = (layout.imu_packet_size, layout.zone_packet_size)
        packets = self.port.receive(layout.lidar_packet_size, stop, ignored_bytes=sizes)
        is_warned = False
        for time_s, data in packets:
            packet = core.LidarPacket(layout)
            packet.buf[:] = np.frombuffer(data, np.uint8)
            packet.host_timestamp = int(time_s * _NS_PER_S)
            if packet.validate(info) != core.PacketValidationFailure.NONE:
                if not is_warned:
                    warnings.warn(
                        f"port {self.port.number} gets packets that {self.metadata} does not "
                        "describe, of another sensor or older settings: they are passed over; "
                        "save the metadata again",
                        stacklevel=2,
                    )
                is_warned = True
                continue
            if add_packet(packet, frame):
                yield frame
                frame = core.LidarFrame(info)


def load_ouster_metadata(path: Path) -> Any:
    """Load a sensor's metadata as ouster-sdk's SensorInfo.

    Raises ImportError without ouster-sdk, OSError, ValueError for a file that is no such
    metadata."""
    core = import_ouster(use="a live Ouster")
    content = read_bytes(path)
    with name_damage(path, "metadata of an Ouster", (Exception,)):
        return core.SensorInfo(content.decode())
