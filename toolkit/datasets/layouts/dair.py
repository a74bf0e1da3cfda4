"""DAIR-V2X (I, V, C) and V2X-Seq: velodyne/*.pcd, calib/, label/.

The cooperative part has two sides and labels in the world.

World frame: the lidar's for one side; the infrastructure's **virtual lidar** for the cooperative
part. Its x-y plane is level with the ground, and the clouds of velodyne/ are in it already.

- Numbers are often strings ("3d_location": {"x": "12.3", ...}), and translations are columns, [[x],
  [y], [z]].
- 3d_location is the centre of the box, 3d_dimensions has h, w and l, rotation is the yaw about z.
- Rotations of calib/ are not orthonormal: they are made so here.
- Labels of the cooperative part are in the (virtual) world, tens of kilometres from its origin, in
  label_world of DAIR-V2X, and in the vehicle's lidar in label of V2X-Seq.
- system_error_offset (delta_x, delta_y) of a pair, in V2X-Seq relative_error of the calibration, is
  to be added to the infrastructure's place in that world; a missing offset is left out or an empty
  string.
- Infrastructure and vehicle of a pair measured up to tens of milliseconds apart:
  pointcloud_timestamp of each side's data_info.json, microseconds since 1970, has the times.
- label/camera, used if there are no other labels, lacks objects that the camera does not show.
- CarIgnore and similar labels are no objects, Trafficcone and Barrowlist no classes here: they are
  counted."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import partial
from os.path import lexists
from pathlib import Path, PureWindowsPath

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import (
    box_frames,
    cloud_records,
    folders,
    frame_labels,
    frame_times,
    listing,
    problem_kinds,
    record_values,
)
from toolkit.datasets.clock_times import parse_microseconds
from toolkit.datasets.origins import Middles, near_frames
from toolkit.datasets.record_values import as_number, entry, name_damage
from toolkit.frame import Everywhere, Frame, ImageWedge, Region
from toolkit.geometry import invert
from toolkit.runtime.writing import write_text

_LABELS = "label/virtuallidar", "label/lidar", "label/camera"
_IMAGE_PX = 1920, 1080  # width and height
NO_PARTNER = "pairs whose clouds are not there, left out"
UNPLACED_LIDAR = "calibrations that say where the lidar is in the map and cannot be read"
NO_CAMERA = "labels of a camera without its calibration: what it does not show counts as empty"
WORLD_LABELS = "label_world"
_COOPERATIVE = f"cooperative/{WORLD_LABELS}", "cooperative/label"
_MAX_OFFSET_M = 1000.0  # correction of the position of the infrastructure


def dair(path: Path) -> listing.Listing:
    """Open the folder of one side or of the cooperative part as a recording.

    Frames are read on demand. Raises FileNotFoundError for any other folder."""
    for root in (path, path / "cooperative-vehicle-infrastructure"):
        if (root / "cooperative").is_dir() and (root / "infrastructure-side").is_dir():
            return _open_pairs(root)
    names = tuple(file.stem for file in folders.list_files(path / "velodyne", "*.pcd"))
    if not names:
        raise FileNotFoundError(
            f"{path} is no DAIR-V2X folder: it has neither velodyne/*.pcd nor infrastructure-side/"
        )
    labelled = _list_labels(path, _LABELS)
    stamps = _read_stamps(path)
    # If points are far from their sensor's origin, coordinates of all clouds count from the middle
    # of the folder's first cloud.
    middles = Middles({"lidar": path / "velodyne" / f"{names[0]}.pcd"})
    load = partial(_load_side, path, stamps, middles, bool(labelled))
    return listing.Listing(names, load, labelled=labelled)


def _load_side(
    path: Path, stamps: Mapping[str, float], middles: Middles, is_labelled: bool, name: str
) -> Frame:
    """Load a frame of one side. path: the side's folder; stamps: times of its clouds by name (s).

    is_labelled: True if the folder has any labels, so that a frame without them counts as a
    problem."""
    problems: problem_kinds.Problems = {}
    cloud_file = path / "velodyne" / f"{name}.pcd"
    cloud = cloud_records.read_cloud(
        cloud_file, "lidar", np.eye(4), problems, stamp_s=stamps.get(name), middles=middles
    )
    label_file = _find_labels(path, _LABELS, name)
    is_unlabelled = is_labelled and label_file is None
    problem_kinds.add_problem(problems, problem_kinds.UNLABELLED, int(is_unlabelled))
    labels = read_annotations(label_file, np.eye(4), problems)
    complete: Region = Everywhere()
    # nobody labelled what the camera does not show
    if label_file is not None and label_file.parent.name == "camera":
        complete = _read_camera(path / "calib", name, problems)
    map_SE3_lidar = _read_place(path / "calib", name, problems)
    return Frame.of_clouds(
        name,
        (cloud,),
        *labels,  # objects, categories, counts, others
        time=frame_times.frame_time([cloud]),
        complete=complete,
        map_SE3_world=map_SE3_lidar,
        problems=problems,
    )


def _read_place(folder: Path, name: str, problems: problem_kinds.Problems) -> Pose:
    """Read map_SE3_lidar of one frame, from calib/virtuallidar_to_world or the vehicle's novatel.

    It is the identity without these files, and, counted in problems, if they cannot be read.
    folder: calib; name: name of the frame."""
    # from an outer frame to an inner one; the first list whose files are there counts
    for transform_kinds in (("virtuallidar_to_world",), ("novatel_to_world", "lidar_to_novatel")):
        files = [folder / kind / f"{name}.json" for kind in transform_kinds]
        if not all(lexists(file) for file in files):
            continue
        map_SE3_lidar = np.eye(4)
        try:
            for file in files:
                map_SE3_lidar = map_SE3_lidar @ read_transform(file)
        except (ValueError, OSError):
            problem_kinds.add_problem(problems, UNPLACED_LIDAR, 1)
            return np.eye(4)
        return map_SE3_lidar
    return np.eye(4)


def _read_stamps(side: Path) -> dict[str, float]:
    """Times of a side's clouds by name (s), if its data_info.json gives one.

    side: folder of the vehicle's or the infrastructure's part of the dataset."""
    index = side / "data_info.json"
    if not lexists(index):  # a broken link is damage, not absence
        return {}
    stamps = {}
    with name_damage(index, "list of clouds"):
        for row in record_values.as_list(record_values.load_json(index)):
            cloud_path = str(row.get("pointcloud_path") or row.get("frame_id") or "")
            name = PureWindowsPath(cloud_path).stem
            stamp_us = row.get("pointcloud_timestamp")
            time_us = frame_times.finite_time(stamp_us, "pointcloud_timestamp")
            if time_us is not None:
                stamps[name] = parse_microseconds(time_us)
    return stamps


def _read_camera(folder: Path, name: str, problems: problem_kinds.Problems) -> Region:
    """Region that the camera shows, from its calibration and its pose in the lidar's frame.

    Without these it is everywhere, and counted in `problems`. folder: calib; name: name of the
    frame."""
    intrinsic = folder / "camera_intrinsic" / f"{name}.json"
    extrinsic = folder / "virtuallidar_to_camera" / f"{name}.json"
    if not (lexists(intrinsic) and lexists(extrinsic)):
        problem_kinds.add_problem(problems, NO_CAMERA, 1)
        return Everywhere()
    with name_damage(intrinsic, "calibration"):
        values = entry(record_values.load_json(intrinsic), "cam_K")
        camera_matrix = record_values.numbers(values, 9, "cam_K").reshape(3, 3)
    camera_SE3_lidar = read_transform(extrinsic)
    width, height = _IMAGE_PX
    return ImageWedge(camera_matrix @ camera_SE3_lidar[:3], width=width, height=height)


def _list_labels(root: Path, label_folders: tuple[str, ...]) -> list[str]:
    """Names of all label files of some folders, without their ending."""
    files: list[Path] = []
    for folder in label_folders:
        files += folders.list_files(root / folder, "*.json")
    return [file.stem for file in files]


def _find_labels(root: Path, label_folders: tuple[str, ...], name: str) -> Path | None:
    """Return the label file of a frame from the first folder that has one, else None."""
    files = (root / folder / f"{name}.json" for folder in label_folders)
    return next((file for file in files if lexists(file)), None)


def _open_pairs(root: Path) -> listing.Listing:
    """Open the cooperative part: a frame for each pair of clouds of both sides.

    root: folder with cooperative/, infrastructure-side/ and vehicle-side/."""
    index = root / "cooperative" / "data_info.json"
    road = root / "infrastructure-side"
    car = root / "vehicle-side"
    with name_damage(index, "list of pairs"):
        all_rows = record_values.as_list(record_values.load_json(index))
        # if no pair has its clouds, all pairs, so that reading explains it
        rows_with_clouds = [row for row in all_rows if _has_clouds(row, road, car)] or all_rows
        pairs = _name_pairs(rows_with_clouds)
        # labels go by the name of the vehicle's cloud
        vehicle_names = [_find_cloud_name(row, "vehicle") for row in all_rows]
    labelled = _list_labels(root, _COOPERATIVE)
    stamps = (_read_stamps(road), _read_stamps(car))
    return listing.Listing(
        tuple(pairs),
        load=partial(_load_pair, root, pairs, stamps, bool(labelled)),
        labelled=labelled,
        known=vehicle_names,
        noted={NO_PARTNER: len(all_rows) - len(rows_with_clouds)},
    )


def _load_pair(
    root: Path,
    pairs: Mapping[str, record_values.Unchecked],
    stamps: tuple[Mapping[str, float], Mapping[str, float]],
    is_labelled: bool,
    name: str,
) -> Frame:
    """Load a frame of both sides, in the infrastructure's frame.

    pairs: rows of data_info.json by name; stamps: times (s) by name of the infrastructure's and the
    vehicle's clouds; is_labelled: True if there are any labels."""
    problems: problem_kinds.Problems = {}
    with name_damage(root / "cooperative" / "data_info.json", "list of pairs"):
        pair = pairs[name]
        vehicle = _find_cloud_name(pair, "vehicle")
        offset = _parse_offset(pair.get("system_error_offset"))
        pole = _find_cloud_name(pair, "infrastructure")
    road = root / "infrastructure-side"
    car = root / "vehicle-side"
    road_stamps, car_stamps = stamps
    map_SE3_road = read_transform(road / "calib" / "virtuallidar_to_world" / f"{pole}.json", offset)
    novatel_SE3_lidar = read_transform(car / "calib" / "lidar_to_novatel" / f"{vehicle}.json")
    map_SE3_novatel = read_transform(car / "calib" / "novatel_to_world" / f"{vehicle}.json")
    road_SE3_car = invert(map_SE3_road) @ map_SE3_novatel @ novatel_SE3_lidar
    pole_file = road / "velodyne" / f"{pole}.pcd"
    vehicle_file = car / "velodyne" / f"{vehicle}.pcd"
    road_cloud = cloud_records.read_cloud(
        pole_file, "infrastructure", np.eye(4), problems, stamp_s=road_stamps.get(pole)
    )
    car_cloud = cloud_records.read_cloud(
        vehicle_file, "vehicle", road_SE3_car, problems, stamp_s=car_stamps.get(vehicle)
    )
    label_file = _find_labels(root, _COOPERATIVE, vehicle)
    is_unlabelled = is_labelled and label_file is None
    problem_kinds.add_problem(problems, problem_kinds.UNLABELLED, int(is_unlabelled))
    is_in_map = label_file is None or label_file.parent.name == WORLD_LABELS
    road_SE3_labels = invert(map_SE3_road) if is_in_map else road_SE3_car
    labels = read_annotations(label_file, road_SE3_labels, problems)
    return Frame.of_clouds(
        name,
        (road_cloud, car_cloud),
        *labels,  # objects, categories, counts, others
        time=frame_times.frame_time([road_cloud]),
        map_SE3_world=map_SE3_road,
        problems=problems,
    )


