"""State of n episodes: chosen sensors, scores and observations. The scalar environments have one
row, the vector environments many, under the same rules in the same arrays."""

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
    *("budget left", "budget", "steps left", "ap", "recall", "kbit per sensor", "price", "covered"),
    *("weight of kbit", "weight of price", *PAPER_SCHEMES),
)
STEPS = 2  # for each sensor of the budget
Info = dict[str, Any]  # of an episode, or arrays (n, ...) of n
Rows = slice | Int64[np.ndarray, " m"]


class State:
    """State of n episodes, written by its own methods alone.

    chosen, failed, allowed: over the slots, allowed are the candidates that may join; scores: of
    the chosen sets; gain: reward that the last step added; repeated: True if it needed no new score
    (`scores.cache_hit` tells whether a score was in the objective's memory, which depends on
    earlier episodes; `info["cache_hit"]` must not, so it is this); groups: each scenario and an
    index of its rows; ready: an episode has started in every row; max_steps: of an episode, None
    for `STEPS` for each sensor of the budget; fixed: sensors are moved, none may join."""

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
        self.chosen, self.failed, self.allowed = (np.zeros((n, slots), np.bool_) for _ in range(3))
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
            STEPS * self.budget[rows] if self._max_steps is None else self._max_steps
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
        """Step the active episodes to these sets, or to other scenarios of some rows, unless
        illegal."""
        before = self.scores.reward.copy()
        changed = np.zeros(self.n, np.bool_)
        if chosen is not None:
            changed = active & (chosen != self.chosen).any(axis=1)
            self.chosen[changed] = chosen[changed]
        if scenarios:
            changed[list(scenarios)] = True
            self._enter(scenarios)
        self.steps += active
        self.illegal = illegal
        self.repeated = active & ~changed
        self._score(changed.nonzero()[0])
        self.gain = np.where(active, self.scores.reward - before, 0.0)
        self._find_allowed()

    def fitting(self, chosen: Bool[np.ndarray, "n slots"]) -> Mask:
        """Tell which sets are feasible, within budget, without failed sensors."""
        fits = ~(chosen & self.failed).any(axis=1) & (chosen.sum(axis=1) <= self.budget)
        for scenario, rows in self.groups:
            inside = chosen[rows, : scenario.width]
            outside = chosen[rows, scenario.width :]
            fits[rows] &= scenario.objective.feasible(inside) & ~outside.any(axis=1)
        return fits

    def placement(self, row: int) -> tuple[Objective, list[int]]:
        """Return the objective of a row and its chosen candidates."""
        scenario = self.scenarios[row]
        assert scenario is not None
        return scenario.objective, np.flatnonzero(self.chosen[row]).tolist()

    def observe(self) -> Float32[np.ndarray, "n size"]:
        """Return `STATIC` and `DYNAMIC` of the slots, feature after feature, then `GLOBAL`, all in
        -1..1. Price and budget are given as x / (x + 8), kbit of the chosen set (in Mbit) as x / (x
        + 1)."""
        n = self.n
        static = len(STATIC)
        own = len(STATIC) + len(DYNAMIC)
        whole = np.empty((n, own * self.slots + len(GLOBAL)), np.float32)
        features = whole[:, : -len(GLOBAL)].reshape(n, own, self.slots)
        covered = np.empty(n)
        for scenario, rows in self.groups:
            together, added = coverage_gain(scenario.seen, self.chosen[rows])
            places = np.float32(max(1, scenario.places))
            covered[rows] = together / places
            features[rows, :static] = scenario.static
            features[rows, static] = added / places
        features[:, -2] = self.chosen
        features[:, -1] = self.allowed
        last = whole[:, -len(GLOBAL) :]
        scores = self.scores
        megabit = self.scores.kbit_per_sensor / 1000
        last[:, 0] = 1 - self.chosen.sum(axis=1) / self.budget
        last[:, 1] = self.budget / (self.budget + 8.0)
        last[:, 2] = 1 - self.steps / self.max_steps
        last[:, 3] = scores.ap
        last[:, 4] = scores.recall
        last[:, 5] = megabit / (megabit + 1)
        last[:, 6] = scores.price / (scores.price + 8)
        last[:, 7] = covered
        last[:, 8:] = self._constants
        return whole

    def objectives(self) -> Float64[np.ndarray, "n 3"]:
        """Return AP, -kbit per sensor and -price of the chosen sets, all to be maximised."""
        scores = self.scores
        return np.stack([scores.ap, 0 - scores.kbit_per_sensor, 0 - scores.price], axis=1)

    def info(self) -> Info:
        """Return the info, an array (n, ...) for each key."""
        scores, (comm, price) = self.scores, self._weights
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
        if not len(rows):
            return
        for scenario, members in self.groups:
            some = rows if isinstance(members, slice) else rows[np.isin(rows, members)]
            if len(some):
                scores = scenario.objective.scores(self.chosen[some, : scenario.width])
                for figure, value in zip(self.scores, scores, strict=True):
                    figure[some] = value

    def _enter(self, scenarios: Mapping[int, Scenario]) -> None:
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
        alone = len(members) == 1 and self.ready
        self.groups = [
            (each, slice(None) if alone else np.array(rows)) for each, rows in members.items()
        ]

    def _find_allowed(self) -> None:
        """Find the candidates that may join. They have not failed, and have room on their mount and
        its link."""
        if self.fixed:
            return
        allowed = ~self.failed
        for scenario, rows in self.groups:
            allowed[rows] &= find_room(scenario, self.chosen[rows])
        self.allowed = allowed & (self.chosen.sum(axis=1) < self.budget)[:, None]


def find_room(
    scenario: Scenario, chosen: Bool[np.ndarray, "n slots"]
) -> Bool[np.ndarray, "n slots"]:
    """Tell which other candidates may join, by their links and the room on their mounts."""
    objective = scenario.objective
    width = scenario.width
    room = scenario.usable & ~chosen
    candidates = objective.candidates
    shared = objective.shared_links
    if shared is not None:
        room[:, :width] &= room_beside(candidates, chosen[:, :width], shared)
        return room
    count, (row, slot) = (
        np.zeros((len(chosen), len(candidates.mounts)), np.int64),
        chosen[:, :width].nonzero(),
    )
    np.add.at(count, (row, candidates.mount[slot]), 1)
    room[:, :width] &= (count < candidates.places)[:, candidates.mount]
    return room


def coverage_gain(
    seen: Shaped[np.ndarray, "words slots"], chosen: Bool[np.ndarray, "n slots"]
) -> tuple[Int64[np.ndarray, " n"], Shaped[np.ndarray, "n slots"]]:
    """Count the places seen, and added by each candidate."""
    together = np.zeros((len(chosen), len(seen)), np.uint64)
    row, slot = chosen.nonzero()
    np.bitwise_or.at(together, row, seen.T[slot])
    added = np.add.reduce(np.bitwise_count(seen & ~together[:, :, None]), axis=1, dtype=np.int16)
    return np.bitwise_count(together).sum(axis=1, dtype=np.int64), added
