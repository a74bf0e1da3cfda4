"""`coview/SensorSubset-v0`: say at once which sensors to build."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import MultiBinary, Space

from placement_env.envs.env import GameEnv, observation_space
from placement_env.envs.scenario import Scenes, Start
from placement_env.envs.state import Boards
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.detection.scheme import Scheme


class SubsetGame:
    """n episodes of one choice each."""

    def __init__(self, n: int, scenes: Scenes) -> None:
        self.scenes, self.boards = scenes, Boards(n, scenes.slots)
        self.action_space: Space[Any] = MultiBinary(scenes.slots)
        self.observation_space = observation_space(scenes.slots)

    def begin(self, rows: Int64[np.ndarray, " m"], starts: list[Start]) -> None:
        """New episodes on some rows."""
        self.boards.begin(rows, starts)

    def play(
        self, playing: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """The set of each row that plays; a set that may not be built is left empty."""
        chosen = np.asarray(actions.reshape(self.boards.chosen.shape) != 0)
        legal = self.boards.fitting(chosen)
        self.boards.illegal = playing & ~legal
        self.boards.turn(playing, chosen & legal[:, None])
        return self.boards.gain, playing.copy(), np.zeros(self.boards.n, np.bool_)

    def look(self) -> tuple[Float32[np.ndarray, "n size"], dict[str, Any]]:
        """Observations and info."""
        allowed = self.boards.allowed()
        mask = allowed | self.boards.chosen
        return self.boards.observations(allowed), {**self.boards.info(), "action_mask": mask.astype(np.int8)}

    def masks(self) -> Bool[np.ndarray, "n choices"]:
        """For each slot whether it may be left out, which is always so, and whether it may be chosen."""
        may = self.boards.allowed() | self.boards.chosen
        return np.stack([np.ones_like(may), may], axis=2).reshape(self.boards.n, -1)


class SensorSubsetEnv(GameEnv):
    """Say in one action which sensors to build at a junction.

    ## Action Space
    `MultiBinary(slots)`: which candidates to build.

    A set that may not be built (more sensors than the budget, two on a mount, one that is out of order, a link that
    cannot carry what its sensor sends, a slot without a candidate) is an illegal action: nothing is built, the reward
    is 0, `info["illegal"]` is True. `info["action_mask"]` says which candidates may be in a set by themselves;
    `action_masks()` gives for each slot whether it may be 0 and whether it may be 1.

    ## Observation Space
    `Box(-1, 1, (14 · slots + 13,), float32)`, as of `coview/SensorSelect-v0`.

    ## Rewards
    The objective's reward of the set, AP − λ_comm · kbit per sensor − λ_price · price.

    ## Starting State
    No sensors. With several sites, one is drawn.

    ## Episode End
    Terminates after one action.

    ## Info
    As of `coview/SensorSelect-v0`.

    ## Arguments
    As of `coview/SensorSelect-v0`, but for `actions`.

    ## Version History
    v0: first version.
    """

    def __init__(
        self,
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
        super().__init__(SubsetGame(1, scenes), render_mode)
