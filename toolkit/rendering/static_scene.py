"""The static scene of a site as one mesh: ground, buildings, hedges, trees, street furniture.

The ground follows `Site.ground`; footways are level with the street behind their kerbstones. Houses
get windows set into their walls, hedges a rough surface, crowns of trees leaves with gaps between
them, and a pond is a hole in the ground with its surface below. Chance is seeded by the site: the
same site gives the same mesh."""

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Rng
from toolkit.geometry import LEVEL
from toolkit.mesh import Mesh, extrude, merge, place, triangulate
from toolkit.sites.site import Site, Solid

CELL = 1.5  # m, edge of the ground's cells within `FINE` of the area; beyond, they grow until `FAR`
FINE = 15.0  # m from the area
FAR = 150.0  # m from the area
MAX_SKIN_M2 = 2e6  # limit of the area to draw on buildings and plants, which bounds the triangles
WINDOW_STOREY_M = 3.0  # from window to window upwards
WINDOW_BAY_M = 2.6  # from window to window along a wall
WINDOW_HEIGHT_M = 1.4
WINDOW_WIDTH_M = 1.2
FIRST_FLOOR_M = 0.3  # above the ground
SILL_M = 0.9  # above the floor of a storey
RECESS = 0.14  # m, of windows
ROUGHNESS = 0.09  # m, of a hedge
HEDGE_STEP_M = 0.4  # between vertices of a hedge's surface, along the outline and upwards
LEAF_M = 0.42  # size of a spray of leaves
LEAVES_PER_M2 = 11.0  # sprays on a crown's outline
SKINNED_KINDS = ("building", "hedge", "bush", "tree")

_HALVES = np.array([[0, 1, 2], [0, 2, 3]])  # triangles of a quadrilateral
_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))  # corners of a cell, counter-clockwise


def build_scenery(site: Site) -> Mesh:
    """Build the mesh of everything static at a site (m, site frame).

    Raises ValueError for solids with more surface than `MAX_SKIN_M2`, or with NaN sizes."""
    # One generator for all solids: what a solid draws depends on the solids before it. Its seed is
    # the sum of the bytes of the site's name.
    rng = np.random.default_rng(sum(site.name.encode()))
    # area (m²) of walls, roofs and leaves to draw
    skin = sum(_measure_skin(solid) for solid in site.solids)
    if not skin <= MAX_SKIN_M2:  # `not`, so that NaN is refused too
        limit = f"where {MAX_SKIN_M2:g} m² can be drawn (a plant's counts four times)"
        remedy = "correct their sizes, or leave some out"
        raise ValueError(
            f"solids of site {site.name!r} have {skin:.3g} m² of skin, {limit}: {remedy}"
        )
    solids = []
    for solid in site.solids:
        mesh = _draw_solid(solid, rng)
        if site.relief.slope != LEVEL:
            mesh = _shear(mesh, solid, site)
        solids.append(mesh)
    banks = [_make_banks(solid, site) for solid in site.solids if solid.kind == "pond"]
    return merge([ground(site), *solids, *banks])


def _draw_solid(solid: Solid, rng: Rng) -> Mesh:
    """Draw one solid as its kind looks; a kind without a special look is a prism."""
    if solid.kind == "building":
        return _make_building(solid)
    if solid.kind == "hedge":
        return _draw_hedge(solid, rng)
    if solid.kind == "bush":
        return _draw_bush(solid, rng)
    if solid.kind == "tree":
        return _draw_crown(solid, rng)
    return extrude(solid.footprint, solid.base, solid.top)


def _shear(mesh: Mesh, solid: Solid, site: Site) -> Mesh:
    """Shear a solid's mesh with the site's slope; the middle of its footprint keeps its height."""
    xy = mesh.vertices[:, :2]
    z = mesh.vertices[:, 2]
    rise = site.plane(xy - solid.footprint.mean(axis=0))
    return Mesh(np.column_stack([xy, z + rise]), mesh.triangles)


