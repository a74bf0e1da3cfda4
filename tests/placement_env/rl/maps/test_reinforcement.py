import copy
from functools import partial

import numpy as np
import pytest
import torch

from placement_env.rl.maps.imitation import Teaching
from placement_env.rl.maps.lessons import lesson_of
from placement_env.rl.maps.map_network import MapNetwork
from placement_env.rl.maps.practice import Practice
from placement_env.rl.maps.reinforcement import REINFORCEMENT, Reinforcement, advantages, reinforce, reward_losses

SHORT = Reinforcement(steps=4, sets=4)
TEACHING = Teaching(passes=1, width=8)


@pytest.fixture(scope="module")
def courses(made_up):
    made = []
    for seed in range(2):
        junction = made_up(seed, 4, 3)
        lesson = lesson_of(junction, seed)
        made.append(partial(lambda *pair: pair, Practice.of(junction, lesson), lesson))
    return made


@pytest.fixture
def network() -> MapNetwork:
    torch.manual_seed(1)
    return MapNetwork(8)


def same(one: MapNetwork, two: MapNetwork) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one.state_dict().values(), two.state_dict().values(), strict=True))


def test_a_set_counts_as_far_as_it_is_better_than_the_others():
    assert advantages(np.array([0.2, 0.5, 0.8])).tolist() == pytest.approx([-0.45, 0.0, 0.45])
    assert advantages(np.full(5, 0.7)).tolist() == pytest.approx([0.0] * 5)


def mean_reward(network: MapNetwork, courses) -> float:
    rewards = []
    for course in courses:
        for number in range(5):
            rng = np.random.default_rng([99, number])
            with torch.no_grad():
                rewards.append(course()[0].task(rng).draw(network, 8, rng, temperature=0.02).rewards.mean())
    return float(np.mean(rewards))


def test_rewards_rise(courses, network, tmp_path):
    """By the rewards alone, nothing of the lessons."""
    settings = Reinforcement(steps=20, sets=6, learning_rate=1e-2, of_lesson=0.0, averaged=0.5)
    before = copy.deepcopy(network)
    better = reinforce(network, courses, tmp_path, settings=settings, teaching=TEACHING)
    assert mean_reward(better, courses) > mean_reward(network, courses) + 0.02
    assert same(before, network)


def test_the_gradient_is_that_of_the_expected_reward(courses, network):
    """Mean of many steps' gradients against the difference of expected rewards, for one candidate to choose."""
    practice = courses[0]()[0]
    settings = Reinforcement(sets=400, divergence=0.0, entropy=0.0, temperature=0.05)
    rng = np.random.default_rng(4)
    task = practice.task(rng)
    task.terms.__dict__["budget"] = 1
    practice = copy.copy(practice)
    practice.__dict__["task"] = lambda rng: task
    single = torch.from_numpy(
        np.append(
            [
                task.objective.scores(row[None]).reward[0] * task.objective.allowed([])[c]
                for c, row in enumerate(np.eye(12, dtype=bool))
            ],
            0.0,
        )
    ).float()

    def expected() -> torch.Tensor:
        logits = task.logits(network, practice.prospects(network), torch.zeros(1, 12), 0.05)
        return (torch.softmax(logits, 1)[0] * single).sum()

    exact = torch.autograd.grad(expected(), network.out.weight)[0]
    sampled = torch.zeros_like(exact)
    for _ in range(10):
        loss, _ = reward_losses(network, network, practice, settings, rng)
        sampled -= torch.autograd.grad(loss, network.out.weight)[0] / 10
    assert torch.nn.functional.cosine_similarity(exact.ravel(), sampled.ravel(), 0).item() > 0.97
    assert sampled.norm().item() == pytest.approx(exact.norm().item(), rel=0.2)


def test_the_imitated_policy_holds_it_back(courses, network):
    settings, practice = Reinforcement(sets=4), courses[0]()[0]
    other = MapNetwork(8)
    _, figures = reward_losses(network, network, practice, settings, np.random.default_rng(0))
    assert figures["divergence"] == pytest.approx(0.0, abs=1e-6)
    _, figures = reward_losses(network, other, practice, settings, np.random.default_rng(0))
    assert figures["divergence"] > 1e-3
    assert 0 < figures["entropy"] <= np.log(13)
    losses = {}
    for name, value in (("plain", 0.0), ("divergence", 2.0), ("entropy", 3.0)):
        extra = {"divergence": 0.0, "entropy": 0.0} | ({name: value} if value else {})
        rng = np.random.default_rng(0)
        losses[name] = reward_losses(network, other, practice, Reinforcement(sets=4, **extra), rng)[0].item()
    assert losses["divergence"] - losses["plain"] == pytest.approx(2 * figures["divergence"], rel=1e-4)
    assert losses["entropy"] - losses["plain"] == pytest.approx(-3 * figures["entropy"], rel=1e-4)


def test_stopped_and_continued_is_the_same(courses, network, tmp_path):
    def stop(step: int, figures: dict[str, float]) -> None:
        assert set(figures) == {"reward", "entropy", "divergence"}
        if step == 2:
            raise KeyboardInterrupt

    asked = {"settings": SHORT, "teaching": TEACHING, "seed": 5}
    whole = reinforce(network, courses, tmp_path / "whole", **asked)
    with pytest.raises(KeyboardInterrupt):
        reinforce(network, courses, tmp_path / "parts", **asked, every_s=0.0, progress=stop)
    later: list[int] = []
    parts = reinforce(network, courses, tmp_path / "parts", **asked, progress=lambda n, _: later.append(n))
    assert later == [3, 4]
    assert same(whole, parts)
    again = reinforce(network, courses, tmp_path / "parts", **asked, progress=lambda n, _: later.append(n))
    assert later == [3, 4]
    assert same(whole, again)
    assert not same(whole, network)
    assert not same(whole, reinforce(network, courses, tmp_path / "other", **{**asked, "seed": 6}))


def test_errors(courses, network, tmp_path):
    with pytest.raises(ValueError, match="got none"):
        reinforce(network, [], tmp_path)
    reinforce(network, courses, tmp_path, settings=Reinforcement(steps=1, sets=2), teaching=TEACHING)
    with pytest.raises(ValueError, match="is of other settings: choose another folder"):
        reinforce(network, courses, tmp_path, settings=Reinforcement(steps=2, sets=2), teaching=TEACHING)
    with pytest.raises(ValueError, match="is of other junctions and imitated policy"):
        reinforce(MapNetwork(8), courses[:1], tmp_path, settings=Reinforcement(steps=1, sets=2), teaching=TEACHING)
    (tmp_path / REINFORCEMENT).write_bytes(b"damaged")
    with pytest.raises(ValueError, match="remove it to begin anew"):
        reinforce(network, courses, tmp_path, settings=SHORT, teaching=TEACHING)
    for wrong in ({"steps": 0}, {"sets": 1}):
        with pytest.raises(ValueError, match="must be a whole number"):
            Reinforcement(**wrong)
