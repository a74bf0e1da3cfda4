"""The cheapest set that reaches an AP, against trying all."""

import numpy as np
import pytest

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.hits.hit_model import HitModel
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search.exact import cheapest
from placement_env.subsets import all_subsets

pytest.importorskip("ortools")
MODEL = HitModel("early", 0.7, -4.0, 1.8, 0.98, 0.7, 0.3, "made up", floor=5.0)


@pytest.fixture
def junction(make):
    """Ten candidates on five mounts of random prices and what they see in eight frames."""

    def junction(fidelity, seed=0, **more):
        candidates = make(5, 2, seed=seed).candidates
        rng = np.random.default_rng(seed)
        points = np.where(rng.random((10, 64)) < 0.35, rng.lognormal(4, 1.0, (10, 64)), 0).astype(np.float32)
        boxes = np.zeros((64, 7))
        sent = np.full((10, 8), 100.0, np.float32)
        near = np.full((10, 64), 20.0, np.float32)
        seen = Visibility(points, near, np.repeat(np.arange(8), 8), boxes, sent, sent)
        scored_by = Coverage(seen) if fidelity == "coverage" else Surrogate(seen, "early", MODEL)
        return Objective.of(candidates, scored_by, visibility=seen, **more)

    return junction


def cheapest_of_all(objective, budget, reaches):
    sets = all_subsets(10)[1:]
    sets = sets[(sets.sum(axis=1) <= budget) & objective.feasible(sets)]
    good = sets[[reaches(row) for row in sets]]
    return float(objective.price(good).min()) if len(good) else None


@pytest.mark.parametrize("seed", range(4))
def test_the_cheapest_coverage_is_proven(junction, seed):
    objective = junction("coverage", seed)
    best = objective.scores(all_subsets(10)[1:]).ap
    for share in (0.4, 0.7):
        least = cheapest_of_all(objective, 4, lambda row, s=share: objective.scores(row[None]).ap[0] >= s)
        found = cheapest.search(objective, 4, at_least=share)
        if least is None:
            assert found.best.subset == ()
            assert found.certificate.note.startswith("no set within the budget covers")
            continue
        assert found.best.price == pytest.approx(least)
        assert found.best.ap >= share
        known = found.certificate
        assert (known.kind, known.measure, known.gap) == ("optimal", "price", 0.0)
        assert known.value == known.bound == pytest.approx(least)
    assert best.max() <= 1


@pytest.mark.parametrize("seed", range(3))
def test_whichever_sensor_fails_and_in_every_part_of_the_traffic(junction, seed):
    objective = junction("coverage", seed)
    frame = np.repeat(np.arange(8), 8)

    def left(row):
        members = np.flatnonzero(row)
        covered = objective.visibility.points >= 20
        return min(covered[[m for m in members if m != gone]].any(axis=0).mean() for gone in members)

    def worst_part(row):
        covered = (objective.visibility.points[row] >= 20).any(axis=0)
        return min(covered[frame // 4 == part].mean() for part in (0, 1))

    for option, reaches in (({"failing": 1}, left), ({"parts": 2}, worst_part)):
        least = cheapest_of_all(objective, 5, lambda row, reaches=reaches: reaches(row) >= 0.5)
        found = cheapest.search(objective, 5, at_least=0.5, **option)
        if least is None:
            assert found.best.subset == ()
        else:
            assert found.best.price == pytest.approx(least)
            assert reaches(objective.row(found.best.subset)) >= 0.5
            assert found.certificate.kind == "optimal"


@pytest.mark.parametrize("seed", range(3))
def test_by_a_surrogate_the_answer_reaches_it_and_no_set_is_cheaper_than_the_bound(junction, seed):
    objective = junction("surrogate", seed)
    for ap in (0.3, 0.6):
        least = cheapest_of_all(objective, 4, lambda row, ap=ap: objective.scores(row[None]).ap[0] >= ap)
        found = cheapest.search(objective, 4, at_least=ap)
        if least is None:
            assert found.best.subset == ()
            continue
        assert found.best.ap >= ap
        assert found.certificate.bound <= least + 1e-9 <= found.best.price + 2e-9
        assert found.best.price <= 1.3 * least
        assert found.certificate.gap == pytest.approx(found.best.price - found.certificate.bound)


def test_money_and_impossible_demands(junction):
    objective = junction("coverage", 1, most_price=1.0)
    found = cheapest.search(objective, 4, at_least=0.99)
    assert found.best.subset == ()
    assert found.certificate.note == "no set within the budget covers 99% of the objects"
    best = junction("surrogate", 1, most_price=1.0)
    assert cheapest.search(best, 4, at_least=0.99).best.subset == ()


def test_it_refuses_what_it_cannot_prove(junction, make):
    with pytest.raises(ValueError, match="constraints of --fidelity coverage"):
        cheapest.search(junction("surrogate"), 2, failing=1)
    with pytest.raises(ValueError, match="must lie above 0 and up to 1, got 90"):
        cheapest.search(junction("coverage"), 2, at_least=90.0)
    with pytest.raises(ValueError, match="0 or 1 sensor may fail here, got failing=2"):
        cheapest.search(junction("coverage"), 2, failing=2)
    with pytest.raises(ValueError, match="known by --fidelity coverage or surrogate, got coverage"):
        cheapest.search(make(), 2)
