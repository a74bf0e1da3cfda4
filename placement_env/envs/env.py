"""Tasks, n episodes side by side under one set of rules, and the Gymnasium environment of one episode."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Space

from placement_env.envs.rendering import bird_view, summary
from placement_env.envs.scenario import STATIC
from placement_env.envs.state import DYNAMIC, GLOBAL, State
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped

RENDER_MODES = ["rgb_array", "ansi"]


@runtime_checkable
class Task(Protocol):
    """The rules of an environment, for n episodes at once; made of n and their scenarios."""

    scenarios: Any  # with draw(rng, options)
    state: State
    observation_space: Box
    action_space: Space[Any]

    def reset(self, rows: Int64[np.ndarray, " m"], episodes: list[Any]) -> None:
        """New episodes in some rows."""

    def step(
        self, active: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """One action in each active row: rewards, terminated, truncated."""

    def observe(self) -> tuple[Float32[np.ndarray, "n size"], dict[str, Any]]:
        """Observations and info, an array (n, ...) each."""

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Which actions are legal."""


class PlacementEnv(gym.Env[np.ndarray, Any]):
    """One episode after another of a task with one row; the registered environments differ by their task."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": 2}  # type: ignore[misc]

    def __init__(self, task: Task, render_mode: str | None) -> None:
        self.task, self.render_mode = task, check_render_mode(render_mode)
        self.observation_space, self.action_space = task.observation_space, task.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; options: site, scheme, budget, failed (candidates that have failed, by index or name),
        which hold for this episode. Raises ValueError where one does not fit."""
        super().reset(seed=seed)
        self.task.reset(np.zeros(1, np.int64), [self.task.scenarios.draw(self.np_random, options)])
        observations, info = self.task.observe()
        return observations[0], first_of(info)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take an action. Raises ValueError for what is none, ResetNeeded before the first `reset`."""
        actions = checked_actions(self.task, action)
        reward, terminated, truncated = self.task.step(np.ones(1, np.bool_), actions)
        observations, info = self.task.observe()
        return observations[0], reward.item(), terminated.item(), truncated.item(), first_of(info)

    def action_masks(self) -> Bool[np.ndarray, " choices"]:
        """Which actions are legal, as sb3-contrib's MaskablePPO asks for them."""
        check_ready(self.task)
        return self.task.action_masks()[0]

    def placed(self) -> tuple[Objective, list[int]]:
        """The objective of the episode and the candidates that are chosen."""
        check_ready(self.task)
        return self.task.state.placed(0)

    def render(self) -> Any:
        """The area from above with the chosen sensors and what they see (uint8), or a few lines of text."""
        if self.render_mode is None:
            return None
        check_ready(self.task)
        return picture(self.task, 0, self.render_mode)


def check_render_mode(render_mode: str | None) -> str | None:
    """The render mode, or ValueError where there is none of that name."""
    if render_mode not in (None, *RENDER_MODES):
        raise ValueError(f"render_mode must be None or one of {', '.join(RENDER_MODES)}, got {render_mode!r}")
    return render_mode


def check_ready(task: Task) -> None:
    """Raises ResetNeeded where an episode has not started."""
    if not task.state.ready:
        raise ResetNeeded("no episode has started: call reset() first")


def checked_actions(task: Task, actions: Any) -> Shaped[np.ndarray, "n ..."]:
    """An action for each of n episodes. Raises ValueError where there are fewer or more numbers, one is not finite, or
    no whole one where choices are counted; ResetNeeded before the first reset."""
    check_ready(task)
    array, shape = np.asarray(actions), (task.state.n, *(task.action_space.shape or ()))
    kind = array.dtype.kind
    if array.size != math.prod(shape) or kind not in "biuf":
        raise ValueError(f"actions must be numbers of shape {shape}, got {array.dtype} {array.shape}")
    if kind == "f":
        if not np.isfinite(array).all():
            raise ValueError(f"actions must be finite, got {array.tolist()}")
        if task.action_space.dtype.kind != "f" and (array != np.round(array)).any():  # type: ignore[union-attr]
            raise ValueError(f"actions must be whole numbers, one of {task.action_space} each, got {array.tolist()}")
    return array.reshape(shape)


def picture(task: Task, row: int, mode: str) -> Any:
    """A row of a task as an image or as text."""
    objective, members = task.state.placed(row)
    return bird_view(objective, members) if mode == "rgb_array" else summary(objective, members)


def first_of(info: dict[str, Any]) -> dict[str, Any]:
    """The info of the first of n episodes, with Python's own numbers."""
    return {
        key: first_of(value) if isinstance(value, dict) else value.item(0) if value.ndim == 1 else value[0]
        for key, value in info.items()
    }


def observation_space(slots: int) -> Box:
    """Of choosing among candidates: features of each slot, feature after feature, then of the whole."""
    size = (len(STATIC) + len(DYNAMIC)) * slots + len(GLOBAL)
    return Box(-1.0, 1.0, (size,), np.float32)
