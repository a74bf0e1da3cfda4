"""coview label: tracks become labels that coview reads back, the most doubtful first."""

import csv
import json

import numpy as np
import pytest

from toolkit.datasets.recording_views import read
from toolkit.datasets.recordings import write_recording
from toolkit.tracking.track_files import write_tracks
from toolkit.tracking.tracks import Tracks

FRAMES = 12
CAR = np.array([10.0, 2, 0.75, 4.5, 1.9, 1.5, 0.0])


@pytest.fixture(scope="module")
def clouds(recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp("label") / "clouds"
    frame = next(read(recording, "hdf5"))
    write_recording([frame] * FRAMES, folder, "folder")
    return folder


@pytest.fixture
def tracks(tmp_path):
    """A sure car, a car that jumps to and fro, and an unsure pedestrian of three frames."""
    path = tmp_path / "tracks.json"
    frames = []
    for k in range(FRAMES):
        ids = [7, 8, 9] if k < 3 else [7, 8]
        boxes = np.tile(CAR, (len(ids), 1))
        boxes[1, :2] = 20.0 + 3.0 * (k % 2), -2.0
        boxes[2:, :6] = [0, 9, 0.9, 0.6, 0.6, 1.8]
        labels = np.array([0, 0, 2][: len(ids)])
        scores = np.array([0.9, 0.9, 0.4][: len(ids)])
        frames.append(Tracks(boxes, scores, labels, ids=np.array(ids)))
    names = [f"{k:06d}" for k in range(FRAMES)]
    write_tracks(path, names, [0.1 * k for k in range(FRAMES)], frames)
    return path


@pytest.mark.one_in(2)
@pytest.mark.parametrize("layout", ["sustech", "openlabel", "folder", "kitti"])
def test_labels_come_back_with_their_numbers(clouds, tracks, tmp_path, run, layout):
    out = tmp_path / "labelled"
    options = ("--tracks", tracks, "--to", layout, "--out", out, "--json")
    code, said, problems = run("label", clouds, *options)
    assert code == 0, problems
    figures = json.loads(said)
    assert (figures["frames"], figures["tracks"]) == (FRAMES, 3)
    frames = list(read(out, layout))
    assert [len(frame.objects) for frame in frames] == [3] * 3 + [2] * (FRAMES - 3)
    order = np.argsort(frames[0].objects.ids)
    if layout != "kitti":  # labels of single frames
        assert frames[0].objects.ids[order].tolist() == [7, 8, 9]
    assert frames[0].objects.boxes[:, :3].min(axis=0) == pytest.approx([0, -2, 0.75], abs=1e-3)


def test_the_most_doubtful_is_first(clouds, tracks, tmp_path, run):
    out = tmp_path / "labels.json"
    code, said, _ = run("label", clouds, "--tracks", tracks, "--out", out)
    assert code == 0
    with (tmp_path / "labels-doubtful.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["id"] for row in rows] == ["9", "8", "7"]
    assert rows[0]["reasons"] == "unsure; short"
    assert rows[1]["reasons"] == "jumps"
    assert (rows[2]["reasons"], rows[2]["doubt"]) == ("", "0.100")
    assert (rows[0]["first_frame"], rows[0]["last_frame"]) == ("000000", "000002")
    assert "pedestrian 9: doubt 0.88, unsure, short, frames 000000 to 000002" in said
    samples = json.loads(out.read_text())["samples"]
    assert [row["id"] for row in samples[0]["objects"]] == [7, 8, 9]


def test_what_does_not_fit_is_refused(clouds, tracks, tmp_path, refused):
    label = ("label", clouds, "--tracks", tracks)
    out = tmp_path / "labelled"
    assert "no folder that annotators open" in refused(*label, "--to", "hdf5", "--out", out)
    assert "is only read" in refused(*label, "--to", "rcooper", "--out", out)
    content = json.loads(tracks.read_text())
    frame = content["frames"].pop()
    tracks.write_text(json.dumps(content))
    assert "lacks frame '000011'" in refused(*label, "--out", out)
    content["frames"] += [frame, frame | {"name": "000012", "time": 1.2}]
    tracks.write_text(json.dumps(content))
    assert "has frame '000012' at 1.2" in refused(*label, "--out", out)
    assert not out.exists()
