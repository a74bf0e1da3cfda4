"""Mistakes on the command line: each is refused in one line, before any work, also where an answer exists already."""

import shutil
from pathlib import Path

import pytest

import coview
from coview.main import run as run_line

MAP = Path(coview.__file__).parents[1] / "docs/own-junction.osm"
OLD = {"plan": "plan.json", "evaluate": "table.json", "stress": "stress.json"}  # an answer that is there already


@pytest.fixture(scope="session")
def clouds(recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp("mistaken clouds é")
    for layout in ("folder", "kitti", "opv2v", "rosbag"):
        assert (
            run_line(["convert", str(recording), "--frames", "1", "--to", layout, "--out", str(folder / layout)]) == 0
        )
    shutil.copytree(folder / "folder", folder / "bare")
    (folder / "bare/labels.json").unlink()
    (folder / "note.txt").write_text("a note")
    (folder / "old.png").write_text("a picture")
    return folder


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("plan tjunction --min-ap 2", "min_ap must lie above 0 and up to 1, got 2"),
        ("plan tjunction --codec zip", "unknown codec 'zip': choose among"),
        ("plan tjunction --detector nowhere", "no weights named 'nowhere'; shipped: general"),
        ("plan tjunction --candidates nowhere.geojson", "no file 'nowhere.geojson'"),
        ("plan tjunction --class-weights 1 2", "--class-weights needs a weight for each"),
        ("plan tjunction --sensors nowhere.toml", "cannot use nowhere.toml"),
        ("plan tjunction --failing 4", "failing must be 0 to 2 sensors, got 4"),
        ("plan nowhere", "no site 'nowhere': give a file, or one of roundabout, tjunction"),
        (f"plan {MAP}", "is a map, of which a site must be made first: coview site import --osm"),
        ("evaluate REC --detector nowhere", "no weights named 'nowhere'"),
        ("evaluate REC --sensors d9", "no sensor 'd9': choose among 0..5 or d0"),
        ("evaluate REC --schemes earl", "there is no fusion scheme 'earl'"),
        ("evaluate REC --iou 70", "--iou must lie above 0 and at most at 1, got 70"),
        ("evaluate REC --codec zip", "unknown codec 'zip'"),
        ("evaluate REC --step 3", "--step must lie between 0 and 1, got 3"),
        ("evaluate REC --calibrate nowhere", "no site 'nowhere'"),
        ("evaluate REC --detector tjunction --area -10 -10 10 10", "give that area (--area -40 -20 40 20)"),
        ("stress REC --kinds rain", "there is no kind of stress 'rain': choose among bytes"),
        ("evaluate REC --layout kiti", "there is no layout 'kiti'"),
        ("evaluate REC --poses nowhere.json", "--poses does not go with layout hdf5"),
        ("evaluate REC --area 10 10 -10 -10", "area is empty: it needs xmin < xmax"),
        ("evaluate CLOUDS/bare --detector general", "the recording has no label, so nothing can be scored"),
    ],
)
def test_an_argument_is_refused_before_an_old_answer(line, said, refused, recording, clouds, tmp_path):
    name, *rest = line.split(" ")
    (tmp_path / OLD[name]).write_text("{}")
    rest = [str(recording) if each == "REC" else each.replace("CLOUDS", str(clouds)) for each in rest]
    assert said in refused(name, *rest, "--out", tmp_path)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("survey CLOUDS/opv2v", "has layout opv2v or v2xset or v2xreal: say by --layout which it is"),
        ("survey CLOUDS/rosbag", "give the recording in it, "),
        ("survey CLOUDS", "neither NAME.pcd nor SENSOR/NAME.pcd: give --layout, or another folder"),
        ("stress CLOUDS/kitti", "recorded clouds of an unknown site: give a recording of coview simulate, or take"),
        ("stress REC --detector nowhere", "no weights named 'nowhere'"),
        ("detect CLOUDS/folder --detector tjunction --out b.json", "give that area (--area -40 -20 40 20)"),
        (
            "detect CLOUDS/folder --detector general+background --out b.json",
            "in a single frame everything stands still",
        ),
        ("survey CLOUDS/note.txt", "is no recording: its ending is none of .hdf5, .h5, .bag"),
        ("view REC --sensors 9 --still CLOUDS/old.png", "no sensor 9: choose among 0..5 or d0"),
        ("view REC --frame 9 --still CLOUDS/old.png", "there is no frame 9: "),
        ("site show nowhere", "no site 'nowhere'"),
        (f"simulate {MAP} --out x.hdf5", "is a map, of which a site must be made first"),
        ("view REC --detector nowhere --still x.png", "no weights named 'nowhere'"),
    ],
)
def test_what_a_mistake_is_told(line, said, refused, recording, clouds):
    words = [str(recording) if each == "REC" else each.replace("CLOUDS", str(clouds)) for each in line.split(" ")]
    assert said in refused(*words)


def test_a_folder_shows_its_layout(run, clouds):
    code, out, err = run("survey", clouds / "kitti")
    assert (code, "read as layout kitti" in err, "vehicle" in out) == (0, True, True)


def test_a_plan_that_says_no_is_replaced(run, tmp_path):
    line = ("plan", "tjunction", "--candidates", "paper", "--budget", "0", "--cache", "None", "--out", tmp_path)
    assert [run(*line)[0], run(*line, "--seed", "1")[0]] == [1, 1]
