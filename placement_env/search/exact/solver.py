"""OR-Tools' solver of integer programmes, with limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpSolver


def build_solver(seconds: float, workers: int, seed: int, effort: float | None) -> CpSolver:
    """A solver with these limits; see `placement_env.search.exact.cpsat.search`."""
    solver = cp_model().CpSolver()
    solver.parameters.max_time_in_seconds = seconds
    if effort is not None:
        solver.parameters.max_deterministic_time = effort
    solver.parameters.num_workers = workers
    solver.parameters.random_seed = seed
    solver.parameters.linearization_level = 2
    return solver


def cp_model() -> Any:
    """OR-Tools' module of the same name. Raises ImportError where it is missing."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise ImportError("CP-SAT needs OR-Tools: pip install coview[search]") from error
    return cp_model
