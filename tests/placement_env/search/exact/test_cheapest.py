"""The cheapest set that reaches an AP, against trying all."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.hit_model import HitModel
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.visibility import Visibility, of_frames
from placement_env.objective import Objective
from placement_env.search.exact import cheapest, programme
from placement_env.search.exact.cheapest import Demand
from placement_env.setting import Setting
from placement_env.subsets import all_subsets

pytest.importorskip("ortools")
MODEL = HitModel("early", 0.7, -4.0, 1.8, 0.98, 0.7, 0.3, "made up", floor=5.0)


@pytest.fixture
def junction(make):
    """Ten candidates on five mounts of random prices and what they see in eight frames."""

    def junction(fidelity, seed=0, **more):
        candidates = make(5, 2, seed=seed).candidates
        rng = np.random.default_rng(seed)
        points = np.where(rng.random((10, 64)) < 0.35, rng.lognormal(4, 1.0, (10, 64)), 0).astype(
            np.float32
        )
        boxes = np.zeros((64, 7))
        sent = np.full((10, 8), 100.0, np.float32)
        near = np.full((10, 64), 20.0, np.float32)
        seen = Visibility(points, near, np.repeat(np.arange(8), 8), boxes, sent, sent)
        scored_by = Coverage(seen) if fidelity == "coverage" else Surrogate(seen, "early", MODEL)
        return Objective(
            Setting(candidates=candidates, fidelity=scored_by, **more), visibility=seen
        )

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
        least = cheapest_of_all(
            objective, 4, lambda row, s=share: objective.scores(row[None]).ap[0] >= s
        )
        found = cheapest.search(objective, 4, demand=Demand(at_least=share))
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
        return min(
            covered[[m for m in members if m != gone]].any(axis=0).mean() for gone in members
        )

    def worst_part(row):
        covered = (objective.visibility.points[row] >= 20).any(axis=0)
        return min(covered[frame // 4 == part].mean() for part in (0, 1))

    for option, reaches in (({"failing": 1}, left), ({"parts": 2}, worst_part)):
        least = cheapest_of_all(objective, 5, lambda row, reaches=reaches: reaches(row) >= 0.5)
        found = cheapest.search(objective, 5, demand=Demand(at_least=0.5, **option))
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
        least = cheapest_of_all(
            objective, 4, lambda row, ap=ap: objective.scores(row[None]).ap[0] >= ap
        )
        found = cheapest.search(objective, 4, demand=Demand(at_least=ap))
        if least is None:
            assert found.best.subset == ()
            continue
        assert found.best.ap >= ap
        assert found.certificate.bound <= least + 1e-9 <= found.best.price + 2e-9
        assert found.best.price <= 1.3 * least
        assert found.certificate.gap == pytest.approx(found.best.price - found.certificate.bound)


CONDITIONS = [{"failing": 1}, {"levels": 2}, {"parts": 2}, {"failing": 1, "levels": 2}]


@pytest.mark.one_in(4)
@pytest.mark.parametrize("asked", CONDITIONS)
def test_by_a_surrogate_whichever_sensor_fails_and_at_each_level(junction, asked):
    """What the answer leaves is counted here frame by frame, not by the demand's own means."""
    seed = 3 + CONDITIONS.index(asked)
    objective = junction("surrogate", seed)
    seen = objective.visibility
    order = (
        np.argsort(np.bincount(seen.frame), kind="stable") if "levels" in asked else np.arange(8)
    )
    halves = (
        [np.sort(half) for half in np.split(order, 2)]
        if {"levels", "parts"} & set(asked)
        else [np.arange(8)]
    )
    by = [Surrogate(of_frames(seen, half), "early", MODEL) for half in halves]

    def reached(row):
        left = [row]
        if "failing" in asked:
            left = [np.where(np.arange(10) == gone, False, row) for gone in np.flatnonzero(row)]
        return min(float(each(case[None]).ap[0]) for each in by for case in left)

    worst = max(
        reached(row)
        for row in all_subsets(10)[1:]
        if row.sum() <= 4 and objective.feasible(row[None])[0]
    )
    for ap in (0.6 * worst, 0.9 * worst):
        least = cheapest_of_all(objective, 4, lambda row, ap=ap: reached(row) >= ap)
        found = cheapest.search(objective, 4, demand=Demand(at_least=ap, **asked))
        known = found.certificate
        assert reached(objective.row(found.best.subset)) >= ap - 1e-6
        assert 0 < known.bound <= least + 1e-9 <= found.best.price + 2e-9
        assert found.best.price <= 1.3 * least
        assert f"AP {reached(objective.row(found.best.subset)):.4f} in the worst case" in known.note
    none = cheapest.search(objective, 4, demand=Demand(at_least=min(1.0, worst + 0.2), **asked))
    assert none.best.subset == ()
    assert ("whichever sensor fails" in none.certificate.note) == ("failing" in asked)


def test_bounds_under_failures_and_steps_of_shares(junction):
    objective = junction("surrogate", 5)
    plain, failing = (
        cheapest.search(objective, 4, demand=Demand(at_least=0.3, failing=each)) for each in (0, 1)
    )
    assert len(failing.best.subset) >= 2
    assert plain.certificate.bound < failing.certificate.bound
    objective = junction("surrogate", 1)
    surrogate = objective.scored_by
    halves = [surrogate.in_frames(np.arange(4)), surrogate.in_frames(np.arange(4, 8))]
    both = cheapest.join_levels([cheapest.build_levels(half, above=True) for half in halves])
    each = [cheapest.build_levels(half, above=True) for half in halves]
    assert both.groups.shape == (2, 64)
    assert (both.groups.sum(axis=0) == 1).all()
    for chosen in ([0], [1, 4], [0, 3, 9]):
        assert both.worth(chosen) == min(one.worth(chosen) for one in each)
    usual = cheapest.build_levels(surrogate, above=True)
    objective.visibility.boxes[:20, 3:6] = 8.0, 2.0, 2.0
    bulky = Surrogate(objective.visibility, "early", replace(MODEL, bulk=1.0))
    levels = cheapest.build_levels(bulky, above=True)
    np.testing.assert_array_equal(levels.evidence, usual.evidence)
    np.testing.assert_allclose(levels.gain[:, :20], usual.gain[:, :20] / 2, atol=1)
    np.testing.assert_array_equal(levels.gain[:, 20:], usual.gain[:, 20:])
    for chosen in ([0], [1, 4], [0, 3, 9]):
        row = np.isin(np.arange(10), chosen)[None]
        assert levels.worth(chosen) / programme.GAIN_UNITS >= bulky(row).recall[0]


def test_impossible_demands_and_what_it_cannot_prove(junction, make):
    found = cheapest.search(
        junction("coverage", 1, most_price=1.0), 4, demand=Demand(at_least=0.99)
    )
    assert found.best.subset == ()
    assert found.certificate.note == "no set within the budget covers 99% of the objects"
    best = junction("surrogate", 1, most_price=1.0)
    assert cheapest.search(best, 4, demand=Demand(at_least=0.99)).best.subset == ()
    with pytest.raises(ValueError, match="must lie above 0 and up to 1, got 90"):
        cheapest.search(junction("coverage"), 2, demand=Demand(at_least=90.0))
    with pytest.raises(ValueError, match="0 or 1 sensor may fail here, got failing=2"):
        cheapest.search(junction("coverage"), 2, demand=Demand(failing=2))
    with pytest.raises(ValueError, match="known by --fidelity coverage or surrogate, got coverage"):
        cheapest.search(make(), 2)
