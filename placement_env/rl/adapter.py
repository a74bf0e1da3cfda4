"""Adapter that lets Stable-Baselines3 train on the native vector environments.

    vector = gym.make_vec("coview/SensorSelect-v0", num_envs=64)
    MaskablePPO("MlpPolicy", as_sb3(vector)).learn(10_000)

All other environments are stepped one by one.
"""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from placement_env.envs.env import AnyEnv, PlacementEnv, PlacementVectorEnv
from placement_env.envs.pose import SensorPoseEnv
from placement_env.envs.scenario import STATIC
from placement_env.envs.select import SensorSelectEnv, SensorSubsetEnv
from placement_env.envs.state import GLOBAL, Info
from toolkit.arrays import Float32, Rng

X_FEATURE = STATIC.index("x")  # y comes next
HEADING_FEATURE = STATIC.index("cos heading")  # sine comes next


def as_sb3(vector: gym.vector.VectorEnv[Any, Any, Any], *, augment: bool = False) -> "SB3VecEnv":
    """Adapt a vector environment of `gymnasium.make_vec("coview/...")` for Stable-Baselines3.

    augment: agents see each junction rotated and mirrored at random. Raises ValueError for any
    other vector environment.
    """
    native = vector.unwrapped
    if not isinstance(native, PlacementVectorEnv):
        raise ValueError(
            f"as_sb3 takes coview's native vector environments, got {vector}: take DummyVecEnv "
            "for others"
        )
    return SB3VecEnv(native, augment=augment)


def vectorize(
    first: AnyEnv, make_env: Callable[[], AnyEnv], n: int, *, augment: bool = False
) -> VecEnv:
    """Vector environment that steps n episodes of an environment and others like it together.

    Coview's environments share their scenarios and are stepped as one; all others are stepped one
    by one.

    Args:
        first: First environment, which decides on the kind.
        make_env: Function that makes the others.
        n: Number of environments.
        augment: True to rotate and mirror junctions at random (`SB3VecEnv`).

    Raises ValueError for `augment` with any other environment than coview's.
    """
    # one of ours itself: a wrapper or subclass may have other rules
    is_native = type(first) in (SensorSelectEnv, SensorSubsetEnv, SensorPoseEnv)
    if is_native and isinstance(first, PlacementEnv):
        return SB3VecEnv(PlacementVectorEnv(n, first.task), augment=augment)
    if augment:
        raise ValueError(
            f"only junctions of our own environments can be augmented, got {first}: leave augment "
            "out"
        )
    # DummyVecEnv takes functions; each call of the second one makes a new environment
    other_makers = [lambda: Monitor(make_env())] * (n - 1)
    return DummyVecEnv([lambda: Monitor(first), *other_makers])


