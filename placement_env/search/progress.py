"""Scoring of sets for one search within limits, with the incumbent, the best feasible set so
far."""

import time
from collections.abc import Sequence

import numpy as np

from placement_env.checks import check_whole
from placement_env.objective import Objective, Score, Scores
from placement_env.search.checkpoint import KeptState
from placement_env.search.result import Certificate, History, Result
from placement_env.subsets import Sets
from toolkit.arrays import Float64, Int

MAX_BLOCK = 4096  # sets scored between two looks at the clock
PACE_S = 0.5  # approximate time of scoring between two looks at the clock
FLOAT_FIELDS = 6  # first fields of `Scores`; the last one is boolean


class Limits:
    """Limits of a search, and its history so far. Raises ValueError for a limit of 0 or less.

    Attributes:
        started: Begin of the search by the monotonic clock (s), earlier by the time that an
            interrupted search took.
        seconds: Time limit, infinite for none.
        evaluations: Most sets to score, infinite for no limit.
        count: Sets scored so far.
        rows: Number of scored sets, seconds and reward at each improvement."""

    def __init__(self, seconds: float | None, evaluations: int | None) -> None:
        """Begin now. None for no limit; raises ValueError for a limit of 0 or less."""
        for name, limit in (("seconds", seconds), ("evaluations", evaluations)):
            if limit is not None and not limit > 0:
                raise ValueError(f"{name} must be above 0, got {limit}: leave it out for no limit")
        self.started = time.monotonic()
        self.seconds = np.inf if seconds is None else float(seconds)
        self.evaluations = np.inf if evaluations is None else int(evaluations)
        self.count = 0  # sets scored so far
        # number of scored sets, seconds and reward at each improvement
        self.rows: list[tuple[int, float, float]] = []

    @property
    def elapsed(self) -> float:
        """Seconds since the search began."""
        return time.monotonic() - self.started

    @property
    def spent(self) -> bool:
        """True if a limit is reached."""
        return self.count >= self.evaluations or self.elapsed >= self.seconds

    def record(self, reward: float, *, at: int | None = None) -> None:
        """Record a new best reward. at: number of sets scored by then, None for `count`."""
        self.rows.append((self.count if at is None else at, self.elapsed, reward))

    def state(self) -> KeptState:
        """JSON values for a checkpoint, from which `resume` continues."""
        return {"count": self.count, "elapsed": self.elapsed, "rows": self.rows}

    def resume(self, state: KeptState) -> None:
        """Resume from a checkpoint. Earlier sets and seconds count too."""
        self.count = int(state["count"])
        self.started = time.monotonic() - float(state["elapsed"])
        self.rows = [
            (int(count), float(seconds), float(reward)) for count, seconds, reward in state["rows"]
        ]

    def history(self, reward: float) -> History:
        """Improvements so far, and the end as a last row. reward: best reward in the end."""
        rows = [*self.rows, (self.count, self.elapsed, reward)]
        return History(
            evaluations=np.array([count for count, _, _ in rows], np.int64),
            seconds=np.array([seconds for _, seconds, _ in rows], np.float64),
            reward=np.array([row_reward for _, _, row_reward in rows], np.float64),
        )


