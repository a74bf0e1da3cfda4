"""coview track: on a street at 10 Hz, and on recordings that cannot be tracked."""

import json
from importlib.util import find_spec

import pytest

from toolkit.datasets.simulation import simulate_dataset
from toolkit.runtime.run import Simulation

needs_sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    path = tmp_path_factory.mktemp("street") / "street.hdf5"
    simulate_dataset("tjunction", path, interval=0.1, run=Simulation(frames=4, seed=2, workers=1))
    return path


@needs_sumo
@pytest.mark.parametrize("mode", [(), ("--offline",)])
def test_standing_and_moving_cars_keep_their_numbers(street, tmp_path, run, mode):
    out = tmp_path / "tracks.json"
    code, said, _ = run(
        "track", street, "--detector", "tjunction+background", *mode, "--out", out, "--json"
    )
    assert code == 0
    assert json.loads(said)["frames"] == 4
    frames = json.loads(out.read_text())["frames"]
    ids = [{row["id"] for row in frame["tracks"] if row["score"] > 0.5} for frame in frames]
    assert len(ids[0] & ids[-1]) >= 3
    assert [frame["time"] for frame in frames] == pytest.approx([0.0, 0.1, 0.2, 0.3])


@needs_sumo
def test_tracks_go_to_other_programs_with_their_numbers(street, tmp_path, run):
    out = tmp_path / "tracks.txt"
    assert run("track", street, "--to", "kitti-tracking", "--out", out)[0] == 0
    rows = [line.split() for line in out.read_text().splitlines()]
    assert {row[0] for row in rows} == {"0", "1", "2", "3"}
    assert all(len(row) == 18 for row in rows)


def test_frames_far_apart_are_refused(recording, tmp_path, refused):
    line = refused("track", recording, "--out", tmp_path / "tracks.json")
    assert "tracks need frames at most 1 s apart, got 5 s" in line
    line = refused("track", recording, "--out", tmp_path / "tracks.png")
    assert ".json or .csv" in line
