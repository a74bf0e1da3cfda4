"""SUSTechPOINTS, the labelling tool's own folders: lidar/*.pcd (or .bin), label/*.json.

World frame: the lidar's, as recorded; z up, which way is forward differs between recordings.

- A label is {"obj_id", "obj_type", "psr": {"position", "rotation", "scale"}}: position is the centre of the box, scale
  x y z its length, width and height, rotation x y z in radians, of which z is the yaw; x and y are hardly ever not 0
  and are dropped.
- obj_id is a string, and the same through a scene.
- Frames nobody has labelled yet have no file: their objects are unknown, not none.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.records import (
    ENDINGS,
    Listing,
    entry,
    labelled,
    load_json,
    named_damage,
    one_cloud,
    read_cloud,
    records,
    write_cloud,
    xyz,
)
from toolkit.frame import Frame
from toolkit.objects import LABELS
from toolkit.runtime.files import write_text

_NAMES = {"vehicle": "Car", "cyclist": "Bicycle", "pedestrian": "Pedestrian", "heavy": "Truck"}


def sustech(path: Path) -> Listing:
    """Frames of a scene's folder. Raises FileNotFoundError if it is not a scene."""
    files = {file.stem: file for file in sorted((path / "lidar").glob("*")) if file.suffix.lower() in ENDINGS}
    if not files:
        raise FileNotFoundError(f"{path} is no SUSTechPOINTS scene: it has no lidar/*.pcd")
    return Listing(tuple(files), lambda name: _sample(path, name, files[name]))


def _sample(folder: Path, name: str, file: Path) -> Frame:
    problems: dict[str, int] = {}
    cloud = read_cloud(file, "lidar", np.eye(4), problems)
    labels = folder / "label" / f"{name}.json"
    boxes: list[list[float]] = []
    names: list[str] = []
    ids: list[Any] = []
    if labels.is_file():
        with named_damage(labels, "list of labels"):
            for each in records(load_json(labels)):
                psr = entry(each, "psr")
                boxes.append([*xyz(psr, "position"), *xyz(psr, "scale"), xyz(psr, "rotation")[2]])
                names.append(str(entry(each, "obj_type")))
                ids.append(each.get("obj_id", len(ids)))
    found = labelled(np.array(boxes).reshape(-1, 7), names, ids, problems)
    return Frame.of_clouds(name, (cloud,), *found, problems=problems)


def write_sustech(samples: Iterable[Frame], folder: Path) -> int:
    """Write frames as a scene; return how many.

    They are numbered from 000000.

    The clouds of a frame become one, in its world frame.
    """
    written = 0
    for written, sample in enumerate(samples, 1):
        name = f"{written - 1:06d}"
        write_cloud(folder / "lidar" / f"{name}.pcd", one_cloud(sample))
        rows = zip(sample.objects.boxes.tolist(), sample.objects.labels, sample.objects.ids.tolist(), strict=True)
        content = [
            {
                "obj_id": str(track),
                "obj_type": _NAMES[LABELS[label]],
                "psr": {
                    "position": dict(zip("xyz", box[:3], strict=True)),
                    "rotation": {"x": 0.0, "y": 0.0, "z": box[6]},
                    "scale": dict(zip("xyz", box[3:6], strict=True)),
                },
            }
            for box, label, track in rows
        ]
        write_text(folder / "label" / f"{name}.json", json.dumps(content, indent=1))
    return written
