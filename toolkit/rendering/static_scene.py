"""The static scene of a site as one mesh: ground, buildings, hedges, trees, street furniture.

The ground follows `Site.ground`; footways are level with the street behind their kerbstones. Houses
get windows set into their walls, hedges a rough surface, crowns of trees leaves with gaps between
them, and a pond is a hole in the ground with its surface below. Chance is seeded by the site: the
same site gives the same mesh."""

from collections.abc import Callable

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Rng
from toolkit.geometry import LEVEL
from toolkit.mesh import Mesh, extrude, merge, place, triangulate
from toolkit.sites.site import Site, Solid

CELL = 1.5  # m, edge of the ground's cells within `FINE` of the area; beyond, they grow until `FAR`
FINE = 15.0
FAR = 150.0

MOST_SKIN = 2e6  # m², of buildings and plants
# m between windows, upwards and along a wall
_STOREY = 3.0
_BAY = 2.6
# m
WINDOW_HEIGHT = 1.4
WINDOW_WIDTH = 1.2
SILL = 0.9
RECESS = 0.14
ROUGHNESS = 0.09  # m, of a hedge
_HALVES = np.array([[0, 1, 2], [0, 2, 3]])  # of a quadrilateral
# m, size of a spray of leaves; how many there are per m² of a crown's outline
LEAF = 0.42
LEAVES = 11.0


def build_scenery(site: Site) -> Mesh:
    """Build the mesh of everything static at a site. Raises ValueError for solids of endless
    size."""
    rng = np.random.default_rng(sum(site.name.encode()))
    skin = sum(_skin(solid) for solid in site.solids)
    if not skin <= MOST_SKIN:
        limit = f"where {MOST_SKIN:g} m² can be drawn (a plant's counts four times)"
        remedy = "correct their sizes, or leave some out"
        raise ValueError(
            f"solids of site {site.name!r} have {skin:.3g} m² of skin, {limit}: {remedy}"
        )
    solids = []
    for solid in site.solids:
        draw = _SHAPES.get(solid.kind)
        vertices, triangles = (
            draw(solid, rng) if draw else extrude(solid.footprint, solid.base, solid.top)
        )
        if (
            site.relief.slope != LEVEL
        ):  # sheared with it; heights under the middle of the footprint stay
            rise = site.plane(vertices[:, :2] - solid.footprint.mean(axis=0))
            vertices = np.column_stack([vertices[:, :2], vertices[:, 2] + rise])
        solids.append(Mesh(vertices, triangles))
    banks = []
    for pond in (solid for solid in site.solids if solid.kind == "pond"):
        edge = _outline(pond.footprint, CELL)
        water = pond.top + site.plane(edge - pond.footprint.mean(axis=0))
        banks.append(
            _strip(np.stack([np.column_stack([edge, z]) for z in (site.ground(edge), water)]))
        )
    return merge([ground(site), *solids, *banks])


def ground(site: Site) -> Mesh:
    """Ground up to `FAR` beyond the area, open at ponds."""
    ponds = shapely.union_all(
        [shapely.Polygon(solid.footprint) for solid in site.solids if solid.kind == "pond"]
    )
    shapely.prepare(ponds)
    cells = _cells(site.area)
    low, high = np.split(np.array(ponds.bounds), 2)  # NaN without ponds
    near = np.flatnonzero(((cells[:, 3] <= high) & (cells[:, 1] >= low)).all(axis=1))
    squares = shapely.polygons(cells[near])
    wet = shapely.intersects(ponds, squares)
    shores = shapely.difference(squares[wet], ponds)
    corners = np.delete(cells, near[wet], axis=0)
    dry = _quadrilaterals(np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2))
    flat = merge([dry, triangulate(shores)])
    return Mesh(
        np.column_stack([flat.vertices[:, :2], site.ground(flat.vertices[:, :2])]), flat.triangles
    )


def _cells(area: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "n 4 2"]:
    """Corners of squares in and about the area: lower right, upper right, upper left, lower
    left."""
    steps = np.cumsum(CELL * 1.2 ** np.arange(1, 40))
    outside = FINE + steps[steps < FAR]

    def lines(low: float, high: float) -> Float64[np.ndarray, " k"]:
        inside = np.linspace(low - FINE, high + FINE, round((high - low + 2 * FINE) / CELL) + 1)
        return np.concatenate([low - outside[::-1], inside, high + outside])

    x, y = lines(area[0], area[2]), lines(area[1], area[3])
    (x0, y0), (x1, y1) = np.meshgrid(x[:-1], y[:-1]), np.meshgrid(x[1:], y[1:])
    return np.stack([x1, y0, x1, y1, x0, y1, x0, y0], axis=-1).reshape(-1, 4, 2)


def _skin(solid: Solid) -> float:
    """Skin of a solid (m²) as it counts, 0 if drawn as a plain prism."""
    if solid.kind not in _SHAPES:
        return 0.0
    outline = shapely.Polygon(solid.footprint)
    return (outline.length * (solid.top - solid.base) + outline.area) * (
        1 if solid.kind == "building" else 4
    )


