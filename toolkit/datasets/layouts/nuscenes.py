"""nuScenes: tables (sample, sample_data, ...) of v1.0-*/ and samples/LIDAR_TOP/*.pcd.bin.

World frame: the ego vehicle's when the lidar measured, x forward, z up, its origin on the ground
below the rear axle; `map_SE3_world` is its place in the map.

- Boxes are **global**: their centre is in the map, hundreds of metres from its origin.
- `size` is **width, length, height**; quaternions are **w x y z**.
- Each sensor has a different ego pose: the vehicle moves between the lidar's time and a camera's.
- The x axis of the lidar points right and its y axis forward.
- .pcd.bin is float32 x y z intensity ring, not a PCD file.
- num_lidar_pts is the data set's count, over the lidar's points at that time; boxes without points
  are labelled too.
- Time is in microseconds."""

import json
import struct
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.boxes import count_points
from toolkit.datasets import (
    box_frames,
    cloud_records,
    frame_labels,
    frame_times,
    listing,
    problem_kinds,
    record_values,
)
from toolkit.datasets.clock_times import parse_microseconds
from toolkit.datasets.origins import near_frames
from toolkit.datasets.pose_files import quaternion_pose
from toolkit.datasets.record_values import as_number, entry, name_damage, numbers
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, transform
from toolkit.objects import LABELS
from toolkit.runtime.reading import resolve_below
from toolkit.runtime.writing import write_bytes, write_text

_NAMES = "vehicle.car", "vehicle.bicycle", "human.pedestrian.adult", "vehicle.truck"  # of `LABELS`
SCENE = "scene"  # token of the one scene that is written, of its log and its map
MAP_FILE = "maps/none.png"
SWEEPS_BETWEEN = "sweeps between two samples, which is_key_frame does not say, left out"
NO_CLOCK = (
    "samples less than a millisecond apart, whose timestamps number them: their times are unknown"
)
MIN_STEP_S = 0.001  # between two sweeps of a lidar
NO_SENSOR = "rows of sample_data whose sensor the tables lack"
_SENSING = ("sample", "sample_data", "sample_annotation", "calibrated_sensor", "ego_pose", "sensor")
_TABLES = (*_SENSING, "instance", "category")
_LISTS = ("sample_data", "sample_annotation")
_Row = dict[str, record_values.Unchecked]


def nuscenes(path: Path) -> listing.Listing:
    """Open a data root or its folder of tables as a recording, whose frames are read on demand.

    Frames are samples, in order of time. Raises FileNotFoundError for any other folder."""
    folder = _find_folder(path)
    tables = {name: _read_rows(folder / f"{name}.json", is_list=name in _LISTS) for name in _TABLES}
    with name_damage(folder / "sample_data.json", "table"):
        # rows of sample_data by token of their sample, and how many have an unknown sensor
        lidars, unknown_count = _group_lidars(tables)
        between_count = 0  # number of sweeps between samples, which are left out
        for token, rows in lidars.items():
            timestamp = tables["sample"].get(token, {}).get("timestamp")
            lidars[token] = _drop_sweeps(tables, rows, timestamp)
            between_count += len(rows) - len(lidars[token])
    labels: dict[str, list[_Row]] = {}  # by token of the sample
    with name_damage(folder / "sample_annotation.json", "table"):
        for row in tables["sample_annotation"].values():
            labels.setdefault(str(entry(row, "sample_token")), []).append(row)
    with name_damage(folder / "sample.json", "table"):
        sample_tokens = sorted(
            lidars,
            key=lambda token: as_number(entry(tables["sample"], token, "timestamp"), "timestamp"),
        )

        times = [
            _parse_time(entry(tables["sample"][token], "timestamp")) for token in sample_tokens
        ]
        # steps that are far too short show that the times are not a clock's
        is_clock = len(times) < 2 or float(np.median(np.diff(times))) >= MIN_STEP_S

    load = partial(_load, folder, tables, lidars, labels, is_clock)
    noted = {
        NO_SENSOR: unknown_count,
        SWEEPS_BETWEEN: between_count,
        NO_CLOCK: 0 if is_clock else len(sample_tokens),
    }
    return listing.Listing(tuple(sample_tokens), load, labelled=labels, noted=noted)


