"""ASAM OpenLABEL 1.0.0, and its variant of TUM Traffic (A9): JSON files of frames.

Clouds are in the folder of the files or below. World frame: the root of the coordinate systems of
the first cloud's sensor, z roughly up. In a file without poses of sensors it is the lidar's, as in
TUM Traffic.

- A cuboid's `val` is x y z, then the quaternion **x y z w** of any length, then length, width,
  height; x y z is the centre. With 9 numbers it has Euler angles about x, y and z, turned in the
  order ZYX, in place of the quaternion.
- A cuboid, or its object, may name its `coordinate_system`; without one it is in the world's.
- pose_wrt_parent places a system in its parent: matrix4x4 by rows, quaternion x y z w and
  translation, or euler_angles in their `sequence` (ZYX) and translation. A frame's `transforms`
  replace it: X_dst = transform_src_to_dst X_src.
- `cuboid` is a list, in TUM Traffic a single object. The class is `type` of the object at the top,
  or, in TUM Traffic, of object_data. Objects at the top may have cuboids too, which hold in their
  frame_intervals.
- A frame's clouds are point_cloud_file_names (TUM Traffic), the `uri` of its streams, or files
  named as the labels. A cloud's sensor is the stream with its uri, else the one in the name of its
  folder or file.
- num_points among the attributes is the data set's count, -1 if nobody counted.
- An object seen by two lidars has a label in each lidar's file: they are different frames here, not
  doubled labels."""

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Pose
from toolkit.datasets import records
from toolkit.datasets.clock_times import find_epoch, parse_time
from toolkit.datasets.origins import Middles
from toolkit.datasets.records import (
    Problems,
    Unchecked,
    add_problem,
    as_number,
    entry,
    named_damage,
    numbers,
)
from toolkit.frame import Frame
from toolkit.geometry import invert, pose, transform
from toolkit.objects import LABELS, Detections, Objects
from toolkit.runtime.files import write_text

WORLD = "world"  # name of the root system that is written
MAX_SYSTEMS_DEEP = 64  # in a chain of coordinate systems; longer ones run in a circle
NO_FRAME = "boxes that name no coordinate system, taken in the root of the sensors'"
UNKNOWN_FRAME = "boxes in a coordinate system that nothing connects with the clouds'"
UNPLACED_SENSOR = (
    "clouds whose sensor is none of the file's coordinate systems, taken in their root"
)
UNCONNECTED_SENSOR = (
    "clouds whose coordinate system nothing connects with the first cloud's, taken in its root"
)
NO_POSE = "coordinate systems without a pose in their parent, taken as being at its origin"
UNREADABLE_POSE = "coordinate systems that hold nothing here, whose poses cannot be read"
OTHER_SHAPES = "objects of other shapes than cuboids"
NO_CLOUD = "clouds that a frame names and that are not there"
NOT_OPENLABEL = "JSON files without openlabel"
ONLY_SENSOR = "clouds whose sensor nothing tells, taken as the file's only one"
STREAM_BY_ORDER = "clouds whose stream only its place in the list tells"
_NAMES = {"vehicle": "CAR", "cyclist": "BICYCLE", "pedestrian": "PEDESTRIAN", "heavy": "TRUCK"}
_SHAPES = (
    "bbox",
    "rbbox",
    "mesh",
    "poly2d",
    "poly3d",
    "mat",
    "binary",
    "point2d",
    "point3d",
    "area_reference",
)
_OTHER_STREAMS = ("camera", "radar", "gps_imu", "other")

_Clouds = Mapping[str, Sequence[Path]]  # cloud files below a folder by name