def _make_banks(pond: Solid, site: Site) -> Mesh:
    """Walls of a pond's edge, from the ground down to its water."""
    edge = _outline(pond.footprint, CELL)
    water = pond.top + site.plane(edge - pond.footprint.mean(axis=0))
    rings = [np.column_stack([edge, z]) for z in (site.ground(edge), water)]
    return _make_strip(np.stack(rings))


def ground(site: Site) -> Mesh:
    """Mesh of the ground up to `FAR` metres beyond the site's area, with holes at ponds.

    Cells that meet a pond are replaced by triangles of their dry part."""
    shapes = [shapely.Polygon(solid.footprint) for solid in site.solids if solid.kind == "pond"]
    ponds = shapely.union_all(shapes)
    shapely.prepare(ponds)
    # (cells, 4 corners, xy)
    cells = _make_cells(site.area)
    low, high = np.split(np.array(ponds.bounds), 2)  # x and y each, NaN without ponds
    upper_right = cells[:, 1]  # corners are lower right, upper right, upper left, lower left
    lower_left = cells[:, 3]
    # only cells that meet the box around all ponds; comparisons with NaN choose none
    near_rows = np.flatnonzero(((lower_left <= high) & (upper_right >= low)).all(axis=1))
    squares = shapely.polygons(cells[near_rows])
    is_wet = shapely.intersects(ponds, squares)
    shores = shapely.difference(squares[is_wet], ponds)
    dry_cells = np.delete(cells, near_rows[is_wet], axis=0)
    # a level mesh first, whose vertices then get their heights
    zeros = np.zeros((*dry_cells.shape[:2], 1))
    dry_mesh = _make_quadrilaterals(np.concatenate([dry_cells, zeros], axis=2))
    level_mesh = merge([dry_mesh, triangulate(shores)])
    xy = level_mesh.vertices[:, :2]  # x and y (m)
    return Mesh(np.column_stack([xy, site.ground(xy)]), level_mesh.triangles)


def _make_cells(area: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "n 4 2"]:
    """Corners (x, y) of the ground's cells in and about an area.

    area: xmin, ymin, xmax, ymax (m). Each cell is a rectangle, its corners in the order lower
    right, upper right, upper left, lower left (counter-clockwise)."""
    xmin, ymin, xmax, ymax = area
    x = _cell_borders(xmin, xmax)
    y = _cell_borders(ymin, ymax)
    # left and lower, then right and upper sides of all cells
    x0, y0 = np.meshgrid(x[:-1], y[:-1])
    x1, y1 = np.meshgrid(x[1:], y[1:])
    return np.stack([x1, y0, x1, y1, x0, y1, x0, y0], axis=-1).reshape(-1, 4, 2)


def _cell_borders(low: float, high: float) -> Float64[np.ndarray, " k"]:
    """Rising coordinates of the cells' borders along one axis of an area from `low` to `high` (m).

    Cells grow by a fifth from one to the next beyond `FINE`."""
    # distances of the borders from the area; 39 growing cells reach farther than `FAR`
    steps = np.cumsum(CELL * 1.2 ** np.arange(1, 40))
    outer_steps = FINE + steps[steps < FAR]
    inner_borders = np.linspace(low - FINE, high + FINE, round((high - low + 2 * FINE) / CELL) + 1)
    return np.concatenate([low - outer_steps[::-1], inner_borders, high + outer_steps])


def _measure_skin(solid: Solid) -> float:
    """Area of a solid's sides and top (m²) that `MAX_SKIN_M2` limits, 0 for a plain prism.

    The area of a plant counts four times."""
    if solid.kind not in SKINNED_KINDS:
        return 0.0
    outline = shapely.Polygon(solid.footprint)
    weight = 1 if solid.kind == "building" else 4
    sides = outline.length * (solid.top - solid.base)
    return (sides + outline.area) * weight


