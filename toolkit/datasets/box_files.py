"""Files of boxes: labels or detections of named frames."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.datasets.frame_labels import FrameLabels, make_labels
from toolkit.datasets.problem_kinds import Problems
from toolkit.datasets.record_values import (
    Unchecked,
    as_list,
    as_number,
    entry,
    load_json,
    name_damage,
)
from toolkit.objects import LABELS, Detections, Objects
from toolkit.runtime.text_values import replace_infinite
from toolkit.runtime.writing import write_text

_VERSION = 1
# keys of a box in the file, in the order of the columns of a box (m)
_SIZES = ("x", "y", "z", "length", "width", "height")
_FORM = f'{{"coview": "boxes", "version": {_VERSION}, "samples": [{{"name", "objects": [...]}}]}}'


def boxes_record(
    name: str,
    time: float,
    boxes: Objects | Detections,
    *,
    counts: Sequence[int] | np.ndarray | None = None,
    stamps_s: Mapping[str, float] | None = None,
) -> str:
    """Return one frame's entry of the file as JSON text, for `write_boxes`.

    Text takes little memory while thousands of frames wait to be written.

    Args:
        name: name of the frame.
        time: its time (s).
        boxes: its labels, which get their ids, or its detections, which get their scores.
        counts: number of points on each box, None to leave it out.
        stamps_s: time of each sensor's cloud by its name (`SensorCloud.stamp_s`)."""
    objects = []
    for k, (box, label) in enumerate(zip(boxes.boxes.tolist(), boxes.labels, strict=True)):
        centre_and_size, yaw = box[:6], box[6]
        row: dict[str, object] = {
            "label": LABELS[label],
            **dict(zip(_SIZES, centre_and_size, strict=True)),
            "yaw_deg": float(np.rad2deg(yaw)),
        }
        if isinstance(boxes, Detections):
            row["score"] = float(boxes.scores[k])
        else:
            row["id"] = int(boxes.ids[k])
        if counts is not None:
            row["points"] = int(counts[k])
        objects.append(row)
    content: dict[str, object] = {"name": name, "time": time}
    if stamps_s:
        content["clouds"] = dict(stamps_s)
    content["objects"] = objects
    return json.dumps(replace_infinite(content), indent=1, allow_nan=False)


def write_boxes(path: str | Path, entries: Sequence[str], **more: object) -> None:
    """Write a file of frame entries, whole or not at all.

    entries: JSON text of each frame (`boxes_record`); more: further fields of the
    file."""
    # the entries are JSON already, so their text is put between "[" and "]" of an empty list
    content = {"coview": "boxes", "version": _VERSION, "frame": "world", **more, "samples": []}
    head = json.dumps(replace_infinite(content), indent=1, allow_nan=False).removesuffix("]\n}")
    body = ",".join("\n  " + text.replace("\n", "\n  ") for text in entries)
    if entries:
        body += "\n "
    write_text(path, head + body + "]\n}")


def read_entries(path: str | Path) -> dict[str, Unchecked]:
    """Read a file of boxes; return its entries, not yet parsed, by the names of their frames.

    Raises ValueError, which names the file."""
    with name_damage(path, "file of boxes"):
        content = load_json(path)
        is_ours = isinstance(content, dict) and content.get("coview") == "boxes"
        if not is_ours or content.get("version") != _VERSION:
            raise ValueError(f"its form must be {_FORM}, got {_describe_form(content)}")
        if (frame := content.get("frame", "world")) != "world":
            raise ValueError(
                f"its boxes must be in the frame world, got {str(frame)[:40]!r}: move them by "
                "poses.json"
            )
        entries = as_list(entry(content, "samples"), "samples")
        named_entries = {str(entry(sample, "name")): sample for sample in entries}
        if len(named_entries) < len(entries):
            raise ValueError("two of its samples have one name")
        return named_entries


def _describe_form(content: Unchecked) -> str:
    """Describe what a file holds in place of our boxes, and the layout that takes it.

    content: parsed JSON."""
    if isinstance(content, list):
        rows = f"a list of {len(content)} rows"
        # SUSTechPOINTS calls a box "psr": position, scale, rotation
        is_sustech = bool(content) and isinstance(content[0], dict) and "psr" in content[0]
        return f"{rows} of SUSTechPOINTS: give --layout sustech" if is_sustech else rows
    if not isinstance(content, dict):
        return str(content)[:40]
    if "openlabel" in content:
        return "OpenLABEL: give --layout openlabel"
    if content.get("coview") == "boxes":
        return f"version {content.get('version')!r:.20}"
    keys = ", ".join(map(str, content))
    return f"an object with the entries {keys[:80]}" if keys else "an empty object"


def parse_objects(path: str | Path, frame_entry: Unchecked, problems: Problems) -> FrameLabels:
    """Parse one entry of a file of boxes as the labels of a frame.

    path: the file, for errors; frame_entry: parsed JSON of the frame, from `read_entries`;
    problems: kinds and numbers of labels left out are added to it."""
    with name_damage(path, "file of boxes"):
        sample = f"sample {str(entry(frame_entry, 'name'))[:60]!r}"
        if "objects" not in frame_entry:
            raise ValueError(f'{sample} has no entry objects: write "objects": [] for an empty one')
        rows = as_list(frame_entry["objects"], f"objects of {sample}")
        objects = []
        for k, row in enumerate(rows):
            try:
                objects.append(_parse_object(row))
            except ValueError as error:
                raise ValueError(f"objects[{k}] of {sample}: {error}") from None
        boxes = np.array([labelled.box for labelled in objects]).reshape(-1, 7)
        yaw = boxes[:, 6]
        yaw[:] = np.deg2rad(yaw)  # a view: this changes `boxes`
        return make_labels(
            boxes,
            categories=[labelled.category for labelled in objects],
            ids=[row.get("id", k) for k, row in enumerate(rows)],
            problems=problems,
            counts=[labelled.point_count for labelled in objects],
        )


class _LabelledBox(NamedTuple):
    """One object of a file.

    Attributes:
        box: x, y, z, length, width, height (m) and yaw (degrees).
        category: name of its class.
        point_count: number of points on it, -1 if unknown."""

    box: list[float]
    category: str
    point_count: int


def _parse_object(row: Unchecked) -> _LabelledBox:
    """Parse one object of a file of boxes; ValueError for a missing or damaged entry."""
    return _LabelledBox(
        box=[as_number(entry(row, key), key) for key in (*_SIZES, "yaw_deg")],
        category=str(entry(row, "label")),
        point_count=int(as_number(row.get("points", -1), "points")),
    )