def openlabel(path: Path) -> records.Listing:
    """Frames of one label file, or of all below a folder. Raises FileNotFoundError without any."""
    files = [path] if path.is_file() else records.list_files(path, "*.json", recursive=True)
    if not files:
        raise FileNotFoundError(f"{path} holds no OpenLABEL files (*.json)")
    root = path.parent if path.is_file() else path
    clouds: dict[str, list[Path]] = {}
    for file in records.list_files(root, recursive=True):
        if file.suffix.lower() in records.ENDINGS:
            clouds.setdefault(file.name, []).append(file)
    frames: dict[str, tuple[Path, str]] = {}
    cloud_names: list[str] = []
    first_clouds: dict[str, Path] = {}
    other_count = 0
    for file in files:
        with named_damage(file, "OpenLABEL file"):
            document = records.load_json(file)
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
                sensors = _find_sensors(file, content, described[key], clouds, {})
                cloud_names += [name] * bool(sensors)
                first_clouds = sensors | first_clouds
        frames |= {name: (file, key) for name, key in keys_by_name.items()}
    if not frames:
        raise ValueError(
            f"{path} holds no OpenLABEL files, but {other_count} other *.json, such as "
            f"{files[0].name}"
        )
    load = partial(_sample, frames, clouds, Middles(first_clouds))
    return records.Listing(
        tuple(frames), load, labelled=frames, known=cloud_names, noted={NOT_OPENLABEL: other_count}
    )


def _frames(content: Unchecked) -> dict[str, Unchecked]:
    """Frames by key in the order of their numbers.

    A file of objects without frames, whose cuboids always hold, is one frame."""
    if "frames" not in content and content.get("objects"):
        return {"0": {}}
    frames = dict(entry({"openlabel": content}, "openlabel", "frames"))
    return {key: frames[key] for key in sorted(frames, key=records.natural_order)}


def _streams(content: Unchecked, frame: Unchecked) -> dict[str, Unchecked]:
    """Streams that may be lidars, as the file and the frame describe them together."""
    of_frame = (frame.get("frame_properties") or {}).get("streams") or {}
    of_file = content.get("streams") or {}
    together = {}
    for name in [*of_frame, *(name for name in of_file if name not in of_frame)]:
        together[name] = {**(of_file.get(name) or {}), **(of_frame.get(name) or {})}
    return {
        name: stream
        for name, stream in together.items()
        if stream.get("type") not in _OTHER_STREAMS
    }


def _find_sensors(
    file: Path, content: Unchecked, frame: Unchecked, clouds: _Clouds, problems: Problems
) -> dict[str, Path]:
    """Cloud file of each sensor of a frame."""
    of_streams = _find_stream_clouds(file, content, frame, clouds)
    files = _find_clouds(file, frame, of_streams, clouds, problems)
    return _name_sensors(content, frame, files, of_streams, problems)


def _find_clouds(
    file: Path,
    frame: Unchecked,
    of_streams: Mapping[Path, str],
    clouds: _Clouds,
    problems: Problems,
) -> list[Path]:
    """Files of a frame's clouds: as the frame names them, by its streams, else by its file's
    name."""
    listed = [
        str(name)
        for name in (frame.get("frame_properties") or {}).get("point_cloud_file_names") or ()
    ]
    if listed:
        matches = [_find_cloud(name, file, clouds) for name in listed]
        present = list(dict.fromkeys(cloud for cloud in matches if cloud is not None))
        add_problem(problems, NO_CLOUD, matches.count(None) if present else 0)
        return present
    if of_streams:
        return list(of_streams)
    candidates = [
        cloud for ending in records.ENDINGS for cloud in clouds.get(f"{file.stem}{ending}", ())
    ]
    of_folder = [cloud for cloud in candidates if cloud.parent.name == file.parent.name]
    return of_folder[:1] or candidates


def _find_stream_clouds(
    file: Path, content: Unchecked, frame: Unchecked, clouds: _Clouds
) -> dict[Path, str]:
    """Streams by the cloud files that their uri names."""
    streams: dict[Path, str] = {}
    for name, stream in _streams(content, frame).items():
        cloud = _find_cloud(str(stream.get("uri") or ""), file, clouds)
        if cloud is not None:
            streams.setdefault(cloud, name)
    return streams


