"""What a cheap fidelity found is tried by a dear one: all entrants on few frames, the best on
all."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.candidates import paper_candidates
from placement_env.cases import Cases
from placement_env.fidelity.cases_fidelity import ProfileFidelities, over_cases
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.search import greedy, verification
from placement_env.setting import Setting
from placement_env.subsets import all_subsets
from toolkit.sites.files import load_site


class PerFrame:
    """AP of a set: the share of what its sensors see in a frame, different in each; counts what it
    is asked."""

    name = "detector"

    def __init__(self, candidates=8, frames=60, seed=0):
        self.frames, self.asked = frames, 0
        rng = np.random.default_rng(seed)
        self.seen = rng.random((candidates, frames, 30)) < rng.uniform(
            0.05, 0.4, (candidates, 1, 1)
        )

    def partial(self, subsets, frames):
        self.asked += len(subsets) * len(frames)
        share = np.array(
            [self.seen[row][:, frames].any(axis=0).mean() if row.any() else 0.0 for row in subsets]
        )
        return Estimate(share, share, 100.0 * subsets.sum(axis=1))

    def __call__(self, subsets, /):
        return self.partial(subsets, range(self.frames))


class Half:
    """The same from the first half of the frames: a cheap fidelity that errs."""

    name = "coverage"

    def __call__(self, subsets, /):
        return PerFrame().partial(subsets, range(30))


@pytest.fixture
def dear():
    return Objective(
        Setting(candidates=paper_candidates(load_site("roundabout")), fidelity=PerFrame())
    )


def test_a_race_finds_the_best_of_all_sets_for_a_part_of_the_frames(dear):
    sets = all_subsets(8)[1:]
    sets = sets[sets.sum(axis=1) == 3]
    ran = dear.race(sets)
    assert dear.scores(sets).reward.argmax() == ran.winners[0]
    assert ran.spent < ran.full / 3
    assert dear.scores(sets[ran.winners[:1]]).reward[0] == pytest.approx(ran.scores[0])
    objective = Objective(Setting("roundabout", fidelity="table"))
    for ask in (
        lambda: objective.race(np.eye(8, dtype=bool)),
        lambda: greedy.search_by_races(objective, 2),
    ):
        with pytest.raises(ValueError, match="all frames at once"):
            ask()
    plain = greedy.search(dear, 3)
    dear.forget()
    dear.scored_by.asked = 0
    raced = greedy.search_by_races(dear, 3, seed=1)
    assert raced.best.reward == pytest.approx(plain.best.reward, abs=0.02)
    assert raced.evaluations < plain.evaluations
    assert raced.best.reward == dear.score(raced.best.subset).reward
    assert greedy.search_by_races(dear, 3, evaluations=1).evaluations < raced.evaluations


def test_neighbours_of_an_answer_are_ranked(dear):
    cheap = Objective(Setting(candidates=dear.candidates, fidelity=Half()))
    found = greedy.search(cheap, 3)
    dear.scored_by.asked = 0
    ranking = verification.verified(cheap, dear, np.array(found.best.subset))
    assert len(ranking.sets) == 5
    assert (np.diff(ranking.accurate) <= 0).all()
    assert ranking.accurate == pytest.approx(dear.scores(ranking.sets).reward)
    around = verification.neighbours(np.array(found.best.subset), 8)
    assert (
        ranking.accurate[0]
        == dear.scores(around).reward.max()
        >= dear.score(found.best.subset).reward
    )
    assert len(around) == 16
    found = greedy.search(dear, 2)
    assert verification.score_result(dear, found).ap == found.best.ap


def test_races_over_profiles_go_by_what_counts(dear):
    # A race over profiles goes by what counts; each profile is said by itself.
    other = PerFrame(seed=1)
    both = Objective(
        Setting(candidates=dear.candidates, fidelity=at_profiles(dear.scored_by, other))
    )
    row = both.row([0, 3])[None]
    said = verification.ap_at_profiles(both, (0, 3))
    assert said == {"paper": float(dear.scored_by(row).ap[0]), "poor": float(other(row).ap[0])}
    assert both.score([0, 3]).ap == min(said.values())
    assert verification.ap_at_profiles(dear, (0, 3)) == verification.ap_at_profiles(both, ()) == {}
    ranking = verification.verified(dear, both, np.array([0, 3]))
    assert (
        both.score(np.flatnonzero(ranking.sets[0])).reward == both.scores(ranking.sets).reward.max()
    )


class Worths:
    """Sum of what each sensor is worth; counts the sets that it scores."""

    name = "made up"

    def __init__(self, *worth):
        self.worth, self.scored = np.array([*worth, *np.zeros(8 - len(worth))]), 0

    def __call__(self, subsets, /):
        self.scored += len(subsets)
        ap = subsets @ self.worth
        return Estimate(ap, ap, 0.0 * ap)


def test_all_that_tie_are_ranked_and_equal_ones_as_the_cheap_fidelity_has_it(dear):
    def ranked(cheap, accurate, best):
        fast, exact = (
            Objective(Setting(candidates=dear.candidates, fidelity=each, scheme="late"))
            for each in (cheap, accurate)
        )
        cheap.scored = accurate.scored = 0
        return verification.verified(fast, exact, np.array([0]), best=best)

    accurate = Worths(0.5, 0.6, 0.6, 0.9)
    found = ranked(Worths(0.9, 0.8, 0.7, 0.1), accurate, 3)
    assert found.sets.argmax(axis=1).tolist() == [1, 2, 0]
    assert found.fast.tolist() == [0.8, 0.7, 0.9]
    assert found.accurate.tolist() == [0.6, 0.6, 0.5]
    assert accurate.scored == 3
    assert len(ranked(Worths(), Worths(0.1, 0.2), 1).sets) == 8
    assert len(ranked(Worths(0.1, 0.2), Worths(), 99).sets) == 8
    with pytest.raises(ValueError, match="best must be a whole number of at least 1"):
        ranked(Worths(), Worths(), 0)


def at_profiles(*fidelities):
    return over_cases(
        [ProfileFidelities(each, ((each,),)) for each in fidelities],
        Cases(errors=("paper", "poor")),
    )


def test_sensors_that_were_moved_are_scored_at_each_profile_where_they_stand(dear, monkeypatch):
    both = Objective(
        Setting(candidates=dear.candidates, fidelity=at_profiles(dear.scored_by, dear.scored_by))
    )
    there = Preparation(Setting(load_site("tjunction"), candidates=dear.candidates, detector=print))
    vars(there)["traffic"] = None
    vars(both)["preparation"] = there
    asked = []

    def build_pose_scorer(preparation, weights):
        (errors,) = preparation.setting.cases.names

        def score(sets):
            asked.append((errors, sets))
            return [replace(dear.score([0]), ap={"paper": 0.9, "poor": 0.4}[errors])]

        return score

    monkeypatch.setattr("placement_env.search.cmaes.build_pose_scorer", build_pose_scorer)
    moved = dear.candidates.sensors[:2]
    assert verification.ap_at_profiles(both, (0, 1), moved) == {"paper": 0.9, "poor": 0.4}
    assert asked == [("paper", [moved]), ("poor", [moved])]
