"""Scenarios: features of candidates in slots, the places they see, and episodes drawn alike in
scalar and vector."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from placement_env.envs.registration import register_environments
from placement_env.envs.scenario import MAX_PLACES, STATIC, Scenario, find_area, places_seen, poses
from placement_env.envs.state import DYNAMIC, GLOBAL
from placement_env.fidelity.coverage import LEAST
from placement_env.objective import Objective
from placement_env.setting import Setting, Weights

register_environments()
CHOOSING = ["coview/SensorSelect-v0"]


def test_features_say_what_a_sensor_would_add(objective: Any):
    env = gym.make(CHOOSING[0], objective=objective(weights=Weights()), budget=3)
    observation, _ = env.reset()
    for action in (0, 3, 4):
        marginal = observation[: 14 * 6].reshape(14, 6)[11, action]
        observation, reward, *_ = env.step(action)
        assert reward == pytest.approx(float(marginal), abs=1e-6)


def test_static_features_are_shares_in_slots(objective: Any):
    some = objective()
    static = Scenario(some, 8).static
    assert static.shape == (len(STATIC), 8)
    assert (np.abs(static) <= 1).all()
    assert not static[:, 6:].any()
    assert static[STATIC.index("seen"), :6] == pytest.approx(
        (some.visibility.points >= LEAST).mean(axis=1)
    )
    scenario = Scenario(objective(), 8)
    assert scenario.usable.tolist() == [True] * 6 + [False] * 2
    assert scenario.width == 6


def test_bits_say_which_places_are_seen(objective: Any):
    scenario = Scenario(objective(), 6)
    bits = np.unpackbits(np.ascontiguousarray(scenario.seen.T).view(np.uint8), axis=1)
    assert bits.shape == (6, MAX_PLACES)
    assert np.array_equal(bits[:, : scenario.places], places_seen(scenario.objective))
    assert not bits[:, scenario.places :].any()


def test_the_area_is_the_sites_or_that_of_the_objects(objective: Any):
    scored = objective()
    assert find_area(scored).tolist() == [-20, -20, 20, 20]
    without = Objective(
        Setting(candidates=scored.candidates, fidelity=scored.scored_by, weights=Weights()),
        visibility=scored.visibility,
    )
    assert find_area(without).tolist() == [-11, 11, 11, 13]


def test_too_few_slots_are_refused(objective: Any):
    with pytest.raises(
        ValueError, match="slots for 5 candidates, this site has 6: make it with slots=6"
    ):
        Scenario(objective(), 5)


def test_spots_in_the_field_of_view_are_seen():
    scored = Objective(Setting("tjunction", fidelity="table"))
    seen = places_seen(scored)
    assert seen.shape == (6, 22 * 22)
    assert seen.any(axis=1).all()
    assert not seen.all(axis=1).any()
    position, heading, tilt, width, lidar = poses(scored.candidates)
    assert position.shape == (6, 3)
    assert (np.abs(heading) <= np.pi).all()
    assert (tilt > 0).all()
    assert (width < np.pi).all()
    assert not lidar.any()


def test_observations_say_budget_and_failures():
    env: Any = gym.make(
        "coview/SensorSelect-v0", fidelity="table", budget=(2, 4), failures=(0, 2)
    ).unwrapped
    slots, allowed = env.task.state.slots, len(STATIC) + DYNAMIC.index("allowed")
    env.reset(seed=1)
    for _ in range(20):
        observation, _ = env.reset()
        budget = env.task.state.budget[0]
        assert observation[len(observation) - len(GLOBAL) + 1] == pytest.approx(
            budget / (budget + 8)
        )
        assert np.array_equal(
            observation[allowed * slots : (allowed + 1) * slots], ~env.task.state.failed[0]
        )


OPEN: dict[str, Any] = {
    "site": ["tjunction", "roundabout"],
    "budget": (2, 4),
    "scheme": ("early", "late"),
    "failures": (0, 2),
}
CASES: list[tuple[str, dict[str, Any]]] = [
    ("coview/SensorSelect-v0", {**OPEN, "fidelity": "table"}),
    ("coview/SensorSelect-v0", {**OPEN, "fidelity": "table", "actions": "factored"}),
    ("coview/SensorSubset-v0", {**OPEN, "fidelity": "table"}),
    (
        "coview/SensorPose-v0",
        {"budget": (1, 2), "failures": (0, 2), "fidelity": "coverage", "frames": 1, "moves": 2},
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "given"),
    [CASES[0], *(pytest.param(*case, marks=pytest.mark.slow) for case in CASES[1:])],
)
def test_a_vector_draws_what_scalars_draw(name: str, given: dict[str, Any]) -> None:
    vector: Any = gym.make_vec(name, num_envs=4, **given)
    scalar = SyncVectorEnv([lambda: gym.make(name, **given)] * 4)
    assert np.array_equal(vector.reset(seed=3)[0], scalar.reset(seed=3)[0])
    scalar.action_space.seed(0)
    for _ in range(3 * given.get("moves", 4)):
        actions = scalar.action_space.sample()
        one, other = vector.step(actions), scalar.step(actions)
        for left, right in zip(one[:4], other[:4], strict=True):
            assert np.array_equal(left, right)
        assert np.array_equal(one[4]["action_mask"], other[4]["action_mask"])


def test_seeds_settle_draws_and_all_that_is_open_is_drawn():
    env: Any = gym.make(CASES[0][0], **CASES[0][1]).unwrapped
    seen: dict[str, set[Any]] = {"site": set(), "budget": set(), "scheme": set(), "failed": set()}
    env.reset(seed=0)
    for _ in range(60):
        env.reset()
        state, objective = env.task.state, env.placement()[0]
        seen["site"].add(objective.site.name)
        seen["scheme"].add(str(objective.scheme))
        seen["budget"].add(int(state.budget[0]))
        seen["failed"].add(int(state.failed[0].sum()))
        assert not (env.action_masks()[:-1] & state.failed[0]).any()
        assert not state.failed[0, len(objective.candidates) :].any()
    assert {key: len(values) for key, values in seen.items()} == {
        "site": 2,
        "budget": 3,
        "scheme": 2,
        "failed": 3,
    }
    other: Any = gym.make("coview/SensorSelect-v0", fidelity="table")
    other.reset(seed=5)
    before = other.unwrapped.np_random.bit_generator.state
    other.reset()
    assert other.unwrapped.np_random.bit_generator.state == before
    again: Any = gym.make(CASES[0][0], **CASES[0][1]).unwrapped

    def run(options: dict[str, Any] | None = None) -> list[np.ndarray]:
        return [
            again.reset(seed=7, options=options)[0],
            *[again.reset(options=options)[0] for _ in range(8)],
        ]

    for one, two in zip(run(), run(), strict=True):
        assert np.array_equal(one, two)
    told = {"site": "roundabout", "scheme": "late", "budget": 3, "failed": [2]}
    assert len({each.tobytes() for each in run(told)}) == 1
    assert np.flatnonzero(again.task.state.failed[0]).tolist() == [2]
    assert len({each.tobytes() for each in run()}) > 4
    with pytest.raises(ValueError, match="budget of an episode must be a whole number"):
        env.reset(options={"budget": (1, 2)})


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("name", "given"), CASES[:3])
@pytest.mark.filterwarnings("error")
def test_both_checkers_pass_where_episodes_differ(name: str, given: dict[str, Any]) -> None:
    env = gym.make(name, disable_env_checker=True, **given)
    check_env(env.unwrapped, skip_render_check=True)
    check_env_sb3(env)


@pytest.mark.slow
def test_episodes_draw_their_traffic_where_asked():
    own = {
        "site": "tjunction",
        "candidates": "paper",
        "fidelity": "coverage",
        "frames": 4,
        "budget": 2,
    }
    fixed, several, fresh = (gym.make(CHOOSING[0], **own, traffics=count) for count in (1, 2, None))

    def seeds(env, episodes):
        for seed in range(episodes):
            env.reset(seed=seed)
        return {
            made.objective.run.seed for made in env.unwrapped.task.scenarios._scenarios.values()
        }

    assert seeds(fixed, 3) == {0}
    assert seeds(several, 8) == {0, 11 * 1_000_003}
    assert len(seeds(fresh, 3)) == 3
    with pytest.raises(ValueError, match="a table is of its own traffic"):
        gym.make(CHOOSING[0], site="tjunction", fidelity="table", traffics=2)
    with pytest.raises(ValueError, match="traffics must be a whole number of at least 1"):
        gym.make(CHOOSING[0], site="tjunction", traffics=0)
