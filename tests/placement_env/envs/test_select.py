"""Choosing sensors one by one and at once: checkers, rewards, illegal actions, options, pictures,
other processes."""

import multiprocessing
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from placement_env.envs.registration import register_environments
from toolkit.sites.files import load_site, save_site

register_environments()
CHOOSING = ["coview/SensorSelect-v0", "coview/SensorSubset-v0"]


@pytest.mark.filterwarnings("error")
def test_both_checkers_pass_with_factored_actions(objective: Any) -> None:
    env = gym.make(CHOOSING[0], objective=objective(), disable_env_checker=True, actions="factored")
    check_env(env.unwrapped)
    check_env_sb3(env)


@pytest.mark.parametrize("actions", ["flat", "factored"])
def test_rewards_add_up_to_the_reward_of_the_set(objective: Any, actions: str) -> None:
    env = gym.make(CHOOSING[0], objective=objective(), actions=actions, budget=3)
    rng = np.random.default_rng(1)
    for seed in range(20):
        total, done = 0.0, False
        _, info = env.reset(seed=seed)
        while not done:
            observation, reward, terminated, truncated, info = env.step(
                sample(env, info["action_mask"], rng)
            )
            assert env.observation_space.contains(observation)
            total += float(reward)
            done = terminated or truncated
        score = env.unwrapped.placement()[0].score(np.flatnonzero(info["subset"]).tolist())  # type: ignore[attr-defined]
        assert total == pytest.approx(score.reward, abs=1e-12)
        assert info["ap"] == score.ap
        assert sum(info["reward_terms"].values()) == pytest.approx(score.reward)


def sample(env: Any, mask: np.ndarray, rng: np.random.Generator) -> Any:
    if isinstance(env.action_space, gym.spaces.Discrete):
        return rng.choice(np.flatnonzero(mask))
    parts = np.split(mask, np.cumsum(env.action_space.nvec)[:-1])
    return np.array([rng.choice(np.flatnonzero(part)) for part in parts])


def test_the_last_action_stops(objective: Any):
    env = gym.make(CHOOSING[0], objective=objective())
    env.reset()
    _, reward, terminated, truncated, info = env.step(6)
    assert (reward, terminated, truncated, info["illegal"]) == (0.0, True, False, False)


def test_illegal_actions_change_nothing(objective: Any):
    env = gym.make(CHOOSING[0], objective=objective(), budget=2)
    env.reset(options={"failed": [4]})
    _, _, _, _, info = env.step(0)
    assert info["action_mask"].tolist() == [0, 0, 1, 1, 0, 1, 1]
    for step, action in enumerate((0, 1, 4)):  # chosen already, on the same mount, failed
        _, reward, terminated, truncated, after = env.step(action)
        assert (reward, terminated, truncated, after["illegal"]) == (0.0, False, step == 2, True)
        assert after["subset"].tolist() == info["subset"].tolist()


def test_links_that_carry_nothing_leave_stopping_alone(objective: Any):
    env = gym.make(CHOOSING[0], objective=objective(capacity=1.0))
    _, info = env.reset()
    assert info["action_mask"].tolist() == [0, 0, 0, 0, 0, 0, 1]
    assert env.step(2)[2]


def test_factored_actions_choose_a_pose(objective: Any):
    env = gym.make(CHOOSING[0], objective=objective(), actions="factored")
    env.reset()
    masks = env.unwrapped.action_masks()  # type: ignore[attr-defined]
    assert masks.shape == (int(env.action_space.nvec.sum()),)  # type: ignore[attr-defined]
    assert masks.all()
    _, _, _, _, info = env.step(np.array([1, 0, 1, 0, 0]))
    assert np.flatnonzero(info["subset"]).tolist() == [3]
    assert info["action_mask"][:4].tolist() == [1, 0, 1, 1]


