"""Shapes of the 3D scene as plain arrays: ground, streets, visible ground, edges of fields of view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from placement_env.report.content import Ground
from toolkit.arrays import Bool, Float32
from toolkit.mesh import Mesh, triangulate
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site
from toolkit.viewing.scene import Segments

GROUND_MARGIN = 25.0  # m of ground that is drawn around the area
TILE = 4.0  # m, edge of the tiles that ground and streets are cut into, to follow the relief
LONGEST_RUN = 8  # cells of visible ground that one rectangle covers
NO_RETURN = 12.0  # m that a ray is drawn which meets nothing
HALVES = np.array([[0, 1, 2], [0, 2, 3]])  # triangles of a rectangle


def ground_mesh(site: Site) -> Mesh:
    """The ground in and around the area, open where a pond is."""
    ponds = [shapely.Polygon(solid.footprint) for solid in site.solids if solid.kind == "pond"]
    return draped(site, [shapely.box(*_extent(site))], lift=0.0, without=ponds)


def draped(
    site: Site, shapes: Sequence[shapely.Polygon], *, lift: float, without: Sequence[shapely.Polygon] = ()
) -> Mesh:
    """Polygons laid on the ground near the area, `lift` metres above it."""
    covered = shapely.union_all(list(shapes)).difference(shapely.union_all(list(without)))
    tiles = shapely.intersection(covered, _tiles(_extent(site)))
    flat = triangulate(tiles[~shapely.is_empty(tiles) & (shapely.area(tiles) > 1e-6)])
    return _lifted(site, flat, lift)


def seen_cells(site: Site, ground: Ground, seen: Bool[np.ndarray, "ny nx"], *, lift: float) -> Mesh:
    """The cells that a sensor sees, as rectangles along the rows of the grid."""
    half, boxes = ground.cell / 2, []
    for row, y in zip(seen, ground.y, strict=True):
        steps = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
        for first, end in steps.reshape(-1, 2):
            for start in range(first, end, LONGEST_RUN):
                last = min(start + LONGEST_RUN, end) - 1
                boxes.append((ground.x[start] - half, y - half, ground.x[last] + half, y + half))
    if not boxes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    x0, y0, x1, y1 = np.array(boxes, np.float64).T
    flat = np.stack([np.stack([x, y], 1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], 1).reshape(-1, 2)
    first_corner = 4 * np.arange(len(boxes))[:, None]
    triangles = np.concatenate([first_corner + half_square for half_square in HALVES]).astype(np.int64)
    return _lifted(site, Mesh(np.column_stack([flat, np.zeros(len(flat))]), triangles), lift)


def view_edges(sensor: Sensor, background: Float32[np.ndarray, "rows columns"], *, spokes: int = 6) -> Segments:
    """The outline of what a sensor sees of the empty site, and rays from the sensor to it, each as long as it goes
    until something stands in its way. background: measurement of each of its rays, 0 where nothing came back."""
    rows, columns = background.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    ring = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]])
    picked = ring[np.linspace(0, len(ring), min(len(ring), 240), endpoint=False).astype(np.int64)]
    lengths = background.ravel()[picked].astype(np.float64)
    lengths = np.where(lengths > 0, lengths, min(sensor.model.max_range, NO_RETURN))
    ends = sensor.position + sensor.world_rays.T[picked] * lengths[:, None]
    outline = np.stack([ends, np.roll(ends, -1, axis=0)], 1)
    jumps = np.linalg.norm(outline[:, 1] - outline[:, 0], axis=1) > 0.25 * lengths  # from one thing to one behind it
    corner_rays = np.linspace(0, len(ends), 4 * max(spokes // 4, 1), endpoint=False).astype(np.int64)
    rays = np.stack([np.broadcast_to(sensor.position, (len(corner_rays), 3)), ends[corner_rays]], 1)
    return np.concatenate([outline[~jumps], rays])


def _extent(site: Site) -> tuple[float, float, float, float]:
    xmin, ymin, xmax, ymax = site.area.tolist()
    return xmin - GROUND_MARGIN, ymin - GROUND_MARGIN, xmax + GROUND_MARGIN, ymax + GROUND_MARGIN


def _tiles(extent: tuple[float, float, float, float]) -> np.ndarray:
    """Squares that cover the extent, as shapely boxes."""
    xmin, ymin, xmax, ymax = extent
    x, y = np.meshgrid(np.arange(xmin, xmax, TILE), np.arange(ymin, ymax, TILE))
    tiles: np.ndarray = shapely.box(x.ravel(), y.ravel(), x.ravel() + TILE, y.ravel() + TILE)
    return tiles


def _lifted(site: Site, flat: Mesh, lift: float) -> Mesh:
    heights = site.ground(flat.vertices[:, :2]) + lift
    return Mesh(np.column_stack([flat.vertices[:, :2], heights]), flat.triangles)
