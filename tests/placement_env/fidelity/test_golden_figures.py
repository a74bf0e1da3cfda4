"""Shipped tables stay as published, and cheap fidelities give the same figures of fixed traffic."""

import hashlib

import numpy as np
import pytest

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.hit_model import shipped_model
from placement_env.fidelity.perception_entropy import PerceptionEntropy
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.table import SHIPPED, TableFidelity, hash_site, load_table
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.setting import Setting
from placement_env.subsets import all_subsets
from toolkit.sites.files import load_site

SCHEMES = ("early", "late", "hybrid")
FILES = {
    "tjunction": "92642fd79d9473829e1cfe5274ab444cacb47bbfc73abd27a06ab3f458160319",
    "roundabout": "45fa4322016fc21e505dfe758216e49a5f2f80f087f841f7c80b34d6af31c57c",
}
# Per table, scheme and IoU 0.7, 0.8, 0.9: AP, recall and kbit of all sets, each weighed by `weigh`.
TABLES = {
    ("tjunction", "early"): [
        1.71037,
        1.70665,
        1914.36527,
        1.51229,
        1.58355,
        1914.36527,
        0.3542,
        0.7006,
        1914.36527,
    ],
    ("tjunction", "late"): [
        1.68429,
        1.68641,
        6.89054,
        1.4361,
        1.5273,
        6.89054,
        0.51263,
        0.79945,
        6.89054,
    ],
    ("tjunction", "hybrid"): [
        1.70218,
        1.70032,
        434.1671,
        1.49735,
        1.57029,
        434.1671,
        0.58218,
        0.86055,
        434.1671,
    ],
    ("roundabout", "early"): [
        -0.88958,
        -0.90453,
        51.76858,
        -0.8405,
        -0.83898,
        51.76858,
        -0.48998,
        -0.65389,
        51.76858,
    ],
    ("roundabout", "late"): [
        *(
            -0.88985,
            -0.90715,
            -12.96672,
            -0.72628,
            -0.76989,
            -12.96672,
            -0.17175,
            -0.36154,
            -12.96672,
        )
    ],
    ("roundabout", "hybrid"): [
        *(
            -0.91139,
            -0.9217,
            -983.80501,
            -0.83618,
            -0.83721,
            -983.80501,
            -0.3692,
            -0.55418,
            -983.80501,
        )
    ],
}
CHEAP = {
    ("coverage", "early"): [26.225, 26.225],
    ("surrogate", "early"): [25.159, 25.2525],
    ("entropy", "early"): [27.0875, 27.0875],
    ("coverage", "late"): [26.225, 26.225],
    ("surrogate", "late"): [22.6835, 23.0124],
    ("entropy", "late"): [27.3555, 27.3555],
    ("coverage", "hybrid"): [26.225, 26.225],
    ("surrogate", "hybrid"): [23.5138, 23.7694],
    ("entropy", "hybrid"): [27.3555, 27.3555],
}
SENT = {"early": 427.2512, "late": 0.8368, "hybrid": 231.6096}


def weigh(column):
    """Sum over sets, each with a weight of its own, so that sets that change places are noticed
    too."""
    return float(np.asarray(column, np.float64) @ np.cos(np.arange(len(column))))


@pytest.mark.parametrize("name", FILES)
def test_shipped_tables_are_the_same_files_of_the_built_in_sites(name):
    assert hashlib.sha256((SHIPPED / f"{name}.npz").read_bytes()).hexdigest() == FILES[name]
    site = load_site(name)
    assert load_table(name).origin.place == hash_site(site, site.sensors)
    assert Objective(Setting(name, fidelity="table")).score([0]).ap > 0


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_shipped_tables_serve_the_same_figures(name, scheme):
    table = load_table(name)
    figures = [TableFidelity(table, scheme, iou)(table.subsets) for iou in (0.7, 0.8, 0.9)]
    now = [weigh(column) for estimate in figures for column in estimate]
    assert now == pytest.approx(TABLES[name, scheme], rel=1e-6, abs=1e-4)


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(17)
    points = rng.integers(0, 300, (5, 40)) * (rng.random((5, 40)) < 0.6)
    boxes = np.column_stack(
        [rng.uniform(-30, 30, (40, 2)), np.tile([0.75, 4, 2, 1.5], (40, 1)), rng.uniform(-3, 3, 40)]
    )
    sent = rng.uniform(1000, 6000, (5, 8)).astype(np.float32)
    return Visibility(
        points.astype(np.float32),
        rng.uniform(2, 45, (5, 40)).astype(np.float32),
        np.sort(rng.integers(0, 8, 40)),
        boxes,
        sent,
        (sent * rng.random((5, 8))).astype(np.float32),
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_cheap_fidelities_say_the_same(seen, scheme):
    sets = all_subsets(5)
    found = {
        "coverage": Coverage(seen, scheme)(sets),
        "surrogate": Surrogate(seen, scheme, shipped_model(scheme, 0.7, "tjunction"), radius=20.0)(
            sets
        ),
        "entropy": PerceptionEntropy(seen, scheme)(sets),
    }
    for estimate in found.values():
        assert weigh(estimate.kbit) == pytest.approx(SENT[scheme], rel=1e-6, abs=1e-4)
    for (
        name,
        estimate,
    ) in found.items():  # sums of float32 differ in the last digits between processors
        assert [float(ap.sum()) for ap in estimate[:2]] == pytest.approx(
            CHEAP[name, scheme], rel=1e-4
        )
