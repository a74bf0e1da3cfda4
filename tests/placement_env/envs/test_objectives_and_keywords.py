"""Vector rewards, as mo-gymnasium takes them; budgets and keywords that do not fit; what an
objective shows."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import placement_env  # noqa: F401  registers the environments
from placement_env.objective import Objective
from placement_env.setting import Setting, Weights

PLAIN = {
    "site": "tjunction",
    "fidelity": "table",
    "budget": 3,
    "weights": Weights(comm=1e-4, price=0.02),
}
SELECT = "coview/SensorSelect-v0"
WEIGHTS = np.array([1.0, 1e-4, 0.02])


def test_vector_rewards_weigh_up_to_the_usual_ones():
    vector: Any = gym.make(SELECT, **PLAIN, vector_reward=True).unwrapped
    scalar: Any = gym.make(SELECT, **PLAIN).unwrapped
    assert vector.reward_space.shape == (3,)
    assert scalar.reward_space is None
    vector.reset(seed=0)
    scalar.reset(seed=0)
    total, names = np.zeros(3), ("ap", "kbit_per_sensor", "price")
    for action in (0, 3, 3, 5):  # the second 3 is illegal
        _, several, done, _, info = vector.step(action)
        _, one, _, _, _ = scalar.step(action)
        assert several in vector.reward_space
        assert one == pytest.approx(float(several @ WEIGHTS), abs=1e-5)
        total += several
        if info["illegal"]:
            assert not several.any()
    assert done
    assert total * [1, -1, -1] == pytest.approx([info[name] for name in names], rel=1e-5)


def test_vector_environments_give_the_rows_of_scalar_ones():
    vector: Any = gym.make_vec(
        SELECT, num_envs=2, vectorization_mode="vector_entry_point", **PLAIN, vector_reward=True
    )
    one = gym.make(SELECT, **PLAIN, vector_reward=True).unwrapped
    vector.reset(seed=0)
    one.reset(seed=0)
    assert vector.unwrapped.reward_space.shape == (2, 3)
    for action in (0, 3, 5):
        _, rewards, *_ = vector.step(np.array([action, 6]))
        np.testing.assert_allclose(rewards[0], one.step(action)[1], rtol=1e-5)
    _, rewards, *_ = vector.step(np.array([1, 1]))  # the episode starts anew
    assert not rewards[0].any()


def test_wrappers_of_mo_gymnasium_take_them():
    wrappers = pytest.importorskip("mo_gymnasium.wrappers")
    env = gym.make(SELECT, **PLAIN, vector_reward=True, disable_env_checker=True)
    recorded = wrappers.MORecordEpisodeStatistics(wrappers.MONormalizeReward(env, idx=1), gamma=1.0)
    recorded.reset(seed=0)
    for action in (0, 3, 6):
        _, reward, done, _, info = recorded.step(action)
        assert reward.shape == (3,)
    assert done
    assert info["episode"]["r"].shape == (3,)
    linear = wrappers.LinearReward(
        gym.make(SELECT, **PLAIN, vector_reward=True, disable_env_checker=True), WEIGHTS
    )
    linear.reset(seed=0)
    plain = gym.make(SELECT, **PLAIN)
    plain.reset(seed=0)
    assert linear.step(0)[1] == pytest.approx(plain.step(0)[1], abs=1e-5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"budgett": 3}, "SelectConfig has no 'budgett': did you mean 'budget'?"),
        ({"fidelty": "table"}, "did you mean 'fidelity'?"),
        ({"qqq": 1}, "take one of actions, "),
    ],
)
def test_misspelt_keywords_are_guessed(wrong, message):
    with pytest.raises(TypeError) as caught:
        gym.make(SELECT, **{"site": "tjunction", **wrong})
    assert message in str(caught.value)


def test_no_budget_is_above_the_number_of_candidates():
    few = {**PLAIN, "budget": 7}
    for name in (SELECT, "coview/SensorSubset-v0"):
        with pytest.raises(
            ValueError, match="budget must be at most the number of candidates, 6, got 7"
        ):
            gym.make(name, **few)
    env = gym.make(SELECT, **PLAIN)
    with pytest.raises(ValueError, match="6, got 9"):
        env.reset(options={"budget": 9})
    env.reset(options={"budget": 6})


def test_an_objective_shows_its_settings():
    text = repr(
        Objective(
            Setting("tjunction", fidelity="table", weights=Weights(comm=0.001), most_price=3.0)
        )
    )
    assert text.startswith(
        "Objective('tjunction', 6 candidates, scheme='early', fidelity='table', "
        "classes='vehicle', iou="
    )
    assert "iou=0.7, comm=0.001, price=0, most_price=3, frames=200, seed=0)" in text
