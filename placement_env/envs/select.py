"""`coview/SensorSelect-v0`: place one sensor after another, or stop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Discrete, MultiDiscrete

from placement_env.envs.config import SelectConfig, build_config
from placement_env.envs.env import ActionSpace, PlacementEnv, PlacementVectorEnv, observation_space
from placement_env.envs.scenario import Options, Scenario, Scenarios
from placement_env.envs.state import Info, State
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped


class SelectTask:
    """n episodes of choosing one candidate after another."""

    def __init__(self, n: int, scenarios: Scenarios) -> None:
        config, slots = scenarios.config, scenarios.slots
        assert isinstance(config, SelectConfig)
        self.scenarios, self.state, self.flat = scenarios, State(n, slots), config.actions == "flat"
        self.factors = (scenarios.shape[0] + 1, *scenarios.shape[1:])
        self.action_space: ActionSpace = Discrete(slots + 1) if self.flat else MultiDiscrete(list(self.factors))
        self.observation_space = observation_space(slots)
        self._rows, self._always = np.arange(n), np.ones((n, 1), np.bool_)
        self._one_hot: dict[Scenario, np.ndarray] = {}

    def resize(self, n: int) -> SelectTask:
        """Return the same rules, at the same scenarios, for n episodes."""
        return SelectTask(n, self.scenarios)

    def reset(
        self, rows: Int64[np.ndarray, " m"], rngs: Sequence[np.random.Generator], options: Options | None
    ) -> None:
        """Start new episodes in some rows, with no sensors."""
        episodes = [self.scenarios.draw(rng, options) for rng in rngs]
        for shape in {each.scenario.objective.candidates.shape for each in episodes if not self.flat}:
            if any(size > known for size, known in zip(shape, self.scenarios.shape, strict=True)):
                raise ValueError(
                    f"factored actions are for {self.scenarios.shape} mounts, heights, headings, tilts and models, "
                    f"this site has {shape}: make the environment with all its sites"
                )
        self.state.reset(rows, episodes)

    def step(
        self, active: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Add a candidate in each active row. The last action adds none and ends the episode."""
        slot, stops = self._slots(actions)
        state, acting = self.state, active & ~stops
        places = acting & (slot >= 0) & state.allowed[self._rows, slot]
        chosen = state.chosen.copy()
        chosen[self._rows[places], slot[places]] = True
        state.place(active, chosen, acting & ~places)
        terminated = active & (stops | ~state.allowed.any(axis=1))
        return state.gain, terminated, active & ~terminated & (state.steps >= state.max_steps)

    def observe(self) -> tuple[Float32[np.ndarray, "n size"], Info]:
        """Return observations and info."""
        info = self.state.info()
        info["action_mask"] = self.action_masks().astype(np.int8)
        return self.state.observe(), info

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Tell which actions are legal. Of factored ones, tell which values of each factor some legal candidate has."""
        allowed = self.state.allowed
        if self.flat:
            return np.concatenate([allowed, self._always], axis=1)
        masks = np.zeros((len(allowed), sum(self.factors)), np.bool_)
        for scenario, rows in self.state.by_scenario():
            masks[rows] = allowed[rows].astype(np.float32) @ self._one_hot_factors(scenario) > 0
        first = np.cumsum([0, *self.factors[:-1]])
        masks[:, first[1] - 1] = True
        masks[:, first[1:]] |= ~allowed.any(axis=1, keepdims=True)  # a factor needs a value, to stop too
        return masks

    def _slots(self, actions: np.ndarray) -> tuple[Int64[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Candidate of each action (-1: none), and True for stops."""
        if self.flat:
            slot, last = actions.astype(np.int64).reshape(-1), self.scenarios.slots
            if ((slot < 0) | (slot > last)).any():
                raise ValueError(f"actions are 0 to {last} (stop), got {slot.tolist()}")
            stops = slot == last
            return np.where(stops, -1, slot), stops
        factors = actions.astype(np.int64).reshape(-1, len(self.factors))
        slot = np.full(len(factors), -1)
        for scenario, rows in self.state.by_scenario():
            slot[rows] = scenario.objective.candidates.at(*factors[rows].T)
        stops = factors[:, 0] == self.factors[0] - 1
        return np.where(stops, -1, slot), stops

    def _one_hot_factors(self, scenario: Scenario) -> Float32[np.ndarray, "slots choices"]:
        if scenario not in self._one_hot:
            factors = scenario.objective.candidates.factors
            values = [np.arange(size) == factors[:, axis, None] for axis, size in enumerate(self.factors)]
            one_hot = np.zeros((scenario.slots, sum(self.factors)), np.float32)
            one_hot[: len(factors)] = np.concatenate(values, axis=1)
            self._one_hot[scenario] = one_hot
        return self._one_hot[scenario]


