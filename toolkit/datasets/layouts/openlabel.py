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
            described = _frames(content)
            stem = file.relative_to(root).with_suffix("").as_posix()
            keys_by_name = {
                stem if len(described) == 1 else f"{stem}#{key}": key for key in described
            }
            for name, key in keys_by_name.items():
                sensors = find_sensors(file, content, described[key], clouds, {})
                cloud_names += [name] * bool(sensors)
                first_clouds = sensors | first_clouds
        frames |= {name: (file, key) for name, key in keys_by_name.items()}
    if not frames:
        raise ValueError(
            f"{path} holds no OpenLABEL files, but {other_count} other *.json, such as "
            f"{files[0].name}"
        )
    load = partial(_sample, frames, clouds, Middles(first_clouds))
    return listing.Listing(
        tuple(frames), load, labelled=frames, known=cloud_names, noted={NOT_OPENLABEL: other_count}
    )


def _frames(content: Unchecked) -> dict[str, Unchecked]:
    """Return the frames of a file by key, in the order of their numbers.

    A file of objects without frames, whose cuboids always hold, is one frame."""
    if "frames" not in content and content.get("objects"):
        return {"0": {}}
    frames = dict(entry({"openlabel": content}, "openlabel", "frames"))
    return {key: frames[key] for key in sorted(frames, key=folders.natural_order)}


def _sample(
    frames: dict[str, tuple[Path, str]], clouds: CloudFiles, middles: Middles, name: str
) -> Frame:
    problems: Problems = {}
    file, key = frames[name]
    with name_damage(file, "OpenLABEL file"):
        content = entry(record_values.load_json(file), "openlabel")
        frame = _frames(content)[key]
        properties = frame.get("frame_properties") or {}
        seconds = parse_time(properties.get("timestamp"), "timestamp")
        sensors = find_sensors(file, content, frame, clouds, problems)
        stamps = {sensor: _stamp(properties, sensor, cloud) for sensor, cloud in sensors.items()}
        if list(stamps.values()) == [None]:
            stamps = dict.fromkeys(stamps, seconds)
        systems = parse_systems(content, frame)
        root, poses = _place_sensors(systems, list(sensors), problems)
        rows = CuboidRows.parse(content, frame, key, systems, root, problems)
        are_moved = any(not np.array_equal(in_root, np.eye(4)) for in_root in poses.values())
        add_problem(problems, NO_FRAME, rows.unnamed * are_moved)
        add_problem(problems, NO_POSE, len(systems.unplaced) * bool(sensors))
        add_problem(problems, UNREADABLE_POSE, len(systems.unreadable))
    labels = frame_labels.make_labels(rows.boxes, rows.kinds, rows.ids, problems, rows.counts)
    measured = []
    for sensor, cloud in sensors.items():
        stamp = stamps[sensor]
        pose = poses[sensor]
        measured.append(
            cloud_records.read_cloud(cloud, sensor, pose, problems, stamp_s=stamp, middles=middles)
        )
    frame_time = frame_times.frame_time(measured) if seconds is None else seconds
    return Frame.of_clouds(name, measured, *labels, time=frame_time, problems=problems)


def _stamp(properties: Unchecked, stream: str, file: Path) -> float | None:
    """Return the time (s) of a stream's cloud, by the frame or the file's name, None if unknown.

    properties: frame_properties of the frame; stream: name of the sensor; file: its cloud."""
    described = (properties.get("streams") or {}).get(stream) or {}
    sync = (described.get("stream_properties") or {}).get("sync") or {}
    stated = parse_time(sync.get("timestamp"), f"timestamp of {stream}")
    return find_epoch(file.stem) if stated is None else stated


def _place_sensors(
    systems: Systems, sensors: list[str], problems: Problems
) -> tuple[str | None, dict[str, Pose]]:
    """Find the root system of a frame's clouds, and the pose of each sensor in it.

    The root is the last in the chain of parents of the first sensor, None if the file does not
    place the sensors. Sensors that nothing connects with it get the pose in their
    root, and are counted in problems."""
    places = {sensor: systems.find_root(sensor) for sensor in sensors if sensor in systems.known}
    roots = [root for root, _ in places.values()]
    if not roots:
        of_file = systems.list_roots()
        roots = list(of_file) if len(of_file) == 1 else []
    root = roots[0] if roots else None
    poses = {}
    for sensor in sensors:
        sensor_root, in_root = places.get(sensor, (None, np.eye(4)))
        if systems.known and sensor_root is None:
            add_problem(problems, UNPLACED_SENSOR, 1)
        elif sensor_root != root:
            add_problem(problems, UNCONNECTED_SENSOR, 1)
        poses[sensor] = in_root
    return root, poses


def write_openlabel(samples: Iterable[Frame], folder: Path) -> None:
    """Write frames as label files and clouds. Every sensor's cloud is in its sensor's frame."""
    for number, sample in enumerate(samples):
        name = f"{number:06d}"
        content = openlabel_content(sample)
        document = content["openlabel"]
        systems = document["coordinate_systems"]
        properties = document["frames"]["0"]["frame_properties"]
        for cloud in sample.clouds:
            file = f"{name}_{cloud.name}.pcd"
            cloud_records.write_cloud(
                folder / "point_clouds" / cloud.name / file, cloud.in_own_frame()
            )
            pose_content = {
                "pose_wrt_parent": {"matrix4x4": cloud.world_SE3_sensor.ravel().tolist()}
            }
            systems[cloud.name] = {
                "type": "sensor_cs",
                "parent": WORLD,
                "children": [],
                **pose_content,
            }
            systems[WORLD]["children"].append(cloud.name)
            sync = (
                {}
                if cloud.stamp_s is None
                else {"stream_properties": {"sync": {"timestamp": cloud.stamp_s}}}
            )
            stream = {"type": "lidar", "uri": f"../point_clouds/{cloud.name}/{file}", **sync}
            properties["point_cloud_file_names"].append(file)
            properties["streams"][cloud.name] = stream
        write_text(folder / "labels_point_clouds" / f"{name}.json", json.dumps(content, indent=1))


def openlabel_content(sample: Frame, found: Detections | None = None) -> Unchecked:
    """Return a frame's objects as one OpenLABEL document.

    found: detections instead of the objects, with scores as attributes."""
    written: Objects | Detections = sample.objects if found is None else found
    ids = sample.objects.ids if found is None else np.arange(len(found))
    described = {}
    objects = {}
    for k, (box, label) in enumerate(zip(written.boxes, written.labels, strict=True)):
        nums = []
        if found is not None:
            nums.append({"name": "score", "val": float(found.scores[k])})
        elif sample.counts is not None:
            nums.append({"name": "num_points", "val": int(sample.counts[k])})
        kind = OPENLABEL_NAMES[LABELS[label]]
        half = box[6] / 2
        quaternion = [0.0, 0.0, float(np.sin(half)), float(np.cos(half))]
        value = box[:3].tolist() + quaternion + box[3:6].tolist()
        cuboid = {
            "name": "shape3D",
            "coordinate_system": WORLD,
            "val": value,
            "attributes": {"num": nums},
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
