"""Files of tracks: JSON and CSV."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from toolkit.objects import LABELS
from toolkit.runtime.writing import write_text
from toolkit.tracking.tracks import Tracks

TRACKS_VERSION = 1
TRACK_COLUMNS = (
    *("frame", "time", "id", "label", "x", "y", "z", "length", "width", "height", "yaw_deg"),
    *("score", "vx", "vy", "vz", "age_s", "unseen_s"),
)


def write_tracks(
    path: str | Path, names: Sequence[str], times: Sequence[float], tracks: Sequence[Tracks]
) -> None:
    """Write the tracks of all frames, as CSV if the file's name ends so, else as JSON.

    Args:
        path: File.
        names: Name of each frame.
        times: Time of each frame (s).
        tracks: Tracks in each frame.

    Raises ValueError if there are not as many of each, OSError as
    `toolkit.runtime.writing.write_text`."""
    if not len(names) == len(times) == len(tracks):
        raise ValueError(
            f"each frame needs a name and a time, got {len(names)} names and {len(times)} times "
            f"for {len(tracks)} frames"
        )
    frames = []
    for name, time, frame_tracks in zip(names, times, tracks, strict=True):
        frames.append((name, float(time), _list_rows(frame_tracks)))
    if Path(path).suffix.lower() == ".csv":
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(TRACK_COLUMNS)
        for name, time, rows in frames:
            writer.writerows([name, time, *row.values()] for row in rows)
        write_text(Path(path), text.getvalue())
        return
    records = [{"name": name, "time": time, "tracks": rows} for name, time, rows in frames]
    lines = ",\n".join(json.dumps(record, allow_nan=False) for record in records)
    write_text(Path(path), f'{{"coview_tracks": {TRACKS_VERSION}, "frames": [\n{lines}\n]}}\n')


def _list_rows(tracks: Tracks) -> list[dict[str, object]]:
    """Values of each track by name: `TRACK_COLUMNS` without the first two, frame and time."""
    # columns from x to unseen_s: box with yaw in degrees, score, velocity, age, time unseen
    numbers = np.column_stack([tracks.boxes[:, :6], np.rad2deg(tracks.boxes[:, 6]), tracks.scores])
    numbers = np.column_stack([numbers, tracks.velocities, tracks.ages, tracks.unseen])
    rows = []
    for track_id, label, values in zip(
        tracks.ids.tolist(), tracks.labels.tolist(), numbers.round(6).tolist(), strict=True
    ):
        rows.append(dict(zip(TRACK_COLUMNS[2:], (track_id, LABELS[label], *values), strict=True)))
    return rows
