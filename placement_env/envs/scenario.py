"""Scenarios: what an episode takes place at, an objective with what of it an agent may observe.

A scenario pads its candidates to a number of slots, so that one policy meets sites with different numbers of them. What
a candidate sees is taken at up to `PLACES` places: vehicles of the traffic where it is known, else spots of the area.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from placement_env.candidates.candidates import Candidates, aims
from placement_env.fidelity.coverage import LEAST
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.detection.schemes import PAPER_SCHEMES

PLACES = 512
STATIC = ("x", "y", "z", "cos heading", "sin heading", "tilt", "field of view", "lidar", "price", "kbit", "seen")
REACH = 30.0  # m within which a sensor is taken to see the spots in its field of view, where no traffic is known


@dataclass(frozen=True, eq=False)
class Scenario:
    """An objective, its C candidates in `slots` slots."""

    objective: Objective
    slots: int

    def __post_init__(self) -> None:
        if len(self.objective.candidates) > self.slots:
            raise ValueError(
                f"the environment has slots for {self.slots} candidates, this site has "
                f"{len(self.objective.candidates)}: make it with slots={len(self.objective.candidates)}"
            )

    @cached_property
    def mount(self) -> Int64[np.ndarray, " slots"]:
        """Mount of each candidate; the empty slots share one of their own."""
        return padded(self.objective.candidates.mount, self.slots, fill=len(self.objective.candidates.mounts))

    @cached_property
    def mounts(self) -> int:
        """How many mounts there are, with that of the empty slots."""
        return int(self.mount.max()) + 1

    @cached_property
    def carried(self) -> Int64[np.ndarray, " mounts"]:
        """How many sensors each mount may carry."""
        return np.append(self.objective.candidates.places, 1)[: self.mounts]

    @cached_property
    def load(self) -> Float64[np.ndarray, " slots"] | None:
        """The share of its mount's link that each candidate takes, where links are shared; else None."""
        sent = self.objective.shared_links
        return None if sent is None else padded(sent / self.objective.candidates.capacity, self.slots)

    @cached_property
    def width(self) -> int:
        """How many candidates there are."""
        return len(self.objective.candidates)

    @cached_property
    def usable(self) -> Bool[np.ndarray, " slots"]:
        """Which slots hold a candidate whose link carries what it sends."""
        return padded(self.objective.linked, self.slots)

    @cached_property
    def seen(self) -> Shaped[np.ndarray, "words slots"]:
        """Which places each candidate sees, a bit each."""
        seen = self._places_seen
        whole = np.zeros((self.slots, PLACES), np.bool_)
        whole[: len(seen), : seen.shape[1]] = seen
        return np.ascontiguousarray(np.packbits(whole, axis=1).view(np.uint64).T)

    @cached_property
    def places(self) -> int:
        """How many places there are."""
        return self._places_seen.shape[1]

    @cached_property
    def _places_seen(self) -> Bool[np.ndarray, "C places"]:
        return places_seen(self.objective)

    @cached_property
    def static(self) -> Float32[np.ndarray, "features slots"]:
        """`STATIC` of each candidate, in -1..1; 0 in the empty slots. x and y are relative to the area, whose sides lie
        at ±0.5; z is in units of 20 m, tilt of a right angle, the field of view of a full turn; price and kbit are
        x / (x + 1) of the price, and of what is sent in Mbit; seen is a share of the places."""
        features = np.zeros((len(STATIC), self.slots), np.float32)
        own = np.bitwise_count(self.seen).sum(axis=0) / max(1, self.places)
        described = candidate_features(self.objective, own[: len(self.objective.candidates)])
        features[:, : described.shape[1]] = np.clip(described, -1, 1)
        return features

    @cached_property
    def constants(self) -> Float32[np.ndarray, "5"]:
        """The last of what is observed of the whole: weights, of a kbit in Mbit, as x / (x + 1), and the scheme."""
        weights = np.array([1000 * self.objective.weights.comm, self.objective.weights.price])
        scheme = [self.objective.scheme.name == name for name in PAPER_SCHEMES]
        return np.concatenate([weights / (weights + 1), scheme]).astype(np.float32)

    def failed_row(self, failed: Iterable[Any]) -> Bool[np.ndarray, " slots"]:
        """Candidates, given by index or name, as a row over the slots."""
        return padded(self.objective.row(failed), self.slots)


def places_seen(objective: Objective) -> Bool[np.ndarray, "C places"]:
    """Which of the places each candidate sees: vehicles with enough points on them, or spots of the area in view."""
    if objective.visibility is not None:
        points = objective.visibility.points
        some = np.unique(np.linspace(0, points.shape[1] - 1, PLACES).round().astype(np.int64))[: points.shape[1]]
        return np.asarray(points[:, some] >= LEAST)
    xmin, ymin, xmax, ymax = area_of(objective)
    x, y = np.meshgrid(np.linspace(xmin, xmax, 22), np.linspace(ymin, ymax, 22))
    positions, headings, _, widths, _ = poses(objective.candidates)
    dx, dy = x.ravel() - positions[:, :1], y.ravel() - positions[:, 1:2]
    bearing = np.angle(np.exp(1j * (np.arctan2(dy, dx) - headings[:, None])))
    return np.asarray((np.abs(bearing) <= widths[:, None] / 2) & (np.hypot(dx, dy) <= REACH))


def area_of(objective: Objective) -> Float64[np.ndarray, "4"]:
    """xmin ymin xmax ymax of the detection area, or of all mounts where the site is not known."""
    if objective.site is not None:
        return objective.site.area
    feet = np.array([mount.position[:2] for mount in objective.candidates.mounts])
    return np.concatenate([feet.min(axis=0) - 1, feet.max(axis=0) + 1])


def poses(candidates: Candidates) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each candidate position (C, 3), heading, tilt, horizontal field of view (rad), and whether it measures range,
    as a lidar does."""
    sensors = candidates.sensors
    lidar = np.array([sensor.model.measures == "range" for sensor in sensors], np.bool_)
    width = [sensor.model.horizontal_fov for sensor in sensors]
    return np.array([sensor.position for sensor in sensors]), *aims(sensors), np.array(width), lidar


def candidate_features(objective: Objective, seen: Float64[np.ndarray, " C"]) -> Float64[np.ndarray, "features C"]:
    """`STATIC` of each candidate; `seen`: the share of places that it sees."""
    position, heading, tilt, width, lidar = poses(objective.candidates)
    area = area_of(objective)
    middle, size = (area[:2] + area[2:]) / 2, area[2:] - area[:2]
    x, y = ((position[:, :2] - middle) / size).T
    price, megabit = objective.candidates.prices, objective.sent / 1000
    turned = (np.cos(heading), np.sin(heading), tilt / (np.pi / 2), width / (2 * np.pi))
    return np.stack([x, y, position[:, 2] / 20, *turned, lidar, price / (price + 1), megabit / (megabit + 1), seen])


def padded(row: Shaped[np.ndarray, " C"], slots: int, fill: int = 0) -> Shaped[np.ndarray, " slots"]:
    """A row over the candidates as one over the slots."""
    return np.concatenate([row, np.full(slots - len(row), fill, row.dtype)])
