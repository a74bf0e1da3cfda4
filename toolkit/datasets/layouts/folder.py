"""Plain folders of clouds: SENSOR/NAME.pcd or NAME.pcd.

There may be poses.json (or .txt) and labels.json. World frame: the poses', world_SE3_sensor;
without a pose file the clouds are assumed to be in it already.

- Clouds are any of .pcd .bin .ply .npy .npz .feather .xyz .csv .las .laz
  (`toolkit.datasets.cloud_files`).
- Sensors' files of one time are one frame if all names are times (`toolkit.datasets.clock_times`),
  else files of one name. If names are no times, no two sensors share one and all have equally many
  files, the k-th files of each are one frame, in the order of their names, 2 before 10. A frame
  that lacks a sensor, or goes by order, is counted in its problems.
- A pose goes by the name of the sensor, or of SENSOR/NAME or NAME if it moves.
- labels.json is of `toolkit.datasets.box_files`, by the names of the frames' first clouds, or other
  clouds.
- A name that is a number of seconds, milli-, micro- or nanoseconds since 1970 gives the time.
  Otherwise labels.json has it, whose `clouds` has the times of the sensors' clouds."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import (
    box_files,
    cloud_records,
    folders,
    frame_labels,
    listing,
    problem_kinds,
    record_values,
)
from toolkit.datasets.clock_times import (
    BY_ORDER,
    UNPAIRED,
    find_epoch,
    group_by_time,
    parse_epoch,
    parse_time,
)
from toolkit.datasets.origins import Middles
from toolkit.datasets.pose_files import read_poses
from toolkit.frame import Frame
from toolkit.runtime.writing import write_text

POSES = ("poses.json", "poses.txt", "poses.csv")
LABELS_FILE = "labels.json"
OTHER_NAME = "labels by the name of a second cloud of a labelled frame"
RECORDED = (
    "*.hdf5",
    "*.h5",
    "*.bag",
    "*.mcap",
    "*.db3",
    "*.pcap",
    "*.pcapng",
)  # recordings in single files
_CONVERT = "convert them to .pcd, .ply, .npy or .csv"
SCANS = {  # files of points that are not read, and what to do with them
    (".e57", ".pts", ".ptx", ".obj", ".stl", ".drc"): _CONVERT,
    (".txt",): "call them .xyz or .csv",
}
MAX_START_BYTES = 4096  # at a text's start, which distinguish points from words
ALONE = "lidar"  # sensor of clouds directly in the folder
_ONE_WORD = re.compile(r"[\w.-]+/\d+")  # SENSOR/NAME in a line of poses.txt
_THREE_NUMBERS = re.compile(
    r"(?m)^\s*(?:[-+]?[\d.]+(?:e[-+]?\d+)?[\s,;]+){2}[-+]?[\d.]+", re.IGNORECASE
)


def folder(path: Path, *, poses: Path | None = None, inverted: bool = False) -> listing.Listing:
    """Open a folder of clouds, or one cloud file.

    poses: a file of poses, None for the one in the folder; inverted: it gives world → sensor.
    Raises FileNotFoundError if there are no clouds."""
    all_clouds = _find_clouds(path)
    clouds = {
        sensor: _drop_doubled(files) if len(files) > 1 else files
        for sensor, files in all_clouds.items()
    }
    doubled_count = sum(len(files) - len(clouds[sensor]) for sensor, files in all_clouds.items())
    names, by_order = _group_files(clouds)
    if not names:
        raise FileNotFoundError(
            f"{path} holds no clouds, neither NAME.pcd nor SENSOR/NAME.pcd: {_find_remedy(path)}"
        )
    base = path.parent if path.is_file() else path
    pose_file = poses or next((base / name for name in POSES if lexists(base / name)), None)
    poses_by_name = {} if pose_file is None else read_poses(pose_file, inverted=inverted)
    if poses:
        _check_names(poses, poses_by_name, names)
    middles = Middles({sensor: files[0] for sensor, files in clouds.items()})
    labels = base / LABELS_FILE
    entries = box_files.read_entries(labels) if lexists(labels) else {}
    with record_values.name_damage(labels, "file of boxes"):
        times = _parse_times(entries)
    load = _Loader(
        names=names,
        sensors=len(clouds),
        by_order=by_order,
        poses=poses_by_name,
        labels=labels,
        entries=entries,
        times=times,
        middles=middles,
    )
    return listing.Listing(
        tuple(names),
        load,
        labelled=entries if path.is_dir() else (),
        known=[_stem(file) for files in names.values() for file in files.values()],
        noted={problem_kinds.DOUBLED_CLOUDS: doubled_count},
    )


def _find_clouds(path: Path) -> dict[str, list[Path]]:
    """Cloud files of each sensor, which is a folder in `path`; clouds in `path` are of one sensor.

    path: a folder, or a single cloud file."""
    if path.is_file():
        return {ALONE: [path]}
    if not path.is_dir():
        raise FileNotFoundError(f"no such folder or cloud file: {path}")
    clouds = {ALONE: _list_cloud_files(path)}
    for subfolder in folders.list_files(path):
        if subfolder.is_dir():
            clouds[subfolder.name] = _list_cloud_files(subfolder)
    return {sensor: files for sensor, files in clouds.items() if files}


def _check_names(
    poses: Path, poses_by_name: Mapping[str, Pose], names: Mapping[str, Mapping[str, Path]]
) -> None:
    """Raise ValueError if no pose of a file has the name of a sensor or cloud.

    poses: the file of poses; names: cloud file of each sensor in each frame."""
    sensors = set()
    pose_names = set()
    for files in names.values():
        for sensor, file in files.items():
            sensors.add(sensor)
            pose_names |= {sensor, file.stem, f"{sensor}/{file.stem}"}
    if not poses_by_name.keys() & pose_names:
        raise ValueError(
            f"{poses} has poses {', '.join(poses_by_name)}, but the sensors are "
            f"{', '.join(sorted(sensors))}"
        )


@dataclass(frozen=True)
class _Loader:
    """Reader of a folder's frames by name.

    Attributes:
        names: cloud file of each sensor in each frame.
        sensors: number of sensors of the folder.
        by_order: True if clouds were put together by their order.
        poses: poses by name.
        labels: the file of labels.
        entries: labels by the names of frames.
        times: times (s) of frames and of their clouds, from the labels.
        middles: middles of the sensors' first clouds.
    """

    names: Mapping[str, Mapping[str, Path]]
    sensors: int
    by_order: bool
    poses: Mapping[str, Pose]
    labels: Path
    entries: Mapping[str, record_values.Unchecked]
    times: Mapping[str, tuple[float | None, dict[str, float]]]
    middles: Middles

    def __call__(self, name: str) -> Frame:
        """Read the frame of a name: its clouds, and the labels under the name of a cloud."""
        # a cloud's file by the name of its sensor
        files = self.names[name]
        problems = problem_kinds.Problems()
        # names of the frame's clouds that have labels
        label_names = [stem for stem in map(_stem, files.values()) if stem in self.entries]
        problem_kinds.add_problem(problems, UNPAIRED, int(len(files) < self.sensors))
        problem_kinds.add_problem(problems, BY_ORDER, int(self.by_order))
        problem_kinds.add_problem(problems, OTHER_NAME, max(0, len(set(label_names)) - 1))
        is_unlabelled = bool(self.entries) and not label_names
        problem_kinds.add_problem(problems, problem_kinds.UNLABELLED, int(is_unlabelled))
        label_name = label_names[0] if label_names else name
        stated_time, stated_stamps = self.times.get(label_name, (None, {}))
        clouds = []
        for sensor, file in files.items():
            # a file name that is a time counts most
            cloud_epoch_s = find_epoch(_stem(file))
            cloud = cloud_records.read_cloud(
                file,
                sensor,
                _find_pose(self.poses, sensor, _stem(file)),
                problems,
                stamp_s=stated_stamps.get(sensor) if cloud_epoch_s is None else cloud_epoch_s,
                middles=self.middles,
            )
            clouds.append(cloud)
        labels = frame_labels.no_labels()
        if label_name in self.entries:
            labels = box_files.parse_objects(self.labels, self.entries[label_name], problems)
        frame_epoch_s = find_epoch(name)
        time = stated_time if frame_epoch_s is None else frame_epoch_s
        frame_time = float("nan") if time is None else time
        # labels: objects, categories, counts, others
        return Frame.of_clouds(name, clouds, *labels, time=frame_time, problems=problems)


def _find_remedy(path: Path) -> str:
    """Words on what to do with a folder without clouds, judging by its content."""
    # files of recordings, and folders that are a ROS 2 bag
    recordings = sorted(entry for pattern in RECORDED for entry in path.glob(pattern))
    recordings += [entry.parent for entry in sorted(path.glob("*/metadata.yaml"))]
    if recordings:
        hint = f" or another of its {len(recordings)}" if len(recordings) > 1 else ""
        return f"give the recording in it, {recordings[0]}{hint}"
    files = sorted(file for file in (*path.glob("*"), *path.glob("*/*")) if file.is_file())
    files = [file for file in files if file.name not in POSES]
    for endings, remedy in SCANS.items():
        scans = [file for file in files if file.suffix.lower() in endings]
        if not scans:
            continue
        first = scans[0]
        if first.suffix.lower() != ".txt" or _holds_rows(first):  # other texts are no scans
            count = f"{len(scans)} of " if len(scans) > 1 else ""
            return f"it holds {count}{first.suffix}, such as {first.relative_to(path)}: {remedy}"
    kinds = Counter(file.suffix.lower() or file.name for file in files)
    content = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(4)) or "no files"
    return f"it holds {content}: give --layout, or another folder"


def _holds_rows(file: Path) -> bool:
    """True for a text whose first lines have three numbers."""
    start = file.read_bytes()[:MAX_START_BYTES].decode("utf-8", "replace")
    return _THREE_NUMBERS.search(start) is not None


def _list_cloud_files(path: Path) -> list[Path]:
    """Files of clouds in a folder, by their endings, without the file of poses."""
    files = folders.list_files(path)
    return [
        file for file in files if file.suffix.lower() in folders.ENDINGS and file.name not in POSES
    ]


def _drop_doubled(files: list[Path]) -> list[Path]:
    """Keep one file of each name, with the ending that comes first in `ENDINGS`.

    The result is in the natural order of names."""
    by_stem: dict[str, Path] = {}
    for file in sorted(files, key=lambda file: folders.ENDINGS.index(file.suffix.lower())):
        by_stem.setdefault(_stem(file), file)
    return [by_stem[stem] for stem in sorted(by_stem, key=folders.natural_order)]


def _stem(file: Path) -> str:
    """Name of a cloud file without its ending, and without both parts of .pcd.bin."""
    return file.stem.removesuffix(".pcd")


def _group_files(clouds: Mapping[str, list[Path]]) -> tuple[dict[str, dict[str, Path]], bool]:
    """Files of each frame by sensor, by the frame's name; and True if their order grouped them.

    Files of one time are a frame if all names are times, else files of one name, or, if no two
    sensors share a name, files of one place in the order. clouds: files of each sensor in order."""
    files_by_stem: dict[str, dict[str, Path]] = {}
    for sensor, files in clouds.items():
        for file in files:
            files_by_stem.setdefault(_stem(file), {})[sensor] = file
    if len(clouds) < 2:
        return _sort_frames(files_by_stem), False
    if all(find_epoch(stem) is not None for stem in files_by_stem):
        return _group_by_names_time(clouds), False
    share_no_name = all(len(files) == 1 for files in files_by_stem.values())
    have_one_length = len({len(files) for files in clouds.values()}) == 1
    if share_no_name and have_one_length:
        first_sensor_files = next(iter(clouds.values()))
        frames = {}
        for k, file in enumerate(first_sensor_files):
            frames[_stem(file)] = {sensor: files[k] for sensor, files in clouds.items()}
        return frames, True
    return _sort_frames(files_by_stem), False


def _sort_frames(by_stem: Mapping[str, dict[str, Path]]) -> dict[str, dict[str, Path]]:
    """Return the files of each frame with the frames in the natural order of their names.

    by_stem: files by sensor, by name of the frame."""
    return {stem: by_stem[stem] for stem in sorted(by_stem, key=folders.natural_order)}


def _group_by_names_time(clouds: Mapping[str, list[Path]]) -> dict[str, dict[str, Path]]:
    """Group files by the times that are their names: the files of each frame by sensor.

    A frame has the name of its first file. clouds: files of each sensor."""
    times = {}
    for sensor, files in clouds.items():
        times[sensor] = np.array([parse_epoch(_stem(file)) for file in files])
    frames: dict[str, dict[str, Path]] = {}
    for group in group_by_time(times):
        files_of_frame = {sensor: clouds[sensor][row] for sensor, row in group.items()}
        sensor, file = next(iter(files_of_frame.items()))
        name = _stem(file)
        # two sensors may have a file of one name in different frames
        frames[name if name not in frames else f"{sensor}/{name}"] = files_of_frame
    return frames


def _parse_times(
    entries: Mapping[str, record_values.Unchecked],
) -> dict[str, tuple[float | None, dict[str, float]]]:
    """Times (s) in labels.json by frame: the frame's, and its clouds' by sensor.

    entries: entry of each frame in the file. Times of frames that are all the same are None, as
    they state nothing."""
    times = {}
    for name, content in entries.items():
        cloud_times = {}
        for sensor, stamp in (content.get("clouds") or {}).items():
            cloud_time = parse_time(stamp, f"clouds.{sensor}")
            if cloud_time is not None:
                cloud_times[str(sensor)] = cloud_time
        times[name] = parse_time(content.get("time"), "time"), cloud_times
    frame_times = {frame_time for frame_time, _ in times.values()}
    if len(frame_times) == 1 < len(times):
        return {name: (None, cloud_times) for name, (_, cloud_times) in times.items()}
    return times


def _find_pose(poses_by_name: Mapping[str, Pose], sensor: str, stem: str) -> Pose:
    """Pose of a cloud: by sensor and name, else by name, else by sensor; identity without poses.

    stem: name of the cloud's file without ending. Raises ValueError if no pose fits."""
    for key in (f"{sensor}/{stem}", stem, sensor):
        if key in poses_by_name:
            return poses_by_name[key]
    if list(poses_by_name) == ["0"]:
        return poses_by_name["0"]  # the one pose of a file without names
    if poses_by_name:
        raise ValueError(
            f"there is no pose of {sensor}/{stem}: the pose file has "
            f"{', '.join(list(poses_by_name)[:8])}"
        )
    return np.eye(4)


