"""Scalar and vector environments of a task, the rules of n episodes side by side.

They agree with `gymnasium.vector.SyncVectorEnv` over the scalar environments, step by step, infos and autoreset (next
step) included.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Space
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from placement_env.envs.rendering import bird_view, summary
from placement_env.envs.scenario import STATIC, Options
from placement_env.envs.state import DYNAMIC, GLOBAL, Info, State
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped

RENDER_MODES = ["rgb_array", "ansi"]
METADATA = {"render_modes": RENDER_MODES, "render_fps": 2}
ActionSpace = Space[Any]
AnyEnv = gym.Env[Any, Any]
Picture = Shaped[np.ndarray, "height width 3"] | str


@runtime_checkable
class Task(Protocol):
    """Rules of an environment, for n episodes at once."""

    state: State
    observation_space: Box
    action_space: ActionSpace

    def resize(self, n: int) -> Task:
        """Return the same rules, at the same scenarios, for n episodes."""

    def reset(
        self, rows: Int64[np.ndarray, " m"], rngs: Sequence[np.random.Generator], options: Options | None
    ) -> None:
        """Start new episodes in some rows, one from each generator."""

    def step(
        self, active: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Take one action in each active row: rewards, terminated, truncated."""

    def observe(self) -> tuple[Float32[np.ndarray, "n size"], Info]:
        """Return observations and info, an array (n, ...) each."""

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Tell which actions are legal."""


class PlacementEnv(gym.Env[np.ndarray, Any]):
    """One episode after another of a task. The registered environments differ by their task."""

    metadata: ClassVar[dict[str, Any]] = METADATA  # type: ignore[misc]

    def __init__(self, task: Task, render_mode: str | None) -> None:
        self.task, self.render_mode = task, check_render_mode(render_mode)
        self.observation_space, self.action_space = task.observation_space, task.action_space

    def reset(self, *, seed: int | None = None, options: Options | None = None) -> tuple[np.ndarray, Info]:
        """Start an episode.

        options, for this episode: site, scheme, budget, failed (candidates that have failed, by index or name). Raises
        ValueError where one does not fit.
        """
        super().reset(seed=seed)
        self.task.reset(np.zeros(1, np.int64), [self.np_random], options)
        observations, info = self.task.observe()
        return observations[0], first_info(info)

    def step(self, action: ArrayLike) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Take an action. Raises ValueError for an invalid action, ResetNeeded before the first `reset`."""
        actions = check_actions(self.task, action)
        reward, terminated, truncated = self.task.step(np.ones(1, np.bool_), actions)
        observations, info = self.task.observe()
        return observations[0], reward.item(), terminated.item(), truncated.item(), first_info(info)

    def action_masks(self) -> Bool[np.ndarray, " choices"]:
        """Tell which actions are legal, in the form of sb3-contrib's MaskablePPO."""
        check_ready(self.task)
        return self.task.action_masks()[0]

    def placement(self) -> tuple[Objective, list[int]]:
        """Return the objective of the episode and the chosen candidates."""
        check_ready(self.task)
        return self.task.state.placement(0)

    def render(self) -> Picture | None:
        """Draw the area with the chosen sensors (uint8), or describe them in text."""
        if self.render_mode is None:
            return None
        check_ready(self.task)
        return draw_row(self.task, 0, self.render_mode)


class PlacementVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """n episodes of a task.

    An episode that has ended starts anew, without options, at the next step, whose reward is 0.
    """

    metadata: ClassVar[dict[str, Any]] = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc]

    def __init__(self, task: Task, render_mode: str | None) -> None:
        self.task, self.render_mode, self.num_envs = task, check_render_mode(render_mode), task.state.n
        self.single_observation_space, self.single_action_space = task.observation_space, task.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._generators = [seeding.np_random()[0] for _ in range(self.num_envs)]
        self._ended, self._all = np.zeros(self.num_envs, np.bool_), np.ones(self.num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Options | None = None
    ) -> tuple[np.ndarray, Info]:
        """Start all episodes, or those of `options["reset_mask"]`. With an int, the i-th is seeded by seed + i."""
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", self._all))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ValueError(f"reset_mask must be {self.num_envs} truth values, got {mask.dtype} {mask.shape}")
        rows = np.flatnonzero(mask)
        seeds = [None] * self.num_envs if seed is None else seed
        seeds = [seeds + i for i in range(self.num_envs)] if isinstance(seeds, int) else seeds
        if len(seeds) != self.num_envs:
            raise ValueError(f"there must be a seed for each of {self.num_envs} environments, got {len(seeds)}")
        if not mask.all():
            check_ready(self.task)
        for row in rows.tolist():
            if seeds[row] is not None:
                self._generators[row] = seeding.np_random(seeds[row])[0]
        self._start(rows, options)
        self._ended[rows] = False
        observations, info = self.task.observe()
        return observations, _batch_info(info, mask)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Take an action in every episode. One that has ended starts anew and ignores its action."""
        actions = check_actions(self.task, actions)
        rewards, terminated, truncated = self.task.step(~self._ended, actions)
        rewards = rewards.copy()
        if self._ended.any():
            self._start(np.flatnonzero(self._ended), None)
        self._ended = terminated | truncated
        observations, info = self.task.observe()
        return observations, rewards, terminated, truncated, _batch_info(info, self._all)

    def action_masks(self) -> np.ndarray:
        """Tell which actions are legal, a row for each episode."""
        check_ready(self.task)
        return self.task.action_masks()

    def render(self) -> tuple[Picture, ...] | None:
        """Draw each episode."""
        if self.render_mode is None:
            return None
        check_ready(self.task)
        return tuple(draw_row(self.task, row, self.render_mode) for row in range(self.num_envs))

    def _start(self, rows: np.ndarray, options: Options | None) -> None:
        self.task.reset(rows, [self._generators[row] for row in rows.tolist()], options)


def side_by_side(env: PlacementEnv, n: int) -> PlacementVectorEnv:
    """Return n episodes of an environment's task, at its scenarios."""
    return PlacementVectorEnv(env.task.resize(n), None)


def check_render_mode(render_mode: str | None) -> str | None:
    """Return the render mode. Raises ValueError for an unknown one."""
    if render_mode not in (None, *RENDER_MODES):
        raise ValueError(f"render_mode must be None or one of {', '.join(RENDER_MODES)}, got {render_mode!r}")
    return render_mode


def check_ready(task: Task) -> None:
    """Raise ResetNeeded where an episode has not started."""
    if not task.state.ready:
        raise ResetNeeded("no episode has started: call reset() first")


def check_actions(task: Task, actions: ArrayLike) -> Shaped[np.ndarray, "n ..."]:
    """Return an action for each of n episodes.

    Raises ValueError for a wrong number of values, one that is not finite, or not whole where choices are counted;
    ResetNeeded before the first reset.
    """
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


def draw_row(task: Task, row: int, mode: str) -> Picture:
    """Draw a row of a task, or describe it in text."""
    objective, members = task.state.placement(row)
    return bird_view(objective, members) if mode == "rgb_array" else summary(objective, members)


def first_info(info: Info) -> Info:
    """Return the info of the first episode, with Python's numbers."""
    return {
        key: first_info(value) if isinstance(value, dict) else value.item(0) if value.ndim == 1 else value[0]
        for key, value in info.items()
    }


def _batch_info(info: Info, rows: np.ndarray) -> Info:
    """Info as in Gymnasium's vector environments. Beside each key stand the episodes that it is for."""
    whole: Info = {}
    for key, value in info.items():
        whole[key] = _batch_info(value, rows) if isinstance(value, dict) else value
        whole[f"_{key}"] = rows.copy()
    return whole


def observation_space(slots: int) -> Box:
    """Space of observations of candidates.

    Features of the slots come first, feature after feature, then those of the whole.
    """
    size = (len(STATIC) + len(DYNAMIC)) * slots + len(GLOBAL)
    return Box(-1.0, 1.0, (size,), np.float32)
