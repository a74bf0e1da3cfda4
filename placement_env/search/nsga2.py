"""The AP-kbit-price front over sets: NSGA-II (Deb et al. 2002, pymoo); exact, by enumeration, up to 16 candidates.

A child has each sensor of its two parents with probability 1/2, made feasible by leaving out what does not fit, and is
then changed in one sensor. The front is of all sets that were scored, not of the last generation alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from placement_env.checks import check_whole
from placement_env.objective import Objective
from placement_env.search.checkpoint import NOWHERE, Checkpoint, KeptState
from placement_env.search.exact import exhaustive
from placement_env.search.neighbourhood import Neighbourhood
from placement_env.search.progress import DEFAULT_EVALUATIONS, Figures, Progress, rows_of
from placement_env.search.result import Result

if TYPE_CHECKING:
    from pymoo.algorithms.moo.nsga2 import NSGA2

MEMBER_COLUMNS = ("X", "F", "rank", "crowding")  # of each member of a population


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    population: int = 100,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """The front of AP against kbit of the whole set against price, with at most `budget` sensors, and the set of most
    reward. Up to 16 candidates it is exact, with nothing random; beyond, without a limit, 20 000 sets are scored.

    checkpoint: where the state of the search is kept. Raises ValueError for a population below 2, and
    ImportError without pymoo.
    """
    check_whole("population", population, least=2)
    if len(objective.candidates) <= exhaustive.LARGEST:
        return exhaustive.search(objective, budget, seconds=seconds, evaluations=evaluations)
    if seconds is None and evaluations is None:
        evaluations = DEFAULT_EVALUATIONS
    progress = Progress(objective, budget, seconds, evaluations)
    rng = np.random.default_rng(seed)
    algorithm = _nsga2(Neighbourhood(objective, budget), progress.size, population, seed, rng)
    subsets, figures = np.zeros((0, progress.size), bool), Figures(*(np.zeros(0) for _ in range(4)))
    if (kept := checkpoint.load()) is not None:
        progress.resume(kept["progress"])
        rng.bit_generator.state = kept["rng"]
        subsets, figures = kept["subsets"], Figures(*kept["figures"])
        _restore(algorithm, kept)

    def state() -> KeptState:
        front = {"subsets": subsets, "figures": np.stack(figures)}
        return {"progress": progress.state(), "rng": rng.bit_generator.state} | front | _generation(algorithm)

    while not progress.spent:
        generation = algorithm.ask()
        if generation is None or not len(generation):  # every child is known already
            break
        rows = np.asarray(generation.get("X"), bool)
        fresh = progress.figures(rows)
        _tell(algorithm, generation, fresh)
        scored = np.isfinite(fresh.reward) & rows.any(axis=1)
        subsets = np.concatenate([subsets, rows[scored]])
        figures = Figures(*(np.concatenate([old, new[scored]]) for old, new in zip(figures, fresh, strict=True)))
        best = exhaustive.undominated(exhaustive.costs(figures))
        subsets, figures = subsets[best], Figures(*(column[best] for column in figures))
        checkpoint.offer(state)
    note = "NSGA-II proves nothing: other sets may beat those of its front"
    return progress.result("NSGA-II", progress.unknown(note), exhaustive.front(objective, subsets, figures))


def _tell(algorithm: NSGA2, generation: Any, figures: Figures) -> None:
    from pymoo.core.evaluator import Evaluator
    from pymoo.problems.static import StaticProblem

    costs = np.where(np.isnan(exhaustive.costs(figures)), 1e9, exhaustive.costs(figures))
    Evaluator().eval(StaticProblem(algorithm.problem, F=costs), generation)
    algorithm.tell(infills=generation)


def _generation(algorithm: NSGA2) -> KeptState:
    """What the next generation is made from, beside our own generator."""
    names = dict(zip(MEMBER_COLUMNS, algorithm.pop.get(*MEMBER_COLUMNS), strict=True))
    known = {name: np.asarray(column, np.float64) for name, column in names.items()}
    return known | {"iteration": algorithm.n_iter, "own rng": algorithm.random_state.bit_generator.state}


def _restore(algorithm: NSGA2, kept: KeptState) -> None:
    """An algorithm that was set up goes on from what `_generation` gave."""
    from pymoo.core.population import Population

    members = Population.new(X=kept["X"].astype(np.bool_), F=kept["F"])
    for name in MEMBER_COLUMNS[2:]:
        members.set(name, kept[name])
    for member in members:
        member.evaluated.update("F")
    algorithm.pop, algorithm.n_iter, algorithm.is_initialized = members, kept["iteration"], True
    algorithm.random_state.bit_generator.state = kept["own rng"]


def _nsga2(neighbourhood: Neighbourhood, size: int, population: int, seed: int, rng: np.random.Generator) -> NSGA2:
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.crossover import Crossover
        from pymoo.core.mutation import Mutation
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination
    except ImportError as error:
        raise ImportError("NSGA-II needs pymoo: pip install coview[search]") from error

    class Inherit(Crossover):  # type: ignore[misc]
        def _do(self, _: Any, parents: np.ndarray, **__: Any) -> np.ndarray:
            either = rng.random(parents.shape[1:]) < 0.5
            children = np.where(either, parents, parents[::-1]).reshape(-1, size)
            feasible = [neighbourhood.repair(np.flatnonzero(child).tolist(), rng) for child in children]
            return rows_of(feasible, size).reshape(parents.shape)

    class Change(Mutation):  # type: ignore[misc]
        def _do(self, _: Any, children: np.ndarray, **__: Any) -> np.ndarray:
            return rows_of([neighbourhood.neighbour(np.flatnonzero(child).tolist(), rng) for child in children], size)

    start = rows_of([_prefix(neighbourhood.sample(rng), rng) for _ in range(population)], size)
    algorithm = NSGA2(population, sampling=start, crossover=Inherit(2, 2), mutation=Change())
    problem = Problem(n_var=size, n_obj=3, xl=0, xu=1, vtype=bool)
    algorithm.setup(problem, termination=NoTermination(), seed=seed)
    return algorithm


def _prefix(chosen: list[int], rng: np.random.Generator) -> list[int]:
    """The first few of a set, of any number from 1 up, so that cheap sets are there from the start."""
    return chosen[: int(rng.integers(1, len(chosen) + 1))] if chosen else []
