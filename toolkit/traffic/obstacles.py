"""Solids in the way of traffic, and bodies in each other's."""

from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Bool, Float64, Int64, Mask
from toolkit.boxes import footprints
from toolkit.sites.site import Site

# boxes (x, y, z, length, width, height in m, yaw in rad), z counted from the plane of the ground
LevelBoxes = Float64[np.ndarray, "n 7"]
BODY_GAP_M = 0.1  # m left between bodies
STEPS_ASIDE_M = (0.0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75, 1.0, -1.0)  # m, tried in this order
MAX_STEP_HEIGHT_M = 0.3  # above the ground; lower solids can be stepped on
MIN_CELL_M = 2.0  # width of the cells in which distances to solids are known
MAX_CELLS = 128  # along x and along y
CELL_MARGIN_M = 12.0  # around all solids, that the cells cover too
ROUNDING_M = 1e-6


class Obstacles:
    """Static solids high enough to be in the way, indexed by place.

    Heights count from the plane of the ground, as the boxes' heights do until a snapshot puts them
    on the ground.

    Attributes:
        bases: height of the lower end of each solid (m).
        tree: search tree of their footprints, in the same order."""

    def __init__(self, site: Site) -> None:
        """Choose the solids of a site that are higher than `MAX_STEP_HEIGHT_M`."""
        middles = np.array([solid.footprint.mean(axis=0) for solid in site.solids]).reshape(-1, 2)
        # tops above the ground (m)
        heights = np.array([solid.top for solid in site.solids]) - site.ground(middles)
        solids = [
            solid
            for solid, height in zip(site.solids, heights, strict=True)
            if height > MAX_STEP_HEIGHT_M
        ]
        solid_middles = np.array([solid.footprint.mean(axis=0) for solid in solids]).reshape(-1, 2)
        # undersides above the plane of the site (m), and outlines from above, in the same order
        self.bases = np.array([solid.base for solid in solids]) - site.plane(solid_middles)
        self.tree = shapely.STRtree([shapely.Polygon(solid.footprint) for solid in solids])
        self._clearances = _Clearances.measure(self.tree)

    def hit(self, boxes: LevelBoxes) -> Mask:
        """Mask of boxes that touch an obstacle, or come within half of `BODY_GAP_M` of it.

        A box may be under a solid that begins above its top, such as a tree's crown."""
        is_hit = np.zeros(len(boxes), bool)
        # outlines are drawn only for boxes whose circles touch an obstacle
        radii = np.hypot(boxes[:, 3] + BODY_GAP_M, boxes[:, 4] + BODY_GAP_M) / 2
        reach = radii.max(initial=0.0) + BODY_GAP_M
        near_rows = self._list_near(boxes[:, :2], reach)
        if not len(near_rows):
            return is_hit
        # row among the near boxes and index of the obstacle of each pair that touches from above
        pairs = self.tree.query(outline_boxes(boxes[near_rows]), predicate="intersects")
        rows = near_rows[pairs[0]]
        obstacles = pairs[1]
        centre_z, height = boxes[rows, 2], boxes[rows, 5]
        box_tops = centre_z + height / 2
        is_hit[rows[self.bases[obstacles] < box_tops]] = True
        return is_hit

    def _list_near(
        self, points: Float64[np.ndarray, "n 2"], reach: float
    ) -> Int64[np.ndarray, " k"]:
        """Rows of the points within a distance (m) of an obstacle."""
        if not len(points):
            return np.zeros(0, np.int64)
        rows = np.flatnonzero(self._clearances.find(points) <= reach)
        if not len(rows):
            return rows
        middles = shapely.points(points[rows])
        pairs = self.tree.query(middles, predicate="dwithin", distance=reach)
        return rows[np.unique(pairs[0])]


