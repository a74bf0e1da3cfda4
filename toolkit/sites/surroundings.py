"""Ground around a road, parking bays, and sensor places.

Things are placed on the ground one by one. Nothing stands where anyone drives. On a footway stand only slim things
near the kerb. Bays lie along kerbs, in line, at an angle or at right angles, and on forecourts behind the footways.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Rng
from toolkit.sites import furniture as f
from toolkit.sites.network import unite
from toolkit.sites.site import Mount, Solid

LANE_CLEARANCE = 0.25  # m between a lane and solids beside it
MOUNT_CLEARANCE = 0.5  # m of air around a mount's axis
FEWEST_MOUNTS = 12  # mounts of a site
POLE = 2.8  # m, height of a mount's own pole: sensors hang above it


Extent = Float[np.ndarray, "4"]
Strip = tuple[Float[np.ndarray, "_ 2"], float]  # middle line as traffic goes, width (m)


@dataclass(frozen=True, eq=False)
class Road:
    """Surface of a road, and the paths of its legs."""

    paths: Sequence[Float64[np.ndarray, "_ 2"]]
    half_widths: Sequence[tuple[float, float]]  # of each leg, left and right (m)
    lanes: f.Outlines  # everything with a kerb, including `strips`
    footways: f.Outlines
    strips: Mapping[str, Strip] = field(default_factory=dict)  # shoulders without traffic, by edge
    angles: Mapping[str, int] = field(default_factory=dict)  # of the bays on strips that have bays (degrees)

    @cached_property
    def carriageway(self) -> shapely.Geometry:
        """Union of the lanes, cracks between them closed."""
        return _close_gaps(self.lanes, 0.02)

    @cached_property
    def driven(self) -> shapely.Geometry:
        """Carriageway without its shoulders."""
        lines = [(shapely.LineString(line), width / 2) for line, width in self.strips.values()]
        strips = [line.buffer(half, cap_style="flat", join_style="mitre") for line, half in lines]
        return self.carriageway.difference(shapely.union_all(strips).buffer(0.02, join_style="mitre"))

    @cached_property
    def surface(self) -> shapely.Geometry:
        """Union of lanes and footways, slivers between them closed."""
        return _close_gaps([*self.lanes, *self.footways], 1.2)

    @cached_property
    def islands(self) -> list[shapely.Polygon]:
        """Ground that the road encloses."""
        return [shapely.Polygon(ring) for part in shapely.get_parts(self.surface) for ring in part.interiors]


class Plot:
    """Ground around a road, where solids are placed one by one.

    open: ground beside the road; lanes: kept clear, with LANE_CLEARANCE; driven: the part kept clear even of solids on
    shoulders; mounts: (n, 2) places of sensors.
    """

    def __init__(self, road: Road, window: shapely.Geometry, mounts: Iterable[Mount]) -> None:
        self.road, self.window = road, window
        self.solids: list[Solid] = []
        self.open = window.difference(shapely.union_all([road.surface, *road.islands]).buffer(0.3))
        self.lanes = road.carriageway.buffer(LANE_CLEARANCE)
        self.driven = road.driven.buffer(LANE_CLEARANCE)
        self.mounts = np.array([m.position[:2] for m in mounts]).reshape(-1, 2)
        self._taken = [shapely.Point(place).buffer(MOUNT_CLEARANCE) for place in self.mounts]
        shapely.prepare([self.lanes, self.open, self.driven])

    def claim(self, ground: shapely.Geometry, *, footway: bool = False, shoulder: bool = False) -> bool:
        """Take `ground` off the lanes and, unless `footway`, off the footways, if it is free; return success.

        shoulder: it may lie on any ground that is not driven.
        """
        if shoulder:
            allowed = not self.driven.intersects(ground)
        else:
            allowed = not self.lanes.intersects(ground) if footway else self.open.contains(ground)
        if not allowed or shapely.intersects(np.array(self._taken, object), ground).any():
            return False
        self._taken.append(ground)
        return True

    def place(self, solids: Sequence[Solid], *, footway: bool = False, shoulder: bool = False) -> bool:
        """Place solids together if there is room for all; return success."""
        if not self.claim(unite(solid.footprint for solid in solids), footway=footway, shoulder=shoulder):
            return False
        self.solids += solids
        return True


def place_mounts(
    road: Road, area: Extent, rng: Rng, *, spacing: float = 5.0, avoid: shapely.Geometry | None = None
) -> tuple[Mount, ...]:
    """Choose sensor places at the kerb and behind the footway, their feet at z = 0.

    `FEWEST_MOUNTS` to twice as many mounts in and just around `area`, out of `avoid`, `spacing` m apart where there is
    room.
    """
    window = shapely.box(*area).buffer(5.0)
    kerb = along(road.carriageway.buffer(0.7).boundary.intersection(window), 1.0)
    behind = along(road.surface.buffer(0.6).boundary.intersection(window), 1.0)
    behind = behind[rng.random(len(behind)) < 0.5]
    candidates = rng.permutation(np.concatenate([kerb, behind]))[:, :2]
    kept_clear = road.carriageway.buffer(0.6).union(avoid or shapely.Polygon())
    candidates = candidates[~shapely.intersects_xy(kept_clear, candidates)]
    wanted = int(rng.integers(FEWEST_MOUNTS, 2 * FEWEST_MOUNTS + 1))
    while True:
        chosen = np.zeros((0, 2))
        for point in candidates:
            if len(chosen) < wanted and (np.hypot(*(chosen - point).T) >= spacing).all():
                chosen = np.vstack([chosen, point])
        if len(chosen) >= FEWEST_MOUNTS or spacing <= 0.5:
            break
        spacing *= 0.7
    places = [(f"pole{i:02}", np.round([x, y, 0.0], 3)) for i, (x, y) in enumerate(chosen)]
    return tuple(Mount(*place, 3.0, 10.0, round(float(rng.uniform(0.5, 2.0)), 2)) for place in places)


def along(lines: shapely.Geometry, step: float) -> Float64[np.ndarray, "n 3"]:
    """Points x, y and direction (rad) every `step` m along `lines`."""
    rows = [np.zeros((0, 3))]
    for part in shapely.get_parts(shapely.line_merge(lines)):
        if part.geom_type == "LineString" and part.length >= 2 * step:
            at = np.arange(step / 2, part.length - step / 2, step)
            here, ahead = (shapely.get_coordinates(part.interpolate(s)) for s in (at, at + step / 2))
            rows.append(np.column_stack([here, np.arctan2(*(ahead - here).T[::-1])]))
    return np.concatenate(rows)


def _close_gaps(polygons: f.Outlines, gap: float) -> shapely.Geometry:
    """Union of polygons, gaps up to twice `gap` (m) filled."""
    union = unite(polygons)
    return union.buffer(gap, join_style="mitre", quad_segs=2).buffer(-gap, join_style="mitre", quad_segs=2)


Bay = tuple[float, float, float]  # x, y, yaw
Bays = Float64[np.ndarray, "n 3"]
BAY = (5.8, 2.6)  # m, length and width of a parking bay
ANGLES = {0: 2.3, 45: 4.8, 60: 5.1, 90: 5.2}  # degrees between bay and kerb, and how wide a strip of such bays is (m)
_CLEAR = 6.0  # m between a junction and the first bay
_REACH = 75.0  # m from a junction; bays are drawn this far
_UNSEEN = 15.0  # m from the edge of the furnished ground; no bays lie on the road there


def kerb_bays(plot: Plot, strips: Mapping[str, Strip], angles: Mapping[str, int], rng: Rng) -> Bays:
    """Draw bays x, y, yaw on the strips that have an angle (degrees, 0 in line with the kerb).

    The junction is at the end of a strip of an edge `in...`, and at the start of the others.
    """
    rows, seen = [np.zeros((0, 3))], plot.window.buffer(-_UNSEEN, join_style="mitre")
    size = BAY[0] - 0.2, BAY[1] - 0.2
    for edge, angle in angles.items():
        if edge in strips:
            bays = stations(strips[edge], angle, at_end=edge.startswith("in"))
            bays = bays[rng.random(len(bays)) < rng.uniform(0.35, 1.0)]
            # parts that reach into the lane or to neighbours do not count
            ground = [outline(bay, size).difference(plot.driven).buffer(-0.02) for bay in bays]
            rows.append(bays[[bool(seen.contains(g) and plot.claim(g, shoulder=True)) for g in ground]].reshape(-1, 3))
    return np.concatenate(rows)


def stations(strip: Strip, angle: int, *, at_end: bool) -> Bays:
    """Middles x, y and headings of all bays on a strip, from the junction on."""
    line = shapely.LineString(strip[0])
    at = np.arange(_CLEAR + BAY[0] / 2, min(line.length - BAY[0] / 2, _REACH), _spacing(angle))
    at = line.length - at if at_end else at
    return (place_along(line, at, 0.25) - [0.0, 0.0, np.deg2rad(angle)]).round(4)  # the kerb is to the right


def bays_between(line: shapely.LineString, angle: int, *, kerb_left: bool = False) -> Bays:
    """Middles x, y and headings of bays on a strip between junctions. line: as traffic goes."""
    at = np.arange(_CLEAR + BAY[0] / 2, line.length - _CLEAR - BAY[0] / 2, _spacing(angle))
    slant = np.deg2rad(-angle if kerb_left else angle)
    return (place_along(line, at, 0.25) - [0.0, 0.0, slant]).round(4)


def _spacing(angle: int) -> float:
    """Distance from bay to bay along the kerb (m)."""
    return BAY[0] + 0.4 if angle == 0 else BAY[1] / float(np.sin(np.deg2rad(angle)))


def place_along(line: shapely.LineString, at: Float[np.ndarray, " n"], half: float) -> Bays:
    """Places x, y and headings `at` metres along a line. Both ends, `half` m from each middle, lie on the line."""
    here, ahead = (shapely.get_coordinates(line.interpolate(s)).reshape(-1, 2) for s in (at - half, at + half))
    return np.column_stack([(here + ahead) / 2, np.arctan2(*(ahead - here).T[::-1])])


def forecourts(plot: Plot, rng: Rng) -> Bays:
    """Parking bays behind the footways, along the road or across."""
    bays: list[Bay] = []
    across = rng.random() < 0.5
    line = along(plot.road.surface.buffer(0.7 + BAY[not across] / 2).boundary.intersection(plot.window), 1.0)
    for x, y, direction in rng.permutation(line)[: rng.integers(0, 14)]:
        yaw = direction + (np.pi / 2 if across else 0.0) + np.pi * rng.integers(2)
        if plot.claim(outline((x, y, yaw))):
            bays.append((round(float(x), 3), round(float(y), 3), round(float(yaw), 4)))
    return np.array(bays, np.float64).reshape(-1, 3)


def outline(bay: Iterable[float], size: tuple[float, float] = BAY) -> shapely.Polygon:
    """Ground of a bay x, y, yaw."""
    x, y, yaw = bay
    return shapely.Polygon(f.block(size, (x, y), yaw))
