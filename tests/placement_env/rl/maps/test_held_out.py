import numpy as np
import pytest
import torch

from placement_env.candidates.outlook.outlook import outlook
from placement_env.envs.maps.junctions import Junction, JunctionSource
from placement_env.envs.maps.terms import Terms
from placement_env.rl.maps import held_out
from placement_env.rl.maps.held_out import Comparison, HeldOut, built_ap, compared, tables, tried, tried_at
from placement_env.rl.maps.lessons import objective_of
from placement_env.rl.maps.map_network import MapNetwork
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.schooling import JunctionFolder
from placement_env.search import greedy


@pytest.fixture
def policy() -> MapPolicy:
    torch.manual_seed(0)
    return MapPolicy(MapNetwork(8))


@pytest.fixture
def seen(monkeypatch, made_up):
    """What greedy looks at is that of another seed; the empty site sends 100 kbit from everywhere."""
    asked = []

    def other_traffic(source, junction, folder, *, frames):
        asked.append((source.name, folder, frames))
        return made_up(9, 4, 3).visibility

    monkeypatch.setattr(held_out, "other_traffic", other_traffic)
    monkeypatch.setattr(held_out, "sent_when_empty", lambda *_: lambda members: np.full(len(members), 100.0))
    return asked


def test_greedy_looks_at_other_traffic_than_judges(seen, made_up, policy, tmp_path):
    junction = made_up(2, 4, 3)
    rows = tried(JunctionSource.of_seed(2), junction, tmp_path, {"mine": policy}, budgets=(1, 3), frames=5)
    assert seen == [("000002", tmp_path, 5)]
    assert [(row.junction, row.budget) for row in rows] == [("000002", 1), ("000002", 3)]
    looked_at = objective_of(Junction(junction.site, junction.candidates, made_up(9, 4, 3).visibility))
    judged, linked = objective_of(junction), looked_at.linked
    for row in rows:
        assert list(row.ap) == ["greedy", "mine", "mine, links looked at"]
        assert row.ap["greedy"] == built_ap(judged, greedy.search(looked_at, row.budget).best.subset, linked)
        terms = Terms.plain(junction.candidates, row.budget)
        known = outlook(junction.site, junction.candidates)
        assert row.ap["mine"] == built_ap(judged, policy.answer_to(known, terms).members, linked)
        checked = policy.answer_checked(known, terms, lambda members: np.full(len(members), 100.0))
        assert row.ap["mine, links looked at"] == built_ap(judged, checked.members, linked)


def test_what_no_link_carries_is_not_built(made_up):
    judged, linked = objective_of(made_up(2, 4, 3)), np.arange(12) != 7
    assert built_ap(judged, [3, 7], linked) == judged.score([3]).ap
    assert built_ap(judged, [7], linked) == 0


def test_several_junctions(seen, monkeypatch, made_up, policy, tmp_path):
    monkeypatch.setattr(JunctionFolder, "junction", lambda self, source: made_up(source.seed, 4, 3))
    told, junctions = [], JunctionFolder(folder=tmp_path / "kept")
    sources = [JunctionSource.of_seed(seed) for seed in (4, 5)]
    rows = tried_at(sources, junctions, {"mine": policy}, budgets=(2,), progress=lambda *s: told.append(s))
    assert [row.junction for row in rows] == ["000004", "000005"]
    assert [each[1:] for each in seen] == [(tmp_path / "kept", 24)] * 2
    assert told == [("held out", 1, 2, {}), ("held out", 2, 2, {})]
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        tried_at(sources, junctions, {"mine": policy}, budgets=(2, 0))


def test_means_and_what_greedy_has_more():
    aps = [(0.8, 0.6), (0.9, 0.9), (0.7, 0.8)]
    rows = [HeldOut(str(k), 2, {"greedy": greedy_ap, "mine": ap}) for k, (greedy_ap, ap) in enumerate(aps)]
    rows.append(HeldOut("0", 1, {"greedy": 0.5, "mine": 0.25}))
    one, mine_of_one, two, mine = compared(rows)
    assert (one.budget, one.name, one.ap, one.behind) == (1, "greedy", 0.5, 0.0)
    assert (mine_of_one.behind, mine_of_one.worst) == (0.25, 0.25)
    assert np.isnan(mine_of_one.error)
    assert (two.name, two.behind, two.error) == ("greedy", 0.0, 0.0)
    assert two.ap == pytest.approx(0.8)
    assert mine.ap == pytest.approx(2.3 / 3)
    assert mine.behind == pytest.approx(0.1 / 3)
    assert mine.error == pytest.approx(np.std([0.2, 0.0, -0.1], ddof=1) / np.sqrt(3))
    assert mine.worst == pytest.approx(0.2)
    assert compared([]) == []


def test_as_lines():
    means = [Comparison("greedy", 2, 0.8, 0.0, 0.0, 0.0), Comparison("me", 2, 0.75, 0.05, 0.0125, 0.2)]
    assert tables(means) == [
        "",
        "2 sensors, AP by the surrogate on traffic nobody saw, and what greedy has more",
        "greedy  0.8000  +0.0000 ± 0.0000  at worst +0.0000",
        "me      0.7500  +0.0500 ± 0.0125  at worst +0.2000",
    ]
    assert tables([]) == []