def _find_folder(path: Path) -> Path:
    """Return the folder of tables: the path, or the first v1.0* in it, with a warning if several.

    Raises FileNotFoundError for none."""
    candidates = (path, *sorted(path.glob("v1.0*")))
    table_folders = [folder for folder in candidates if (folder / "sample_data.json").is_file()]
    if not table_folders:
        raise FileNotFoundError(f"{path} is no nuScenes root: it has no v1.0-*/sample_data.json")
    first = table_folders[0]
    if len(table_folders) > 1 and first != path:
        others = ", ".join(folder.name for folder in table_folders[1:6])
        warnings.warn(
            f"{path}: {first.name} is read, and not {others}: give the folder to read another",
            stacklevel=3,
        )
    return first


def _group_lidars(tables: dict[str, dict[str, _Row]]) -> tuple[dict[str, list[_Row]], int]:
    """Rows of sample_data that are of lidars, by token of their sample.

    The second result is the number of rows whose sensor is unknown. Raises ValueError if no row is
    of a lidar. tables: rows by token, by name of the table."""
    lidars: dict[str, list[_Row]] = {}
    modalities: set[str] = set()
    unknown_count = 0
    last_error: ValueError | None = None
    for row in tables["sample_data"].values():
        if not row.get("is_key_frame", True):  # between two samples
            continue
        try:
            modality = _find_sensor_entry(tables, row, "modality").lower()
        except ValueError as error:
            unknown_count += 1
            last_error = error
            continue
        modalities.add(modality)
        if modality == "lidar":
            lidars.setdefault(str(entry(row, "sample_token")), []).append(row)
    if last_error is not None and not lidars:
        raise last_error
    if modalities and not lidars:
        names = ", ".join(sorted(modalities)[:6])
        raise ValueError(
            f"it has no row of a sensor whose modality is lidar, but of {names}: add the lidars' "
            "rows"
        )
    return lidars, unknown_count


def _read_rows(path: Path, *, is_list: bool) -> dict[str, _Row]:
    """Read the rows of a table by token.

    is_list: True for a table whose rows no other table refers to. Then all rows are kept, and a
    token that was there before gets a number. Otherwise a token names one row, and two rows with
    one token that differ raise ValueError, as does a damaged file."""
    # errors within become one that names the file
    with name_damage(path, "table"):
        rows = record_values.as_list(record_values.load_json(path))
        by_token: dict[str, _Row] = {}
        for row in rows:
            token = str(entry(row, "token"))
            if token in by_token and is_list:
                token = f"{token} {len(by_token)}"
            elif token in by_token and by_token[token] != row:
                raise ValueError(
                    f"two rows that differ have the token {token[:60]!r}: give each its token"
                )
            by_token[token] = row
    return by_token


def _drop_sweeps(
    tables: dict[str, _Row], rows: list[_Row], stamp: record_values.Unchecked
) -> list[_Row]:
    """Keep one row of each channel: the nearest to the sample's stamp, in the table's order.

    tables: rows by token, by name of the table; rows: rows of sample_data of one sample; stamp:
    timestamp of the sample."""
    channels = [_find_sensor_entry(tables, row, "channel") for row in rows]
    if len(set(channels)) == len(rows):
        return rows
    sample_time = as_number(stamp, "timestamp")
    distances: dict[str, float] = {}  # each channel's nearest row so far
    nearest_index: dict[str, int] = {}
    for index, (channel, row) in enumerate(zip(channels, rows, strict=True)):
        distance = abs(as_number(entry(row, "timestamp"), "timestamp") - sample_time)
        if channel not in distances or distance < distances[channel]:
            distances[channel] = distance
            nearest_index[channel] = index
    return [rows[index] for index in sorted(nearest_index.values())]


def _load(
    folder: Path,
    tables: dict[str, _Row],
    lidars: Mapping[str, list[_Row]],
    labels: Mapping[str, list[_Row]],
    is_clock: bool,
    token: str,
) -> Frame:
    """Read the sample of a token; the arguments before it are the same for all samples.

    tables: rows by token, by name of the table; lidars, labels: rows of sample_data and of
    sample_annotation by token of the sample; is_clock: True if timestamps are times."""
    return _read_frame(
        folder, token, tables, data=lidars[token], labels=labels.get(token, []), is_clock=is_clock
    )


