"""Mistakes on the command line: each is refused in one line, before any work, also where an answer
exists already."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import coview
from coview.main import run as run_line

MAP = Path(coview.__file__).parents[1] / "docs/own-junction.osm"
# an answer that is there already
OLD = {"plan": "plan.json", "evaluate": "table.json", "stress": "stress.json"}


@pytest.fixture(scope="session")
def clouds(recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp("mistaken clouds é")
    for layout in ("folder", "kitti", "opv2v", "rosbag"):
        assert (
            run_line(
                [
                    "convert",
                    str(recording),
                    "--frames",
                    "1",
                    "--to",
                    layout,
                    "--out",
                    str(folder / layout),
                ]
            )
            == 0
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
        (
            "evaluate REC --detector tjunction --area -10 -10 10 10",
            "give that area (--area -40 -20 40 20)",
        ),
        ("stress REC --kinds rain", "there is no kind of stress 'rain': choose among bytes"),
        ("evaluate REC --layout kiti", "there is no layout 'kiti'"),
        ("evaluate REC --poses nowhere.json", "--poses does not go with layout hdf5"),
        ("evaluate REC --area 10 10 -10 -10", "area is empty: it needs xmin < xmax"),
        ("evaluate REC --detector nomodule:detect", "detector nomodule:detect cannot be imported"),
        ("evaluate REC --detector os:name", "detector os:name must be callable, got str"),
        ("evaluate REC --errors bad", "unknown error profile 'bad': choose among paper"),
        ("evaluate REC --rate 0", "--rate must be above 0, got 0"),
        ("plan tjunction --width 2", "--width must lie between 0 and 1, got 2"),
        (
            "evaluate CLOUDS/bare --detector general",
            "the recording has no label, so nothing can be scored",
        ),
        (
            "evaluate REC --schemes early early",
            "--schemes takes each value once, got early early: leave the",
        ),
        ("evaluate REC --sensors all all", "--sensors takes each value once, got all all"),
        (
            "evaluate REC --classes",
            "--classes needs one value or several: leave it out for the usual ones",
        ),
        (
            "stress REC --kinds",
            "--kinds needs one value or several: leave it out for the usual ones",
        ),
        ("stress REC --kinds pose pose", "--kinds takes each value once, got pose pose"),
        (
            "stress REC --schemes late early late",
            "--schemes takes each value once, got late early late",
        ),
    ],
)
def test_an_argument_is_refused_before_an_old_answer(
    line, said, refused, recording, clouds, tmp_path
):
    name, *rest = line.split(" ")
    (tmp_path / OLD[name]).write_text("{}")
    rest = [
        str(recording) if each == "REC" else each.replace("CLOUDS", str(clouds)) for each in rest
    ]
    assert said in refused(name, *rest, "--out", tmp_path)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "survey CLOUDS/opv2v",
            "has layout opv2v or v2xset or v2xreal: say by --layout which it is",
        ),
        ("survey CLOUDS/rosbag", "give the recording in it, "),
        ("survey CLOUDS", "1 .png: give --layout, or another folder"),
        (
            "stress CLOUDS/kitti",
            "recorded clouds of an unknown site: give a recording of coview simulate, or take",
        ),
        ("stress REC --detector nowhere", "no weights named 'nowhere'"),
        (
            "detect CLOUDS/folder --detector tjunction --out b.json",
            "give that area (--area -40 -20 40 20)",
        ),
        (
            "detect CLOUDS/folder --detector general+background --out b.json",
            "1 frames do not distinguish what waits from what belongs to the site",
        ),
        ("survey CLOUDS/note.txt", "is no recording: its ending is none of .hdf5, .h5, .bag"),
        ("view REC --sensors 9 --still CLOUDS/old.png", "no sensor 9: choose among 0..5 or d0"),
        ("view REC --frame 9 --still CLOUDS/old.png", "there is no frame 9: "),
        ("site show nowhere", "no site 'nowhere'"),
        (f"simulate {MAP} --out x.hdf5", "is a map, of which a site must be made first"),
        ("view REC --detector nowhere --still x.png", "no weights named 'nowhere'"),
        (
            "simulate tjunction --out x.txt",
            "the name of a recording must end in .hdf5 or .h5, got x.txt",
        ),
        (
            "simulate tjunction --out x.hdf5 --frames -3",
            "frames must be a whole number of at least 1, got -3",
        ),
        ("simulate tjunction --out x.hdf5 --every 0", "interval must "),
        (
            "simulate REC --out x.hdf5",
            "is a recording, no site: give the file of its site, or one of",
        ),
        (
            "survey tjunction",
            "tjunction is a site, no recording: make one with coview simulate tjunction --out",
        ),
        ("survey nowhere.hdf5", "no dataset nowhere.hdf5: check the path"),
        ("detect tjunction --out b.json", "tjunction is a site, no recording"),
        ("detect REC --out REC", "the name of a file of boxes must end in .json, got few.hdf5"),
        (
            "detect REC --out boxes.txt",
            "the name of a file of boxes must end in .json, got boxes.txt: it is known by",
        ),
        (
            "detect REC --detector a.b:c --out b.json",
            "detector a.b:c cannot be imported (ModuleNotFoundError",
        ),
        (
            "convert REC --to kitti --out k.hdf5",
            "layout kitti is a folder, which cannot be called k.hdf5",
        ),
        (
            "convert REC --to hdf5 --out k",
            "the name of a recording in layout hdf5 must end in .hdf5 or .h5, got k",
        ),
        ("convert REC --to kiti --out k", "there is no layout 'kiti': choose among folder, kitti"),
        ("pack nowhere.hdf5 --out p.packed", "no dataset nowhere.hdf5: check the path"),
        (
            "train --data REC --out runs",
            "is damaged or not a packed file (it is a recording): make it again with coview",
        ),
        ("train --data nowhere --out runs", "no packed file nowhere: make it with coview pack"),
        (
            "calibrate REC --out c.json",
            "4 frames are too few to tell what stands still from who passes",
        ),
        ("doctor REC --frames 0", "--frames must be at least 1, got 0"),
        (
            "view REC --out a.html --still a.png",
            "--out writes a page, --still a picture: give only one",
        ),
        ("view REC --port 99999", "port must lie in 1..65535, got 99999"),
        ("site show tjunction --out t.txt", "a picture's name must end in .png or .svg, got t.txt"),
        (
            "site export tjunction --out t.png",
            "the name of the export must end in .json or .geojson, got t.png",
        ),
        (
            "site random --seed 1 --out r.png",
            "the name of a site's file must end in .json or .geojson, got r.png",
        ),
        (
            f"site import --osm {MAP} --centre 49.5 8 --size 70 50 --out j.json",
            "longitude comes first, give --centre 8 49.5",
        ),
        (
            f"site import --osm {MAP} --centre 8 49.5 --size 70000 50 --out j.json",
            "at most 1000 m, got (70000.0, 50.0)",
        ),
        (
            f"site import --opendrive {MAP} --centre 8 49.5 --size 7 5 --out j.json",
            "give an .xodr file",
        ),
        (
            f"search tjunction --candidates {MAP}",
            "is no GeoJSON: save the poles as points in a .geojson file",
        ),
        (
            (
                f"site import --osm {MAP} --centre 8 49.5 --size 70 50 --out j.json --bearing 60 "
                "--heading-deg 30"
            ),
            "--bearing and --heading-deg are two directions of one axis: give only one",
        ),
        (
            f"site import --osm {MAP} --centre 8 49.5 --size 70 50 --out j.json --bearing 600",
            "--bearing must be degrees clockwise from north, from 0 to 360, got 600",
        ),
        (
            "what-if tjunction --move d0 80 95 --frames 8",
            "a tilt must be -10 to 89 degrees below the horizon, got 95",
        ),
        (
            "what-if tjunction --move d0 NW 20 --frames 8",
            "a bearing must be degrees clockwise from north, from 0",
        ),
        (
            "what-if tjunction --lift d0 20 --frames 8",
            "takes sensors at 3 to 8 m above its foot, got 20",
        ),
        ("search REC", "is a recording, no site: give the file of its site, or one of"),
        ("search tjunction --budget -1", "--budget must be at least 1, got -1"),
        ("search tjunction --iou 70", "iou must lie in (0, 1], got 70"),
        ("search tjunction --money -5", "--money must be at least 0, got -5"),
        (
            "search tjunction --method exhaustive",
            "takes at most 16 candidates, got 2363: say --method greedy or swap",
        ),
        (
            "search tjunction --method cheapest --at-least 90",
            "must lie above 0 and up to 1, got 90.0: 0.9 is 0.9",
        ),
        (
            "search tjunction --surrogate nowhere.json",
            "no surrogate nowhere.json: fit one with coview surrogate",
        ),
        (
            "plan tjunction --drawings 3",
            "nothing was drawn at site 'tjunction': leave --drawings out",
        ),
        ("plan tjunction --capacity 0", "capacity_kbit must be above 0"),
        (
            "plan tjunction --link-share 0",
            "link_share must lie above 0 and up to 1, got 0.0: 0.95 is usual",
        ),
        (
            "search tjunction --link-share 95",
            "link_share must lie above 0 and up to 1, got 95.0: 0.95 is usual",
        ),
        ("table tjunction --out t.npz", "tjunction is a site, no recording"),
        (
            "table REC --out t.json",
            "a table's file must end in .npz, by which it is loaded, got t.json",
        ),
        ("surrogate tjunction --out s.npz", "the name of a surrogate must end in .json, got s.npz"),
        (
            "surrogate --out s.json",
            "there is no site to fit to: name one, or pass --random-sites 8",
        ),
        ("stress tjunction", "tjunction is a site, no recording"),
        ("fuse nowhere.pcd --out f.ply", "give cloud files and --poses, or --argoverse LOG"),
        ("serch tjunction", "unknown command 'serch': did you mean search?"),
    ],
)
def test_what_a_mistake_is_told(line, said, refused, recording, clouds):
    words = [
        str(recording) if each == "REC" else each.replace("CLOUDS", str(clouds))
        for each in line.split(" ")
    ]
    assert said in refused(*words)


def test_a_folder_shows_its_layout(run, clouds):
    code, out, err = run("survey", clouds / "kitti")
    assert (code, "read as layout kitti" in err, "vehicle" in out) == (0, True, True)


def test_a_plan_that_says_no_is_replaced(run, tmp_path):
    line = (
        "plan",
        "tjunction",
        "--candidates",
        "paper",
        "--budget",
        "0",
        "--cache",
        "None",
        "--out",
        tmp_path,
    )
    assert [run(*line)[0], run(*line, "--seed", "1")[0]] == [1, 1]


def test_no_table_is_written_where_nothing_is_to_be_found(
    refused, recording, tmp_path, monkeypatch
):
    module = "toolkit.detection.frame_scores"
    monkeypatch.setattr(
        f"{module}.has_centre_inside", lambda boxes, area: np.zeros(len(boxes), bool)
    )
    line = (
        "evaluate",
        recording,
        "--frames",
        "1",
        "--classes",
        "heavy",
        "--schemes",
        "late",
        "--sensors",
        "0",
    )
    said = refused(*line, "--out", tmp_path / "new")
    assert (
        "there is no AP, since no heavy is to be found in 1 frame: take more frames, other "
        "--classes"
    ) in said
    assert not (tmp_path / "new" / "table.json").exists()


def test_no_command_replaces_the_site_it_read_or_a_file_of_another_kind(run, refused, tmp_path):
    site = tmp_path / "junction.json"
    assert run("site", "random", "--seed", 1, "--out", site)[0] == 0
    before = site.read_bytes()
    (tmp_path / "pl").mkdir()
    (tmp_path / "pl/site.json").write_bytes(before)
    line = (
        "plan",
        tmp_path / "pl/site.json",
        "--out",
        tmp_path / "pl",
        "--overwrite",
        "--cache",
        "None",
    )
    assert "site.json is what is read: write to another place, so that nothing is lost" in refused(
        *line
    )
    line = ("plan", site, "--out", tmp_path / "pl", "--overwrite", "--cache", "None")
    assert "holds site.json, which this command did not write, as there is no plan.json" in refused(
        *line
    )
    said = refused("surrogate", "tjunction", "--out", site, "--overwrite")
    assert "is a site's file, which this command does not write: give another name" in said
    assert "is a folder, no site: give the file" in refused("site", "show", tmp_path / "pl")
    assert site.read_bytes() == (tmp_path / "pl/site.json").read_bytes() == before
