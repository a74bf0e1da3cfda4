"""The solver keeps to its limits and seed."""

import pytest

pytest.importorskip("ortools")
from placement_env.search.exact.programme import SolverLimits, cp_model


def test_limits_and_seed_are_those_asked_for():
    parameters = SolverLimits(2.5, 7, 0.5).build_solver().parameters
    assert (parameters.max_time_in_seconds, parameters.num_workers, parameters.random_seed) == (2.5, 1, 7)
    assert parameters.max_deterministic_time == 0.5
    assert SolverLimits(1.0).build_solver().parameters.max_deterministic_time > 1e6


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ortools.sat.python", None)
    with pytest.raises(ImportError, match="pip install coview"):
        cp_model()
