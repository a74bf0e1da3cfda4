"""Environments with several classes of road users; vehicles alone change nothing."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.envs.registration import register_environments
from placement_env.fidelity.coverage import Coverage
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.objects import PEDESTRIAN, VEHICLE
from toolkit.runtime.run import Run

register_environments()
BOTH = Classes(("vehicle", "pedestrian"), combine="worst")
SELECT = "coview/SensorSelect-v0"


def mixed(plain: Objective) -> Objective:
    """Same candidates, with every third object a pedestrian."""
    assert plain.visibility is not None
    labels = np.where(np.arange(60) % 3 == 0, PEDESTRIAN, VEHICLE)
    seen = replace(plain.visibility, labels=labels)
    return Objective(
        Setting(
            plain.site,
            candidates=plain.candidates,
            fidelity=Coverage(seen, classes=BOTH),
            scheme="early",
        ),
        visibility=seen,
    )


def test_rewards_of_classes_add_up_and_vehicles_alone_are_as_ever(objective: Any):
    made = mixed(objective())
    env = gym.make(SELECT, objective=made, budget=3)
    _, info = env.reset(seed=0)
    assert info["class_ap"] == {"vehicle": 0.0, "pedestrian": 0.0}
    total = 0.0
    for action in (0, 3, 4):
        _, reward, _, _, info = env.step(action)
        total += float(reward)
    score = made.score([0, 3, 4])
    assert total == pytest.approx(score.reward)
    assert info["ap"] == score.ap == min(info["class_ap"].values())
    assert info["class_ap"] == score.class_ap
    assert info["class_ap"]["vehicle"] != info["class_ap"]["pedestrian"]
    plain, several = (
        gym.make(SELECT, objective=objective()),
        gym.make(SELECT, objective=mixed(objective())),
    )
    first, info = plain.reset(seed=1)
    other, more = several.reset(seed=1)
    assert set(more) - set(info) == {"class_ap"}
    assert "class_ap" not in plain.step(0)[4]
    assert first.shape == other.shape
    assert plain.observation_space == several.observation_space


def test_vector_environments_say_what_scalar_ones_say_or_refuse(objective: Any):
    made = mixed(objective())
    vector = gym.make_vec(
        SELECT, num_envs=3, vectorization_mode="vector_entry_point", objective=made
    )
    alone = gym.make(SELECT, objective=made)
    vector.reset(seed=0)
    alone.reset(seed=0)
    _, rewards, _, _, infos = vector.step(np.array([0, 2, 4]))
    _, reward, _, _, info = alone.step(0)
    assert rewards[0] == reward
    for name in BOTH.names:
        assert infos["class_ap"][name][0] == info["class_ap"][name]
        assert infos["class_ap"][name][1] == made.score([2]).class_ap[name]
    assert infos["_class_ap"].all()
    with pytest.raises(ValueError, match="there is no class 'tram'"):
        gym.make(SELECT, classes=("tram",))
    with pytest.raises(ValueError, match="keeps its classes: give them to the objective"):
        gym.make(SELECT, objective=objective(), classes=("pedestrian",))
    with pytest.raises(
        ValueError, match=r"no surrogate of tjunction for early at IoU 0\.7 of heavy"
    ):
        gym.make(SELECT, classes=("vehicle", "heavy"), site="tjunction")
    gym.make(SELECT, classes=("heavy",), fidelity="table")
    gym.make(SELECT, objective=mixed(objective()), classes=BOTH)
    gym.make(SELECT, objective=mixed(objective()), classes=VEHICLES)


def test_classes_by_name_at_a_site() -> None:
    settings: dict[str, Any] = {"site": "tjunction", "fidelity": "coverage", "frames": 6}
    env = gym.make(SELECT, classes=("pedestrian", "vehicle"), **settings)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(3)
    expected = Objective(
        Setting("tjunction", fidelity="coverage", classes=("vehicle", "pedestrian")), Run(frames=6)
    ).score([3])
    assert (reward, info["class_ap"]) == (expected.reward, expected.class_ap)
    pose = gym.make("coview/SensorPose-v0", classes=BOTH, budget=1, **settings)
    _, info = pose.reset(seed=0)
    assert set(info["class_ap"]) == {"vehicle", "pedestrian"}
    _, _, _, _, info = pose.step(np.ones(3, np.float32))
    assert info["ap"] == min(info["class_ap"].values())
