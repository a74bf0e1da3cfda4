"""Boards: n games of choosing sensors side by side, what is chosen in each, its score, and what an agent sees of it.

The scalar environments play one board, the vector environments many, by the same rules in the same arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from placement_env.envs.scenario import STATIC, Scene, Start
from placement_env.objective import Objective, Scores
from toolkit.arrays import Bool, Float32, Int64, Shaped
from toolkit.detection.schemes import PAPER_SCHEMES

DYNAMIC = ("marginal", "chosen", "allowed")
GLOBAL = (
    *("budget left", "budget", "turns left", "ap", "recall", "kbit per sensor", "price", "covered"),
    *("weight of kbit", "weight of price", *PAPER_SCHEMES),
)
TURNS = 2  # for each sensor of the budget


class Boards:
    """State of n games. chosen, failed: over the slots; budget: sensors to place; turns: taken; scores: of the chosen
    sets; gain: reward that the last turn added; illegal: whether it was; repeated: whether it needed no new score.

    `scores.cache_hit` says whether a score was in the objective's memory, which depends on what was played before;
    `info["cache_hit"]` must not, so it is `repeated`."""

    def __init__(self, n: int, slots: int, turns: int | None = None) -> None:
        self.n, self.slots, self._most_turns = n, slots, turns
        self.scenes: list[Scene] = []
        self.scene = np.zeros(n, np.int64)
        self._weights, self._constants = np.zeros((2, n)), np.zeros((n, 2 + len(PAPER_SCHEMES)), np.float32)
        self._fidelity = np.full(n, None, object)
        self.chosen, self.failed = np.zeros((n, slots), np.bool_), np.zeros((n, slots), np.bool_)
        self.budget, self.turns = np.ones(n, np.int64), np.zeros(n, np.int64)
        self.scores = Scores(*np.zeros((6, n)), np.zeros(n, np.bool_))  # type: ignore[call-arg]
        self.gain = np.zeros(n)
        self.illegal, self.repeated = np.zeros(n, np.bool_), np.zeros(n, np.bool_)

    def begin(self, rows: Int64[np.ndarray, " m"], starts: list[Start]) -> None:
        """New games on these boards."""
        self.clear(rows, np.array([start.budget for start in starts]))
        for row, start in zip(rows.tolist(), starts, strict=True):
            if start.scene not in self.scenes:
                self.scenes.append(start.scene)
            self._enter(row, self.scenes.index(start.scene))
            self.failed[row] = start.failed

    def clear(self, rows: Int64[np.ndarray, " m"], budget: Int64[np.ndarray, " m"]) -> None:
        """Nothing chosen, no turns taken."""
        self.budget[rows] = budget
        self.chosen[rows] = self.failed[rows] = self.illegal[rows] = self.repeated[rows] = False
        self.turns[rows] = 0
        self.gain[rows] = 0.0
        for figure in self.scores:
            figure[rows] = 0

    def put(self, row: int, scene: Scene) -> None:
        """A scene of its own for a board."""
        self.scenes.extend([scene] * (row + 1 - len(self.scenes)))
        self.scenes[row] = scene
        self._enter(row, row)

    def _enter(self, row: int, index: int) -> None:
        objective = self.scenes[index].objective
        self.scene[row], self._fidelity[row], self._constants[row] = (
            index,
            objective.fidelity,
            self.scenes[index].constants,
        )
        self._weights[:, row] = objective.weights.comm, objective.weights.price

    def turn(self, playing: Bool[np.ndarray, " n"], chosen: Bool[np.ndarray, "n slots"]) -> None:
        """One turn on the boards that play: these sets are chosen now."""
        self.turns[playing] += 1
        changed = playing & (chosen != self.chosen).any(axis=1)
        before = self.scores.reward.copy()
        self.repeated = playing & ~changed
        self.chosen[changed] = chosen[changed]
        self.score(np.flatnonzero(changed))
        self.gain = np.where(playing, self.scores.reward - before, 0.0)

    def score(self, rows: Int64[np.ndarray, " m"]) -> None:
        """Score what is chosen on these boards."""
        for scene, some in self.by_scene(rows) if len(rows) else []:
            width = len(scene.objective.candidates)
            for figure, found in zip(self.scores, scene.objective.scores(self.chosen[some, :width]), strict=True):
                figure[some] = found

    @property
    def most_turns(self) -> Int64[np.ndarray, " n"]:
        """After which an episode is cut off."""
        return TURNS * self.budget if self._most_turns is None else np.full(self.n, self._most_turns)

    def by_scene(self, rows: Int64[np.ndarray, " m"] | None = None) -> list[tuple[Scene, Any]]:
        """The boards, or some of them, apart by scene: each scene and an index of its boards."""
        if len(self.scenes) == 1:
            return [(self.scenes[0], slice(None) if rows is None else rows)]
        rows = np.arange(self.n) if rows is None else rows
        return [(self.scenes[index], rows[self.scene[rows] == index]) for index in np.unique(self.scene[rows])]

    def allowed(self) -> Bool[np.ndarray, "n slots"]:
        """Which candidates may join: in order, within their link's capacity, on a free mount, while budget is left."""
        allowed = ~self.failed
        for scene, rows in self.by_scene():
            allowed[rows] &= ~scene.taken(self.chosen[rows])
            allowed[rows] &= scene.usable
        allowed &= (self.chosen.sum(axis=1) < self.budget)[:, None]
        return allowed

    def fitting(self, chosen: Bool[np.ndarray, "n slots"]) -> Bool[np.ndarray, " n"]:
        """Which of these sets may be built: in order, feasible, no larger than the budget."""
        fits = ~(chosen & self.failed).any(axis=1) & (chosen.sum(axis=1) <= self.budget)
        for scene, rows in self.by_scene():
            width = len(scene.objective.candidates)
            fits[rows] &= scene.objective.feasible(chosen[rows, :width]) & ~chosen[rows, width:].any(axis=1)
        return fits

    def observations(self, allowed: Bool[np.ndarray, "n slots"]) -> Float32[np.ndarray, "n size"]:
        """`STATIC` and `DYNAMIC` of each slot, feature after feature, then `GLOBAL`; all in -1..1. Price and kbit (in
        Mbit) of the chosen set come as x / (x + 8) and x / (x + 1), the budget as the former."""
        n, slots = self.n, self.slots
        whole = np.empty((n, (len(STATIC) + len(DYNAMIC)) * slots + len(GLOBAL)), np.float32)
        features = whole[:, : -len(GLOBAL)].reshape(n, -1, slots)
        covered = np.zeros(n)
        for scene, rows in self.by_scene():
            together, added = sights(scene.seen, self.chosen[rows])
            places = np.float32(max(1, scene.places))
            covered[rows] = together / places
            features[rows, : len(STATIC)], features[rows, len(STATIC)] = scene.static, added / places
        features[:, -2], features[:, -1] = self.chosen, allowed
        whole[:, -len(GLOBAL) :] = self._global(covered)
        return whole

    def info(self) -> dict[str, Any]:
        """What `step` tells beside the observation, an array (n, ...) each, `reward_terms` a dictionary of these."""
        comm, price = self._weights
        scores = self.scores
        return {
            "ap": scores.ap.copy(),
            "recall": scores.recall.copy(),
            "kbit": scores.kbit.copy(),
            "kbit_per_sensor": scores.kbit_per_sensor.copy(),
            "price": scores.price.copy(),
            "subset": self.chosen.copy(),
            "marginal_gain": self.gain.copy(),
            "reward_terms": {
                "ap": scores.ap.copy(),
                "comm": 0 - comm * scores.kbit_per_sensor,
                "price": 0 - price * scores.price,
            },
            "fidelity": self._fidelity.copy(),
            "cache_hit": self.repeated.copy(),
            "illegal": self.illegal.copy(),
        }

    def placed(self, row: int) -> tuple[Objective, list[int]]:
        """The objective of a board and the candidates chosen on it."""
        return self.scenes[self.scene[row]].objective, np.flatnonzero(self.chosen[row]).tolist()

    def _global(self, covered: np.ndarray) -> Float32[np.ndarray, "n size"]:
        scores, megabit = self.scores, self.scores.kbit_per_sensor / 1000
        whole = np.empty((self.n, len(GLOBAL)), np.float32)
        whole[:, 0] = 1 - self.chosen.sum(axis=1) / self.budget
        whole[:, 1] = self.budget / (self.budget + 8.0)
        whole[:, 2] = 1 - self.turns / self.most_turns
        whole[:, 3], whole[:, 4] = scores.ap, scores.recall
        whole[:, 5], whole[:, 6] = megabit / (megabit + 1), scores.price / (scores.price + 8)
        whole[:, 7], whole[:, 8:] = covered, self._constants
        return whole


def sights(
    seen: Shaped[np.ndarray, "words slots"], chosen: Bool[np.ndarray, "n slots"]
) -> tuple[Int64[np.ndarray, " n"], Shaped[np.ndarray, "n slots"]]:
    """How many places each set sees, and how many more with each candidate beside it."""
    together = np.zeros((len(chosen), len(seen)), np.uint64)
    board, slot = np.nonzero(chosen)
    np.bitwise_or.at(together, board, seen.T[slot])
    unseen = seen & ~together[:, :, None]
    added = np.add.reduce(np.bitwise_count(unseen), axis=1, dtype=np.int16)
    return np.bitwise_count(together).sum(axis=1, dtype=np.int64), added
