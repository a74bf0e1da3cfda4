"""ASAM OpenLABEL, as the TUM Traffic (A9) sets write it: one JSON file per cloud; *.pcd lies beside or below it.

World frame: that of the cuboids, which in TUM Traffic is the lidar's own, z roughly up. Clouds are placed by the file's
coordinate systems if these give a sensor's pose.

- A cuboid's `val` is x y z, then the quaternion **x y z w**, then length, width, height; x y z is the centre. The
  standard also has 9 numbers, with Euler angles about x, y and z in place of the quaternion.
- `cuboid` is one object in TUM Traffic and a list in the standard.
- The class is object_data.type in TUM Traffic and `type` of the object itself in the standard, whose `objects` at the
  top say it for all frames.
- num_points among the attributes is the set's own count, -1 if nobody counted.
- An object seen by two lidars has a label in each lidar's file: they are different frames here, not doubled labels."""

import json
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np

from toolkit.datasets import records
from toolkit.datasets.clock_times import find_epoch, parse_time
from toolkit.datasets.cloud_files import quaternion_pose
from toolkit.datasets.records import as_number, entry, named_damage, numbers
from toolkit.frame import Frame
from toolkit.geometry import pose
from toolkit.objects import LABELS, Detections, Objects
from toolkit.runtime.files import write_text

_NAMES = {"vehicle": "CAR", "cyclist": "BICYCLE", "pedestrian": "PEDESTRIAN", "heavy": "TRUCK"}


def openlabel(path: Path) -> records.Listing:
    """Frames of one label file, or of all below a folder. Raises FileNotFoundError if there are none."""
    files = [path] if path.is_file() else sorted(path.rglob("*.json"))
    if not files:
        raise FileNotFoundError(f"{path} holds no OpenLABEL files (*.json)")
    root = path.parent if path.is_file() else path
    clouds = {file.name: file for file in sorted(root.rglob("*")) if file.suffix.lower() in records.ENDINGS}
    frames: dict[str, tuple[Path, str]] = {}
    known: list[str] = []
    for file in files:
        with named_damage(file, "OpenLABEL file"):
            some = entry(records.load_json(file), "openlabel", "frames")
            stem = file.relative_to(root).with_suffix("").as_posix()
            named = {stem if len(some) == 1 else f"{stem}#{key}": key for key in some}
            known += [name for name, key in named.items() if _clouds(file, some[key], clouds)]
        frames |= {name: (file, key) for name, key in named.items()}
    load = partial(_sample, frames, clouds)
    return records.Listing(tuple(frames), load, labelled=frames, known=known)


def _clouds(file: Path, frame: records.Unchecked, clouds: dict[str, Path]) -> list[Path]:
    """Files of a frame's clouds, by the names it gives them or by its own file's."""
    names = frame.get("frame_properties", {}).get("point_cloud_file_names")
    names = [Path(str(each)).name for each in names or [f"{file.stem}{ending}" for ending in records.ENDINGS]]
    return [clouds[name] for name in names if name in clouds]


def _sample(frames: dict[str, tuple[Path, str]], clouds: dict[str, Path], name: str) -> Frame:
    problems: records.Problems = {}
    file, key = frames[name]
    with named_damage(file, "OpenLABEL file"):
        content = entry(records.load_json(file), "openlabel")
        frame = entry(content, "frames", key)
        properties = frame.get("frame_properties", {})
        seconds = parse_time(properties.get("timestamp"), "timestamp")
        files = _clouds(file, frame, clouds)
        # a cloud's sensor is the stream that the frame names in its place, else the cloud's folder
        streams = list(properties.get("streams", {}))
        sensors = [streams[k] if k < len(streams) else each.parent.name for k, each in enumerate(files)]
        stamps = [_stamp(properties, sensor, each) for sensor, each in zip(sensors, files, strict=True)]
        if len(files) == 1 and stamps[0] is None:
            stamps = [seconds]
        poses = [_pose(content, sensor) for sensor in sensors]
        boxes, kinds, ids, counts = [], [], [], []
        for track, each in frame.get("objects", {}).items():
            kind = entry(content, "objects", track, "type") if "type" not in entry(each, "object_data") else None
            cuboids = each["object_data"].get("cuboid", [])
            for cuboid in cuboids if isinstance(cuboids, list) else [cuboids]:
                boxes.append(_box(cuboid["val"]))
                kinds.append(str(kind or each["object_data"]["type"]))
                ids.append(track)
                nums = [num for num in cuboid.get("attributes", {}).get("num", []) if num.get("name") == "num_points"]
                counts.append(int(as_number(nums[0]["val"], "num_points")) if nums else -1)
    found = records.labelled(np.array(boxes).reshape(-1, 7), kinds, ids, problems, counts)
    clouds = []
    for each, sensor, where, stamp in zip(files, sensors, poses, stamps, strict=True):
        clouds.append(records.read_cloud(each, sensor, where, problems, stamp_s=stamp))
    known = records.frame_time(clouds) if seconds is None else seconds
    return Frame.of_clouds(name, clouds, *found, time=known, problems=problems)