class SensorSelectEnv(PlacementEnv):
    """Place one sensor after another at a junction, or stop.

    ## Action Space
    `Discrete(slots + 1)`: the candidate to place; the last action stops. With `actions="factored"`, for large pools,
    `MultiDiscrete([mounts + 1, heights, headings, tilts, models])`: the factors of the candidate; the last mount stops.

    An illegal action changes nothing: the reward is 0, `info["illegal"]` is True, and a step is used up. Illegal are an
    empty slot and a candidate that is chosen already, has failed, is on a full mount, or sends more than its link
    carries. `info["action_mask"]` and `action_masks()` tell the legal actions; of factored actions, the values of each
    factor that some legal candidate has, one factor after another, so a combination of them may still be illegal.

    ## Observation Space
    `Box(-1, 1, (14 · slots + 13,), float32)`. 14 features of every slot, each for all slots before the next: x, y, z,
    cosine and sine of heading, tilt, field of view, lidar or camera, price, kbit, share of places seen, share it would
    add to the chosen ones', chosen, allowed (`placement_env.envs.scenario.STATIC`,
    `placement_env.envs.state.DYNAMIC`), all relative to the area, so that a policy may go from site to site; then 13 of
    the whole (`placement_env.envs.state.GLOBAL`): budget and steps left, AP, recall, kbit, price, share seen, weights,
    scheme.

    ## Rewards
    Increase of the objective's reward, AP − λ_comm · kbit per sensor − λ_price · price. The rewards of an episode add
    up to that of its set.

    ## Starting State
    No sensors. Everything that the config leaves open (site, scheme, budget, failed candidates) is drawn.

    ## Episode End
    Terminates when the agent stops, the budget is used up, or nothing more may be placed. Truncated after two steps for
    each sensor of the budget.

    ## Info
    `ap`, `recall`, `kbit` (of the set), `kbit_per_sensor`, `price`, `subset` (boolean, of the slots), `marginal_gain`,
    `reward_terms`, `fidelity`, `cache_hit` (the set was scored in this episode already), `illegal`, `action_mask`; with
    several classes also `class_ap`, the AP of each by its name.

    ## Arguments
    config: a `placement_env.envs.config.SelectConfig`; or its fields by name. site, scheme: one or several; budget:
    sensors to place; failures: candidates that have failed. Each episode draws one of several, and a number from a
    budget or failures given as (lowest, highest). actions: flat or factored; slots: for candidates, None for as many as
    the largest of the sites needs; objective: in place of a site and all that follows; the fields of
    `placement_env.setting.Setting` (fidelity, weights, candidates, classes, ...) and of `toolkit.runtime.run.Run`
    (frames, seed, cache, workers, ray), and iou. `reset` takes the options site, scheme, budget and failed.

    ## Version History
    v0: first version.
    """

    def __init__(self, config: SelectConfig | None = None, *, render_mode: str | None = None, **given: object) -> None:
        super().__init__(SelectTask(1, Scenarios(build_config(SelectConfig, config, given))), render_mode)


class SensorSelectVectorEnv(PlacementVectorEnv):
    """n of `SensorSelectEnv`, which describes the arguments."""

    def __init__(
        self,
        num_envs: int = 1,
        config: SelectConfig | None = None,
        *,
        render_mode: str | None = None,
        **given: object,
    ) -> None:
        super().__init__(SelectTask(num_envs, Scenarios(build_config(SelectConfig, config, given))), render_mode)
