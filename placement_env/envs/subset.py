"""`coview/SensorSubset-v0`: choose all sensors at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import MultiBinary

from placement_env.envs.config import SubsetConfig, build_config
from placement_env.envs.env import ActionSpace, PlacementEnv, PlacementVectorEnv, observation_space
from placement_env.envs.scenario import Options, Scenarios
from placement_env.envs.state import Info, State
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped


class SubsetTask:
    """n episodes of one choice each."""

    def __init__(self, n: int, scenarios: Scenarios) -> None:
        self.scenarios, self.state = scenarios, State(n, scenarios.slots)
        self.action_space: ActionSpace = MultiBinary(scenarios.slots)
        self.observation_space = observation_space(scenarios.slots)

    def resize(self, n: int) -> SubsetTask:
        """Return the same rules, at the same scenarios, for n episodes."""
        return SubsetTask(n, self.scenarios)

    def reset(
        self, rows: Int64[np.ndarray, " m"], rngs: Sequence[np.random.Generator], options: Options | None
    ) -> None:
        """Start new episodes in some rows."""
        self.state.reset(rows, [self.scenarios.draw(rng, options) for rng in rngs])

    def step(
        self, active: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Choose the set of each active row. A set that may not be built is left empty."""
        chosen = np.asarray(actions.reshape(self.state.chosen.shape) != 0)
        if (actions.reshape(chosen.shape) != chosen).any():
            raise ValueError(f"actions must be 0 or 1 for each slot, got {actions.tolist()}")
        legal = self.state.fitting(chosen)
        self.state.place(active, chosen & legal[:, None], active & ~legal)
        return self.state.gain, active.copy(), np.zeros(self.state.n, np.bool_)

    def observe(self) -> tuple[Float32[np.ndarray, "n size"], Info]:
        """Return observations and info."""
        mask = self.state.allowed | self.state.chosen
        return self.state.observe(), {**self.state.info(), "action_mask": mask.astype(np.int8)}

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Tell for each slot whether it may be 0, always True, and 1."""
        may = self.state.allowed | self.state.chosen
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

    ## Starting State
    As of `coview/SensorSelect-v0`.

    ## Episode End
    Terminates after one action.

    ## Info
    As of `coview/SensorSelect-v0`.

    ## Arguments
    config: a `placement_env.envs.config.SubsetConfig`; or its fields by name, which are those of
    `coview/SensorSelect-v0` except `actions`.

    ## Version History
    v0: first version.
    """

    def __init__(self, config: SubsetConfig | None = None, *, render_mode: str | None = None, **given: object) -> None:
        super().__init__(SubsetTask(1, Scenarios(build_config(SubsetConfig, config, given))), render_mode)


class SensorSubsetVectorEnv(PlacementVectorEnv):
    """n of `SensorSubsetEnv`, which describes the arguments."""

    def __init__(
        self,
        num_envs: int = 1,
        config: SubsetConfig | None = None,
        *,
        render_mode: str | None = None,
        **given: object,
    ) -> None:
        super().__init__(SubsetTask(num_envs, Scenarios(build_config(SubsetConfig, config, given))), render_mode)