def write_folder(samples: Iterable[Frame], path: Path) -> None:
    """Write frames as SENSOR/000000.pcd and on, with labels.json and poses.

    Poses are lines of poses.txt, or poses.json if the name of a sensor would not be one word
    there."""
    entries = []
    # by SENSOR/NAME: upper 3 x 4 part of world_SE3_sensor, row by row
    poses = dict[str, list[float]]()
    for k, sample in enumerate(samples):
        name = f"{k:06d}"
        for cloud in sample.clouds:
            cloud_records.write_cloud(path / cloud.name / f"{name}.pcd", cloud.in_own_frame())
            poses[f"{cloud.name}/{name}"] = cloud.world_SE3_sensor[:3].ravel().tolist()
        stamps = {cloud.name: cloud.stamp_s for cloud in sample.clouds if cloud.stamp_s is not None}
        entry = box_files.boxes_record(
            name, sample.time, sample.objects, counts=sample.counts, stamps_s=stamps
        )
        entries.append(entry)
    if entries:
        box_files.write_boxes(path / LABELS_FILE, entries)
        if all(map(_ONE_WORD.fullmatch, poses)):
            lines = []
            for name, pose in poses.items():
                numbers = " ".join(f"{value:.17g}" for value in pose)
                lines.append(f"{name} {numbers}\n")
            write_text(path / "poses.txt", "".join(lines))
        else:
            write_text(path / "poses.json", json.dumps(poses))