def _find_sensor_entry(tables: dict[str, _Row], row: _Row, key: str) -> str:
    """Return an entry, by its key, of the sensor to which a row of sample_data refers.

    tables: rows by token, by name of the table."""
    calibration = entry(tables["calibrated_sensor"], str(entry(row, "calibrated_sensor_token")))
    return str(entry(tables["sensor"], str(entry(calibration, "sensor_token")), key))


def _read_frame(
    folder: Path,
    token: str,
    tables: dict[str, _Row],
    data: list[_Row],
    labels: list[_Row],
    is_clock: bool,
) -> Frame:
    """Read a sample.

    tables: rows of each table, by their tokens; data, labels: the sample's rows of sample_data and
    of sample_annotation; is_clock: the tables' times are those of a clock."""
    problems: problem_kinds.Problems = {}
    ego_poses = [_read_pose(folder, tables, "ego_pose", row) for row in data]
    sensor_poses = [_read_pose(folder, tables, "calibrated_sensor", row) for row in data]
    with name_damage(folder / "sample_data.json", "table"):
        files = [resolve_below(folder.parent, str(entry(row, "filename"))) for row in data]
        names = [_find_sensor_entry(tables, row, "channel") for row in data]
        stamps = [_parse_time(entry(row, "timestamp")) if is_clock else None for row in data]
    map_SE3_ego = box_frames.level_frame(ego_poses[0])
    poses = [
        invert(map_SE3_ego) @ ego @ pose for ego, pose in zip(ego_poses, sensor_poses, strict=True)
    ]
    clouds = []
    for file, name, pose, stamp in zip(files, names, poses, stamps, strict=True):
        clouds.append(cloud_records.read_cloud(file, name, pose, problems, stamp_s=stamp))
    with name_damage(folder / "sample_annotation.json", "table"):
        boxes = np.array([_parse_unturned_box(row) for row in labels], np.float64).reshape(-1, 7)
        rotations = np.array([_parse_rotation(row) for row in labels]).reshape(-1, 3, 3)
        boxes[:, 6] = box_frames.find_headings(rotations, problems)
        counts = np.array(
            [int(as_number(row.get("num_lidar_pts", -1))) for row in labels], np.int64
        )
        instances = [str(entry(row, "instance_token")) for row in labels]
    with name_damage(folder / "instance.json", "table"):
        categories = [
            _find_category(tables, row, instance)
            for row, instance in zip(labels, instances, strict=True)
        ]
    labelled_objects = frame_labels.make_labels(
        box_frames.move_boxes(invert(map_SE3_ego), boxes),
        categories=categories,
        ids=instances,
        problems=problems,
        counts=counts,
    )
    time = frame_times.frame_time(clouds)
    return Frame.of_clouds(
        token, clouds, *labelled_objects, time=time, map_SE3_world=map_SE3_ego, problems=problems
    )


def _parse_time(value: record_values.Unchecked) -> float:
    """Return a timestamp in seconds: it is in microseconds, or nanoseconds if it is that large."""
    return parse_microseconds(as_number(value, "timestamp"))


def _read_pose(folder: Path, tables: dict[str, _Row], name: str, row: _Row) -> Pose:
    """Read the pose to which a row of sample_data refers.

    folder: folder of the tables, for errors; tables: rows by token, by name of the table; name:
    table of the pose, "ego_pose" (pose in the map) or "calibrated_sensor" (pose in the vehicle)."""
    with name_damage(folder / f"{name}.json", "table"):
        pose_row = entry(tables[name], str(entry(row, f"{name}_token")))
        quaternion = numbers(entry(pose_row, "rotation"), 4, "rotation")
        translation = numbers(entry(pose_row, "translation"), 3, "translation")
        if not (np.isfinite(quaternion).all() and np.isfinite(translation).all()):
            raise ValueError(f"{name}_token holds NaN or infinite numbers")
        return quaternion_pose(quaternion, translation)


def _parse_unturned_box(row: _Row) -> Float64[np.ndarray, "7"]:
    """Box of a label in the map, with a yaw of 0."""
    width, length, height = numbers(entry(row, "size"), 3, "size")
    centre = numbers(entry(row, "translation"), 3, "translation")
    return np.array([*centre, length, width, height, 0.0])


def _parse_rotation(row: _Row) -> Float64[np.ndarray, "3 3"]:
    """Rotation matrix of a label's box in the map, NaN if its numbers are not finite."""
    quaternion = numbers(entry(row, "rotation"), 4, "rotation")
    if not np.isfinite(quaternion).all():
        return np.full((3, 3), np.nan)
    return quaternion_pose(quaternion, translation=np.zeros(3))[:3, :3]


