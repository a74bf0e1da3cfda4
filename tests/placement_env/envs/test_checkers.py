"""Every environment at every fidelity: Gymnasium's and Stable-Baselines3's checkers, and sets
chosen through it."""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import placement_env  # noqa: F401  registers the environments
from placement_env.objective import Objective
from placement_env.protocol import FidelityName
from placement_env.search import greedy
from placement_env.search.exact import exhaustive
from placement_env.setting import Setting
from toolkit.runtime.run import Run

CHOOSING = ["coview/SensorSelect-v0", "coview/SensorSubset-v0"]
SCORED_BY = ["coverage", "surrogate", pytest.param("detector", marks=pytest.mark.slow), "table"]


@cache
def objective(fidelity: FidelityName) -> Objective:
    return Objective(Setting("tjunction", fidelity=fidelity), Run(frames=2))


@pytest.mark.one_in(2)
@pytest.mark.parametrize("fidelity", SCORED_BY)
@pytest.mark.parametrize("name", CHOOSING)
@pytest.mark.filterwarnings("error")
def test_both_checkers_pass(name: str, fidelity: FidelityName) -> None:
    env = gym.make(name, objective=objective(fidelity), disable_env_checker=True)
    check_env(env.unwrapped)
    check_env_sb3(env)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("fidelity", SCORED_BY[:-1])
@pytest.mark.filterwarnings("error")
def test_both_checkers_pass_moving_sensors(fidelity: FidelityName) -> None:
    env = gym.make(
        "coview/SensorPose-v0", frames=1, budget=1, fidelity=fidelity, disable_env_checker=True
    )
    check_env(env.unwrapped, skip_render_check=True)
    check_env_sb3(env)


@pytest.mark.parametrize("fidelity", SCORED_BY)
@pytest.mark.parametrize("name", CHOOSING)
def test_random_greedy_and_exhaustive_sets_are_paid_their_reward(
    name: str, fidelity: FidelityName
) -> None:
    scored = objective(fidelity)
    some = np.random.default_rng(0).choice(6, 2, replace=False).tolist()
    answers = [greedy.search(scored, 3).best.subset, exhaustive.search(scored, 3).best.subset]
    rewards = [episode_reward(name, scored, list(chosen)) for chosen in (some, *answers)]
    assert rewards == pytest.approx([scored.score(chosen).reward for chosen in (some, *answers)])
    assert rewards[0] <= rewards[2] + 1e-9 >= rewards[1]


def episode_reward(name: str, scored: Objective, chosen: list[int]) -> float:
    env = gym.make(name, objective=scored, budget=3)
    env.reset(seed=0)
    actions = (
        [*chosen, len(scored.candidates)]
        if "Select" in name
        else [scored.row(chosen).astype(np.int8)]
    )
    total = 0.0
    for action in actions:
        _, reward, terminated, truncated, _ = env.step(action)
        total += float(reward)
        if terminated or truncated:
            break
    return total