def _find_cloud(location: str, labels: Path, clouds: _Clouds) -> Path | None:
    """File that a label file names; of several with one name, the one with most folders in
    common."""
    candidates = clouds.get(PurePosixPath(location).name) or clouds.get(
        PureWindowsPath(location).name, ()
    )
    return max(candidates, key=lambda cloud: _common_tail(cloud, location, labels), default=None)


def _common_tail(cloud: Path, location: str, labels: Path) -> tuple[int, bool]:
    """Fit of a file to the location in a label file: path components in common, and the folder's
    name."""
    pairs = zip(reversed(cloud.parts), reversed(PureWindowsPath(location).parts), strict=False)
    common = 0
    for name, stated_name in pairs:
        if name != stated_name:
            break
        common += 1
    return common, cloud.parent.name == labels.parent.name


def _name_sensors(
    content: Unchecked,
    frame: Unchecked,
    files: Sequence[Path],
    of_streams: Mapping[Path, str],
    problems: Problems,
) -> dict[str, Path]:
    """Cloud of each sensor, named by a stream or coordinate system.

    The stream is the one with this file, or the one in the name of the file or its folder."""
    streams = _streams(content, frame)
    systems = content.get("coordinate_systems") or {}
    sensors: dict[str, Path] = {}
    for index, file in enumerate(files):
        names_in_stem = [name for name in (*streams, *systems) if name in file.stem]
        if file in of_streams:
            name = of_streams[file]
        elif file.parent.name in streams or file.parent.name in systems:
            name = file.parent.name
        elif names_in_stem:
            name = max(names_in_stem, key=len)
        elif index < len(streams):
            name = list(streams)[index]
            add_problem(problems, STREAM_BY_ORDER, 1)
        elif len(files) == 1 and len(single := _list_sensors(systems)) == 1:
            (name,) = single
            add_problem(problems, ONLY_SENSOR, 1)
        else:
            name = file.parent.name
        sensors[name if name not in sensors else file.stem] = file
    return sensors


def _list_sensors(systems: Mapping[str, Unchecked]) -> list[str]:
    """Names of the coordinate systems that are sensors by their type, else that are nobody's
    parent."""
    of_type = [
        name for name, system in systems.items() if "sensor" in str(system.get("type")).lower()
    ]
    parents = {system.get("parent") for system in systems.values()}
    return of_type or [
        name for name, system in systems.items() if system.get("parent") and name not in parents
    ]


@dataclass(frozen=True)
class _Systems:
    """Coordinate systems of one frame.

    Attributes:
        parents: parent of each system that has one, and the system's pose in it.
        known: names of all systems.
        unplaced: systems whose pose in their parent nothing states.
        unreadable: systems whose pose cannot be read, and why; it matters only to what is in
            them."""

    parents: dict[str, tuple[str, Pose]]
    known: frozenset[str]
    unplaced: frozenset[str] = field(default_factory=frozenset)
    unreadable: dict[str, str] = field(default_factory=dict)

    def find_root(self, name: str) -> tuple[str, Pose]:
        """Return the root of a system, and the system's pose in it."""
        root_SE3_system = np.eye(4)
        for _ in range(MAX_SYSTEMS_DEEP):
            if name in self.unreadable:
                raise ValueError(self.unreadable[name])
            if name not in self.parents:
                return name, root_SE3_system
            name, in_parent = self.parents[name]
            root_SE3_system = in_parent @ root_SE3_system
        raise ValueError(f"its coordinate systems run in a circle, through {name!r}")

    def list_roots(self) -> set[str]:
        """Return the roots of all systems that can be read."""
        roots = set()
        for name in self.known:
            with suppress(ValueError):
                roots.add(self.find_root(name)[0])
        return roots