def _find_category(tables: dict[str, _Row], row: _Row, instance: str) -> str:
    """Class name of a label, in its row or through its instance.

    tables: rows of each table by their tokens; row: row of sample_annotation; instance: token of
    its instance."""
    if "category_name" in row:
        return str(row["category_name"])
    category_token = str(entry(tables["instance"], instance, "category_token"))
    return str(entry(tables["category"], category_token, "name"))


def write_nuscenes(samples: Iterable[Frame], folder: Path) -> None:
    """Write frames as a root with v1.0-coview/, one scene that the nuScenes devkit loads.

    Each sensor is a channel with its frame. Objects without a count of points get the number of the
    frame's points in their box."""
    tables: dict[str, list[_Row]] = {
        name: [] for name in (*_TABLES, "scene", "log", "map", "attribute", "visibility")
    }
    pairs = zip(LABELS, _NAMES, strict=True)
    tables["category"] = [
        {"token": label, "name": name, "description": ""} for label, name in pairs
    ]
    channels: dict[str, str] = {}  # by sensor
    instances: dict[str, str] = {}  # category by token
    for number, sample in enumerate(near_frames(samples), 1):
        token = f"{number - 1:06d}"
        seconds = frame_times.clock_time(sample, number)
        stamp = round(seconds * 1e6)
        tables["sample"].append({"token": token, "timestamp": stamp, "scene_token": SCENE})
        tables["ego_pose"].append(
            {"token": token, "timestamp": stamp, **_format_pose(sample.map_SE3_world)}
        )
        for cloud in sample.clouds:
            channel = channels.setdefault(cloud.name, _name_channel(cloud.name))
            _write_cloud(
                folder,
                tables,
                channel=channel,
                token=token,
                cloud=cloud,
                time_s=frame_times.cloud_time(cloud, seconds),
            )
        tables["sample_annotation"] += _format_labels(sample, token, number, instances)
    for channel in channels.values():
        tables["sensor"].append({"token": channel, "channel": channel, "modality": "lidar"})
    _link_neighbours(tables["sample"], lambda row: SCENE)  # in place
    _link_neighbours(tables["sample_data"], lambda row: str(row["filename"]).split("/")[1])
    annotations = _link_neighbours(
        tables["sample_annotation"], lambda row: str(row["instance_token"])
    )
    tables["instance"] = [
        {
            "token": name,
            "category_token": instances[name],
            "nbr_annotations": len(rows),
            "first_annotation_token": rows[0]["token"],
            "last_annotation_token": rows[-1]["token"],
        }
        for name, rows in annotations.items()
    ]
    if tables["sample"]:
        tables["scene"] = [_format_scene(tables["sample"])]
    log = {"token": SCENE, "logfile": "", "vehicle": "", "date_captured": "", "location": ""}
    tables["log"] = [log]
    tables["map"] = [
        {"token": SCENE, "log_tokens": [SCENE], "category": "semantic_prior", "filename": MAP_FILE}
    ]
    write_bytes(folder / MAP_FILE, _draw_pixel())
    for name, table in tables.items():
        write_text(folder / "v1.0-coview" / f"{name}.json", json.dumps(table, indent=0))


def _name_channel(sensor: str) -> str:
    return sensor if sensor.startswith("LIDAR") else f"LIDAR_{sensor}"


def _write_cloud(
    folder: Path,
    tables: dict[str, list[_Row]],
    channel: str,
    token: str,
    cloud: SensorCloud,
    time_s: float,
) -> None:
    """Write a cloud's file, and add its rows to sample_data and calibrated_sensor in `tables`.

    channel: name of its sensor; token: token of its sample; time_s: time of the cloud (s)."""
    cloud_token = f"{token}_{channel}"  # for its calibration too
    file = f"samples/{channel}/{token}.pcd.bin"
    ring = np.zeros(len(cloud.points)) if cloud.ring is None else cloud.ring
    columns = cloud.in_sensor(), cloud_records.get_intensity(cloud), ring
    write_bytes(folder / file, np.column_stack(columns).astype("<f4").tobytes())
    calibration_row = {
        "token": cloud_token,
        "sensor_token": channel,
        "camera_intrinsic": [],
        **_format_pose(cloud.world_SE3_sensor),
    }
    tables["calibrated_sensor"].append(calibration_row)
    data_row = {
        "token": cloud_token,
        "sample_token": token,
        "ego_pose_token": token,
        "calibrated_sensor_token": cloud_token,
        "timestamp": round(time_s * 1e6),
        "is_key_frame": True,
        "width": 0,
        "height": 0,
        "fileformat": "pcd",
        "filename": file,
    }
    tables["sample_data"].append(data_row)


