"""Vector environments: n episodes stepped as arrays, sets of all of them scored together.

They agree with `gymnasium.vector.SyncVectorEnv` over the scalar environments, step by step, infos and autoreset (next
step) included.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from placement_env.envs.config import PoseConfig, SelectConfig, SubsetConfig, build_config
from placement_env.envs.env import (
    RENDER_MODES,
    PlacementEnv,
    Task,
    check_ready,
    check_render_mode,
    checked_actions,
    picture,
)
from placement_env.envs.episode import Scenarios
from placement_env.envs.pose import PoseScenarios, PoseTask
from placement_env.envs.select import SelectTask
from placement_env.envs.subset import SubsetTask


class PlacementVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """n episodes of a task. An episode that has ended starts anew, without options, at the next step, whose reward
    is 0."""

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": RENDER_MODES,
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, task: Task, render_mode: str | None) -> None:
        self.task, self.render_mode, self.num_envs = task, check_render_mode(render_mode), task.state.n
        self.single_observation_space, self.single_action_space = task.observation_space, task.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._generators = [seeding.np_random()[0] for _ in range(self.num_envs)]
        self._ended, self._all = np.zeros(self.num_envs, np.bool_), np.ones(self.num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start all episodes, or those of `options["reset_mask"]`; with an int, the i-th is seeded by seed + i."""
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
        return observations, _batched(info, mask)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take an action in every episode; where one has ended, it starts anew and its action is not looked at."""
        actions = checked_actions(self.task, actions)
        rewards, terminated, truncated = self.task.step(~self._ended, actions)
        rewards = rewards.copy()
        if self._ended.any():
            self._start(np.flatnonzero(self._ended), {})
        self._ended = terminated | truncated
        observations, info = self.task.observe()
        return observations, rewards, terminated, truncated, _batched(info, self._all)

    def action_masks(self) -> np.ndarray:
        """Which actions are legal, a row for each episode."""
        check_ready(self.task)
        return self.task.action_masks()

    def render(self) -> tuple[Any, ...] | None:
        """A picture of each episode."""
        if self.render_mode is None:
            return None
        check_ready(self.task)
        return tuple(picture(self.task, row, self.render_mode) for row in range(self.num_envs))

    def _start(self, rows: np.ndarray, options: dict[str, Any]) -> None:
        episodes = [self.task.scenarios.draw(self._generators[row], options) for row in rows.tolist()]
        self.task.reset(rows, episodes)


def side_by_side(env: PlacementEnv, n: int) -> PlacementVectorEnv:
    """n episodes of an environment's task, at its scenarios."""
    return PlacementVectorEnv(type(env.task)(n, env.task.scenarios), None)  # type: ignore[call-arg]


class SensorSelectVectorEnv(PlacementVectorEnv):
    """n of `placement_env.envs.select.SensorSelectEnv`, which describes the arguments."""

    def __init__(
        self,
        num_envs: int = 1,
        config: SelectConfig | None = None,
        *,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(SelectTask(num_envs, Scenarios(build_config(SelectConfig, config, settings))), render_mode)


class SensorSubsetVectorEnv(PlacementVectorEnv):
    """n of `placement_env.envs.subset.SensorSubsetEnv`, which describes the arguments."""

    def __init__(
        self,
        num_envs: int = 1,
        config: SubsetConfig | None = None,
        *,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(SubsetTask(num_envs, Scenarios(build_config(SubsetConfig, config, settings))), render_mode)


class SensorPoseVectorEnv(PlacementVectorEnv):
    """n of `placement_env.envs.pose.SensorPoseEnv`, which describes the arguments."""

    def __init__(
        self, num_envs: int = 1, config: PoseConfig | None = None, *, render_mode: str | None = None, **settings: Any
    ) -> None:
        super().__init__(PoseTask(num_envs, PoseScenarios(build_config(PoseConfig, config, settings))), render_mode)


def _batched(info: dict[str, Any], rows: np.ndarray) -> dict[str, Any]:
    """Info as Gymnasium's vector environments give it: beside each key, which episodes it is of."""
    whole: dict[str, Any] = {}
    for key, value in info.items():
        whole[key] = _batched(value, rows) if isinstance(value, dict) else value
        whole[f"_{key}"] = rows.copy()
    return whole
