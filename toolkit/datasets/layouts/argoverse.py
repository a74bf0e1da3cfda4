"""Argoverse 2 logs with two real lidars.

Lasers 0-31 of a sweep belong to `up_lidar`, 32-63 to `down_lidar`. World frame: the ego vehicle's.
`check_log` fuses the two lidars as any two sensors, and counts the points in every labelled cuboid,
to compare with the recording's count."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from os.path import lexists
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Int32, Int64, Pose
from toolkit.boxes import count_points
from toolkit.datasets import (
    box_frames,
    cloud_records,
    folders,
    frame_labels,
    frame_times,
    listing,
    problem_kinds,
)
from toolkit.datasets.feather_files import read_table
from toolkit.datasets.layouts.nuscenes import compute_quaternion
from toolkit.datasets.origins import near_frames
from toolkit.datasets.pose_files import quaternion_pose
from toolkit.datasets.problem_kinds import add_problem
from toolkit.datasets.record_values import name_damage
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import LABELS
from toolkit.point_columns import name_attributes
from toolkit.runtime.writing import writing

LASERS = {"up_lidar": range(32), "down_lidar": range(32, 64)}
_CALIBRATION = Path("calibration", "egovehicle_SE3_sensor.feather")
_POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
NO_LASER = "points of other lasers than 0 to 63"
NO_CALIBRATION = "sensors without calibration stand at the vehicle's origin"
NO_PLACE = "sweeps whose time has no pose in the map"
_NAMES = {
    "vehicle": "REGULAR_VEHICLE",
    "cyclist": "BICYCLIST",
    "pedestrian": "PEDESTRIAN",
    "heavy": "TRUCK",
}


@dataclass(frozen=True)
class Labels:
    """Labelled cuboids of one sweep, in the vehicle's frame.

    boxes: m and rad; categories, tracks: class and track id of each, as in the log;
    interior_points: the recording's number of points in each."""

    boxes: BoxRows
    categories: tuple[str, ...]
    interior_points: Int64[np.ndarray, " n"]
    tracks: tuple[str, ...]


class Checked(NamedTuple):
    """Number of points in one labelled cuboid, counted here and by the recording.

    sweep: time of its sweep (ns); category: its class; points: our count; recorded: theirs."""

    sweep: int
    category: str
    points: int
    recorded: int


def sweep_times(log: str | Path) -> list[int]:
    """List the times (ns) of a log's sweeps, which are the names of their files, in rising order.

    Raises FileNotFoundError if the folder is no log."""
    files = folders.list_files(Path(log, "sensors", "lidar"), "*.feather")
    times = sorted(int(file.stem) for file in files if file.stem.isdecimal())
    if not times:
        raise FileNotFoundError(f"{log} is no Argoverse 2 log: it has no sensors/lidar/*.feather")
    return times


def read_labels(
    log: str | Path, time: int, problems: problem_kinds.Problems | None = None
) -> Labels:
    """Read the cuboids that are labelled at the time of one sweep.

    log: folder of the log; time: time of the sweep (ns); problems: boxes with more tilt than any
    road are counted in it, None for no count."""
    all_rows = read_table(Path(log, "annotations.feather"))
    is_of_sweep = _get_stamps(all_rows) == time
    table = {name: column[is_of_sweep] for name, column in all_rows.items()}
    poses = _parse_poses(table)
    rotations, centres = poses[:, :3, :3], poses[:, :3, 3]
    yaw = box_frames.find_headings(rotations, {} if problems is None else problems)
    size = [table[name] for name in ("length_m", "width_m", "height_m")]
    return Labels(
        boxes=np.column_stack([centres, *size, yaw]),
        categories=tuple(map(str, table["category"])),
        interior_points=table["num_interior_pts"].astype(np.int64),
        tracks=tuple(map(str, table["track_uuid"])),
    )


