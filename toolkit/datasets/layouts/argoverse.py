"""Argoverse 2 logs with two real lidars.

A log is taken apart by laser, fused back, and counted against its own labels.

A sweep holds the points of both lidars in the ego vehicle's frame, lasers 0-31 of `up_lidar`, 32-63 of `down_lidar`.
`fuse_sweep` puts each lidar's part into that lidar's own frame by the calibration, as if two stations had sent them,
and fuses them as any two sensors; `count_labels` counts the points in every labelled cuboid beside the recording's
count. All of it is float64, so that going there and back moves no point across a cuboid's face.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import corners
from toolkit.clouds import PointCloud, crop, from_points, fuse, points_per_box
from toolkit.datasets.cloud_files import quaternion_pose, read_table
from toolkit.datasets.layouts.nuscenes import compute_quaternion
from toolkit.datasets.records import Listing, build_cloud, get_intensity, labelled, named_damage, no_labels
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, transform
from toolkit.objects import LABELS
from toolkit.point_files import name_attributes
from toolkit.runtime.files import writing

LASERS = {"up_lidar": range(32), "down_lidar": range(32, 64)}


@dataclass(frozen=True)
class Labels:
    """Cuboids of one sweep, ego frame.

    They are boxes (n, 7), categories, and the recording's own number of points in each.
    """

    boxes: Float64[np.ndarray, "n 7"]
    categories: tuple[str, ...]
    interior_points: Int64[np.ndarray, " n"]


class Checked(NamedTuple):
    """One labelled cuboid of a sweep with its point counts.

    time is the sweep's (ns). Points are counted here, and by the recording.
    """

    sweep: int
    category: str
    points: int
    recorded: int


def sweep_times(log: str | Path) -> list[int]:
    """Timestamps (ns) of a log's sweeps, in order. Raises FileNotFoundError if the folder is not a log."""
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
    """Clouds of each lidar in one sweep. Points are in the lidar's own frame (m)."""
    table, calibration = read_table(Path(log, "sensors", "lidar", f"{time}.feather")), read_calibration(log)
    points = np.column_stack([table[axis].astype(np.float64) for axis in "xyz"])
    return {
        name: transform(invert(calibration[name]), points[np.isin(table["laser_number"], lasers)])
        for name, lasers in LASERS.items()
    }


def fuse_sweep(log: str | Path, time: int) -> PointCloud:
    """Fuse one sweep from its two lidars.

    The cloud is float64 in the ego frame. Sensor 0 is `up_lidar`, 1 `down_lidar`.
    """
    calibration = read_calibration(log)
    parts = split_sweep(log, time).items()
    return fuse(from_points(transform(calibration[name], part), number) for number, (name, part) in enumerate(parts))


def count_labels(log: str | Path, time: int) -> tuple[Labels, Int64[np.ndarray, " n"]]:
    """Labels of one sweep, and their point counts.

    The counts are those of the fused sweep, cropped to where the labels are.
    """
    labels = read_labels(log, time)
    reach = corners(labels.boxes).reshape(-1, 3)
    low, high = reach.min(axis=0) - 1.0, reach.max(axis=0) + 1.0
    cloud = crop(fuse_sweep(log, time), np.append(low[:2], high[:2]), height=float(high[2]), floor=float(low[2]))
    return labels, points_per_box(cloud, labels.boxes)


def check_log(log: str | Path) -> list[Checked]:
    """Check the point counts of every labelled cuboid.

    Points are counted in the fused sweep, beside the recording's own count.
    """
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


_NAMES = {"vehicle": "REGULAR_VEHICLE", "cyclist": "BICYCLIST", "pedestrian": "PEDESTRIAN", "heavy": "TRUCK"}


def argoverse(path: Path) -> Listing:
    """Sweeps of a log. Raises FileNotFoundError if the folder is not a log."""
    names = tuple(str(time) for time in sweep_times(path))
    return Listing(names, lambda name: _sample(path, name))


def _sample(log: Path, name: str) -> Frame:
    problems: dict[str, int] = {}
    time = int(name)
    with named_damage(log / "calibration" / "egovehicle_SE3_sensor.feather", "calibration"):
        calibration = read_calibration(log)
    file = log / "sensors" / "lidar" / f"{name}.feather"
    with named_damage(file, "sweep"):
        table = {key: column.astype(np.float32) if column.dtype == np.float16 else column
                 for key, column in read_table(file).items()}  # fmt: skip
        lasers = table["laser_number"]
        recorded = name_attributes(table)
        clouds = tuple(
            build_cloud(
                {key: column[np.isin(lasers, own)] for key, column in recorded.items()},
                lidar, calibration[lidar], problems, frame="world",
            )
            for lidar, own in LASERS.items()
            if np.isin(lasers, own).any() or lidar in calibration
        )  # fmt: skip
    annotations, found = log / "annotations.feather", no_labels()
    if annotations.is_file():
        with named_damage(annotations, "table of labels"):
            labels = read_labels(log, time)
            rows = read_table(annotations)
            tracks = [str(track) for track in rows["track_uuid"][rows["timestamp_ns"] == time]]
            found = labelled(labels.boxes, labels.categories, tracks, problems, labels.interior_points)
    return Frame.of_clouds(name, clouds, *found, time=time * 1e-9, map_SE3_world=_city(log, time), problems=problems)


