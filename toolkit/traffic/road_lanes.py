"""Lanes of SUMO's network: places on them, and drives along them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType

import numpy as np
import shapely

from toolkit.arrays import Float, Float64

# m round the area within which objects belong to a snapshot: they occlude, and the edge cuts them
VIEW_MARGIN_M = 10.0
PLACE_SPACING_M = 2.0  # m between the places of a lane


@dataclass(frozen=True, eq=False)
class Lane:
    """Lane of SUMO's network.

    Attributes:
        name: its id in SUMO.
        edge: id of its edge, a stretch of road with one or more lanes.
        length: length (m) that the network states; its drawn line may be longer or shorter.
        shape: x, y of the points of its middle line (m).
        forbidden: SUMO vehicle classes, such as "passenger", that may not use it.
        following: names of lanes that it leads to, U-turns only if there is nothing else."""

    name: str
    edge: str
    length: float
    shape: Float64[np.ndarray, "k 2"]
    forbidden: frozenset[str]
    following: tuple[str, ...]

    def is_open(self, vehicle_class: str) -> bool:
        """True if a SUMO class may use the lane; pedestrians only if cars may not."""
        is_shared = vehicle_class == "pedestrian" and "passenger" not in self.forbidden
        return vehicle_class not in self.forbidden and not is_shared

    def at(self, offset: Float[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
        """Points x, y (m) of the middle line at offsets (m) from its start.

        Offsets are by SUMO's `length`, from which the length of the drawn line may differ."""
        steps = np.hypot(*np.diff(self.shape, axis=0).T)
        distances = np.concatenate([[0.0], np.cumsum(steps)])  # along the line to its corners
        drawn_length = distances[-1]
        drawn_offset = offset * drawn_length / self.length
        x = np.interp(drawn_offset, distances, self.shape[:, 0])
        y = np.interp(drawn_offset, distances, self.shape[:, 1])
        return np.stack([x, y], axis=-1)


@dataclass(frozen=True, eq=False)
class Places:
    """Places on lanes at which something can start, one per row.

    Attributes:
        lanes: name of the lane of each place.
        lengths: length of that lane (m).
        offsets: distance of the place from the lane's start (m).
        points: its x, y (m)."""

    lanes: tuple[str, ...]
    lengths: Float64[np.ndarray, " n"]
    offsets: Float64[np.ndarray, " n"]
    points: Float64[np.ndarray, "n 2"]


@dataclass(frozen=True, eq=False)
class Roads:
    """Lanes of a network by name, without junctions' inner lanes."""

    lanes: Mapping[str, Lane]

    @staticmethod
    def read(sumo: ModuleType) -> "Roads":
        """Read the roads of the network that SUMO runs."""
        names = [name for name in sumo.lane.getIDList() if not name.startswith(":")]
        return Roads({name: _read_lane(sumo, name) for name in names})

    def places(self, area: Float64[np.ndarray, "4"], reach: float, vehicle_class: str) -> Places:
        """Places within `reach` (m) of the area to start a vehicle or pedestrian of a SUMO class.

        Outside the area, lanes must lead towards it. Pedestrians start on lanes without cars and
        walk either way. area: xmin, ymin, xmax, ymax (m)."""
        is_on_foot = vehicle_class == "pedestrian"
        names = []
        offsets = [np.zeros(0)]
        points = [np.zeros((0, 2))]
        for lane in self.lanes.values():
            if not lane.is_open(vehicle_class):
                continue
            lane_offsets = np.arange(PLACE_SPACING_M / 2, lane.length, PLACE_SPACING_M)
            xy = lane.at(lane_offsets)
            # vectors along the lane, and from each place to the nearest point of the area
            next_xy = lane.at(lane_offsets + PLACE_SPACING_M)
            ahead = next_xy - lane.at(lane_offsets - PLACE_SPACING_M)
            to_area = np.clip(xy, area[:2], area[2:]) - xy
            is_inside = (to_area == 0).all(axis=1)
            leads_to_area = is_inside | ((to_area * ahead).sum(axis=1) > 0)
            is_useful = (distance_to_area(xy, area) <= reach) & (is_on_foot | leads_to_area)
            names += [lane.name] * int(is_useful.sum())
            offsets.append(lane_offsets[is_useful])
            points.append(xy[is_useful])
        return Places(
            lanes=tuple(names),
            lengths=np.array([self.lanes[name].length for name in names]),
            offsets=np.concatenate(offsets),
            points=np.concatenate(points),
        )

    def route(
        self, start: str, vehicle_class: str, distance: float, rng: np.random.Generator
    ) -> list[str]:
        """Draw a drive and return the ids of its edges, the edge of lane `start` first.

        After that edge it is at least `distance` (m) long, or ends with the road. vehicle_class:
        SUMO class, for which all its lanes are open."""
        lane = self.lanes[start]
        edges = [lane.edge]
        driven_m = 0.0
        while driven_m < distance:
            # names of the next lanes; if the lane leads nowhere, the first neighbour on its edge
            # that goes on gives them
            next_lanes = self._list_onward(lane, vehicle_class)
            for neighbour in self.by_edge[lane.edge]:
                next_lanes = next_lanes or self._list_onward(neighbour, vehicle_class)
            if not next_lanes:
                break
            lane = self.lanes[next_lanes[rng.integers(len(next_lanes))]]
            edges.append(lane.edge)
            driven_m += lane.length
        return edges

    def _list_onward(self, lane: Lane, vehicle_class: str) -> list[str]:
        """Names of the lanes after a lane that are open to a SUMO class."""
        return [name for name in lane.following if vehicle_class not in self.lanes[name].forbidden]

    @cached_property
    def by_edge(self) -> Mapping[str, Sequence[Lane]]:
        """Lanes of each edge, by the edge's id."""
        edges: dict[str, list[Lane]] = {}
        for lane in self.lanes.values():
            edges.setdefault(lane.edge, []).append(lane)
        return edges


def _read_lane(sumo: ModuleType, name: str) -> Lane:
    """Read a lane of the network that SUMO runs. name: its id in the network."""
    links = sumo.lane.getLinks(name)
    # a link holds the next lane at 0 and its direction at 6, "t" for a U-turn
    next_lanes = [link[0] for link in links if link[6] != "t"]
    if not next_lanes:
        next_lanes = [link[0] for link in links]
    # in order and without repeats; names with ":" are lanes within junctions
    following = dict.fromkeys(lane for lane in next_lanes if not lane.startswith(":"))
    return Lane(
        name,
        edge=sumo.lane.getEdgeID(name),
        length=sumo.lane.getLength(name),
        shape=np.array(sumo.lane.getShape(name), np.float64),
        forbidden=frozenset(sumo.lane.getDisallowed(name)),
        following=tuple(following),
    )


def outline_view(area: Float64[np.ndarray, "4"]) -> shapely.Polygon:
    """Outline of an area with `VIEW_MARGIN_M` around it, within which objects are seen.

    area: xmin, ymin, xmax, ymax (m)."""
    return shapely.box(*(area + VIEW_MARGIN_M * np.array([-1, -1, 1, 1])))


def distance_to_area(
    points: Float[np.ndarray, "*n 2"], area: Float64[np.ndarray, "4"]
) -> Float64[np.ndarray, "*n"]:
    """Distance (m) from points x, y to a rectangle (xmin, ymin, xmax, ymax), 0 inside."""
    beyond = points - np.clip(points, area[:2], area[2:])
    return np.hypot(beyond[..., 0], beyond[..., 1])
