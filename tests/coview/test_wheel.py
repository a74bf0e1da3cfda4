"""What is installed is whole: a wheel, in an environment of its own, run from outside the tree."""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
PACKAGES = ("coview", "toolkit", "models", "placement_env")
pytestmark = pytest.mark.slow

LOADS = """
import coview
from models.config import SHIPPED
from models.detector_loading import load_detector
from placement_env.fidelity.hit_model import shipped_model
from placement_env.fidelity.table import load_table
assert not coview.__file__.startswith({tree!r}), coview.__file__
for path in SHIPPED.glob("*.safetensors"):
    load_detector(path.stem)
for name in ("tjunction", "roundabout"):
    print(coview.load_site(name).name, load_table(name).origin.site, shipped_model("early", 0.7, name).scheme)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    isolation = ["--no-build-isolation"] if find_spec("hatchling") else []
    options = ["--quiet", "--no-deps", *isolation, "--wheel-dir", folder]
    command = [sys.executable, "-m", "pip", "wheel", *options, REPOSITORY]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode and not find_spec("hatchling"):
        pytest.skip(f"hatchling is not here and could not be fetched: {done.stderr[-200:]}")
    assert not done.returncode, done.stderr
    (built,) = folder.glob("coview-*.whl")
    return built


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory):
    """Runs a command of a fresh environment that holds the wheel, and for all else borrows what is
    installed here."""
    home = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    scheme = {"base": str(home), "platbase": str(home), "installed_base": str(home)}
    packages = Path(sysconfig.get_path("purelib", "venv", scheme))
    target = [sys.executable, "-m", "pip", "--python", str(home / "bin" / "python")]
    subprocess.run([*target, "install", "--quiet", "--no-deps", wheel], check=True)
    # its own .pth files are not read
    (packages / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    outside = tmp_path_factory.mktemp("outside")
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(program, *arguments):
        command = [home / "bin" / program, *map(str, arguments)]
        return subprocess.run(
            command, cwd=outside, env=variables, capture_output=True, text=True, check=False
        )

    return run


@pytest.fixture
def installed(environment):
    """Runs a command that must succeed, and returns what it prints."""

    def run(program, *arguments):
        done = environment(program, *arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_studies_are_named_with_their_remedy(environment):
    done = environment("coview", "stress", "two.hdf5")
    assert done.returncode == 3
    assert "clone the repository" in done.stderr


def test_it_holds_everything_that_is_not_python_too(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    tracked = [
        path for package in PACKAGES for path in (REPOSITORY / package).rglob("*") if path.is_file()
    ]
    wanted = {
        str(path.relative_to(REPOSITORY)) for path in tracked if "__pycache__" not in path.parts
    }
    assert wanted <= names
    for ending in (
        "py.typed",
        ".safetensors",
        ".npz",
        "surrogates/general.json",
        "sites/tjunction.json",
    ):
        assert any(name.endswith(ending) for name in wanted)
    assert {name.partition("/")[0].partition("-")[0] for name in names} == set(PACKAGES)


def test_commands_weights_sites_and_tables_load_outside_the_tree(installed):
    assert installed("coview", "--version").startswith("coview 0.")
    assert "80 x 40 m" in installed("coview", "site", "show", "tjunction")
    installed("coview", "simulate", "tjunction", "--frames", 2, "--workers", 1, "--out", "two.hdf5")
    arguments = ("--detector", "voxelnet", "--schemes", "early", "--out", "evaluation", "--json")
    rows = json.loads(installed("coview", "evaluate", "two.hdf5", *arguments))["rows"]
    assert rows[0]["scheme"] == "early"
    printed = installed("python", "-c", LOADS.format(tree=str(REPOSITORY)))
    assert printed.splitlines() == ["tjunction tjunction early", "roundabout roundabout early"]
