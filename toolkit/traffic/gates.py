"""Gates: places at the border of a site's network at which road users come in and leave."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.gate_names import name_gates
from toolkit.sites.georeference import bearing_deg
from toolkit.sites.site import Site
from toolkit.traffic.road_lanes import Roads, outline_view

_SAME_GATE_M = 30.0  # between ends of roads that are one gate


class Passage(NamedTuple):
    """Way through the network from one gate to another.

    Attributes:
        edges: ids of SUMO's edges, in order.
        start_m: place on the first edge at which it begins.
        end_m: place on the last edge at which it ends."""

    edges: tuple[str, ...]
    start_m: float
    end_m: float


class _End(NamedTuple):
    """End of an edge at the border of the network.

    Attributes:
        edge: id of the edge.
        is_start: True for the edge's start, which drivers come in by.
        length_m: length of the edge.
        point: x, y of the end (m)."""

    edge: str
    is_start: bool
    length_m: float
    point: Float64[np.ndarray, "2"]


@dataclass(frozen=True, eq=False)
class Gates:
    """Gates of a site's network, and the passages between them.

    Attributes:
        sumo: libsumo module that runs the network.
        site: site of the network.
        roads: its lanes."""

    sumo: ModuleType
    site: Site
    roads: Roads

    def passages(self, vehicle_class: str, type_id: str) -> dict[tuple[str, str], Passage]:
        """Passages of a SUMO class that come near the area, by names of entry and exit.

        type_id: id of a vehicle type of that class. Pedestrians may go either way on an edge. No
        passage leads back to its own gate."""
        walks = vehicle_class == "pedestrian"
        lanes = self.roads.lanes.values()
        open_edges = {lane.edge for lane in lanes if lane.is_open(vehicle_class)}
        passages: dict[tuple[str, str], Passage] = {}
        for entry in self._ends:
            if entry.edge not in open_edges or not (walks or entry.is_start):
                continue
            entry_name = self._names[entry.edge, entry.is_start]
            for leave in self._ends:
                if leave.edge not in open_edges or not (walks or not leave.is_start):
                    continue
                exit_name = self._names[leave.edge, leave.is_start]
                if entry_name == exit_name or (entry_name, exit_name) in passages:
                    continue
                edges = self._find_edges(entry.edge, leave.edge, type_id, walks=walks)
                if edges and self._comes_near(edges):
                    passages[entry_name, exit_name] = Passage(
                        edges=edges,
                        start_m=0.0 if entry.is_start else entry.length_m,
                        end_m=0.0 if leave.is_start else leave.length_m,
                    )
        return passages

    def _find_edges(self, first: str, last: str, type_id: str, *, walks: bool) -> tuple[str, ...]:
        """Ids of the edges of the quickest way between two edges, both included; empty without one.

        first, last: their ids; type_id: id of a vehicle type that may use them; walks:
        True for a way on foot."""
        if not walks:
            return tuple(self.sumo.simulation.findRoute(first, last, type_id).edges)
        stages = self.sumo.simulation.findIntermodalRoute(first, last, pType=type_id)
        return tuple(edge for stage in stages for edge in stage.edges)

    def _comes_near(self, edges: Sequence[str]) -> bool:
        """True if one of these edges, or a junction between them, is near the area."""
        shapes = [lane.shape for edge in edges for lane in self.roads.by_edge[edge]]
        # as one line, so that gaps at junctions are bridged
        line = shapely.LineString(np.concatenate(shapes))
        return bool(line.intersects(outline_view(self.site.area)))

    @cached_property
    def _ends(self) -> list[_End]:
        """Ends of edges at junctions that join no more than one other junction."""
        edge = self.sumo.edge
        joined: dict[str, set[str]] = {}  # by junction: junctions at the other ends of its edges
        for name in self.roads.by_edge:
            origin = edge.getFromJunction(name)
            target = edge.getToJunction(name)
            joined.setdefault(origin, set()).add(target)
            joined.setdefault(target, set()).add(origin)
        ends = []
        for name, lanes in self.roads.by_edge.items():
            shape = lanes[0].shape
            length = lanes[0].length
            if len(joined[edge.getFromJunction(name)]) == 1:
                ends.append(_End(edge=name, is_start=True, length_m=length, point=shape[0]))
            if len(joined[edge.getToJunction(name)]) == 1:
                ends.append(_End(edge=name, is_start=False, length_m=length, point=shape[-1]))
        return ends

    @cached_property
    def _names(self) -> dict[tuple[str, bool], str]:
        """Name of the gate of each end, by its edge and `is_start`.

        Ends near each other, such as both directions of a road, are one gate."""
        ends = self._ends
        if not ends:
            return {}
        points = np.array([end.point for end in ends])
        # discs around ends touch if these are near each other; a patch of discs is one gate
        discs = shapely.buffer(shapely.points(points), _SAME_GATE_M / 2)
        groups = shapely.get_parts(shapely.union_all(discs))
        group_of_end = shapely.STRtree(groups).query(shapely.points(points), "within")[1]
        area = self.site.area
        middle = (area[:2] + area[2:]) / 2
        offsets = [
            points[group_of_end == group].mean(axis=0) - middle for group in range(len(groups))
        ]
        bearings = [bearing_deg(self.site, float(np.arctan2(dy, dx))) for dx, dy in offsets]
        names = name_gates(bearings, [float(np.hypot(*offset)) for offset in offsets])
        return {
            (end.edge, end.is_start): names[group]
            for end, group in zip(ends, group_of_end.tolist(), strict=True)
        }
