"""Figures that the paper reports in its evaluation, each with its table, figure or section.

Arnold, Dianati, de Temple and Fallah: Cooperative Perception for 3D Object Detection in Driving Scenarios Using
Infrastructure Sensors, IEEE T-ITS 2020, arXiv 1912.12147. Sensors go by the paper's numbers, which are those of the
built-in sites. AP at IoU 0.7 unless stated otherwise; shares of vehicles between 0 and 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import Literal, NamedTuple

PAPER_SITES = ("tjunction", "roundabout")
TEST_FRAMES = 1000  # of each test collection, section III
DEPTH_NOISE = 0.015  # m, section III
PLACE_NAMES = {"tjunction": "T-junction", "roundabout": "roundabout"}

SensorSet = tuple[int, ...]
Relation = Literal["is", "more than", "less than"]


class SchemeRow(NamedTuple):
    """Fusion scheme of table 1: AP at IoU 0.7, 0.8 and 0.9, kbit per sensor and frame, ms on the authors' GPU."""

    ap: tuple[float, float, float]
    kbit: float
    ms: float


class SetRow(NamedTuple):
    """Sensor set of table 2: early and late AP."""

    sensors: SensorSet
    early: float
    late: float


class RegionRow(NamedTuple):
    """AP of table 3: early fusion with these sensors in the region that both sensors of a pair have in view."""

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
    """Method of table 4: its reported AP with one sensor and with two."""

    method: str
    single: tuple[float, ...]
    two: float | None


SCHEME_TABLE: dict[str, dict[str, SchemeRow]] = {
    "tjunction": {
        "late": SchemeRow((0.8181, 0.6259, 0.07072), 0.51, 298.0),
        "hybrid": SchemeRow((0.8903, 0.7056, 0.07277), 64.0, 380.0),
        "early": SchemeRow((0.9870, 0.9447, 0.3861), 516.0, 380.0),
    },
    "roundabout": {
        "late": SchemeRow((0.8143, 0.5986, 0.01762), 0.26, 214.0),
        "hybrid": SchemeRow((0.8398, 0.6289, 0.02013), 372.0, 299.0),
        "early": SchemeRow((0.9670, 0.8816, 0.04638), 674.0, 299.0),
    },
}

_SETS = {  # sensors, AP early, AP late
    "tjunction": """
        012345 0.9870 0.8181
        01345 0.9441 0.7611   01235 0.9348 0.6672   12345 0.9327 0.7914
        1345 0.8653 0.7336    0125 0.8596 0.4765    0134 0.8394 0.6827
        025 0.7123 0.4039     235 0.6938 0.5834     345 0.6837 0.6656
        34 0.5365 0.5361      23 0.4591 0.4530      25 0.4453 0.3309
        4 0.2862 0.2862       3 0.2512 0.2512       2 0.2013 0.2013
    """,
    "roundabout": """
        01234567 0.9670 0.8143
        0123567 0.9385 0.7904   1234567 0.9340 0.7868   0134567 0.9307 0.7834
        123567 0.9050 0.7627    123457 0.9017 0.7627    012357 0.8973 0.7664
        12357 0.8678 0.7385     13567 0.8610 0.7314     13457 0.8576 0.7313
        1357 0.8231 0.7069      1237 0.7356 0.6557      1347 0.7263 0.6482
        137 0.6892 0.6230       357 0.6713 0.5831       135 0.6382 0.5861
        37 0.5016 0.4594        13 0.4995 0.4998        57 0.4664 0.4638
        3 0.2811 0.2811         5 0.2596 0.2596         1 0.2151 0.2151
    """,
}

_REGIONS = {  # pair of sensors: AP of the first, of the second, of both
    "tjunction": {(1, 5): (0.4717, 0.3222, 0.8722), (2, 4): (0.5621, 0.7942, 0.9560)},
    "roundabout": {(1, 7): (0.1474, 0.8874, 0.8925), (3, 5): (0.3944, 0.8819, 0.8996)},
}
REGION_TABLE: dict[str, tuple[RegionRow, ...]] = {
    site: tuple(
        RegionRow(pair, sensors, ap)
        for pair, aps in pairs.items()
        for sensors, ap in zip((pair[:1], pair[1:], pair), aps, strict=True)
    )
    for site, pairs in _REGIONS.items()
}

CURVE_STATEMENTS: dict[str, tuple[Statement, ...]] = {  # section IV-C, on the PR curves
    "tjunction": (
        Statement("greatest recall", (4,), "is", 0.30),
        Statement("greatest recall", (0, 1, 2, 3, 4, 5), "more than", 0.95),
        Statement("precision at recall 0.95", (0, 1, 2, 3, 4, 5), "more than", 0.95),
    ),
    "roundabout": (
        Statement("greatest recall", (3,), "more than", 0.30),
        Statement("greatest recall", (0, 1, 2, 3, 4, 5, 6, 7), "more than", 0.95),
        Statement("precision at recall 0.95", (0, 1, 2, 3, 4, 5, 6, 7), "more than", 0.95),
    ),
}

DENSITY_STATEMENTS: dict[str, tuple[Statement, ...]] = {  # section IV-E; the roundabout has none
    "tjunction": (
        Statement("no points", (4,), "more than", 0.60),
        Statement("no points", (3, 4), "more than", 0.30),
        Statement("no points", (0, 2, 5), "is", 0.0),
        Statement("below 300 points", (0, 2, 5), "is", 0.90),
    ),
    "roundabout": (),
}

IOU_BINS = 200  # uniform bins of point density, section IV-E
POOR_BELOW, GOOD_ABOVE = 70, 100  # points: "accuracy below 70 is poor, but increases significantly above 100"

BENCHMARK_TABLE = (
    BenchmarkRow("VoxelNet, KITTI easy, moderate, hard", (0.8197, 0.6546, 0.6285), None),
    BenchmarkRow("Cooper", (0.1960,), 0.7237),
    BenchmarkRow("F-Cooper, road intersection, far", (0.1960,), 0.7237),
    BenchmarkRow("the paper, early fusion, T-junction", (0.4717,), 0.8722),
)
BENCHMARK_PAIR: dict[str, SensorSet] = {"tjunction": (1, 5), "roundabout": (1, 7)}  # single: the first of the pair


@dataclass(frozen=True)
class Listed:
    """Table 2 of one site, rows in the paper's order."""

    rows: tuple[SetRow, ...]

    @cached_property
    def best(self) -> dict[str, tuple[SensorSet, ...]]:
        """Best set of each size with early and with late fusion, most sensors first.

        With early fusion these are the rows in bold; the paper draws PR curves and density curves of them.
        """
        sizes = [list(rows) for _, rows in groupby(self.rows, key=lambda row: len(row.sensors))]
        early, late = (tuple(max(rows, key=itemgetter(at)).sensors for rows in sizes) for at in (1, 2))
        return {"early": early, "late": late}


def sensor_sets(site: str) -> Listed:
    """Table 2 of a site.

    >>> sensor_sets("tjunction").best["early"][-2:]
    ((3, 4), (4,))
    """
    words = _SETS[site].split()
    sets = [tuple(map(int, word)) for word in words[::3]]
    return Listed(tuple(map(SetRow, sets, map(float, words[1::3]), map(float, words[2::3]))))


def set_name(sensors: SensorSet) -> str:
    """Name of a sensor set, as the paper writes it.

    >>> set_name((0, 2, 5))
    '0,2,5'
    """
    return ",".join(map(str, sensors))
