"""`coview/SensorSelect-v0`: place one sensor after another, or stop; `coview/SensorSubset-v0`:
choose all in one action.
"""

import numpy as np
from gymnasium.spaces import Discrete, MultiBinary, MultiDiscrete

from placement_env.envs.config import SelectConfig, SubsetConfig
from placement_env.envs.env import Ends, PlacementEnv, PlacementVectorEnv, Task
from placement_env.envs.scenario import Scenario, Scenarios
from toolkit.arrays import Bool, Float32, Int64, Mask, Shaped


class _SelectTask(Task):
    """n episodes of choosing one candidate after another."""

    config_type = SelectConfig
    scenarios_type = Scenarios

    def __init__(self, n: int, scenarios: Scenarios) -> None:
        """Build n episodes. Flat actions are slots; factored ones have a value of each factor."""
        self.flat = not scenarios.factored
        self.stop = scenarios.slots  # the flat action that stops
        # number of values of each factor: mounts, heights, headings, tilts, models; one mount more
        # stops
        mount_count, *other_counts = scenarios.shape
        self.factors = (mount_count + 1, *other_counts)
        super().__init__(n, scenarios)
        self.action_space = (
            Discrete(self.stop + 1) if self.flat else MultiDiscrete(list(self.factors))
        )
        self._rows = np.arange(n)
        self._one_hot: dict[Scenario, np.ndarray] = {}  # `_one_hot_factors` of each scenario

    def step(self, active: Mask, actions: Shaped[np.ndarray, "n ..."]) -> Ends:
        """Place a candidate in each active row, or stop; an illegal action changes nothing.

        Returns rewards, terminated (stopped, or no candidate may be added) and truncated by row."""
        slot, is_stop = self._read_slots(actions)
        state = self.state
        is_acting = active & ~is_stop
        is_placing = is_acting & (slot >= 0) & state.allowed[self._rows, slot]
        chosen = state.chosen.copy()
        chosen[self._rows[is_placing], slot[is_placing]] = True
        state.step(active, illegal=is_acting & ~is_placing, chosen=chosen)
        terminated = active & (is_stop | ~state.allowed.any(axis=1))
        truncated = active & ~terminated & (state.steps >= state.max_steps)
        return state.gain, terminated, truncated

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Mask of legal actions; for factored actions, of the values that some legal candidate
        has.

        Factored actions have a column for each value of the first factor (mounts), then for each
        value of the second, and so on."""
        allowed = self.state.allowed
        if self.flat:
            stop_is_legal = np.ones((len(allowed), 1), np.bool_)
            return np.concatenate([allowed, stop_is_legal], axis=1)
        masks = np.zeros((len(allowed), sum(self.factors)), np.bool_)
        for scenario, rows in self.state.groups:
            # number of allowed candidates that have each value
            counts = allowed[rows].astype(np.float32) @ self._one_hot_factors(scenario)
            masks[rows] = counts > 0
        mount_count, *_ = self.factors
        masks[:, mount_count - 1] = True  # the last mount: stop
        # to stop, the other factors need a legal value too: their first, if no candidate is allowed
        first_values = np.cumsum(self.factors[:-1])
        masks[:, first_values] |= ~allowed.any(axis=1, keepdims=True)
        return masks

    def _read_slots(self, actions: np.ndarray) -> tuple[Int64[np.ndarray, " n"], Mask]:
        """Slot of the candidate that each action places, -1 for none, and True for stops.

        actions: slots, the last of them to stop; or mount, height, heading, tilt and model, with
        the last mount to stop."""
        if self.flat:
            slot = actions.astype(np.int64).reshape(-1)
            if ((slot < 0) | (slot > self.stop)).any():
                raise ValueError(f"actions are 0 to {self.stop} (stop), got {slot.tolist()}")
            is_stop = slot == self.stop
            return np.where(is_stop, -1, slot), is_stop
        # columns: mount, height, heading, tilt and model
        factors = actions.astype(np.int64).reshape(-1, len(self.factors))
        slot = np.full(len(factors), -1)
        for scenario, rows in self.state.groups:
            slot[rows] = scenario.objective.candidates.at(*factors[rows].T)
        mount_count, *_ = self.factors
        is_stop = factors[:, 0] == mount_count - 1  # the last mount
        return np.where(is_stop, -1, slot), is_stop

    def _one_hot_factors(self, scenario: Scenario) -> Float32[np.ndarray, "slots choices"]:
        """Values of the candidates' factors, as 1 in the column of each value; 0 in empty slots.

        Columns are the values of mounts, then of heights, headings, tilts and models."""
        if scenario not in self._one_hot:
            factors = scenario.objective.candidates.factors
            has_value = []
            for axis, size in enumerate(self.factors):
                has_value.append(np.arange(size) == factors[:, axis, None])
            one_hot = np.zeros((scenario.slots, sum(self.factors)), np.float32)
            one_hot[: len(factors)] = np.concatenate(has_value, axis=1)
            self._one_hot[scenario] = one_hot
        return self._one_hot[scenario]


class SensorSelectEnv(PlacementEnv):
    """Place one sensor after another at a junction, or stop.

    ## Action Space
    `Discrete(slots + 1)`: the candidate to place; the last action stops. With `actions="factored"`,
    for large pools, `MultiDiscrete([mounts + 1, heights, headings, tilts, models])`: the factors of
    the candidate; the last mount stops.

    An illegal action changes nothing: the reward is 0, `info["illegal"]` is True, and a step is
    used up. Illegal are an empty slot and a candidate that is chosen already, has failed, is on a
    full mount, or sends more than its link carries. `info["action_mask"]` and `action_masks()` mark
    the legal actions; of factored actions, the values of each factor that some legal candidate has,
    one factor after another, so a combination may still be illegal.

    ## Observation Space
    `Box(-1, 1, (14 · slots + 13,), float32)`. 14 features of every slot, each for all slots before
    the next: x, y, z, cosine and sine of heading, tilt, field of view, lidar or camera, price,
    kbit, share of places seen, share it would add to the chosen ones', chosen, allowed
    (`placement_env.envs.scenario.STATIC`, `placement_env.envs.state.DYNAMIC`), all relative to the
    area, so that a policy may go from site to site; then 13 global features
    (`placement_env.envs.state.GLOBAL`): budget and steps left, AP, recall, kbit, price, share seen,
    weights, scheme.

    ## Rewards
    Increase of the objective's reward, AP − λ_comm · kbit per sensor − λ_price · price. The rewards
    of an episode add up to the reward of its set.

    ## Starting State
    No sensors. Everything that the config leaves open (site, scheme, budget, failed candidates) is
    drawn.

    ## Episode End
    Terminates when the agent stops, the budget is used up, or nothing more may be placed. Truncated
    after two steps for each sensor of the budget.

    ## Info
    `ap`, `recall`, `kbit` (of the set), `kbit_per_sensor`, `price`, `subset` (boolean, of the
    slots), `marginal_gain`, `reward_terms`, `fidelity`, `cache_hit` (the set was scored in this
    episode already), `illegal`, `action_mask`; with several classes also `class_ap`, the AP of each
    by its name.

    ## Arguments
    config: a `placement_env.envs.config.SelectConfig`; or its fields by name. site, scheme: one or
    several; budget: sensors to place; failures: candidates that have failed; traffics: number of
    simulations of the traffic, None for a new one in every episode. Each episode draws one of
    several, and a number from a budget or failures given as (lowest, highest). actions: flat or
    factored; slots: for candidates, None for as many as the largest site needs; objective: in place
    of a site and all that follows; the fields of `placement_env.setting.Setting` (fidelity,
    weights, candidates, classes, ...) and of `toolkit.runtime.run.Run` (frames, seed, cache,
    workers, ray), and iou. `reset` takes the options site, scheme, budget and failed."""

    task_type = _SelectTask


class SensorSelectVectorEnv(PlacementVectorEnv):
    """n of `SensorSelectEnv`, which describes the arguments."""

    task_type = _SelectTask


class _SubsetTask(Task):
    """n episodes of one choice each."""

    config_type = SubsetConfig
    scenarios_type = Scenarios

    def __init__(self, n: int, scenarios: Scenarios) -> None:
        super().__init__(n, scenarios)
        self.action_space = MultiBinary(scenarios.slots)

    def step(self, active: Mask, actions: Shaped[np.ndarray, "n ..."]) -> Ends:
        """Choose the set of each active row. A set that may not be built is left empty.

        actions: 1 for each slot whose candidate is in the row's set, 0 for others."""
        slot_actions = actions.reshape(self.state.chosen.shape)
        chosen = np.asarray(slot_actions != 0)
        if (slot_actions != chosen).any():
            raise ValueError(f"actions must be 0 or 1 for each slot, got {actions.tolist()}")
        is_legal = self.state.fitting(chosen)
        self.state.step(active, illegal=active & ~is_legal, chosen=chosen & is_legal[:, None])
        terminated = active.copy()  # every episode ends after its first action
        truncated = np.zeros(self.state.n, np.bool_)
        return self.state.gain, terminated, truncated

    def info_mask(self) -> Bool[np.ndarray, "n slots"]:
        """Mask of candidates that may be in the set."""
        return self.state.allowed | self.state.chosen

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Mask of legal values: for each slot whether it may be 0, always True, and 1."""
        may_be_one = self.info_mask()
        may_be_zero = np.ones_like(may_be_one)
        return np.stack([may_be_zero, may_be_one], axis=2).reshape(self.state.n, -1)


class SensorSubsetEnv(PlacementEnv):
    """Choose in one action the sensors to build at a junction.

    ## Action Space
    `MultiBinary(slots)`: 1 for each candidate to build.

    A set that may not be built (more sensors than the budget, more on a mount than it carries, a
    failed one, too much data for a link, a slot without a candidate) is an illegal action: nothing
    is built, the reward is 0, `info["illegal"]` is True. `info["action_mask"]` marks the candidates
    that may be the only member of a set; `action_masks()` marks for each slot whether it may be 0
    and whether it may be 1.

    ## Observation Space
    `Box(-1, 1, (14 · slots + 13,), float32)`, as in `coview/SensorSelect-v0`.

    ## Rewards
    The objective's reward of the set, AP − λ_comm · kbit per sensor − λ_price · price.

    ## Episode End
    Terminates after one action.

    ## Starting State, Info, Arguments
    As in `coview/SensorSelect-v0`; config: a `placement_env.envs.config.SubsetConfig`, without
    `actions`.
    """

    task_type = _SubsetTask


class SensorSubsetVectorEnv(PlacementVectorEnv):
    """n of `SensorSubsetEnv`, which describes the arguments."""

    task_type = _SubsetTask
