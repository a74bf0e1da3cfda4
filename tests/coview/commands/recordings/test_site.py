"""coview site: show, draw, import."""

import json
from pathlib import Path

import numpy as np
import pytest

from coview.commands.recordings.site import ImportMap
from toolkit.sites.files import load_site


def test_show(run, tmp_path):
    code, out, _ = run("site", "show", "roundabout", "--out", tmp_path / "site.png")
    assert code == 0
    assert "96 x 96 m" in out
    assert (tmp_path / "site.png").stat().st_size > 10_000


PLACE = ("--centre", 0, 0, "--size", 9, 9, "--out", "x.json")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("import", *PLACE), "--opendrive"),
        (("import", "--opendrive", "a.xodr", "--lefthand", *PLACE), "--lefthand is for --osm"),
        (("import", "--opendrive", "a.xodr", *PLACE[:-1], "a.xodr"), "no map 'a.xodr'"),
        (("random", "--seed", -3, "--out", "x.json"), "--seed must be at least 0, got -3"),
    ],
)
def test_wrong_arguments(arguments, message, refused):
    assert message in refused("site", *arguments)


@pytest.mark.parametrize(
    ("options", "heading"),
    [({}, 0.0), ({"bearing": 60.0}, 30.0), ({"bearing": 90}, 0.0), ({"heading_deg": 30.0}, 30.0)],
)
def test_an_import_is_turned_by_a_bearing_or_a_heading_by_its_name(options, heading):
    command = ImportMap(centre=(0.0, 0.0), size=(9.0, 9.0), out=Path("x.json"), **options)
    assert command.find_heading() == pytest.approx(heading)


def test_a_site_is_replaced_only_when_told(run, refused, tmp_path):
    mine = tmp_path / "mine.json"
    assert run("site", "random", "--seed", 1, "--out", mine)[0] == 0
    before = mine.read_bytes()
    assert "--overwrite" in refused("site", "random", "--seed", 2, "--out", mine)
    assert "is what is read" in refused("site", "show", mine, "--out", mine, "--overwrite")
    assert mine.read_bytes() == before
    assert run("site", "random", "--seed", 2, "--out", mine, "--overwrite")[0] == 0
    assert mine.read_bytes() != before


def test_an_import_has_no_sensors(run, refused, tmp_path):
    site = tmp_path / "own.json"
    code, out, _ = run("site", "import", *OWN, "--out", site)
    assert code == 0
    assert "sensors none" in out
    assert f"it has no sensors yet: coview plan {site} says which to build" in out
    assert load_site(site).sensors == ()
    line = refused("simulate", site, "--frames", 2, "--out", tmp_path / "own.hdf5")
    assert (
        "site 'own-junction' has no sensors: coview plan or coview search --out says which to build"
        in line
    )
    assert not (tmp_path / "own.hdf5").exists()
    assert "has no sensors" in refused("search", site, "--candidates", "paper", "--frames", 1)


DOCS = Path(__file__).parents[4] / "docs"
OWN = ("--osm", DOCS / "own-junction.osm", "--centre", 8.0, 49.5, "--size", 70, 50)


def test_what_is_drawn_is_said_and_can_be_left_out(run, tmp_path):
    place = [*OWN, "--out", tmp_path / "own.json", "--overwrite"]
    code, _, err = run("site", "import", *place)
    assert code == 0
    assert "own-junction.osm: drawn from seed 0, in no map: " in err
    drawn = load_site(tmp_path / "own.json")
    assert "drawn from seed 7" in run("site", "import", *place, "--seed", 7)[2]
    assert load_site(tmp_path / "own.json") != drawn
    assert "drawn" not in run("site", "import", *place, "--furnish", "none")[2]
    bare = load_site(tmp_path / "own.json")
    assert len(bare.solids) < len(drawn.solids)
    assert bare.relief.amplitude == 0 < drawn.relief.amplitude


def test_sensors_that_are_asked_for_are_placed_by_coverage(run, refused, tmp_path, limits):
    limits("placement_env.search.first_sensors", FIRST_FRAMES=2)
    limits("placement_env.search.first_sensors", FIRST_HEADINGS=4)
    site = tmp_path / "own.json"
    code, out, _ = run("site", "import", *OWN, "--sensors", 2, "--out", site)
    assert code == 0
    assert "2 sensors placed by coverage: from" in out
    assert len(load_site(site).sensors) == 2
    assert "--sensors must be at least 1, got 0" in refused(
        "site", "import", *OWN, "--sensors", 0, "--out", "x.json"
    )
    assert "own.json exists" in refused("site", "import", *OWN, "--out", site)


def test_an_export_lies_where_the_map_does(run, refused, tmp_path):
    run("site", "import", *OWN, "--out", tmp_path / "own.json")
    code, out, _ = run("site", "export", tmp_path / "own.json", "--out", tmp_path / "own.geojson")
    assert (code, "longitude and latitude" in out) == (0, True)
    collection = json.loads((tmp_path / "own.geojson").read_text(encoding="utf-8"))
    (area,) = [each for each in collection["features"] if each["properties"]["layer"] == "area"]
    corners = np.array(area["geometry"]["coordinates"][0])
    # 35 m east and 25 m north of 8.0 49.5, where a degree is 72,437 m of longitude and 111,228 m of
    # latitude
    assert corners.max(axis=0) == pytest.approx([8 + 35 / 72437, 49.5 + 25 / 111228], abs=1e-7)
    assert "own.geojson exists" in refused(
        "site", "export", tmp_path / "own.json", "--out", tmp_path / "own.geojson"
    )
    assert "is what is read" in refused(
        "site", "export", tmp_path / "own.json", "--out", tmp_path / "own.json"
    )
    nowhere = refused("site", "export", "tjunction", "--out", tmp_path / "t.geojson")
    assert "does not say where on earth it is" in nowhere
    assert not (tmp_path / "t.geojson").exists()
