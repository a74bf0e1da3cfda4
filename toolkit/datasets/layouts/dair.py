"""DAIR-V2X (I, V, C) and V2X-Seq: velodyne/*.pcd, calib/, label/.

The cooperative part has two sides and world labels.

World frame: of one side its lidar's; of the cooperative part the infrastructure's **virtual lidar**. Its x-y plane is
level with the ground, and the clouds of velodyne/ are in it already.

- Numbers are often strings ("3d_location": {"x": "12.3", ...}), and translations are columns, [[x], [y], [z]].
- 3d_location is the centre of the box, 3d_dimensions has h, w and l, rotation is the yaw about z.
- Rotations of calib/ are not orthonormal: they are made so here.
- Labels of the cooperative part are in the (virtual) world, tens of kilometres from its origin.
- system_error_offset (delta_x, delta_y) of a pair, in V2X-Seq relative_error of the calibration, is to be added to the
  infrastructure's place in that world; a missing offset is left out or an empty string.
- Infrastructure and vehicle of a pair measured up to tens of milliseconds apart; each cloud's time says when.
- CarIgnore and its like are not objects, Trafficcone and Barrowlist none of our classes: they are counted.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.records import (
    Labelled,
    Listing,
    as_number,
    count_full_turns,
    entry,
    heading,
    labelled,
    load_json,
    named_damage,
    one_cloud,
    read_cloud,
    records,
    rigid,
    write_cloud,
    xyz,
)
from toolkit.frame import Frame
from toolkit.geometry import invert, transform
from toolkit.objects import LABELS
from toolkit.runtime.files import write_text

_NAMES = {"vehicle": "Car", "cyclist": "Cyclist", "pedestrian": "Pedestrian", "heavy": "Truck"}
_LABELS = "label/virtuallidar", "label/lidar", "label/camera"
_COOPERATIVE = "label_world", "label"


def dair(path: Path) -> Listing:
    """Frames of one side's folder or of the cooperative part. Raises FileNotFoundError for any other folder."""
    inner = next((each for each in (path, path / "cooperative-vehicle-infrastructure") if _is_pair(each)), None)
    if inner is not None:
        return _pairs(inner)
    names = tuple(sorted(file.stem for file in (path / "velodyne").glob("*.pcd")))
    if not names:
        raise FileNotFoundError(f"{path} is no DAIR-V2X folder: it has neither velodyne/*.pcd nor infrastructure-side/")
    return Listing(names, lambda name: _one_side(path, name))


def _is_pair(path: Path) -> bool:
    return (path / "cooperative").is_dir() and (path / "infrastructure-side").is_dir()


def _one_side(folder: Path, name: str) -> Frame:
    problems: dict[str, int] = {}
    cloud = read_cloud(folder / "velodyne" / f"{name}.pcd", "lidar", np.eye(4), problems)
    labels = next(
        (folder / each / f"{name}.json" for each in _LABELS if (folder / each / f"{name}.json").is_file()), None
    )
    found = read_annotations(labels, np.eye(4), problems)
    return Frame.of_clouds(name, (cloud,), *found, problems=problems)


def _pairs(root: Path) -> Listing:
    index = root / "cooperative" / "data_info.json"
    with named_damage(index, "list of pairs"):
        pairs = {_stem(each, "infrastructure_pointcloud_path", "infrastructure_frame"): each
                 for each in records(load_json(index))}  # fmt: skip
    return Listing(tuple(pairs), lambda name: _pair(root, name, pairs[name]))


def _stem(pair: Any, path: str, frame: str) -> str:
    return Path(str(pair[path])).stem if path in pair else str(entry(pair, frame))


