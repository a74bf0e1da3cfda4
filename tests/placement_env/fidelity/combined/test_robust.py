"""What is left of a set when sensors fail, against trying every failure."""

from itertools import combinations

import numpy as np
import pytest

from placement_env.cases import TIE
from placement_env.fidelity.combined.robust import Failing, RobustByFrames, RobustFidelity, robust
from placement_env.fidelity.coverage import Coverage
from placement_env.objective import Objective
from placement_env.search import swap
from placement_env.subsets import all_subsets

SETS = all_subsets(4)


@pytest.mark.parametrize("failing", [1, 2])
@pytest.mark.parametrize("combine", ["mean", "worst"])
def test_what_is_left_is_that_of_every_failure(seen, failing, combine):
    plain = Coverage(seen)
    found = robust(plain, Failing(failing, combine))
    assert isinstance(found, RobustFidelity)
    left = found(SETS)
    for row, ap, recall in zip(SETS, left.ap, left.recall, strict=True):
        members = np.flatnonzero(row).tolist()
        cases = []
        for lost in combinations(members, failing):
            remaining = row.copy()
            remaining[list(lost)] = False
            cases.append(float(plain(remaining[None]).ap[0]))
        expected = 0.0 if len(members) <= failing else min(cases) if combine == "worst" else np.mean(cases)
        assert ap == pytest.approx(expected + TIE * plain(row[None]).ap[0], abs=1e-12)
        assert recall == ap
    assert np.array_equal(left.kbit, plain(SETS).kbit)
    assert found.by_class(SETS).ap[:, 0] == pytest.approx(left.ap)
    assert (found.name, found.classes) == ("coverage", plain.classes)


def test_nothing_fails(seen):
    plain = Coverage(seen)
    assert robust(plain, Failing()) is plain


def test_detection_of_some_frames(street):
    found = robust(street.detected, Failing(1))
    assert isinstance(found, RobustByFrames)
    pair = np.array([[1, 1, 0, 0]], bool)
    assert found.frames == 8
    assert found.partial(pair, [1, 2]).ap[0] == pytest.approx(0.5, abs=1e-5)
    assert found(pair).ap[0] == pytest.approx(0.5, abs=1e-5)


def test_an_objective_for_the_worst_case_prefers_sets_that_stand_it():
    plain = Objective("tjunction", fidelity="table")
    hardy = Objective("tjunction", fidelity="table", failing=1)
    best, hardiest = (swap.search(objective, 3).best for objective in (plain, hardy))

    def worst(subset):
        return min(plain.score([c for c in subset if c != gone]).ap for gone in subset)

    every = [worst(chosen) for chosen in combinations(range(6), 3)]
    assert worst(hardiest.subset) == max(every) >= worst(best.subset)
    assert hardiest.ap == pytest.approx(max(every), abs=1e-5)
    assert hardy.provenance["failing"] == {"sensors": 1, "combine": "worst"}
    assert "failing" not in plain.provenance


@pytest.mark.parametrize("wrong", [{"sensors": 3}, {"sensors": -1}, {"sensors": True}, {"sensors": 1.0}])
def test_what_is_no_failure_is_refused(wrong):
    with pytest.raises((TypeError, ValueError)):
        Failing(**wrong)
    with pytest.raises((TypeError, ValueError)):
        Failing(1, "median")