def _parse_systems(content: Unchecked, frame: Unchecked) -> _Systems:
    parents: dict[str, tuple[str, Pose]] = {}
    unplaced = set()
    unreadable = dict[str, str]()
    systems = content.get("coordinate_systems") or {}
    for name, system in systems.items():
        parent = str(system.get("parent") or "")
        pose_content = system.get("pose_wrt_parent")
        if pose_content:
            try:
                parents[name] = parent, parse_transform(pose_content, f"pose of {name}")
            except ValueError as error:
                unreadable[name] = str(error)
        elif parent:
            parents[name] = parent, np.eye(4)
            unplaced.add(name)
    system_names = {*systems, *(parent for parent, _ in parents.values())}
    for title, link in ((frame.get("frame_properties") or {}).get("transforms") or {}).items():
        source = str(entry(link, "src"))
        target = str(entry(link, "dst"))
        system_names |= {source, target}
        try:
            dst_SE3_src = parse_transform(_find_transform(link), f"transform {title}")
        except ValueError as error:
            unreadable[source] = str(error)
            continue
        if parents.get(target, ("",))[0] == source or (
            source in parents and parents[source][0] != target
        ):
            parents[target] = source, invert(dst_SE3_src)
            unplaced.discard(target)
            unreadable.pop(target, None)
        else:
            parents[source] = target, dst_SE3_src
            unplaced.discard(source)
            unreadable.pop(source, None)
    return _Systems(parents, frozenset(system_names), frozenset(unplaced), unreadable)


def _find_transform(transform: Unchecked) -> Unchecked:
    """Data of a frame's transform; VCD 4.3 has a matrix under another name."""
    older = transform.get("transform_src_to_dst_4x4")
    return entry(transform, "transform_src_to_dst") if older is None else older


def parse_transform(value: Unchecked, name: str) -> Pose:
    """Parse OpenLABEL's transform data: a matrix, or a rotation and a translation.

    Raises ValueError for neither."""
    if isinstance(value, list):  # TUM Traffic, without a name
        return records.rigid_matrix(value, name)
    if "matrix4x4" in value:
        return records.rigid_matrix(value["matrix4x4"], name)
    if "quaternion" in value:
        rotation = turn_by_quaternion(numbers(value["quaternion"], 4, f"quaternion of {name}"))
    elif "euler_angles" in value:
        rotation = turn_by_angles(value, name)
    else:
        forms = "matrix4x4, quaternion and translation, or euler_angles and translation"
        raise ValueError(f"{name} must be {forms}, got {', '.join(value)[:60]}")
    translation = numbers(entry(value, "translation"), 3, f"translation of {name}")
    return records.rigid(rotation, translation, name)


def turn_by_angles(value: Unchecked, name: str) -> Float64[np.ndarray, "3 3"]:
    """Rotation of euler_angles (rad) in the order of `sequence`, each about the axes turned so
    far."""
    from scipy.spatial.transform import Rotation

    angles = numbers(value["euler_angles"], 3, f"euler_angles of {name}")
    sequence = str(value.get("sequence") or "ZYX").upper()
    if len(sequence) != 3 or not set(sequence) <= set("XYZ") or not np.isfinite(angles).all():
        raise ValueError(
            f"{name} must turn by three finite angles about a sequence of X, Y and Z, got "
            f"{sequence!r:.40}"
        )
    if np.abs(angles).max() > records.FULL_TURN_RAD:
        raise ValueError(
            f"euler_angles of {name} must be radians, got {angles.tolist()}: give degrees times "
            "pi / 180"
        )
    return np.asarray(Rotation.from_euler(sequence, angles).as_matrix())


def turn_by_quaternion(xyzw: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "3 3"]:
    """Rotation of a quaternion of any length but 0, whose rotation is NaN."""
    from scipy.spatial.transform import Rotation

    norm = np.linalg.norm(xyzw)
    if not (np.isfinite(norm) and norm > 0):
        return np.full((3, 3), np.nan)
    return np.asarray(Rotation.from_quat(xyzw / norm).as_matrix())


