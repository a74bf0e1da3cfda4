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
    """State of n episodes, written only by its methods.

    Attributes:
        chosen: Slots of the chosen candidates.
        failed: Slots of the failed candidates.
        allowed: Slots of the candidates that may join.
        scores: Scores of the chosen sets.
        gain: Reward that the last step added.
        repeated: Whether the last step needed no new score. `scores.cache_hit` is whether a score
            was in the objective's memory, which depends on earlier episodes; `info["cache_hit"]`
            must not, so it is `repeated`.
        groups: Each scenario and an index of its rows.
        ready: Whether an episode has started in every row.
        max_steps: Largest number of steps of an episode, None for `STEPS_PER_SENSOR` times the
            budget.
        fixed: Whether sensors are moved, so that none may join.
    """

    def __init__(
        self, n: int, slots: int, *, max_steps: int | None = None, fixed: bool = False
    ) -> None:
        check_whole("num_envs", n, least=1)
        self.n = n
        self.slots = slots
        self.fixed = fixed
        self._max_steps = max_steps
        self.scenarios: list[Scenario | None] = [None] * n
        self.ready = False
        self.groups: list[tuple[Scenario, Rows]] = []
        self._weights = np.zeros((2, n))
        self._constants = np.zeros((n, 2 + len(PAPER_SCHEMES)), np.float32)
        self._fidelity = np.full(n, None, object)
        self.gain = np.zeros(n)
        self.chosen = np.zeros((n, slots), np.bool_)
        self.failed = np.zeros((n, slots), np.bool_)
        self.allowed = np.zeros((n, slots), np.bool_)
        self.budget = np.ones(n, np.int64)
        self.steps = np.zeros(n, np.int64)
        self.max_steps = np.ones(n, np.int64)
        self.scores = Scores(*np.zeros((6, n)), np.zeros(n, np.bool_))  # type: ignore[call-arg]
        self.illegal = np.zeros(n, np.bool_)
        self.repeated = np.zeros(n, np.bool_)

    def reset(self, rows: Int64[np.ndarray, " m"], episodes: Sequence[Episode]) -> None:
        """Start new episodes in some rows."""
        self.budget[rows] = [episode.budget for episode in episodes]
        self.max_steps[rows] = (
            STEPS_PER_SENSOR * self.budget[rows] if self._max_steps is None else self._max_steps
        )
        self.chosen[rows] = self.illegal[rows] = self.repeated[rows] = False
        self.steps[rows] = 0
        self.gain[rows] = 0.0
        for figure in self.scores:
            figure[rows] = 0
        self._enter(
            {row: episode.scenario for row, episode in zip(rows.tolist(), episodes, strict=True)}
        )
        for row, episode in zip(rows.tolist(), episodes, strict=True):
            self.failed[row] = episode.failed
            if episode.chosen is not None:
                self.chosen[row] = episode.chosen
        self._score(rows[self.chosen[rows].any(axis=1)])
        self._find_allowed()

    def step(
        self,
        active: Mask,
        illegal: Mask,
        *,
        chosen: Bool[np.ndarray, "n slots"] | None = None,
        scenarios: Mapping[int, Scenario] | None = None,
    ) -> None:
        """Step the active episodes to these sets, or to other scenarios of some rows.

        illegal: rows whose action was illegal, for the info; the caller decides on their sets.
        scenarios: new scenarios by row.
        """
        earlier_reward = self.scores.reward.copy()
        is_changed = np.zeros(self.n, np.bool_)
        if chosen is not None:
            is_changed = active & (chosen != self.chosen).any(axis=1)
            self.chosen[is_changed] = chosen[is_changed]
        if scenarios:
            is_changed[list(scenarios)] = True
            self._enter(scenarios)
        self.steps += active
        self.illegal = illegal
        self.repeated = active & ~is_changed
        self._score(is_changed.nonzero()[0])
        self.gain = np.where(active, self.scores.reward - earlier_reward, 0.0)
        self._find_allowed()

    def fitting(self, chosen: Bool[np.ndarray, "n slots"]) -> Mask:
        """Mask of sets that are feasible, within budget, and without failed sensors."""
        is_fitting = ~(chosen & self.failed).any(axis=1) & (chosen.sum(axis=1) <= self.budget)
        for scenario, rows in self.groups:
            candidates = chosen[rows, : scenario.width]
            empty_slots = chosen[rows, scenario.width :]
            is_fitting[rows] &= scenario.objective.feasible(candidates) & ~empty_slots.any(axis=1)
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
        static = len(STATIC)  # number of these features, and index of the first of `DYNAMIC`
        feature_count = len(STATIC) + len(DYNAMIC)
        observations = np.empty((n, feature_count * self.slots + len(GLOBAL)), np.float32)
        features = observations[:, : -len(GLOBAL)].reshape(n, feature_count, self.slots)
        covered = np.empty(n)
        for scenario, rows in self.groups:
            covered_counts, added = coverage_gain(scenario.seen, self.chosen[rows])
            places = np.float32(max(1, scenario.places))
            covered[rows] = covered_counts / places
            features[rows, :static] = scenario.static
            features[rows, static] = added / places
        features[:, -2] = self.chosen
        features[:, -1] = self.allowed
        global_features = observations[:, -len(GLOBAL) :]  # a view, in the order of `GLOBAL`
        scores = self.scores
        megabit = self.scores.kbit_per_sensor / 1000
        global_features[:, 0] = 1 - self.chosen.sum(axis=1) / self.budget
        global_features[:, 1] = self.budget / (self.budget + 8.0)
        global_features[:, 2] = 1 - self.steps / self.max_steps
        global_features[:, 3] = scores.ap
        global_features[:, 4] = scores.recall
        global_features[:, 5] = megabit / (megabit + 1)
        global_features[:, 6] = scores.price / (scores.price + 8)
        global_features[:, 7] = covered
        global_features[:, 8:] = self._constants
        return observations

    def objectives(self) -> Float64[np.ndarray, "n 3"]:
        """AP, -kbit per sensor and -price of the chosen sets, all to be maximised."""
        scores = self.scores
        return np.stack([scores.ap, 0 - scores.kbit_per_sensor, 0 - scores.price], axis=1)

    def info(self) -> Info:
        """Info with an array (n, ...) for each key."""
        scores = self.scores
        comm, price = self._weights
        terms = {
            "ap": scores.ap.copy(),
            "comm": 0 - comm * scores.kbit_per_sensor,
            "price": 0 - price * scores.price,
        }
        info: Info = {
            key: getattr(scores, key).copy()
            for key in ("ap", "recall", "kbit", "kbit_per_sensor", "price")
        }
        info |= {
            "subset": self.chosen.copy(),
            "marginal_gain": self.gain.copy(),
            "reward_terms": terms,
        }
        info |= {
            "fidelity": self._fidelity.copy(),
            "cache_hit": self.repeated.copy(),
            "illegal": self.illegal.copy(),
        }
        names = self.groups[0][0].objective.classes.names if self.groups else ()
        if len(names) > 1:
            figures = np.zeros((self.n, len(names)))
            for scenario, rows in self.groups:
                figures[rows] = scenario.objective.class_ap(self.chosen[rows, : scenario.width])
            info["class_ap"] = {name: figures[:, k].copy() for k, name in enumerate(names)}
        return info

    def _score(self, rows: Int64[np.ndarray, " m"]) -> None:
        """Write the scores of the chosen sets of some rows."""
        if not len(rows):
            return
        for scenario, members in self.groups:
            scored_rows = rows if isinstance(members, slice) else rows[np.isin(rows, members)]
            if len(scored_rows):
                scores = scenario.objective.scores(self.chosen[scored_rows, : scenario.width])
                for figure, value in zip(self.scores, scores, strict=True):
                    figure[scored_rows] = value

    def _enter(self, scenarios: Mapping[int, Scenario]) -> None:
        """Take over the scenarios of some rows, and group all rows by scenario."""
        changed = {
            row: scenario
            for row, scenario in scenarios.items()
            if self.scenarios[row] is not scenario
        }
        if not changed:
            return
        for row, scenario in changed.items():
            objective = scenario.objective
            self.scenarios[row] = scenario
            self._fidelity[row] = objective.fidelity
            self._constants[row] = scenario.constants
            self._weights[:, row] = objective.weights.comm, objective.weights.price
        members: dict[Scenario, list[int]] = {}
        for row, entered in enumerate(self.scenarios):
            if entered is not None:
                members.setdefault(entered, []).append(row)
        self.ready = None not in self.scenarios
        is_single = len(members) == 1 and self.ready
        self.groups = [
            (group_scenario, slice(None) if is_single else np.array(rows))
            for group_scenario, rows in members.items()
        ]

    def _find_allowed(self) -> None:
        """Find the candidates that may join: not failed, with room on their mount and its link."""
        if self.fixed:
            return
        allowed = ~self.failed
        for scenario, rows in self.groups:
            allowed[rows] &= find_room(scenario, self.chosen[rows])
        self.allowed = allowed & (self.chosen.sum(axis=1) < self.budget)[:, None]


