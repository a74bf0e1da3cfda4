"""Ground of a site that sensors see, and the density of their points, by rays cast at the empty
site.

The area is cut into square cells. A sensor sees a cell if a place `TARGET_HEIGHT` above the ground
at its centre lies in the sensor's field of view and range, and nothing in the static scene is in
between. The density is counted in the frame that the sensor measures of the empty site, without
noise and before any crop by height; a point is on the ground if it would be the same without
anything but ground."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from toolkit.arrays import Bool, Float32, Float64, ImageRanges, Int64
from toolkit.frame import unproject
from toolkit.geometry import invert, transform
from toolkit.rendering.renderer import Renderer, SightLines
from toolkit.rendering.static_scene import build_scenery, ground as ground_mesh
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

# m above the ground: the tread of a tyre, clear of the roughness between the ground's vertices
TARGET_HEIGHT = 0.1
SAME = 1e-3  # m between measurements of one place
CLEARANCE = 1.0  # m of air below a solid from which the ground counts as open: tree crowns, roofs
SPECK = 1.0  # m²; polygons leave out smaller pieces and holes, which rays through leaves make
MOST_CELLS = 4_000_000  # of a grid


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground of the area that each sensor sees, as a grid of square cells.

    x, y: centres of columns and rows (m, site frame, ascending); seen: whether the centre of a cell
    of open ground is in unobstructed view; density: points that a frame puts on the cell's open
    ground, per m²; open_ground: free of solids and ponds; lanes, footways: kind of the cell."""

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
    """Shares of the area's open ground.

    seen_by: by at least 1, 2 and 3 sensors; blind: by none; blind_lanes: share of the lanes seen by
    none; sensor_m2: area that each sensor sees, by name; open_m2, blind_m2: area of open ground and
    of blind spots."""

    seen_by: tuple[float, float, float]
    blind: float
    blind_lanes: float
    sensor_m2: dict[str, float]
    open_m2: float
    blind_m2: float


def visible_ground(site: Site, sensors: Sequence[Sensor], *, cell: float = 0.5) -> Ground:
    """Compute the ground that each sensor sees. No sensor sees cells with a solid or a pond.

    cell: side of a cell (m). If it does not divide the area, the grid is centred on it and the
    outermost cells stick out or fall short by a quarter of a cell at most. Raises ValueError for a
    cell that is not positive, so large that a side has fewer than two, or far too small."""
    x, y, targets, open_ground = lay_grid(site, cell, TARGET_HEIGHT)
    middles = targets[..., :2]
    still = build_scenery(site)
    lines = SightLines(still)
    images = Renderer(site, (), sensors, still).background
    bare = Renderer(site, (), sensors, ground_mesh(site)).background
    shape = (len(sensors), len(y), len(x))
    seen = np.zeros(shape, bool)
    density = np.zeros(shape, np.float32)
    for s, sensor in enumerate(sensors):
        seen[s] = open_ground & sensor.model.in_view(transform(invert(sensor.pose), targets))
        seen[s, seen[s]] = lines.clear(sensor.position, targets[seen[s]])
        on_ground = np.where(np.abs(images[s] - bare[s]) < SAME, images[s], np.float32(0))
        density[s] = np.where(open_ground, _density(sensor, on_ground, x, y), np.float32(0))
    lanes, footways = (_covered(polygons, middles) for polygons in (site.lanes, site.footways))
    return Ground(x, y, seen, density, open_ground, lanes, footways)