def _city(log: Path, time: int) -> np.ndarray:
    file = log / "city_SE3_egovehicle.feather"
    if not file.is_file():
        return np.eye(4)
    with named_damage(file, "table of poses"):
        table = read_table(file)
        rows = np.flatnonzero(table["timestamp_ns"] == time)
        if not len(rows):
            return np.eye(4)
        values = {key: float(table[key][rows[0]]) for key in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")}
        turned = np.array([values[key] for key in ("qw", "qx", "qy", "qz")])
        return quaternion_pose(turned, np.array([values[key] for key in ("tx_m", "ty_m", "tz_m")]))


def write_argoverse(samples: Iterable[Frame], folder: Path) -> int:
    """Write frames as a log; return how many were written.

    Of several sensors the first two become up_lidar and down_lidar; a frame of more raises ValueError. Sweeps without
    times get tenths of a second.
    """
    annotations: dict[str, np.ndarray] = {}
    stamps: list[int] = []
    cities: list[np.ndarray] = []
    mounted: dict[str, np.ndarray] = {}
    for k, sample in enumerate(samples):
        if len(sample.clouds) > len(LASERS):
            raise ValueError(
                f"an Argoverse log has two lidars, but {sample.name!r} has {len(sample.clouds)}: fuse some"
            )
        stamps.append(round((sample.time if np.isfinite(sample.time) else 0.1 * k) * 1e9))
        cities.append(sample.map_SE3_world)
        lidars = dict(zip(LASERS, sample.clouds, strict=False))
        mounted |= {name: cloud.world_SE3_sensor for name, cloud in lidars.items()}
        _write_table(folder / "sensors" / "lidar" / f"{stamps[-1]}.feather", _sweep(lidars))
        for column, values in _labels(sample, stamps[-1]).items():
            annotations[column] = np.concatenate([annotations.get(column, values[:0]), values])
    if stamps:
        names = {"sensor_name": list(mounted), **_pose_columns(list(mounted.values()))}
        _write_table(folder / "calibration" / "egovehicle_SE3_sensor.feather", names)
        _write_table(folder / "city_SE3_egovehicle.feather", {"timestamp_ns": stamps, **_pose_columns(cities)})
        _write_table(folder / "annotations.feather", annotations)
    return len(stamps)


def _sweep(lidars: dict[str, SensorCloud]) -> dict[str, np.ndarray]:
    clouds = list(lidars.values())
    points = np.concatenate([np.zeros((0, 3)), *(cloud.in_world() for cloud in clouds)])
    sizes = [len(cloud.points) for cloud in clouds]
    times = [np.zeros(len(cloud.points)) if cloud.time is None else cloud.time for cloud in clouds]
    return {
        **dict(zip("xyz", points.T.astype(np.float32), strict=True)),
        "intensity": np.concatenate([np.zeros(0, np.float32), *map(get_intensity, clouds)]),
        "laser_number": np.repeat([LASERS[name].start for name in lidars], sizes).astype(np.uint8),
        "offset_ns": np.round(np.concatenate([np.zeros(0), *times]) * 1e9).astype(np.int32),
    }


def _labels(sample: Frame, stamp: int) -> dict[str, np.ndarray]:
    boxes, count = sample.objects.boxes, len(sample.objects)
    counts = np.zeros(count, np.int64) if sample.counts is None else sample.counts
    half = boxes[:, 6] / 2
    columns = {"length_m": boxes[:, 3], "width_m": boxes[:, 4], "height_m": boxes[:, 5], "qw": np.cos(half),
               "qx": 0 * half, "qy": 0 * half, "qz": np.sin(half), "tx_m": boxes[:, 0], "ty_m": boxes[:, 1],
               "tz_m": boxes[:, 2], "num_interior_pts": counts}  # fmt: skip
    return {
        "timestamp_ns": np.full(count, stamp, np.int64),
        "track_uuid": sample.objects.ids.astype(str).astype(object),
        "category": np.array([_NAMES[LABELS[label]] for label in sample.objects.labels], object),
        **columns,
    }


def _pose_columns(placed: list[np.ndarray]) -> dict[str, list[float]]:
    rows = np.array([[*compute_quaternion(each), *each[:3, 3]] for each in placed]).reshape(-1, 7)
    names = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
    return {name: column.tolist() for name, column in zip(names, rows.T, strict=True)}


def _write_table(path: Path, columns: Mapping[str, Any]) -> None:
    try:
        import pyarrow
        from pyarrow import feather
    except ImportError:
        raise ImportError("writing .feather needs pyarrow: pip install pyarrow") from None
    with writing(path) as unfinished:
        feather.write_feather(pyarrow.table(columns), unfinished, compression="lz4")
