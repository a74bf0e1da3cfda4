"""Clouds of recordings: any cloud file as a `SensorCloud`, with time, intensity and ring where there are some.

Points that are not finite, and those of no return, which drivers store at the sensor itself, are left out and counted;
a cloud without points is counted and stays. Times are seconds from the earliest point of the cloud: whole numbers are
taken as nanoseconds, others as seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.cloud_files import read_recorded
from toolkit.datasets.records.labels import add_problem
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.point_files import pcd_bytes
from toolkit.runtime.files import write_bytes

ENDINGS = (".pcd", ".bin", ".ply", ".npy", ".npz", ".feather", ".xyz", ".csv")
NOT_FINITE_POINTS = "points with NaN or infinite numbers"
NO_RETURN_POINTS = "points of no return"
EMPTY = "clouds without points"
FARTHEST_POINT = 1e5  # m from the sensor, beyond which float32 keeps no centimetres
_INTENSITIES = ("intensity", "reflectivity", "i", "colors")
_RINGS = ("ring", "laser_number", "laser_id", "channel", "line", "beam")
_MOST_RINGS = 1 << 16  # that are believed where they are written as floats, as nuScenes does
_TIMES = ("offset_ns", "t", "time", "timestamp", "time_stamp", "offset_time")


def read_cloud(
    path: str | Path,
    name: str,
    world_SE3_sensor: Float64[np.ndarray, "4 4"],
    problems: dict[str, int],
    *,
    frame: Literal["sensor", "world"] = "sensor",
) -> SensorCloud:
    """The cloud of a file. Raises FileNotFoundError, and ValueError for a file that holds no points to be read."""
    return cloud_of(read_recorded(path), name, world_SE3_sensor, problems, frame=frame)


def cloud_of(
    attributes: Mapping[str, np.ndarray],
    name: str,
    world_SE3_sensor: Float64[np.ndarray, "4 4"],
    problems: dict[str, int],
    *,
    frame: Literal["sensor", "world"] = "sensor",
) -> SensorCloud:
    """A cloud of `positions` and other columns."""
    recorded = np.asarray(attributes["positions"], np.float64)
    finite = np.isfinite(recorded).all(axis=1)
    with np.errstate(invalid="ignore"):
        near = (np.abs(recorded) <= FARTHEST_POINT).all(axis=1)
    returned = (recorded != 0).any(axis=1) if frame == "sensor" else np.ones(len(recorded), bool)
    keep = finite & near & returned
    add_problem(problems, NOT_FINITE_POINTS, int((~finite | ~near).sum()))
    add_problem(problems, NO_RETURN_POINTS, int((finite & near & ~returned).sum()))
    add_problem(problems, EMPTY, int(not keep.any()))
    columns = {key: np.asarray(column) for key, column in attributes.items()}
    return SensorCloud(
        name,
        recorded[keep].astype(np.float32),
        world_SE3_sensor,
        frame,
        _seconds(columns, keep),
        _intensity(columns, keep),
        _ring(columns, keep),
    )


def write_cloud(path: str | Path, cloud: SensorCloud, *, in_world: bool = False) -> None:
    """A cloud as a binary PCD file: x y z intensity, and ring where it is known, in its frame or in the world's."""
    points = cloud.in_world() if in_world else cloud.points
    columns = dict(zip("xyz", points.astype(np.float32).T, strict=True))
    ring = {} if cloud.ring is None else {"ring": cloud.ring.astype(np.int32)}
    write_bytes(path, pcd_bytes(columns | {"intensity": intensity_of(cloud)} | ring))


def one_cloud(sample: Sample, name: str = "lidar") -> SensorCloud:
    """All clouds of a sample as one in its world frame, with their intensities if all have some."""
    intensities = [cloud.intensity for cloud in sample.clouds if cloud.intensity is not None]
    whole = len(intensities) == len(sample.clouds) and len(intensities) > 0
    pose = sample.clouds[0].world_SE3_sensor if sample.clouds else np.eye(4)
    intensity = np.concatenate(intensities) if whole else None
    return SensorCloud(name, sample.points().astype(np.float32), pose, "world", None, intensity)


def intensity_of(cloud: SensorCloud) -> np.ndarray:
    """The intensity of each point, 0 where the sensor gives none."""
    return np.zeros(len(cloud.points), np.float32) if cloud.intensity is None else cloud.intensity


def _intensity(columns: Mapping[str, np.ndarray], keep: np.ndarray) -> np.ndarray | None:
    for name in _INTENSITIES:
        if name in columns and len(columns[name]) == len(keep):
            first = columns[name] if columns[name].ndim == 1 else columns[name][:, 0]  # OPV2V keeps it in the red
            return first[keep].astype(np.float32)
    return None


def _ring(columns: Mapping[str, np.ndarray], keep: np.ndarray) -> np.ndarray | None:
    for name in _RINGS:
        if name in columns and columns[name].size == len(keep):
            numbers = columns[name].reshape(-1)[keep]
            if numbers.dtype.kind in "iu" or bool((np.abs(numbers) < _MOST_RINGS).all() and (numbers % 1 == 0).all()):
                return numbers.astype(np.int64)
    return None


def _seconds(columns: Mapping[str, np.ndarray], keep: np.ndarray) -> np.ndarray | None:
    for name in _TIMES:
        if name in columns and columns[name].size == len(keep):
            column = columns[name].reshape(-1)[keep]
            if column.dtype.kind in "iu":
                ticks = column.astype(np.int64)
                return (ticks - ticks.min(initial=ticks[0] if len(ticks) else 0)).astype(np.float64) * 1e-9
            seconds = column.astype(np.float64)
            seconds = np.where(np.isfinite(seconds), seconds, 0.0)
            return seconds - (seconds.min() if len(seconds) else 0.0)
    return None