def _stamp(properties: records.Unchecked, stream: str, file: Path) -> float | None:
    """Time of a stream's cloud (s), as the frame or the file's name states it."""
    described = properties.get("streams", {}).get(stream) or {}
    sync = (described.get("stream_properties") or {}).get("sync") or {}
    stated = parse_time(sync.get("timestamp"), f"timestamp of {stream}")
    return find_epoch(file.stem) if stated is None else stated


def _pose(content: records.Unchecked, sensor: str) -> np.ndarray:
    """Pose of a sensor, if the coordinate systems name it."""
    system = content.get("coordinate_systems", {}).get(sensor, {})
    if not system.get("pose_wrt_parent"):
        return np.eye(4)
    return records.rigid_matrix(entry(system, "pose_wrt_parent", "matrix4x4"), f"pose of {sensor}")


def _box(value: records.Unchecked) -> np.ndarray:
    if np.size(np.array(value, dtype=object)) == 9:
        x, y, z, roll, pitch, yaw, *sizes = numbers(value, 9, "cuboid val")
        turned = pose(roll=roll, pitch=pitch, yaw=yaw)
    else:
        x, y, z, qx, qy, qz, qw, *sizes = numbers(value, 10, "cuboid val")
        finite = np.isfinite([qx, qy, qz, qw]).all()
        turned = quaternion_pose(np.array([qw, qx, qy, qz]), np.zeros(3)) if finite else np.full((4, 4), np.nan)
    return np.array([x, y, z, *sizes, np.arctan2(turned[1, 0], turned[0, 0])])


def write_openlabel(samples: Iterable[Frame], folder: Path) -> None:
    """Write frames as label files and clouds. Every sensor's cloud is in its own frame."""
    for number, sample in enumerate(samples):
        name = f"{number:06d}"
        content = openlabel_content(sample)
        frame, systems = content["openlabel"]["frames"]["0"], content["openlabel"]["coordinate_systems"]
        for cloud in sample.clouds:
            place = f"{name}_{cloud.name}.pcd"
            records.write_cloud(folder / "point_clouds" / cloud.name / place, cloud.in_own_frame())
            placed = {"pose_wrt_parent": {"matrix4x4": cloud.world_SE3_sensor.ravel().tolist()}}
            systems[cloud.name] = {"type": "sensor", "parent": "world", "children": [], **placed}
            systems["world"]["children"].append(cloud.name)
            frame["frame_properties"]["point_cloud_file_names"].append(place)
            sync = {} if cloud.stamp_s is None else {"stream_properties": {"sync": {"timestamp": cloud.stamp_s}}}
            frame["frame_properties"]["streams"][cloud.name] = sync
        write_text(folder / "labels_point_clouds" / f"{name}.json", json.dumps(content, indent=1))


def openlabel_content(sample: Frame, found: Detections | None = None) -> records.Unchecked:
    """Return a frame's objects, or the detections `found` with scores as attributes, as one OpenLABEL document."""
    shown: Objects | Detections = sample.objects if found is None else found
    ids = sample.objects.ids if found is None else np.arange(len(found))
    objects = {}
    for k, (box, label) in enumerate(zip(shown.boxes, shown.labels, strict=True)):
        if found is not None:
            nums = [{"name": "score", "val": float(found.scores[k])}]
        else:
            nums = [] if sample.counts is None else [{"name": "num_points", "val": int(sample.counts[k])}]
        kind, half = _NAMES[LABELS[label]], box[6] / 2
        value = [*box[:3].tolist(), 0.0, 0.0, float(np.sin(half)), float(np.cos(half)), *box[3:6].tolist()]
        cuboid = {"name": "shape3D", "val": value, "attributes": {"num": nums}}
        objects[str(ids[k])] = {"object_data": {"name": f"{kind}_{ids[k]}", "type": kind, "cuboid": cuboid}}
    properties: records.Unchecked = {"point_cloud_file_names": [], "streams": {}}
    properties |= {"timestamp": sample.time} if np.isfinite(sample.time) else {}
    world = {"type": "scene_cs", "parent": "", "children": [], "pose_wrt_parent": {}}
    content = {"metadata": {"schema_version": "1.0.0"}, "coordinate_systems": {"world": world}}
    return {"openlabel": content | {"frames": {"0": {"frame_properties": properties, "objects": objects}}}}
