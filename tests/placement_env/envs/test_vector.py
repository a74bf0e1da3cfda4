"""Vector environments agree with scalar ones step by step."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from placement_env.candidates.candidates import pool
from placement_env.envs.registration import register_environments
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.setting import Setting, Weights
from toolkit.sites.site import Mount, Site

register_environments()
N = 5


class Counting:
    """Each candidate adds a share of AP that sums without rounding, and kbit."""

    name = "counting"

    def __call__(self, subsets: np.ndarray, /) -> Estimate:
        ap = subsets @ ((1 + np.arange(subsets.shape[1])) / 256)
        return Estimate(ap, ap / 2, subsets @ (128.0 * np.arange(subsets.shape[1])))


def objective() -> Objective:
    site = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
    poles = [Mount(f"m{i}", np.array([10.0 * i - 20, 12.0, 0.0])) for i in range(4)]
    some = pool(site, heights=(5.0,), headings=3, tilts=(0.3,), mounts=poles, blind=True)
    return Objective(
        Setting(
            site,
            candidates=some,
            fidelity=Counting(),
            scheme="early",
            weights=Weights(2.0**-14, 2.0**-7),
        )
    )


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        *(
            ("coview/SensorSelect-v0", {"actions": "flat"}),
            ("coview/SensorSelect-v0", {"actions": "factored"}),
        ),
        ("coview/SensorSubset-v0", {}),
    ],
)
def test_it_agrees_with_scalar_environments_step_by_step(
    name: str, arguments: dict[str, Any]
) -> None:
    arguments = {"objective": objective(), "budget": 3, **arguments}
    vector = gym.make_vec(name, num_envs=N, **arguments)
    scalar = SyncVectorEnv([lambda: gym.make(name, **arguments)] * N)
    assert (
        vector.metadata["autoreset_mode"]
        == scalar.metadata["autoreset_mode"]
        == AutoresetMode.NEXT_STEP
    )
    assert vector.single_action_space == scalar.single_action_space
    assert vector.observation_space == scalar.observation_space
    scalar.action_space.seed(3)
    options = {"failed": [1, 7]}
    same(vector.reset(seed=7, options=dict(options)), scalar.reset(seed=7, options=dict(options)))
    for _ in range(60):
        actions = scalar.action_space.sample()
        if name.endswith("Subset-v0"):
            actions &= np.random.default_rng(int(actions.sum())).random(actions.shape) < 0.3
        same(vector.step(actions), scalar.step(actions))


def same(left: Any, right: Any) -> None:
    assert type(left) is type(right)
    if isinstance(left, dict):
        assert left.keys() == right.keys()
        for key in left:
            same(left[key], right[key])
    elif isinstance(left, tuple):
        for one, other in zip(left, right, strict=True):
            same(one, other)
    else:
        assert left.dtype == right.dtype
        assert np.array_equal(left, right)


def test_some_may_be_reset_by_seeds_and_drawn():
    vector = gym.make_vec("coview/SensorSelect-v0", num_envs=3, objective=objective())
    vector.reset(seed=0)
    vector.step(np.array([0, 1, 2]))
    only = np.array([False, True, False])
    _, info = vector.reset(options={"reset_mask": only})
    assert info["subset"].sum(axis=1).tolist() == [1, 0, 1]
    assert info["_subset"].tolist() == only.tolist()
    vector = gym.make_vec(
        "coview/SensorSelect-v0", num_envs=2, objective=objective(), render_mode="ansi"
    )
    with pytest.raises(ValueError, match="a seed for each"):
        vector.reset(seed=[1, 2, 3])
    vector.reset(seed=[1, None])
    assert len(vector.render()) == 2  # type: ignore[arg-type]
    assert vector.unwrapped.action_masks().shape == (2, 13)  # type: ignore[attr-defined]
