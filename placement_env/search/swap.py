"""Swap local search: change one sensor at a time until nothing improves, from greedy's answer and
others.

The set is taken as `budget` places, each with one sensor or none. A step scores every alternative
for one place at once and takes the best, so it may swap, add or drop a sensor. When no place can be
improved the set is a local optimum under such changes, and the search restarts from a random
set."""

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from placement_env.checks import check_whole
from placement_env.objective import Objective
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.greedy import grow
from placement_env.search.progress import Progress, add_each, as_rows
from placement_env.search.result import Certificate, Result

STARTS = 5
SECOND = 0.5  # chance of each further sensor, where mounts carry several and the drawn set has room
EMPTY = -1  # a place without a sensor


@dataclass
class Climb:
    """A climb in progress. before: best reward until it began; waiting: places (a candidate or
    `EMPTY`) to change."""

    start: int
    before: float
    places: list[int]
    waiting: list[int]
    reward: float


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    starts: int | None = None,
    start: Iterable[int | str] | None = None,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """The best local optimum of several starts: greedy's set or `start`, then sets drawn from
    `seed`.

    start: candidates by index or name; those that do not fit beside earlier ones are left out;
    starts: their number; None for as many as the limits allow, or `STARTS` without a limit;
    checkpoint: where the state of the search is kept. The certificate is "local optimum" where the
    neighbourhood of the best set was searched completely. Raises ValueError where `starts` is below
    1 and for an unknown candidate."""
    if starts is not None:
        check_whole("starts", starts, least=1)
    progress = Progress(objective, budget, seconds, evaluations)
    rng = np.random.default_rng(seed)
    if starts is None:
        starts = STARTS if seconds is None and evaluations is None else sys.maxsize
    first = 0
    proven = False
    climb = None

    def state() -> KeptState:
        now = {"progress": progress.state(), "rng": rng.bit_generator.state, "proven": proven}
        return now | ({} if climb is None else {"climb": vars(climb)})

    if (kept := checkpoint.load()) is not None:
        progress.resume(kept["progress"])
        rng.bit_generator.state = kept["rng"]
        proven = kept["proven"]
        climb = Climb(**kept["climb"])
        first = climb.start
    for number in range(first, starts):
        if climb is None:
            if progress.spent and number:
                break
            before = progress.reward if number else -np.inf
            chosen = draw_set(objective, budget, rng) if number else _first(progress, start)
            reward = float(progress.rewards(as_rows([chosen], progress.size))[0])
            places = chosen + [EMPTY] * (budget - len(chosen))
            climb = Climb(number, before, places, list(range(len(places))), reward)
        finished = _climb(progress, climb, rng, lambda: checkpoint.offer(state))
        proven = finished if progress.reward > climb.before else proven
        climb = None
    certificate = progress.unknown("stopped before all changes of one sensor were tried")
    if proven:
        certificate = Certificate(
            "local optimum", progress.reward, note="no set that differs in one sensor is better"
        )
    return progress.result("swap", certificate)


def _first(progress: Progress, start: Iterable[int | str] | None) -> list[int]:
    """Members of a given set that fit beside earlier ones; else the best set on greedy's way, the
    last if none pays."""
    if start is None:
        grown, _ = grow(progress)
        return np.flatnonzero(progress.best).tolist() or grown
    objective = progress.objective
    fitting = list[int]()
    members = np.flatnonzero(objective.row(start))
    first = np.isin(objective.candidates.mount[members], objective.kept)
    for member in [*members[first].tolist(), *members[~first].tolist()]:
        if len(fitting) < progress.budget and objective.next_allowed(fitting)[member]:
            fitting.append(member)
    return (
        fitting
        if objective.keeps(objective.row(fitting)[None])[0]
        else grow(progress, start=fitting)[0]
    )


def _climb(
    progress: Progress, climb: Climb, rng: np.random.Generator, between: Callable[[], None]
) -> bool:
    """Change places one by one until none improves; True if this ended before the limits did."""
    places = climb.places
    while climb.waiting:
        between()
        place = climb.waiting.pop(0)
        others = [c for i, c in enumerate(places) if i != place and c != EMPTY]
        options = np.flatnonzero(progress.objective.allowed(others))
        subsets = np.vstack(
            [as_rows([others], progress.size), add_each(others, options, progress.size)]
        )
        keeps = progress.objective.keeps(subsets)
        options = np.r_[EMPTY, options][keeps]
        rewards = progress.rewards(subsets[keeps])
        best = int(rewards.argmax()) if len(rewards) else 0
        if len(rewards) and rewards[best] > climb.reward:
            climb.reward = float(rewards[best])
            places[place] = int(options[best])
            climb.waiting = [i for i in rng.permutation(len(places)).tolist() if i != place]
        if not np.isfinite(rewards).all():
            return False
    if climb.reward == progress.reward:  # among equal sets the one whose neighbourhood was searched
        progress.best = as_rows([[c for c in places if c != EMPTY]], progress.size)[0]
    return True


def draw_set(objective: Objective, budget: int, rng: np.random.Generator) -> list[int]:
    """Random feasible set: mounts in random order, those to be kept first, an affordable candidate
    of each."""
    candidates = objective.candidates
    free = np.flatnonzero(objective.allowed([]))
    mount = candidates.mount[free]
    chosen: list[int] = []
    places = rng.permutation(np.unique(mount))
    for place in places[np.argsort(~np.isin(places, objective.kept), kind="stable")].tolist():
        options = free[mount == place]
        options = options[objective.next_allowed(chosen)[options]]
        if len(chosen) < budget and options.size:
            chosen.append(int(rng.choice(options)))
    while candidates.several and len(chosen) < budget and rng.random() < SECOND:
        options = np.flatnonzero(objective.allowed(chosen))
        if not options.size:
            break
        chosen.append(int(rng.choice(options)))
    return chosen
