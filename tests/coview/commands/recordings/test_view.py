"""coview view: a recording as one page, and served."""

import json

import numpy as np
import pytest

from toolkit.datasets.recording_views import read
from toolkit.datasets.recordings import write_recording
from toolkit.tracking.track_files import write_tracks
from toolkit.tracking.tracks import Tracks


@pytest.fixture(scope="module")
def clouds(recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp("view") / "clouds"
    write_recording([next(read(recording, "hdf5"))], folder, "folder")
    return folder


def test_our_recording_becomes_a_page(recording, tmp_path, run):
    out = tmp_path / "view.html"
    code, said, _ = run("view", recording, "--every", 2, "--frames", 1, "--out", out, "--json")
    assert code == 0
    figures = json.loads(said)
    (sample, *_) = read(recording, "hdf5")
    points = len(sample.points())
    assert (figures["frames"], figures["of_frames"], figures["points"]) == (1, 4, points)
    assert figures["said"] == [
        f"000000: {points} points, {len(sample.objects)} labelled, 0 detected"
    ]
    assert "few.hdf5" in out.read_text()
    assert "exists" in run("view", recording, "--out", out)[2]


def test_clouds_with_what_is_detected(clouds, tmp_path, run):
    area = ("--area", -40, -20, 40, 20)
    options = ("--layout", "folder", "--level", "plane", "--detector", "general", *area)
    code, said, _ = run("view", clouds, *options, "--out", tmp_path / "clouds.html", "--json")
    assert code == 0
    assert not json.loads(said)["said"][0].endswith(" 0 detected")


def test_one_frame_as_a_picture(clouds, tmp_path, run, without_packages, work_in):
    """Without viser, of some sensors and classes; the frame is one of those that are chosen."""
    without_packages("viser")
    (tmp_path / "finds.py").write_text(
        "import toolkit.objects as o\ndef none(points): return o.Detections.empty()\n"
    )
    work_in(tmp_path)
    sensor = next(read(clouds, "folder")).clouds[0].name
    options = ("--layout", "folder", "--level", "none", "--colour", "height", "--sensors", sensor)
    chosen = ("--classes", "vehicle", "--detector", "finds:none", "--area", -40, -20, 40, 20)
    code, said, problems = run(
        "view", clouds, *options, *chosen, "--still", tmp_path / "a.png", "--json"
    )
    assert code == 0, problems
    figures = json.loads(said)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert figures["still"] == str(tmp_path / "a.png")
    assert ", 0 detected (0 hits, " in figures["said"]
    assert figures["said"].endswith("0 false alarms, 0 ignored)")


def test_pictures_that_cannot_be_drawn_are_refused(clouds, tmp_path, refused):
    (tmp_path / "a.png").write_bytes(b"")
    arguments = ("view", clouds, "--layout", "folder", "--still")
    assert "there is no frame 1: 1 are chosen" in refused(
        *arguments, tmp_path / "b.png", "--frame", 1
    )
    assert "must end in .png or .svg" in refused(*arguments, tmp_path / "b.jpg")
    assert "--overwrite" in refused(*arguments, tmp_path / "a.png")
    assert "give only one" in refused(*arguments, tmp_path / "b.png", "--out", tmp_path / "b.html")
    assert "no sensor 'west'" in refused(*arguments, tmp_path / "b.png", "--sensors", "west")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("detector", ["tjunction", "voxelnet"])
def test_a_detector_of_one_site_sees_recordings_of_that_site(recording, tmp_path, run, detector):
    out = tmp_path / "a.png"
    code, said, _ = run("view", recording, "--detector", detector, "--still", out)
    assert code == 0
    assert "hits" in said


def test_it_is_served_to_this_machine(clouds, run, monkeypatch):
    monkeypatch.setattr("viser.ViserServer.sleep_forever", lambda self: None)
    code, said, _ = run("view", clouds, "--layout", "folder", "--level", "none", "--port", 18700)
    assert code == 0
    assert said.startswith("http://127.0.0.1:187")


def test_what_is_refused(recording, clouds, tmp_path, refused):
    assert "none.hdf5" in refused("view", tmp_path / "none.hdf5")
    assert "no layout 'kiti'" in refused("view", clouds, "--layout", "kiti")
    assert "--frames must be at least 1" in refused("view", recording, "--frames", 0)
    assert "--every must be at least 1" in refused("view", recording, "--every", 0)
    assert "are for the area" in refused("view", recording, "--detector", "roundabout")
    unknown = ("view", clouds, "--layout", "folder", "--detector")
    assert "needs a site" in refused(*unknown, "voxelnet")
    assert "are for the area" in refused(*unknown, "tjunction")
    assert "port must lie in 1..65535" in refused("view", recording, "--port", 70000)
    assert "--poses does not go with layout hdf5" in refused("view", recording, "--poses", "p.json")
    assert "is empty" in refused("view", recording, "--area", 1, 1, 0, 0)
    assert str(recording) in refused("view", recording, "--out", recording, "--overwrite")


def test_without_viser_it_says_what_to_install(recording, run, without_packages):
    without_packages("viser")
    code, _, err = run("view", recording)
    assert code == 3
    assert "pip install coview[report]" in err


def test_tracks_have_numbers_and_trails(recording, tmp_path, run, refused):
    frames = list(read(recording, "hdf5"))
    tracks = []
    for frame in frames:
        objects = frame.objects
        tracks.append(Tracks(objects.boxes, np.ones(len(objects)), objects.labels, ids=objects.ids))
    path = tmp_path / "tracks.json"
    names = [frame.name for frame in frames]
    times = [frame.time for frame in frames]
    write_tracks(path, names, times, tracks)
    out = tmp_path / "view.html"
    options = ("--tracks", path, "--frames", 2)
    code, said, _ = run("view", recording, *options, "--out", out, "--json")
    assert code == 0
    page = out.read_text()
    assert "/trails" in page
    assert f"{len(frames[0].objects)} detected" in json.loads(said)["said"][0]
    still = tmp_path / "view.png"
    assert run("view", recording, *options, "--frame", 1, "--still", still)[0] == 0
    assert "both give boxes" in refused("view", recording, *options, "--detector", "general")
    write_tracks(path, names[1:], times[1:], tracks[1:])
    line = refused("view", recording, *options, "--still", still, "--overwrite")
    assert "lacks frame '000000' at" in line
