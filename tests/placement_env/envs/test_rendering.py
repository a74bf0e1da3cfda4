"""Pictures and text of the chosen sensors."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from placement_env.envs.env import summary
from placement_env.envs.registration import register_environments
from toolkit.plots.palette import point_colours

register_environments()


@pytest.mark.parametrize("name", ["coview/SensorSelect-v0", "coview/SensorSubset-v0"])
def test_pictures_and_text(objective: Any, name: str) -> None:
    env = gym.make(name, objective=objective(), render_mode="rgb_array")
    env.reset()
    before = env.render()
    env.step(np.array([1, 0, 0, 0, 0, 0]) if "Subset" in name else 0)
    after = env.render()
    assert before.shape == after.shape  # type: ignore[union-attr]
    assert (before != after).any()
    text = gym.make(name, objective=objective(), render_mode="ansi")
    text.reset()
    assert "no sensors" in str(text.render())


@pytest.mark.slow
def test_pictures_are_of_one_size_and_darker_with_points():
    env = gym.make(
        "coview/SensorPose-v0",
        render_mode="rgb_array",
        site=["tjunction", "roundabout"],
        frames=1,
        budget=2,
        fidelity="coverage",
    )
    sizes = set()
    for seed in range(4):
        env.reset(seed=seed)
        sizes.add(env.render().shape)  # type: ignore[union-attr]
    assert len(sizes) == 1
    red, green, blue, opaque = point_colours(np.array([0.0, 1.0, 5.0, 50.0, 1e6])).T
    assert red[0] == green[0] == blue[0] > 0.9
    assert (np.diff(0.2126 * red + 0.7152 * green + 0.0722 * blue) < -0.02).all()
    assert (opaque == 1).all()


def test_the_summary_names_what_is_chosen_and_its_reward(objective: Any) -> None:
    some = objective()
    text = summary(some, [1, 4])
    assert some.names[1] in text
    assert some.names[4] in text
    assert f"reward {some.score([1, 4]).reward:.3f}" in text
