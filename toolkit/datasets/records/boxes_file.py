"""Our own file of boxes, boxes.json: what `coview detect` writes, and labels of a plain folder of clouds.

    {"coview": "boxes", "version": 1, "frame": "world", "samples": [
      {"name": "000000", "time": 0.0, "objects": [
        {"label": "vehicle", "x": 1.0, "y": 2.0, "z": 0.8, "length": 4.0, "width": 1.8, "height": 1.6,
         "yaw_deg": 90.0, "id": 7, "score": 0.93, "points": 120}]}]}

x y z is the geometric centre (m), sizes are full, yaw is counter-clockwise from +x. Labels have an id, detections a
score; points, where they are there, count those in the box.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.records.fields import as_number, entry, json_of, named_damage, records
from toolkit.datasets.records.labels import Labelled, labelled
from toolkit.objects import LABELS, Detections, Objects
from toolkit.runtime.files import finite, write_text

_VERSION = 1
_SIZES = ("x", "y", "z", "length", "width", "height")


def boxes_record(
    name: str, time: float, boxes: Objects | Detections, *, counts: Sequence[int] | np.ndarray | None = None
) -> dict[str, Any]:
    """One sample's entry of the file."""
    objects = []
    for k, (box, label) in enumerate(zip(boxes.boxes.tolist(), boxes.labels, strict=True)):
        row: dict[str, Any] = {"label": LABELS[label], **dict(zip(_SIZES, box[:6], strict=True))}
        row["yaw_deg"] = float(np.rad2deg(box[6]))
        if isinstance(boxes, Detections):
            row["score"] = float(boxes.scores[k])
        else:
            row["id"] = int(boxes.ids[k])
        if counts is not None:
            row["points"] = int(counts[k])
        objects.append(row)
    return {"name": name, "time": time, "objects": objects}


def write_boxes(path: str | Path, entries: Sequence[dict[str, Any]], **more: Any) -> None:
    """Write the file of some samples' entries, whole or not at all; more: what else it shall say."""
    content = {"coview": "boxes", "version": _VERSION, "frame": "world", **more, "samples": list(entries)}
    write_text(path, json.dumps(finite(content), indent=1, allow_nan=False))


def read_entries(path: str | Path) -> dict[str, dict[str, Any]]:
    """The entries of a file by the names of their samples. Raises ValueError, which names the file."""
    with named_damage(path, "file of boxes"):
        content = json_of(path)
        if entry(content, "coview") != "boxes" or entry(content, "version") != _VERSION:
            raise ValueError(f"it must say coview boxes, version {_VERSION}: see toolkit.datasets.records.boxes_file")
        return {str(entry(each, "name")): each for each in records(entry(content, "samples"), "samples")}


def objects_in(path: str | Path, each: dict[str, Any], problems: dict[str, int]) -> Labelled:
    """The labels of one entry."""
    with named_damage(path, "file of boxes"):
        rows = records(entry(each, "objects"), "objects")
        boxes = np.array([_box(row) for row in rows]).reshape(-1, 7)
        names = [str(entry(row, "label")) for row in rows]
        ids = [row.get("id", k) for k, row in enumerate(rows)]
        counts = [int(as_number(row.get("points", -1), "points")) for row in rows]
        return labelled(boxes, names, ids, problems, counts)


def detections_in(path: str | Path, each: dict[str, Any]) -> Detections:
    """The detections of one entry. Raises ValueError where one has no score, or is no box."""
    with named_damage(path, "file of boxes"):
        rows = records(entry(each, "objects"), "objects")
        boxes = np.array([_box(row) for row in rows]).reshape(-1, 7)
        scores = np.array([as_number(entry(row, "score"), "score") for row in rows])
        if not (np.isfinite(boxes).all() and np.isfinite(scores).all() and (boxes[:, 3:6] > 0).all()):
            raise ValueError("boxes and scores of detections must be finite, and sizes positive")
        return Detections(boxes, scores, np.array([str(entry(row, "label")) for row in rows]))


def _box(row: Any) -> list[float]:
    values = [as_number(entry(row, name), name) for name in (*_SIZES, "yaw_deg")]
    return [*values[:6], float(np.deg2rad(values[6]))]
