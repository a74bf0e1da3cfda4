"""Clouds of recorded files: positions, intensities, rings and times of points."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from toolkit.arrays import Float32, Float64, Int64, Mask, Pose
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
    """Read the cloud of one sensor from a file, without points that cannot be used.

    Args:
        path: the file, with positions in the sensor's frame.
        name: name of the sensor.
        world_SE3_sensor: its pose.
        problems: kinds and numbers of points left out are added to it.
        stamp_s: time of the cloud (s), None if unknown.
        middles: place from which each sensor's clouds are counted if they are kilometres from
            their origin, the same for a whole recording; None for a single cloud.

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
    """Build a sensor's cloud from recorded columns, without points that cannot be used.

    Points kilometres from their origin, such as in UTM without their sensor's pose, are counted
    from the middle of the sensor's first cloud, which moves into the pose.

    Args:
        attributes: columns by name: `positions` (n, 3; m) and maybe intensity, ring and time.
        name: name of the sensor.
        world_SE3_sensor: its pose.
        problems: kinds and numbers of points left out are added to it.
        frame: frame of the positions.
        stamp_s: time of the cloud (s), None if unknown.
        middles: middles of the recording's sensors; None for one cloud only.

    Raises ValueError for points that are too far apart to be metres."""
    positions = np.asarray(attributes["positions"], np.float64)
    check_extent(positions)
    is_returned = np.ones(len(positions), bool)
    if frame == "sensor":  # drivers write 0 0 0 for no return
        is_returned = (positions != 0).any(axis=1)
    middle = find_far_middle(positions)
    if middle.any():
        add_problem(problems, COARSE_POINTS, int(describe_rounding(positions) is not None))
        if frame == "world":
            positions = transform(invert(world_SE3_sensor), positions)
            frame = "sensor"
            middle = find_far_middle(positions)
    if middle.any():
        add_problem(problems, UNPLACED, 1)
        origin = (middles or Middles()).find(name, middle)
        positions = positions - origin
        world_SE3_sensor = world_SE3_sensor @ translation(origin)
    is_kept = _mark_sound(positions, is_returned, problems)
    columns = _PointColumns(attributes, is_kept)
    return SensorCloud(
        name=name,
        points=positions[is_kept].astype(np.float32),
        world_SE3_sensor=world_SE3_sensor,
        frame=frame,
        time=columns.find_times(problems),
        intensity=columns.find_intensity(),
        ring=columns.find_rings(),
        stamp_s=stamp_s,
    )


def _mark_sound(
    positions: Float64[np.ndarray, "n 3"], is_returned: Mask, problems: Problems
) -> Mask:
    """Mask of the points to keep; the others are counted in `problems`, which is changed in place.

    Points far from the middle are counted but kept. positions: m; is_returned: mask of the points
    that are no placeholder for no return."""
    with np.errstate(invalid="ignore"):
        is_finite = (np.abs(positions) <= MAX_POINT_DISTANCE_M).all(axis=1)  # NaN is not
    is_kept = is_finite & is_returned
    add_problem(problems, NOT_FINITE_POINTS, int((~is_finite).sum()))
    add_problem(problems, NO_RETURN_POINTS, int((is_finite & ~is_returned).sum()))
    add_problem(problems, EMPTY, int(not is_kept.any()))
    if is_kept.any():
        points = positions[is_kept]
        middle = np.median(points[:: len(points) // 1000 + 1], axis=0)  # a thousand are enough
        is_far = np.linalg.norm(points - middle, axis=1) > _FAR_POINT_M
        add_problem(problems, FAR_POINTS, int(is_far.sum()))
    return is_kept


class _PointColumns(NamedTuple):
    """Columns of a recorded cloud, and a mask of the points that are kept."""

    attributes: Mapping[str, np.ndarray]
    is_kept: Mask

    def _kept_columns(self, names: Sequence[str], *, wide: bool = False) -> Iterator[np.ndarray]:
        """Yield the attributes with some names, for the kept points, in the names' order.

        Names without an attribute are skipped, and attributes of another length. wide: True to take
        the first column of attributes with several; otherwise they are skipped too."""
        count = len(self.is_kept)
        for name in names:
            if name not in self.attributes:
                continue
            values = np.asarray(self.attributes[name])
            if len(values) == count and (wide or values.size == count):
                column = values if values.ndim == 1 else values[:, 0]
                yield column[self.is_kept]

    def find_intensity(self) -> Float32[np.ndarray, " n"] | None:
        """Intensities, None without any; OPV2V keeps them in the red of colours."""
        intensity = next(self._kept_columns(_INTENSITIES, wide=True), None)
        return None if intensity is None else intensity.astype(np.float32)

    def find_rings(self) -> Int64[np.ndarray, " n"] | None:
        """Laser of each point by the first column of whole numbers, None without one."""
        for column in self._kept_columns(_RINGS):
            is_small = column.dtype.kind in "iu" or (np.abs(column) < _MAX_RINGS).all()
            if is_small and (column % 1 == 0).all():
                return column.astype(np.int64)
        return None

    def find_times(self, problems: Problems) -> Float64[np.ndarray, " n"] | None:
        """Times of points (s), None without a column of times or if its unit is unknown.

        An unknown unit is counted in `problems`, which is changed in place."""
        count = len(self.is_kept)
        for name, column in self.attributes.items():
            if is_time(name) and np.size(column) == count:
                kept_times = next(self._kept_columns([name]))
                seconds = parse_point_times(name, kept_times)
                add_problem(problems, UNTIMED, int(seconds is None))
                return seconds
        return None


def write_cloud(path: str | Path, cloud: SensorCloud) -> None:
    """Write a cloud as a binary PCD file: x y z (m) as stored, intensity, and ring if known."""
    columns = dict(zip("xyz", cloud.points.astype(np.float32).T, strict=True))
    columns["intensity"] = get_intensity(cloud)
    if cloud.ring is not None:
        columns["ring"] = cloud.ring.astype(np.int32)
    write_bytes(path, pcd_bytes(columns))


def one_cloud(sample: Frame) -> SensorCloud:
    """Merge all clouds of a frame into one in its world frame, named "lidar".

    Intensities are kept if all clouds have them, the time if it is the same for all. Its pose is
    the pose of the first cloud's sensor."""
    intensities = [cloud.intensity for cloud in sample.clouds if cloud.intensity is not None]
    all_have_intensity = len(intensities) == len(sample.clouds) and len(intensities) > 0
    stamps = {cloud.stamp_s for cloud in sample.clouds}
    return SensorCloud(
        name="lidar",
        points=sample.points().astype(np.float32),
        world_SE3_sensor=sample.clouds[0].world_SE3_sensor if sample.clouds else np.eye(4),
        frame="world",
        intensity=np.concatenate(intensities) if all_have_intensity else None,
        stamp_s=stamps.pop() if len(stamps) == 1 else None,
    )


def get_intensity(cloud: SensorCloud) -> np.ndarray:
    """Intensity of each point, 0 if the sensor gives none."""
    return np.zeros(len(cloud.points), np.float32) if cloud.intensity is None else cloud.intensity
