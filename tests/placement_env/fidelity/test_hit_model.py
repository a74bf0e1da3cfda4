"""Models of hits: their probability, their file, and those that come with coview."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from placement_env.fidelity.hit_model import FOLDER, RANGES, load_models, save_models, shipped_model

SCHEMES = ("early", "late", "hybrid")


def test_probability_grows_with_the_evidence_up_to_the_ceiling(hit_model):
    p = hit_model.probability(np.array([0.0, 1e-3, 1.0, 1e3, 1e9]))
    assert p[0] == 0
    assert (np.diff(p) > 0).all()
    assert p[-1] == pytest.approx(hit_model.ceiling, abs=1e-3)


@pytest.mark.parametrize("name", RANGES)
def test_a_number_out_of_its_range_is_refused(hit_model, name):
    with pytest.raises(ValueError, match=f"{name} must lie in"):
        replace(hit_model, **{name: RANGES[name][1] + 1})


def test_models_come_back_from_their_file(tmp_path, hit_models):
    models = tuple(hit_models.values())
    save_models(models, tmp_path / "m.json")
    assert load_models(tmp_path / "m.json") == models
    assert [path.name for path in tmp_path.iterdir()] == ["m.json"]


@pytest.mark.parametrize(
    "change",
    [
        lambda row: row.pop("norm"),
        lambda row: row.update(more=1),
        lambda row: row.update(norm="1"),
        lambda row: row.update(norm=float("nan")),
        lambda row: row.update(density=-1.0),
        lambda row: row.update(ceiling=True),
        lambda row: row.update(scheme="middle"),
        lambda row: row.update(source=3),
    ],
)
def test_damaged_models_are_refused_in_one_line(tmp_path, change, hit_model):
    row = asdict(hit_model)
    change(row)
    path = tmp_path / "m.json"
    path.write_text(json.dumps([row]))
    with pytest.raises(ValueError, match=r"m\.json") as caught:
        load_models(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '[{"scheme": "early"'])
def test_what_is_no_file_of_models_is_refused(tmp_path, text):
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(ValueError, match=r"m\.json"):
        load_models(tmp_path / "m.json")


def test_shipped_models_load_for_all_schemes_and_thresholds():
    for path in FOLDER.glob("*.json"):
        for scheme in SCHEMES:
            for iou in (0.7, 0.8, 0.9):
                assert shipped_model(scheme, iou, path.stem).scheme == scheme
    with pytest.raises(ValueError, match="choose among"):
        shipped_model("early", 0.35)