def _name_pairs(rows: list[record_values.Unchecked]) -> dict[str, record_values.Unchecked]:
    """Rows of pairs by name: the infrastructure's frame, with the vehicle's if it has several."""
    count = Counter(_find_cloud_name(row, "infrastructure") for row in rows)
    pairs = {}
    for row in rows:
        pole = _find_cloud_name(row, "infrastructure")
        name = pole if count[pole] == 1 else f"{pole}-{_find_cloud_name(row, 'vehicle')}"
        pairs[name] = row
    return pairs


def _has_clouds(pair: record_values.Unchecked, road: Path, car: Path) -> bool:
    """True if the clouds of both sides of a pair are there."""
    road_cloud = road / "velodyne" / f"{_find_cloud_name(pair, 'infrastructure')}.pcd"
    car_cloud = car / "velodyne" / f"{_find_cloud_name(pair, 'vehicle')}.pcd"
    return lexists(road_cloud) and lexists(car_cloud)


def _find_cloud_name(pair: record_values.Unchecked, side: str) -> str:
    """Name of the cloud of one side, "infrastructure" or "vehicle", without folder and ending."""
    key = f"{side}_pointcloud_path"
    path = pair[key] if key in pair else entry(pair, f"{side}_frame")
    return PureWindowsPath(str(path)).stem


