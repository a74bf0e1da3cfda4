"""ASAM OpenLABEL 1.0.0, and its variant of TUM Traffic (A9): JSON files of frames.

Clouds are in the folder of the files or below. World frame: the root of the coordinate systems of
the first cloud's sensor, z roughly up. In a file without poses of sensors it is the lidar's, as in
TUM Traffic. An object seen by two lidars has a label in each lidar's file: they are different
frames here, not doubled labels."""

import json
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import (
    cloud_records,
    folders,
    frame_labels,
    frame_times,
    listing,
    record_values,
)
from toolkit.datasets.clock_times import find_epoch, parse_time
from toolkit.datasets.layouts.openlabel_boxes import CuboidRows
from toolkit.datasets.layouts.openlabel_clouds import CloudFiles, find_sensors
from toolkit.datasets.layouts.openlabel_systems import (
    NO_POSE,
    UNREADABLE_POSE,
    Systems,
    parse_systems,
)
from toolkit.datasets.origins import Middles
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.datasets.record_values import Unchecked, entry, name_damage
from toolkit.frame import Frame
from toolkit.objects import LABELS, Detections, Objects
from toolkit.runtime.writing import write_text

WORLD = "world"  # name of the root system that is written
NO_FRAME = "boxes that name no coordinate system, taken in the root of the sensors'"
UNPLACED_SENSOR = (
    "clouds whose sensor is none of the file's coordinate systems, taken in their root"
)
UNCONNECTED_SENSOR = (
    "clouds whose coordinate system nothing connects with the first cloud's, taken in its root"
)
NOT_OPENLABEL = "JSON files without openlabel"
OPENLABEL_NAMES = {
    "vehicle": "CAR",
    "cyclist": "BICYCLE",
    "pedestrian": "PEDESTRIAN",
    "heavy": "TRUCK",
}


def openlabel(path: Path) -> listing.Listing:
    """Open one label file, or all below a folder. Raises FileNotFoundError without any."""
    files = [path] if path.is_file() else folders.list_files(path, "*.json", recursive=True)
    if not files:
        raise FileNotFoundError(f"{path} holds no OpenLABEL files (*.json)")
    root = path.parent if path.is_file() else path
    clouds: dict[str, list[Path]] = {}
    for file in folders.list_files(root, recursive=True):
        if file.suffix.lower() in folders.ENDINGS:
            clouds.setdefault(file.name, []).append(file)
    frames: dict[str, tuple[Path, str]] = {}
    cloud_names: list[str] = []
    first_clouds: dict[str, Path] = {}
    other_count = 0
    for file in files:
        with name_damage(file, "OpenLABEL file"):
            document = record_values.load_json(file)
            if len(files) > 1 and not (isinstance(document, dict) and "openlabel" in document):
                other_count += 1
                continue
            content = entry(document, "openlabel")
            described_frames = _list_frames(content)
            stem = file.relative_to(root).with_suffix("").as_posix()
            keys_by_name = {
                stem if len(described_frames) == 1 else f"{stem}#{key}": key
                for key in described_frames
            }
            for name, key in keys_by_name.items():
                sensors = find_sensors(
                    file, content, frame=described_frames[key], clouds=clouds, problems={}
                )
                cloud_names += [name] * bool(sensors)
                first_clouds = sensors | first_clouds
        frames |= {name: (file, key) for name, key in keys_by_name.items()}
    if not frames:
        raise ValueError(
            f"{path} holds no OpenLABEL files, but {other_count} other *.json, such as "
            f"{files[0].name}"
        )
    load = partial(_read_frame, frames, clouds, Middles(first_clouds))
    return listing.Listing(
        tuple(frames), load, labelled=frames, known=cloud_names, noted={NOT_OPENLABEL: other_count}
    )


def _list_frames(content: Unchecked) -> dict[str, Unchecked]:
    """Return the frames of a file by key, in the order of their numbers.

    A file of objects without frames, whose cuboids always hold, is one frame. content: what the
    file holds under "openlabel"."""
    if "frames" not in content and content.get("objects"):
        return {"0": {}}
    # wrapped again, so that the error for a missing entry names openlabel.frames
    frames = dict(entry({"openlabel": content}, "openlabel", "frames"))
    return {key: frames[key] for key in sorted(frames, key=folders.natural_order)}


def _read_frame(
    frames: dict[str, tuple[Path, str]], clouds: CloudFiles, middles: Middles, name: str
) -> Frame:
    """Read the frame of a name.

    frames: label file and key in the file of each frame by name; clouds: cloud files by name."""
    problems: Problems = {}
    file, key = frames[name]
    with name_damage(file, "OpenLABEL file"):
        content = entry(record_values.load_json(file), "openlabel")
        frame = _list_frames(content)[key]
        properties = frame.get("frame_properties") or {}
        seconds = parse_time(properties.get("timestamp"), "timestamp")
        sensors = find_sensors(file, content, frame, clouds, problems)
        stamps = {
            sensor: _find_stamp(properties, sensor, cloud) for sensor, cloud in sensors.items()
        }
        if list(stamps.values()) == [None]:
            stamps = dict.fromkeys(stamps, seconds)
        systems = parse_systems(content, frame)
        root, poses = _place_sensors(systems, list(sensors), problems)
        rows = CuboidRows.parse(content, frame, key, systems, root, problems)
        are_moved = any(not np.array_equal(pose, np.eye(4)) for pose in poses.values())
        if are_moved:
            add_problem(problems, NO_FRAME, rows.unnamed)
        if sensors:
            add_problem(problems, NO_POSE, len(systems.unplaced))
        add_problem(problems, UNREADABLE_POSE, len(systems.unreadable))
    labels = frame_labels.make_labels(
        rows.boxes, categories=rows.kinds, ids=rows.ids, problems=problems, counts=rows.counts
    )
    measured_clouds = [
        cloud_records.read_cloud(
            cloud, sensor, poses[sensor], problems, stamp_s=stamps[sensor], middles=middles
        )
        for sensor, cloud in sensors.items()
    ]
    frame_time = frame_times.frame_time(measured_clouds) if seconds is None else seconds
    return Frame.of_clouds(name, measured_clouds, *labels, time=frame_time, problems=problems)


