"""The scalar environment: few files crossed in a step, one clear line for an invalid action."""

import importlib.util
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import placement_env  # noqa: F401  registers the environments
from placement_env.objective import Objective
from placement_env.setting import Setting

TABLE: dict[str, Any] = {"fidelity": "table", "disable_env_checker": True}
NAMES = ["coview/SensorSelect-v0", "coview/SensorSubset-v0"]


def test_a_step_crosses_few_files() -> None:
    spec = importlib.util.spec_from_file_location(
        "bench_env", Path(__file__).parents[2] / "benchmarks" / "placement_env" / "bench_env.py"
    )
    assert spec is not None
    assert spec.loader is not None
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    calls = bench.crossings(Objective(Setting("tjunction", fidelity="table")))
    assert 1 < len(bench.files_of(calls)) <= 7
    assert len(calls) <= 15


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_answered_before_the_first_reset(name: str) -> None:
    env: Any = gym.make(name, render_mode="ansi", **TABLE).unwrapped
    vector: Any = gym.make_vec(name, num_envs=2, fidelity="table", render_mode="ansi")
    for early in (
        *(lambda: env.step(0), env.action_masks, env.render, env.placement),
        lambda: vector.step(np.zeros(vector.action_space.shape, np.int64)),
        *(vector.action_masks, vector.render),
        lambda: vector.reset(options={"reset_mask": np.array([True, False])}),
    ):
        with pytest.raises(ResetNeeded, match="call reset"):
            early()


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(
            (NAMES[0], 1.5),
            (NAMES[0], np.float32(0.2)),
            (NAMES[0], -1),
            (NAMES[0], 99),
            (NAMES[1], np.full(6, 0.5)),
        ),
        *((NAMES[1], np.full(6, 2)), (NAMES[1], np.full(6, -1))),
    ],
)
def test_an_action_of_another_kind_is_an_error(name: str, wrong: Any) -> None:
    env = gym.make(name, **TABLE)
    before, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions (must be|are)"):
        env.step(wrong)
    assert np.array_equal(env.reset()[0], before)


def test_whole_numbers_are_choices_and_factored_actions():
    env = gym.make(NAMES[0], **TABLE)
    for action in (2, 2.0, np.int8(2), np.array([2]), np.float32(2)):
        env.reset(seed=0)
        *_, info = env.step(action)
        assert np.flatnonzero(info["subset"]).tolist() == [2]
    env = gym.make(NAMES[0], actions="factored", **TABLE)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="whole numbers"):
        env.step([0.5, 0, 0, 0, 0])


@pytest.mark.parametrize("mask", [np.ones(3, np.bool_), np.ones(2), [True]])
def test_a_reset_mask_has_a_truth_value_for_each(mask: Any) -> None:
    vector = gym.make_vec(NAMES[0], num_envs=2, fidelity="table")
    vector.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask must be 2 truth values"):
        vector.reset(options={"reset_mask": mask})
