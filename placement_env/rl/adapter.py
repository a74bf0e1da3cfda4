"""Episodes side by side as Stable-Baselines3 plays them: our environments as arrays, all others one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from placement_env.envs.env import Game, GameEnv
from placement_env.envs.pose import PoseGame, SensorPoseEnv
from placement_env.envs.scenario import STATIC
from placement_env.envs.select import SelectGame, SensorSelectEnv
from placement_env.envs.state import GLOBAL
from placement_env.envs.subset import SensorSubsetEnv, SubsetGame
from placement_env.envs.vector import GameVectorEnv
from toolkit.arrays import Float32

X, HEADING = STATIC.index("x"), STATIC.index("cos heading")  # y and sine come next


def episodes(
    first: gym.Env[Any, Any], make_env: Callable[[], gym.Env[Any, Any]], n: int, *, turned: bool = False
) -> VecEnv:
    """n episodes of an environment and others like it, stepped together; those of ours share its scenes.

    Raises ValueError where `turned`, of `Episodes`, is asked of an environment that is not ours.
    """
    ours = type(first) in (SensorSelectEnv, SensorSubsetEnv, SensorPoseEnv)  # neither wrapped nor inherited from
    if ours and isinstance(first, GameEnv):
        return Episodes(GameVectorEnv(side_by_side(first.game, n), None), turned=turned)
    if turned:
        raise ValueError(f"only junctions of our own environments can be turned, got {first}: leave turned out")
    return DummyVecEnv([lambda: Monitor(first), *[lambda: Monitor(make_env())] * (n - 1)])


class Episodes(VecEnv):
    """A native vector environment for Stable-Baselines3: an episode that has ended starts anew within the step.

    Infos hold what a training looks at and are empty until an episode ends: its return `r` and length `l` (`episode`),
    the set it ended with (`subset`), whether it was cut off (`TimeLimit.truncated`) and its last observation.

    turned: each episode's junction is turned by a multiple of 90° and perhaps mirrored at random, as agents see it.
    """

    def __init__(self, envs: GameVectorEnv, *, turned: bool = False) -> None:
        self.envs, self._turned = envs, turned
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)
        self._turns = np.zeros((self.num_envs, 2, 2), np.float32)

    def reset(self) -> np.ndarray:
        """Start all episodes, seeded as `seed` was told to."""
        observations, _ = self.envs.reset(seed=list(self._seeds))
        self._rng = np.random.default_rng(self._seeds[0])
        self._reset_seeds()
        self._begin(np.ones(self.num_envs, np.bool_))
        return self._as_seen(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions until `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the actions: observations, rewards, which episodes have ended, infos."""
        observations, rewards, terminated, truncated, info = self.envs.step(self._actions)
        observations = self._as_seen(observations)
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
            self._begin(ended)
            observations = self._as_seen(self.envs.reset(options={"reset_mask": ended})[0])
        return observations, rewards, ended, infos

    def _begin(self, rows: np.ndarray) -> None:
        self._returns[rows], self._lengths[rows] = 0.0, 0
        if self._turned:
            self._turns[rows] = turns(self._rng, int(rows.sum()))

    def _as_seen(self, observations: np.ndarray) -> np.ndarray:
        if not self._turned:
            return observations
        seen = observations.copy()
        features = seen[:, : -len(GLOBAL)].reshape(self.num_envs, -1, self.envs.game.boards.slots)
        for first in (X, HEADING):
            features[:, first : first + 2] = self._turns @ features[:, first : first + 2]
        return seen

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


def turns(rng: np.random.Generator, n: int) -> Float32[np.ndarray, "n 2 2"]:
    """Turns of the plane by random multiples of 90°, half of them mirrored."""
    cosine, sine = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[rng.integers(0, 4, n)].T
    side = rng.choice([-1, 1], n)
    return np.array([[cosine, -sine * side], [sine, cosine * side]], np.float32).transpose(2, 0, 1)


def side_by_side(game: Game, n: int) -> Game:
    """n episodes of a game with its scenes."""
    if isinstance(game, SelectGame):
        return SelectGame(n, game.scenes, game.actions)
    if isinstance(game, SubsetGame):
        return SubsetGame(n, game.scenes)
    assert isinstance(game, PoseGame)
    return PoseGame(n, game.scenes, int(game.boards.most_turns[0]))
