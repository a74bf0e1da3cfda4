"""Places of strays: anywhere on a road, and next to solids and vehicles."""

from dataclasses import dataclass, replace

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.boxes import footprints
from toolkit.sites.network import unite
from toolkit.sites.site import Site
from toolkit.traffic.obstacles import Obstacles

MAX_STRAY_GAP_M = 1.5  # largest distance between a stray and the thing next to it
EDGE_STEP_M = 0.5  # largest distance between places along an edge
ROAD_SAMPLES = 8000  # places drawn in the area, of which those on the road are kept


@dataclass(frozen=True, eq=False)
class StrayGround:
    """Places for strays.

    Attributes:
        points: x, y (m) on lanes and footways in the area.
        edges: x, y (m) on the outline of solids and vehicles near them, and x, y of the outward
            unit normal there."""

    points: Float64[np.ndarray, "n 2"]
    edges: Float64[np.ndarray, "m 4"]

    @staticmethod
    def draw(site: Site, obstacles: Obstacles, rng: np.random.Generator) -> "StrayGround":
        """Draw places all over the lanes and footways of a site, with edges of obstacles nearby."""
        road = unite([*site.lanes, *site.footways])
        surface = shapely.intersection(road, shapely.box(*site.area))
        samples = rng.uniform(site.area[:2], site.area[2:], (ROAD_SAMPLES, 2))
        shapely.prepare(surface)
        points = samples[shapely.contains_xy(surface, *samples.T)]
        solids = obstacles.tree.geometries
        near_solids = solids[shapely.dwithin(solids, surface, MAX_STRAY_GAP_M)]
        return StrayGround(points, outward_edges(near_solids))

    @staticmethod
    def empty() -> "StrayGround":
        """Ground without places."""
        return StrayGround(np.zeros((0, 2)), np.zeros((0, 4)))

    def add_vehicles(self, boxes: np.ndarray) -> "StrayGround":
        """Return the ground of solids with the edges of vehicles too.

        The vehicles' edges are repeated until they are half as many as the solids', so that about
        one in three strays at an edge is at a vehicle.

        boxes: (n, 7) box of each vehicle."""
        vehicle_edges = outward_edges(shapely.polygons(footprints(boxes)))
        # whole repeats, rounded down; `self.edges` belong to solids
        repeats = max(1, len(self.edges) // max(1, 2 * len(vehicle_edges)))
        edges = np.concatenate([self.edges, np.tile(vehicle_edges, (repeats, 1))])
        return replace(self, edges=edges)


def outward_edges(polygons: np.ndarray) -> Float64[np.ndarray, "n 4"]:
    """Points along the outlines of polygons, with the outward unit normal: x, y, nx, ny per row.

    Points are the middles of pieces at most `EDGE_STEP_M` long."""
    rings = shapely.segmentize(shapely.get_exterior_ring(shapely.normalize(polygons)), EDGE_STEP_M)
    xy, ring_of_point = shapely.get_coordinates(rings, return_index=True)
    # False from the last point of one ring to the first of the next
    is_piece = ring_of_point[1:] == ring_of_point[:-1]
    pieces = np.diff(xy, axis=0)[is_piece]  # vectors from start to end
    middles = ((xy[1:] + xy[:-1]) / 2)[is_piece]
    lengths = np.hypot(*pieces.T)
    has_direction = lengths > 1e-6
    # normalised rings run clockwise: left is outside
    to_left = np.column_stack([-pieces[:, 1], pieces[:, 0]])
    normals = to_left[has_direction] / lengths[has_direction, None]
    return np.column_stack([middles[has_direction], normals])
