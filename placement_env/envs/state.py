"""State of n episodes: chosen sensors, scores and observations.

The scalar environments have one row, the vector environments many, under the same rules in the same
arrays.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from placement_env.candidates.candidates import room_beside
from placement_env.checks import check_whole
from placement_env.envs.scenario import STATIC, Episode, Scenario
from placement_env.objective import Objective, Scores
from toolkit.arrays import Bool, Float32, Float64, Int64, Mask, Shaped
from toolkit.detection.schemes import PAPER_SCHEMES

DYNAMIC = ("marginal", "chosen", "allowed")
GLOBAL = (
    "budget left",
    "budget",
    "steps left",
    "ap",
    "recall",
    "kbit per sensor",
    "price",
    "covered",
    "weight of kbit",
    "weight of price",
    *PAPER_SCHEMES,
)
STEPS_PER_SENSOR = 2
Info = dict[str, Any]  # values of one episode, or arrays (n, ...)
Rows = slice | Int64[np.ndarray, " m"]


class State:
    """State of n episodes, a row each, written only by its methods.

    Attributes:
        n: Number of episodes.
        slots: Number of slots for candidates.
        scenarios: Scenario of each row, None before its first episode.
        chosen: True for slots of the chosen candidates (n, slots).
        failed: True for slots of the failed candidates (n, slots).
        allowed: True for slots of the candidates that may join (n, slots).
        budget: Largest number of sensors of each row.
        steps: Steps done in the episode of each row.
        max_steps: Largest number of steps of the episode of each row.
        scores: Scores of the chosen sets.
        gain: Reward that the last step added.
        illegal: Whether the last action was illegal.
        repeated: Whether the last step needed no new score. `scores.cache_hit` is whether a score
            was in the objective's memory, which depends on earlier episodes; `info["cache_hit"]`
            must not, so it is `repeated`.
        groups: Each scenario and an index of its rows.
        ready: Whether an episode has started in every row.
        fixed: Whether sensors are moved, so that none may join.
    """

    def __init__(
        self, n: int, slots: int, *, max_steps: int | None = None, fixed: bool = False
    ) -> None:
        """Make room for n episodes that have not started.

        slots: number of candidates that an episode has room for; max_steps: largest number of steps
        of an episode, None for `STEPS_PER_SENSOR` times the budget; fixed: True if sensors are only
        moved, so that none may join."""
        check_whole("num_envs", n, least=1)
        self.n = n
        self.slots = slots
        self.fixed = fixed
        self._max_steps = max_steps
        self.scenarios: list[Scenario | None] = [None] * n
        self.ready = False
        # each scenario with the index of its rows
        self.groups: list[tuple[Scenario, Rows]] = []
        self._weights = np.zeros((2, n))  # rows: weights of kbit per sensor and of price
        # last global features: two weights, and the scheme
        self._constants = np.zeros((n, 2 + len(PAPER_SCHEMES)), np.float32)
        self._fidelity = np.full(n, None, object)  # names
        # the class docstring says what these hold
        self.gain = np.zeros(n)
        self.chosen = np.zeros((n, slots), np.bool_)
        self.failed = np.zeros((n, slots), np.bool_)
        self.allowed = np.zeros((n, slots), np.bool_)
        self.budget = np.ones(n, np.int64)
        self.steps = np.zeros(n, np.int64)
        self.max_steps = np.ones(n, np.int64)
        # six figures of each row, and whether they were in memory
        self.scores = Scores(*np.zeros((6, n)), np.zeros(n, np.bool_))  # type: ignore[call-arg]
        self.illegal = np.zeros(n, np.bool_)
        self.repeated = np.zeros(n, np.bool_)

    def reset(self, rows: Int64[np.ndarray, " m"], episodes: Sequence[Episode]) -> None:
        """Start new episodes in some rows.

        rows: indices of the rows; episodes: one for each row, in their order."""
        self.budget[rows] = [episode.budget for episode in episodes]
        self.max_steps[rows] = (
            STEPS_PER_SENSOR * self.budget[rows] if self._max_steps is None else self._max_steps
        )
        self.chosen[rows] = self.illegal[rows] = self.repeated[rows] = False
        self.steps[rows] = 0
        self.gain[rows] = 0.0
        for figure in self.scores:
            figure[rows] = 0
        episode_by_row = dict(zip(rows.tolist(), episodes, strict=True))
        self._set_scenarios({row: episode.scenario for row, episode in episode_by_row.items()})
        for row, episode in episode_by_row.items():
            self.failed[row] = episode.failed
            if episode.chosen is not None:
                self.chosen[row] = episode.chosen
        # the empty set keeps its scores of 0
        self._update_scores(rows[self.chosen[rows].any(axis=1)])
        self._update_allowed()

    def step(
        self,
        active: Mask,
        illegal: Mask,
        *,
        chosen: Bool[np.ndarray, "n slots"] | None = None,
        scenarios: Mapping[int, Scenario] | None = None,
    ) -> None:
        """Step the active episodes to these sets, or to other scenarios of some rows.

        Args:
            active: True for rows whose episode takes a step.
            illegal: True for rows whose action was illegal, for the info; the caller decides on
                their sets.
            chosen: New sets, used in active rows only; None to keep all sets.
            scenarios: New scenarios by row, None to keep all.
        """
        earlier_reward = self.scores.reward.copy()
        is_changed = np.zeros(self.n, np.bool_)
        if chosen is not None:
            is_changed = active & (chosen != self.chosen).any(axis=1)
            self.chosen[is_changed] = chosen[is_changed]
        if scenarios:
            is_changed[list(scenarios)] = True
            self._set_scenarios(scenarios)
        self.steps += active
        self.illegal = illegal
        self.repeated = active & ~is_changed
        self._update_scores(np.flatnonzero(is_changed))
        self.gain = np.where(active, self.scores.reward - earlier_reward, 0.0)
        self._update_allowed()

    def fitting(self, chosen: Bool[np.ndarray, "n slots"]) -> Mask:
        """Mask of sets that are feasible, within budget, and without failed sensors.

        chosen: a set for each episode; a set with an empty slot does not fit."""
        is_fitting = ~(chosen & self.failed).any(axis=1) & (chosen.sum(axis=1) <= self.budget)
        for scenario, rows in self.groups:
            # the first `width` slots hold candidates, the others are empty
            is_feasible = scenario.objective.feasible(chosen[rows, : scenario.width])
            has_empty_slot = chosen[rows, scenario.width :].any(axis=1)
            is_fitting[rows] &= is_feasible & ~has_empty_slot
        return is_fitting

    def placement(self, row: int) -> tuple[Objective, list[int]]:
        """Objective of a row and its chosen candidates."""
        scenario = self.scenarios[row]
        assert scenario is not None
        return scenario.objective, np.flatnonzero(self.chosen[row]).tolist()

    def observe(self) -> Float32[np.ndarray, "n size"]:
        """`STATIC` and `DYNAMIC` of the slots, feature after feature, then `GLOBAL`, all in -1..1.

        Price and budget are given as x / (x + 8), kbit of the chosen set (in Mbit) as x / (x + 1).
        """
        n = self.n
        feature_count = len(STATIC) + len(DYNAMIC)
        observations = np.empty((n, feature_count * self.slots + len(GLOBAL)), np.float32)
        # a view with the axes episode, feature, slot
        features = observations[:, : -len(GLOBAL)].reshape(n, feature_count, self.slots)
        static_features = features[:, : len(STATIC)]
        marginal = features[:, len(STATIC)]
        covered_share = np.empty(n)
        for scenario, rows in self.groups:
            covered_counts, added_counts = coverage_gain(scenario.seen, self.chosen[rows])
            places = np.float32(max(1, scenario.places))
            covered_share[rows] = covered_counts / places
            static_features[rows] = scenario.static
            marginal[rows] = added_counts / places
        features[:, len(STATIC) + DYNAMIC.index("chosen")] = self.chosen
        features[:, len(STATIC) + DYNAMIC.index("allowed")] = self.allowed
        scores = self.scores
        megabit = scores.kbit_per_sensor / 1000
        columns = [  # in the order of `GLOBAL`; weights and scheme follow
            1 - self.chosen.sum(axis=1) / self.budget,
            self.budget / (self.budget + 8.0),
            1 - self.steps / self.max_steps,
            scores.ap,
            scores.recall,
            megabit / (megabit + 1),
            scores.price / (scores.price + 8),
            covered_share,
        ]
        global_features = observations[:, -len(GLOBAL) :]  # a view
        global_features[:, : len(columns)] = np.stack(columns, axis=1)
        global_features[:, len(columns) :] = self._constants
        return observations

    def objectives(self) -> Float64[np.ndarray, "n 3"]:
        """AP, -kbit per sensor and -price of the chosen sets, all to be maximised."""
        scores = self.scores
        # 0 - x is 0 for no cost, and -x would be -0.0
        return np.stack([scores.ap, 0 - scores.kbit_per_sensor, 0 - scores.price], axis=1)

    def info(self) -> Info:
        """Info with an array (n, ...) for each key, copied from the state."""
        scores = self.scores
        comm_weight, price_weight = self._weights
        info: Info = {
            key: getattr(scores, key).copy()
            for key in ("ap", "recall", "kbit", "kbit_per_sensor", "price")
        }
        info["subset"] = self.chosen.copy()
        info["marginal_gain"] = self.gain.copy()  # reward that the last step added
        info["reward_terms"] = {
            "ap": scores.ap.copy(),
            # 0 - x is 0 for no cost, and -x would be -0.0
            "comm": 0 - comm_weight * scores.kbit_per_sensor,
            "price": 0 - price_weight * scores.price,
        }
        info["fidelity"] = self._fidelity.copy()
        # True if the last step needed no new score; not `scores.cache_hit` (class docstring)
        info["cache_hit"] = self.repeated.copy()
        info["illegal"] = self.illegal.copy()
        class_aps = self._find_class_aps()
        if len(class_aps) > 1:
            info["class_ap"] = class_aps
        return info

    def _find_class_aps(self) -> dict[str, Float64[np.ndarray, " n"]]:
        """AP of each class in each row, by the name of the class; empty for a single class."""
        if not self.groups:
            return {}
        first_scenario, _ = self.groups[0]
        names = first_scenario.objective.classes.names  # the same in all scenarios
        if len(names) == 1:
            return {}
        class_ap = np.zeros((self.n, len(names)))
        for scenario, rows in self.groups:
            class_ap[rows] = scenario.objective.class_ap(self.chosen[rows, : scenario.width])
        return {name: class_ap[:, k].copy() for k, name in enumerate(names)}

    def _update_scores(self, rows: Int64[np.ndarray, " m"]) -> None:
        """Write the scores of the chosen sets of some rows into `scores`."""
        if not len(rows):
            return
        for scenario, group_rows in self.groups:
            # a slice means all rows
            scored_rows = rows if isinstance(group_rows, slice) else rows[np.isin(rows, group_rows)]
            if len(scored_rows):
                scores = scenario.objective.scores(self.chosen[scored_rows, : scenario.width])
                for figure, value in zip(self.scores, scores, strict=True):
                    figure[scored_rows] = value

    def _set_scenarios(self, scenarios: Mapping[int, Scenario]) -> None:
        """Take over new scenarios, and group all rows by scenario.

        scenarios: the scenario of each row that starts an episode, by the row's index."""
        changed_scenarios = {
            row: scenario
            for row, scenario in scenarios.items()
            if self.scenarios[row] is not scenario
        }
        if not changed_scenarios:
            return
        for row, scenario in changed_scenarios.items():
            objective = scenario.objective
            self.scenarios[row] = scenario
            self._fidelity[row] = objective.fidelity
            self._constants[row] = scenario.constants
            self._weights[:, row] = objective.weights.comm, objective.weights.price
        rows_by_scenario: dict[Scenario, list[int]] = {}
        for row, row_scenario in enumerate(self.scenarios):
            if row_scenario is not None:
                rows_by_scenario.setdefault(row_scenario, []).append(row)
        self.ready = None not in self.scenarios
        # a slice of all rows makes views instead of copies
        is_single = len(rows_by_scenario) == 1 and self.ready
        self.groups = [
            (scenario, slice(None) if is_single else np.array(rows))
            for scenario, rows in rows_by_scenario.items()
        ]

    def _update_allowed(self) -> None:
        """Update `allowed`: candidates that work and have room on their mount and its link.

        None may join a set that has used up its budget. If sensors are moved, nothing changes."""
        if self.fixed:
            return
        allowed = ~self.failed
        for scenario, rows in self.groups:
            allowed[rows] &= find_room(scenario, self.chosen[rows])
        has_budget = self.chosen.sum(axis=1) < self.budget
        self.allowed = allowed & has_budget[:, None]


