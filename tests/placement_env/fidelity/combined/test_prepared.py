"""A fidelity by its name, at several thresholds and with failures."""

import numpy as np
import pytest

from placement_env.fidelity.combined.prepared import Counting
from placement_env.fidelity.combined.robust import Failing
from placement_env.objective import Objective


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
