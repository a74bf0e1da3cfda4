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
    simulate_dataset("tjunction", path, interval=0.1, run=Simulation(frames=4, seed=3, workers=1))
    return path


@pytest.mark.one_in(2)
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
@pytest.mark.parametrize("detector", ["tjunction", "voxelnet", "cluster"])
def test_a_detector_of_one_site_goes_with_recordings_of_that_site(
    street, tmp_path, run, refused, detector
):
    out = tmp_path / "tracks.json"
    code, said, _ = run("track", street, "--detector", detector, "--out", out, "--json")
    assert code == 0
    assert json.loads(said)["tracks"] >= 2
    line = refused("track", street, "--detector", "roundabout", "--out", tmp_path / "other.json")
    assert "are for the area -48 -48 48 48 of 'roundabout' alone, got -40 -20 40 20" in line


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


def car(frame, place, score, number=-1):
    """A row of KITTI's tracking text: a car `place` m ahead of a camera 1.65 m above the ground."""
    return (
        f"{frame} {number} Car 0 0 -1 100 150 220 210 1.5 1.8 4.2 2 1.65 {place:.3f} -1.57 {score}"
    )


def write_cars(path, *, frames=range(20), step=0.5):
    """Detections of a car that drives away at 10 times `step` m/s, with logits as scores."""
    rows = [car(frame, 10 + step * frame, 4.2) for frame in frames]
    path.write_text("\n".join(rows))
    return path


@pytest.mark.parametrize("mode", [(), ("--offline",)])
def test_detections_of_others_are_followed(tmp_path, run, mode):
    text = write_cars(tmp_path / "0001.txt")
    out = tmp_path / "tracks.json"
    code, said, _ = run("track", text, "--rate", 10, *mode, "--out", out, "--json")
    assert code == 0
    assert json.loads(said)["tracks"] == 1
    last = json.loads(out.read_text())["frames"][-1]
    (row,) = last["tracks"]
    assert (last["name"], last["time"]) == ("000019", 1.9)
    assert (row["x"], row["y"]) == pytest.approx((19.5, -2), abs=0.2)
    assert row["vx"] == pytest.approx(5, abs=0.5)
    assert 0.9 < row["score"] < 1  # a probability


@pytest.mark.parametrize(
    ("frames", "rate"),
    [
        ([*range(8), *range(12, 20)], 10),  # frames lost
        (range(0, 20, 2), 10),  # a sensor that blinks
        (range(12), 2),  # 2 Hz
    ],
)
def test_gaps_keep_one_number(tmp_path, run, frames, rate):
    text = write_cars(tmp_path / "0001.txt", frames=frames)
    out = tmp_path / "tracks.json"
    options = ("--rate", rate, "--offline", "--out", out, "--json")
    code, said, _ = run("track", text, *options)
    assert code == 0
    assert json.loads(said)["tracks"] == 1
    assert all(len(frame["tracks"]) == 1 for frame in json.loads(out.read_text())["frames"])


def test_texts_that_cannot_be_followed_are_refused(recording, tmp_path, refused):
    text = write_cars(tmp_path / "0001.txt")
    out = ("--out", tmp_path / "tracks.json")
    assert "has no times: give --rate" in refused("track", text, *out)
    assert "--detector does not go" in refused("track", text, "--detector", "tjunction", *out)
    line = refused("track", text, "--rate", 0.5, *out)
    assert "at most 1 s apart, got 2 s" in line
    line = refused("track", recording, "--detections", text, *out)
    assert "has frame 4, which is not among the recording's 4 frames" in line
    row = text.read_text().splitlines()[0].split(" ", 1)[1]
    text.write_text(f"0 {row}\n2000000000 {row}\n")
    line = refused("track", text, "--rate", 10, *out)
    assert "has frame 2000000000: number the frames from 0 to 999999" in line
    text.write_text("")
    assert "has no detections" in refused("track", text, "--rate", 10, *out)


@needs_sumo
def test_detections_next_to_a_recording_have_its_times(street, tmp_path, run, refused):
    text = write_cars(tmp_path / "found.txt", frames=range(4), step=0.2)
    out = tmp_path / "tracks.json"
    assert run("track", street, "--detections", text, "--out", out)[0] == 0
    frames = json.loads(out.read_text())["frames"]
    assert [frame["time"] for frame in frames] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [len(frame["tracks"]) for frame in frames] == [1, 1, 1, 1]
    line = refused("track", street, "--rate", 10, "--out", out, "--overwrite")
    assert "--rate is for recordings without times" in line
