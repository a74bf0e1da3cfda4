"""`GroundPlan`: the detection area as a raster of cells, with what the map says of each: lanes, bays, footways, solids.

How many vehicles stand or drive in a cell, in the mean over time, is estimated from four of its figures,

    traffic = Σ weight · figure    figures: metres of lane, of waiting lane, inside the junction, bays

with `TRAFFIC` as weights, fitted by least squares without negative ones to vehicles of simulated traffic at 74 random
junctions (`tests/benchmarks/placement_env/bench_map_policy.py --traffic`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.sites.network import points_of, users_of
from toolkit.sites.site import Site

RASTER_CELLS = 24  # of the raster along each side of the area
FINE = 3  # points along each side of a cell by which shares of its ground are measured
WAITING = 15.0  # m before a stop line within which vehicles wait, as the scale of an exponential
LANE_WIDTH = 3.5  # m, of a lane of which the network says nothing
LANE_STEP = 1.0  # m along a lane from point to point
CHANNELS = ("lanes", "waiting", "inside", "parked", "footways", "solids", "traffic", "oblique")
TRAFFIC = (0.0055, 0.0773, 0.0031, 0.312)  # vehicles to a metre of lane, of waiting lane, of junction, and to a bay


@dataclass(frozen=True, eq=False)
class GroundPlan:
    """G x G cells of the area, row after row from its south-western corner.

    centres: their middles; ground: its height there (m); metres: of lane, of lane near a stop line (each metre counts
    exp(-distance / `WAITING`)) and of lane inside the junction, and the number of parking bays, of each cell; shares:
    of its ground that lanes, footways and solids cover; course: means of cos 2ψ, sin 2ψ and |sin 2ψ| over the headings
    ψ of lanes and bays there, as much as each counts as traffic.
    """

    area: Float64[np.ndarray, "4"]
    centres: Float64[np.ndarray, "P 2"]
    ground: Float64[np.ndarray, " P"]
    metres: Float64[np.ndarray, "P 4"]
    shares: Float64[np.ndarray, "P 3"]
    course: Float64[np.ndarray, "P 3"]

    @property
    def size(self) -> Float64[np.ndarray, "2"]:
        """Width and depth of a cell (m)."""
        return (self.area[2:] - self.area[:2]) / RASTER_CELLS

    @cached_property
    def traffic(self) -> Float64[np.ndarray, " P"]:
        """Vehicles expected in each cell."""
        return self.metres @ np.array(TRAFFIC)

    @cached_property
    def used(self) -> Int64[np.ndarray, " Q"]:
        """The cells in which there may be vehicles."""
        return np.flatnonzero(self.traffic > 0)

    @cached_property
    def channels(self) -> Float32[np.ndarray, "P channels"]:
        """`CHANNELS` of each cell, in 0..1: shares of the ground for lanes, footways and solids; metres of lane as
        shares of what two lanes have across the cell; x / (x + 1) of the bays and of the vehicles; oblique the
        mean |sin 2ψ| of their headings."""
        across = 2 * float(self.size.mean())
        waiting, inside = np.minimum(self.metres[:, 1:3] / across, 1).T
        parked, traffic = (x / (x + 1) for x in (self.metres[:, 3], self.traffic))
        lanes, footways, solids = self.shares.T
        columns = {
            "lanes": lanes, "waiting": waiting, "inside": inside, "parked": parked, "footways": footways,
            "solids": solids, "traffic": traffic, "oblique": self.course[:, 2],
        }  # fmt: skip
        return np.stack([columns[name] for name in CHANNELS], axis=1).astype(np.float32)

    def cells_at(self, xy: Float64[np.ndarray, "n 2"]) -> Int64[np.ndarray, " n"]:
        """The cell of each place, -1 outside the area."""
        column, row = np.floor((xy - self.area[:2]) / self.size).astype(np.int64).T
        inside = (column >= 0) & (column < RASTER_CELLS) & (row >= 0) & (row < RASTER_CELLS)
        return np.where(inside, row * RASTER_CELLS + column, -1)


def ground_plan(site: Site) -> GroundPlan:
    """The raster of a site. One without a road network has the lanes of its polygons alone, headed nowhere."""
    size = (site.area[2:] - site.area[:2]) / RASTER_CELLS
    row, column = np.divmod(np.arange(RASTER_CELLS**2), RASTER_CELLS)
    centres = site.area[:2] + (np.column_stack([column, row]) + 0.5) * size
    metres, shares, course = (
        np.zeros((RASTER_CELLS**2, 4)),
        _shares(site, centres, size),
        np.zeros((RASTER_CELLS**2, 3)),
    )
    plan = GroundPlan(site.area, centres, np.asarray(site.ground(centres)), metres, shares, course)
    points = lane_points(site.network) if site.network else LanePoints.none()
    waiting = points.metres * ~points.inside * np.exp(-points.rest / WAITING)
    lanes = np.stack([points.metres * ~points.inside, waiting, points.metres * points.inside], axis=1)
    bays = np.concatenate([np.zeros((len(site.parking), 3)), np.ones((len(site.parking), 1))], axis=1)
    figures = np.concatenate([np.pad(lanes, ((0, 0), (0, 1))), bays])
    cells = plan.cells_at(np.concatenate([points.xy, site.parking[:, :2]]))
    double = 2 * np.concatenate([points.heading, site.parking[:, 2]])
    counted = figures @ np.array(TRAFFIC)
    _count(metres, cells, figures)
    if not site.network:
        metres[:, 0] = shares[:, 0] * size.prod() / LANE_WIDTH
    turned = np.stack([np.cos(double), np.sin(double), np.abs(np.sin(double))], axis=1)
    _count(course, cells, turned * counted[:, None])
    course /= np.maximum(plan.traffic, 1e-9)[:, None]
    return plan


class LanePoints(NamedTuple):
    """Points of the middle lines of lanes: places; headings ψ (rad); metres of lane that each stands for; metres to the
    end of its lane; whether it is inside a junction."""

    xy: Float64[np.ndarray, "n 2"]
    heading: Float64[np.ndarray, " n"]
    metres: Float64[np.ndarray, " n"]
    rest: Float64[np.ndarray, " n"]
    inside: Bool[np.ndarray, " n"]

    @staticmethod
    def none() -> LanePoints:
        """Of no lane."""
        return LanePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.bool_))


def lane_points(network: str) -> LanePoints:
    """Of all lanes of a net.xml text that cars may use, one at about every `LANE_STEP`."""
    found = [LanePoints.none()]
    for edge in ElementTree.fromstring(network).iter("edge"):
        function = edge.get("function", "normal")
        if function in ("normal", "internal"):
            found += [_along(points_of(lane), function == "internal") for lane in edge.iter("lane") if _for_cars(lane)]
    return LanePoints(*(np.concatenate(each) for each in zip(*found, strict=True)))


def _for_cars(lane: ElementTree.Element) -> bool:
    return "passenger" in users_of(lane)


def _along(line: np.ndarray, inside: bool) -> LanePoints:
    """Those of one lane."""
    if len(line) < 2:
        return LanePoints.none()
    pieces = np.diff(line, axis=0)
    at = np.concatenate([[0], np.cumsum(np.linalg.norm(pieces, axis=1))])
    count = max(1, round(at[-1] / LANE_STEP))
    middles = (np.arange(count) + 0.5) * at[-1] / count
    xy = np.column_stack([np.interp(middles, at, line[:, axis]) for axis in (0, 1)])
    piece = np.clip(np.searchsorted(at, middles) - 1, 0, len(pieces) - 1)
    heading = np.arctan2(pieces[:, 1], pieces[:, 0])[piece]
    return LanePoints(xy, heading, np.full(count, at[-1] / count), at[-1] - middles, np.full(count, inside))


def _count(sums: np.ndarray, cells: np.ndarray, rows: np.ndarray) -> None:
    """Add rows up in their cells."""
    kept = cells >= 0
    np.add.at(sums, cells[kept], rows[kept])


def _shares(site: Site, centres: np.ndarray, size: np.ndarray) -> Float64[np.ndarray, "P 3"]:
    """Of lanes, footways and solids, by some points in each cell."""
    offsets = (np.arange(FINE) + 0.5) / FINE - 0.5
    x = (centres[:, :1] + np.tile(offsets, FINE) * size[0]).ravel()
    y = (centres[:, 1:] + np.repeat(offsets, FINE) * size[1]).ravel()
    layers = (site.lanes, site.footways, [solid.footprint for solid in site.solids if solid.kind != "tree"])
    covered = [covers(layer, x, y).reshape(len(centres), -1).mean(axis=1) for layer in layers]
    return np.stack(covered, axis=1)


def covers(
    polygons: list[np.ndarray] | tuple[np.ndarray, ...], x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Which of the places some polygon covers."""
    tree = shapely.STRtree([shapely.Polygon(polygon) for polygon in polygons])
    covered = np.zeros(len(x), np.bool_)
    covered[tree.query(shapely.points(x, y), predicate="within")[0]] = True
    return covered
