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
    """List the times (ns) of a log's sweeps in rising order.

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
    table = read_table(Path(log, "annotations.feather"))
    table = {name: column[_stamps(table) == time] for name, column in table.items()}
    poses = _poses(table)
    yaw = box_frames.find_headings(poses[:, :3, :3], {} if problems is None else problems)
    size = [table[name] for name in ("length_m", "width_m", "height_m")]
    categories = tuple(map(str, table["category"]))
    tracks = tuple(map(str, table["track_uuid"]))
    boxes = np.column_stack([poses[:, :3, 3], *size, yaw])
    return Labels(boxes, categories, table["num_interior_pts"].astype(np.int64), tracks)


def check_log(log: str | Path) -> list[Checked]:
    """Count the points of every labelled cuboid in the fused sweep, and compare with the
    recording's."""
    checked = []
    for frame in argoverse(Path(log)):
        labels = read_labels(log, int(frame.name))
        counted = count_points(frame.points(), labels.boxes)
        rows = zip(
            labels.categories, counted.tolist(), labels.interior_points.tolist(), strict=True
        )
        checked += [Checked(int(frame.name), *row) for row in rows]
    return checked


def _poses(table: Mapping[str, np.ndarray]) -> Float64[np.ndarray, "n 4 4"]:
    # Pose (4, 4) of each row of a table.
    rows = np.column_stack([table[name] for name in _POSE])
    return np.array([quaternion_pose(row[:4], row[4:]) for row in rows]).reshape(-1, 4, 4)


def argoverse(path: Path) -> listing.Listing:
    """Open a log, its sweeps as frames. Raises FileNotFoundError if the folder is not a log."""
    names = tuple(map(str, sweep_times(path)))
    annotations = path / "annotations.feather"
    labelled: list[str] = []
    if lexists(annotations):
        with name_damage(annotations, "table of labels"):
            labelled = np.unique(_stamps(read_table(annotations))).astype(str).tolist()
    return listing.Listing(names, partial(_sample, path), labelled=labelled)


def _stamps(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the times (ns) of a table's rows; ValueError unless they are whole numbers.

    They are not converted: a float has lost the last digits, and a text equals no number."""
    stamps = table["timestamp_ns"]
    if stamps.dtype.kind not in "iu":
        raise ValueError(
            f"timestamp_ns must hold whole nanoseconds, got {stamps.dtype}: convert the column to "
            "int64"
        )
    return stamps


def _sample(log: Path, name: str) -> Frame:
    problems: problem_kinds.Problems = {}
    # ego_SE3_sensor
    time = int(name)
    calibration = dict[str, Pose]()
    if lexists(log / _CALIBRATION):
        with name_damage(log / _CALIBRATION, "calibration"):
            table = read_table(log / _CALIBRATION)
            calibration = dict(zip(map(str, table["sensor_name"]), _poses(table), strict=True))
    else:  # the points are in the vehicle's frame anyway
        add_problem(problems, NO_CALIBRATION, 1)
    file = log / "sensors" / "lidar" / f"{name}.feather"
    clouds = []
    with name_damage(file, "sweep"):
        table = read_table(file)
        recorded = name_attributes(table)
        strange = ~np.isin(table["laser_number"], [*chain(*LASERS.values())])
        add_problem(problems, NO_LASER, int(strange.sum()))
        for lidar, lasers in LASERS.items():
            is_lidar = np.isin(table["laser_number"], lasers)
            if is_lidar.any() or lidar in calibration:
                lidar_columns = {key: column[is_lidar] for key, column in recorded.items()}
                pose = calibration[lidar] if calibration else np.eye(4)
                stamp = (time + _first_offset_ns(lidar_columns)) * 1e-9
                clouds.append(
                    cloud_records.build_cloud(
                        lidar_columns, lidar, pose, problems, frame="world", stamp_s=stamp
                    )
                )
    annotations = log / "annotations.feather"
    labels_in_frame = frame_labels.no_labels()
    if lexists(annotations):
        with name_damage(annotations, "table of labels"):
            labels = read_labels(log, time, problems)
            columns = labels.boxes, labels.categories, labels.tracks
            labels_in_frame = frame_labels.make_labels(*columns, problems, labels.interior_points)
    city = log / "city_SE3_egovehicle.feather"
    map_SE3_ego = np.eye(4)
    if lexists(city):
        with name_damage(city, "table of poses"):
            table = read_table(city)
            rows = np.flatnonzero(_stamps(table) == time)[:1]
            add_problem(problems, NO_PLACE, int(not len(rows)))
            map_SE3_ego = next(iter(_poses({key: table[key][rows] for key in _POSE})), map_SE3_ego)
    return Frame.of_clouds(
        name,
        clouds,
        *labels_in_frame,
        time=time * 1e-9,
        map_SE3_world=map_SE3_ego,
        problems=problems,
    )


def _first_offset_ns(columns: Mapping[str, np.ndarray]) -> int:
    """Time (ns) from a sweep's time to a lidar's first point, 0 if the points have no times."""
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
        for column, values in _labels(sample, stamps[-1]).items():
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
    within = np.zeros(len(cloud.points)) if cloud.time is None else cloud.time
    # float64 holds no finer clock
    return within + round(frame_times.cloud_time(cloud, start_s) - start_s, 6)


def _sweep(sample: Frame, start_s: float) -> dict[str, np.ndarray]:
    """Columns of a sweep's file with the points of all clouds. start_s: time of the sweep (s)."""
    sizes = [len(cloud.points) for cloud in sample.clouds]
    times = [_offsets_s(cloud, start_s) for cloud in sample.clouds]
    lasers = [lasers.start for lasers in LASERS.values()][: len(sizes)]
    return {
        **dict(zip("xyz", sample.points().T.astype(np.float32), strict=True)),
        "intensity": np.concatenate(
            [np.zeros(0, np.float32), *map(cloud_records.get_intensity, sample.clouds)]
        ),
        "laser_number": np.repeat(lasers, sizes).astype(np.uint8),
        "offset_ns": _fit_offsets(np.concatenate([np.zeros(0), *times])),
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


def _labels(sample: Frame, stamp: int) -> dict[str, np.ndarray]:
    boxes = sample.objects.boxes
    half = sample.objects.boxes[:, 6] / 2
    sizes = dict(zip(("length_m", "width_m", "height_m"), boxes[:, 3:6].T, strict=True))
    turns = dict(
        zip(_POSE, (np.cos(half), 0 * half, 0 * half, np.sin(half), *boxes[:, :3].T), strict=True)
    )
    ids = sample.objects.ids.astype(str)
    names = [_NAMES[LABELS[label]] for label in sample.objects.labels]
    labels = {
        "timestamp_ns": np.full(len(boxes), stamp, np.int64),
        "track_uuid": ids.astype(object),
    }
    labels |= {"category": np.array(names, object), **sizes, **turns}
    counts = count_points(sample.points(), boxes) if sample.counts is None else sample.counts
    return labels | {"num_interior_pts": counts}


def _pose_columns(poses: Sequence[np.ndarray]) -> dict[str, list[float]]:
    rows = np.array([[*compute_quaternion(pose), *pose[:3, 3]] for pose in poses]).reshape(-1, 7)
    return {name: column.tolist() for name, column in zip(_POSE, rows.T, strict=True)}


def _write_table(path: Path, columns: Mapping[str, object]) -> None:
    try:
        import pyarrow
        from pyarrow import feather
    except ImportError:
        raise ImportError("writing .feather needs pyarrow: pip install pyarrow") from None
    with writing(path) as unfinished:
        feather.write_feather(pyarrow.table(columns), unfinished, compression="lz4")
