"""Races among the sets of one size, from the largest size down.

Sets of one size race each other until the best is known well enough (`contest`). A size contends
if its winner is expected within `NEAR_TIE_AP` of the best of all sizes: only then can the winner
be the answer. Sizes below one that does not contend do not race. The sets of contending sizes near
the best are judged on all frames, the winners of the other sizes in a sample."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from placement_env.racing import Contest
from placement_env.report.planning.judged_options import JudgedOptions
from placement_env.search.portfolio.evaluators import race_order
from placement_env.search.portfolio.reward_race import NEAR_AP, NEAR_TIE_AP, contest, find_finalists
from toolkit.arrays import Int64
from toolkit.runtime.allocation import return_freed_memory
from toolkit.runtime.run import Run

MAX_RACED_FRAMES = 60  # frames of a race


class Finalist(NamedTuple):
    """Set that ended its race near the front.

    Attributes:
        expected: Expected AP.
        row: Row among all entrants."""

    expected: float
    row: int


class SizeRace(NamedTuple):
    """Race of the sets of one size, with its best sets.

    Rows of the race itself count only the sets of this size.

    Attributes:
        race: The race.
        winner: Row of the winner among all entrants.
        finalists: The winner and its likeliest rivals."""

    race: Contest
    winner: int
    finalists: list[Finalist]


@dataclass(frozen=True)
class SizeRaces:
    """Races of all sizes, filled in place by `race_sizes`.

    A row is the index of a set among all entrants.

    Attributes:
        by_size: Races that were run, by number of sensors.
        winners: Row of the winner of each size, the largest size first. A size without a race has
            the set with the highest prediction."""

    by_size: dict[int, SizeRace]
    winners: list[int]

    @property
    def best(self) -> Finalist:
        """The set of all races with the highest expected AP; -inf and row -1 before the first."""
        finalists = [finalist for race in self.by_size.values() for finalist in race.finalists]
        return max(finalists, default=Finalist(-math.inf, -1))

    def contends(self, race: Contest) -> bool:
        """True if the winner of a race is expected within `NEAR_TIE_AP` of the best of all."""
        return bool(race.expected[0] >= self.best.expected - NEAR_TIE_AP)

    def list_rows(self) -> list[int]:
        """List the rows of the finalists of contending sizes that are near the best of all.

        Each row appears once, winners are always included."""
        min_ap = self.best.expected - NEAR_AP
        rows: list[int] = []
        for race, winner, finalists in self.by_size.values():
            if self.contends(race):
                rows.append(winner)
                rows += [finalist.row for finalist in finalists if finalist.expected >= min_ap]
        return list(dict.fromkeys(rows))

    def list_rows_behind(self) -> list[int]:
        """List the rows of the winners of sizes that do not contend."""
        rows = self.list_rows()
        return [winner for winner in self.winners if winner not in rows]


def race_sizes(options: JudgedOptions, confidence: float, run: Run) -> SizeRaces:
    """Race the sets of each number of sensors, the largest number first.

    Once a size does not contend, smaller sets fall further behind: each of their sizes then gets
    its set with the highest prediction as winner, without a race.

    Args:
        options: Entrants with their judge.
        confidence: Confidence at which a race ends.
        run: Gives the seed and reports the sizes done."""
    entrants = options.entrants
    races = SizeRaces(by_size={}, winners=[])
    sizes = entrants.sets.sum(axis=1)
    different_sizes = np.unique(sizes)[::-1]  # the largest first
    report = run.stage("set sizes compared", len(different_sizes))
    contends = True  # the last size that raced
    for step, size in enumerate(different_sizes, 1):
        size_rows = np.flatnonzero(sizes == size)
        if contends:
            race = _race_size(options, size_rows, races, confidence, run.seed)
            return_freed_memory()  # detection leaves gaps in the heap
            contends = races.contends(race)
        else:
            best = size_rows[int(entrants.predicted[size_rows].argmax())]
            races.winners.append(int(best))
        if report is not None:
            report(step)
    return races


def _race_size(
    options: JudgedOptions,
    size_rows: Int64[np.ndarray, " k"],
    races: SizeRaces,
    confidence: float,
    seed: int,
) -> Contest:
    """Race the sets of one size, and return the race.

    The race, its winner and its finalists are also added to `races`, which changes.

    Args:
        options: Entrants with their judge.
        size_rows: Indices of the sets of this size among all entrants, ascending.
        races: Races so far.
        confidence: Confidence at which the race ends.
        seed: Seed of the race and of the order of its frames."""
    sets = options.entrants.sets
    evaluator = options.judge.evaluator
    race = contest(
        options.objective,
        sets[size_rows],
        evaluator,
        confidence=confidence,
        seed=seed,
        frames=MAX_RACED_FRAMES,
        best_elsewhere=races.best.expected,
    )
    rows = size_rows[race.ranking]  # indices among all entrants, best first
    winner = int(rows[0])
    order = race_order(options.judge.frames, seed=seed)
    finalists = find_finalists(race, sets[rows], evaluator, order)
    finalist_aps = race.expected[finalists].tolist()
    finalist_rows = rows[finalists].tolist()
    races.winners.append(winner)
    races.by_size[int(sets[winner].sum())] = SizeRace(
        race, winner, finalists=[*map(Finalist, finalist_aps, finalist_rows)]
    )
    return race
