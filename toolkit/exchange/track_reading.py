"""Files of tracks and detections, ours and other programs', read frame by frame.

| file | frames are known by | lists frames without road users | has |
|---|---|---|---|
| `.json` of `coview track` | name and time | yes | all columns |
| `.json` of OpenLABEL | time, or number without one | yes | cuboids, scores, velocities |
| `.csv` of `coview track` | name and time | no | all columns |
| `.txt` of KITTI's tracking | number | no | boxes, scores, image rectangles |
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import record_values
from toolkit.datasets.record_values import Unchecked, as_list, as_number, entry, name_damage
from toolkit.exchange.instant import Instant
from toolkit.exchange.openlabel_track_reading import parse_openlabel_tracks
from toolkit.exchange.track_frames import TrackFile, TrackFrame, check_rising, make_tracks
from toolkit.exchange.track_text import read_track_text
from toolkit.geometry import BODY_SE3_CAMERA
from toolkit.objects import label_index
from toolkit.runtime.reading import read_bytes
from toolkit.tracking.track_files import TRACK_COLUMNS, TRACKS_VERSION

ENDINGS_READ = (".json", ".csv", ".txt")
_BOX_KEYS = ("x", "y", "z", "length", "width", "height", "yaw_deg")
_OPTIONAL_KEYS = ("score", "vx", "vy", "vz", "age_s", "unseen_s")


def read_track_file(path: Path, world_SE3_camera: Pose = BODY_SE3_CAMERA) -> TrackFile:
    """Read a file of tracks, as the table at the top of this module describes them.

    world_SE3_camera: pose of the camera of KITTI's text, by default one at the world's origin that
    faces along x. Raises ValueError that names the file, OSError if it is missing."""
    ending = path.suffix.lower()
    if ending == ".txt":
        return read_track_text(path, world_SE3_camera)
    if ending not in ENDINGS_READ:
        raise ValueError(
            f"{path} is no file of tracks: its ending must be {', '.join(ENDINGS_READ)}"
        )
    with name_damage(path, "file of tracks"):
        if ending == ".csv":
            return _parse_csv(path, read_bytes(path).decode("utf-8-sig"))
        content = record_values.load_json(path)
        if isinstance(content, dict) and "openlabel" in content:
            return parse_openlabel_tracks(path, entry(content, "openlabel"))
        return _parse_json(path, content)


def _parse_json(path: Path, content: Unchecked) -> TrackFile:
    """Parse the content of a JSON file in the format of `toolkit.tracking.track_files`.

    Raises ValueError for another format or version, and for damaged values. path: the file."""
    version = content.get("coview_tracks") if isinstance(content, dict) else None
    if version != TRACKS_VERSION:
        raise ValueError(
            f'it must be {{"coview_tracks": {TRACKS_VERSION}, "frames": [...]}} or OpenLABEL'
        )
    frames = []
    for number, record in enumerate(as_list(entry(content, "frames"), "frames")):
        name = str(entry(record, "name"))
        time = as_number(entry(record, "time"), f"time of frame {name}")
        rows = as_list(entry(record, "tracks"), f"tracks of frame {name}")
        frames.append(_make_frame(number, name=name, time=time, rows=rows))
    check_rising(frames)
    return TrackFile(path, tuple(frames), is_complete=True, has_times=True, problems={})


def _parse_csv(path: Path, text: str) -> TrackFile:
    """Parse the CSV of `toolkit.tracking.track_files`, a row for each track in each frame.

    Raises ValueError for a missing column, a wrong value, or times that do not rise."""
    table = csv.DictReader(io.StringIO(text))
    missing_columns = [name for name in TRACK_COLUMNS if name not in (table.fieldnames or ())]
    if missing_columns:
        raise ValueError(f"it has no column {', '.join(missing_columns)}")
    rows_by_frame: dict[tuple[str, float], list[Unchecked]] = {}  # by the frame's name and time
    for row in table:
        time = as_number(row["time"], "time")
        rows_by_frame.setdefault((str(row["frame"]), time), []).append(row)
    frames = []
    for number, ((name, time), rows) in enumerate(rows_by_frame.items()):
        frames.append(_make_frame(number, name=name, time=time, rows=rows))
    check_rising(frames)
    # not complete: frames without a track have no row
    return TrackFile(path, tuple(frames), is_complete=False, has_times=True, problems={})


def _make_frame(number: int, name: str, time: float, rows: Sequence[Unchecked]) -> TrackFrame:
    """Make a frame of rows with the names of `TRACK_COLUMNS`.

    number: place of the frame in the file; name: its name in the file; time: its time (s). Scores
    that a row lacks are 1, other values that it may lack NaN or 0. Raises ValueError that names the
    frame."""
    try:
        box_rows = []
        labels = []
        ids = []
        optional_rows = []
        for row in rows:
            box_rows.append([as_number(entry(row, key), key) for key in _BOX_KEYS])
            labels.append(label_index(str(entry(row, "label"))))
            ids.append(int(as_number(entry(row, "id"), "id")))
            optional_rows.append([as_number(row.get(key, np.nan), key) for key in _OPTIONAL_KEYS])
        # columns: score, velocity x y z (m/s), age and time unseen (s)
        optional_values = np.array(optional_rows, np.float64).reshape(-1, len(_OPTIONAL_KEYS))
        scores = optional_values[:, 0]
        boxes = np.array(box_rows, np.float64).reshape(-1, 7)
        boxes[:, 6] = np.deg2rad(boxes[:, 6])  # yaw
        instant = Instant(
            time,
            boxes=boxes,
            labels=np.array(labels, np.int64),
            scores=np.where(np.isnan(scores), 1.0, scores),
            ids=np.array(ids, np.int64),
            velocities=optional_values[:, 1:4],
        )
    except ValueError as error:
        raise ValueError(f"frame {name!r}: {error}") from None
    ages, unseen = np.nan_to_num(optional_values[:, 4:]).T
    tracks = make_tracks(instant, ages=ages, unseen=unseen)
    rectangles = np.full((len(tracks), 4), np.nan)  # these files know no images
    return TrackFrame(number, name=name, time=time, tracks=tracks, rectangles=rectangles)