def read_transform(path: str | Path, offset: tuple[float, float] | None = None) -> Pose:
    """Read the pose of a calibration file, its rotation made a true one.

    offset: m, added to x and y; None for the file's relative_error, if it has one."""
    with name_damage(path, "calibration"):
        content = record_values.load_json(path)
        transform_entry = content.get("transform", content)
        pose = record_values.rigid(
            entry(transform_entry, "rotation"), entry(transform_entry, "translation")
        )
        x_and_y = pose[:2, 3]  # a view: adding to it moves the pose
        x_and_y += offset or _parse_offset(content.get("relative_error")) or (0.0, 0.0)
    return pose


def _parse_offset(value: record_values.Unchecked) -> tuple[float, float] | None:
    """Parse a correction of x and y (m), delta_x and delta_y; None if it is missing or empty.

    Raises ValueError for a correction that is too large."""
    if not value or (isinstance(value, dict) and value.get("delta_x") in ("", None)):
        return None
    delta_x = as_number(entry(value, "delta_x"), "delta_x")
    delta_y = as_number(entry(value, "delta_y"), "delta_y")
    if not np.abs([delta_x, delta_y]).max() <= _MAX_OFFSET_M:
        raise ValueError(
            f"delta_x and delta_y must be numbers within {_MAX_OFFSET_M:g} m of 0, got "
            f"{(delta_x, delta_y)}"
        )
    return delta_x, delta_y


