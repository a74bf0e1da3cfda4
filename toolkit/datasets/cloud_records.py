"""Clouds of recorded files: positions, intensities, rings and times of points."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets.cloud_files import read_recorded
from toolkit.datasets.coordinates import check_extent, describe_rounding
from toolkit.datasets.origins import Middles, find_far_middle, translation
from toolkit.datasets.point_times import is_time, parse_point_times
from toolkit.datasets.problem_kinds import (
    COARSE_POINTS,
    EMPTY,
    FAR_POINTS,
    NO_RETURN_POINTS,
    NOT_FINITE_POINTS,
    UNPLACED,
    UNTIMED,
    Problems,
    add_problem,
)
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, transform
from toolkit.point_files.pcd import pcd_bytes
from toolkit.runtime.writing import write_bytes

MAX_POINT_DISTANCE_M = 1e5  # from the sensor or the cloud's middle; float32 holds centimetres
_FAR_POINT_M = 1000.0  # from the middle, beyond the range of traffic sensors
_INTENSITIES = ("intensity", "reflectivity", "i", "colors")
_RINGS = ("ring", "laser_number", "laser_id", "channel", "line", "beam")
_MAX_RINGS = 1 << 16  # in a column of floats, such as nuScenes writes


def read_cloud(
    path: str | Path,
    name: str,
    world_SE3_sensor: Pose,
    problems: Problems,
    *,
    stamp_s: float | None = None,
    middles: Middles | None = None,
) -> SensorCloud:
    """Read the cloud of a file, as `build_cloud`.

    Raises FileNotFoundError, and ValueError for a file without readable points."""
    attributes = read_recorded(path)
    return build_cloud(
        attributes, name, world_SE3_sensor, problems, stamp_s=stamp_s, middles=middles
    )


def build_cloud(
    attributes: Mapping[str, np.ndarray],
    name: str,
    world_SE3_sensor: Pose,
    problems: Problems,
    *,
    frame: Literal["sensor", "world"] = "sensor",
    stamp_s: float | None = None,
    middles: Middles | None = None,
) -> SensorCloud:
    """Build a cloud of `positions` and other columns.

    Points kilometres from their origin, such as in UTM without their sensor's pose, are counted
    from the middle of the sensor's first cloud, which moves into the pose. middles: middles of the
    recording's sensors. Raises ValueError for points that are too far apart to be metres."""
    recorded = np.asarray(attributes["positions"], np.float64)
    check_extent(recorded)
    is_returned = (recorded != 0).any(axis=1) if frame == "sensor" else np.ones(len(recorded), bool)
    middle = find_far_middle(recorded)
    if middle.any():
        add_problem(problems, COARSE_POINTS, int(describe_rounding(recorded) is not None))
        if frame == "world":
            recorded = transform(invert(world_SE3_sensor), recorded)
            frame = "sensor"
            middle = find_far_middle(recorded)
    if middle.any():
        add_problem(problems, UNPLACED, 1)
        origin = (middles or Middles()).find(name, middle)
        recorded = recorded - origin
        world_SE3_sensor = world_SE3_sensor @ translation(origin)
    with np.errstate(invalid="ignore"):
        is_sound = (np.abs(recorded) <= MAX_POINT_DISTANCE_M).all(axis=1)  # NaN is not
    is_kept = is_sound & is_returned
    add_problem(problems, NOT_FINITE_POINTS, int((~is_sound).sum()))
    add_problem(problems, NO_RETURN_POINTS, int((is_sound & ~is_returned).sum()))
    add_problem(problems, EMPTY, int(not is_kept.any()))
    if is_kept.any():
        middle = np.median(recorded[is_kept][:: int(is_kept.sum()) // 1000 + 1], axis=0)
        add_problem(
            problems,
            FAR_POINTS,
            int((np.linalg.norm(recorded[is_kept] - middle, axis=1) > _FAR_POINT_M).sum()),
        )

    def columns(names: Sequence[str], *, wide: bool = False) -> Iterator[np.ndarray]:
        """Columns with these names, or the first of their columns if `wide`."""
        for column in (np.asarray(attributes[key]) for key in names if key in attributes):
            if len(column) == len(is_kept) and (wide or column.size == len(is_kept)):
                yield (column if column.ndim == 1 else column[:, 0])[is_kept]

    intensity = next(columns(_INTENSITIES, wide=True), None)  # OPV2V keeps it in the red
    rings = (
        ring_column
        for ring_column in columns(_RINGS)
        if ring_column.dtype.kind in "iu" or (np.abs(ring_column) < _MAX_RINGS).all()
    )
    ring = next((ring_column for ring_column in rings if (ring_column % 1 == 0).all()), None)
    timed = [key for key in attributes if is_time(key) and np.size(attributes[key]) == len(is_kept)]
    seconds = parse_point_times(timed[0], next(columns(timed[:1]))) if timed else None
    add_problem(problems, UNTIMED, int(bool(timed) and seconds is None))
    geometry = recorded[is_kept].astype(np.float32), world_SE3_sensor, frame
    intensity = None if intensity is None else intensity.astype(np.float32)
    return SensorCloud(
        name,
        *geometry,
        seconds,
        intensity,
        None if ring is None else ring.astype(np.int64),
        stamp_s,
    )


def write_cloud(path: str | Path, cloud: SensorCloud) -> None:
    """Write x y z, intensity, and ring if known, of a cloud, in its frame, as a binary PCD file."""
    columns = dict(zip("xyz", cloud.points.astype(np.float32).T, strict=True))
    ring = {} if cloud.ring is None else {"ring": cloud.ring.astype(np.int32)}
    write_bytes(path, pcd_bytes(columns | {"intensity": get_intensity(cloud)} | ring))


def one_cloud(sample: Frame) -> SensorCloud:
    """Merge all clouds of a frame in its world frame. Intensities are kept if all clouds have
    them."""
    intensities = [cloud.intensity for cloud in sample.clouds if cloud.intensity is not None]
    is_complete = len(intensities) == len(sample.clouds) and len(intensities) > 0
    pose = sample.clouds[0].world_SE3_sensor if sample.clouds else np.eye(4)
    intensity = np.concatenate(intensities) if is_complete else None
    stamps = {cloud.stamp_s for cloud in sample.clouds}
    stamp = stamps.pop() if len(stamps) == 1 else None
    points = sample.points().astype(np.float32)
    return SensorCloud("lidar", points, pose, "world", intensity=intensity, stamp_s=stamp)


def get_intensity(cloud: SensorCloud) -> np.ndarray:
    """Intensity of each point, 0 if the sensor gives none."""
    return np.zeros(len(cloud.points), np.float32) if cloud.intensity is None else cloud.intensity
