"""Two real lidars: an Argoverse 2 log taken apart by laser, fused back, and counted against its own labels.

A sweep holds the points of both lidars in the ego vehicle's frame, lasers 0-31 of `up_lidar`, 32-63 of `down_lidar`.
`fuse_sweep` puts each lidar's part into that lidar's own frame by the calibration, as if two stations had sent them,
and fuses them as any two sensors; `count_labels` counts the points in every labelled cuboid beside the recording's
count. All of it is float64, so that going there and back moves no point across a cuboid's face.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import corners
from toolkit.clouds import PointCloud, crop, from_points, fuse, points_per_box
from toolkit.datasets.cloud_files import quaternion_pose, read_table
from toolkit.geometry import invert, transform

LASERS = {"up_lidar": range(32), "down_lidar": range(32, 64)}


@dataclass(frozen=True)
class Labels:
    """The cuboids of one sweep, ego frame: boxes (n, 7), categories, and the recording's own points in each."""

    boxes: Float64[np.ndarray, "n 7"]
    categories: tuple[str, ...]
    interior_points: Int64[np.ndarray, " n"]


class Checked(NamedTuple):
    """One labelled cuboid of a sweep (its time, ns): points counted here, and by the recording."""

    sweep: int
    category: str
    points: int
    recorded: int


def sweep_times(log: str | Path) -> list[int]:
    """The timestamps (ns) of a log's sweeps, in order. Raises FileNotFoundError where the folder is no log."""
    times = sorted(int(file.stem) for file in Path(log, "sensors", "lidar").glob("*.feather"))
    if not times:
        raise FileNotFoundError(f"{log} is no Argoverse 2 log: it has no sensors/lidar/*.feather")
    return times


def read_calibration(log: str | Path) -> dict[str, Float64[np.ndarray, "4 4"]]:
    """ego_SE3_sensor of each sensor by name."""
    table = read_table(Path(log, "calibration", "egovehicle_SE3_sensor.feather"))
    return {str(name): pose for name, pose in zip(table["sensor_name"], _poses(table), strict=True)}


def read_labels(log: str | Path, time: int) -> Labels:
    """The cuboids labelled at one sweep's time."""
    table = read_table(Path(log, "annotations.feather"))
    table = {name: column[table["timestamp_ns"] == time] for name, column in table.items()}
    poses = _poses(table)
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    size = [table[name] for name in ("length_m", "width_m", "height_m")]
    return Labels(
        np.column_stack([poses[:, :3, 3], *size, yaw]),
        tuple(map(str, table["category"])),
        table["num_interior_pts"].astype(np.int64),
    )


def split_sweep(log: str | Path, time: int) -> dict[str, Float64[np.ndarray, "_ 3"]]:
    """What each lidar measured in one sweep, in its own frame (m)."""
    table, calibration = read_table(Path(log, "sensors", "lidar", f"{time}.feather")), read_calibration(log)
    points = np.column_stack([table[axis].astype(np.float64) for axis in "xyz"])
    return {
        name: transform(invert(calibration[name]), points[np.isin(table["laser_number"], lasers)])
        for name, lasers in LASERS.items()
    }


def fuse_sweep(log: str | Path, time: int) -> PointCloud:
    """One sweep fused from its two lidars, ego frame, float64: sensor 0 is `up_lidar`, 1 `down_lidar`."""
    calibration = read_calibration(log)
    parts = split_sweep(log, time).items()
    return fuse(from_points(transform(calibration[name], part), number) for number, (name, part) in enumerate(parts))


def count_labels(log: str | Path, time: int) -> tuple[Labels, Int64[np.ndarray, " n"]]:
    """The labels of one sweep, and the points that the fused sweep, cropped to where the labels are, has in each."""
    labels = read_labels(log, time)
    reach = corners(labels.boxes).reshape(-1, 3)
    low, high = reach.min(axis=0) - 1.0, reach.max(axis=0) + 1.0
    cloud = crop(fuse_sweep(log, time), np.append(low[:2], high[:2]), height=float(high[2]), floor=float(low[2]))
    return labels, points_per_box(cloud, labels.boxes)


def check_log(log: str | Path) -> list[Checked]:
    """Every labelled cuboid of every sweep, its points counted in the fused sweep beside the recording's own count."""
    checked = []
    for time in sweep_times(log):
        labels, counted = count_labels(log, time)
        rows = zip(labels.categories, counted.tolist(), labels.interior_points.tolist(), strict=True)
        checked += [Checked(time, *row) for row in rows]
    return checked


def _poses(table: dict[str, np.ndarray]) -> Float64[np.ndarray, "n 4 4"]:
    quaternions = np.column_stack([table[name] for name in ("qw", "qx", "qy", "qz")])
    places = np.column_stack([table[name] for name in ("tx_m", "ty_m", "tz_m")])
    poses = [quaternion_pose(*row) for row in zip(quaternions, places, strict=True)]
    return np.array(poses).reshape(-1, 4, 4)