def find_room(
    scenario: Scenario, chosen: Bool[np.ndarray, "n slots"]
) -> Bool[np.ndarray, "n slots"]:
    """Mask of candidates that may join each of n sets: their links and mounts have room."""
    objective = scenario.objective
    width = scenario.width
    has_room = scenario.usable & ~chosen
    candidates = objective.candidates
    loads = objective.shared_links
    if loads is not None:
        has_room[:, :width] &= room_beside(candidates, chosen[:, :width], loads)
        return has_room
    count = np.zeros((len(chosen), len(candidates.mounts)), np.int64)
    row, slot = chosen[:, :width].nonzero()
    np.add.at(count, (row, candidates.mount[slot]), 1)
    has_room[:, :width] &= (count < candidates.places)[:, candidates.mount]
    return has_room


def coverage_gain(
    seen: Shaped[np.ndarray, "words slots"], chosen: Bool[np.ndarray, "n slots"]
) -> tuple[Int64[np.ndarray, " n"], Shaped[np.ndarray, "n slots"]]:
    """Number of places that each of n sets sees, and the number that each candidate would add.

    seen: places that each candidate sees, 64 in a word, a bit each.
    """
    covered = np.zeros((len(chosen), len(seen)), np.uint64)
    row, slot = chosen.nonzero()
    np.bitwise_or.at(covered, row, seen.T[slot])
    added = np.add.reduce(np.bitwise_count(seen & ~covered[:, :, None]), axis=1, dtype=np.int16)
    return np.bitwise_count(covered).sum(axis=1, dtype=np.int64), added