def read_annotations(
    path: Path | None, world_SE3_labels: Pose, problems: problem_kinds.Problems
) -> frame_labels.FrameLabels:
    """Read the objects of a label file, turned into the world frame.

    path: None for no labels; world_SE3_labels: pose of the file's frame in the world; problems:
    counts of labels left out are added to it."""
    with name_damage(path or "", "list of labels"):
        labels = [] if path is None else record_values.as_list(record_values.load_json(path))
        centres = []
        sizes = []
        for label in labels:
            centres.append(record_values.xyz(label, "3d_location"))
            sizes.append(record_values.xyz(label, "3d_dimensions", axes="lwh"))
        yaws = [as_number(entry(label, "rotation"), "rotation") for label in labels]
        categories = [str(entry(label, "type")) for label in labels]
        ids = [label.get("track_id", label.get("id", k)) for k, label in enumerate(labels)]
    boxes = np.column_stack(
        [np.array(centres).reshape(-1, 3), np.array(sizes).reshape(-1, 3), yaws]
    )
    frame_labels.count_full_turns(np.array(yaws), problems)
    return frame_labels.make_labels(
        box_frames.move_boxes(world_SE3_labels, boxes),
        categories=categories,
        ids=ids,
        problems=problems,
    )


def written_labels(sample: Frame) -> list[dict[str, object]]:
    """Return a frame's objects as the rows of a label file, in the world frame."""
    rows: list[dict[str, object]] = []
    for box, name, track in frame_labels.list_rows(sample.objects, frame_labels.COMMON_NAMES):
        centre, size = box[:3], box[3:6]
        yaw = box[6]
        row = {
            "type": name,
            "track_id": str(track),
            "3d_dimensions": dict(zip("lwh", size, strict=True)),
            "3d_location": dict(zip("xyz", centre, strict=True)),
            "rotation": yaw,
        }
        rows.append(row)
    return rows


def write_dair(samples: Iterable[Frame], folder: Path) -> None:
    """Write samples as one infrastructure side, with one cloud each, in the world frame.

    The world's origin is moved near the sensors, and the calibration says by how much."""
    index = []
    for number, sample in enumerate(near_frames(samples)):
        name = f"{number:06d}"
        cloud = cloud_records.one_cloud(sample)
        cloud_records.write_cloud(folder / "velodyne" / f"{name}.pcd", cloud)
        # NaN if the time is unknown
        seconds = frame_times.cloud_time(cloud, sample.time)
        if np.isfinite(seconds):
            microseconds = str(round(seconds * 1e6))
            index.append(
                {"pointcloud_path": f"velodyne/{name}.pcd", "pointcloud_timestamp": microseconds}
            )
        write_text(
            folder / "label" / "virtuallidar" / f"{name}.json",
            json.dumps(written_labels(sample), indent=1),
        )
        calib = {
            "rotation": sample.map_SE3_world[:3, :3].tolist(),
            "translation": sample.map_SE3_world[:3, 3:].tolist(),  # a column
            "relative_error": {"delta_x": "", "delta_y": ""},
        }
        write_text(folder / "calib" / "virtuallidar_to_world" / f"{name}.json", json.dumps(calib))
    if index:
        write_text(folder / "data_info.json", json.dumps(index, indent=1))
