"""Where traffic can be put on a SUMO network near a detection area, and the routes it takes from there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from toolkit.arrays import Bool, Float, Float64

SPACING = 2.0  # m between the places of a lane


@dataclass(frozen=True, eq=False)
class Lane:
    """A lane of the network. shape: (k, 2) middle line (m); following: lanes its links lead to, U-turns last."""

    name: str
    edge: str
    length: float
    shape: Float64[np.ndarray, "k 2"]
    forbidden: frozenset[str]
    following: tuple[str, ...]

    def at(self, offset: Float[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
        """Points of the middle line, `offset` (m, in SUMO's length of the lane) from its start."""
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.shape, axis=0).T))])
        stretched = offset * along[-1] / self.length
        return np.stack([np.interp(stretched, along, self.shape[:, axis]) for axis in (0, 1)], axis=-1)


@dataclass(frozen=True, eq=False)
class Places:
    """Places on lanes: the lane's name and length (m), the offset from its start (m), the point in the site frame."""

    lanes: tuple[str, ...]
    lengths: Float64[np.ndarray, " n"]
    offsets: Float64[np.ndarray, " n"]
    points: Float64[np.ndarray, "n 2"]

    def __len__(self) -> int:
        return len(self.lanes)


@dataclass(frozen=True, eq=False)
class Roads:
    """The lanes of a network, junctions' inner lanes left out, by name."""

    lanes: Mapping[str, Lane]

    @staticmethod
    def read(sumo: Any) -> Roads:
        """The roads of the network that SUMO runs."""
        names = [name for name in sumo.lane.getIDList() if not name.startswith(":")]
        return Roads({name: _read_lane(sumo.lane, name) for name in names})

    def places(self, area: Float64[np.ndarray, "4"], reach: float, vehicle_class: str) -> Places:
        """Where a vehicle or pedestrian of this SUMO class can start so that it is in the area now or soon: within
        `reach` (m) of it and, outside, headed for it. Pedestrians start on lanes of their own and walk either way.
        """
        walks = vehicle_class == "pedestrian"
        names, offsets, points = [], [np.zeros(0)], [np.zeros((0, 2))]
        for lane in self.lanes.values():
            if vehicle_class in lane.forbidden or (walks and "passenger" not in lane.forbidden):
                continue
            along = np.arange(SPACING / 2, lane.length, SPACING)
            xy = lane.at(along)
            ahead = lane.at(along + SPACING) - lane.at(along - SPACING)
            useful = _near(xy, area, reach) & (walks | _headed_for(xy, ahead, area))
            names += [lane.name] * int(useful.sum())
            offsets.append(along[useful])
            points.append(xy[useful])
        return Places(
            tuple(names),
            np.array([self.lanes[name].length for name in names]),
            np.concatenate(offsets),
            np.concatenate(points),
        )

    def route(self, start: str, vehicle_class: str, distance: float, rng: np.random.Generator) -> list[str]:
        """Edges of a random drive from lane `start` on, at least `distance` (m) beyond it or to where the road ends."""
        lane, edges, driven = self.lanes[start], [self.lanes[start].edge], 0.0
        while driven < distance:
            choices = self._onward(lane, vehicle_class)
            if not choices:
                break
            lane = self.lanes[choices[rng.integers(len(choices))]]
            edges.append(lane.edge)
            driven += lane.length
        return edges

    def _onward(self, lane: Lane, vehicle_class: str) -> list[str]:
        """Lanes that follow this one or, where it just ends, those that follow its neighbours."""
        for candidate in (lane, *self._neighbours[lane.edge]):
            allowed = [name for name in candidate.following if vehicle_class not in self.lanes[name].forbidden]
            if allowed:
                return allowed
        return []

    @cached_property
    def _neighbours(self) -> Mapping[str, Sequence[Lane]]:
        edges: dict[str, list[Lane]] = {}
        for lane in self.lanes.values():
            edges.setdefault(lane.edge, []).append(lane)
        return edges


def distance_to_area(points: Float[np.ndarray, "*n 2"], area: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "*n"]:
    """Distance (m) from points to the rectangle xmin ymin xmax ymax, 0 inside.

    >>> distance_to_area(np.array([[0.0, 0.0], [5.0, 5.0]]), np.array([-1.0, -1.0, 1.0, 2.0]))
    array([0., 5.])
    """
    beyond = points - np.clip(points, area[:2], area[2:])
    return np.hypot(beyond[..., 0], beyond[..., 1])


def _near(points: Float64[np.ndarray, "n 2"], area: Float64[np.ndarray, "4"], reach: float) -> Bool[np.ndarray, " n"]:
    return distance_to_area(points, area) <= reach


def _headed_for(
    points: Float64[np.ndarray, "n 2"], ahead: Float64[np.ndarray, "n 2"], area: Float64[np.ndarray, "4"]
) -> Bool[np.ndarray, " n"]:
    towards = np.clip(points, area[:2], area[2:]) - points
    return (towards == 0).all(axis=1) | ((towards * ahead).sum(axis=1) > 0)


def _read_lane(lanes: Any, name: str) -> Lane:
    links = lanes.getLinks(name)
    onward = [link[0] for link in links if link[6] != "t"] or [link[0] for link in links]
    return Lane(
        name,
        lanes.getEdgeID(name),
        lanes.getLength(name),
        np.array(lanes.getShape(name), np.float64),
        frozenset(lanes.getDisallowed(name)),
        tuple(dict.fromkeys(lane for lane in onward if not lane.startswith(":"))),
    )
