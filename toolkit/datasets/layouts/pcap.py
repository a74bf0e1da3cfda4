"""Captures of network packets (.pcap, .pcapng) of Velodyne and Ouster lidars.

- Velodyne's packets are known by their size (`toolkit.datasets.layouts.velodyne_packets`). Ouster's
  need the sensor's metadata next to the capture, NAME.json
  (`toolkit.datasets.layouts.ouster_packets`). A capture of neither is refused with the sizes of its
  packets.
- A sweep is a turn. The first and the last of a capture may be parts of one, and are counted. Of
  two returns of a beam one is read, and the others are counted.
- World frame: the sensor's, as a capture holds no poses: `poses` places the sensors of a static
  setting by their names, such as velodyne, or velodyne-192.168.1.201 and ouster-1234 for each of
  several.
- A sweep's time is when its first packet was captured, by the clock of the computer; points have
  seconds from there. Sweeps of several sensors are paired by time.
- Packets shorter than they state, as at the end of a capture that was cut off, are left out with a
  warning."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import listing
from toolkit.datasets.clock_times import UNPAIRED, group_by_time
from toolkit.datasets.cloud_records import build_cloud
from toolkit.datasets.layouts.ouster_packets import find_metadata, open_ousters
from toolkit.datasets.layouts.packet_sweeps import SweepReader, SweepSource
from toolkit.datasets.layouts.velodyne_packets import (
    VELODYNE_PACKET_BYTES,
    VelodyneCapture,
    open_velodynes,
)
from toolkit.datasets.origins import Middles
from toolkit.datasets.pose_files import read_poses
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.runtime.reading import plain_file

PARTIAL_TURN = "sweeps of less than a turn, at the start or end of a capture"
SECOND_RETURNS = "second returns of a beam, of which one is read"


def pcap(path: Path, *, poses: Path | None = None, inverted: bool = False) -> listing.Listing:
    """Open a capture of Velodyne or Ouster lidars.

    poses: a file of poses by sensor, None for sensors at the origin; inverted: it gives world →
    sensor. Raises ImportError without the packages, FileNotFoundError for a folder, ValueError for
    a damaged capture and one without points."""
    if path.is_dir():
        raise FileNotFoundError(f"{path} is a folder: give a .pcap file in it")
    source = _open_source(plain_file(path))
    poses_by_name = {} if poses is None else read_poses(poses, inverted=inverted)
    missing_names = [
        name for name in source.names if poses is not None and name not in poses_by_name
    ]
    if missing_names:
        raise ValueError(
            f"there is no pose of {missing_names[0]}: the pose file has {', '.join(poses_by_name)}"
        )
    times: dict[str, list[float]] = {name: [] for name in source.names}
    for sweep in source.decode():
        times[sweep.sensor].append(sweep.time_s)
    start = min((stamps[0] for stamps in times.values() if stamps), default=None)
    if start is None:
        raise ValueError(f"{path} holds no packet that can be decoded: capture at least one turn")
    since = {name: np.array(stamps) - start for name, stamps in times.items()}
    groups = {f"{number:06d}": group for number, group in enumerate(group_by_time(since))}
    loader = _Loader(SweepReader(source.decode), groups, len(times), poses_by_name)
    return listing.Listing(tuple(groups), loader)


def _open_source(path: Path) -> SweepSource:
    """Open a capture with the reader of the lidars whose packets it holds.

    Raises ImportError without velodyne-decoder, ValueError for packets of other lidars."""
    try:
        import velodyne_decoder  # noqa: F401
    except ImportError:
        raise ImportError(
            "reading .pcap needs velodyne-decoder: pip install coview[scans]"
        ) from None
    opened = open_velodynes(path)
    if isinstance(opened, VelodyneCapture):
        return opened
    if find_metadata(path):
        return open_ousters(path)
    listed_sizes = ", ".join(f"{count} of {size} bytes" for size, count in opened.most_common(4))
    raise ValueError(
        f"{path} has no packets of {VELODYNE_PACKET_BYTES} bytes, which Velodyne lidars send, but "
        f"{listed_sizes or 'no UDP packets'}: an Ouster's needs its metadata next to it, "
        f"{path.stem}.json; decode others with the sensor's driver"
    )


@dataclass(frozen=True, eq=False)
class _Loader:
    """Reader of a capture's frames by name.

    reader: reader of sweeps; groups: number of each sensor's sweep in each frame; sensor_count:
    number of sensors; poses: by sensor."""

    reader: SweepReader
    groups: Mapping[str, Mapping[str, int]]
    sensor_count: int
    poses: Mapping[str, Pose]
    middles: Middles = field(default_factory=Middles)

    def __call__(self, name: str) -> Frame:
        """Read the frame of a name: a sweep of each sensor, with problems counted."""
        problems: Problems = {}
        # number of the sweep, by sensor
        group = self.groups[name]
        add_problem(problems, UNPAIRED, int(len(group) < self.sensor_count))
        clouds = []
        sweeps = self.reader.read(group)
        for sweep in sweeps:
            add_problem(problems, PARTIAL_TURN, int(sweep.is_partial))
            add_problem(problems, SECOND_RETURNS, sweep.left_out)
            clouds.append(
                build_cloud(
                    sweep.columns,
                    sweep.sensor,
                    self.poses.get(sweep.sensor, np.eye(4)),
                    problems,
                    stamp_s=sweep.time_s,
                    middles=self.middles,
                )
            )
        time = min(sweep.time_s for sweep in sweeps)
        return Frame.of_clouds(name, clouds, Objects.empty(), time=time, problems=problems)
