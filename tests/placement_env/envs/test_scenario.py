"""What of an objective an agent may observe: features of candidates, in slots, and the places that they see."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from placement_env.envs.registration import register
from placement_env.envs.scenario import PLACES, STATIC, Scenario, find_area, pad, places_seen, poses
from placement_env.fidelity.coverage import LEAST
from placement_env.objective import Objective
from placement_env.setting import Setting, Weights

register()
CHOOSING = ["coview/SensorSelect-v0"]


def test_what_it_would_add_is_what_it_adds(objective: Any) -> None:
    env = gym.make(CHOOSING[0], objective=objective(weights=Weights()), budget=3)
    observation, _ = env.reset()
    for action in (0, 3, 4):
        marginal = observation[: 14 * 6].reshape(14, 6)[11, action]
        observation, reward, *_ = env.step(action)
        assert reward == pytest.approx(float(marginal), abs=1e-6)


def test_features_are_in_range_and_0_in_empty_slots(objective: Any) -> None:
    some = objective()
    static = Scenario(some, 8).static
    assert static.shape == (len(STATIC), 8)
    assert (np.abs(static) <= 1).all()
    assert not static[:, 6:].any()
    assert static[STATIC.index("seen"), :6] == pytest.approx((some.visibility.points >= LEAST).mean(axis=1))


def test_a_site_with_more_candidates_than_slots_is_refused(objective: Any) -> None:
    with pytest.raises(ValueError, match="slots for 5 candidates, this site has 6: make it with slots=6"):
        Scenario(objective(), 5)


def test_slots_without_a_candidate_are_of_no_use_and_on_a_mount_of_their_own(objective: Any) -> None:
    scenario = Scenario(objective(), 8)
    assert scenario.usable.tolist() == [True] * 6 + [False] * 2
    assert scenario.mount.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert (scenario.mounts, scenario.width) == (4, 6)
    assert scenario.mark_failed([1]).tolist() == [slot == 1 for slot in range(8)]


def test_what_is_seen_is_kept_as_bits(objective: Any) -> None:
    scenario = Scenario(objective(), 6)
    bits = np.unpackbits(np.ascontiguousarray(scenario.seen.T).view(np.uint8), axis=1)
    assert bits.shape == (6, PLACES)
    assert np.array_equal(bits[:, : scenario.places], places_seen(scenario.objective))
    assert not bits[:, scenario.places :].any()


def test_without_traffic_spots_in_the_field_of_view_are_seen() -> None:
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


def test_without_a_site_the_area_is_that_of_the_mounts(objective: Any) -> None:
    scored = objective()
    assert find_area(scored).tolist() == [-20, -20, 20, 20]
    without = Objective(
        Setting(candidates=scored.candidates, fidelity=scored.scored_by, weights=Weights()),
        visibility=scored.visibility,
    )
    assert find_area(without).tolist() == [-11, 11, 11, 13]


def test_rows_are_padded() -> None:
    assert pad(np.array([1, 2]), 4, fill=9).tolist() == [1, 2, 9, 9]
