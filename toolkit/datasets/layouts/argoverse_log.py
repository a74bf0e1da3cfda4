"""Argoverse 2: one log of the sensor set, sensors/lidar/*.feather, annotations.feather, calibration/.

World frame: the ego vehicle's at the sweep's time, x forward, z up, its origin on the ground below the rear axle;
`map_SE3_world` is its place in the city, where city_SE3_egovehicle.feather says it.

- A sweep holds the points of both lidars, already in the **ego** frame: lasers 0-31 are up_lidar, 32-63 down_lidar.
  They stay in that frame here, as float16 had them, so that none moves across a cuboid's face.
- Quaternions are w x y z; times whole nanoseconds; offset_ns is of each point.
- num_interior_pts is the set's own count, of the sweep of the same timestamp.
- Some sweeps have no labels of their time: they are then not in annotations.feather at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.argoverse import LASERS, read_calibration, read_labels, sweep_times
from toolkit.datasets.cloud_files import quaternion_pose, read_table
from toolkit.datasets.layouts.nuscenes import quaternion_of
from toolkit.datasets.records.clouds import cloud_of, intensity_of
from toolkit.datasets.records.fields import Listing, named_damage
from toolkit.datasets.records.labels import labelled, no_labels
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.objects import LABELS
from toolkit.point_files import attributes_of
from toolkit.runtime.files import writing

_NAMES = {"vehicle": "REGULAR_VEHICLE", "cyclist": "BICYCLIST", "pedestrian": "PEDESTRIAN", "heavy": "TRUCK"}


def argoverse(path: Path) -> Listing:
    """The sweeps of a log. Raises FileNotFoundError where the folder is none."""
    names = tuple(str(time) for time in sweep_times(path))
    return Listing(names, lambda name: _sample(path, name))


def _sample(log: Path, name: str) -> Sample:
    problems: dict[str, int] = {}
    time = int(name)
    with named_damage(log / "calibration" / "egovehicle_SE3_sensor.feather", "calibration"):
        calibration = read_calibration(log)
    file = log / "sensors" / "lidar" / f"{name}.feather"
    with named_damage(file, "sweep"):
        table = {key: column.astype(np.float32) if column.dtype == np.float16 else column
                 for key, column in read_table(file).items()}  # fmt: skip
        lasers = table["laser_number"]
        recorded = attributes_of(table)
        clouds = tuple(
            cloud_of(
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
    return Sample(name, clouds, *found, time=time * 1e-9, map_SE3_world=_city(log, time), problems=problems)


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


def write_argoverse(samples: Iterable[Sample], folder: Path) -> int:
    """Write samples as a log; of several sensors the first two become up_lidar and down_lidar, a sample of more is
    a ValueError. Times of sweeps that have none are tenths of a second. How many were written."""
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
        names = {"sensor_name": list(mounted), **_poses(list(mounted.values()))}
        _write_table(folder / "calibration" / "egovehicle_SE3_sensor.feather", names)
        _write_table(folder / "city_SE3_egovehicle.feather", {"timestamp_ns": stamps, **_poses(cities)})
        _write_table(folder / "annotations.feather", annotations)
    return len(stamps)


def _sweep(lidars: dict[str, SensorCloud]) -> dict[str, np.ndarray]:
    clouds = list(lidars.values())
    points = np.concatenate([np.zeros((0, 3)), *(cloud.in_world() for cloud in clouds)])
    sizes = [len(cloud.points) for cloud in clouds]
    times = [np.zeros(len(cloud.points)) if cloud.time is None else cloud.time for cloud in clouds]
    return {
        **dict(zip("xyz", points.T.astype(np.float32), strict=True)),
        "intensity": np.concatenate([np.zeros(0, np.float32), *map(intensity_of, clouds)]),
        "laser_number": np.repeat([LASERS[name].start for name in lidars], sizes).astype(np.uint8),
        "offset_ns": np.round(np.concatenate([np.zeros(0), *times]) * 1e9).astype(np.int32),
    }


def _labels(sample: Sample, stamp: int) -> dict[str, np.ndarray]:
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


def _poses(placed: list[np.ndarray]) -> dict[str, list[float]]:
    rows = np.array([[*quaternion_of(each), *each[:3, 3]] for each in placed]).reshape(-1, 7)
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
