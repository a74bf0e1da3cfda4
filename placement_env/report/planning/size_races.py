"""Races among the sets of one size, from the largest size down.

Sets of one size race each other until the best is known well enough (`contest`), or all are surely
far behind the best of larger sizes. Still smaller sizes do not race. The winner of each size,
and others near the best of all, are judged on all frames."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from placement_env.racing import Contest
from placement_env.report.planning.judged_options import JudgedOptions
from placement_env.search.portfolio.evaluators import race_order
from placement_env.search.portfolio.reward_race import contest, find_finalists
from toolkit.arrays import Int64
from toolkit.runtime.parallel import return_freed_memory
from toolkit.runtime.run import Run

MAX_RACED_FRAMES = 60  # frames of a race
NEAR_AP = 0.03  # below the best of a race, which further frames may make up for


class SizeRace(NamedTuple):
    """Race of the sets of one size, and the winner's row among all entrants.

    Rows of the race itself count only the sets of this size."""

    race: Contest
    winner: int


@dataclass(frozen=True)
class SizeRaces:
    """Races of all sizes, filled in place by `race_sizes`.

    A row is the index of a set among all entrants.

    Attributes:
        by_size: Races that were run, by number of sensors.
        winners: Row of the winner of each size, the largest size first. A size without a race has
            the set with the highest prediction.
        close_sets: Expected AP and row of the finalists of all races."""

    by_size: dict[int, SizeRace]
    winners: list[int]
    close_sets: list[tuple[float, int]]

    @property
    def min_expected(self) -> float:
        """Expected AP from which a set is near the best of all races; -inf before the first."""
        return max(self.close_sets)[0] - NEAR_AP if self.close_sets else -math.inf

    def list_rows(self) -> list[int]:
        """List the rows of all winners, and of finalists near the best of all races.

        Each row appears once, winners first."""
        near_rows = [row for expected, row in self.close_sets if expected >= self.min_expected]
        return list(dict.fromkeys([*self.winners, *near_rows]))


def race_sizes(options: JudgedOptions, confidence: float, run: Run) -> SizeRaces:
    """Race the sets of each number of sensors, the largest number first.

    Once the winner of a size is more than `NEAR_AP` behind the best of all, smaller sets fall
    further behind: each of their sizes then gets its set with the highest prediction as winner,
    without a race.

    Args:
        options: Entrants with their judge.
        confidence: Confidence at which a race ends.
        run: Gives the seed and reports the sizes done."""
    entrants = options.entrants
    races = SizeRaces(by_size={}, winners=[], close_sets=[])
    sizes = entrants.sets.sum(axis=1)
    different_sizes = np.unique(sizes)[::-1]  # the largest first
    report = run.stage("set sizes compared", len(different_sizes))
    winner_ap = math.inf  # expected AP of the last race's winner
    for step, size in enumerate(different_sizes, 1):
        size_rows = np.flatnonzero(sizes == size)
        # `min_expected`: expected AP from which a set is near the best of all races
        if winner_ap < races.min_expected:
            best = size_rows[int(entrants.predicted[size_rows].argmax())]
            races.winners.append(int(best))
        else:
            race = _race_size(options, size_rows, races, confidence, run.seed)
            return_freed_memory()  # detection leaves gaps in the heap
            winner_ap = float(race.expected[0])
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
        target=races.min_expected,
    )
    rows = size_rows[race.ranking]  # indices among all entrants, best first
    winner = int(rows[0])
    order = race_order(options.judge.frames, seed=seed)
    finalists = find_finalists(race, sets[rows], evaluator, order)
    expected_aps = race.expected[finalists].tolist()
    races.close_sets.extend(zip(expected_aps, rows[finalists].tolist(), strict=True))
    races.winners.append(winner)
    races.by_size[int(sets[winner].sum())] = SizeRace(race, winner)
    return race
