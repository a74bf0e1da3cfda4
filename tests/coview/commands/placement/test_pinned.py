"""What small searches, tables and surrogates come to: figures to a tolerance that another processor
keeps."""

import json
from pathlib import Path

import numpy as np
import pytest

from placement_env.fidelity.hit_model import load_models
from placement_env.fidelity.table import load_table

PINNED = json.loads(Path(__file__).with_name("pinned.json").read_text())
OWN = ("--candidates", "paper", "--frames", 6, "--cache", "None")
COVERAGE = (*OWN, "--fidelity", "coverage", "--budget", 2)
TABLE = ("--candidates", "paper", "--fidelity", "table", "--frames", 4)
SEARCHES = {
    "greedy": (*OWN, "--method", "greedy", "--budget", 3, "--comm", 0.0001, "--price", 0.01),
    "swap late mean IoU": (
        *COVERAGE,
        "--method",
        "swap",
        "--budget",
        3,
        "--scheme",
        "late",
        "--iou",
        "0.5:0.95",
    ),
    "exhaustive failing": (*OWN, "--method", "exhaustive", "--budget", 3, "--failing", 1),
    "exhaustive levels": (
        *OWN,
        "--method",
        "exhaustive",
        "--budget",
        2,
        "--levels",
        2,
        "--failures",
        "mean",
    ),
    "classes": (
        *OWN,
        "--method",
        "greedy",
        "--budget",
        2,
        "--classes",
        "vehicle",
        "cyclist",
        "--combine",
        "worst",
    ),
    "foreground bytes": (*OWN, "--method", "greedy", "--budget", 2, "--scheme", "foreground"),
    "coverage cpsat": (*COVERAGE, "--method", "cpsat"),
    "coverage levels": (*COVERAGE, "--method", "greedy", "--levels", 3, "--levels-by", "mean"),
    "hits": (*OWN, "--method", "hits", "--budget", 2, "--codec", "range-images"),
    "cheapest": (*OWN, "--at-least", 0.4, "--budget", 6, "--failing", 1),
    "cheapest coverage": (*COVERAGE, "--budget", 6, "--at-least", 0.5, "--parts", 2),
    "table": (*TABLE, "--budget", 3),
    "table hybrid": (*TABLE, "--budget", 2, "--scheme", "hybrid", "--comm", 0.0005, "--failing", 1),
    "detector errors": (
        *(
            *OWN[:-4],
            "--frames",
            2,
            "--cache",
            "None",
            "--method",
            "raced",
            "--fidelity",
            "detector",
            "--budget",
            2,
        ),
        *("--errors", "paper", "poor"),
    ),
}


@pytest.mark.parametrize("name", SEARCHES)
def test_searches_find_as_good_a_set(name, run):
    code, said, err = run("search", "tjunction", *SEARCHES[name], "--json")
    assert code == 0, err
    found, pinned = json.loads(said), PINNED[name]
    assert found["certificate"]["kind"] == pinned["kind"]
    assert len(found["sensors"]) == pinned["sensors"]
    for figure in ("ap", "recall", "reward", "price"):
        assert found[figure] == pytest.approx(pinned[figure], abs=0.01), figure
    assert found["kbit"] == pytest.approx(pinned["kbit"], rel=0.01)
    assert found["class_ap"] == pytest.approx(pinned["class_ap"], abs=0.01)


@pytest.mark.slow
def test_portfolios_judge_and_curves_have_points_as_well(run):
    code, said, err = run(
        "search", "tjunction", *OWN, "--frames", 12, "--budget", 2, "--judge", "surrogate", "--json"
    )
    assert code == 0, err
    found, pinned = json.loads(said), PINNED["portfolio"]
    assert found["ap"] == pytest.approx(pinned["ap"], abs=0.02)
    assert len(found["sensors"]) == pinned["sensors"]
    assert found["assessment"]["ap"] == pytest.approx(pinned["ap"], abs=0.1)
    assert found["assessment"]["low"] is None, "too few frames for an interval"
    code, said, err = run(
        "search",
        "tjunction",
        *OWN,
        "--budget",
        3,
        "--curve",
        "--judge",
        "coverage",
        "--fidelity",
        "coverage",
        "--json",
    )
    assert code == 0, err
    points = json.loads(said)["curve"]
    assert [len(point["sensors"]) for point in points] == PINNED["curve"]["sensors"]
    assert [point["ap"] for point in points] == pytest.approx(PINNED["curve"]["ap"], abs=0.02)


@pytest.mark.slow
def test_a_surrogate_is_fitted_as_well(tmp_path, run):
    out = tmp_path / "fit.json"
    few = (
        "--frames",
        8,
        "--poses",
        4,
        "--sets",
        16,
        "--schemes",
        "early",
        "--iou",
        0.7,
        "--resamples",
        0,
    )
    code, said, err = run(
        "surrogate",
        "tjunction",
        "--detector",
        "tjunction",
        *few,
        "--out",
        out,
        "--cache",
        "None",
        "--json",
    )
    assert code == 0, err
    (row,) = json.loads(said)
    assert row["rms"] == pytest.approx(PINNED["surrogate"]["rms"], abs=0.02)
    assert load_models(out)[0].domain.sets == PINNED["surrogate"]["sets"]


@pytest.mark.slow
def test_a_table_holds_the_same_figures(recording, tmp_path, run):
    out = tmp_path / "table.npz"
    code, said, err = run(
        "table", recording, "--out", out, "--frames", 2, "--detector", "voxelnet", "--json"
    )
    assert code == 0, err
    table = load_table(out)
    best = {
        scheme: {size: rows[0][1] for size, rows in sizes.items()}
        for scheme, sizes in json.loads(said).items()
    }
    for scheme, sizes in PINNED["command table"]["best"].items():
        assert best[scheme] == pytest.approx(sizes, abs=0.03)
    assert float(np.mean(table.ap)) == pytest.approx(PINNED["command table"]["mean"], abs=0.01)
