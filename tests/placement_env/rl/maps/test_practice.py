from dataclasses import replace

import numpy as np
import pytest
import torch

from placement_env.candidates.drawing import with_mounts
from placement_env.candidates.outlook.outlook import outlook
from placement_env.envs.maps.terms import Terms, drawn_terms
from placement_env.objective import Weights
from placement_env.rl.maps.lessons import lesson_of
from placement_env.rl.maps.map_network import MapNetwork
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.practice import Practice, PracticeTask


@pytest.fixture(scope="module")
def junction(made_up):
    return made_up(2, 4, 3)


@pytest.fixture(scope="module")
def practice(junction) -> Practice:
    return Practice.of(junction, lesson_of(junction, 2))


@pytest.fixture(scope="module")
def network() -> MapNetwork:
    torch.manual_seed(3)
    return MapNetwork(8)


def rows(*sets: tuple[int, ...]) -> torch.Tensor:
    chosen = torch.zeros(len(sets), 12)
    for row, members in zip(chosen, sets, strict=True):
        row[list(members)] = 1
    return chosen


def carrying(junction, capacity: float, places: int = 1):
    """The candidates with other links, and poles of several places."""
    some = junction.candidates
    other = with_mounts(some, [1.0] * 4, [capacity] * 4, [1.0] * len(some.axes.models))
    return replace(other, mounts=tuple(replace(mount, max_sensors=places) for mount in other.mounts))


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("places", [1, 2])
def test_gains_are_those_of_the_answering_policy(practice, junction, network, known, places):
    predicted = MapPolicy(network).predicted(outlook(junction.site, junction.candidates))
    if known:
        predicted = replace(predicted, sent=practice.sent)
    capacity = float(np.median(practice.sent)) if known else 500.0
    terms = Terms.plain(carrying(junction, capacity, places), 3, weights=Weights(1e-4, 0.02))
    task = PracticeTask(practice, terms, known=known)
    with torch.no_grad():
        seen = practice.prospects(network)
        gains, carried = task.gains(network, seen, rows((), (3,), (0, 7)))
    for members, gain, chance in zip(((), (3,), (0, 7)), gains.numpy(), carried.numpy(), strict=True):
        others = [c for c in range(12) if c not in members]
        assert gain[others] == pytest.approx(predicted.gains(members, terms)[others], abs=1e-3)
        expected = predicted.carried(terms.candidates, members)
        assert chance[others] == pytest.approx(expected[others], abs=1e-3)
        assert not known or set(chance.tolist()) == {0.0, 1.0}


def test_only_what_the_terms_allow_may_be_drawn(practice, junction, network):
    failed = np.arange(12) == 5
    task = PracticeTask(practice, replace(Terms.plain(carrying(junction, 1e9), 3), failed=failed), known=True)
    with torch.no_grad():
        logits = task.logits(network, practice.prospects(network), rows((), (0,)), 0.02)
        gains, _ = task.gains(network, practice.prospects(network), rows((), (0,)))
    assert torch.isfinite(logits[:, :12]).numpy().tolist() == [
        (~failed).tolist(),
        (~failed & (junction.candidates.mount != junction.candidates.mount[0])).tolist(),
    ]
    assert logits[:, 12].tolist() == [0.0, 0.0]
    assert logits[0, 3].item() == pytest.approx(gains[0, 3].item() / 0.02)


def test_candidates_are_drawn_as_likely_as_the_policy_says(practice, junction, network):
    task = PracticeTask(practice, Terms.plain(carrying(junction, 1e9), 1), known=True)
    with torch.no_grad():
        draws = task.draw(network, 4000, np.random.default_rng(0), temperature=0.05)
    expected = torch.softmax(draws.logits[0], 0).numpy()
    counted = np.bincount(draws.taken.numpy(), minlength=13) / 4000
    assert np.abs(counted - expected).max() < 4 * np.sqrt(0.25 / 4000)
    assert draws.episode.tolist() == list(range(4000))
    single = np.array([0.0 if c == 12 else task.objective.score([c]).reward for c in range(13)])
    assert draws.rewards == pytest.approx(single[draws.taken.numpy()])


def test_sets_end_with_the_budget_or_when_it_is_chosen_to_stop(practice, network):
    for number in range(6):
        task = practice.task(rng := np.random.default_rng(number))
        with torch.no_grad():
            draws = task.draw(network, 5, rng, temperature=0.02)
        built = np.zeros(5)
        for episode in range(5):
            mine = draws.episode == episode
            taken, before = draws.taken[mine].tolist(), draws.before[mine]
            chosen: list[int] = []
            for choice, row in zip(taken, before, strict=True):
                assert np.flatnonzero(row).tolist() == sorted(chosen)
                assert choice == 12 or task.terms.allowed(chosen)[choice]
                chosen.append(choice)
            assert len(chosen) == task.terms.budget or chosen[-1] == 12
            assert 12 not in chosen[:-1]
            left: list[int] = []
            for choice in chosen:  # of which each is built where it may be
                left += [choice] if choice < 12 and task.objective.allowed(left)[choice] else []
            built[episode] = task.objective.score(left).reward
        assert draws.rewards == pytest.approx(built)


def test_a_refused_sensor_is_left_out(practice, junction, network, monkeypatch):
    """Nothing is carried by any link: who does not know that builds nothing."""
    terms = Terms.plain(carrying(junction, 1.0), 2, weights=Weights(price=1e-3))
    unaware = PracticeTask(practice, terms, known=False)
    monkeypatch.setattr(unaware, "_carried", lambda seen, chosen, kbit: torch.ones(len(chosen), 12))
    with torch.no_grad():
        draws = unaware.draw(network, 8, np.random.default_rng(1), temperature=1.0)
        aware = PracticeTask(practice, terms, known=True).draw(network, 8, np.random.default_rng(1), temperature=1.0)
    assert (draws.taken < 12).any()
    assert draws.rewards.tolist() == [0.0] * 8
    assert aware.taken.tolist() == [12] * 8


def test_tasks_are_of_both_kinds(practice, junction):
    tasks = [practice.task(np.random.default_rng(seed)) for seed in range(40)]
    plain = [task for task in tasks if task.terms.candidates is junction.candidates]
    assert 10 < len(plain) < 30
    assert 10 < sum(task.known for task in tasks) < 30
    assert {task.terms.budget for task in tasks} == {1, 2, 3, 4, 5, 6}
    assert any(task.terms.failed.any() for task in tasks)
    assert all(task.objective.most_price == task.terms.most_price for task in tasks)
    assert all(task.objective.weights == task.terms.weights for task in tasks)
    drawn = drawn_terms(junction.candidates, np.random.default_rng(0), budget=(1, 6), failures=(0, 8))
    assert PracticeTask(practice, drawn, known=True).objective.candidates is drawn.candidates


def test_a_lesson_of_another_junction(junction, made_up):
    with pytest.raises(ValueError, match="a lesson of 6 candidates is none of a junction with 12"):
        Practice.of(junction, lesson_of(made_up(0, 3, 2), 0))
