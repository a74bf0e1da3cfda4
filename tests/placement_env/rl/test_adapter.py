"""Our environments under Stable-Baselines3 do what it makes of the scalar ones."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from placement_env.envs.select import SensorSelectEnv, SensorSubsetEnv
from placement_env.envs.state import GLOBAL
from placement_env.rl.adapter import HEADING_FEATURE, X_FEATURE, SB3VecEnv, as_sb3, vectorize

N = 3


@pytest.mark.parametrize("actions", ["flat", "factored", "subset"])
def test_it_agrees_with_scalar_environments_step_by_step(make, actions):
    objective = make(5, 2)

    def make_env():
        if actions == "subset":
            return SensorSubsetEnv(objective=objective, budget=2)
        return SensorSelectEnv(objective=objective, budget=2, actions=actions)

    native, scalar = (
        vectorize(make_env(), make_env, N),
        DummyVecEnv([lambda: Monitor(make_env())] * N),
    )
    assert isinstance(native, SB3VecEnv)
    assert is_masking_supported(native)
    native.seed(3)
    scalar.seed(3)
    np.testing.assert_array_equal(native.reset(), scalar.reset())
    scalar.action_space.seed(4)
    cut = 0
    for turn in range(40):
        np.testing.assert_array_equal(get_action_masks(native), get_action_masks(scalar))
        action = np.array([scalar.action_space.sample() for _ in range(N)])
        action[:] *= turn >= 4  # the same candidate again and again uses up the turns
        observations, rewards, ended, infos = native.step(action)
        same_observations, same_rewards, same_ended, same_infos = scalar.step(action)
        np.testing.assert_array_equal(observations, same_observations)
        # which Stable-Baselines3 keeps in float32
        np.testing.assert_allclose(rewards, same_rewards, atol=1e-6)
        np.testing.assert_array_equal(ended, same_ended)
        for info, same in zip(infos, same_infos, strict=True):
            assert ("episode" in info) == ("episode" in same)
            if "episode" in info:
                assert info["episode"]["r"] == pytest.approx(same["episode"]["r"], abs=1e-5)
                assert info["episode"]["l"] == same["episode"]["l"]
                assert info["TimeLimit.truncated"] == same["TimeLimit.truncated"]
                np.testing.assert_array_equal(info["subset"], same["subset"])
                np.testing.assert_array_equal(
                    info["terminal_observation"], same["terminal_observation"]
                )
                cut += info["TimeLimit.truncated"]
    assert cut == (0 if actions == "subset" else N)


def features_of(observations: Any) -> np.ndarray:
    return observations[:, : -len(GLOBAL)].reshape(64, -1, 15)


def test_junctions_turn_and_foreign_environments_are_played(make):
    objective = make(5, 3)
    env = SensorSelectEnv(objective=objective, budget=2)
    plain, turned = vectorize(env, lambda: env, 64), vectorize(env, lambda: env, 64, augment=True)
    turned.seed(3)
    before, seen = (features_of(vector.reset()) for vector in (plain, turned))

    def along(features):  # the heading of each candidate along its position
        return (
            features[:, X_FEATURE : X_FEATURE + 2]
            * features[:, HEADING_FEATURE : HEADING_FEATURE + 2]
        ).sum(axis=1)

    np.testing.assert_allclose(along(seen), along(before), atol=1e-6)
    moved = [X_FEATURE, X_FEATURE + 1, HEADING_FEATURE, HEADING_FEATURE + 1]
    np.testing.assert_array_equal(np.delete(seen, moved, axis=1), np.delete(before, moved, axis=1))
    assert len(np.unique(seen[:, moved].round(3), axis=0)) == 8
    turned.seed(3)
    np.testing.assert_array_equal(features_of(turned.reset()), seen)
    with pytest.raises(ValueError, match="only junctions of our own"):
        vectorize(gym.make("CartPole-v1"), lambda: env, 2, augment=True)

    class Halved(SensorSelectEnv):
        def step(self, action):
            observation, reward, *rest = super().step(action)
            return observation, reward / 2, *rest

    objective = make(5, 2)
    for of in (
        lambda: Halved(objective=objective, budget=2),
        lambda: gym.wrappers.TimeLimit(SensorSelectEnv(objective=objective, budget=2), 3),
        lambda: gym.make("CartPole-v1"),
    ):
        assert isinstance(vectorize(of(), of, 2), DummyVecEnv)


def trained(algorithm, vector, **given):
    model = algorithm(
        "MlpPolicy", vector, n_steps=4, batch_size=128, n_epochs=1, seed=0, device="cpu", **given
    )
    return model.learn(512)


@pytest.mark.parametrize("augment", [False, True])
def test_both_libraries_train_on_64_side_by_side(make, augment):
    objective = make(5, 2)
    for algorithm in (PPO, MaskablePPO):
        vector = as_sb3(
            gym.make_vec("coview/SensorSelect-v0", num_envs=64, objective=objective),
            augment=augment,
        )
        model = trained(algorithm, vector)
        assert model.num_timesteps == 512
        assert model.ep_info_buffer
        assert all(np.isfinite(episode["r"]) for episode in model.ep_info_buffer)


def test_returns_are_those_of_the_scalar_environment(make):
    objective = make(5, 2)
    vector = as_sb3(
        gym.make_vec("coview/SensorSelect-v0", num_envs=64, objective=objective, budget=3)
    )
    model = trained(MaskablePPO, vector)
    vector.seed(1)
    observations: Any = vector.reset()
    done = 0
    while done < 64:
        actions, _ = model.predict(observations, action_masks=get_action_masks(vector))
        observations, _, _, infos = vector.step(actions)
        for info in infos:
            if "episode" in info:
                done += 1
                assert info["episode"]["r"] == pytest.approx(
                    objective.score(np.flatnonzero(info["subset"])).reward
                )
                assert not info["TimeLimit.truncated"]
    env = SensorSelectEnv(objective=objective, budget=3)
    native, _ = evaluate_policy(model, vector, n_eval_episodes=64, deterministic=True)
    scalar, _ = evaluate_policy(model, Monitor(env), n_eval_episodes=1, deterministic=True)
    assert native == pytest.approx(scalar, abs=1e-5)


@pytest.mark.slow
def test_pose_environments_train_too():
    vector = as_sb3(
        gym.make_vec(
            "coview/SensorPose-v0", num_envs=2, frames=1, budget=1, moves=2, fidelity="coverage"
        )
    )
    model = PPO(
        "MlpPolicy", vector, n_steps=4, batch_size=8, n_epochs=1, seed=0, device="cpu"
    ).learn(8)
    assert [episode["l"] for episode in model.ep_info_buffer or ()] == [2] * 4


def test_options_attributes_pictures_and_closing(make):
    native: Any = gym.make_vec(
        "coview/SensorSelect-v0", num_envs=3, objective=make(5, 2), render_mode="rgb_array"
    )
    vector = as_sb3(native)
    vector.set_options([{"budget": 1}, {"budget": 2}, {"budget": 2}])
    vector.seed(0)
    vector.reset()
    assert native.unwrapped.task.state.budget.tolist() == [1, 2, 2]
    vector.reset()
    assert native.unwrapped.task.state.budget.tolist() == [4, 4, 4]
    assert vector.get_attr("render_mode", [0, 2]) == ["rgb_array"] * 2
    assert len(vector.get_images()) == 3
    assert vector.env_method("action_masks", indices=1)[0].shape == (11,)
    assert vector.env_is_wrapped(Monitor) == [True] * 3
    assert vector.env_is_wrapped(gym.wrappers.TimeLimit) == [False] * 3
    vector.close()
    assert native.unwrapped.closed
    with pytest.raises(ValueError, match="native vector environments"):
        as_sb3(gym.make_vec("CartPole-v1", num_envs=2))