def _building(solid: Solid, rng: Rng) -> Mesh:
    """Walls with windows, and a flat roof."""
    corners = _outline(solid.footprint, np.inf)
    walls = [
        _facade(a, b, solid.base, solid.top)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    roof = triangulate(shapely.Polygon(corners))
    return merge([*walls, place(roof, z=solid.top)])


def _facade(start: np.ndarray, end: np.ndarray, base: float, top: float) -> Mesh:
    """Wall from start to end with windows that fit."""
    length = float(np.hypot(*(end - start)))
    bays = int(length // _BAY)
    storeys = max(int((top - base - 0.3) // _STOREY), 0)
    middles = (np.arange(bays) + 0.5) * length / max(bays, 1)
    sills = base + 0.3 + _STOREY * np.arange(storeys) + SILL
    x = np.sort(
        np.concatenate([[0, length], middles - WINDOW_WIDTH / 2, middles + WINDOW_WIDTH / 2])
    )
    z = np.sort(np.concatenate([[base, top], sills, sills + WINDOW_HEIGHT]))
    along = (end - start) / max(length, 1e-9)
    inwards = np.array([-along[1], along[0]]) * RECESS

    def at(i: np.ndarray, j: np.ndarray, depth: float) -> np.ndarray:
        return np.concatenate(
            [start + x[i][..., None] * along + depth * inwards, z[j][..., None]], axis=-1
        )

    i, j = (index.ravel() for index in np.meshgrid(np.arange(len(x) - 1), np.arange(len(z) - 1)))
    pane = (i % 2 == 1) & (j % 2 == 1)
    around = [(0, 0), (1, 0), (1, 1), (0, 1)]
    wall = np.stack([at(i[~pane] + di, j[~pane] + dj, 0.0) for di, dj in around], axis=1)
    i, j = i[pane], j[pane]
    outer = np.stack([at(i + di, j + dj, 0.0) for di, dj in around], axis=1)
    inner = np.stack([at(i + di, j + dj, 1.0) for di, dj in around], axis=1)
    ways = [(k, (k + 1) % 4) for k in range(4)]
    sides = [
        np.stack([outer[:, a], outer[:, b], inner[:, b], inner[:, a]], axis=1) for a, b in ways
    ]
    return _quadrilaterals(np.concatenate([wall, inner, *sides]))


def _hedge(solid: Solid, rng: Rng) -> Mesh:
    """Prism with a bumpy skin, narrower at the top, that passes its footprint by the roughness at
    most."""
    outline = _outline(solid.footprint, 0.4)
    middle = outline.mean(axis=0)
    levels = np.linspace(solid.base, solid.top, max(3, round((solid.top - solid.base) / 0.4)))
    rings = []
    for level, narrow in zip(levels, np.linspace(1.0, 0.9, len(levels)), strict=True):
        ring = (
            middle + (outline - middle) * narrow + rng.uniform(-ROUGHNESS, ROUGHNESS, outline.shape)
        )
        rings.append(
            np.column_stack(
                [ring, level + rng.uniform(-ROUGHNESS, 0, len(ring)) * (level > solid.base)]
            )
        )
    top = np.concatenate([rings[-1], [[*middle, solid.top]]])
    lid = np.arange(len(outline))
    cap = np.stack([lid, np.roll(lid, -1), np.full(len(lid), len(lid))], axis=1)
    return merge([_strip(np.stack(rings)), Mesh(top, cap)])


def _bush(solid: Solid, rng: Rng) -> Mesh:
    """Dense core, and sprays of leaves over it."""
    middle = solid.footprint.mean(axis=0)
    core = Solid(
        middle + 0.75 * (solid.footprint - middle),
        solid.base,
        solid.base + 0.8 * (solid.top - solid.base),
    )
    leaves = Solid(middle + 0.85 * (solid.footprint - middle), solid.base, solid.top - LEAF / 3)
    return merge([_hedge(core, rng), _crown(leaves, rng)])


def _crown(solid: Solid, rng: Rng) -> Mesh:
    """Sprays of leaves, most near the outline."""
    polygon = shapely.Polygon(solid.footprint)
    height = solid.top - solid.base
    count = max(12, round(LEAVES * (polygon.length * height + polygon.area)))
    edge = shapely.line_interpolate_point(
        polygon.exterior, rng.uniform(0, 1, count), normalized=True
    )
    middle = shapely.get_coordinates(polygon.centroid)[0]
    out = rng.uniform(0.25, 1, count) ** 0.4
    xy = middle + (shapely.get_coordinates(edge) - middle) * out[:, None]
    z = solid.base + height * rng.uniform(0, 1, count)
    sprays = rng.normal(size=(count, 3, 3))
    sprays *= (
        LEAF / np.linalg.norm(sprays, axis=2, keepdims=True) * rng.uniform(0.5, 1.0, (count, 1, 1))
    )
    vertices = (np.column_stack([xy, z])[:, None] + sprays).reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


_Shape = Callable[[Solid, Rng], Mesh]
_SHAPES: dict[str, _Shape] = {"building": _building, "hedge": _hedge, "bush": _bush, "tree": _crown}


def _outline(footprint: Float[np.ndarray, "k 2"], spacing: float) -> Float64[np.ndarray, "m 2"]:
    """Corners of a footprint counter-clockwise, at most `spacing` apart."""
    ring = shapely.geometry.polygon.orient(shapely.Polygon(footprint)).exterior
    return shapely.get_coordinates(
        shapely.segmentize(ring, spacing) if np.isfinite(spacing) else ring
    )[:-1]


def _strip(rings: Float64[np.ndarray, "s p 3"]) -> Mesh:
    """Skin between closed rings of equally many points, without ends."""
    ahead = np.roll(rings, -1, axis=1)
    return _quadrilaterals(
        np.stack([rings[:-1], ahead[:-1], ahead[1:], rings[1:]], axis=2).reshape(-1, 4, 3)
    )


def _quadrilaterals(corners: Float64[np.ndarray, "q 4 3"]) -> Mesh:
    first = np.arange(0, 4 * len(corners), 4)[:, None]
    return Mesh(corners.reshape(-1, 3), np.concatenate([first + _HALVES[0], first + _HALVES[1]]))
