"""`coview/SensorMap-v0`: place one sensor after another by the map alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete

from placement_env.candidates.outlook.outlook import Outlook, outlook
from placement_env.checks import check_range, check_whole
from placement_env.envs.env import RENDER_MODES, check_render_mode
from placement_env.envs.maps.junctions import JUNCTION_FRAMES, JUNCTION_PLACES, POSES, Junction, prepare
from placement_env.envs.maps.map_observation import Observation, map_space, observed, rasters
from placement_env.envs.maps.terms import Terms, drawn_terms
from placement_env.envs.rendering import bird_view, summary
from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective
from toolkit.arrays import Bool

KEPT_JUNCTIONS = 8  # junctions in memory
OPTIONS_OF_MAP = ("seed", "terms")


@dataclass(frozen=True, kw_only=True, eq=False)
class MapConfig:
    """What `coview/SensorMap-v0` is made with.

    seeds: of the random junctions, of which each episode draws one; folder: where they are kept once they are prepared,
    which takes seconds each; frames, places, poses: of `placement_env.envs.maps.junctions.prepare`; budget, failures:
    sensors to place and candidates that have failed, or (lowest, highest) to draw from; scheme, iou: by which the
    surrogate of the general network scores. Raises ValueError for a setting that does not fit.
    """

    seeds: Sequence[int] = tuple(range(8))
    folder: str | Path = "out/junctions"
    frames: int = JUNCTION_FRAMES
    places: int = JUNCTION_PLACES
    poses: int = POSES
    budget: int | Sequence[int] = (2, 6)
    failures: int | Sequence[int] = (0, 8)
    scheme: str = "early"
    iou: float = 0.7

    def __post_init__(self) -> None:
        if not len(self.seeds):
            raise ValueError("seeds must be one or several, got none")
        for seed in self.seeds:
            check_whole("seed", seed, least=0)
        for name in ("frames", "places", "poses"):
            check_whole(name, getattr(self, name), least=1)
        check_range("budget", self.budget, least=1, unit="sensor")
        check_range("failures", self.failures, least=0, unit="candidates")

    @property
    def slots(self) -> int:
        """Candidates of a junction at most."""
        return self.places * self.poses


class SensorMapEnv(gym.Env[Any, Any]):
    """Place one sensor after another at a junction of which the map alone is known, or stop.

    ## Action Space
    `Discrete(slots + 1)`: the candidate to place; the last action stops. An action that may not be taken, a candidate
    that is chosen already or has failed, on a mount that is taken, that costs more than is left, or an empty slot,
    changes nothing: the reward is 0, `info["illegal"]` is True, and a step is used up. `info["action_mask"]` and
    `action_masks()` say what is legal as far as that is known without looking: whether a link carries what a sensor
    sends is not. Where it does not, nothing is placed, `info["refused"]` is True, and the candidate has failed from
    then on.

    ## Observation Space
    `Dict` of "map", "view", "candidates" and "whole" (`placement_env.envs.maps.map_observation`), all in -1..1.

    ## Rewards
    What the placed sensor adds to the objective's reward, AP − λ_comm · kbit per sensor − λ_price · price, by the
    surrogate. The rewards of an episode add up to that of its set.

    ## Starting State
    No sensors. Junction, budget, money, prices, links, weights and failed candidates are drawn
    (`placement_env.envs.maps.terms.drawn_terms`).

    ## Episode End
    Terminates when the agent stops, the budget is used up, or nothing more may be placed. Truncated after two steps for
    each sensor of the budget.

    ## Info
    `seed` (of the junction), `ap`, `kbit_per_sensor`, `price`, `reward` (of the set), `subset` (boolean, of the slots),
    `illegal`, `refused`, `action_mask`.

    ## Arguments
    config: a `MapConfig`; or its settings by name. `reset` takes the options seed, of one of the junctions, and terms,
    a `placement_env.envs.maps.terms.Terms` of its candidates.

    ## Version History
    v0: first version.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": 2}  # type: ignore[misc]

    def __init__(self, config: MapConfig | None = None, *, render_mode: str | None = None, **settings: Any) -> None:
        self.config = config or MapConfig(**settings)
        self.render_mode, slots = check_render_mode(render_mode), self.config.slots
        self.observation_space, self.action_space = map_space(slots), Discrete(slots + 1)
        self._place = lru_cache(KEPT_JUNCTIONS)(self._made)
        self.objective: Objective | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode. Raises ValueError for an option that there is not or does not fit."""
        super().reset(seed=seed)
        options = options or {}
        if unknown := set(options) - set(OPTIONS_OF_MAP):
            raise ValueError(f"options are {', '.join(OPTIONS_OF_MAP)}, got {', '.join(map(repr, sorted(unknown)))}")
        drawn = self.config.seeds[int(self.np_random.integers(len(self.config.seeds)))]
        self.junction_seed = int(options.get("seed", drawn))
        if self.junction_seed not in self.config.seeds:
            raise ValueError(f"seed must be one of the environment's junctions, got {self.junction_seed}")
        junction, self.outlook, self._fixed, scored_by = self._place(self.junction_seed)
        terms = options.get("terms") or drawn_terms(
            junction.candidates, self.np_random, budget=self.config.budget, failures=self.config.failures
        )
        if len(terms.candidates) != len(junction.candidates):
            raise ValueError(f"terms are of {len(terms.candidates)} candidates, {len(junction.candidates)} are here")
        self.terms: Terms = terms
        self.objective = Objective.of(
            terms.candidates, scored_by, self.config.scheme, terms.weights, site=junction.site,
            visibility=junction.visibility, most_price=terms.most_price,
        )  # fmt: skip
        self.chosen: list[int] = []
        self._steps, self._reward, self._refused = 0, 0.0, np.zeros(len(junction.candidates), np.bool_)
        return self._observed(), self._info(illegal=False, refused=False)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Place a candidate, or stop. Raises ValueError for no action, ResetNeeded before the first `reset`."""
        objective = self._ready()
        if not self.action_space.contains(np.int64(action)):
            raise ValueError(f"actions are 0 to {self.config.slots} (stop), got {action!r}")
        slot, before = int(action), self._reward
        stops = slot == self.config.slots
        illegal = not stops and not self.action_masks()[slot]
        refused = not stops and not illegal and not bool(objective.allowed(self.chosen)[slot])
        self._steps += 1
        if refused:
            self._refused[slot] = True
        elif not (stops or illegal):
            self.chosen.append(slot)
            self._reward = objective.score(self.chosen).reward
        terminated = stops or not self.action_masks()[:-1].any()
        truncated = not terminated and self._steps >= 2 * self.terms.budget
        return (
            self._observed(),
            self._reward - before,
            terminated,
            truncated,
            self._info(illegal=illegal, refused=refused),
        )

    def action_masks(self) -> Bool[np.ndarray, " choices"]:
        """Which actions are legal as far as is known without looking."""
        self._ready()
        masks = np.zeros(self.config.slots + 1, np.bool_)
        masks[-1] = True
        if len(self.chosen) < self.terms.budget:
            masks[: len(self._refused)] = self.terms.allowed(self.chosen) & ~self._refused
        return masks

    def placed(self) -> tuple[Objective, list[int]]:
        """The objective of the episode and the candidates that are chosen."""
        return self._ready(), sorted(self.chosen)

    def render(self) -> Any:
        """The area from above with the chosen sensors and what they see (uint8), or a few lines of text."""
        if self.render_mode is None:
            return None
        return (bird_view if self.render_mode == "rgb_array" else summary)(*self.placed())

    def _ready(self) -> Objective:
        if self.objective is None:
            raise ResetNeeded("no episode has started: call reset() first")
        return self.objective

    def _made(self, seed: int) -> tuple[Junction, Outlook, tuple[np.ndarray, np.ndarray], Surrogate]:
        config = self.config
        junction = prepare(seed, config.folder, frames=config.frames, places=config.places, poses=config.poses)
        known = outlook(junction.site, junction.candidates)
        scored_by = Surrogate(junction.visibility, config.scheme, iou=config.iou, radius=junction.site.hybrid_radius)
        return junction, known, rasters(known, config.slots), scored_by

    def _observed(self) -> Observation:
        left = 1 - self._steps / (2 * self.terms.budget)
        observation = observed(self._fixed, self.outlook, self.terms, self.chosen, steps_left=left)
        observation["candidates"][: len(self._refused), -1] *= ~self._refused
        return observation

    def _info(self, *, illegal: bool, refused: bool) -> dict[str, Any]:
        score = self._ready().score(self.chosen)
        subset = np.zeros(self.config.slots, np.bool_)
        subset[self.chosen] = True
        mask = self.action_masks().astype(np.int8)
        return {
            "seed": self.junction_seed, "ap": score.ap, "kbit_per_sensor": score.kbit_per_sensor, "price": score.price,
            "reward": score.reward, "subset": subset, "illegal": illegal, "refused": refused, "action_mask": mask,
        }  # fmt: skip
