from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import placement_env  # noqa: F401  registers the environments
from placement_env.candidates.drawing import with_mounts
from placement_env.envs.maps.map_select import MapConfig, SensorMapEnv
from placement_env.envs.maps.terms import Terms


@pytest.fixture
def env(junctions) -> SensorMapEnv:
    return SensorMapEnv(seeds=(0, 1), folder=junctions, places=3, poses=4, failures=(0, 2))


@pytest.fixture
def plain(made_up) -> Terms:
    return Terms.plain(made_up(0).candidates, 2)


@pytest.mark.filterwarnings("error")
def test_gymnasium_checks_it(junctions):
    made = gym.make("coview/SensorMap-v0", seeds=(0,), folder=junctions, places=3, poses=4, disable_env_checker=True)
    check_env(made.unwrapped, skip_render_check=True)


def test_rewards_add_up_to_that_of_the_set(env):
    for seed in range(6):
        _, info = env.reset(seed=seed)
        total, ended, rng = 0.0, False, np.random.default_rng(seed)
        while not ended:
            legal = np.flatnonzero(info["action_mask"][:-1])
            action = int(rng.choice(legal)) if len(legal) else env.config.slots
            observation, reward, terminated, truncated, info = env.step(action)
            total, ended = total + reward, terminated or truncated
        objective, members = env.placed()
        assert total == pytest.approx(objective.score(members).reward)
        assert info["reward"] == pytest.approx(total)
        assert bool(objective.feasible(objective.row(members)[None])[0])
        assert len(members) <= env.terms.budget
        assert env.observation_space.contains(observation)


def test_what_a_link_does_not_carry_is_refused_and_not_known_before(env, plain):
    _, info = env.reset(
        seed=0,
        options={
            "seed": 0,
            "terms": Terms.plain(with_mounts(plain.candidates, [1.0] * 3, [1e-3] * 3, [0.0]), 2),
        },
    )
    assert info["action_mask"][0]
    observation, reward, terminated, _, info = env.step(0)
    assert (reward, terminated, info["refused"], info["illegal"]) == (0, False, True, False)
    assert not info["subset"].any()
    assert not info["action_mask"][0]
    assert observation["candidates"][0, -1] == 0
    assert info["action_mask"][1]


@pytest.mark.parametrize(("room", "refused"), [(1.0, False), (-1.0, True)])
def test_sensors_share_a_mount_and_its_link(env, plain, room, refused):
    env.reset(options={"seed": 0, "terms": plain})
    sent = env.placed()[0].sent
    assert plain.candidates.mount[:4].tolist() == [0, 0, 0, 0]
    some = with_mounts(plain.candidates, [1.0] * 3, [float(sent[0] + sent[1]) + room] * 3, [0.5])
    some = replace(some, mounts=tuple(replace(mount, max_sensors=2) for mount in some.mounts))
    env.reset(options={"seed": 0, "terms": Terms.plain(some, 3)})
    env.step(0)
    _, _, _, _, info = env.step(1)
    assert (info["refused"], info["illegal"]) == (refused, False)
    assert info["price"] == (1.5 if refused else 2.0)
    assert info["action_mask"][:4].tolist() == ([0, 0, 1, 1] if refused else [0, 0, 0, 0])


def test_what_may_not_be_done_changes_nothing(env, plain):
    _, info = env.reset(seed=0, options={"seed": 0, "terms": plain})
    objective, _ = env.placed()
    first = int(np.flatnonzero(objective.linked)[0])
    _, gain, *_ = env.step(first)
    assert gain > 0
    _, reward, terminated, truncated, info = env.step(first)
    assert (reward, terminated, truncated, info["illegal"]) == (0, False, False, True)
    assert np.flatnonzero(info["subset"]).tolist() == [first]
    _, _, terminated, _, info = env.step(env.config.slots)
    assert terminated
    assert not info["illegal"]


def test_it_ends_when_the_budget_is_used_and_is_cut_off(env, plain):
    env.reset(options={"seed": 0, "terms": plain})
    objective, _ = env.placed()
    linked = np.flatnonzero(objective.linked)
    mount = objective.candidates.mount
    second = int(linked[mount[linked] != mount[linked[0]]][0])
    assert not env.step(int(linked[0]))[2]
    assert env.step(second)[2]
    env.reset(options={"seed": 0, "terms": plain})
    env.step(int(linked[0]))
    ends = [env.step(int(linked[0]))[3] for _ in range(3)]
    assert ends == [False, False, True]


def test_same_seed_same_episode(env):
    one, _ = env.reset(seed=7)
    two, _ = env.reset(seed=7)
    other, _ = env.reset(seed=8)
    assert all((one[name] == two[name]).all() for name in one)
    assert any((one[name] != other[name]).any() for name in one)


def test_pictures_and_words(junctions):
    env = SensorMapEnv(seeds=(0,), folder=junctions, places=3, poses=4, render_mode="ansi")
    env.reset(seed=0)
    assert "AP" in env.render()
    assert SensorMapEnv(seeds=(0,), folder=junctions).render() is None


def test_errors_say_what_fits(env, made_up):
    with pytest.raises(ResetNeeded):
        env.step(0)
    with pytest.raises(ValueError, match="options are seed, terms"):
        env.reset(options={"site": "tjunction"})
    with pytest.raises(ValueError, match="must be one of the environment's junctions"):
        env.reset(options={"seed": 5})
    with pytest.raises(ValueError, match="terms are of 20 candidates"):
        env.reset(options={"seed": 0, "terms": Terms.plain(made_up(0, 5, 4).candidates, 2)})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions are 0 to 12"):
        env.step(13)
    for wrong in ({"seeds": ()}, {"seeds": (-1,)}, {"frames": 0}, {"budget": 0}, {"failures": (2, 1)}):
        with pytest.raises(ValueError, match="must be"):
            MapConfig(**wrong)
