"""The published environments answer as they did when they were published: observations, rewards,
masks and infos of seeded episodes, scalar and vector, are held in `golden_v0.npz`.

python tests/placement_env/envs/test_golden.py    # writes the file anew; only a new version of an
                                                  environment may
"""

from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import placement_env  # noqa: F401  registers the environments
from placement_env.objective import Objective
from placement_env.setting import Setting, Weights
from toolkit.runtime.run import Run

GOLDEN = Path(__file__).with_name("golden_v0.npz")
STEPS, SIDE_BY_SIDE = 14, 3
MADE_FROM_A_SITE = {"frames": 2, "weights": Weights(1e-4, 0.01)}
CHOOSING: dict[str, tuple[str, dict[str, Any]]] = {
    "flat": ("coview/SensorSelect-v0", {"budget": 3}),
    "factored": ("coview/SensorSelect-v0", {"budget": 3, "actions": "factored"}),
    "subset": ("coview/SensorSubset-v0", {"budget": 3}),
}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{
        f"{name}_{f}": (env, {**given, "fidelity": f})
        for f in ("table", "coverage", "surrogate")
        for name, (env, given) in CHOOSING.items()
    },
    **{
        f"pose_{f}": (
            "coview/SensorPose-v0",
            {"budget": 2, "moves": 4, "fidelity": f, "rendering": "full"},
        )
        for f in ("coverage", "surrogate")
    },
    "sites": (
        "coview/SensorSelect-v0",
        {"budget": 2, "fidelity": "table", "site": ["tjunction", "roundabout"]},
    ),
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("vector", [False, True])
@pytest.mark.parametrize("case", list(CASES))
def test_it_answers_as_it_did(case: str, vector: bool) -> None:
    kind = "vector" if vector else "scalar"
    with np.load(GOLDEN) as file:
        golden = {
            key.removeprefix(f"{case}/{kind}/"): file[key]
            for key in file
            if key.startswith(f"{case}/{kind}/")
        }
    now = played(case, vector)
    assert now.keys() == golden.keys()
    for key, value in now.items():
        assert value.dtype == golden[key].dtype, key
        assert value.shape == golden[key].shape, key
        if value.dtype.kind == "f":
            np.testing.assert_allclose(value, golden[key], rtol=2e-3, atol=2e-3, err_msg=key)
        else:
            np.testing.assert_array_equal(value, golden[key], err_msg=key)


@cache
def objective(fidelity: Any) -> Objective:
    return Objective(
        Setting("tjunction", fidelity=fidelity, weights=Weights(1e-4, 0.01)), Run(frames=2)
    )


def played(case: str, vector: bool) -> dict[str, np.ndarray]:
    """Everything that some seeded episodes answer, a row for each reset and step."""
    name, given = CASES[case]
    given = dict(given)
    if case.split("_")[0] in CHOOSING:
        given["objective"] = objective(given.pop("fidelity"))
    else:
        given |= MADE_FROM_A_SITE
    env = make(name, vector, given)
    n = SIDE_BY_SIDE if vector else 1
    space = env.single_action_space if vector else env.action_space
    rng, rows = (
        np.random.default_rng(8),
        [answer(*env.reset(seed=11, options={"failed": [1]}), env=env)],
    )
    for _ in range(STEPS):
        actions = drawn(space, n, rng)
        observation, reward, terminated, truncated, info = env.step(
            actions if vector else actions[0]
        )
        ends = {"reward": reward, "terminated": terminated, "truncated": truncated}
        rows.append({**answer(observation, info, env=env), **ends})
        if not vector and (terminated or truncated):
            rows.append(answer(*env.reset(), env=env))
    keys = dict.fromkeys(key for row in rows for key in row)
    columns = {key: np.array([row[key] for row in rows if key in row]) for key in keys}
    return {
        key: whole.astype(str) if whole.dtype == object else whole for key, whole in columns.items()
    }


def make(name: str, vector: bool, given: dict[str, Any]) -> Any:
    env: Any = (
        gym.make_vec(name, num_envs=SIDE_BY_SIDE, **given) if vector else gym.make(name, **given)
    )
    return env.unwrapped


def answer(observation: np.ndarray, info: dict[str, Any], *, env: Any) -> dict[str, Any]:
    terms = info.pop("reward_terms")
    return {
        "observation": observation,
        **{f"info_{key}": value for key, value in info.items()},
        **{f"term_{key}": value for key, value in terms.items()},
        "mask": env.action_masks(),
    }


def drawn(space: gym.Space[Any], n: int, rng: np.random.Generator) -> np.ndarray:
    if isinstance(space, gym.spaces.Discrete):
        return rng.integers(0, space.n, n)
    if isinstance(space, gym.spaces.MultiDiscrete):
        return rng.integers(0, space.nvec, (n, len(space.nvec)))
    if isinstance(space, gym.spaces.MultiBinary):
        return (rng.random((n, *space.shape)) < 0.3).astype(np.int8)
    return rng.uniform(-1, 1, (n, *(space.shape or ()))).astype(np.float32)


if __name__ == "__main__":
    np.savez_compressed(
        GOLDEN,
        **{
            f"{case}/{'vector' if vector else 'scalar'}/{key}": value
            for case in CASES
            for vector in (False, True)
            for key, value in played(case, vector).items()
        },
    )