def _sample(
    frames: dict[str, tuple[Path, str]], clouds: _Clouds, middles: Middles, name: str
) -> Frame:
    problems: Problems = {}
    file, key = frames[name]
    with named_damage(file, "OpenLABEL file"):
        content = entry(records.load_json(file), "openlabel")
        frame = _frames(content)[key]
        properties = frame.get("frame_properties") or {}
        seconds = parse_time(properties.get("timestamp"), "timestamp")
        sensors = _find_sensors(file, content, frame, clouds, problems)
        stamps = {sensor: _stamp(properties, sensor, cloud) for sensor, cloud in sensors.items()}
        if list(stamps.values()) == [None]:
            stamps = dict.fromkeys(stamps, seconds)
        systems = _parse_systems(content, frame)
        root, poses = _place_sensors(systems, list(sensors), problems)
        rows = _Rows.parse(content, frame, key, systems, root, problems)
        are_moved = any(not np.array_equal(in_root, np.eye(4)) for in_root in poses.values())
        add_problem(problems, NO_FRAME, rows.unnamed * are_moved)
        add_problem(problems, NO_POSE, len(systems.unplaced) * bool(sensors))
        add_problem(problems, UNREADABLE_POSE, len(systems.unreadable))
    labels = records.labelled(rows.boxes, rows.kinds, rows.ids, problems, rows.counts)
    measured = []
    for sensor, cloud in sensors.items():
        stamp = stamps[sensor]
        pose = poses[sensor]
        measured.append(
            records.read_cloud(cloud, sensor, pose, problems, stamp_s=stamp, middles=middles)
        )
    frame_time = records.frame_time(measured) if seconds is None else seconds
    return Frame.of_clouds(name, measured, *labels, time=frame_time, problems=problems)


def _stamp(properties: Unchecked, stream: str, file: Path) -> float | None:
    """Time of a stream's cloud (s), as the frame or the file's name states it."""
    described = (properties.get("streams") or {}).get(stream) or {}
    sync = (described.get("stream_properties") or {}).get("sync") or {}
    stated = parse_time(sync.get("timestamp"), f"timestamp of {stream}")
    return find_epoch(file.stem) if stated is None else stated


def _place_sensors(
    systems: _Systems, sensors: list[str], problems: Problems
) -> tuple[str | None, dict[str, Pose]]:
    """Root system of the clouds, and the sensors' poses in it.

    The root is None if the file does not place their sensors."""
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