def _pair(root: Path, name: str, pair: dict[str, Any]) -> Frame:
    problems: dict[str, int] = {}
    with named_damage(root / "cooperative" / "data_info.json", "list of pairs"):
        vehicle = _stem(pair, "vehicle_pointcloud_path", "vehicle_frame")
        offset = _offset(pair.get("system_error_offset"))
    road, car = root / "infrastructure-side", root / "vehicle-side"
    map_SE3_road = read_transform(road / "calib" / "virtuallidar_to_world" / f"{name}.json", offset)
    novatel_SE3_lidar = read_transform(car / "calib" / "lidar_to_novatel" / f"{vehicle}.json")
    map_SE3_novatel = read_transform(car / "calib" / "novatel_to_world" / f"{vehicle}.json")
    road_SE3_car = invert(map_SE3_road) @ map_SE3_novatel @ novatel_SE3_lidar
    clouds = (
        read_cloud(road / "velodyne" / f"{name}.pcd", "infrastructure", np.eye(4), problems),
        read_cloud(car / "velodyne" / f"{vehicle}.pcd", "vehicle", road_SE3_car, problems),
    )
    files = [root / "cooperative" / each / f"{vehicle}.json" for each in _COOPERATIVE]
    labels = next((file for file in files if file.is_file()), None)
    found = read_annotations(labels, invert(map_SE3_road), problems)
    return Frame.of_clouds(name, clouds, *found, map_SE3_world=map_SE3_road, problems=problems)


def read_transform(path: str | Path, offset: tuple[float, float] | None = None) -> Float64[np.ndarray, "4 4"]:
    """Pose of a calibration file, made rigid. offset: added to x and y, the file's own relative_error if None."""
    with named_damage(path, "calibration"):
        content = load_json(path)
        inner = content.get("transform", content)
        matrix = rigid(entry(inner, "rotation"), entry(inner, "translation"))
        matrix[:2, 3] += offset or _offset(content.get("relative_error")) or (0.0, 0.0)
    return matrix


def _offset(value: Any) -> tuple[float, float] | None:
    if not value or (isinstance(value, dict) and value.get("delta_x") in ("", None)):
        return None
    delta = as_number(entry(value, "delta_x"), "delta_x"), as_number(entry(value, "delta_y"), "delta_y")
    if not np.isfinite(delta).all():
        raise ValueError(f"delta_x and delta_y must be finite numbers, got {delta}")
    return delta


def read_annotations(
    path: Path | None, world_SE3_labels: Float64[np.ndarray, "4 4"], problems: dict[str, int]
) -> Labelled:
    """Objects of a label file, in the world frame. Empty without a file."""
    boxes: list[list[float]] = []
    names: list[str] = []
    ids: list[Any] = []
    if path is not None:
        with named_damage(path, "list of labels"):
            for k, each in enumerate(records(load_json(path))):
                size = xyz(each, "3d_dimensions", "lwh")
                boxes.append([*xyz(each, "3d_location"), *size, as_number(entry(each, "rotation"), "rotation")])
                names.append(str(entry(each, "type")))
                ids.append(each.get("track_id", each.get("id", k)))
    rows = np.array(boxes, np.float64).reshape(-1, 7)
    count_full_turns(rows[:, 6], problems)
    with np.errstate(all="ignore"):
        rows = np.column_stack(
            [transform(world_SE3_labels, rows[:, :3]), rows[:, 3:6], heading(world_SE3_labels, rows[:, 6])]
        )
    return labelled(rows, names, ids, problems)


def written_labels(sample: Frame) -> list[dict[str, Any]]:
    """Format a frame's objects for a label file, world frame."""
    rows = zip(sample.objects.boxes.tolist(), sample.objects.labels, sample.objects.ids.tolist(), strict=True)
    return [
        {
            "type": _NAMES[LABELS[label]],
            "track_id": str(track),
            "3d_dimensions": dict(zip("lwh", box[3:6], strict=True)),
            "3d_location": dict(zip("xyz", box[:3], strict=True)),
            "rotation": box[6],
        }
        for box, label, track in rows
    ]


def write_dair(samples: Iterable[Frame], folder: Path) -> int:
    """Write frames as one infrastructure side; return how many. The clouds of each become one, in its world frame."""
    written = 0
    for written, sample in enumerate(samples, 1):
        name = f"{written - 1:06d}"
        write_cloud(folder / "velodyne" / f"{name}.pcd", one_cloud(sample))
        write_text(folder / "label" / "virtuallidar" / f"{name}.json", json.dumps(written_labels(sample), indent=1))
        placed = sample.map_SE3_world
        calib = {"rotation": placed[:3, :3].tolist(), "translation": placed[:3, 3:].tolist(),
                 "relative_error": {"delta_x": "", "delta_y": ""}}  # fmt: skip
        write_text(folder / "calib" / "virtuallidar_to_world" / f"{name}.json", json.dumps(calib))
    return written
