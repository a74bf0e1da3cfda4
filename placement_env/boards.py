"""Boards: n games of choosing sensors side by side, what is chosen in each, its score, and what an agent sees of it.

The scalar environments play one board, the vector environments many, by the same rules in the same arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from placement_env.objective import SCHEMES, Objective, Scores
from placement_env.scenes import STATIC, Scene, Start
from toolkit.arrays import Bool, Float32, Int64, Shaped

DYNAMIC = ("marginal", "chosen", "allowed")
GLOBAL = (
    *("budget left", "budget", "turns left", "ap", "recall", "kbit per sensor", "price", "covered"),
    *("weight of kbit", "weight of price", *SCHEMES),
)
TURNS = 2  # for each sensor of the budget
AT_ONCE = 1 << 22  # words of what is seen that are looked at together


class Boards:
    """State of n games. chosen, failed: over the slots; budget: sensors to place; turns: taken; scores: of the chosen
    sets; gain: reward that the last turn added; illegal: whether it was; repeated: whether it needed no new score.

    `scores.cache_hit` says whether a score was in the objective's memory, which depends on what was played before;
    `info["cache_hit"]` must not, so it is `repeated`."""

    def __init__(self, n: int, slots: int, turns: int | None = None) -> None:
        self.n, self.slots, self._most_turns = n, slots, turns
        self.scenes: list[Scene] = []
        self.scene = np.zeros(n, np.int64)
        self.chosen, self.failed = np.zeros((n, slots), np.bool_), np.zeros((n, slots), np.bool_)
        self.budget, self.turns = np.ones(n, np.int64), np.zeros(n, np.int64)
        self.scores = Scores(*(np.zeros(n) for _ in range(6)), cache_hit=np.zeros(n, np.bool_))
        self.gain = np.zeros(n)
        self.illegal, self.repeated = np.zeros(n, np.bool_), np.zeros(n, np.bool_)

    def begin(self, rows: Int64[np.ndarray, " m"], starts: list[Start]) -> None:
        """New games on these boards."""
        self.clear(rows, np.array([start.budget for start in starts]))
        for row, start in zip(rows.tolist(), starts, strict=True):
            if start.scene not in self.scenes:
                self.scenes.append(start.scene)
            self.scene[row] = self.scenes.index(start.scene)
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
        self.scenes[row], self.scene[row] = scene, row

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
        for scene, some in self.by_scene(rows):
            width = len(scene.objective.candidates)
            for figure, found in zip(self.scores, scene.objective.scores(self.chosen[some, :width]), strict=True):
                figure[some] = found

    @property
    def most_turns(self) -> Int64[np.ndarray, " n"]:
        """After which an episode is cut off."""
        return TURNS * self.budget if self._most_turns is None else np.full(self.n, self._most_turns)

    def by_scene(self, rows: Int64[np.ndarray, " m"]) -> list[tuple[Scene, Int64[np.ndarray, " k"]]]:
        """The boards apart by scene."""
        if len(self.scenes) == 1:
            return [(self.scenes[0], rows)] if len(rows) else []
        return [(self.scenes[index], rows[self.scene[rows] == index]) for index in np.unique(self.scene[rows])]

    def allowed(self) -> Bool[np.ndarray, "n slots"]:
        """Which candidates may join: in order, within their link's capacity, on a free mount, while budget is left."""
        allowed = ~self.failed
        for scene, rows in self.by_scene(np.arange(self.n)):
            taken = np.zeros((len(rows), int(scene.mount.max()) + 1), np.bool_)
            board, slot = np.nonzero(self.chosen[rows])
            taken[board, scene.mount[slot]] = True
            allowed[rows] &= ~taken[:, scene.mount] & scene.usable
        return np.asarray(allowed & (self.chosen.sum(axis=1) < self.budget)[:, None])

    def fitting(self, chosen: Bool[np.ndarray, "n slots"]) -> Bool[np.ndarray, " n"]:
        """Which of these sets may be built: in order, feasible, no larger than the budget."""
        fits = ~(chosen & self.failed).any(axis=1) & (chosen.sum(axis=1) <= self.budget)
        for scene, rows in self.by_scene(np.arange(self.n)):
            width = len(scene.objective.candidates)
            fits[rows] &= scene.objective.feasible(chosen[rows, :width]) & ~chosen[rows, width:].any(axis=1)
        return fits

    def observations(self, allowed: Bool[np.ndarray, "n slots"]) -> Float32[np.ndarray, "n size"]:
        """`STATIC` and `DYNAMIC` of each slot, feature after feature, then `GLOBAL`; all in -1..1."""
        n, slots = self.n, self.slots
        seen = np.zeros((n, len(STATIC) + len(DYNAMIC), slots), np.float32)
        covered = np.zeros(n)
        for scene, rows in self.by_scene(np.arange(n)):
            together, added = sights(scene.seen, self.chosen[rows])
            covered[rows] = together / max(1, scene.places)
            seen[rows, : len(STATIC)] = scene.static
            seen[rows, len(STATIC)] = added / np.float32(max(1, scene.places))
        seen[:, -2], seen[:, -1] = self.chosen, allowed
        whole = (seen.reshape(n, -1), self._global(covered))
        return np.concatenate(whole, axis=1)

    def info(self) -> dict[str, Any]:
        """What `step` tells beside the observation, an array (n, ...) each, `reward_terms` a dictionary of these."""
        objectives = [self.scenes[index].objective for index in self.scene.tolist()]
        comm = np.array([objective.weights.comm for objective in objectives])
        price = np.array([objective.weights.price for objective in objectives])
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
                "comm": -comm * scores.kbit_per_sensor,
                "price": -price * scores.price,
            },
            "fidelity": np.array([objective.fidelity for objective in objectives], object),
            "cache_hit": self.repeated.copy(),
            "illegal": self.illegal.copy(),
        }

    def placed(self, row: int) -> tuple[Objective, list[int]]:
        """The objective of a board and the candidates chosen on it."""
        return self.scenes[self.scene[row]].objective, np.flatnonzero(self.chosen[row]).tolist()

    def _global(self, covered: np.ndarray) -> Float32[np.ndarray, "n size"]:
        objectives = [self.scenes[index].objective for index in self.scene.tolist()]
        weights = np.array([(1000 * o.weights.comm, o.weights.price) for o in objectives])
        scheme = np.array([[o.scheme == name for name in SCHEMES] for o in objectives])
        size, scores = self.chosen.sum(axis=1), self.scores
        left = np.stack([1 - size / self.budget, self.budget / (self.budget + 8.0), 1 - self.turns / self.most_turns])
        megabit = scores.kbit_per_sensor / 1000
        figures = [scores.ap, scores.recall, megabit / (megabit + 1), scores.price / (scores.price + 8), covered]
        whole = np.concatenate([left, figures, (weights / (weights + 1)).T, scheme.T])
        return np.clip(whole.T, -1, 1).astype(np.float32)


def sights(
    seen: Shaped[np.ndarray, "slots words"], chosen: Bool[np.ndarray, "n slots"]
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, "n slots"]]:
    """How many places each set sees, and how many more with each candidate beside it."""
    together = np.zeros((len(chosen), seen.shape[1]), np.uint64)
    board, slot = np.nonzero(chosen)
    np.bitwise_or.at(together, board, seen[slot])
    added = np.empty(chosen.shape, np.int64)
    step = max(1, AT_ONCE // seen.size)
    for first in range(0, len(chosen), step):
        fresh = seen & ~together[first : first + step, None]
        added[first : first + step] = np.bitwise_count(fresh).sum(axis=2, dtype=np.int64)
    return np.bitwise_count(together).sum(axis=1, dtype=np.int64), added