@dataclass(frozen=True)
class _Rows:
    """Cuboids of one frame in the world frame.

    Attributes:
        boxes: the boxes.
        kinds: classes as the file names them.
        ids: ids of the objects.
        counts: the data set's counts of points.
        unnamed: number of cuboids that name no coordinate system.
    """

    boxes: BoxRows
    kinds: list[str]
    ids: list[str]
    counts: list[int]
    unnamed: int

    @staticmethod
    def parse(
        content: Unchecked,
        frame: Unchecked,
        key: str,
        systems: _Systems,
        root: str | None,
        problems: Problems,
    ) -> "_Rows":
        """Parse the cuboids that the frame has or that hold in it."""
        boxes = list[np.ndarray]()
        kinds = list[str]()
        ids = list[str]()
        counts = list[int]()
        turns: list[np.ndarray] = []
        names: list[str] = []  # coordinate system of each box
        poses: dict[str, Pose | None] = {}
        described = content.get("objects") or {}
        for track, data in _list_object_data(described, frame, key):
            cuboids = data.get("cuboid") or []
            add_problem(
                problems,
                OTHER_SHAPES,
                int(not cuboids and any(data.get(shape) for shape in _SHAPES)),
            )
            about = described.get(track) or {}
            for cuboid in cuboids if isinstance(cuboids, list) else [cuboids]:
                system = cuboid.get("coordinate_system") or data.get("coordinate_system")
                system = system or about.get("coordinate_system")
                name = str(system or "")
                if name not in poses:
                    poses[name] = _place_box(systems, name, root)
                if poses[name] is None:
                    add_problem(problems, UNKNOWN_FRAME, 1)
                    continue
                parsed = _parse_box(entry(cuboid, "val"))
                records.count_full_turns(parsed.angles, problems)
                boxes.append(parsed.box)
                turns.append(parsed.rotation)
                names.append(name)
                kinds.append(
                    str(data.get("type") or entry({"objects": described}, "objects", track, "type"))
                )
                ids.append(track)
                counts.append(_count(cuboid))
        table = np.array(boxes, np.float64).reshape(-1, 7)
        turned_boxes = np.array(turns, np.float64).reshape(-1, 3, 3)
        for name, in_root in poses.items():
            rows = np.flatnonzero(np.array(names, str) == name)
            if in_root is not None and len(rows):
                table[rows, :3] = transform(in_root, table[rows, :3])
                turned_boxes[rows] = in_root[:3, :3] @ turned_boxes[rows]
        table[:, 6] = records.find_headings(turned_boxes, problems)
        return _Rows(table, kinds, ids, counts, names.count(""))


def _list_object_data(
    described: Unchecked, frame: Unchecked, key: str
) -> Iterable[tuple[str, Unchecked]]:
    """Yield id and object_data of a frame's objects, then of valid objects at the top level."""
    for track, content in (frame.get("objects") or {}).items():
        about = content or {}
        inherited = {key: about[key] for key in ("coordinate_system", "type") if about.get(key)}
        yield track, inherited | (about.get("object_data") or {})
    for track, about in described.items():
        data = (about or {}).get("object_data") or {}
        intervals = about.get("frame_intervals") or [] if data else []
        limits = [
            (int(as_number(interval["frame_start"])), int(as_number(interval["frame_end"])))
            for interval in intervals
        ]
        if data and (not limits or any(first <= int(key) <= last for first, last in limits)):
            yield track, data


def _place_box(systems: _Systems, system: str, root: str | None) -> Pose | None:
    """Pose in the world frame of the system that a cuboid names, None if nothing connects them."""
    if not system or (root is None and system not in systems.known):
        return np.eye(4)
    system_root, in_root = systems.find_root(system)
    return in_root if system_root == root else None


def _count(cuboid: Unchecked) -> int:
    """The set's count of points in a cuboid, -1 without one."""
    for number in (cuboid.get("attributes") or {}).get("num") or ():
        if number.get("name") == "num_points":
            return int(as_number(entry(number, "val"), "num_points"))
    return -1


class _ParsedBox(NamedTuple):
    """Box of a cuboid without its yaw, its rotation, and any Euler angles (rad)."""

    box: Float64[np.ndarray, "7"]
    rotation: Float64[np.ndarray, "3 3"]
    angles: Float64[np.ndarray, " n"]


def _parse_box(value: Unchecked) -> _ParsedBox:
    """Parse the numbers of a cuboid."""
    angles = np.zeros(0)
    if np.size(np.array(value, dtype=object)) == 9:
        values = numbers(value, 9, "cuboid val")
        roll, pitch, yaw = values[3:6]
        angles = np.array([max(roll, pitch, yaw, key=abs)])
        rotation = pose(roll=roll, pitch=pitch, yaw=yaw)[:3, :3]
    else:
        values = numbers(value, 10, "cuboid val")
        rotation = turn_by_quaternion(np.array(values[3:7]))
    return _ParsedBox(np.array([*values[:3], *values[-3:], 0.0]), rotation, angles)


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
            records.write_cloud(folder / "point_clouds" / cloud.name / file, cloud.in_own_frame())
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
        kind = _NAMES[LABELS[label]]
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
