"""ASAM OpenLABEL 1.0.0 of a whole recording: one JSON file, an object per id over its frames.

- A frame is the number of the instant from 0; its time is `timestamp` in frame_properties,
  seconds as text.
- An object has its frame_intervals and its class, the one it had most often. In each frame it has a
  cuboid (x y z, quaternion x y z w, length width height), its score, and its velocity (m/s) if that
  is known, in the coordinate system `world`.
- Frames are written as they come and objects at the end, so that memory grows with the number of
  ids, not of boxes."""

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.layouts.openlabel import OPENLABEL_NAMES, WORLD, cuboid_values
from toolkit.datasets.problem_kinds import Problems
from toolkit.exchange.instant import Instant
from toolkit.objects import LABELS


@dataclass
class _Track:
    """Frames and classes of one id.

    intervals: first and last frame of each unbroken stretch; labels: number of frames by class."""

    intervals: list[list[int]] = field(default_factory=list)
    labels: Counter[int] = field(default_factory=Counter)

    def add(self, frame: int, label: int) -> None:
        """Count a frame."""
        if self.intervals and self.intervals[-1][1] == frame - 1:
            self.intervals[-1][1] = frame
        else:
            self.intervals.append([frame, frame])
        self.labels[label] += 1

    def describe(self, number: int) -> dict[str, Any]:
        """Return the object's entry."""
        kind = OPENLABEL_NAMES[LABELS[self.labels.most_common(1)[0][0]]]
        return {
            "name": f"{kind}_{number}",
            "type": kind,
            "frame_intervals": _list_intervals(self.intervals),
        }


class OpenLabelWriter:
    """Writer of one OpenLABEL file."""

    def __init__(self, path: Path) -> None:
        self.problems: Problems = {}
        self._file = path.open("w", encoding="utf-8", newline="\n")
        self._frame = 0
        self._tracks: dict[int, _Track] = {}
        systems = {WORLD: {"type": "scene_cs", "parent": "", "children": []}}
        head = {"metadata": {"schema_version": "1.0.0"}, "coordinate_systems": systems}
        text = json.dumps({"openlabel": head}).removesuffix("}}")
        self._file.write(f'{text}, "frames": {{')

    def write(self, instant: Instant) -> None:
        """Write a frame."""
        objects = {}
        ids = instant.list_ids()
        velocities = instant.known_velocities()
        for row, number in enumerate(ids):
            box = instant.boxes[row]
            data: dict[str, Any] = {
                "cuboid": [
                    {"name": "shape3D", "coordinate_system": WORLD, "val": cuboid_values(box)}
                ],
                "num": [{"name": "score", "val": float(instant.scores[row])}],
            }
            velocity = velocities[row]
            if velocity is not None:
                data["vec"] = [
                    {"name": "velocity", "coordinate_system": WORLD, "val": list(velocity)}
                ]
            objects[str(number)] = {"object_data": data}
            self._tracks.setdefault(number, _Track()).add(self._frame, int(instant.labels[row]))
        known = np.isfinite(instant.time_s)
        # some readers take whole numbers and text only
        properties = {"timestamp": f"{instant.time_s:.6f}"} if known else {}
        frame = {"frame_properties": properties, "objects": objects}
        separator = ",\n" if self._frame else "\n"
        self._file.write(f'{separator}"{self._frame}": {json.dumps(frame, allow_nan=False)}')
        self._frame += 1

    def close(self) -> None:
        """Write the objects and complete the file."""
        described = {str(number): track.describe(number) for number, track in self._tracks.items()}
        intervals = _list_intervals([[0, self._frame - 1]] if self._frame else [])
        objects = json.dumps(described)
        self._file.write(
            f'\n}},\n"objects": {objects},\n"frame_intervals": {json.dumps(intervals)}}}}}\n'
        )
        self._file.close()


def _list_intervals(intervals: list[list[int]]) -> list[dict[str, int]]:
    """Return first and last frames as OpenLABEL names them."""
    return [{"frame_start": first, "frame_end": last} for first, last in intervals]