def _make_building(solid: Solid) -> Mesh:
    """Mesh of a building: walls with windows, and a flat roof."""
    corners = _outline(solid.footprint, np.inf)
    next_corners = np.roll(corners, -1, axis=0)
    walls = [
        _make_facade(start, end, solid.base, solid.top)
        for start, end in zip(corners, next_corners, strict=True)
    ]
    roof = triangulate(shapely.Polygon(corners))
    return merge([*walls, place(roof, z=solid.top)])


def _make_facade(start: np.ndarray, end: np.ndarray, base: float, top: float) -> Mesh:
    """Mesh of a wall from start to end with as many windows as fit, each set in by `RECESS`.

    start, end: x, y (m), the building on the left of the way between them; base, top: z (m)."""
    length = float(np.hypot(*(end - start)))
    bays = int(length // WINDOW_BAY_M)
    storeys = max(int((top - base - FIRST_FLOOR_M) // WINDOW_STOREY_M), 0)
    middles = (np.arange(bays) + 0.5) * length / max(bays, 1)
    sills = base + FIRST_FLOOR_M + WINDOW_STOREY_M * np.arange(storeys) + SILL_M
    half_window = WINDOW_WIDTH_M / 2
    # borders of the wall's grid along it (m from start) and upwards (z): every second column and
    # row, from the second on, holds windows
    x = np.sort(np.concatenate([[0, length], middles - half_window, middles + half_window]))
    z = np.sort(np.concatenate([[base, top], sills, sills + WINDOW_HEIGHT_M]))
    ahead = (end - start) / max(length, 1e-9)
    inwards = np.array([-ahead[1], ahead[0]]) * RECESS

    def corners(i: np.ndarray, j: np.ndarray, depth: float) -> np.ndarray:
        """Corners (cells, 4, 3) of the wall's cells in columns i and rows j of its grid.

        depth: how far inwards, as a multiple of `RECESS`: 1 for panes, 0 for the wall. The grid has
        borders at x (m along the wall, in the direction `ahead` from its start) and z (m)."""
        points = []
        for di, dj in _CORNERS:  # 0 or 1: the border before or after the cell
            xy = start + x[i + di][..., None] * ahead + depth * inwards
            points.append(np.concatenate([xy, z[j + dj][..., None]], axis=-1))
        return np.stack(points, axis=1)

    columns, rows = np.meshgrid(np.arange(len(x) - 1), np.arange(len(z) - 1))
    i = columns.ravel()
    j = rows.ravel()
    is_pane = (i % 2 == 1) & (j % 2 == 1)
    wall = corners(i[~is_pane], j[~is_pane], 0.0)
    frames = corners(i[is_pane], j[is_pane], 0.0)
    panes = corners(i[is_pane], j[is_pane], 1.0)
    reveals = []  # the four sides of each recess, between frame and pane
    for corner in range(4):
        next_corner = (corner + 1) % 4
        side = [frames[:, corner], frames[:, next_corner], panes[:, next_corner], panes[:, corner]]
        reveals.append(np.stack(side, axis=1))
    return _make_quadrilaterals(np.concatenate([wall, panes, *reveals]))


def _draw_hedge(solid: Solid, rng: Rng) -> Mesh:
    """Draw a hedge: a prism with bumpy sides, a tenth narrower at the top.

    It passes its footprint by `ROUGHNESS` at most."""
    outline = _outline(solid.footprint, HEDGE_STEP_M)
    middle = outline.mean(axis=0)
    height = solid.top - solid.base
    levels = np.linspace(solid.base, solid.top, max(3, round(height / HEDGE_STEP_M)))
    widths = np.linspace(1.0, 0.9, len(levels))  # relative to the footprint
    rings = []
    # the order of the draws fixes the mesh: for each ring its bumps, then its drops
    for level, width in zip(levels, widths, strict=True):
        bumps = rng.uniform(-ROUGHNESS, ROUGHNESS, outline.shape)
        ring = middle + (outline - middle) * width + bumps
        # the lowest ring keeps its height, but draws too
        drops = rng.uniform(-ROUGHNESS, 0, len(ring)) * (level > solid.base)
        rings.append(np.column_stack([ring, level + drops]))
    # the cap: a triangle from each side of the last ring to a vertex in its middle, the last one
    cap_vertices = np.concatenate([rings[-1], [[*middle, solid.top]]])
    first = np.arange(len(outline))
    centre = np.full(len(first), len(first))
    cap_triangles = np.stack([first, np.roll(first, -1), centre], axis=1)
    return merge([_make_strip(np.stack(rings)), Mesh(cap_vertices, cap_triangles)])


def _draw_bush(solid: Solid, rng: Rng) -> Mesh:
    """Draw a bush: a dense core like a hedge, and sprays of leaves over it.

    Both are narrower and lower than the solid, as leaves reach beyond their outline."""
    middle = solid.footprint.mean(axis=0)
    offsets = solid.footprint - middle
    core_top = solid.base + 0.8 * (solid.top - solid.base)
    core = Solid(middle + 0.75 * offsets, base=solid.base, top=core_top)
    leaves_top = solid.top - LEAF_M / 3
    leaves = Solid(middle + 0.85 * offsets, base=solid.base, top=leaves_top)
    # the core draws its random numbers first
    return merge([_draw_hedge(core, rng), _draw_crown(leaves, rng)])


def _draw_crown(solid: Solid, rng: Rng) -> Mesh:
    """Draw the crown of a tree or bush: loose triangles as sprays of leaves, most near the outline.

    Gaps between them let rays through."""
    polygon = shapely.Polygon(solid.footprint)
    height = solid.top - solid.base
    # in proportion to the surface of sides and top
    count = max(12, round(LEAVES_PER_M2 * (polygon.length * height + polygon.area)))
    # the order of the draws below fixes the mesh
    stations = rng.uniform(0, 1, count)  # along the outline, 0 to 1
    edge_points = shapely.line_interpolate_point(polygon.exterior, stations, normalized=True)
    middle = shapely.get_coordinates(polygon.centroid)[0]
    shares = rng.uniform(0.25, 1, count) ** 0.4  # share of the way from the middle to the outline
    xy = middle + (shapely.get_coordinates(edge_points) - middle) * shares[:, None]
    z = solid.base + height * rng.uniform(0, 1, count)
    # offsets of a spray's three corners from its place, (sprays, corners, xyz)
    sprays = rng.normal(size=(count, 3, 3))
    scales = LEAF_M / np.linalg.norm(sprays, axis=2, keepdims=True)
    sprays *= scales * rng.uniform(0.5, 1.0, (count, 1, 1))
    vertices = (np.column_stack([xy, z])[:, None] + sprays).reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _outline(footprint: Float[np.ndarray, "k 2"], spacing: float) -> Float64[np.ndarray, "m 2"]:
    """Points of a footprint's outline (x, y; m), counter-clockwise, the first not repeated.

    spacing: largest distance (m) between neighbours, infinite for the corners only."""
    ring = shapely.geometry.polygon.orient(shapely.Polygon(footprint)).exterior
    if np.isfinite(spacing):
        ring = shapely.segmentize(ring, spacing)
    return shapely.get_coordinates(ring)[:-1]


def _make_strip(rings: Float64[np.ndarray, "s p 3"]) -> Mesh:
    """Mesh between successive closed rings, open at both ends.

    rings: (ring, point, x y z), p points each; the last point of a ring joins the first."""
    next_points = np.roll(rings, -1, axis=1)  # next point of the same ring
    # around each quadrilateral: two points of a ring, then the two of the next ring, reversed
    corners = np.stack([rings[:-1], next_points[:-1], next_points[1:], rings[1:]], axis=2)
    return _make_quadrilaterals(corners.reshape(-1, 4, 3))


def _make_quadrilaterals(corners: Float64[np.ndarray, "q 4 3"]) -> Mesh:
    """Mesh of quadrilaterals, two triangles each; corners are not shared between them."""
    first = np.arange(0, 4 * len(corners), 4)[:, None]
    return Mesh(corners.reshape(-1, 3), np.concatenate([first + _HALVES[0], first + _HALVES[1]]))
