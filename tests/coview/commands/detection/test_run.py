"""coview run: a centre over a short street, ended by its inputs, by SIGTERM and by kill -9."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from toolkit.datasets.simulation import simulate_dataset
from toolkit.runtime.run import Simulation

pytestmark = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
ROOT = Path(__file__).parents[4]
FRAMES = 12
CONFIG = """
coview_run = 1
detector = "tjunction+background"
[[input]]
kind = "recording"
path = "street.hdf5"
[replay]
speed = {speed}
[output]
folder = "out"
to = ["kitti-tracking", "openlabel"]
piece_s = {piece_s}
[health]
file = "health.jsonl"
every_s = 0.2
"""


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    folder = tmp_path_factory.mktemp("street")
    simulate_dataset(
        "tjunction",
        folder / "street.hdf5",
        interval=0.1,
        run=Simulation(frames=FRAMES, seed=2, workers=1),
    )
    return folder


@pytest.fixture
def configured(street, tmp_path):
    """Writes a configuration for the street."""
    (tmp_path / "street.hdf5").symlink_to(street / "street.hdf5")

    def configured(speed=0.2, piece_s=60, more=""):
        path = tmp_path / "centre.toml"
        path.write_text(CONFIG.format(speed=speed, piece_s=piece_s) + more)
        return path

    return configured


def rows(folder):
    """Frame and id of each row in the numbered files."""
    files = sorted(folder.glob("0*.txt"))
    return [line.split()[:2] for file in files for line in file.read_text().splitlines()]


def test_a_recording_is_tracked_at_its_pace(configured, run):
    config = configured()
    code, printed, _ = run("run", config, "--json")
    figures = json.loads(printed.splitlines()[-1])
    assert code == 0
    assert figures["frames"] == FRAMES
    assert 0 <= figures["late_detections"] <= figures["predicted_frames"] <= FRAMES
    stages = ("wait", "fuse", "hold", "level", "detect", "track", "write")
    assert set(figures["ms"]) == {"latency", "detection_age", *stages}
    assert len(rows(config.parent / "out/kitti-tracking")) > 10
    tracks = json.loads((config.parent / "out/openlabel/000000.json").read_text())
    assert len(tracks["openlabel"]["frames"]) == figures["frames"]
    lines = [json.loads(line) for line in (config.parent / "health.jsonl").read_text().splitlines()]
    assert lines[-1]["frames"] == figures["frames"]
    assert lines[-1]["memory_mb"] > 0


def start(config):
    process = subprocess.Popen(
        [sys.executable, "-m", "coview", "run", str(config), "--json"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    health = config.parent / "health.jsonl"
    while process.poll() is None and len(lines_of(health)) < 2:
        time.sleep(0.05)
    return process


def lines_of(path):
    return path.read_text().splitlines() if path.exists() else []


@pytest.mark.slow
def test_sigterm_ends_it_with_whole_files(configured):
    config = configured(speed=0.1)
    process = start(config)
    process.send_signal(signal.SIGTERM)
    printed, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    figures = json.loads(printed.splitlines()[-1])
    assert 0 < figures["frames"] <= FRAMES
    tracks = json.loads((config.parent / "out/openlabel/000000.json").read_text())
    assert len(tracks["openlabel"]["frames"]) == figures["frames"]


@pytest.mark.slow
def test_whole_files_survive_a_kill_and_the_next_run_adds_to_them(configured, run):
    config = configured(speed=0.1, piece_s=0.2)
    process = start(config)
    process.kill()
    process.communicate(timeout=60)
    folder = config.parent / "out/openlabel"
    before = sorted(folder.glob("0*.json"))
    assert before
    for file in before:
        assert json.loads(file.read_text())["openlabel"]["frames"]
    for line in lines_of(config.parent / "health.jsonl"):
        json.loads(line)
    contents = [file.read_bytes() for file in before]
    assert run("run", configured(speed=1.0, piece_s=60), "--json")[0] == 0
    assert [file.read_bytes() for file in before] == contents
    assert len(sorted(folder.glob("0*.json"))) == len(before) + 1


def test_what_cannot_run_is_refused_in_a_line(configured, refused, tmp_path):
    assert "no such file" in refused("run", tmp_path / "none.toml").lower()
    unknown = configured(more='[[sensor]]\nname = "d9"\n')
    assert "there is no sensor 'd9': the inputs have d0" in refused("run", unknown)
    twice = configured(more="[speed]\n")
    assert "centre.toml: speed is unknown" in refused("run", twice)
    config = configured()
    config.write_text(config.read_text().replace("tjunction+background", "tjunctoin"))
    assert "no weights named 'tjunctoin'" in refused("run", config)
    config = configured()
    config.write_text(config.read_text().replace("street.hdf5", "none.hdf5"))
    assert "none.hdf5" in refused("run", config)
    assert "--seconds must be above 0" in refused("run", configured(), "--seconds", "0")