def _format_labels(sample: Frame, token: str, number: int, instances: dict[str, str]) -> list[_Row]:
    """Rows of sample_annotation of one frame.

    token: token of its sample; number: its number, from 1; instances: class of each instance so
    far, to which the frame's are added."""
    counts = sample.counts
    if counts is None:
        counts = count_points(sample.points(), sample.objects.boxes)
    map_SE3_world = sample.map_SE3_world
    rows = []
    labelled_boxes = frame_labels.list_rows(sample.objects, {name: name for name in LABELS})
    for k, (box, label, track) in enumerate(labelled_boxes):
        instance = str(track)
        # objects of recordings without tracks are counted again in each frame: a number may have
        # several classes
        if instances.setdefault(instance, label) != label:
            instance = f"{track}_{label}"
            instances.setdefault(instance, label)
        world_centre, world_yaw = box[:3], box[6]
        length, width = box[3], box[4]
        height = box[5]
        centre = transform(map_SE3_world, np.array([world_centre]))[0]
        yaw = float(box_frames.heading(map_SE3_world, world_yaw))
        row = {
            "token": f"{number}_{k}",
            "sample_token": token,
            "instance_token": instance,
            "translation": centre.tolist(),
            "size": [width, length, height],
            "rotation": [float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))],  # w x y z
            "attribute_tokens": [],
            "visibility_token": "",
            "num_lidar_pts": int(counts[k]),
            "num_radar_pts": 0,
        }
        rows.append(row)
    return rows


def _link_neighbours(rows: list[_Row], find_group: Callable[[_Row], str]) -> dict[str, list[_Row]]:
    """Set `prev` and `next` of each row to the tokens of its neighbours in its group.

    The rows change. find_group: name of a row's group. Returns the rows of each group in order."""
    groups: dict[str, list[_Row]] = {}
    for row in rows:
        groups.setdefault(find_group(row), []).append(row)
    for group in groups.values():
        # "" before the first row and after the last, so row i has token i + 1
        tokens = ["", *(row["token"] for row in group), ""]
        for index, row in enumerate(group):
            row["prev"] = tokens[index]
            row["next"] = tokens[index + 2]
    return groups


def _format_scene(rows: list[_Row]) -> _Row:
    """Row of the one scene of all samples."""
    texts = {"token": SCENE, "log_token": SCENE, "name": "scene-0001", "description": ""}
    ends = {"first_sample_token": rows[0]["token"], "last_sample_token": rows[-1]["token"]}
    return {**texts, **ends, "nbr_samples": len(rows)}


def _draw_pixel() -> bytes:
    """A PNG of one white pixel: the devkit loads no set without a map."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        """Format a part of a PNG: its length, its kind, its content, and their checksum."""
        length = struct.pack(">I", len(content))
        checksum = struct.pack(">I", zlib.crc32(kind + content))
        return length + kind + content + checksum

    # width, height, bits of a grey value, and four zeros for the usual storage
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0))
    pixel = chunk(b"IDAT", zlib.compress(b"\0\xff"))
    end = chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + header + pixel + end


def _format_pose(pose: np.ndarray) -> dict[str, list[float]]:
    return {"translation": pose[:3, 3].tolist(), "rotation": compute_quaternion(pose).tolist()}


def compute_quaternion(pose: Pose) -> Float64[np.ndarray, "4"]:
    """Unit quaternion w x y z of a pose's rotation, w not negative."""
    (quaternion,) = compute_quaternions(pose[None, :3, :3])
    return quaternion


def compute_quaternions(rotations: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n 4"]:
    """Unit quaternions w x y z of rotation matrices, w not negative.

    Many of them take little more time than one."""
    from scipy.spatial.transform import Rotation

    if not len(rotations):
        return np.zeros((0, 4))
    quaternions = Rotation.from_matrix(rotations).as_quat(canonical=True)  # x y z w
    return np.roll(quaternions, 1, axis=1) + 0.0
