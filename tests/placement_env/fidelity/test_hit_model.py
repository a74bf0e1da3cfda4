"""Models of hits: their probability, their file, and those that come with coview."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from placement_env.fidelity.hit_model import (
    NUMBERS,
    RANGES,
    SURROGATE_FOLDER,
    HitDomain,
    load_models,
    save_models,
    shipped_model,
)

DOMAIN = {
    "farthest": 60.0,
    "most_points": 900.0,
    "sensors": ["DepthCamera"],
    "sites": 2,
    "objects": 30,
    "sets": 9,
}


def test_evidence_bulk_and_few_points_set_the_probability(hit_model):
    p = hit_model.probability(np.array([0.0, 1e-3, 1.0, 1e3, 1e9]))
    assert p[0] == 0
    assert (np.diff(p) > 0).all()
    assert p[-1] == pytest.approx(hit_model.ceiling, abs=1e-3)
    boxes = np.zeros((4, 7))
    boxes[:, 3:6] = [[4.5, 1.8, 1.5], [4.0, 2.0, 2.0], [8.0, 2.0, 2.0], [12.0, 2.5, 3.2]]
    model = replace(hit_model, bulk=0.5)
    assert model.of_size(boxes) == pytest.approx([1, 1, 2**-0.5, 6**-0.5])
    assert hit_model.of_size(boxes).tolist() == [1.0] * 4
    assert model.of_size(boxes[:0]).shape == (0,)
    model = replace(hit_model, floor=20.0, norm=2.0)
    powers, raw = np.full(4, 1e9), np.array([0.0, 5.0, 20.0, 80.0]) ** 2
    assert model.probability(powers, raw) == pytest.approx(
        hit_model.ceiling * np.array([0, 0.25, 1, 1]), abs=1e-3
    )
    assert model.probability(powers) == pytest.approx(np.full(4, hit_model.ceiling), abs=1e-3)


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
        *(
            lambda row: row.pop("norm"),
            lambda row: row.update(more=1),
            lambda row: row.update(norm="1"),
        ),
        *(lambda row: row.update(norm=float("nan")), lambda row: row.update(density=-1.0)),
        *(lambda row: row.update(ceiling=True), lambda row: row.update(scheme="middle")),
        *(
            lambda row: row.update(source=3),
            lambda row: row.update(floor="20"),
            lambda row: row.update(floor=-1.0),
        ),
        *(
            lambda row: row.update(domain={"farthest": 3.0}),
            lambda row: row.update(domain={**DOMAIN, "farthest": 0}),
        ),
        lambda row: row.update(domain={**DOMAIN, "sensors": "DepthCamera"}),
        *(lambda row: row.update(resampled=3), lambda row: row.update(resampled=[[1.0]])),
        *(
            lambda row: row.update(resampled=[["a"] * 9]),
            lambda row: row.update(resampled=[[None] * 9]),
        ),
        *(
            lambda row: row.update(resampled=[[99.0] * 9]),
            lambda row: row.update(resampled=[[0.5] * 10]),
        ),
        lambda row: row.update(bulk=-0.1),
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
    for path in SURROGATE_FOLDER.glob("*.json"):
        for scheme in ("early", "late", "hybrid"):
            for iou in (0.7, 0.8, 0.9):
                assert shipped_model(scheme, iou, path.stem).scheme == scheme
    with pytest.raises(ValueError, match="choose among"):
        shipped_model("early", 0.35)


def test_files_say_of_fits_and_bulk_what_they_know(tmp_path, hit_model):
    domain = HitDomain(60.0, 900.0, ("DepthCamera", "SpinningLidar"), 2, 30, 9)
    numbers = tuple(getattr(hit_model, name) for name in NUMBERS)
    model = replace(hit_model, floor=15.0, domain=domain, resampled=(numbers, (-3.0, *numbers[1:])))
    save_models((model,), tmp_path / "m.json")
    assert load_models(tmp_path / "m.json") == (model,)
    assert [each.intercept for each in model.resamples] == [hit_model.intercept, -3.0]
    assert all(each.resampled == () and each.domain == domain for each in model.resamples)
    rows = json.loads((tmp_path / "m.json").read_text())
    for name in ("floor", "domain", "resampled", "label"):
        rows[0].pop(name)
    (tmp_path / "old.json").write_text(json.dumps(rows))
    assert load_models(tmp_path / "old.json") == (hit_model,)
    row = asdict(
        replace(hit_model, resampled=((*[getattr(hit_model, name) for name in NUMBERS[:-1]], 0.0),))
    )
    row.pop("bulk")
    row["resampled"] = [row["resampled"][0][:-1]]
    (tmp_path / "m.json").write_text(json.dumps([row]))
    (model,) = load_models(tmp_path / "m.json")
    assert model.bulk == 0
    assert model.resamples == (hit_model,)
