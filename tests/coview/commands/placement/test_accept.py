"""coview accept: a street as planned and streets with planted faults, and what it refuses."""

import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest

from coview.commands.placement.accept import ACCEPTANCE_FILES
from coview.main import run as run_line
from toolkit.sites.files import load_site, save_site

FRAMES = 8


@pytest.fixture(scope="module")
def streets(tmp_path_factory):
    """Folder with a plan of two sensors, a recording of them, and one of sensors of other names."""
    folder = tmp_path_factory.mktemp("streets")
    common = ["--frames", str(FRAMES), "--workers", "1"]
    plan = ["plan", "tjunction", "--candidates", "paper", "--budget", "2", "--frames", "2"]
    assert run_line([*plan, "--workers", "1", "--out", str(folder / "plan")]) == 0
    planned = load_site(folder / "plan/site.json")
    renamed = [replace(sensor, name=f"x{k}") for k, sensor in enumerate(planned.sensors)]
    save_site(replace(planned, sensors=tuple(renamed)), folder / "other.json")
    for site, name in ((folder / "plan/site.json", "sound"), (folder / "other.json", "other")):
        record = ["simulate", str(site), *common, "--seed", "3"]
        assert run_line([*record, "--out", str(folder / f"{name}.hdf5")]) == 0
    return folder


def dead(images, rng):
    """Nothing returns any more."""
    images[images != 0] = 1000


def thinned(images, rng):
    """A third of the returns is missing."""
    images[(images != 0) & (rng.random(images.shape) < 1 / 3)] = 1000


def planted(folder, fault):
    """The sound recording with a fault of its first sensor; its path and the sensor's name."""
    path = folder / f"{fault.__name__}.hdf5"
    shutil.copy(folder / "sound.hdf5", path)
    with h5py.File(path, "r+") as file:
        images = file["dslices"][:, 0]
        fault(images, np.random.default_rng(0))
        file["dslices"][:, 0] = images
        name = next(iter(file["cameras"].values())).attrs["name"]
    return path, name


@pytest.mark.slow
def test_a_street_as_planned_keeps_the_promise(streets, run, tmp_path):
    out = tmp_path / "out"
    code, text, _ = run("accept", streets / "sound.hdf5", "--plan", streets / "plan", "--out", out)
    assert code == 0, text
    assert sorted(path.name for path in out.iterdir()) == sorted(ACCEPTANCE_FILES)
    found = json.loads((out / "acceptance.json").read_text(), parse_constant=pytest.fail)
    assert (found["kept"], found["faults"], found["frames"]) == (True, [], FRAMES)
    assert found["consistency"] is None
    vehicle = next(check for check in found["classes"] if check["label"] == "vehicle")
    assert vehicle["measured"]["ap"] > 0.3
    assert not vehicle["compared"]  # eight frames give no interval
    assert "too short to compare AP" in text
    page = (out / "acceptance.html").read_text()
    assert "Acceptance of" in page
    code, _, err = run("accept", streets / "sound.hdf5", "--plan", streets / "plan", "--out", out)
    assert (code, "exists" in err) == (2, True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "said"),
    [(dead, "returns nothing in any frame"), (thinned, "of what the plan promises")],
)
def test_planted_faults_are_found(streets, run, tmp_path, fault, said):
    path, name = planted(streets, fault)
    code, text, _ = run(
        "accept", path, "--plan", streets / "plan", "--out", tmp_path / "out", "--json"
    )
    assert code == 1
    found = json.loads(text)
    assert any(
        sentence.startswith(f"Sensor {name} ") and said in sentence for sentence in found["faults"]
    )
    assert [sensor["name"] for sensor in found["sensors"] if sensor["faults"]] == [name]


@pytest.mark.slow
def test_what_is_no_street_of_the_plan_is_refused(streets, run, tmp_path):
    plan = streets / "plan"
    out = ("--out", tmp_path / "out")
    code, _, err = run("accept", streets / "other.hdf5", "--plan", plan, *out)
    assert (code, "none of the plan's sensors" in err) == (2, True), err
    code, _, err = run("accept", streets / "sound.hdf5", "--plan", plan, "--frames", 4, *out)
    assert (code, "4 frames do not show what stands still" in err) == (2, True)
    assert not (tmp_path / "out").exists()


def test_a_folder_without_a_plan_is_refused(run, tmp_path):
    code, _, err = run("accept", tmp_path / "a.hdf5", "--plan", tmp_path)
    assert (code, "is no folder of a plan" in err) == (2, True)
