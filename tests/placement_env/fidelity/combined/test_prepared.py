"""A fidelity by its name, at several thresholds and with failures."""

from typing import Any

import numpy as np
import pytest

from placement_env.classes import VEHICLES
from placement_env.fidelity.combined.error_profiles import ErrorProfiles
from placement_env.fidelity.combined.prepared import Counting
from placement_env.fidelity.combined.robust import Failing
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from toolkit.objects import Detections
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR


def test_an_objective_of_several_thresholds_is_their_mean():
    several = Objective("tjunction", fidelity="table", iou=(0.7, 0.9))
    each = [Objective("tjunction", fidelity="table", iou=iou) for iou in (0.7, 0.9)]
    sets = np.eye(6, dtype=bool)
    assert several.scores(sets).ap == pytest.approx(np.mean([one.scores(sets).ap for one in each], axis=0))
    assert several.provenance["iou"] == [0.7, 0.9]
    assert each[0].provenance["iou"] == 0.7
    assert several.score([0, 1]).class_ap == {"vehicle": several.score([0, 1]).ap}


def test_a_threshold_without_a_table_is_refused():
    with pytest.raises(ValueError, match=r"got 'early' and 0\.5"):
        Objective("tjunction", fidelity="table", iou=(0.5, 0.7))


def test_what_counts():
    plain = Counting.of(0.7)
    assert plain.plain
    assert plain.origin == {"iou": 0.7}
    assert not Counting.of((0.5, 0.7)).plain
    hardy = Counting.of(0.7, 1)
    assert (hardy.failing, hardy.plain) == (Failing(1), False)
    assert hardy.origin == {"iou": 0.7, "failing": {"sensors": 1, "combine": "worst"}}


def test_what_was_seen_is_seen_once():
    objective = Objective("tjunction", 1, fidelity="coverage", iou=(0.5, 0.7))
    made = objective.counting.preparations(objective.preparation)
    assert [each.iou for each in made] == [0.5, 0.7]
    assert made[0].visibility is made[1].visibility is objective.visibility
    assert made[0].traffic is made[1].traffic


class Blind:
    digest = "blind"

    def __call__(self, points, /):
        return Detections.empty()


WORTH = {("paper", 0.7): (0.8, 0.2), ("paper", 0.9): (0.4, 0.2), ("poor", 0.7): (0.3, 0.5), ("poor", 0.9): (0.3, 0.3)}


@pytest.mark.parametrize(
    ("iou", "failing", "combine", "paper", "poor", "ap"),
    [
        (0.7, Failing(0), "worst", 1.0, 0.8, 0.8),
        ((0.7, 0.9), Failing(0), "worst", 0.8, 0.7, 0.7),
        (0.7, Failing(1), "worst", 0.2, 0.3, 0.2),
        (0.7, Failing(1, "mean"), "worst", 0.5, 0.4, 0.4),
        (0.7, Failing(1), "mean", 0.2, 0.3, 0.25),
        ((0.7, 0.9), Failing(1), "mean", 0.2, 0.3, 0.25),
    ],
)
def test_profiles_are_combined_last(monkeypatch, iou, failing, combine, paper, poor, ap):
    """A set is worth the sum of its two sensors: failures and thresholds first, at each profile by itself."""

    class Sum:
        name, classes = "detector", VEHICLES

        def __init__(self, worth):
            self.worth = np.array(worth)

        def __call__(self, subsets, /):
            return Estimate(subsets @ self.worth, subsets @ self.worth, 10.0 * subsets.sum(axis=1))

    def fidelity(self, name):
        assert name == "detector"
        return Sum(WORTH[self.errors.name, self.iou])

    errors = ErrorProfiles((PAPER_ERRORS, POOR), combine)
    made = Objective("tjunction", 1, fidelity="table", iou=0.7).preparation.changed(errors=errors, detector=Blind())
    monkeypatch.setattr(Preparation, "fidelity", fidelity)
    counted: Any = Counting.of(iou, failing).fidelity(made, "detector")
    both = np.array([[True, True]])
    assert counted(both).ap == pytest.approx([ap], abs=2e-6)
    assert {name: each.ap[0] for name, each in counted.at_each(both).items()} == pytest.approx(
        {"paper": paper, "poor": poor}, abs=2e-6
    )
    with pytest.raises(ValueError, match="'paper and poor' are known to fidelity detector alone, got 'coverage'"):
        Counting.of(iou, failing).fidelity(made, "coverage")