def check_log(log: str | Path) -> list[Checked]:
    """Count the points of every labelled cuboid in the fused sweep, next to the recording's count.

    The result has a row for each cuboid, sweep after sweep."""
    checked = []
    for frame in argoverse(Path(log)):
        time = int(frame.name)  # frames are named by their time (ns)
        labels = read_labels(log, time)
        counts = count_points(frame.points(), labels.boxes)
        for category, count, recorded_count in zip(
            labels.categories, counts.tolist(), labels.interior_points.tolist(), strict=True
        ):
            checked.append(Checked(time, category, points=count, recorded=recorded_count))
    return checked


def _parse_poses(table: Mapping[str, np.ndarray]) -> Float64[np.ndarray, "n 4 4"]:
    """Pose (4, 4) of each row of a table with the columns `_POSE`: quaternion and translation."""
    rows = np.column_stack([table[name] for name in _POSE])
    return np.array([quaternion_pose(row[:4], row[4:]) for row in rows]).reshape(-1, 4, 4)


def argoverse(path: Path) -> listing.Listing:
    """Open a log as a recording, its sweeps as frames that are read on demand.

    Raises FileNotFoundError if the folder is not a log."""
    names = tuple(map(str, sweep_times(path)))
    annotations = path / "annotations.feather"
    labelled: list[str] = []
    if lexists(annotations):
        with name_damage(annotations, "table of labels"):
            labelled = np.unique(_get_stamps(read_table(annotations))).astype(str).tolist()
    return listing.Listing(names, partial(_read_frame, path), labelled=labelled)


