"""Episodes side by side as Stable-Baselines3 plays them: our environments as arrays, all others one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from placement_env.games import Game, GameEnv
from placement_env.pose_env import PoseGame, SensorPoseEnv
from placement_env.select_env import SelectGame, SensorSelectEnv
from placement_env.subset_env import SensorSubsetEnv, SubsetGame
from placement_env.vector_env import GameVectorEnv


def episodes(first: gym.Env[Any, Any], make_env: Callable[[], gym.Env[Any, Any]], n: int) -> VecEnv:
    """n episodes of an environment and others like it, stepped together; those of ours share its scenes."""
    ours = type(first) in (SensorSelectEnv, SensorSubsetEnv, SensorPoseEnv)  # neither wrapped nor inherited from
    if ours and isinstance(first, GameEnv):
        return Episodes(GameVectorEnv(side_by_side(first.game, n), None))
    return DummyVecEnv([lambda: Monitor(first), *[lambda: Monitor(make_env())] * (n - 1)])


class Episodes(VecEnv):
    """A native vector environment for Stable-Baselines3: an episode that has ended starts anew within the step.

    Infos hold what a training looks at and are empty until an episode ends: its return `r` and length `l` (`episode`),
    the set it ended with (`subset`), whether it was cut off (`TimeLimit.truncated`) and its last observation.
    """

    def __init__(self, envs: GameVectorEnv) -> None:
        self.envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)

    def reset(self) -> np.ndarray:
        """Start all episodes, seeded as `seed` was told to."""
        observations, _ = self.envs.reset(seed=list(self._seeds))
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions until `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the actions: observations, rewards, which episodes have ended, infos."""
        observations, rewards, terminated, truncated, info = self.envs.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(ended).tolist():
            infos[row] = {
                "episode": {"r": float(self._returns[row]), "l": int(self._lengths[row])},
                "subset": info["subset"][row],
                "TimeLimit.truncated": bool(truncated[row]),
                "terminal_observation": observations[row],
            }
        if ended.any():
            self._returns[ended], self._lengths[ended] = 0.0, 0
            observations, _ = self.envs.reset(options={"reset_mask": ended})
        return observations, rewards, ended, infos

    def close(self) -> None:
        """There is nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector environment, for each episode asked for."""
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector environment, which all episodes share."""
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """What a method of the vector environment answers for each episode asked for."""
        answers = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [answers[index] for index in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """No episode is."""
        return [False for _ in self._get_indices(indices)]


def side_by_side(game: Game, n: int) -> Game:
    """n episodes of a game with its scenes."""
    if isinstance(game, SelectGame):
        return SelectGame(n, game.scenes, game.actions)
    if isinstance(game, SubsetGame):
        return SubsetGame(n, game.scenes)
    assert isinstance(game, PoseGame)
    return PoseGame(n, game.scenes, int(game.boards.most_turns[0]))
