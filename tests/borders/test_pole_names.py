"""Names of poles: kept as the file writes them, told apart, and numbered when no font can set them.

A name is any text of JSON (RFC 8259, section 7); one text can have several encodings (Unicode
Standard Annex 15)."""

import json
from pathlib import Path

import numpy as np
import pytest

from placement_env.candidates.candidates import pool
from placement_env.candidates.poles import load_poles
from toolkit.plots.fonts import number_names, spell_name
from toolkit.sites.site import Site

SITE = Site("yard", np.array([-40.0, -30.0, 40.0, 30.0]))
NAMES = (
    "信号灯杆一",
    "Ώμος",
    "عمود",
    "Straße;5",
    "खम्भा 4",
    "12/3 west",
    'He said "two"\nthen three',
    "b" * 200,
)


def load(folder: Path, *names: object):
    features = []
    for k, name in enumerate(names):
        place = {"type": "Point", "coordinates": [5.0 * k - 20.0, 10.0]}
        features.append({"type": "Feature", "properties": {"name": name}, "geometry": place})
    path = folder / "poles.geojson"
    collection = {"type": "FeatureCollection", "coview_site": 1, "features": features}
    path.write_text(json.dumps(collection, ensure_ascii=False), "utf-8")
    return load_poles(path, SITE)


def test_names_are_kept_whole(tmp_path: Path):
    mounts = load(tmp_path, *NAMES)
    assert tuple(mount.name for mount in mounts) == NAMES
    candidates = pool(SITE, mounts=mounts)
    assert [m.name for m in candidates.mounts] == list(NAMES)
    assert not any(
        "/" in sensor.name for sensor in candidates.sensors
    )  # names of groups in a recording


@pytest.mark.parametrize("name", [None, "", "\n", " \t"])
def test_a_blank_name_is_no_name(tmp_path: Path, name):
    assert [mount.name for mount in load(tmp_path, "a", name)] == ["a", "pole01"]


@pytest.mark.parametrize(
    ("one", "other"), [("é", "e\u0301"), ("a 1", "a  1"), ("a", "a "), ("12/3", "12-3")]
)
def test_names_that_look_alike_are_refused(tmp_path: Path, one, other):
    with pytest.raises(ValueError, match=r"must be told apart.*rename one"):
        load(tmp_path, one, "x", other)


@pytest.mark.parametrize("name", [True, ["a"], {"x": 1}])
def test_a_name_that_is_no_text_is_refused(tmp_path: Path, name):
    with pytest.raises(
        ValueError, match=r"features\[0\].properties.name must be a text or a number, got"
    ):
        load(tmp_path, name)


def test_a_number_is_never_the_name_of_another_pole():
    names = ("pole 2", "信", "灯", "pole 5")
    numbers = number_names(names, frozenset("信灯"), "pole")
    assert numbers == {"信": "pole 6", "灯": "pole 3"}
    assert not set(numbers.values()) & set(names)


def test_only_letters_without_a_font_are_spelled():
    assert spell_name("\U0001f6a6 Ampel", frozenset("\U0001f6a6")) == "U+1F6A6 Ampel"
    assert spell_name("信号12", frozenset("信号")) == "U+4FE1 U+53F7 12"
