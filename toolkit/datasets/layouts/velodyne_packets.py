"""Packets of Velodyne lidars in a capture, decoded by velodyne-decoder.

A sensor is a source of packets of 1206 bytes, by its address; the model is what the packets state
in their last byte. Other packets are passed over."""

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.layouts.packet_sweeps import Sweep
from toolkit.datasets.record_values import name_damage

VELODYNE_PACKET_BYTES = 1206
# models by the last byte of a packet, as Velodyne's manuals list them
VELODYNE_MODELS = {0x21: "HDL32E", 0x22: "VLP16", 0x24: "PuckHiRes", 0x28: "VLP32C", 0xA1: "VLS128"}
_MIN_TURN_RAD = np.deg2rad(355.0)
_ETHERNET = 1  # link type of a capture
_UDP_HEADER_BYTES = 8


@dataclass(frozen=True, eq=False)
class VelodyneCapture:
    """Capture of one or several Velodyne lidars.

    path: the file; models: last byte of each sensor's packets by its address."""

    path: Path
    models: Mapping[str, int]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors: velodyne for one, with their addresses for several."""
        return tuple(self._name(address) for address in self.models)

    def _name(self, address: str) -> str:
        """Name of the sensor with an address."""
        return "velodyne" if len(self.models) == 1 else f"velodyne-{address}"

    def decode(self) -> Iterator[Sweep]:
        """Yield all sweeps of all sensors, each from azimuth 0 on; the last may be partial."""
        decoders = {address: make_velodyne_decoder(last) for address, last in self.models.items()}
        counts: Counter[str] = Counter()
        with name_damage(self.path, "capture", (Exception,)):
            for time_s, address, data in read_packets(self.path):
                if address not in decoders or len(data) != VELODYNE_PACKET_BYTES:
                    continue
                decoded = decoders[address].decode(time_s, data, True)
                # this packet has completed a turn
                if decoded is not None:
                    yield self._sweep(address, decoded, counts)
            for address, decoder in decoders.items():
                decoded = decoder.finish(True)
                if decoded is not None:
                    yield self._sweep(address, decoded, counts)

    def _sweep(self, address: str, decoded: Any, counts: Counter[str]) -> Sweep:
        """Return a decoded turn with its number among its sensor's turns.

        address: source of the packets; decoded: time stamp and table of points, as
        velodyne-decoder returns them; counts: turns so far by name of the sensor, which rise."""
        stamp, table = decoded
        points = np.array(table)
        name = self._name(address)
        counts[name] += 1
        columns = list_sweep_columns(points)
        is_partial = len(points) > 0 and _measure_turn(points) < _MIN_TURN_RAD
        return Sweep(
            sensor=name,
            number=counts[name] - 1,
            time_s=float(stamp.host),
            columns=columns,
            is_partial=is_partial,
        )


def list_sweep_columns(points: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of a decoded turn by the names of `Sweep.columns`.

    points: structured array of velodyne-decoder."""
    return {
        "positions": np.column_stack([points["x"], points["y"], points["z"]]),
        "intensity": points["intensity"],
        "ring": points["ring"],
        "time_s": points["time"],
    }


def _measure_turn(points: np.ndarray) -> float:
    """Return the angle (rad) that a sweep's points cover: a turn less its largest gap."""
    azimuths = np.unique(np.round(np.arctan2(points["y"], points["x"]), 4))
    if len(azimuths) < 2:
        return 0.0
    gaps = np.diff(azimuths, append=azimuths[0] + 2 * np.pi)
    return float(2 * np.pi - gaps.max())


def make_velodyne_decoder(last_byte: int) -> Any:
    """Make the decoder of a sensor's packets; last_byte: their last byte, which names the model."""
    import velodyne_decoder

    model = getattr(velodyne_decoder.Model, VELODYNE_MODELS[last_byte])
    config = velodyne_decoder.Config(model=model, cut_angle=0.0, timestamp_first_packet=True)
    return velodyne_decoder.StreamDecoder(config)


def open_velodynes(path: Path) -> VelodyneCapture | Counter[int]:
    """Open a capture of Velodyne lidars.

    Returns the number of packets by their size if none is Velodyne's. Raises ImportError without
    velodyne-decoder, ValueError for a damaged capture and an unknown model."""
    models: dict[str, int] = {}
    sizes: Counter[int] = Counter()
    with name_damage(path, "capture", (Exception,)):
        for _, address, data in read_packets(path, is_first=True):
            sizes[len(data)] += 1
            if len(data) == VELODYNE_PACKET_BYTES:
                models.setdefault(address, data[-1])
        for address, last in models.items():
            if last not in VELODYNE_MODELS:
                raise ValueError(
                    f"the packets of {address} end in {last:#04x}, which is none of the known "
                    f"models {', '.join(VELODYNE_MODELS.values())}: decode it with the sensor's "
                    "driver"
                )
    return VelodyneCapture(path, models) if models else sizes


def read_packets(path: Path, *, is_first: bool = False) -> Iterator[tuple[float, str, bytes]]:
    """Yield capture time (s), source address and data of every UDP packet.

    Packets that were cut are left out. is_first: True for the first reading, which warns of cuts.
    """
    import dpkt

    with path.open("rb") as file:
        reader = dpkt.pcap.UniversalReader(file)
        if reader.datalink() != _ETHERNET:
            raise ValueError(
                f"its link type is {reader.datalink()}, not Ethernet: convert it with editcap"
            )
        cut = 0
        for time_s, content in reader:
            try:
                frame = dpkt.ethernet.Ethernet(content)
            except dpkt.UnpackError:
                continue
            network = frame.data
            if not isinstance(network, dpkt.ip.IP) or not isinstance(network.data, dpkt.udp.UDP):
                continue
            udp = network.data
            data = bytes(udp.data)
            if len(data) < udp.ulen - _UDP_HEADER_BYTES:
                cut += 1
                continue
            address = ".".join(str(byte) for byte in network.src)
            yield float(time_s), address, data
        if is_first and cut:
            warnings.warn(
                f"{path}: {cut} packets are shorter than they state and left out", stacklevel=2
            )
