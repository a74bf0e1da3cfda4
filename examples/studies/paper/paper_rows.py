"""Rows of the paper's tables. Sensors go by the paper's numbers."""

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Literal, NamedTuple

SensorSet = tuple[int, ...]
Relation = Literal["is", "more than", "less than"]


class SchemeRow(NamedTuple):
    """Fusion scheme of table 1.

    Attributes:
        ap: AP at IoU 0.7, 0.8 and 0.9.
        kbit: Data per sensor and frame.
        ms: Time per frame on the authors' GPU.
    """

    ap: tuple[float, float, float]
    kbit: float
    ms: float


class SetRow(NamedTuple):
    """Sensor set of table 2, with its AP by early and by late fusion."""

    sensors: SensorSet
    early: float
    late: float


class RegionRow(NamedTuple):
    """AP of table 3: early fusion in the region that both sensors of a pair have in view.

    Attributes:
        region: Pair of sensors.
        sensors: Sensors that are fused: the pair, or one of them.
        ap: AP at IoU 0.7.
    """

    region: SensorSet
    sensors: SensorSet
    ap: float


class Statement(NamedTuple):
    """Figure that the paper's text gives or bounds.

    Attributes:
        of: Figure: a share of vehicles by their points, or a value of the PR curve.
        sensors: Sensor set that it is about.
        relation: "is" for a figure, "more than" or "less than" for a bound.
        value: Figure or bound.
    """

    of: Literal["no points", "below 300 points", "greatest recall", "precision at recall 0.95"]
    sensors: SensorSet
    relation: Relation
    value: float


class BenchmarkRow(NamedTuple):
    """Method of table 4, with its reported AP.

    Attributes:
        method: Name of the method.
        single: Each AP reported with one sensor.
        two: AP with two sensors, None if not reported.
    """

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
