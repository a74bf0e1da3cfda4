"""Files of tracks hold what was tracked."""

import csv
import json

import numpy as np
import pytest

from toolkit.tracking.track_files import TRACK_COLUMNS, write_tracks
from toolkit.tracking.tracks import Tracks

NOW = Tracks(
    np.array([[1.0, 2, 0.8, 4.5, 1.9, 1.6, np.pi / 2], [9, 9, 1, 0.6, 0.5, 1.8, 0]]),
    np.array([0.9, 0.4]),
    np.array([0, 2]),
    ids=np.array([7, 3]),
    velocities=np.array([[0.0, 8.0, 0.0], [1.0, 0.0, 0.0]]),
    ages=np.array([2.5, 0.0]),
    unseen=np.array([0.0, 0.1]),
)
FIRST = {
    "id": 7,
    "label": "vehicle",
    "x": 1.0,
    "y": 2.0,
    "z": 0.8,
    "length": 4.5,
    "width": 1.9,
    "height": 1.6,
    "yaw_deg": 90.0,
    "score": 0.9,
    "vx": 0.0,
    "vy": 8.0,
    "vz": 0.0,
    "age_s": 2.5,
    "unseen_s": 0.0,
}


def test_json_has_a_record_for_each_frame(tmp_path):
    path = tmp_path / "tracks.json"
    write_tracks(path, ["a", "b"], [0.0, 0.1], [NOW, Tracks.empty()])
    content = json.loads(path.read_text())
    assert content["coview_tracks"] == 1
    first, second = content["frames"]
    assert first["tracks"][0] == FIRST
    assert second == {"name": "b", "time": 0.1, "tracks": []}


def test_csv_has_a_row_for_each_track(tmp_path):
    path = tmp_path / "tracks.csv"
    write_tracks(path, ["a"], [0.0], [NOW])
    with path.open(newline="") as file:
        header, first, second = csv.reader(file)
    assert header == list(TRACK_COLUMNS)
    assert dict(zip(header[2:], first[2:], strict=True)) == {k: str(v) for k, v in FIRST.items()}
    assert second[:4] == ["a", "0.0", "3", "pedestrian"]


def test_each_frame_needs_a_name_and_a_time(tmp_path):
    with pytest.raises(ValueError, match="got 1 names and 2 times for 2 frames"):
        write_tracks(tmp_path / "tracks.json", ["a"], [0.0, 0.1], [NOW, NOW])