def test_options_pickles_and_masks(objective: Any):
    env = gym.make(CHOOSING[0], objective=objective(), budget=3)
    env.reset(options={"budget": 1, "failed": ["m0_5.0m_h0_t17_camera"]})
    assert env.step(1)[2]
    for bad, message in (
        *(
            ({"colour": 1}, "options are"),
            ({"budget": 0}, "at least 1"),
            ({"budget": 2.5}, "whole number"),
        ),
        *(
            ({"budget": None}, "whole number"),
            ({"failed": [9]}, "candidates"),
            ({"failed": "m0"}, "must be a list"),
        ),
        *(({"failed": 3}, "must be a list"), ({"scheme": "late"}, "made from an objective")),
    ):
        with pytest.raises(ValueError, match=message):
            env.reset(options=bad)
    env = gym.make(CHOOSING[0], objective=objective())
    here = rollout(env)
    assert rollout(pickle.loads(pickle.dumps(env))) == here
    masked: Any = gym.make(CHOOSING[1], objective=objective(capacity=1.0)).unwrapped
    masked.reset()
    assert masked.action_masks().tolist() == [True, False] * 6


@pytest.mark.parametrize("name", CHOOSING)
@pytest.mark.parametrize("wrong", [np.zeros(9), np.full(6, np.nan), np.zeros(0), "x", None])
def test_what_is_no_action_is_an_error_and_does_no_harm(
    objective: Any, name: str, wrong: Any
) -> None:
    env = gym.make(name, objective=objective(), disable_env_checker=True)
    before, _ = env.reset()
    with pytest.raises(ValueError, match="actions must be"):
        env.step(wrong)
    assert np.array_equal(env.reset()[0], before)


def test_sites_are_those_it_was_made_with_read_once(tmp_path: Path):
    env = gym.make(
        CHOOSING[0], actions="factored", slots=8, frames=1, fidelity="coverage", scheme="late"
    )
    with pytest.raises(ValueError, match="make the environment with all"):
        env.reset(options={"site": "roundabout"})
    path = tmp_path / "mine.json"
    save_site(replace(load_site("tjunction"), name="mine"), path)
    env = gym.make(CHOOSING[0], frames=1, fidelity="coverage")
    for _ in range(3):
        env.reset(options={"site": str(path)})
    assert len(env.unwrapped.task.scenarios.sites) == 2  # type: ignore[attr-defined]
    for wrong in ([], 3):
        with pytest.raises(ValueError, match="site"):
            gym.make(CHOOSING[0], site=wrong)


def rollout(env: gym.Env[Any, Any]) -> list[Any]:
    observation, info = env.reset(seed=5)
    rng, found = np.random.default_rng(2), [observation.tolist()]
    for _ in range(4):
        observation, reward, terminated, _, info = env.step(sample(env, info["action_mask"], rng))
        found.append([observation.tolist(), reward, info["ap"], info["kbit"]])
        if terminated:
            observation, info = env.reset()
    return found


@pytest.mark.slow
def test_the_same_in_a_spawned_process(objective: Any) -> None:
    env = gym.make(CHOOSING[0], objective=objective())
    with multiprocessing.get_context("spawn").Pool(1) as processes:
        assert processes.apply(rollout, (env,)) == rollout(env)


@pytest.mark.parametrize(
    ("action", "illegal"),
    [
        ([1, 0, 0, 1, 0, 0], False),
        ([1, 1, 0, 0, 0, 0], True),
        ([1, 0, 1, 0, 1, 0], True),
        ([0] * 6, False),
    ],
)
def test_a_set_that_may_not_be_built_is_left_empty(
    objective: Any, action: list[int], illegal: bool
) -> None:
    env = gym.make(CHOOSING[1], objective=objective(), budget=2)
    env.reset()
    _, reward, terminated, _, info = env.step(np.array(action, np.int8))
    assert (terminated, info["illegal"]) == (True, illegal)
    assert info["subset"].sum() == (0 if illegal else sum(action))
    assert reward == sum(info["reward_terms"].values())
