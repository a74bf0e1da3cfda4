"""coview surrogate: a file that coview search takes."""

import json

import pytest

from placement_env.fidelity.hit_model import load_models

QUICK = ("--frames", 6, "--poses", 4, "--sets", 10, "--schemes", "early", "--resamples", 2)


@pytest.mark.slow
def test_models_of_classes_are_fitted_and_searched_with(tmp_path, run, refused):
    out, cache = tmp_path / "people.json", ("--cache", tmp_path / "cache")
    asked = (
        *(
            "surrogate",
            "tjunction",
            "--detector",
            "tjunction",
            "--classes",
            "vehicle",
            "pedestrian",
            "--iou",
            0.7,
        ),
        0.55,
    )
    code, said, err = run(*asked, *QUICK, "--out", out, *cache, "--json")
    assert code == 0, err
    models = load_models(out)
    assert [(model.label, model.scheme, model.iou) for model in models] == [
        ("vehicle", "early", 0.7),
        ("vehicle", "early", 0.55),
        ("pedestrian", "early", 0.5),
    ]
    assert "seed 1000, 10 sets, detector tjunction" in models[0].source
    assert models[0].domain.sites == 1
    assert len(models[0].resampled) == 2
    rows = json.loads(said)
    assert [row["label"] for row in rows] == [model.label for model in models]
    assert all(0 <= row["rms"] < 0.3 for row in rows)
    assert "--overwrite" in refused(*asked, *QUICK, "--out", out, *cache)

    search = (
        *(
            "search",
            "tjunction",
            "--method",
            "greedy",
            "--candidates",
            "paper",
            "--budget",
            2,
            "--frames",
            6,
        ),
        *cache,
    )
    both = ("--classes", "vehicle", "pedestrian", "--combine", "worst", "--surrogate", out)
    code, said, err = run(*search, *both, "--json")
    assert code == 0, err
    best = json.loads(said)
    assert set(best["class_ap"]) == {"vehicle", "pedestrian"}
    assert best["ap"] == min(best["class_ap"].values())
    assert best["provenance"]["classes"]["combine"] == "worst"
    code, said, _ = run(*search, *both)
    assert "(vehicle " in said
    assert "no surrogate of" in refused(*search, *both, "--classes", "vehicle", "cyclist")
    assert "for fidelity surrogate, got 'coverage'" in refused(
        *search, *both, "--fidelity", "coverage"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--frames", 0), "frames must be a whole number of at least 1"),
        *(
            (("--iou", 0.7, 1.2), "iou must lie in (0, 1], got 1.2"),
            (("--poses", 10**6), "poses must be 0 to the"),
        ),
        (("--detector", "cluster"), "detector cluster learns from a recording"),
        (
            ("--classes", "vehicle", "heavy", "--detector", "vehicles/general"),
            "knows vehicle only, not heavy",
        ),
        (("--small-iou", 50), "--small-iou must lie above 0"),
        (("--schemes", "middle"), "there is no fusion scheme"),
        (("--random-sites", -1), "--random-sites must be at least 0"),
        *(
            (("--resamples", -1), "--resamples must be at least 0"),
            (("--model", "telepathy"), "telepathy"),
        ),
    ],
)
def test_bad_input_is_refused(arguments, message, refused, tmp_path):
    asked = ("surrogate", "tjunction", "--out", tmp_path / "a.json", "--cache", tmp_path / "cache")
    assert message in refused(*asked, *arguments)
    assert not (tmp_path / "a.json").exists()


def test_without_a_site_it_says_what_to_name(refused, tmp_path):
    assert "pass --random-sites 8" in refused(
        "surrogate", "--out", tmp_path / "a.json", "--cache", tmp_path / "cache"
    )


@pytest.mark.slow
def test_random_sites_are_fitted_to_together(tmp_path, run):
    out = tmp_path / "general.json"
    asked = (
        "surrogate",
        "--random-sites",
        2,
        "--detector",
        "general",
        "--frames",
        2,
        "--poses",
        3,
        "--sets",
        4,
    )
    few = (
        "--schemes",
        "early",
        "--resamples",
        0,
        "--model",
        "depth-camera",
        "--seed",
        9101,
        "--cache",
        "None",
    )
    code, _, err = run(*asked, *few, "--out", out)
    assert code == 0, err
    models = load_models(out)
    assert {model.domain.sites for model in models} == {2}
    assert (
        models[0].source
        == "2 frames of 2 random sites traffic, seed 9101, 4 sets, detector general"
    )
