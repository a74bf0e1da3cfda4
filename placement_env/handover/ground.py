"""Ground of a site that sensors see, and the density of their points, by rays cast at the empty
site.

The area is divided into square cells. A sensor sees a cell if a point `TARGET_HEIGHT_M` above the
ground at its centre is in the sensor's field of view and range, and nothing in the static scene is
in between. The density is counted in the frame that the sensor measures of the empty site, without
noise and before any crop by height; a point is on the ground if it would be the same with nothing
but ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Bool, Float32, Float64, ImageRanges, Int64
from toolkit.frame import unproject
from toolkit.geometry import invert, transform
from toolkit.rendering.renderer import Renderer, SightLines
from toolkit.rendering.static_scene import build_scenery, ground as ground_mesh
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

TARGET_HEIGHT_M = 0.1  # the tread of a tyre, clear of the roughness between the ground's vertices
SAME_RANGE_M = 1e-3  # largest difference between measurements of one point
MIN_CLEARANCE_M = 1.0  # air below tree crowns and roofs from which the ground counts as open
MIN_POLYGON_M2 = 1.0  # smaller pieces and holes, from rays through leaves, are left out
MAX_CELLS = 4_000_000  # in a grid


@dataclass(frozen=True, eq=False)
class GroundGrid:
    """Ground of the area that each sensor sees, as a grid of square cells.

    Attributes:
        x: Centres of columns (m, site frame, ascending).
        y: Centres of rows (m, site frame, ascending).
        seen: Whether the centre of a cell of open ground is in unobstructed view.
        density: Points that a frame puts on the cell's open ground, per m².
        open_ground: Whether a cell is free of solids and ponds.
        lanes: Whether a cell is on a lane.
        footways: Whether a cell is on a footway.
    """

    x: Float64[np.ndarray, " nx"]
    y: Float64[np.ndarray, " ny"]
    seen: Bool[np.ndarray, "sensors ny nx"]
    density: Float32[np.ndarray, "sensors ny nx"]
    open_ground: Bool[np.ndarray, "ny nx"]
    lanes: Bool[np.ndarray, "ny nx"]
    footways: Bool[np.ndarray, "ny nx"]

    @property
    def cell(self) -> float:
        """Side of a cell (m)."""
        return float(self.x[1] - self.x[0]) if len(self.x) > 1 else float(self.y[1] - self.y[0])

    @property
    def views(self) -> Int64[np.ndarray, "ny nx"]:
        """Number of sensors that see each cell."""
        return self.seen.sum(axis=0, dtype=np.int64)


@dataclass(frozen=True)
class GroundShares:
    """Shares of the area's open ground, from 0 to 1, and areas.

    Attributes:
        seen_by: Shares seen by at least 1, 2 and 3 sensors.
        blind: Share that no sensor sees.
        blind_lanes: Share of the lanes that no sensor sees.
        sensor_m2: Area that each sensor sees, by name.
        open_m2: Area of open ground.
        blind_m2: Area of blind spots.
    """

    seen_by: tuple[float, float, float]
    blind: float
    blind_lanes: float
    sensor_m2: dict[str, float]
    open_m2: float
    blind_m2: float


def visible_ground(site: Site, sensors: Sequence[Sensor], *, cell: float = 0.5) -> GroundGrid:
    """Ground that each sensor sees. No sensor sees cells with a solid or a pond.

    cell: side of a cell (m). If it does not divide the area, the grid is centred on it and the
    outermost cells extend beyond it or fall short by a quarter of a cell at most. Raises ValueError
    for a cell that is not positive, so large that a side has fewer than two, or far too small."""
    grid = lay_grid(site, cell, TARGET_HEIGHT_M)
    scenery = build_scenery(site)
    sight_lines = SightLines(scenery)
    # measurements of the empty site, then of the same ground without anything on it
    images = Renderer(site, bodies=(), sensors=sensors, scenery=scenery).background
    ground_images = Renderer(site, bodies=(), sensors=sensors, scenery=ground_mesh(site)).background
    shape = (len(sensors), len(grid.y), len(grid.x))
    seen = np.zeros(shape, bool)
    density = np.zeros(shape, np.float32)
    for s, sensor in enumerate(sensors):
        sensor_points = transform(invert(sensor.pose), grid.points)  # in the sensor's frame
        seen[s] = grid.open_ground & sensor.model.in_view(sensor_points)
        seen[s, seen[s]] = sight_lines.clear(sensor.position, grid.points[seen[s]])
        is_ground = np.abs(images[s] - ground_images[s]) < SAME_RANGE_M
        ground_image = np.where(is_ground, images[s], np.float32(0))  # 0: no measurement
        cell_density = _density(sensor, ground_image, grid.x, grid.y)
        density[s] = np.where(grid.open_ground, cell_density, np.float32(0))
    middles = grid.points[..., :2]
    return GroundGrid(
        x=grid.x,
        y=grid.y,
        seen=seen,
        density=density,
        open_ground=grid.open_ground,
        lanes=_covered(site.lanes, middles),
        footways=_covered(site.footways, middles),
    )


class Grid(NamedTuple):
    """Square cells over the area of a site.

    Attributes:
        x: Centres of columns (m, site frame).
        y: Centres of rows (m, site frame).
        points: Points above the centres of the cells.
        open_ground: Whether each cell is open ground.
    """

    x: np.ndarray
    y: np.ndarray
    points: Float64[np.ndarray, "ny nx 3"]
    open_ground: Bool[np.ndarray, "ny nx"]


def lay_grid(site: Site, cell: float, height: float) -> Grid:
    """Grid of square cells over a site's area, with a point above the middle of each.

    cell: side of a cell (m); height: of the points above the ground (m). Raises ValueError for a
    cell that is not positive, so large that a side has fewer than two, or far too small."""
    area = site.area
    sides = area[2:] - area[:2]
    # 1.5 cells are rounded to two
    if not 0 < cell <= sides.min() / 1.5:
        raise ValueError(
            f"cell must be positive and fit twice into {sides[0]:g} x {sides[1]:g} m, got {cell:g}"
        )
    if (sides / cell).prod() > MAX_CELLS:
        problem = (
            f"cells of {cell:g} m make a grid of more than {MAX_CELLS} for {sides[0]:g} x "
            f"{sides[1]:g} m"
        )
        raise ValueError(
            f"{problem}: take cells of {np.sqrt(sides.prod() / MAX_CELLS):.2g} m or more"
        )
    middle_x, middle_y = (area[:2] + area[2:]) / 2
    columns, rows = np.rint(sides / cell)
    x = middle_x + (np.arange(columns) - (columns - 1) / 2) * cell
    y = middle_y + (np.arange(rows) - (rows - 1) / 2) * cell
    middles = np.stack(np.meshgrid(x, y), axis=-1)  # (ny, nx, x y)
    ground = np.concatenate([middles, site.ground(middles)[..., None]], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    return Grid(
        x=x,
        y=y,
        points=ground + height * up,
        open_ground=_open_ground(site, ground + TARGET_HEIGHT_M * up),
    )


def ground_shares(ground: GroundGrid, names: Sequence[str]) -> GroundShares:
    """Shares and areas of the open ground that sensors see, or that no sensor sees.

    names: names of the sensors, in the order of `ground`. Without lanes their blind share is 0.
    Raises ValueError for names that are too few, too many or not distinct, and for an area without
    open ground.
    """
    if len(names) != len(ground.seen) or len(set(names)) < len(names):
        raise ValueError(
            f"each of the {len(ground.seen)} sensors needs a name of its own, got {list(names)}"
        )
    if not ground.open_ground.any():
        raise ValueError(
            "the area has no open ground: solids cover all of it, so move the area or the solids"
        )
    views = ground.views[ground.open_ground]  # number of sensors that see each open cell
    cell_m2 = ground.cell**2
    is_blind_lane = (ground.views == 0)[ground.open_ground & ground.lanes]
    seen_cells = (ground.seen & ground.open_ground).sum(axis=(1, 2))  # for each sensor
    return GroundShares(
        seen_by=(
            float((views >= 1).mean()),
            float((views >= 2).mean()),
            float((views >= 3).mean()),
        ),
        blind=float((views == 0).mean()),
        blind_lanes=float(is_blind_lane.mean()) if len(is_blind_lane) else 0.0,
        sensor_m2=dict(zip(names, (seen_cells * cell_m2).tolist(), strict=True)),
        open_m2=float(len(views) * cell_m2),
        blind_m2=float((views == 0).sum() * cell_m2),
    )


def blind_polygons(ground: GroundGrid) -> list[shapely.Polygon]:
    """Open ground that no sensor sees, as polygons with holes (m, site frame).

    Pieces below `MIN_POLYGON_M2` are left out.
    """
    return _polygons(ground, ground.open_ground & (ground.views == 0))


def visible_polygons(ground: GroundGrid) -> list[list[shapely.Polygon]]:
    """Ground that each sensor sees, as polygons with holes (m, site frame).

    Pieces below `MIN_POLYGON_M2` are left out.
    """
    return [_polygons(ground, seen_cells & ground.open_ground) for seen_cells in ground.seen]


def _density(
    sensor: Sensor, image: ImageRanges, x: np.ndarray, y: np.ndarray
) -> Float32[np.ndarray, "ny nx"]:
    """Points of an image in each cell, per m².

    image: the sensor's measurements (m), 0 for no return; x, y: centres of the columns and rows of
    cells (m), evenly spaced."""
    # x y z (3, pixels), and a mask of pixels with a return
    xyz, is_valid = unproject(sensor, image)
    cell = x[1] - x[0]
    edges = [np.append(middles - cell / 2, middles[-1] + cell / 2) for middles in (y, x)]
    # rows along y, columns along x
    counts = np.histogram2d(xyz[1, is_valid], xyz[0, is_valid], bins=edges)[0]
    return (counts / cell**2).astype(np.float32)


def _open_ground(site: Site, targets: Float64[np.ndarray, "ny nx 3"]) -> Bool[np.ndarray, "ny nx"]:
    """Mask of targets without a pond or a solid close above the ground.

    targets: points `TARGET_HEIGHT_M` above the ground.
    """
    open_ground = np.ones(targets.shape[:2], bool)
    if not site.solids:
        return open_ground
    target_rows = targets.reshape(-1, 3)
    footprints = shapely.STRtree([shapely.Polygon(solid.footprint) for solid in site.solids])
    # pairs of a target and a solid on whose footprint it is
    target, solid_index = footprints.query(
        shapely.points(target_rows[:, :2]), predicate="intersects"
    )
    base = np.array([solid.base for solid in site.solids])[solid_index]
    top = np.array([solid.top for solid in site.solids])[solid_index]
    is_water = np.array([solid.kind == "pond" for solid in site.solids])[solid_index]
    height = target_rows[target, 2]
    ground = height - TARGET_HEIGHT_M
    # from less than the clearance above the ground up to the target or higher
    is_blocked = (base < ground + MIN_CLEARANCE_M) & (top >= height)
    open_ground.ravel()[target[is_water | is_blocked]] = False
    return open_ground


def _covered(
    polygons: Sequence[np.ndarray], middles: Float64[np.ndarray, "ny nx 2"]
) -> Bool[np.ndarray, "ny nx"]:
    """Mask of points on any of the polygons.

    polygons: corners x, y (m) of each; middles: x, y (m) of the points."""
    union = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons])
    shapely.prepare(union)
    return np.asarray(shapely.intersects_xy(union, middles[..., 0], middles[..., 1]))


def _polygons(ground: GroundGrid, mask: Bool[np.ndarray, "ny nx"]) -> list[shapely.Polygon]:
    """Polygons of the cells of a mask, with holes (m, site frame).

    Steps of slanting edges are smoothed to about half a cell; pieces and holes below
    `MIN_POLYGON_M2` are left out.
    """
    half = ground.cell / 2
    # 1 at the first cell of each run of cells in a row, -1 behind its last one
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, first_columns = np.nonzero(edges == 1)
    _, end_columns = np.nonzero(edges == -1)
    runs = shapely.box(
        ground.x[first_columns] - half,
        ground.y[rows] - half,
        ground.x[end_columns - 1] + half,
        ground.y[rows] + half,
    )
    # a grid of a thousandth of a cell closes gaps of rounding between the runs
    union = shapely.union_all(runs, grid_size=ground.cell / 1000)
    merged_runs = shapely.simplify(union, 1.2 * half)
    polygons = []
    for piece in shapely.get_parts(merged_runs):
        if piece.area >= MIN_POLYGON_M2:
            rings = piece.interiors
            holes = [ring for ring in rings if shapely.Polygon(ring).area >= MIN_POLYGON_M2]
            polygons.append(shapely.Polygon(piece.exterior, holes))
    return polygons
