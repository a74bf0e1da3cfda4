"""Captures of network packets (.pcap, .pcapng) of Velodyne lidars, by velodyne-decoder.

- A sensor is a source of packets of 1206 bytes, by its address; the model is what the packets state
  in their last byte (the calibration of an HDL-64E is read from its packets). Other packets are
  passed over; a capture without any of Velodyne's is refused with the sizes that it has.
- A sweep is a turn from azimuth 0, which is the sensor's x. The first and the last of a capture are
  parts of a turn, and are counted.
- World frame: the sensor's, as a capture holds no poses: `poses` places the sensors of a static
  setting by their names, velodyne for one, velodyne-192.168.1.201 for each of several.
- A sweep's time is when its first packet was captured, by the clock of the computer; points have
  seconds from there. Sweeps of several sensors are paired by time.
- Packets shorter than they state, as at the end of a capture that was cut off, are left out with a
  warning."""

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import listing
from toolkit.datasets.clock_times import UNPAIRED, group_by_time
from toolkit.datasets.cloud_records import build_cloud
from toolkit.datasets.origins import Middles
from toolkit.datasets.pose_files import read_poses
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.datasets.record_values import name_damage
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.runtime.reading import plain_file

PARTIAL_TURN = "sweeps of less than a turn, at the start or end of a capture"
VELODYNE_PACKET_BYTES = 1206
# models by the last byte of a packet, as Velodyne's manuals list them
VELODYNE_MODELS = {0x21: "HDL32E", 0x22: "VLP16", 0x24: "PuckHiRes", 0x28: "VLP32C", 0xA1: "VLS128"}
_MIN_TURN_RAD = np.deg2rad(355.0)
_ETHERNET = 1  # link type of a capture
_UDP_HEADER_BYTES = 8


class Sweep(NamedTuple):
    """Points of one turn.

    sensor: its name; number: number among its sweeps; time_s: capture of its first packet; points:
    named columns."""

    sensor: str
    number: int
    time_s: float
    points: np.ndarray


@dataclass(eq=False)
class _Packets:
    """Capture that is decoded from its start, with the place that reading has reached.

    Attributes:
        path: the file.
        names: name of each sensor by its address.
        models: last byte of each sensor's packets by its address.
    """

    path: Path
    names: Mapping[str, str]
    models: Mapping[str, int]
    _sweeps: Iterator[Sweep] | None = None
    _passed: Counter[str] = field(default_factory=Counter)
    _waiting: dict[tuple[str, int], Sweep] = field(default_factory=dict)

    def read(self, numbers: Mapping[str, int]) -> list[Sweep]:
        """Return sweeps by sensor and number, reading on or again from the start."""
        is_behind = any(
            self._passed[sensor] > number and (sensor, number) not in self._waiting
            for sensor, number in numbers.items()
        )
        if self._sweeps is None or is_behind:
            self._sweeps = self.decode()
            self._passed.clear()
            self._waiting.clear()
        while any(self._passed[sensor] <= number for sensor, number in numbers.items()):
            sweep = next(self._sweeps)
            self._passed[sweep.sensor] = sweep.number + 1
            self._waiting[sweep.sensor, sweep.number] = sweep
        wanted = [self._waiting.pop(key) for key in numbers.items()]
        for sensor, number in list(self._waiting):
            if number < numbers.get(sensor, 0):
                del self._waiting[sensor, number]
        return wanted

    def decode(self) -> Iterator[Sweep]:
        """Yield all sweeps of the capture."""
        decoders = {address: _make_decoder(last) for address, last in self.models.items()}
        counts: Counter[str] = Counter()
        with name_damage(self.path, "capture", (Exception,)):
            for time_s, address, data in _read_packets(self.path):
                if address not in decoders or len(data) != VELODYNE_PACKET_BYTES:
                    continue
                decoded = decoders[address].decode(time_s, data, True)
                if decoded is not None:
                    yield self._sweep(address, decoded, counts)
            for address, decoder in decoders.items():
                decoded = decoder.finish(True)
                if decoded is not None:
                    yield self._sweep(address, decoded, counts)

    def _sweep(self, address: str, decoded: Any, counts: Counter[str]) -> Sweep:
        """Return a decoded turn with its number."""
        stamp, points = decoded
        name = self.names[address]
        counts[name] += 1
        return Sweep(name, counts[name] - 1, float(stamp.host), np.array(points))


