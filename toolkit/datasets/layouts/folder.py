"""Plain folders of clouds: SENSOR/NAME.pcd or NAME.pcd, with poses.json (or .txt) and labels.json or without.

World frame: that of the poses, world_SE3_sensor; without a pose file the clouds are taken to be in it already.

- Clouds are any of .pcd .bin .ply .npy .npz .feather .xyz .csv (`toolkit.datasets.cloud_files`).
- Sensors' files of one name are one frame. If no two sensors share a name and all have equally many files, the k-th
  files of each are one frame, in the order of their names.
- A pose goes by the name of the sensor, or of SENSOR/NAME or NAME if it moves.
- labels.json is `toolkit.datasets.records`, by the names of the frames.
- A name that is a number of seconds, milli-, micro- or nanoseconds since 1970 gives the time. Without one it is that of
  labels.json, whose `clouds` has the times of the sensors' clouds."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from os.path import lexists
from pathlib import Path

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import records
from toolkit.datasets.clock_times import find_epoch
from toolkit.datasets.cloud_files import read_poses
from toolkit.datasets.origins import Middles
from toolkit.frame import Frame
from toolkit.runtime.files import write_text

POSES = ("poses.json", "poses.txt", "poses.csv")
LABELS_FILE = "labels.json"
RECORDED = ("*.hdf5", "*.h5", "*.bag", "*.mcap")  # recordings in single files
ALONE = "lidar"  # name of the sensor of clouds that lie in the folder itself
_ONE_WORD = re.compile(r"[\w.-]+/\d+")  # SENSOR/NAME in a line of poses.txt


def folder(path: Path, *, poses: Path | None = None, inverted: bool = False) -> records.Listing:
    """Frames of a folder, or of one cloud file. poses: a file of poses, the folder's own if None; inverted: it gives
    world → sensor. Raises FileNotFoundError if there are no clouds."""
    if path.is_file():
        clouds = {ALONE: [path]}
    elif path.is_dir():
        below = {each.name: _files(each) for each in sorted(path.iterdir()) if each.is_dir()}
        clouds = {name: files for name, files in {ALONE: _files(path), **below}.items() if files}
    else:
        raise FileNotFoundError(f"no such folder or cloud file: {path}")
    names = _match(clouds)
    if not names:
        recorded = sorted(each for kind in RECORDED for each in path.glob(kind))
        recorded += [each.parent for each in sorted(path.glob("*/metadata.yaml"))]
        remedy = f"give the recording in it, {recorded[0]}" if recorded else "give --layout, or another folder"
        raise FileNotFoundError(f"{path} holds no clouds, neither NAME.pcd nor SENSOR/NAME.pcd: {remedy}")
    base = path.parent if path.is_file() else path
    given = poses or next((base / each for each in POSES if lexists(base / each)), None)
    placed = {} if given is None else read_poses(given, inverted=inverted)
    files = [(sensor, file.stem) for each in names.values() for sensor, file in each.items()]
    if poses and not placed.keys() & {key for sensor, stem in files for key in (sensor, stem, f"{sensor}/{stem}")}:
        sensors = ", ".join(sorted({sensor for sensor, _ in files}))
        raise ValueError(f"{poses} has poses {', '.join(placed)}, but the sensors are {sensors}")
    middles = Middles({sensor: files[0] for sensor, files in clouds.items()})
    labels = base / LABELS_FILE
    entries = records.read_entries(labels) if lexists(labels) else {}
    with records.named_damage(labels, "file of boxes"):
        times = _written_times(entries)

    def load(name: str) -> Frame:
        problems: records.Problems = {}
        seconds, stamps = times.get(name, (None, {}))
        measured = []
        for sensor, file in names[name].items():
            stem = file.stem.removesuffix(".pcd")
            stamp = next((time for time in (find_epoch(stem), stamps.get(sensor)) if time is not None), None)
            pose = _pose(placed, sensor, stem)
            cloud = records.read_cloud(file, sensor, pose, problems, stamp_s=stamp, middles=middles)
            measured.append(cloud)
        found = records.parse_objects(labels, entries[name], problems) if name in entries else records.no_labels()
        known = next((time for time in (find_epoch(name), seconds) if time is not None), float("nan"))
        return Frame.of_clouds(name, measured, *found, time=known, problems=problems)

    return records.Listing(tuple(names), load, labelled=entries if path.is_dir() else ())


def _files(path: Path) -> list[Path]:
    clouds = (file for file in path.iterdir() if file.suffix.lower() in records.ENDINGS and file.name not in POSES)
    return sorted(file for file in clouds if not file.name.startswith("."))


def _match(clouds: Mapping[str, list[Path]]) -> dict[str, dict[str, Path]]:
    """Files of each frame by sensor."""
    by_stem: dict[str, dict[str, Path]] = {}
    for sensor, files in clouds.items():
        for file in files:
            by_stem.setdefault(file.stem.removesuffix(".pcd"), {})[sensor] = file
    apart = len(clouds) > 1 and all(len(files) == 1 for files in by_stem.values())
    if apart and len({len(files) for files in clouds.values()}) == 1:
        first = next(iter(clouds.values()))
        return {file.stem: {s: files[k] for s, files in clouds.items()} for k, file in enumerate(first)}
    return dict(sorted(by_stem.items()))


def _written_times(entries: Mapping[str, records.Unchecked]) -> dict[str, tuple[float | None, dict[str, float]]]:
    """Time of each frame of labels.json and of its clouds by sensor. Times that are all the same are none."""
    times = {}
    for name, content in entries.items():
        clouds = content.get("clouds") or {}
        stamps = {str(sensor): records.finite_time(stamp, f"clouds.{sensor}") for sensor, stamp in clouds.items()}
        known = {sensor: stamp for sensor, stamp in stamps.items() if stamp is not None}
        times[name] = records.finite_time(content.get("time"), "time"), known
    count = Counter(seconds for seconds, _ in times.values())
    if len(count) == 1 < len(times):
        return {name: (None, stamps) for name, (_, stamps) in times.items()}
    return times


def _pose(placed: Mapping[str, Pose], sensor: str, stem: str) -> Pose:
    for key in (f"{sensor}/{stem}", stem, sensor):
        if key in placed:
            return placed[key]
    if list(placed) == ["0"]:
        return placed["0"]  # the one pose of a file without names
    if placed:
        raise ValueError(f"there is no pose of {sensor}/{stem}: the pose file has {', '.join(list(placed)[:8])}")
    return np.eye(4)


def write_folder(samples: Iterable[Frame], path: Path) -> None:
    """Write frames as SENSOR/000000.pcd and on, with labels.json and poses. Poses are lines of poses.txt, or poses.json
    where a sensor's name would not stay one word there."""
    entries, poses = [], dict[str, list[float]]()
    for k, sample in enumerate(samples):
        name = f"{k:06d}"
        for cloud in sample.clouds:
            records.write_cloud(path / cloud.name / f"{name}.pcd", cloud.in_own_frame())
            poses[f"{cloud.name}/{name}"] = cloud.world_SE3_sensor[:3].ravel().tolist()
        stamps = {cloud.name: cloud.stamp_s for cloud in sample.clouds if cloud.stamp_s is not None}
        entry = records.boxes_record(name, sample.time, sample.objects, counts=sample.counts, stamps_s=stamps)
        entries.append(entry)
    if entries:
        records.write_boxes(path / LABELS_FILE, entries)
        if all(map(_ONE_WORD.fullmatch, poses)):
            lines = (f"{name} {' '.join(f'{value:.17g}' for value in pose)}\n" for name, pose in poses.items())
            write_text(path / "poses.txt", "".join(lines))
        else:
            write_text(path / "poses.json", json.dumps(poses))
