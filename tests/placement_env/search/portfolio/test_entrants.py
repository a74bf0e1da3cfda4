"""Sets worth a judgement: feasible, of every size, within the money, the same again."""

import numpy as np
import pytest

from placement_env.objective import Objective
from placement_env.search import swap
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.portfolio.entrants import Effort, Entrants, entrants, kept_entrants
from placement_env.search.portfolio.proposals import Proposal, Proposals
from toolkit.runtime.cache import Cache

TWO = Effort((1, 2))


class Proposing:
    """Proposes the last candidates."""

    name = "map policy"

    def __init__(self, note=""):
        self.note = note

    def __call__(self, objective, budget):
        count = len(objective.candidates)
        return Proposal((), self.note) if self.note else Proposal(tuple(range(count - budget, count)))


@pytest.fixture
def started(monkeypatch):
    """From which further sets each swap started."""
    starts, search = [], swap.search

    def noted(*given, also=(), **settings):
        starts.append(also)
        return search(*given, also=also, **settings)

    monkeypatch.setattr(swap, "search", noted)
    return starts


def test_a_proposal_is_an_entrant_and_swap_starts_from_it(make, started):
    objective = make(mounts=6, poses=4)
    found = entrants(objective, TWO, proposals=Proposals("map policy", {1: (3,), 2: (0, 9)}))
    assert started == [((3,),)] * 2 + [((0, 9),)] * 2  # by the objective, and the thrifty one
    rows = [tuple(np.flatnonzero(row).tolist()) for row in found.sets]
    for members in ((3,), (0, 9)):
        assert "map policy" in found.searches[rows.index(members)]
    assert sum("map policy" in names for names in found.searches) == 2
    assert found.notes == ()
    assert not any("map policy" in names for names in entrants(objective, TWO).searches)
    assert started[4:] == [()] * 4


def test_what_may_not_be_built_is_no_entrant(make):
    found = entrants(make(mounts=6, poses=4), TWO, proposals=Proposals("map policy", {2: (0, 1)}))  # on one mount
    assert not any("map policy" in names for names in found.searches)
    assert not (found.sets[:, 0] & found.sets[:, 1]).any()


def test_a_state_of_other_proposals_is_not_gone_on_with(street, started, tmp_path):
    one, other = (Proposals("map policy", {1: members}) for members in ((0,), (2,)))
    for proposals, times in ((one, 2), (one, 2), (other, 4), (Proposals(), 6), (one, 6)):
        entrants(street.objective, Effort((1,)), proposals=proposals, checkpoint=Checkpoint(tmp_path))
        assert len(started) == times


def test_why_nothing_is_proposed_is_kept(street):
    cache, asked = Cache(), {"depends_on": "a", "proposer": Proposing("no map")}
    first, again = (kept_entrants(street.objective, TWO, cache, **asked) for _ in range(2))
    assert first.notes == again.notes == ("no map",)
    poor = Objective.of(street.candidates, street.objective.scored_by, "late", most_price=1.0)
    assert kept_entrants(poor, TWO, cache, **asked).notes == ("no map",)


def test_every_size_has_the_best_set_of_all(street):
    found = entrants(street.objective, Effort((1, 2, 3)))
    assert street.objective.feasible(found.sets).all()
    sizes = found.sets.sum(axis=1)
    assert (np.diff(sizes) >= 0).all()
    best = {size: found.predicted[sizes == size].max() for size in (1, 2, 3)}
    assert best == {1: 0.5, 2: 0.75, 3: 1.0}
    assert len(np.unique(found.sets, axis=0)) == len(found.sets)
    three = int(np.flatnonzero(sizes == 3)[found.predicted[sizes == 3].argmax()])
    assert {"exhaustive", "greedy"} <= set(found.searches[three])
    assert found.considered > 14
    assert np.array_equal(found.predicted, street.objective.scores(found.sets).ap)


def test_money_is_kept_to(street):
    # the sets cost 11, 11, 10.5 and 23
    tight = Objective.of(street.candidates, street.objective.scored_by, "late", most_price=22.0)
    found = entrants(tight, Effort((1, 2, 3, 4)))
    assert tight.price(found.sets).max() == 22.0
    assert found.sets.sum(axis=1).max() == 2


def test_the_same_again(street):
    first, again = (
        entrants(street.objective, Effort((1, 2)), seed=3),
        entrants(street.objective, Effort((1, 2)), seed=3),
    )
    assert np.array_equal(first.sets, again.sets)
    assert (first.searches, first.considered) == (again.searches, again.considered)


def test_nothing_to_build(street):
    poor = Objective.of(street.candidates, street.objective.scored_by, "late", most_price=1.0)
    found = entrants(poor, Effort((1, 2)))
    assert (found.sets.shape, found.predicted.shape, found.searches) == ((0, 4), (0,), ())


def test_large_pools(make):
    stages = []
    found = entrants(
        make(mounts=6, poses=4), Effort((1, 2), neighbours=3), progress=lambda *stage: stages.append(stage)
    )
    assert stages == [("searching", 1, 2), ("searching", 2, 2)]
    assert not any("exhaustive" in names for names in found.searches)
    assert 4 <= len(found.sets) <= 14


def test_they_are_kept_under_all_that_they_depend_on(street, monkeypatch):
    cache = Cache()
    first = kept_entrants(street.objective, TWO, cache, depends_on="a", seed=1)
    assert first.searches == entrants(street.objective, TWO, seed=1).searches
    rich = Objective.of(street.candidates, street.objective.scored_by, "late", most_price=900.0)
    monkeypatch.setattr("placement_env.search.portfolio.entrants.entrants", lambda *_, **__: pytest.fail("searched"))
    again = kept_entrants(street.objective, TWO, cache, depends_on="a", seed=1)
    assert np.array_equal(first.sets, again.sets)
    assert np.array_equal(first.predicted, again.predicted)
    assert (first.searches, first.considered) == (again.searches, again.considered)
    for objective, effort, changes in (
        (street.objective, Effort((1, 2, 3)), {}),
        (street.objective, Effort((1, 2), evaluations=9), {}),
        (street.objective, TWO, {"depends_on": "b"}),
        (street.objective, TWO, {"seed": 2}),
        (street.objective, TWO, {"proposer": Proposing()}),
        (street.objective, TWO, {"proposer": Proposing("no map")}),
        (rich, TWO, {}),
    ):
        with pytest.raises(pytest.fail.Exception, match="searched"):
            kept_entrants(objective, effort, cache, **{"depends_on": "a", "seed": 1, **changes})


def test_none_are_kept_too():
    none = Entrants(np.zeros((0, 4), bool), np.zeros(0), (), 3)
    assert Entrants.of(none.arrays()).searches == ()
    assert Entrants.of(none.arrays()).sets.shape == (0, 4)
