"""nuScenes: tables of v1.0-*/ and samples/LIDAR_TOP/*.pcd.bin.

The tables are sample, sample_data, sample_annotation, ...

World frame: the ego vehicle's when the lidar measured, x forward, z up, its origin on the ground below the rear axle;
`map_SE3_world` is its place in the map.

- Boxes are **global**: their centre is in the map, hundreds of metres from its origin.
- `size` is **width, length, height**; quaternions are **w x y z**.
- Each sensor has its own ego pose: the vehicle moves between the lidar's time and a camera's.
- The lidar's own x points right and its y forward.
- .pcd.bin is float32 x y z intensity ring, not a PCD file.
- num_lidar_pts is the set's own count, over the lidar's points at that time; boxes without points are labelled too.
- Time is in microseconds.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.cloud_files import quaternion_pose
from toolkit.datasets.records import (
    Listing,
    as_number,
    entry,
    get_intensity,
    heading,
    labelled,
    load_json,
    named_damage,
    numbers,
    read_cloud,
    records,
)
from toolkit.frame import Frame
from toolkit.geometry import invert, transform
from toolkit.objects import LABELS
from toolkit.runtime.files import write_bytes, write_text

_NAMES = {
    "vehicle": "vehicle.car",
    "cyclist": "vehicle.bicycle",
    "pedestrian": "human.pedestrian.adult",
    "heavy": "vehicle.truck",
}
_TABLES = (
    "sample",
    "sample_data",
    "sample_annotation",
    "calibrated_sensor",
    "ego_pose",
    "sensor",
    "instance",
    "category",
)
Table = dict[str, dict[str, Any]]


def nuscenes(path: Path) -> Listing:
    """Frames of a data root or its folder of tables.

    They are ordered by time. Raises FileNotFoundError for any other folder.
    """
    folder = next((each for each in (path, *sorted(path.glob("v1.0*"))) if (each / "sample_data.json").is_file()), None)
    if folder is None:
        raise FileNotFoundError(f"{path} is no nuScenes root: it has no v1.0-*/sample_data.json")
    tables = {name: _table(folder / f"{name}.json") for name in _TABLES}
    with named_damage(folder / "sample_data.json", "table"):
        lidars: dict[str, list[dict[str, Any]]] = {}
        for row in tables["sample_data"].values():
            if row.get("is_key_frame", True) and _channel(tables, row)[1] == "lidar":
                lidars.setdefault(str(entry(row, "sample_token")), []).append(row)
    with named_damage(folder / "sample_annotation.json", "table"):
        labels: dict[str, list[dict[str, Any]]] = {}
        for row in tables["sample_annotation"].values():
            labels.setdefault(str(entry(row, "sample_token")), []).append(row)
    with named_damage(folder / "sample.json", "table"):
        order = sorted(lidars, key=lambda token: as_number(entry(tables["sample"], token, "timestamp"), "timestamp"))

    def load(token: str) -> Frame:
        return _sample(folder, token, tables, lidars[token], labels.get(token, []))

    return Listing(tuple(order), load)


def _table(file: Path) -> Table:
    with named_damage(file, "table"):
        return {str(entry(row, "token")): row for row in records(load_json(file))}


def _channel(tables: dict[str, Table], row: dict[str, Any]) -> tuple[str, str]:
    """Channel and modality of a row of sample_data."""
    mounted = entry(tables["calibrated_sensor"], str(entry(row, "calibrated_sensor_token")))
    sensor = entry(tables["sensor"], str(entry(mounted, "sensor_token")))
    return str(entry(sensor, "channel")), str(entry(sensor, "modality"))


def _sample(
    folder: Path, token: str, tables: dict[str, Table], data: list[dict[str, Any]], labels: list[dict[str, Any]]
) -> Frame:
    problems: dict[str, int] = {}
    with named_damage(folder / "ego_pose.json", "table"):
        placed = [_placed(tables["ego_pose"], row, "ego_pose_token") for row in data]
    with named_damage(folder / "calibrated_sensor.json", "table"):
        mounted = [_placed(tables["calibrated_sensor"], row, "calibrated_sensor_token") for row in data]
    with named_damage(folder / "sample_data.json", "table"):
        files = [folder.parent / str(entry(row, "filename")) for row in data]
        names = [_channel(tables, row)[0] for row in data]
        time = as_number(entry(data[0], "timestamp"), "timestamp") * 1e-6
    map_SE3_ego = placed[0]
    clouds = tuple(
        read_cloud(file, name, invert(map_SE3_ego) @ ego @ pose, problems)
        for file, name, ego, pose in zip(files, names, placed, mounted, strict=True)
    )
    with named_damage(folder / "sample_annotation.json", "table"):
        boxes = np.array([_box(row) for row in labels], np.float64).reshape(-1, 7)
        counts = np.array([int(as_number(row.get("num_lidar_pts", -1))) for row in labels], np.int64)
        instances = [str(entry(row, "instance_token")) for row in labels]
    with named_damage(folder / "instance.json", "table"):
        kinds = [_kind(tables, row, instance) for row, instance in zip(labels, instances, strict=True)]
    with np.errstate(all="ignore"):
        world = invert(map_SE3_ego)
        boxes = np.column_stack([transform(world, boxes[:, :3]), boxes[:, 3:6], heading(world, boxes[:, 6])])
    found = labelled(boxes, kinds, instances, problems, counts)
    return Frame.of_clouds(token, clouds, *found, time=time, map_SE3_world=map_SE3_ego, problems=problems)


def _placed(table: Table, row: dict[str, Any], key: str) -> Float64[np.ndarray, "4 4"]:
    where = entry(table, str(entry(row, key)))
    turned = numbers(entry(where, "rotation"), 4, "rotation")
    moved = numbers(entry(where, "translation"), 3, "translation")
    if not (np.isfinite(turned).all() and np.isfinite(moved).all()):
        raise ValueError(f"{key} holds NaN or infinite numbers")
    return quaternion_pose(turned, moved)


def _box(row: dict[str, Any]) -> np.ndarray:
    width, length, height = numbers(entry(row, "size"), 3, "size")
    turned = numbers(entry(row, "rotation"), 4, "rotation")
    yaw = heading(quaternion_pose(turned, np.zeros(3)), 0.0) if np.isfinite(turned).all() else np.nan
    return np.array([*numbers(entry(row, "translation"), 3, "translation"), length, width, height, yaw])


def _kind(tables: dict[str, Table], row: dict[str, Any], instance: str) -> str:
    if "category_name" in row:
        return str(row["category_name"])
    return str(entry(tables["category"], str(entry(tables["instance"], instance, "category_token")), "name"))


def write_nuscenes(samples: Iterable[Frame], folder: Path) -> int:
    """Write frames as a root with v1.0-coview/; return how many. Each sensor is a channel in its own frame."""
    tables: dict[str, list[dict[str, Any]]] = {
        name: [] for name in (*_TABLES, "scene", "log", "map", "attribute", "visibility")
    }
    tables["category"] = [{"token": label, "name": _NAMES[label], "description": ""} for label in LABELS]
    instances: dict[str, str] = {}  # category by token
    written = 0
    for written, sample in enumerate(samples, 1):
        token = f"{written - 1:06d}"
        time = sample.time if np.isfinite(sample.time) else 0.1 * written
        stamp = round(time * 1e6)
        tables["sample"].append({"token": token, "timestamp": stamp, "scene_token": "", "prev": "", "next": ""})
        tables["ego_pose"].append({"token": token, "timestamp": stamp, **_written(sample.map_SE3_world)})
        for cloud in sample.clouds:
            channel = cloud.name if cloud.name.startswith("LIDAR") else f"LIDAR_{cloud.name}"
            key = f"{token}_{channel}"
            file = f"samples/{channel}/{token}.pcd.bin"
            points = transform(invert(cloud.world_SE3_sensor), cloud.in_world())
            rows = np.column_stack([points, get_intensity(cloud), np.zeros(len(points))]).astype("<f4")
            write_bytes(folder / file, rows.tobytes())
            tables["sensor"].append({"token": key, "channel": channel, "modality": "lidar"})
            tables["calibrated_sensor"].append({"token": key, "sensor_token": key, "camera_intrinsic": [],
                                                **_written(cloud.world_SE3_sensor)})  # fmt: skip
            tables["sample_data"].append({"token": key, "sample_token": token, "ego_pose_token": token,
                                          "calibrated_sensor_token": key, "timestamp": stamp, "is_key_frame": True,
                                          "fileformat": "pcd", "filename": file, "prev": "", "next": ""})  # fmt: skip
        tracks = zip(sample.objects.ids.tolist(), sample.objects.labels.tolist(), strict=True)
        names = [_instance(instances, track, label) for track, label in tracks]
        tables["sample_annotation"] += _annotations(sample, names, token, written)
    tables["instance"] = [{"token": name, "category_token": category} for name, category in instances.items()]
    for name, table in tables.items():
        write_text(folder / "v1.0-coview" / f"{name}.json", json.dumps(table, indent=0))
    return written


def _instance(instances: dict[str, str], track: int, label: int) -> str:
    """Token of a track's instance.

    It is the track's number. The class is added if another class has that number already. That happens in recordings
    without tracks, as their objects are counted anew in each frame.
    """
    plain, category = str(track), LABELS[label]
    token = plain if instances.setdefault(plain, category) == category else f"{plain}_{category}"
    instances.setdefault(token, category)
    return token


def _annotations(sample: Frame, instances: list[str], token: str, written: int) -> list[dict[str, Any]]:
    rows = []
    for k, (box, instance) in enumerate(zip(sample.objects.boxes, instances, strict=True)):
        placed = sample.map_SE3_world
        yaw = float(heading(placed, box[6]))
        counted = {} if sample.counts is None else {"num_lidar_pts": int(sample.counts[k]), "num_radar_pts": 0}
        rows.append({
            "token": f"{written}_{k}", "sample_token": token, "instance_token": instance,
            "translation": transform(placed, box[None, :3])[0].tolist(), "size": box[[4, 3, 5]].tolist(),
            "rotation": [float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))], "attribute_tokens": [],
            "visibility_token": "", "prev": "", "next": "", **counted,
        })  # fmt: skip
    return rows


def _written(placed: np.ndarray) -> dict[str, list[float]]:
    return {"translation": placed[:3, 3].tolist(), "rotation": compute_quaternion(placed).tolist()}


def compute_quaternion(placed: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4"]:
    """Unit quaternion w x y z of a pose's rotation.

    w is not negative.

    >>> compute_quaternion(np.diag([-1.0, -1.0, 1.0, 1.0])).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    r = placed[:3, :3]
    # four times each squared component; the largest gives the others without cancellation
    squares = np.array([1 + r[0, 0] + r[1, 1] + r[2, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2],
                        1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2]])  # fmt: skip
    w, x, y, z = range(4)
    products = np.diag(squares)
    for (a, b), value in {
        (w, x): r[2, 1] - r[1, 2], (w, y): r[0, 2] - r[2, 0], (w, z): r[1, 0] - r[0, 1],
        (x, y): r[0, 1] + r[1, 0], (x, z): r[0, 2] + r[2, 0], (y, z): r[1, 2] + r[2, 1],
    }.items():  # fmt: skip
        products[a, b] = products[b, a] = value
    best = products[int(np.argmax(squares))]
    unit = best / np.linalg.norm(best)
    return -unit if unit[0] < 0 else unit + 0.0
