"""coview count and coview conflicts: of a site, of a recording, and of what cannot be counted."""

import csv
import json
from importlib.util import find_spec

import numpy as np
import pytest

from toolkit.datasets.recordings import open_recording
from toolkit.datasets.simulation import simulate_dataset
from toolkit.runtime.run import Simulation
from toolkit.tracking.track_files import write_tracks
from toolkit.tracking.tracks import Tracks

needs_sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    path = tmp_path_factory.mktemp("street") / "street.hdf5"
    simulate_dataset("tjunction", path, interval=0.5, run=Simulation(frames=6, seed=2, workers=1))
    return path


@needs_sumo
def test_a_site_is_counted_by_its_traffic(tmp_path, run):
    flow = tmp_path / "flow.csv"
    flow.write_text("kind,entry,exit,per_hour\nvehicle,north,south,900\n")
    table = tmp_path / "counts.csv"
    picture = tmp_path / "counts.svg"
    code, said, _ = run(
        *("count", "tjunction", "--hours", "0.05", "--flow", flow, "--seed", "1"),
        *("--out", table, "--diagram", picture, "--json"),
    )
    assert code == 0
    result = json.loads(said)
    assert result["counted"] == "truth"
    assert result["seconds"] == pytest.approx(180)
    assert {(row["entry"], row["exit"]) for row in result["movements"]} == {("north", "south")}
    vehicles = result["totals"][0]
    assert vehicles["group"] == "vehicles"
    assert 25 <= vehicles["count"] <= 65  # 45 expected
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(int(row["count"]) for row in rows) == vehicles["count"]
    assert b"<svg" in picture.read_bytes()


@needs_sumo
def test_a_recording_is_counted_next_to_its_truth(street, tmp_path, run):
    tracks = tmp_path / "tracks.json"
    detector = ("--detector", "tjunction+background")
    assert run("track", street, *detector, "--offline", "--out", tracks)[0] == 0
    code, by_tracks, _ = run("count", street, "--tracks", tracks, "--json")
    assert code == 0
    code, by_detector, _ = run("count", street, *detector, "--json")
    assert code == 0
    assert json.loads(by_tracks)["totals"] == json.loads(by_detector)["totals"]
    row = json.loads(by_tracks)["totals"][0]
    assert row["error"] == row["count"] - row["true_count"]
    code, said, _ = run("count", street, "--tracks", tracks)
    assert "counted by tracks" in said


@needs_sumo
def test_tracks_may_leave_out_frames_without_road_users_and_must_be_of_the_recording(
    street, tmp_path, run, refused
):
    recording = open_recording(street)
    frames = [recording[k] for k in range(len(recording))]
    names = [frame.name for frame in frames]
    times = [frame.time for frame in frames]
    tracks = [Tracks(frame.objects.boxes, np.ones(len(frame.objects))) for frame in frames]
    tracks[2] = Tracks.empty()
    results = []
    for name in ("tracks.json", "tracks.csv"):
        path = tmp_path / name
        write_tracks(path, names, times, tracks)
        code, said, _ = run("count", street, "--tracks", path, "--json")
        assert code == 0
        results.append(json.loads(said))
    assert results[0] == results[1]
    path = tmp_path / "tracks.csv"
    write_tracks(path, names, [time + 3 for time in times], tracks)
    assert "which is not among the recording's 6" in refused("count", street, "--tracks", path)
    path = tmp_path / "tracks.json"
    write_tracks(path, names[:4], times[:4], tracks[:4])
    assert "lacks 2 of 6 frames" in refused("conflicts", street, "--tracks", path)
    code, said, _ = run("count", street, "--tracks", path, "--frames", 4, "--json")
    assert code == 0
    assert json.loads(said)["seconds"] == pytest.approx(1.5)


@needs_sumo
def test_conflicts_of_a_site_and_of_a_recording(street, tmp_path, run):
    table = tmp_path / "conflicts.csv"
    code, said, _ = run(
        *("conflicts", "roundabout", "--hours", "0.03", "--max-pet", "3"),
        *("--out", table, "--json"),
    )
    assert code == 0
    conflicts = json.loads(said)["conflicts"]
    assert conflicts
    assert all(row["pet_s"] <= 3 for row in conflicts)
    with table.open(newline="") as file:
        assert len(list(csv.DictReader(file))) == len(conflicts)
    code, said, _ = run("conflicts", street, "--detector", "tjunction+background", "--json")
    assert code == 0
    assert "found_share" in json.loads(said)
    # in three seconds nothing is near: no share of nothing
    code, said, _ = run("conflicts", street, "--detector", "tjunction+background")
    assert code == 0
    assert said.splitlines()[1:] == ["true 0"]


def test_what_cannot_be_counted_is_refused(recording, tmp_path, refused):
    assert "at most 1 s apart, got 5 s" in refused("count", recording)
    assert "--hours must be above 0" in refused("count", "tjunction", "--hours", "0")
    assert "--max-pet must be at most 5" in refused("conflicts", recording, "--max-pet", "9")
    assert "are for a site" in refused("count", recording, "--hours", "2")
    assert "--tracks is for a recording" in refused("count", "tjunction", "--tracks", recording)
    assert ".csv" in refused("count", recording, "--out", tmp_path / "counts.json")
    assert ".png or .svg" in refused("count", recording, "--diagram", tmp_path / "counts.gif")
    assert "no weights named 'nobody'" in refused("count", recording, "--detector", "nobody")
