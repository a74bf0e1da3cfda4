"""Choosing a set at once."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from placement_env.envs.registration import register

register()
CHOOSING = ["coview/SensorSelect-v0", "coview/SensorSubset-v0"]


@pytest.mark.parametrize(
    ("action", "illegal"),
    [([1, 0, 0, 1, 0, 0], False), ([1, 1, 0, 0, 0, 0], True), ([1, 0, 1, 0, 1, 0], True), ([0] * 6, False)],
)
def test_a_set_that_may_not_be_built_is_left_empty(objective: Any, action: list[int], illegal: bool) -> None:
    env = gym.make(CHOOSING[1], objective=objective(), budget=2)
    env.reset()
    _, reward, terminated, _, info = env.step(np.array(action, np.int8))
    assert (terminated, info["illegal"]) == (True, illegal)
    assert info["subset"].sum() == (0 if illegal else sum(action))
    assert reward == sum(info["reward_terms"].values())


def test_its_mask_says_for_each_slot_whether_it_may_be_0_and_1(objective: Any) -> None:
    env: Any = gym.make(CHOOSING[1], objective=objective(capacity=1.0)).unwrapped
    env.reset()
    assert env.action_masks().tolist() == [True, False] * 6