def find_room(
    scenario: Scenario, chosen: Bool[np.ndarray, "n slots"]
) -> Bool[np.ndarray, "n slots"]:
    """Mask of candidates that may join each of n sets: their links and mounts have room.

    chosen: sets over all slots of the scenario."""
    objective = scenario.objective
    width = scenario.width  # the slots from here on are empty
    has_room = scenario.usable & ~chosen
    candidates = objective.candidates
    loads = objective.shared_links  # kbit per frame of each candidate, None if no link is shared
    if loads is not None:
        # `room_beside` checks both, links and mounts
        has_room[:, :width] &= room_beside(candidates, chosen[:, :width], loads)
        return has_room
    # only the places on mounts limit: number of sensors on each mount in each set
    sensor_count = np.zeros((len(chosen), len(candidates.mounts)), np.int64)
    row, slot = chosen[:, :width].nonzero()
    np.add.at(sensor_count, (row, candidates.mount[slot]), 1)
    has_place = sensor_count < candidates.places
    has_room[:, :width] &= has_place[:, candidates.mount]
    return has_room


def coverage_gain(
    seen: Shaped[np.ndarray, "words slots"], chosen: Bool[np.ndarray, "n slots"]
) -> tuple[Int64[np.ndarray, " n"], Shaped[np.ndarray, "n slots"]]:
    """Number of places that each of n sets sees, and the number that each candidate would add.

    seen: places that each candidate sees, 64 in a word (uint64), a bit each; chosen: the candidates
    of each set.
    """
    covered_words = np.zeros((len(chosen), len(seen)), np.uint64)  # sets × words
    row, slot = chosen.nonzero()
    np.bitwise_or.at(covered_words, row, seen.T[slot])
    new_places = seen & ~covered_words[:, :, None]  # sets × words × slots
    # int16 holds `MAX_PLACES`
    added_counts = np.add.reduce(np.bitwise_count(new_places), axis=1, dtype=np.int16)
    covered_counts = np.bitwise_count(covered_words).sum(axis=1, dtype=np.int64)
    return covered_counts, added_counts
