"""Rows of the paper's tables. Sensors go by the paper's numbers."""

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Literal, NamedTuple

SensorSet = tuple[int, ...]
Relation = Literal["is", "more than", "less than"]


class SchemeRow(NamedTuple):
    """Fusion scheme of table 1.

    ap: at IoU 0.7, 0.8 and 0.9; kbit: per sensor and frame; ms: on the authors' GPU."""

    ap: tuple[float, float, float]
    kbit: float
    ms: float


class SetRow(NamedTuple):
    """Sensor set of table 2: early and late AP."""

    sensors: SensorSet
    early: float
    late: float


class RegionRow(NamedTuple):
    """AP of table 3: early fusion in the region that both sensors of a pair have in view."""

    region: SensorSet
    sensors: SensorSet
    ap: float


class Statement(NamedTuple):
    """Figure that the paper's text gives or bounds."""

    of: Literal["no points", "below 300 points", "greatest recall", "precision at recall 0.95"]
    sensors: SensorSet
    relation: Relation
    value: float


class BenchmarkRow(NamedTuple):
    """Method of table 4: its reported AP with one sensor and with two sensors."""

    method: str
    single: tuple[float, ...]
    two: float | None = None


@dataclass(frozen=True)
class Listed:
    """Table 2 of one site, rows in the paper's order."""

    rows: tuple[SetRow, ...]

    @cached_property
    def best(self) -> dict[str, tuple[SensorSet, ...]]:
        """Best set of each size with early and with late fusion, most sensors first.

        With early fusion these are the rows in bold. The paper draws their PR curves and density
        curves."""
        sizes = [list(rows) for _, rows in groupby(self.rows, key=lambda row: len(row.sensors))]
        early = tuple(max(rows, key=lambda row: row.early).sensors for rows in sizes)
        late = tuple(max(rows, key=lambda row: row.late).sensors for rows in sizes)
        return {"early": early, "late": late}


def set_name(sensors: SensorSet) -> str:
    """Return the name of a sensor set, as the paper writes it."""
    return ",".join(map(str, sensors))
