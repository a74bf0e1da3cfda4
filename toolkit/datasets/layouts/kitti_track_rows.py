"""Rows of KITTI's tracking text: labels, tracks or detections of one sequence.

- A row of the benchmark is a label of the object benchmark (`toolkit.datasets.layouts.kitti`) after
  the number of its frame and its track; a DontCare has the track -1. Results may end in a score.
- Detections as AB3DMOT takes them have commas: frame, class (1 pedestrian, 2 car, 3 cyclist), left,
  top, right, bottom, score, h, w, l, x, y, z, ry, alpha. They have no tracks.
"""

from pathlib import Path

import numpy as np

from toolkit.datasets import record_values
from toolkit.datasets.layouts.kitti import LabelRows
from toolkit.runtime.reading import read_bytes

NUMBERED_KINDS = {1: "Pedestrian", 2: "Car", 3: "Cyclist"}
NO_TRACK = "-1"
_COMMA_ENTRIES = 15


def read_track_rows(path: Path) -> dict[int, LabelRows]:
    """Read the labels of each frame of a text file, by the frame's number.

    Cells of a line: frame, track, the 15 columns of KITTI's labels, and perhaps a score. Raises
    ValueError that names the file."""
    rows: dict[int, list[list[str]]] = {}
    with record_values.name_damage(path, "list of labels"):
        for line in read_bytes(path).decode("utf-8-sig").splitlines():
            cells = line.split()
            if not cells:
                continue
            if "," in line:
                cells = _order_commas([cell.strip() for cell in line.split(",")])
            if len(cells) not in (17, 18):
                raise ValueError(f"a line must have 17 or 18 entries, got {len(cells)}")
            rows.setdefault(parse_whole(cells[0], "frame"), []).append(cells)
        labels = {}
        for number, cells_of_frame in rows.items():
            ids = [str(parse_whole(cells[1], "track")) for cells in cells_of_frame]
            parsed_rows = LabelRows.parse([cells[2:17] for cells in cells_of_frame], ids)
            scores = [_parse_score(cells) for cells in cells_of_frame]
            labels[number] = parsed_rows._replace(scores=np.array(scores))
    return labels


def _parse_score(cells: list[str]) -> float:
    """Parse the score at the end of a row, NaN without one."""
    return record_values.as_number(cells[17], "score") if len(cells) > 17 else float("nan")


def _order_commas(cells: list[str]) -> list[str]:
    """Return a row of AB3DMOT's detections in the order of the benchmark's rows.

    cells: frame, number of the class, rectangle (4), score, box (7), alpha. The benchmark's rows
    have frame, track, class, truncation, occlusion, alpha, rectangle, box, score."""
    if len(cells) != _COMMA_ENTRIES:
        raise ValueError(f"a line with commas must have 15 entries, got {len(cells)}")
    code = parse_whole(cells[1], "class")
    if code not in NUMBERED_KINDS:
        raise ValueError(f"a class must be 1 (pedestrian), 2 (car) or 3 (cyclist), got {code}")
    rectangle = cells[2:6]
    box = cells[7:14]
    score = cells[6]
    alpha = cells[14]
    return [cells[0], NO_TRACK, NUMBERED_KINDS[code], "0", "0", alpha, *rectangle, *box, score]


def parse_whole(text: str, name: str) -> int:
    """Parse a whole number. Raises ValueError that names it."""
    value = record_values.as_number(text, name)
    if value != np.trunc(value) or not abs(value) < 2**31:
        raise ValueError(f"{name} must be a whole number, got {text[:40]!r}")
    return int(value)
