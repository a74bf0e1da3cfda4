"""Configurations are checked when an environment is made, before anything is simulated or
rendered."""

from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from placement_env.candidates.candidates import paper_candidates
from placement_env.envs.config import EnvConfig, PoseConfig, SelectConfig, SubsetConfig
from placement_env.envs.pose import SensorPoseEnv
from placement_env.envs.select import SensorSelectEnv, SensorSelectVectorEnv, SensorSubsetEnv
from placement_env.objective import Objective
from placement_env.setting import Setting, Weights
from toolkit import load_site

TABLE = Setting(fidelity="table")
ALL = ["coview/SensorSelect-v0", "coview/SensorSubset-v0", "coview/SensorPose-v0"]
WRONG: list[tuple[dict[str, Any], str]] = [
    *(
        ({"weights": (0.1, 0.2)}, "weights"),
        ({"weights": {"comm": 1}}, "weights"),
        ({"weights": 0.1}, "weights"),
    ),
    *(({"fidelity": "surogate"}, "surogate"), ({"iou": 0.0}, "iou"), ({"iou": 7}, "iou")),
    *(
        ({"iou": float("nan")}, "iou"),
        ({"fidelity": "surrogate", "iou": 0.5}, "IoU 0.5"),
        ({"frames": 0}, "frames"),
    ),
    *(({"frames": 1.5}, "frames"), ({"scheme": "earlier"}, "earlier"), ({"scheme": ()}, "scheme")),
    *(
        ({"scheme": ("early", "later")}, "later"),
        ({"candidates": "pol"}, "pol"),
        ({"detector": 3}, "detector"),
    ),
    *(
        ({"seed": -1}, "seed"),
        ({"budget": 0}, "budget"),
        ({"budget": 1.5}, "budget"),
        ({"budget": True}, "budget"),
    ),
    *(
        ({"budget": (3, 2)}, "budget"),
        ({"budget": (0, 2)}, "budget"),
        ({"budget": (1, 2, 3)}, "budget"),
    ),
    *(
        ({"failures": -1}, "failures"),
        ({"failures": (1, 0.5)}, "failures"),
        ({"site": "nowhere"}, "nowhere"),
    ),
    *(({"site": []}, "site"), ({"frame": 3}, "frame")),
]


@pytest.fixture(autouse=True)
def _nothing_is_rendered(fail: Any) -> None:
    fail("placement_env.fidelity.preparation", "simulate_traffic")
    fail("placement_env.fidelity.seeing", "see")


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(("wrong", "told"), WRONG)
def test_what_does_not_fit_is_told_when_made(name: str, wrong: dict[str, Any], told: str) -> None:
    for make in (gym.make, partial(gym.make_vec, num_envs=2)):
        with pytest.raises((ValueError, TypeError, FileNotFoundError), match=told):
            make(name, **wrong)


@pytest.mark.parametrize(
    ("name", "wrong", "told"),
    [
        (ALL[0], {"fidelity": "table", "iou": 0.5}, "IoU"),
        (ALL[0], {"fidelity": "table", "candidates": "pool"}, "table"),
        *(
            (ALL[0], {"slots": 3}, "slots"),
            (ALL[0], {"slots": 0}, "slots"),
            (ALL[0], {"workers": 0}, "workers"),
        ),
        *((ALL[0], {"actions": "both"}, "both"), (ALL[0], {"objective": 3}, "objective")),
        *(
            (ALL[1], {"actions": "flat"}, "actions"),
            (ALL[2], {"moves": 0}, "moves"),
            (ALL[2], {"moves": 2.5}, "moves"),
        ),
        (ALL[2], {"budget": 9}, "too few for a budget of 9"),
        (ALL[2], {"budget": (1, 4), "failures": 4}, "too few for a budget of 4 and 4 failures"),
        (ALL[2], {"slots": 9}, "slots"),
    ],
)
def test_what_one_environment_does_not_take(name: str, wrong: dict[str, Any], told: str) -> None:
    with pytest.raises((ValueError, TypeError), match=told):
        gym.make(name, **wrong)


def test_environments_of_an_objective_a_config_or_candidates():
    scored = Objective(Setting("tjunction", fidelity="table"))
    for wrong in ({"site": ["tjunction", "roundabout"]}, {"scheme": ["early", "late"]}):
        with pytest.raises(ValueError, match="keeps its site and scheme"):
            SubsetConfig(objective=scored, **wrong)  # type: ignore[arg-type]
    config = SelectConfig(setting=TABLE, budget=2)
    one, some = gym.make(ALL[0], config=config), gym.make_vec(ALL[0], num_envs=3, config=config)
    assert np.array_equal(one.reset(seed=0)[0], some.reset(seed=0)[0][0])
    assert isinstance(some, SensorSelectVectorEnv)
    own = paper_candidates(load_site("tjunction"))
    assert gym.make(ALL[1], fidelity="table", candidates=own).action_space.shape == (len(own),)


@pytest.mark.parametrize(
    ("env", "config"),
    [
        (SensorSelectEnv, SelectConfig(setting=TABLE, budget=2)),
        (SensorSubsetEnv, SubsetConfig(setting=TABLE, budget=2)),
        (SensorPoseEnv, PoseConfig(setting=Setting(fidelity="coverage"), budget=2)),
    ],
)
def test_one_config_holds_all_settings(env: Any, config: EnvConfig) -> None:
    assert env(config).task.scenarios.config is not None
    assert (
        env(config, weights=Weights(price=0.1)).task.scenarios.config.setting.weights.price == 0.1
    )
    assert env(config).task.scenarios.config.budget == 2
    with pytest.raises(TypeError, match=r"by name|Type-check"):
        env("tjunction")
    with pytest.raises(AttributeError):
        config.budget = 3  # type: ignore[misc]


@pytest.mark.parametrize("count", [0, -1, 1.5])
def test_a_vector_has_episodes(count: Any) -> None:
    with pytest.raises((ValueError, TypeError), match="num_envs"):
        gym.make_vec(ALL[0], num_envs=count, fidelity="table")
