"""`coview/SensorSelect-v0`: place one sensor after another, or stop."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Discrete, MultiDiscrete, Space

from placement_env.envs.env import GameEnv, observation_space
from placement_env.envs.scenario import Scene, Scenes, Start
from placement_env.envs.state import Boards
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.detection.scheme import Scheme

Actions = Literal["flat", "factored"]


class SelectGame:
    """n episodes of choosing one candidate after another."""

    def __init__(self, n: int, scenes: Scenes, actions: Actions = "flat") -> None:
        if actions not in ("flat", "factored"):
            raise ValueError(f"actions must be flat or factored, got {actions!r}")
        self.scenes, self.boards, self.actions = scenes, Boards(n, scenes.slots), actions
        self.factors = (scenes.shape[0] + 1, *scenes.shape[1:])
        self.action_space: Space[Any] = (
            Discrete(scenes.slots + 1) if actions == "flat" else MultiDiscrete(list(self.factors))
        )
        self.observation_space = observation_space(scenes.slots)
        self._allowed = np.zeros((n, scenes.slots), np.bool_)
        self._one_hot: dict[Scene, np.ndarray] = {}

    def begin(self, rows: Int64[np.ndarray, " m"], starts: list[Start]) -> None:
        """New episodes on some rows, with nothing chosen."""
        for shape in {start.scene.objective.candidates.shape for start in starts if self.actions == "factored"}:
            if any(size > known for size, known in zip(shape, self.scenes.shape, strict=True)):
                raise ValueError(
                    f"factored actions are for {self.scenes.shape} mounts, heights, headings, tilts and models, this "
                    f"site has {shape}: make the environment with all its sites"
                )
        self.boards.begin(rows, starts)
        self._allowed = self.boards.allowed()

    def play(
        self, playing: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """One candidate more on each row that plays, or none for the last action, which ends the episode."""
        slot, stops = self._slots(actions)
        rows = np.arange(self.boards.n)
        places = playing & ~stops & (slot >= 0) & self._allowed[rows, slot]
        self.boards.illegal = playing & ~stops & ~places
        chosen = self.boards.chosen.copy()
        chosen[rows[places], slot[places]] = True
        self.boards.turn(playing, chosen)
        self._allowed = self.boards.allowed()
        terminated = playing & (stops | ~self._allowed.any(axis=1))
        truncated = playing & ~terminated & (self.boards.turns >= self.boards.most_turns)
        return self.boards.gain, terminated, truncated

    def look(self) -> tuple[Float32[np.ndarray, "n size"], dict[str, Any]]:
        """Observations and info."""
        info = {**self.boards.info(), "action_mask": self.masks().astype(np.int8)}
        return self.boards.observations(self._allowed), info

    def masks(self) -> Bool[np.ndarray, "n choices"]:
        """Which actions are legal; of factored ones, which values of each factor some legal candidate has."""
        if self.actions == "flat":
            return np.concatenate([self._allowed, np.ones((self.boards.n, 1), np.bool_)], axis=1)
        masks = np.zeros((self.boards.n, sum(self.factors)), np.bool_)
        for scene, rows in self.boards.by_scene():
            masks[rows] = self._allowed[rows].astype(np.float32) @ self._factors_of(scene) > 0
        first = np.cumsum([0, *self.factors[:-1]])
        masks[:, first[1] - 1] = True
        masks[:, first[1:]] |= ~self._allowed.any(axis=1, keepdims=True)  # a factor needs a value, to stop too
        return masks

    def _slots(self, actions: np.ndarray) -> tuple[Int64[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Which candidate each action means, -1 for none there is, and which actions stop."""
        if self.actions == "flat":
            slot = actions.astype(np.int64).reshape(-1)
            if ((slot < 0) | (slot > self.boards.slots)).any():
                raise ValueError(f"actions are 0 to {self.boards.slots} (stop), got {slot.tolist()}")
            stops = slot == self.boards.slots
            return np.where(stops, -1, slot), stops
        factors = actions.astype(np.int64).reshape(-1, len(self.factors))
        slot = np.full(len(factors), -1)
        for scene, rows in self.boards.by_scene():
            slot[rows] = scene.objective.candidates.at(*factors[rows].T)
        stops = factors[:, 0] == self.factors[0] - 1
        return np.where(stops, -1, slot), stops

    def _factors_of(self, scene: Scene) -> Float32[np.ndarray, "slots choices"]:
        if scene not in self._one_hot:
            factors = scene.objective.candidates.factors
            values = [np.arange(size) == factors[:, axis, None] for axis, size in enumerate(self.factors)]
            one_hot = np.zeros((scene.slots, sum(self.factors)), np.float32)
            one_hot[: len(factors)] = np.concatenate(values, axis=1)
            self._one_hot[scene] = one_hot
        return self._one_hot[scene]


class SensorSelectEnv(GameEnv):
    """Place one sensor after another at a junction, or stop.

    ## Action Space
    `Discrete(slots + 1)`: the candidate to place; the last action stops. With `actions="factored"`, for large pools,
    `MultiDiscrete([mounts + 1, heights, headings, tilts, models])`: the factors of the candidate; the last mount stops.

    An illegal action, a candidate that is chosen already or out of order, on a mount that is taken, whose link cannot
    carry what it sends, or that there is not, changes nothing: the reward is 0, `info["illegal"]` is True, and a turn
    is used up. `info["action_mask"]` and `action_masks()` say what is legal; of factored actions, which values of each
    factor some legal candidate has, one factor after another, so a combination of them may still be illegal.

    ## Observation Space
    `Box(-1, 1, (14 · slots + 13,), float32)`. 14 features of every slot, each for all slots before the next: x, y, z,
    cosine and sine of heading, tilt, field of view, lidar or camera, price, kbit, what it sees alone, what it would add
    to what the chosen ones see, whether chosen, whether allowed (`placement_env.envs.scenario.STATIC`,
    `placement_env.envs.state.DYNAMIC`), all relative to the area, so that a policy may go from site to site; then 13 of
    the whole (`placement_env.envs.state.GLOBAL`): budget and turns left, AP, recall, kbit, price, share seen, weights,
    scheme.

    ## Rewards
    What the placed sensor adds to the objective's reward, AP − λ_comm · kbit per sensor − λ_price · price. The rewards
    of an episode add up to that of its set.

    ## Starting State
    No sensors. With several sites, one is drawn.

    ## Episode End
    Terminates when the agent stops, the budget is used up, or nothing more may be placed. Truncated after two turns for
    each sensor of the budget.

    ## Info
    `ap`, `recall`, `kbit` (of the set), `kbit_per_sensor`, `price`, `subset` (boolean, of the slots), `marginal_gain`,
    `reward_terms`, `fidelity`, `cache_hit` (the set was scored in this episode already), `illegal`, `action_mask`.

    ## Arguments
    site: a site, its name, or several of these, of which each episode draws one; budget: sensors to place; actions:
    flat or factored; slots: for candidates, None for what the largest of the sites needs; objective: in place of a site
    and all that follows; scheme, and by name fidelity, frames, weights, candidates, detector, iou, seed, cache,
    workers: of `placement_env.objective.Objective`. `reset` takes the options site, scheme, budget and failed.

    ## Version History
    v0: first version.
    """

    def __init__(
        self,
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
        super().__init__(SelectGame(1, scenes, actions), render_mode)
