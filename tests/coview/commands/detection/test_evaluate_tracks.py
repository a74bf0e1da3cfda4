"""coview evaluate --tracks: a street whose truth is its tracks, and files that do not fit."""

import json
from importlib.util import find_spec

import numpy as np
import pytest

from toolkit.datasets.recordings import open_recording
from toolkit.datasets.simulation import simulate_dataset
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import open_writer
from toolkit.runtime.run import Simulation
from toolkit.tracking.track_files import write_tracks
from toolkit.tracking.tracks import Tracks

pytestmark = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
FRAMES = 6


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    path = tmp_path_factory.mktemp("street") / "street.hdf5"
    run = Simulation(frames=FRAMES, seed=2, workers=1)
    simulate_dataset("tjunction", path, interval=0.1, run=run)
    return path


@pytest.fixture(scope="module")
def truth(street):
    """Names, times, and the true objects as tracks, of each frame."""
    recording = open_recording(street)
    frames = [recording[k] for k in range(len(recording))]
    tracks = []
    for frame in frames:
        objects = frame.objects
        tracks.append(Tracks(objects.boxes, np.ones(len(objects)), objects.labels, ids=objects.ids))
    return [frame.name for frame in frames], [frame.time for frame in frames], tracks


def write(path, truth):
    """Write tracks in the format of the file's ending."""
    names, times, tracks = truth
    if path.suffix == ".txt" or path.stem == "openlabel":
        kind = "openlabel" if path.stem == "openlabel" else "kitti-tracking"
        with open_writer(kind, path) as writer:
            for time, now in zip(times, tracks, strict=True):
                writer.write(Instant.from_tracks(time, now))
    else:
        write_tracks(path, names, times, tracks)
    return path


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", ["tracks.json", "tracks.csv", "tracks.txt", "openlabel.json"])
def test_the_truth_scores_one_in_every_format(street, truth, tmp_path, run, name):
    path = write(tmp_path / name, truth)
    out = tmp_path / "scores"
    code, said, _ = run("evaluate", street, "--tracks", path, "--out", out, "--json")
    assert code == 0
    found = json.loads(said)
    assert {row["label"] for row in found["rows"]} >= {"vehicle"}
    assert all(row["ap"] == pytest.approx(1) for row in found["rows"])
    for row in found["tracks"]:
        shares = [row[key] for key in ("hota", "deta", "assa", "mota", "idf1", "mostly_tracked")]
        assert shares == pytest.approx([1.0] * 6), row
        assert (row["switches"], row["threshold"]) == (0, 0.5)
        assert row["heading_error_deg"] == pytest.approx(0, abs=1e-3)
    vehicles = found["tracks"][0]
    # OpenLABEL and ours have velocities, here of standing ones; KITTI's text has none
    assert (vehicles["speed_error_mps"] is None) == (name == "tracks.txt")
    assert json.loads((out / "table.json").read_text()) == found
    code, said, _ = run("evaluate", street, "--tracks", path, "--out", out, "--overwrite")
    assert "HOTA" in said
    assert "first detection" in said


def test_similarities_and_first_frames_are_chosen(street, truth, tmp_path, run):
    path = write(tmp_path / "tracks.json", truth)
    options = ("--frames", 3, "--similarity", 0.25, 0.7, "--classes", "vehicle", "--iou", 0.5)
    out = tmp_path / "scores"
    _, said, _ = run("evaluate", street, "--tracks", path, *options, "--out", out, "--json")
    found = json.loads(said)
    assert found["frames"] == 3
    assert [row["threshold"] for row in found["tracks"]] == [0.25, 0.7]
    assert [(row["label"], row["iou"]) for row in found["rows"]] == [("vehicle", 0.5)]


def test_what_does_not_match_is_refused_by_name(street, truth, tmp_path, refused):
    names, times, tracks = truth
    path = tmp_path / "tracks.json"
    evaluate = ("evaluate", street, "--tracks", path, "--out", tmp_path / "scores")
    write_tracks(path, names[:4], times[:4], tracks[:4])
    assert f"tracks.json lacks 2 of {FRAMES} frames" in refused(*evaluate)
    write_tracks(path, names, [time + 3 for time in times], tracks)
    assert "which is not among the recording's 6" in refused(*evaluate)
    shift = np.array([900.0, 0, 0, 0, 0, 0, 0])
    moved = [Tracks(now.boxes + shift, now.scores) for now in tracks]
    write_tracks(path, names, times, moved)
    assert "comes within 5 m of a true one" in refused(*evaluate)
    path.write_text(path.read_text().replace('"vehicle"', '"rocket"'))
    assert "rocket" in refused(*evaluate)
    text = tmp_path / "tracks.txt"
    write(text, truth)
    text.write_text(f"{text.read_text()}40{text.read_text().splitlines()[0][1:]}\n")
    assert "has frame 40" in refused(*evaluate[:3], text, *evaluate[4:])


def test_options_of_detectors_are_refused(street, tmp_path, refused):
    path = tmp_path / "tracks.json"
    evaluate = ("evaluate", street, "--tracks", path)
    assert "no such file of tracks" in refused(*evaluate)
    assert "--detector does not go with --tracks" in refused(*evaluate, "--detector", "general")
    assert "--schemes does not go" in refused(*evaluate, "--schemes", "early")
    assert "--similarity is for --tracks" in refused("evaluate", street, "--similarity", 0.5)
    assert "--codec and --step" in refused(*evaluate, "--step", 0.04)


def test_labels_of_others_are_scored_without_clouds(truth, tmp_path, run):
    labels = write(tmp_path / "labels.txt", truth)
    path = write(tmp_path / "tracks.json", truth)
    arguments = ("evaluate", labels, "--tracks", path, "--rate", 10, "--out", tmp_path / "scores")
    code, said, _ = run(*arguments, "--json")
    assert code == 0
    assert json.loads(said)["tracks"][0]["hota"] == pytest.approx(1)
