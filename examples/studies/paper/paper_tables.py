"""Figures that the paper reports, and causes of differences from them, from `paper.toml`."""

from typing import Any

from examples.studies.paper.paper_rows import (
    BenchmarkRow,
    Listed,
    RegionRow,
    SchemeRow,
    SensorSet,
    SetRow,
    Statement,
)
from toolkit.runtime.text_values import read_own_table

PAPER_SITES = ("tjunction", "roundabout")
TEST_FRAMES = 1000  # in each test collection, section III
DEPTH_NOISE_M = 0.015  # section III
IOU_BINS = 200  # uniform bins of point density, section IV-E
# the paper: "accuracy below 70 is poor, but increases significantly above 100"
POOR_POINTS = 70
GOOD_POINTS = 100
PLACE_NAMES = {"tjunction": "T-junction", "roundabout": "roundabout"}


def _tuples(value: Any) -> Any:
    # lists, also in lists, as tuples
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


_PAPER = read_own_table(__file__, "paper.toml")
CAUSES: dict[str, str] = _PAPER["causes"]
BENCHMARK_TABLE = tuple(BenchmarkRow(*row) for row in _tuples(_PAPER["benchmarks"]))
BENCHMARK_PAIR: dict[str, SensorSet] = {}  # the single sensor is the first of the pair
SCHEME_TABLE: dict[str, dict[str, SchemeRow]] = {}
SET_TABLE: dict[str, tuple[SetRow, ...]] = {}
REGION_TABLE: dict[str, tuple[RegionRow, ...]] = {}
CURVE_STATEMENTS: dict[str, tuple[Statement, ...]] = {}
DENSITY_STATEMENTS: dict[str, tuple[Statement, ...]] = {}
for _site in PAPER_SITES:
    _tables = _PAPER[_site]
    BENCHMARK_PAIR[_site] = _tuples(_tables["pair"])
    SCHEME_TABLE[_site] = {
        scheme: SchemeRow(*_tuples(row)) for scheme, row in _tables["schemes"].items()
    }
    SET_TABLE[_site] = tuple(SetRow(*row) for row in _tuples(_tables["sets"]))
    REGION_TABLE[_site] = tuple(RegionRow(*row) for row in _tuples(_tables["regions"]))
    CURVE_STATEMENTS[_site] = tuple(Statement(*row) for row in _tuples(_tables["curves"]))
    DENSITY_STATEMENTS[_site] = tuple(Statement(*row) for row in _tuples(_tables["densities"]))


def sensor_sets(site: str) -> Listed:
    """Return table 2 of a site."""
    return Listed(SET_TABLE[site])
