"""`coview/SensorSubset-v0`: choose all sensors at once."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import MultiBinary

from placement_env.envs.config import SubsetConfig
from placement_env.envs.env import Ends, PlacementEnv, PlacementVectorEnv, Task
from placement_env.envs.scenario import Scenarios
from toolkit.arrays import Bool, Shaped


class _SubsetTask(Task):
    """n episodes of one choice each."""

    config_type, scenarios_type = SubsetConfig, Scenarios

    def __init__(self, n: int, scenarios: Scenarios) -> None:
        super().__init__(n, scenarios)
        self.action_space = MultiBinary(scenarios.slots)

    def step(self, active: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]) -> Ends:
        """Choose the set of each active row. A set that may not be built is left empty."""
        chosen = np.asarray(actions.reshape(self.state.chosen.shape) != 0)
        if (actions.reshape(chosen.shape) != chosen).any():
            raise ValueError(f"actions must be 0 or 1 for each slot, got {actions.tolist()}")
        legal = self.state.fitting(chosen)
        self.state.step(active, active & ~legal, chosen=chosen & legal[:, None])
        return self.state.gain, active.copy(), np.zeros(self.state.n, np.bool_)

    def info_mask(self) -> Bool[np.ndarray, "n slots"]:
        return self.state.allowed | self.state.chosen

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Tell for each slot whether it may be 0, always True, and 1."""
        may = self.info_mask()
        return np.stack([np.ones_like(may), may], axis=2).reshape(self.state.n, -1)


class SensorSubsetEnv(PlacementEnv):
    """Choose in one action the sensors to build at a junction.

    ## Action Space
    `MultiBinary(slots)`: 1 for each candidate to build.

    A set that may not be built (more sensors than the budget, more on a mount than it carries, a failed one, too much
    data for a link, a slot without a candidate) is an illegal action: nothing is built, the reward is 0,
    `info["illegal"]` is True. `info["action_mask"]` tells the candidates that may be in a set by themselves;
    `action_masks()` tells for each slot whether it may be 0 and whether it may be 1.

    ## Observation Space
    `Box(-1, 1, (14 · slots + 13,), float32)`, as of `coview/SensorSelect-v0`.

    ## Rewards
    The objective's reward of the set, AP − λ_comm · kbit per sensor − λ_price · price.

    ## Episode End
    Terminates after one action.

    ## Starting State, Info, Arguments
    As of `coview/SensorSelect-v0`; config: a `placement_env.envs.config.SubsetConfig`, without `actions`.
    """

    task_type = _SubsetTask


class SensorSubsetVectorEnv(PlacementVectorEnv):
    """n of `SensorSubsetEnv`, which describes the arguments."""

    task_type = _SubsetTask