def pcap(path: Path, *, poses: Path | None = None, inverted: bool = False) -> listing.Listing:
    """Open a capture of Velodyne lidars.

    poses: a file of poses by sensor, None for sensors at the origin; inverted: it gives world →
    sensor. Raises ImportError without velodyne-decoder, FileNotFoundError for a folder, ValueError
    for a damaged capture and one without points."""
    if path.is_dir():
        raise FileNotFoundError(f"{path} is a folder: give a .pcap file in it")
    models = _find_sensors(plain_file(path))
    names = {address: f"velodyne-{address}" for address in models}
    if len(models) == 1:
        names = dict.fromkeys(models, "velodyne")
    poses_by_name = {} if poses is None else read_poses(poses, inverted=inverted)
    missing = [name for name in names.values() if poses is not None and name not in poses_by_name]
    if missing:
        raise ValueError(
            f"there is no pose of {missing[0]}: the pose file has {', '.join(poses_by_name)}"
        )
    packets = _Packets(path, names, models)
    times: dict[str, list[float]] = {name: [] for name in names.values()}
    for sweep in packets.decode():
        times[sweep.sensor].append(sweep.time_s)
    start = min((stamps[0] for stamps in times.values() if stamps), default=None)
    if start is None:
        raise ValueError(f"{path} holds no packet that can be decoded: capture at least one turn")
    groups = {}
    since = {name: np.array(stamps) - start for name, stamps in times.items()}
    for number, group in enumerate(group_by_time(since)):
        groups[f"{number:06d}"] = group
    loader = _Loader(packets, groups, poses_by_name)
    return listing.Listing(tuple(groups), loader)


@dataclass(frozen=True, eq=False)
class _Loader:
    """Reader of a capture's frames by name.

    packets: the capture; groups: number of each sensor's sweep in each frame; poses: by sensor."""

    packets: _Packets
    groups: Mapping[str, Mapping[str, int]]
    poses: Mapping[str, Pose]
    middles: Middles = field(default_factory=Middles)

    def __call__(self, name: str) -> Frame:
        problems: Problems = {}
        group = self.groups[name]
        add_problem(problems, UNPAIRED, int(len(group) < len(self.packets.names)))
        clouds = []
        sweeps = self.packets.read(group)
        for sweep in sweeps:
            points = sweep.points
            is_partial = len(points) > 0 and _measure_turn(points) < _MIN_TURN_RAD
            add_problem(problems, PARTIAL_TURN, int(is_partial))
            attributes = {
                "positions": np.column_stack([points["x"], points["y"], points["z"]]),
                "intensity": points["intensity"],
                "ring": points["ring"],
                "time_s": points["time"],
            }
            clouds.append(
                build_cloud(
                    attributes,
                    sweep.sensor,
                    self.poses.get(sweep.sensor, np.eye(4)),
                    problems,
                    stamp_s=sweep.time_s,
                    middles=self.middles,
                )
            )
        time = min(sweep.time_s for sweep in sweeps)
        return Frame.of_clouds(name, clouds, Objects.empty(), time=time, problems=problems)


def _measure_turn(points: np.ndarray) -> float:
    """Return the angle (rad) that a sweep covers: a turn less its largest gap."""
    azimuths = np.unique(np.round(np.arctan2(points["y"], points["x"]), 4))
    if len(azimuths) < 2:
        return 0.0
    gaps = np.diff(azimuths, append=azimuths[0] + 2 * np.pi)
    return float(2 * np.pi - gaps.max())


def _make_decoder(last_byte: int) -> Any:
    """Make the decoder of a sensor's packets."""
    import velodyne_decoder

    model = getattr(velodyne_decoder.Model, VELODYNE_MODELS[last_byte])
    config = velodyne_decoder.Config(model=model, cut_angle=0.0, timestamp_first_packet=True)
    return velodyne_decoder.StreamDecoder(config)


def _find_sensors(path: Path) -> dict[str, int]:
    """Return the last byte of the packets of each Velodyne in a capture by its address."""
    try:
        import velodyne_decoder  # noqa: F401
    except ImportError:
        raise ImportError(
            "reading .pcap needs velodyne-decoder: pip install coview[scans]"
        ) from None
    models: dict[str, int] = {}
    sizes: Counter[int] = Counter()
    with name_damage(path, "capture", (Exception,)):
        for _, address, data in _read_packets(path, is_first=True):
            sizes[len(data)] += 1
            if len(data) == VELODYNE_PACKET_BYTES:
                models.setdefault(address, data[-1])
        if not models:
            listed = ", ".join(f"{count} of {size} bytes" for size, count in sizes.most_common(4))
            raise ValueError(
                f"it has no packets of {VELODYNE_PACKET_BYTES} bytes, which Velodyne lidars send, "
                f"but {listed or 'no UDP packets'}: decode it with the sensor's driver"
            )
        for address, last in models.items():
            if last not in VELODYNE_MODELS:
                raise ValueError(
                    f"the packets of {address} end in {last:#04x}, which is none of the known "
                    f"models {', '.join(VELODYNE_MODELS.values())}: decode it with the sensor's "
                    "driver"
                )
    return models


def _read_packets(path: Path, *, is_first: bool = False) -> Iterator[tuple[float, str, bytes]]:
    """Yield capture time (s), source address and data of every UDP packet.

    is_first: True to warn of packets that were cut."""
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
