"""Moving sensors: ranges, renders, checkers, agreement of scalar and vector environments."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from placement_env.candidates.candidates import paper_candidates
from placement_env.envs.pose import TILT_LIMITS_RAD, PoseRig
from placement_env.envs.registration import register_environments
from toolkit import load_site
from toolkit.runtime.cache import Cache

register_environments()
NAME = "coview/SensorPose-v0"
FEW: dict[str, Any] = {"frames": 2, "fidelity": "coverage", "budget": 2}


@pytest.fixture(scope="module")
def env() -> gym.Env[Any, Any]:
    return gym.make(NAME, disable_env_checker=True, moves=3, **FEW)


def test_rigs_stand_within_ranges_and_links_are_relieved():
    some = paper_candidates(load_site("tjunction"))
    for before, after in zip(
        some.sensors, PoseRig.from_candidates(some).to_candidates().sensors, strict=True
    ):
        assert np.allclose(before.pose, after.pose, atol=1e-6)
    some = paper_candidates(load_site("roundabout"))
    rig = PoseRig.from_candidates(some)
    for _ in range(40):
        rig = rig.move(np.ones((len(some), 3)))
    highest = [some.mounts[index].max_height for index in some.mount]
    assert np.allclose(rig.aim[:, 0], highest)
    assert np.allclose(rig.aim[:, 2], TILT_LIMITS_RAD[1])
    assert (np.abs(rig.aim[:, 1]) <= np.pi).all()
    assert np.array_equal(rig.move(np.zeros((len(some), 3))).aim, rig.aim)
    site = load_site("tjunction")
    tight = replace(site, mounts=tuple(replace(mount, capacity=1.0) for mount in site.mounts))
    env = gym.make(NAME, site=tight, moves=12, frames=2, fidelity="coverage", budget=1)
    _, info = env.reset(seed=0)
    env.action_space.seed(0)
    illegal = []
    for _ in range(12):
        before, (*_, info) = info["kbit"], env.step(env.action_space.sample())
        illegal.append(info["illegal"])
        assert info["kbit"] <= before
    assert len(set(illegal)) == 2


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_both_checkers_pass_without_a_warning(env: gym.Env[Any, Any]) -> None:
    check_env(env.unwrapped, skip_close_check=True, skip_render_check=True)
    check_env_sb3(env)


def test_rewards_add_up_and_rest_is_as_if_rendered_again(env: gym.Env[Any, Any]):
    env.reset(seed=1)
    env.step(np.array([0.0, 1.0, 0.3, 0.0, 0.0, 0.0], np.float32))
    task = env.unwrapped.task  # type: ignore[attr-defined]
    objective, members = task.state.placement(0)
    now = task.episodes[0]
    again = now.preparation.live.see(now.rig.to_candidates())
    assert members == [0, 1]
    for column in ("points", "distance", "sent", "far"):
        assert np.array_equal(getattr(again, column), getattr(objective.visibility, column))
    _, info = env.reset(seed=2, options={"failed": ["d1"]})
    total, first = 0.0, info["ap"]
    env.action_space.seed(0)
    for move in range(3):
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        total += float(reward)
        assert (terminated, truncated) == (False, move == 2)
    assert total == pytest.approx(info["ap"] - first)


@pytest.mark.slow
def test_a_vector_does_what_scalars_do() -> None:
    vector = gym.make_vec(NAME, num_envs=2, moves=2, **FEW)
    scalar = SyncVectorEnv([lambda: gym.make(NAME, moves=2, **FEW)] * 2)
    assert np.array_equal(vector.reset(seed=4)[0], scalar.reset(seed=4)[0])
    scalar.action_space.seed(0)
    for _ in range(4):
        actions = scalar.action_space.sample()
        one, other = vector.step(actions), scalar.step(actions)
        for left, right in zip(one[:4], other[:4], strict=True):
            assert np.array_equal(left, right)
        assert np.array_equal(one[4]["subset"], other[4]["subset"])


def test_what_does_not_fit(env: gym.Env[Any, Any]) -> None:
    with pytest.raises(ValueError, match="a table knows no poses"):
        gym.make(NAME, fidelity="table")
    with pytest.raises(ValueError, match=r"budget must lie in 1\.\.2"):
        env.reset(options={"budget": 3})
    with pytest.raises(ValueError, match="budget must be at least 1"):
        gym.make(NAME, budget=0)
    for nobody in ("nobody", 99, 1.5):
        with pytest.raises(ValueError, match="candidates are 0 to 5"):
            env.reset(options={"failed": [nobody]})
    env.reset()
    with pytest.raises(ValueError, match="finite"):
        env.step(np.full(6, np.nan, np.float32))
    with pytest.raises(ValueError, match="too few for a budget"):
        env.reset(options={"failed": ["d0", "d1", "d2", "d3", 4]})


def test_in_panoramas_a_step_sees_what_full_rendering_sees(tmp_path: Path) -> None:
    settings = {**FEW, "fidelity": "surrogate", "moves": 4}
    # the first by default
    ways: list[dict[str, Any]] = [{"cache": tmp_path}, {"rendering": "full"}]
    both = [gym.make(NAME, **way, **settings).unwrapped for way in ways]
    tasks: list[Any] = [env.task for env in both]  # type: ignore[attr-defined]
    both[0].action_space.seed(1)
    apart, near = [], []
    for seed in range(3, 7):
        for env in both:
            env.reset(seed=seed)
        for _ in range(3):
            action = both[0].action_space.sample()
            rewards = [float(env.step(action)[1]) for env in both]
            apart.append(abs(rewards[0] - rewards[1]))
            quick, full = (task.state.placement(0)[0].visibility for task in tasks)
            near.append(
                (np.abs(quick.points - full.points) <= np.maximum(0.03 * full.points, 8)).mean()
            )
            assert (quick.points != full.points).any()
    assert np.mean(near) > 0.97
    assert (
        np.mean(apart) < 0.02
    )  # one vehicle with some ten points may be there for the one and not for the other
    now = tasks[0].episodes[0]
    assert np.array_equal(now.preparation.live.see(now.rig.to_candidates()).points, quick.points)
    assert tasks[1].episodes[0].preparation.live is None
    assert len(Cache(tmp_path / "cache.sqlite")) > 2
