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
        """Count a frame, given by its number, in which the object has class number `label`."""
        if self.intervals and self.intervals[-1][1] == frame - 1:  # the last stretch goes on
            self.intervals[-1][1] = frame
        else:
            self.intervals.append([frame, frame])
        self.labels[label] += 1

    def describe(self, track_id: int) -> dict[str, Any]:
        """Return the object's entry, with the class that it had most often."""
        ((label, _),) = self.labels.most_common(1)
        kind = OPENLABEL_NAMES[LABELS[label]]
        return {
            "name": f"{kind}_{track_id}",
            "type": kind,
            "frame_intervals": _list_intervals(self.intervals),
        }


class OpenLabelWriter:
    """Writer of one OpenLABEL file."""

    def __init__(self, path: Path) -> None:
        """Open an OpenLABEL file, and write what precedes its frames."""
        self.problems: Problems = {}
        self._file = path.open("w", encoding="utf-8", newline="\n")
        self._frame = 0  # number of the next frame
        self._tracks: dict[int, _Track] = {}
        systems = {WORLD: {"type": "scene_cs", "parent": "", "children": []}}
        head = {"metadata": {"schema_version": "1.0.0"}, "coordinate_systems": systems}
        # the braces stay open until `close`
        text = json.dumps({"openlabel": head}).removesuffix("}}")
        self._file.write(f'{text}, "frames": {{')

    def write(self, instant: Instant) -> None:
        """Write an instant as the next frame.

        Classes are kept for the list of objects, which comes last in the file."""
        objects = {}
        velocities = instant.known_velocities()
        for row, track_id in enumerate(instant.list_ids()):
            cuboid = cuboid_values(instant.boxes[row])
            data: dict[str, Any] = {
                "cuboid": [{"name": "shape3D", "coordinate_system": WORLD, "val": cuboid}],
                "num": [{"name": "score", "val": float(instant.scores[row])}],
            }
            velocity = velocities[row]
            if velocity is not None:
                data["vec"] = [
                    {"name": "velocity", "coordinate_system": WORLD, "val": list(velocity)}
                ]
            objects[str(track_id)] = {"object_data": data}
            track = self._tracks.setdefault(track_id, _Track())
            track.add(self._frame, int(instant.labels[row]))
        has_time = np.isfinite(instant.time_s)
        # text, as some readers take no number but a whole one
        properties = {"timestamp": f"{instant.time_s:.6f}"} if has_time else {}
        frame = {"frame_properties": properties, "objects": objects}
        separator = ",\n" if self._frame else "\n"
        self._file.write(f'{separator}"{self._frame}": {json.dumps(frame, allow_nan=False)}')
        self._frame += 1

    def close(self) -> None:
        """Write the objects and complete the file."""
        objects = {
            str(track_id): track.describe(track_id) for track_id, track in self._tracks.items()
        }
        intervals = _list_intervals([[0, self._frame - 1]] if self._frame else [])
        # }} in the text is a single brace: the first closes the frames, the last two the document
        self._file.write(
            f'\n}},\n"objects": {json.dumps(objects)},\n'
            f'"frame_intervals": {json.dumps(intervals)}}}}}\n'
        )
        self._file.close()


def _list_intervals(intervals: list[list[int]]) -> list[dict[str, int]]:
    """Return pairs of a first and a last frame as OpenLABEL names them."""
    return [{"frame_start": first, "frame_end": last} for first, last in intervals]
