"""Configurations of a centre: read whole, or refused with the name of the wrong entry."""

import numpy as np
import pytest

from toolkit.calibration.place import Place
from toolkit.centre.centre_config import load_centre_config

SMALL = """
coview_run = 1
[[input]]
kind = "recording"
path = "street.hdf5"
"""
WHOLE = """
coview_run = 1
detector = "tjunction+background"
detect_every = 2
parallel = 3
deadline_s = 0.05
[[input]]
kind = "velodyne"
name = "north"
port = 2369
address = "192.168.1.201"
[[input]]
kind = "velodyne"
name = "south"
[[input]]
kind = "ouster"
name = "east"
metadata = "east.json"
[replay]
interval_s = 0.2
[[sensor]]
name = "north"
pose = [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 6]]
clock_offset_s = 0.02
background = "scenes.npz"
[place]
level = "plane"
area = [-40, -30, 40, 30]
[output]
folder = "out"
to = ["mcap", "mf-json"]
piece_s = 30
asn1 = "modules"
origin = [48.137, 11.575]
[page]
port = 8081
[health]
file = "health.jsonl"
every_s = 5
"""


def load(tmp_path, text):
    path = tmp_path / "centre.toml"
    path.write_text(text)
    return load_centre_config(path)


def test_a_small_configuration_has_the_usual_values(tmp_path):
    config = load(tmp_path, SMALL)
    assert config.inputs[0].path == tmp_path / "street.hdf5"
    assert config.detector == "general"
    assert config.place == Place(still=True)
    assert (config.speed, config.interval_s, config.page_port) == (1.0, None, None)
    assert (config.detect_every, config.parallel, config.deadline_s) == (1, 1, 0.08)
    assert config.output.folders == {}


def test_every_key_is_read(tmp_path):
    config = load(tmp_path, WHOLE)
    assert [(row.name, row.port, row.address) for row in config.inputs] == [
        ("north", 2369, "192.168.1.201"),
        ("south", 2368, None),
        ("east", 7502, None),
    ]
    assert config.inputs[2].metadata == tmp_path / "east.json"
    assert (config.interval_s, config.detect_every, config.parallel) == (0.2, 2, 3)
    assert config.deadline_s == 0.05
    north = config.setups["north"]
    assert np.array_equal(north.pose[:3, 3], [5, 0, 6])
    assert north.clock_offset_s == 0.02
    assert config.backgrounds == {"north": tmp_path / "scenes.npz"}
    assert config.place == Place("plane", still=True, area=(-40, -30, 40, 30))
    assert config.output.folders["mcap"] == tmp_path / "out" / "mcap"
    assert config.output.origin.latitude_deg == 48.137
    assert config.output.asn1 == tmp_path / "modules"
    assert (config.output.piece_s, config.page_port, config.health_every_s) == (30, 8081, 5)


@pytest.mark.parametrize(
    ("old", "new", "refusal"),
    [
        ("coview_run = 1", "", "coview_run is missing"),
        ("coview_run = 1", "coview_run = 2", "coview_run 2 is of another coview: this one reads 1"),
        ("coview_run = 1", "coview_run = 1\nspeed = 2", "speed is unknown"),
        (
            "coview_run = 1",
            "coview_run = 1\ndetect_every = 0",
            "detect_every must be a whole number from 1 to 10",
        ),
        ("coview_run = 1", "coview_run = 1\ndeadline_s = 11", "deadline_s must be from 0 to 10"),
        (
            "coview_run = 1",
            "coview_run = 1\ndeadline_s = inf",
            "deadline_s must be a finite number",
        ),
        ('kind = "recording"', 'kind = "bag"', "input\\[0\\].kind must be one of recording"),
        ('path = "street.hdf5"', "", "input\\[0\\].path is missing"),
        ('path = "street.hdf5"', 'path = "x"\nport = 3', "input\\[0\\].port is unknown"),
        ("[[input]]", "[[inputs]]", "inputs is unknown"),
        ("", "[page]\nport = 80000\n", "page.port must be a whole number from 1 to 65535"),
        ("", "[replay]\nspeed = 0\n", "replay.speed must be from 0.001 to 1000"),
        ("", '[[sensor]]\nname = "a"\npose = [1, 2]\n', "sensor\\[0\\].pose must be"),
        ("", '[[sensor]]\nname = "a"\n[[sensor]]\nname = "a"\n', "is there twice"),
        ("", '[[sensor]]\nname = "a"\noffset = 1\n', "sensor\\[0\\].offset is unknown"),
        ("", '[output]\nfolder = "o"\nto = ["csv"]\n', "no writer 'csv'"),
        ("", '[place]\nlevel = "hill"\n', "place.level must be one of map, plane, none"),
        ("", '[[input]]\nkind = "junction"\nsite = "x"\n', "sets the clock"),
        ("", "[[input]\n", "not TOML"),
        ("", "[health]\nevery_s = nan\n", "health.every_s must be a finite number"),
    ],
)
def test_what_is_wrong_is_refused_by_name(tmp_path, old, new, refusal):
    text = SMALL.replace(old, new) if old else SMALL + new
    with pytest.raises(ValueError, match=f"centre.toml.*{refusal}"):
        load(tmp_path, text)


@pytest.mark.parametrize(("words", "seed"), [("", 0), ("seed = 0\n", 0), ("seed = 7\n", 7)])
def test_a_simulated_junction_has_the_seed_that_is_asked_for(tmp_path, words, seed):
    text = f'coview_run = 1\n[[input]]\nkind = "junction"\nsite = "tjunction"\n{words}'
    (junction,) = load(tmp_path, text).inputs
    assert junction.seed == seed
    assert junction.site == "tjunction"
