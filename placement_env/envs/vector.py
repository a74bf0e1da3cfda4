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

from placement_env.envs.env import RENDER_MODES, Game, as_actions, picture
from placement_env.envs.pose import PoseGame, PoseScenes
from placement_env.envs.scenario import Scenes
from placement_env.envs.select import Actions, SelectGame
from placement_env.envs.subset import SubsetGame
from placement_env.objective import FidelityName, Objective
from toolkit.detection.scheme import Scheme


class GameVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """n episodes of a game. An episode that has ended starts anew, without options, at the next step, whose reward
    is 0."""

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": RENDER_MODES,
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, game: Game, render_mode: str | None) -> None:
        self.game, self.render_mode, self.num_envs = game, render_mode, game.boards.n
        self.single_observation_space, self.single_action_space = game.observation_space, game.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._generators = [seeding.np_random()[0] for _ in range(self.num_envs)]
        self._ended = np.zeros(self.num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start all episodes, or those of `options["reset_mask"]`; with an int, the i-th is seeded by seed + i."""
        options = dict(options or {})
        rows = np.flatnonzero(options.pop("reset_mask", np.ones(self.num_envs, np.bool_)))
        seeds = [None] * self.num_envs if seed is None else seed
        seeds = [seeds + i for i in range(self.num_envs)] if isinstance(seeds, int) else seeds
        if len(seeds) != self.num_envs:
            raise ValueError(f"there must be a seed for each of {self.num_envs} environments, got {len(seeds)}")
        for row in rows.tolist():
            if seeds[row] is not None:
                self._generators[row] = seeding.np_random(seeds[row])[0]
        self._begin(rows, options)
        self._ended[rows] = False
        observations, info = self.game.look()
        return observations, _batched(info, np.isin(np.arange(self.num_envs), rows))

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take an action in every episode; where one has ended, it starts anew and its action is not looked at."""
        playing = ~self._ended
        rewards, terminated, truncated = self.game.play(playing, as_actions(self.game, actions))
        rewards = rewards.copy()
        if self._ended.any():
            self._begin(np.flatnonzero(self._ended), {})
        self._ended = terminated | truncated
        observations, info = self.game.look()
        return observations, rewards, terminated, truncated, _batched(info, np.ones(self.num_envs, np.bool_))

    def action_masks(self) -> np.ndarray:
        """Which actions are legal, a row for each episode."""
        return self.game.masks()

    def render(self) -> tuple[Any, ...] | None:
        """A picture of each episode."""
        if self.render_mode is None:
            return None
        return tuple(picture(self.game, row, self.render_mode) for row in range(self.num_envs))

    def _begin(self, rows: np.ndarray, options: dict[str, Any]) -> None:
        starts = [self.game.scenes.start(self._generators[row], options) for row in rows.tolist()]
        self.game.begin(rows, starts)


class SensorSelectVectorEnv(GameVectorEnv):
    """n of `placement_env.envs.select.SensorSelectEnv`, which describes the arguments."""

    def __init__(
        self,
        num_envs: int = 1,
        site: Any = "tjunction",
        *,
        budget: int = 4,
        actions: Actions = "flat",
        slots: int | None = None,
        objective: Objective | None = None,
        scheme: Scheme | str = "early",
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        scenes = Scenes(site, budget, scheme, slots, objective, arguments)
        super().__init__(SelectGame(num_envs, scenes, actions), render_mode)


class SensorSubsetVectorEnv(GameVectorEnv):
    """n of `placement_env.envs.subset.SensorSubsetEnv`, which describes the arguments."""

    def __init__(
        self,
        num_envs: int = 1,
        site: Any = "tjunction",
        *,
        budget: int = 4,
        slots: int | None = None,
        objective: Objective | None = None,
        scheme: Scheme | str = "early",
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        scenes = Scenes(site, budget, scheme, slots, objective, arguments)
        super().__init__(SubsetGame(num_envs, scenes), render_mode)


class SensorPoseVectorEnv(GameVectorEnv):
    """n of `placement_env.envs.pose.SensorPoseEnv`, which describes the arguments."""

    def __init__(
        self,
        num_envs: int = 1,
        site: Any = "tjunction",
        *,
        budget: int = 4,
        moves: int = 20,
        scheme: Scheme | str = "early",
        fidelity: FidelityName = "surrogate",
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        super().__init__(PoseGame(num_envs, PoseScenes(site, budget, scheme, fidelity, arguments), moves), render_mode)


def _batched(info: dict[str, Any], rows: np.ndarray) -> dict[str, Any]:
    """Info as Gymnasium's vector environments give it: beside each key, which episodes it is of."""
    whole: dict[str, Any] = {}
    for key, value in info.items():
        whole[key] = _batched(value, rows) if isinstance(value, dict) else value
        whole[f"_{key}"] = rows.copy()
    return whole
