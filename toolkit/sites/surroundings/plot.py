"""Ground around a road, on which solids are placed one by one.

Solids are never on driven ground. A footway holds only slim things near the kerb."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites import furniture
from toolkit.sites.network import unite
from toolkit.sites.site import Mount, Solid

LANE_CLEARANCE_M = 0.25  # between a lane and solids next to it
MOUNT_CLEARANCE_M = 0.5  # air around a mount's axis
Strip = tuple[Float[np.ndarray, "_ 2"], float]  # middle line as traffic goes, width (m)


@dataclass(frozen=True, eq=False)
class Road:
    """Surface of a road, and the paths of its legs.

    Attributes:
        paths: lines of points x, y (m) along the legs, from the junction outwards.
        half_widths: width (m) of the road to the left and right of each path, footways included.
        lanes: polygons of everything with a kerb, including `strips`.
        footways: polygons of the footways next to the lanes.
        strips: shoulders without traffic, by the id of their edge: `in...` for edges towards the
            junction, others for those away from it.
        angles: angles between parking bays and kerb (degrees) on strips that have bays, by edge;
            strips without an angle get road works."""

    paths: Sequence[Float64[np.ndarray, "_ 2"]]
    half_widths: Sequence[tuple[float, float]]
    lanes: furniture.Outlines
    footways: furniture.Outlines
    strips: Mapping[str, Strip] = field(default_factory=dict)
    angles: Mapping[str, int] = field(default_factory=dict)

    @cached_property
    def carriageway(self) -> shapely.Geometry:
        """Union of the lanes, cracks between them closed."""
        return _close_gaps(self.lanes, 0.02)

    @cached_property
    def driven_ground(self) -> shapely.Geometry:
        """Carriageway without its shoulders (`strips`, each a line and a width in m)."""
        shoulders = []
        for line, width in self.strips.values():
            middle = shapely.LineString(line)
            shoulders.append(middle.buffer(width / 2, cap_style="flat", join_style="mitre"))
        # wider by 0.02 m, so that no slivers are left
        shoulder_ground = shapely.union_all(shoulders).buffer(0.02, join_style="mitre")
        return self.carriageway.difference(shoulder_ground)

    @cached_property
    def surface(self) -> shapely.Geometry:
        """Union of lanes and footways, slivers between them closed."""
        return _close_gaps([*self.lanes, *self.footways], 1.2)

    @cached_property
    def islands(self) -> list[shapely.Polygon]:
        """Ground that the road's surface encloses, a polygon for each hole of the surface."""
        return [
            shapely.Polygon(hole)
            for polygon in shapely.get_parts(self.surface)
            for hole in polygon.interiors
        ]


class Plot:
    """Ground around a road, on which solids are placed one by one.

    Attributes:
        road: the road.
        window: ground on which solids may be placed.
        solids: solids placed so far, on level ground (z = 0).
        open_ground: ground of the window next to the road, without islands.
        lane_ground: lanes to keep clear, with `LANE_CLEARANCE_M` around them.
        driven_ground: part of `lane_ground` to keep clear even of solids on shoulders.
        mount_places: (n, 2) places x, y (m) of mounts."""

    def __init__(self, road: Road, window: shapely.Geometry, mounts: Iterable[Mount]) -> None:
        """Make a plot without solids.

        window: ground on which solids may be placed; mounts: around which ground is kept clear."""
        self.road = road
        self.window = window
        self.solids: list[Solid] = []
        road_and_islands = shapely.union_all([road.surface, *road.islands])
        # ground off the road and its islands, 0.3 m from both
        self.open_ground = window.difference(road_and_islands.buffer(0.3))
        self.lane_ground = road.carriageway.buffer(LANE_CLEARANCE_M)
        self.driven_ground = road.driven_ground.buffer(LANE_CLEARANCE_M)
        self.mount_places = np.array([mount.position[:2] for mount in mounts]).reshape(-1, 2)
        # ground of everything placed so far, first around the mounts
        self._taken = [shapely.Point(foot).buffer(MOUNT_CLEARANCE_M) for foot in self.mount_places]
        # makes the many tests against them faster
        shapely.prepare([self.lane_ground, self.open_ground, self.driven_ground])

    def claim(
        self, ground: shapely.Geometry, *, on_footways: bool = False, on_shoulders: bool = False
    ) -> bool:
        """Take `ground` if it is free; return True if it was.

        It must be next to the road (`open_ground`) and off all ground taken before. on_footways: it
        may be anywhere off the lanes (`lane_ground`, shoulders included), also on footways and
        islands; on_shoulders: it may be anywhere off the smaller `driven_ground`, whatever
        `on_footways` is."""
        if on_shoulders:
            is_allowed = not self.driven_ground.intersects(ground)
        elif on_footways:
            is_allowed = not self.lane_ground.intersects(ground)
        else:
            is_allowed = self.open_ground.contains(ground)
        if not is_allowed or shapely.intersects(np.array(self._taken, object), ground).any():
            return False
        self._taken.append(ground)
        return True

    def place(
        self, solids: Sequence[Solid], *, on_footways: bool = False, on_shoulders: bool = False
    ) -> bool:
        """Place solids together if there is room for all; return True if there was.

        solids: on level ground (z = 0); on_footways: they may be anywhere off the lanes, also on
        footways and islands; on_shoulders: they may be on any ground that is not driven."""
        ground = unite(solid.footprint for solid in solids)
        if not self.claim(ground, on_footways=on_footways, on_shoulders=on_shoulders):
            return False
        self.solids += solids
        return True


def _close_gaps(polygons: furniture.Outlines, gap: float) -> shapely.Geometry:
    """Union of polygons, with gaps up to twice `gap` (m) wide filled."""
    # grown by `gap` and shrunk again: gaps that closed remain closed
    grown = unite(polygons).buffer(gap, join_style="mitre", quad_segs=2)
    return grown.buffer(-gap, join_style="mitre", quad_segs=2)
