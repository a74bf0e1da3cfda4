"""Proposals by the map: what the policy answers when it knows what is sent, or why there is none."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from placement_env.candidates.outlook.outlook import outlook
from placement_env.envs.maps.terms import Terms
from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective, Weights
from placement_env.rl.maps import map_starts
from placement_env.rl.maps.lessons import objective_of
from placement_env.rl.maps.map_network import MapNetwork
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.map_starts import MapStarts
from toolkit.sites.site import Site


@pytest.fixture(scope="module")
def policy() -> MapPolicy:
    torch.manual_seed(3)
    return MapPolicy(MapNetwork(8))


@pytest.fixture(scope="module")
def junction(made_up):
    return made_up(2, 4, 3)


@pytest.fixture(scope="module")
def objective(junction) -> Objective:
    return objective_of(junction)


@pytest.mark.parametrize("budget", [1, 3])
def test_it_is_the_policy_that_knows_what_is_sent(policy, junction, objective, budget):
    known = outlook(junction.site, junction.candidates)
    expected = policy.answer_to(known, Terms.plain(junction.candidates, budget), sent=objective.sent)
    starts = MapStarts(policy)
    assert starts.name == "map policy"
    assert starts(objective, budget) == (expected.members, "")
    assert starts(objective, budget) == MapStarts(policy)(objective, budget)
    assert 0 < len(expected.members) <= budget
    assert not objective.linked.all()
    assert objective.feasible(objective.row(expected.members)[None])[0]


def test_all_that_limits_a_set_is_kept_to(policy, junction, objective):
    starts, mount = MapStarts(policy), junction.candidates.mount
    for most in (0.5, 1.0, 2.0):
        limited = objective.weighed(objective.weights, most_price=most)
        members = starts(limited, 4).members
        assert limited.price(limited.row(members)[None])[0] <= most
        assert len(members) == int(most)
    assert starts(objective.weighed(Weights(price=9.0)), 4) == ((), "")

    def mounted_on(mounts):
        candidates, seen = replace(junction.candidates, mounts=mounts), junction.visibility
        return Objective.of(candidates, objective.scored_by, site=junction.site, visibility=seen)

    mounts = tuple(replace(each, max_sensors=2, capacity=1e6) for each in junction.candidates.mounts)
    members = starts(mounted_on(mounts), 12).members
    assert np.bincount(mount[list(members)]).max() == 2
    narrow = tuple(replace(each, capacity=1.5 * float(objective.sent.max())) for each in mounts)
    shared = mounted_on(narrow)
    members = starts(shared, 12).members
    assert shared.feasible(shared.row(members)[None])[0]


def test_links_do_not_limit_boxes(policy, junction):
    boxes = Objective.of(
        junction.candidates, Surrogate(junction.visibility, "late"), "late", site=junction.site,
        visibility=junction.visibility,
    )  # fmt: skip
    known = outlook(junction.site, junction.candidates)
    free = policy.answer_to(known, Terms.plain(junction.candidates, 4), sent=np.zeros(12))
    assert MapStarts(policy)(boxes, 4).members == free.members
    assert len(free.members) == 4


def test_the_map_is_looked_at_once(policy, objective, made_up, monkeypatch):
    looked = []

    def noted(*given):
        looked.append(given)
        return outlook(*given)

    monkeypatch.setattr(map_starts, "outlook", noted)
    starts = MapStarts(policy)
    for budget in (1, 2):
        starts(objective, budget)
        starts(objective.weighed(objective.weights, most_price=2.0), budget)
    assert len(looked) == 1
    other = objective_of(made_up(1, 4, 3))
    assert starts(other, 2) == MapStarts(policy)(other, 2)
    assert len(looked) == 3


def test_where_there_is_no_map_it_says_so(policy, junction, objective, tmp_path):
    some = objective.candidates
    nowhere = Objective.of(some, objective.scored_by)
    assert MapStarts(policy)(nowhere, 2) == (
        (),
        "no start from the map: it is not known of which site the candidates are",
    )
    field = Site("field", junction.site.area, mounts=junction.site.mounts)
    fielded = Objective.of(some, objective.scored_by, site=field, visibility=objective.visibility)
    assert MapStarts(policy)(fielded, 2) == (
        (),
        "no start from the map: that of field has no lane and no bay in its area",
    )
    none = MapStarts.shipped(tmp_path / "none")(objective, 2)
    assert none.members == ()
    assert none.note.startswith("no start from the map: no policy at")
    (tmp_path / "bad").write_bytes(b"damaged")
    assert "is damaged" in MapStarts.shipped(tmp_path / "bad")(objective, 2).note


def test_the_shipped_policy_proposes(objective):
    proposed = MapStarts.shipped()(objective, 2)
    assert len(proposed.members) == 2
    assert proposed.note == ""