class SB3VecEnv(VecEnv):
    """Native vector environment for Stable-Baselines3; ended episodes restart within the step.

    Infos are empty until an episode ends; then they hold its return `r` and length `l` (`episode`),
    its final set (`subset`), `TimeLimit.truncated` and `terminal_observation`. augment: agents see
    each episode's junction rotated by a multiple of 90° and mirrored at random.
    """

    def __init__(self, vector: PlacementVectorEnv, *, augment: bool = False) -> None:
        """Adapt a vector environment.

        augment: whether agents see each episode's junction rotated and mirrored at random."""
        self.vector = vector
        self._augment = augment
        super().__init__(
            vector.num_envs, vector.single_observation_space, vector.single_action_space
        )
        self._returns = np.zeros(self.num_envs)  # sum of the rewards of each running episode
        self._lengths = np.zeros(self.num_envs, np.int64)  # steps of each running episode
        # matrix that turns and mirrors the plane in each episode; used with `augment` only
        self._rotations = np.zeros((self.num_envs, 2, 2), np.float32)

    def reset(self) -> np.ndarray:
        """Start all episodes and return their observations, one row each.

        Seeds are from `seed`, options from `set_options`; both are used up. The first seed also
        seeds the rotations of `augment`."""
        seeds = list(self._seeds)
        options = list(self._options)
        self._rng = np.random.default_rng(seeds[0])
        observations, _ = self.vector.reset(seed=seeds, options=options[0])
        # one reset takes one set of options: rows with others are reset once more; the other rows
        # of the observations stay as they are
        for row in range(self.num_envs):
            if options[row] == options[0]:
                continue
            mask = np.arange(self.num_envs) == row
            row_seeds = [seed if mask[i] else None for i, seed in enumerate(seeds)]
            observations, _ = self.vector.reset(
                seed=row_seeds, options={**options[row], "reset_mask": mask}
            )
        self._reset_seeds()
        self._reset_options()
        self._begin_episodes(np.ones(self.num_envs, np.bool_))
        return self._rotate(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions until `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Info]]:
        """Take the kept actions; return observations, rewards, ends and infos, a row per episode.

        The observation of an ended episode is the first of the next one; its last is in the info.
        """
        observations, rewards, terminated, truncated, info = self.vector.step(self._actions)
        observations = self._rotate(observations)
        self._returns += rewards
        self._lengths += 1
        ended = terminated | truncated
        infos: list[Info] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(ended).tolist():
            infos[row] = {
                # return and length of the episode, as `Monitor` names them
                "episode": {"r": float(self._returns[row]), "l": int(self._lengths[row])},
                "subset": info["subset"][row],
                "TimeLimit.truncated": bool(truncated[row]),
                "terminal_observation": observations[row],
            }
        if ended.any():
            self._begin_episodes(ended)
            first_observations, _ = self.vector.reset(options={"reset_mask": ended})
            observations = self._rotate(first_observations)  # running episodes keep theirs
        return observations, rewards, ended, infos

    def _begin_episodes(self, is_new: np.ndarray) -> None:
        """Reset the sums of episodes that begin, and draw their rotations if junctions are rotated.

        is_new: True for the episodes that begin."""
        self._returns[is_new] = 0.0
        self._lengths[is_new] = 0
        if self._augment:
            self._rotations[is_new] = rotations(self._rng, int(is_new.sum()))

    def _rotate(self, observations: np.ndarray) -> np.ndarray:
        """Copy of observations (episodes, values), with each junction rotated by its row's angle.

        Without `augment` the observations themselves come back."""
        if not self._augment:
            return observations
        rotated = observations.copy()
        slots = self.vector.task.state.slots
        # a view of `rotated` with the axes episode, feature, slot
        features = rotated[:, : -len(GLOBAL)].reshape(self.num_envs, -1, slots)
        # pairs of features that rotate: x and y, then cosine and sine of the heading
        for first in (X_FEATURE, HEADING_FEATURE):
            features[:, first : first + 2] = self._rotations @ features[:, first : first + 2]
        return rotated

    def close(self) -> None:
        """Close the vector environment."""
        self.vector.close()

    def get_images(self) -> tuple[Any, ...]:
        """Picture of each episode, None without a render mode."""
        return self.vector.render() or (None,) * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Attribute of the vector environment, for each requested episode."""
        return [getattr(self.vector, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector environment, which all episodes share."""
        setattr(self.vector, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: object,
        indices: VecEnvIndices = None,
        **method_kwargs: object,
    ) -> list[Any]:
        """Result of a method such as `action_masks`, for each requested episode."""
        answers = getattr(self.vector, method_name)(*method_args, **method_kwargs)
        return [answers[index] for index in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """True only for `Monitor`, whose infos these are."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]


def rotations(rng: Rng, n: int) -> Float32[np.ndarray, "n 2 2"]:
    """Draw n rotations of the plane by multiples of 90°, about half of them mirrored.

    They are matrices that multiply column vectors (x, y)."""
    quarter_turns = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])  # cosine and sine of each
    cosine, sine = quarter_turns[rng.integers(0, 4, n)].T
    side = rng.choice([-1, 1], n)  # -1 mirrors y before the rotation
    matrices = np.array([[cosine, -sine * side], [sine, cosine * side]], np.float32)
    return matrices.transpose(2, 0, 1)  # from (2, 2, n)