class _Clearances(NamedTuple):
    """Distances to the nearest obstacle in square cells around all obstacles.

    Attributes:
        low: lowest x and y of all cells (m).
        cell_m: width of a cell (m).
        distances: least distance (m) of any place in each cell, by cells along x and y; the
            outermost cells hold all that is outside, with 0."""

    low: Float64[np.ndarray, "2"]
    cell_m: float
    distances: Float64[np.ndarray, "columns rows"]

    @staticmethod
    def measure(tree: shapely.STRtree) -> "_Clearances":
        """Measure the distances to the footprints in a search tree."""
        if not len(tree.geometries):
            return _Clearances(np.zeros(2), MIN_CELL_M, np.full((1, 1), np.inf))
        bounds = shapely.total_bounds(tree.geometries)
        low = bounds[:2] - CELL_MARGIN_M
        extent = bounds[2:] + CELL_MARGIN_M - low
        cell_m = max(MIN_CELL_M, float(extent.max()) / MAX_CELLS)
        columns, rows = np.ceil(extent / cell_m).astype(np.int64).tolist()
        x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5, indexing="ij")
        middles = low + cell_m * np.column_stack([x.ravel(), y.ravel()])
        distances = tree.query_nearest(
            shapely.points(middles), return_distance=True, all_matches=False
        )[1].reshape(x.shape)
        distances -= cell_m * np.sqrt(0.5) + ROUNDING_M
        return _Clearances(low - cell_m, cell_m, np.pad(distances, 1))

    def find(self, points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Distance (m) to the nearest obstacle that each point has at least."""
        cells = np.floor((points - self.low) / self.cell_m).astype(np.int64)
        columns, rows = np.clip(cells, 0, np.array(self.distances.shape) - 1).T
        return self.distances[columns, rows]


def separate(boxes: LevelBoxes, obstacles: Obstacles) -> tuple[LevelBoxes, Mask, int]:
    """Move boxes apart from each other and from obstacles.

    Earlier rows have precedence. A row in the way steps aside by up to 1 m across its heading, or
    is dropped. Returns all boxes with their new places, a mask of the rows to keep, and the number
    of rows that were moved or dropped."""
    is_kept = np.ones(len(boxes), bool)
    # of two boxes that overlap, the later one is in the way
    rows_in_the_way = np.flatnonzero(overlaps(boxes).any(axis=0) | obstacles.hit(boxes))
    if not len(rows_in_the_way):
        return boxes, is_kept, 0
    new_boxes = boxes.copy()
    shapes = outline_boxes(boxes)  # kept up to date with `new_boxes`
    for row in rows_in_the_way:
        is_kept[row] = False  # so that the row is not compared with itself below
        yaw = boxes[row, 6]
        to_left = [-np.sin(yaw), np.cos(yaw)]
        places = np.tile(boxes[row], (len(STEPS_ASIDE_M), 1))  # a box for each step
        places[:, :2] += np.outer(STEPS_ASIDE_M, to_left)
        place_shapes = outline_boxes(places)
        touches = shapely.intersects(place_shapes[:, None], shapes[is_kept][None])
        is_free = ~obstacles.hit(places) & ~touches.any(axis=1)
        # first free place; without a free one it is place 0, and the row is dropped
        first = np.argmax(is_free)
        is_kept[row] = is_free[first]
        new_boxes[row] = places[first]
        shapes[row] = place_shapes[first]
    is_changed = ~is_kept | (new_boxes != boxes).any(axis=1)
    return new_boxes, is_kept, int(is_changed.sum())


def place_boxes(poses: Float64[np.ndarray, "n 3"], sizes: Float64[np.ndarray, "n 3"]) -> LevelBoxes:
    """Boxes of bodies on level ground, with yaws in -pi..pi.

    poses: x, y (m), yaw (rad) of each; sizes: its length, width, height (m)."""
    yaw = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    return np.column_stack([poses[:, :2], sizes[:, 2] / 2, sizes, yaw])


def overlaps(boxes: LevelBoxes) -> Bool[np.ndarray, "n n"]:
    """Mask (n, n) of pairs of boxes closer than `BODY_GAP_M`, seen from above.

    Only entries above the diagonal are set: the row is the earlier box, the column the later."""
    length, width = boxes[:, 3], boxes[:, 4]
    # radius of the circle around a box that is widened by half of the gap on each side
    radius = np.hypot(length + BODY_GAP_M, width + BODY_GAP_M) / 2
    offsets = boxes[:, None, :2] - boxes[None, :, :2]
    square_distances = np.square(offsets).sum(-1)
    # only pairs whose circles touch are compared exactly
    is_near = square_distances < np.square(radius[:, None] + radius[None])
    earlier, later = np.nonzero(np.triu(is_near, 1))
    shapes = outline_boxes(boxes)
    is_close = np.zeros((len(boxes), len(boxes)), bool)
    is_close[earlier, later] = shapely.intersects(shapes[earlier], shapes[later])
    return is_close


def outline_boxes(boxes: LevelBoxes) -> np.ndarray:
    """Footprint of each box as a polygon, wider by half of `BODY_GAP_M` on each side."""
    widened = boxes.copy()
    widened[:, 3:5] += BODY_GAP_M
    return shapely.polygons(footprints(widened))
