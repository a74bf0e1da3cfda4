"""From a map to a recording: import, poles, search, hand-over, simulation, as docs/own-junction.md
has it."""

import csv
import json
import os
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from placement_env.candidates.candidates import aims
from placement_env.candidates.poles import load_poles
from toolkit.sites.files import load_site

ROOT = Path(__file__).parents[2]
TOWN = Path(os.environ.get("COVIEW_SHARED", ROOT.parent / "shared")) / "carla" / "Town01.xodr"
carla = pytest.mark.skipif(not TOWN.is_file(), reason="the CARLA maps are not here")

OSM = ("--osm", ROOT / "docs" / "own-junction.osm", "--centre", 8.0, 49.5, "--size", 70, 50)
OPENDRIVE = ("--opendrive", TOWN, "--centre", 93, -130, "--size", 70, 60)


def poles(folder, *names) -> Path:
    """Some of the documentation's poles."""
    collection = json.loads(
        (ROOT / "docs" / "own-junction-poles.geojson").read_text(encoding="utf-8")
    )
    collection["features"] = [
        each for each in collection["features"] if each["properties"]["name"] in names
    ]
    (folder / "poles.geojson").write_text(json.dumps(collection))
    return folder / "poles.geojson"


def planned(run, folder, place, *candidates) -> dict[str, str]:
    """Row of the schedule of the one sensor that was chosen, after it has recorded a frame."""
    site, out, recording = folder / "site.json", folder / "answer", folder / "r.hdf5"
    assert run("site", "import", *place, "--out", site)[0] == 0
    few = ("--budget", 1, "--frames", 1, "--fidelity", "coverage", "--cache", "None")
    code, _, err = run("search", site, *candidates, *few, "--out", out)
    assert code == 0, err
    assert (
        run("simulate", out / "site.json", "--frames", 1, "--workers", 1, "--out", recording)[0]
        == 0
    )
    (row,) = csv.DictReader((out / "schedule.csv").open(encoding="utf-8", newline=""))
    with h5py.File(recording) as file:
        assert json.loads(str(file["coview"].attrs["sensors"])) == [row["sensor"]]
    return row


@pytest.mark.slow
def test_an_openstreetmap_extract_with_poles_of_ones_own(run, tmp_path):
    row = planned(run, tmp_path, OSM, "--candidates", poles(tmp_path, "LM 104", "LM 106"))
    x, y, price = {"LM 104": (34, 10, "0.8"), "LM 106": (12, -9, "0.8")}[row["pole"]]
    assert (float(row["x_m"]), float(row["y_m"])) == pytest.approx((x, y))
    assert row["pole_price"] == price
    # of 8.0 49.5, where a degree is 72,437 m of longitude and 111,228 m of latitude
    assert float(row["longitude"]) == pytest.approx(8 + x / 72437, abs=1e-7)
    assert float(row["latitude"]) == pytest.approx(49.5 + y / 111228, abs=1e-7)
    assert row["sensor"] == row["pole"]
    (sensor,) = load_site(tmp_path / "answer" / "site.json").sensors
    assert float(row["bearing_deg"]) == pytest.approx((90 - np.rad2deg(aims([sensor])[0][0])) % 360)
    run("site", "import", *OSM, "--out", tmp_path / "site.json")
    path = ROOT / "docs" / "own-junction-poles.geojson"
    with pytest.warns(UserWarning, match="left out") as caught:
        mounts = load_poles(path, load_site(tmp_path / "site.json"))
    said = [str(each.message) for each in caught]
    assert said == [f"{path}: left out, since they stand in a keep-out area: LM 101"]
    assert [mount.name for mount in mounts] == [
        "LM 102",
        "LM 103",
        "LM 104",
        "LM 105",
        "LM 106",
        "Neu 1",
        "Neu 2",
    ]


@pytest.mark.slow
@carla
def test_an_opendrive_junction_that_is_not_the_papers(run, tmp_path):
    pytest.importorskip("pyproj")
    features = [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {"type": "Point", "coordinates": at},
        }
        for name, at in {"a": [-9.0, 12.0], "b": [9.0, -14.0]}.items()
    ]
    (tmp_path / "p.geojson").write_text(
        json.dumps({"type": "F", "coview_site": 1, "features": features})
    )
    row = planned(run, tmp_path, OPENDRIVE, "--candidates", tmp_path / "p.geojson")
    assert load_site(tmp_path / "site.json").sensors == ()
    # the map's zero is where equator and Greenwich meet
    assert float(row["longitude"]) == pytest.approx((93 + float(row["x_m"])) / 111319.49, abs=1e-7)
    assert float(row["latitude"]) == pytest.approx((-130 + float(row["y_m"])) / 110574.28, abs=1e-7)


def test_the_page_names_files_that_there_are():
    page = (ROOT / "docs" / "own-junction.md").read_text(encoding="utf-8")
    assert set(re.findall(r"docs/[\w.-]+\w", page)) == {
        "docs/own-junction.osm",
        "docs/own-junction-poles.geojson",
    }
    assert all((ROOT / name).is_file() for name in re.findall(r"docs/[\w.-]+\w", page))
