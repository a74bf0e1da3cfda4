"""Games: n episodes side by side under one set of rules, and the Gymnasium environment of one of them."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Space

from placement_env.envs.rendering import bird_view, summary
from placement_env.envs.scenario import STATIC
from placement_env.envs.state import DYNAMIC, GLOBAL, Boards
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped

RENDER_MODES = ["rgb_array", "ansi"]


@runtime_checkable
class Game(Protocol):
    """n episodes by one set of rules."""

    scenes: Any  # with start(rng, options)
    boards: Boards
    observation_space: Box
    action_space: Space[Any]

    def begin(self, rows: Int64[np.ndarray, " m"], starts: list[Any]) -> None:
        """New episodes on some rows."""

    def play(
        self, playing: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """One action on each row that plays: rewards, terminated, truncated."""

    def look(self) -> tuple[Float32[np.ndarray, "n size"], dict[str, Any]]:
        """Observations and info, an array (n, ...) each."""

    def masks(self) -> Bool[np.ndarray, "n choices"]:
        """Which actions are legal."""


class GameEnv(gym.Env[np.ndarray, Any]):
    """One episode after another of a game with one row; the registered environments differ by their game."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": 2}  # type: ignore[misc]

    def __init__(self, game: Game, render_mode: str | None) -> None:
        if render_mode not in (None, *RENDER_MODES):
            raise ValueError(f"render_mode must be None or one of {', '.join(RENDER_MODES)}, got {render_mode!r}")
        self.game, self.render_mode = game, render_mode
        self.observation_space, self.action_space = game.observation_space, game.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; options: site, scheme, budget, failed (candidates out of order, by index or name), which
        hold for this episode. Raises ValueError where one does not fit."""
        super().reset(seed=seed)
        self.game.begin(np.zeros(1, np.int64), [self.game.scenes.start(self.np_random, options)])
        observations, info = self.game.look()
        return observations[0], alone(info)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take an action. Raises ValueError for what is none."""
        reward, terminated, truncated = self.game.play(np.ones(1, np.bool_), as_actions(self.game, action))
        observations, info = self.game.look()
        return observations[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), alone(info)

    def action_masks(self) -> Bool[np.ndarray, " choices"]:
        """Which actions are legal, as sb3-contrib's MaskablePPO asks for them."""
        return self.game.masks()[0]

    def render(self) -> Any:
        """The area from above with the chosen sensors and what they see (uint8), or a few lines of text."""
        if self.render_mode is None:
            return None
        return picture(self.game, 0, self.render_mode)


def as_actions(game: Game, actions: Any) -> Shaped[np.ndarray, "n ..."]:
    """An action for each of n games, or ValueError where there are fewer or more figures, or one is not finite."""
    array, shape = np.asarray(actions), (game.boards.n, *(game.action_space.shape or ()))
    if array.size != math.prod(shape) or array.dtype.kind not in "biuf":
        raise ValueError(f"actions must be numbers of shape {shape}, got {array.dtype} {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"actions must be finite, got {array.tolist()}")
    return array.reshape(shape)


def picture(game: Game, row: int, mode: str) -> Any:
    """A row of a game as an image or as text."""
    objective, members = game.boards.placed(row)
    return bird_view(objective, members) if mode == "rgb_array" else summary(objective, members)


def alone(info: dict[str, Any]) -> dict[str, Any]:
    """The info of the first of n games, with Python's own numbers."""
    return {key: _alone(value) for key, value in info.items()}


def _alone(value: Any) -> Any:
    if isinstance(value, dict):
        return alone(value)
    return value.item(0) if value.ndim == 1 else value[0]


def observation_space(slots: int) -> Box:
    """Of games that choose among candidates: features of each slot, feature after feature, then of the whole."""
    size = (len(STATIC) + len(DYNAMIC)) * slots + len(GLOBAL)
    return Box(-1.0, 1.0, (size,), np.float32)