def lay_grid(
    site: Site, cell: float, height: float
) -> tuple[np.ndarray, np.ndarray, Float64[np.ndarray, "ny nx 3"], Bool[np.ndarray, "ny nx"]]:
    """Centres of columns and rows of square cells over the area, places above them, and which are
    open ground. cell: side (m); height: of the places above the ground (m). Raises ValueError as
    `visible_ground`."""
    area = site.area
    sides = area[2:] - area[:2]
    if not 0 < cell <= sides.min() / 1.5:
        raise ValueError(
            f"cell must be positive and fit twice into {sides[0]:g} x {sides[1]:g} m, got {cell:g}"
        )
    if (sides / cell).prod() > MOST_CELLS:
        said = (
            f"cells of {cell:g} m make a grid of more than {MOST_CELLS} for {sides[0]:g} x "
            f"{sides[1]:g} m"
        )
        raise ValueError(
            f"{said}: take cells of {np.sqrt(sides.prod() / MOST_CELLS):.2g} m or more"
        )
    middle = (area[:2] + area[2:]) / 2
    x, y = (
        m + (np.arange(n) - (n - 1) / 2) * cell
        for m, n in zip(middle, np.rint(sides / cell), strict=True)
    )
    middles = np.stack(np.meshgrid(x, y), axis=-1)
    ground = np.concatenate([middles, site.ground(middles)[..., None]], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    return x, y, ground + height * up, _open_ground(site, ground + TARGET_HEIGHT * up)


def ground_shares(ground: Ground, names: Sequence[str]) -> GroundShares:
    """Compute shares of the ground. names: of its sensors, in order. Without lanes their blind
    share is 0. Raises ValueError for names that are too few, too many or not distinct, and for an
    area without open ground."""
    if len(names) != len(ground.seen) or len(set(names)) < len(names):
        raise ValueError(
            f"each of the {len(ground.seen)} sensors needs a name of its own, got {list(names)}"
        )
    if not ground.open_ground.any():
        raise ValueError(
            "the area has no open ground: solids cover all of it, so move the area or the solids"
        )
    views = ground.views[ground.open_ground]
    square = ground.cell**2
    lanes = (ground.views == 0)[ground.open_ground & ground.lanes]
    one, two, three = (float((views >= count).mean()) for count in (1, 2, 3))
    seen = (ground.seen & ground.open_ground).sum(axis=(1, 2))
    return GroundShares(
        seen_by=(one, two, three),
        blind=float((views == 0).mean()),
        blind_lanes=float(lanes.mean()) if len(lanes) else 0.0,
        sensor_m2=dict(zip(names, (seen * square).tolist(), strict=True)),
        open_m2=float(len(views) * square),
        blind_m2=float((views == 0).sum() * square),
    )


def blind_polygons(ground: Ground) -> list[shapely.Polygon]:
    """Open ground that no sensor sees, as polygons with holes (m, site frame) without pieces below
    `SPECK`."""
    return _polygons(ground, ground.open_ground & (ground.views == 0))


def visible_polygons(ground: Ground) -> list[list[shapely.Polygon]]:
    """Ground that each sensor sees, as polygons with holes (m, site frame) without pieces below
    `SPECK`."""
    return [_polygons(ground, seen & ground.open_ground) for seen in ground.seen]


def _density(
    sensor: Sensor, image: ImageRanges, x: np.ndarray, y: np.ndarray
) -> Float32[np.ndarray, "ny nx"]:
    """Points of an image in each cell, per m²."""
    xyz, valid = unproject(sensor, image)
    cell = x[1] - x[0]
    edges = [np.append(middles - cell / 2, middles[-1] + cell / 2) for middles in (y, x)]
    counts, _, _ = np.histogram2d(xyz[1, valid], xyz[0, valid], bins=edges)
    return (counts / cell**2).astype(np.float32)


def _open_ground(site: Site, targets: Float64[np.ndarray, "ny nx 3"]) -> Bool[np.ndarray, "ny nx"]:
    """Select targets where nothing stands and no pond lies."""
    open_ground = np.ones(targets.shape[:2], bool)
    if not site.solids:
        return open_ground
    flat = targets.reshape(-1, 3)
    solids = shapely.STRtree([shapely.Polygon(solid.footprint) for solid in site.solids])
    place, which = solids.query(shapely.points(flat[:, :2]), predicate="intersects")
    base, top = (
        np.array([getattr(solid, end) for solid in site.solids])[which] for end in ("base", "top")
    )
    water = np.array([solid.kind == "pond" for solid in site.solids])[which]
    height = flat[place, 2]
    stands = (base < height - TARGET_HEIGHT + CLEARANCE) & (top >= height)
    open_ground.ravel()[place[water | stands]] = False
    return open_ground


def _covered(
    polygons: Sequence[np.ndarray], middles: Float64[np.ndarray, "ny nx 2"]
) -> Bool[np.ndarray, "ny nx"]:
    """Select places on any of the polygons."""
    whole = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons])
    shapely.prepare(whole)
    return np.asarray(shapely.intersects_xy(whole, middles[..., 0], middles[..., 1]))


def _polygons(ground: Ground, mask: Bool[np.ndarray, "ny nx"]) -> list[shapely.Polygon]:
    """Merge cells along their edges. The steps of slanting edges are smoothed to about half a
    cell."""
    half = ground.cell / 2
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (rows, first), (_, end) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    # one for each run of cells in a row
    runs = shapely.box(
        ground.x[first] - half,
        ground.y[rows] - half,
        ground.x[end - 1] + half,
        ground.y[rows] + half,
    )
    merged = shapely.simplify(shapely.union_all(runs, grid_size=ground.cell / 1000), 1.2 * half)
    return [
        shapely.Polygon(
            part.exterior, [ring for ring in part.interiors if shapely.Polygon(ring).area >= SPECK]
        )
        for part in shapely.get_parts(merged)
        if part.area >= SPECK
    ]