def _get_stamps(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the times (ns) of a table's rows; ValueError unless they are whole numbers.

    They are not converted: a float has lost the last digits, and a text equals no number."""
    stamps = table["timestamp_ns"]
    if stamps.dtype.kind not in "iu":
        raise ValueError(
            f"timestamp_ns must hold whole nanoseconds, got {stamps.dtype}: convert the column to "
            "int64"
        )
    return stamps


def _read_frame(log: Path, name: str) -> Frame:
    """Read the sweep of a name, its time in ns, as a frame. log: folder of the log."""
    problems: problem_kinds.Problems = {}
    time_ns = int(name)
    clouds = _read_clouds(log, time_ns, problems)
    annotations = log / "annotations.feather"
    labels_in_frame = frame_labels.no_labels()
    if lexists(annotations):
        with name_damage(annotations, "table of labels"):
            labels = read_labels(log, time_ns, problems)
            labels_in_frame = frame_labels.make_labels(
                labels.boxes,
                categories=labels.categories,
                ids=labels.tracks,
                problems=problems,
                counts=labels.interior_points,
            )
    map_SE3_ego = _read_vehicle_pose(log, time_ns, problems)
    return Frame.of_clouds(
        name,
        clouds,
        *labels_in_frame,  # objects, categories, counts, others
        time=time_ns * 1e-9,
        map_SE3_world=map_SE3_ego,
        problems=problems,
    )


def _read_clouds(log: Path, time_ns: int, problems: problem_kinds.Problems) -> list[SensorCloud]:
    """Read the clouds of a sweep's lidars, in the vehicle's frame.

    log: folder of the log; time_ns: time of the sweep; problems: counts are added to it. Raises
    ValueError if the calibration lacks a lidar of the sweep."""
    calibration = dict[str, Pose]()  # ego_SE3_sensor by the name of the sensor
    if lexists(log / _CALIBRATION):
        with name_damage(log / _CALIBRATION, "calibration"):
            table = read_table(log / _CALIBRATION)
            sensor_names = map(str, table["sensor_name"])
            calibration = dict(zip(sensor_names, _parse_poses(table), strict=True))
    else:  # the points are in the vehicle's frame anyway
        add_problem(problems, NO_CALIBRATION, 1)
    file = log / "sensors" / "lidar" / f"{time_ns}.feather"
    clouds = []
    with name_damage(file, "sweep"):
        table = read_table(file)
        attributes = name_attributes(table)
        is_other_laser = ~np.isin(table["laser_number"], [*chain(*LASERS.values())])
        add_problem(problems, NO_LASER, int(is_other_laser.sum()))
        for lidar, lasers in LASERS.items():
            is_of_lidar = np.isin(table["laser_number"], lasers)
            if is_of_lidar.any() and calibration and lidar not in calibration:
                raise ValueError(
                    f"it has points of {lidar}, which {log / _CALIBRATION} lacks: add its row, or "
                    "remove that file if all points are in the vehicle's frame"
                )
            if is_of_lidar.any() or lidar in calibration:
                lidar_columns = {key: column[is_of_lidar] for key, column in attributes.items()}
                pose = calibration[lidar] if calibration else np.eye(4)
                stamp_s = (time_ns + _first_offset_ns(lidar_columns)) * 1e-9
                clouds.append(
                    cloud_records.build_cloud(
                        lidar_columns, lidar, pose, problems, frame="world", stamp_s=stamp_s
                    )
                )
    return clouds


def _read_vehicle_pose(log: Path, time_ns: int, problems: problem_kinds.Problems) -> Pose:
    """Read the vehicle's pose in the map at the time of a sweep.

    It is the identity without a table of poses, and, counted in `problems`, if the table lacks the
    time."""
    city = log / "city_SE3_egovehicle.feather"
    if not lexists(city):
        return np.eye(4)
    with name_damage(city, "table of poses"):
        table = read_table(city)
        rows = np.flatnonzero(_get_stamps(table) == time_ns)
        if not len(rows):
            add_problem(problems, NO_PLACE, 1)
            return np.eye(4)
        return _parse_poses({column: table[column][rows[:1]] for column in _POSE})[0]


def _first_offset_ns(columns: Mapping[str, np.ndarray]) -> int:
    """Time (ns) from a sweep's time to a lidar's first point, 0 if the points have no times.

    columns: columns of the points, by name."""
    offsets = columns.get("offset_ns", np.zeros(0, np.int64))
    return int(offsets.min()) if offsets.size and offsets.dtype.kind in "iu" else 0


def write_argoverse(samples: Iterable[Frame], folder: Path) -> None:
    """Write frames as a log.

    The first two sensors become up_lidar and down_lidar; a frame of more raises ValueError. Sweeps
    without times get tenths of a second."""
    annotations: dict[str, np.ndarray] = {}
    stamps: list[int] = []
    cities: list[np.ndarray] = []
    poses_by_lidar: dict[str, np.ndarray] = {}
    for k, sample in enumerate(near_frames(samples)):
        if len(sample.clouds) > len(LASERS):
            count = len(sample.clouds)
            remedy = "leave out the others, or convert to folder or nuscenes, which hold any number"
            raise ValueError(
                f"an Argoverse log has two lidars, but {sample.name!r} has {count}: {remedy}"
            )
        stamps.append(round(frame_times.clock_time(sample, k) * 1e9))
        if stamps[-1] in stamps[:-1]:
            raise ValueError(
                "sweeps of an Argoverse log are named by their times, but two are of "
                f"{sample.time:g} s"
            )
        cities.append(sample.map_SE3_world)
        poses_by_lidar |= {
            name: cloud.world_SE3_sensor for name, cloud in zip(LASERS, sample.clouds, strict=False)
        }
        sweep = _sweep(sample, stamps[-1] * 1e-9)
        _write_table(folder / "sensors" / "lidar" / f"{stamps[-1]}.feather", sweep)
        for column, values in _format_labels(sample, stamps[-1]).items():
            annotations[column] = np.concatenate([annotations.get(column, values[:0]), values])
    if stamps:
        _write_table(
            folder / _CALIBRATION,
            {"sensor_name": list(poses_by_lidar), **_pose_columns(list(poses_by_lidar.values()))},
        )
        _write_table(
            folder / "city_SE3_egovehicle.feather",
            {"timestamp_ns": stamps, **_pose_columns(cities)},
        )
        _write_table(folder / "annotations.feather", annotations)


def _offsets_s(cloud: SensorCloud, start_s: float) -> np.ndarray:
    """Time (s) from the sweep's time to each point of a cloud. start_s: the sweep's time (s)."""
    times_in_cloud = np.zeros(len(cloud.points)) if cloud.time is None else cloud.time
    # rounded to a microsecond: float64 holds no finer clock since 1970
    return times_in_cloud + round(frame_times.cloud_time(cloud, start_s) - start_s, 6)


def _sweep(sample: Frame, start_s: float) -> dict[str, np.ndarray]:
    """Columns of a sweep's file with the points of all clouds, in the frame of the world.

    start_s: time of the sweep (s)."""
    point_counts = [len(cloud.points) for cloud in sample.clouds]
    offsets_s = [_offsets_s(cloud, start_s) for cloud in sample.clouds]
    intensities = [cloud_records.get_intensity(cloud) for cloud in sample.clouds]
    # all points of a lidar get its first laser
    first_lasers = [lasers.start for lasers in LASERS.values()][: len(point_counts)]
    return {
        **dict(zip("xyz", sample.points().T.astype(np.float32), strict=True)),
        "intensity": np.concatenate([np.zeros(0, np.float32), *intensities]),
        "laser_number": np.repeat(first_lasers, point_counts).astype(np.uint8),
        "offset_ns": _fit_offsets(np.concatenate([np.zeros(0), *offsets_s])),
    }


def _fit_offsets(offsets_s: Float64[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
    """Return times of points after their sweep's time in whole nanoseconds.

    They are all 0, with a warning, if a point is too far from its sweep's time for the column's
    type."""
    offsets_ns = np.round(offsets_s * 1e9)
    if np.abs(offsets_ns).max(initial=0) > np.iinfo(np.int32).max:
        warnings.warn(
            "times of points are left out: offset_ns holds two seconds from the sweep's time",
            stacklevel=2,
        )
        offsets_ns = np.zeros(len(offsets_ns))
    return offsets_ns.astype(np.int32)


def _format_labels(sample: Frame, stamp_ns: int) -> dict[str, np.ndarray]:
    """Columns of the table of labels with a row for each object of a frame.

    stamp_ns: time of the frame."""
    boxes = sample.objects.boxes
    centre_columns, size_columns = boxes[:, :3].T, boxes[:, 3:6].T
    yaw = boxes[:, 6]
    zeros = 0 * yaw
    w_x_y_z = np.cos(yaw / 2), zeros, zeros, np.sin(yaw / 2)  # quaternion of a turn about z
    names = [_NAMES[LABELS[label]] for label in sample.objects.labels]
    counts = count_points(sample.points(), boxes) if sample.counts is None else sample.counts
    return {
        "timestamp_ns": np.full(len(boxes), stamp_ns, np.int64),
        "track_uuid": sample.objects.ids.astype(str).astype(object),
        "category": np.array(names, object),
        **dict(zip(("length_m", "width_m", "height_m"), size_columns, strict=True)),
        **dict(zip(_POSE, (*w_x_y_z, *centre_columns), strict=True)),
        "num_interior_pts": counts,
    }


def _pose_columns(poses: Sequence[np.ndarray]) -> dict[str, list[float]]:
    rows = np.array([[*compute_quaternion(pose), *pose[:3, 3]] for pose in poses]).reshape(-1, 7)
    return {name: column.tolist() for name, column in zip(_POSE, rows.T, strict=True)}


def _write_table(path: Path, columns: Mapping[str, object]) -> None:
    """Write columns, by name, to a feather file, whole or not at all.

    Raises ImportError without pyarrow."""
    try:
        import pyarrow
        from pyarrow import feather
    except ImportError:
        raise ImportError("writing .feather needs pyarrow: pip install pyarrow") from None
    with writing(path) as unfinished:
        feather.write_feather(pyarrow.table(columns), unfinished, compression="lz4")