def _find_stamp(properties: Unchecked, stream: str, file: Path) -> float | None:
    """Return the time (s) of a stream's cloud, by the frame or the file's name, None if unknown.

    properties: frame_properties of the frame; stream: name of the sensor; file: its cloud."""
    stream_entry = (properties.get("streams") or {}).get(stream) or {}
    sync = (stream_entry.get("stream_properties") or {}).get("sync") or {}
    stated_time = parse_time(sync.get("timestamp"), f"timestamp of {stream}")
    return find_epoch(file.stem) if stated_time is None else stated_time


def _place_sensors(
    systems: Systems, sensors: list[str], problems: Problems
) -> tuple[str | None, dict[str, Pose]]:
    """Find the root coordinate system of a frame's clouds, and the pose of each sensor in it.

    The root is the last in the chain of parents of the first sensor, None if the file does not
    place the sensors. Sensors that nothing connects with it get the pose in their root. They are
    counted in `problems`, which is changed in place.

    systems: coordinate systems of the frame; sensors: names of the sensors with a cloud."""
    # for each sensor that is a coordinate system: its root, and its pose in the root
    root_and_pose = {
        sensor: systems.find_root(sensor) for sensor in sensors if sensor in systems.known
    }
    roots = [root for root, _ in root_and_pose.values()]
    if not roots:
        file_roots = systems.list_roots()
        roots = list(file_roots) if len(file_roots) == 1 else []
    root = roots[0] if roots else None
    poses = {}
    for sensor in sensors:
        sensor_root, root_SE3_sensor = root_and_pose.get(sensor, (None, np.eye(4)))
        if systems.known and sensor_root is None:
            add_problem(problems, UNPLACED_SENSOR, 1)
        elif sensor_root != root:
            add_problem(problems, UNCONNECTED_SENSOR, 1)
        poses[sensor] = root_SE3_sensor
    return root, poses


def write_openlabel(samples: Iterable[Frame], folder: Path) -> None:
    """Write frames as label files and clouds. Every sensor's cloud is in its sensor's frame."""
    for number, sample in enumerate(samples):
        name = f"{number:06d}"
        content = openlabel_content(sample)  # the objects; sensors and clouds are added below
        document = content["openlabel"]
        systems = document["coordinate_systems"]
        properties = document["frames"]["0"]["frame_properties"]
        for cloud in sample.clouds:
            file = f"{name}_{cloud.name}.pcd"
            cloud_records.write_cloud(
                folder / "point_clouds" / cloud.name / file, cloud.in_own_frame()
            )
            systems[cloud.name] = {
                "type": "sensor_cs",
                "parent": WORLD,
                "children": [],
                "pose_wrt_parent": {"matrix4x4": cloud.world_SE3_sensor.ravel().tolist()},
            }
            systems[WORLD]["children"].append(cloud.name)
            stream: Unchecked = {"type": "lidar", "uri": f"../point_clouds/{cloud.name}/{file}"}
            if cloud.stamp_s is not None:
                stream["stream_properties"] = {"sync": {"timestamp": cloud.stamp_s}}
            properties["point_cloud_file_names"].append(file)
            properties["streams"][cloud.name] = stream
        write_text(folder / "labels_point_clouds" / f"{name}.json", json.dumps(content, indent=1))


def cuboid_values(box: np.ndarray) -> list[float]:
    """Return a box as OpenLABEL's ten numbers: centre, quaternion x y z w, sizes."""
    half = float(box[6]) / 2
    quaternion = [0.0, 0.0, float(np.sin(half)), float(np.cos(half))]
    return [*box[:3].tolist(), *quaternion, *box[3:6].tolist()]


def openlabel_content(sample: Frame, found: Detections | None = None) -> Unchecked:
    """Return a frame's objects as one OpenLABEL document.

    found: detections instead of the objects, with scores as attributes."""
    written: Objects | Detections = sample.objects if found is None else found
    ids = sample.objects.ids if found is None else np.arange(len(found))
    described = {}
    objects = {}
    for k, (box, label) in enumerate(zip(written.boxes, written.labels, strict=True)):
        numbers = []
        if found is not None:
            numbers.append({"name": "score", "val": float(found.scores[k])})
        elif sample.counts is not None:
            numbers.append({"name": "num_points", "val": int(sample.counts[k])})
        kind = OPENLABEL_NAMES[LABELS[label]]
        cuboid = {
            "name": "shape3D",
            "coordinate_system": WORLD,
            "val": cuboid_values(box),
            "attributes": {"num": numbers},
        }
        track = str(ids[k])
        described[track] = {"name": f"{kind}_{track}", "type": kind}
        objects[track] = {"object_data": {"cuboid": [cuboid]}}
    properties: Unchecked = {"point_cloud_file_names": [], "streams": {}}
    properties |= {"timestamp": sample.time} if np.isfinite(sample.time) else {}
    systems = {WORLD: {"type": "scene_cs", "parent": "", "children": []}}
    content = {
        "metadata": {"schema_version": "1.0.0"},
        "coordinate_systems": systems,
        "objects": described,
    }
    content |= {"frame_intervals": [{"frame_start": 0, "frame_end": 0}]}
    content |= {"frames": {"0": {"frame_properties": properties, "objects": objects}}}
    return {"openlabel": content}
