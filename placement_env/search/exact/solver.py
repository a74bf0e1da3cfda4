"""OR-Tools' solver of integer programmes, with limits."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import CpSolver

SECONDS = 60.0  # default limit of solving


@dataclass(frozen=True)
class SolverLimits:
    """Limits of a solver. effort: OR-Tools' deterministic seconds, None for unlimited."""

    seconds: float = SECONDS
    seed: int = 0
    effort: float | None = None

    def build_solver(self) -> CpSolver:
        """A solver of one worker within these limits."""
        solver = cp_model().CpSolver()
        solver.parameters.max_time_in_seconds = self.seconds
        if self.effort is not None:
            solver.parameters.max_deterministic_time = self.effort
        solver.parameters.num_workers = 1
        solver.parameters.random_seed = self.seed
        solver.parameters.linearization_level = 2
        return solver


USUAL_LIMITS = SolverLimits()


def cp_model() -> ModuleType:
    """OR-Tools' module of the same name. Raises ImportError where it is missing."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise ImportError("CP-SAT needs OR-Tools: pip install coview[search]") from error
    return cp_model