class Progress:
    """Score sets and keep the best feasible one of at most `budget` candidates.

    It begins with the empty set, reward 0. If poles must carry a sensor, the empty set is worse
    than any other. A limit in seconds is kept to about `PACE_S`, or the time of one set.

    Attributes:
        objective: Objective that scores the sets.
        budget: Largest number of sensors.
        size: Number of candidates.
        limits: Limits and history.
        best: The best set so far, a row of booleans.
        reward: Its reward.
    """

    def __init__(
        self, objective: Objective, budget: int, seconds: float | None, evaluations: int | None
    ) -> None:
        """Begin with the empty set as incumbent.

        Args:
            objective: Objective that scores the sets.
            budget: Largest number of sensors.
            seconds: Time limit, None for none.
            evaluations: Most sets to score, None for no limit.

        Raises ValueError for limits that do not fit."""
        check_whole("budget", budget, least=1)
        objective.setting.check_budget(budget)
        self.objective = objective
        self.budget = budget
        self.size = len(objective.candidates)
        self.limits = Limits(seconds, evaluations)
        self.best = np.zeros(self.size, bool)
        # the empty set is no answer if poles must carry a sensor
        self.reward = -np.inf if len(objective.kept) else 0.0
        self._block = 1  # sets to score next, adapted so that they take about `PACE_S`

    @property
    def spent(self) -> bool:
        """True if a limit is reached."""
        return self.limits.spent

    def state(self) -> KeptState:
        """JSON values for a checkpoint, from which `resume` continues."""
        return {
            "limits": self.limits.state(),
            "best": np.flatnonzero(self.best).tolist(),
            "reward": self.reward,
        }

    def resume(self, state: KeptState) -> None:
        """Resume from a checkpoint. The incumbent is scored once more to restore its score."""
        self.limits.resume(state["limits"])
        self.best = as_rows([state["best"]], self.size)[0]
        self.reward = float(state["reward"])
        self.objective.scores(self.best[None])  # scored again, so that it is in memory

    def figures(self, subsets: Sets) -> Scores:
        """Scores of sets, feasible or not; the best feasible one is kept as incumbent.

        Sets that the limits leave out have reward -inf, and NaN in all other figures. Sets are
        scored in blocks, whose size follows the pace of scoring."""
        n = len(subsets)
        # the float fields of `figures` are views of the rows of `columns`, filled block by block
        columns = np.full((FLOAT_FIELDS, n), np.nan)
        figures = Scores(*columns, np.zeros(n, np.bool_))  # type: ignore[call-arg]
        figures.reward[:] = -np.inf
        done = 0  # sets scored in this call
        while done < n and not self.spent:
            block = int(min(n - done, self._block, self.limits.evaluations - self.limits.count))
            rows = slice(done, done + block)
            began = time.monotonic()
            columns[:, rows] = self.objective.scores(subsets[rows])[:FLOAT_FIELDS]
            duration_s = max(time.monotonic() - began, 1e-9)  # one set may take 0.1 ms, or a minute
            next_s = min(PACE_S, max(0.0, self.limits.seconds - self.limits.elapsed))
            affordable_sets = next_s * block / duration_s
            # at most fourfold growth, as the pace of a small block is uncertain
            self._block = int(np.clip(affordable_sets, 1, min(MAX_BLOCK, 4 * self._block)))
            self._update_incumbent(subsets[rows], figures.reward[rows])
            self.limits.count += block
            done += block
        return figures

    def rewards(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Rewards of sets, -inf beyond the limits."""
        return self.figures(subsets).reward

    def settle(self, members: list[int]) -> None:
        """Make a set the answer, regardless of its score and the limits.

        members: indices of its candidates."""
        self.best = as_rows([members], self.size)[0]
        self.reward = float(self.objective.scores(self.best[None]).reward[0])
        self.limits.count += 1
        self.limits.record(self.reward)

    def result(
        self,
        method: str,
        certificate: Certificate,
        front: tuple[Score, ...] = (),
        by_size: tuple[Score, ...] = (),
    ) -> Result:
        """Incumbent as the answer of a search.

        Args:
            method: Name of the search.
            certificate: Proof of how good the answer is.
            front: Scored sets that no other beats in AP, kbit and price together.
            by_size: Best set of 1, 2, ... sensors."""
        best = self.objective.score(np.flatnonzero(self.best).tolist())
        return Result(
            method=method,
            best=best,
            history=self.limits.history(self.reward),
            certificate=certificate,
            evaluations=self.limits.count,
            seconds=self.limits.elapsed,
            front=front,
            by_size=by_size,
            origin=self.objective.describe_origin(best.subset),
        )

    def unknown(self, note: str) -> Certificate:
        """Certificate without any evidence. note: reason in words."""
        return Certificate("none", self.reward, note=note)

    def _update_incumbent(self, subsets: np.ndarray, rewards: np.ndarray) -> None:
        """Make the best feasible set the incumbent if it is better, and report it to the watcher.

        subsets: sets scored now, not yet in `limits.count`; rewards: their rewards."""
        better_rows = np.flatnonzero(rewards > self.reward)
        previous_reward = self.reward
        if better_rows.size:
            is_small_enough = subsets[better_rows].sum(axis=1) <= self.budget
            is_valid = self.objective.feasible(subsets[better_rows]) & is_small_enough
            # one after another, so that batch size does not change the history
            for row in better_rows[is_valid].tolist():
                if rewards[row] > self.reward:
                    self.best = subsets[row].copy()
                    self.reward = float(rewards[row])
                    self.limits.record(self.reward, at=self.limits.count + row + 1)
        if self.reward > previous_reward and self.objective.watch is not None:
            members = tuple(np.flatnonzero(self.best).tolist())
            self.objective.watch(members, self.reward, 0)  # 0 frames: not in a race


def as_rows(sets: Sequence[Sequence[int]], size: int) -> Sets:
    """Sets of indices as rows of booleans, sets × candidates.

    size: number of candidates, the length of a row."""
    rows = np.zeros((len(sets), size), bool)
    for row, members in zip(rows, sets, strict=True):
        row[list(members)] = True
    return rows


def add_each(members: Sequence[int], options: Int[np.ndarray, " n"], size: int) -> Sets:
    """Rows of booleans that each add one candidate to a set, in the order of the options.

    members: indices of the set's candidates; options: indices of the candidates to add; size:
    number of all candidates, the length of a row."""
    rows = np.zeros((len(options), size), bool)
    rows[:, list(members)] = True
    rows[np.arange(len(options)), options] = True
    return rows
