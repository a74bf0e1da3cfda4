"""A site in 3D: ground with its relief, streets, solids and poles."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.mesh import Mesh, extrude, merge, triangulate, tube
from toolkit.plots.palette import GROUND, OTHER_SOLID, POLE_INK, SOLID
from toolkit.sites.site import Mount, Site
from toolkit.viewing import scene_parts

if TYPE_CHECKING:
    from viser import SceneApi

# Darker than on maps, because the light of the scene whitens them.
_SHADES = {**SOLID, "pond": "#a0c8dc", "tree": "#9fbf8c", "hedge": "#93b57f", "trunk": "#7a6554"}
_FREE_POLE = "#8c8c8c"
_LANE = "#b4b6ba"
_BARE_GROUND = "#dfe2d8"
FREE_POLE_RADIUS_M = 0.06
USED_POLE_RADIUS_M = 0.12
# heights above the ground, so that nothing flickers
LANE_LIFT_M = 0.03
FOOTWAY_LIFT_M = 0.04
GROUND_MARGIN_M = 25.0  # ground drawn around the area
TILE_M = 4.0  # side of the tiles into which ground and streets are cut to follow the relief
MIN_TILE_AREA_M2 = 1e-6  # smaller pieces are slivers of rounding


def add_site(api: "SceneApi", site: Site, used_poles: set[str]) -> None:
    """Add ground, streets, solids and poles to a scene.

    api: scene of viser; used_poles: names of the poles that carry a sensor, which are thicker and
    darker."""
    scene_parts.add_mesh(api, name="/site/ground", mesh=ground_mesh(site), colour=_BARE_GROUND)
    # name of the part, outlines, height above the ground at which it is drawn, and colour
    for name, outlines, lift_m, colour in (
        ("lanes", site.lanes, LANE_LIFT_M, _LANE),
        ("footways", site.footways, FOOTWAY_LIFT_M, GROUND["footways"]),
    ):
        polygons = [shapely.Polygon(outline) for outline in outlines]
        scene_parts.add_mesh(
            api, name=f"/site/{name}", mesh=drape(site, polygons, lift=lift_m), colour=colour
        )
    meshes_by_kind: dict[str, list[Mesh]] = {}
    for solid in site.solids:
        mesh = extrude(solid.footprint, solid.base, solid.top)
        meshes_by_kind.setdefault(solid.kind, []).append(mesh)
    for kind, meshes in sorted(meshes_by_kind.items()):
        scene_parts.add_mesh(
            api, name=f"/site/{kind}", mesh=merge(meshes), colour=_SHADES.get(kind, OTHER_SOLID)
        )
    free_mounts = [mount for mount in site.mounts if mount.name not in used_poles]
    used_mounts = [mount for mount in site.mounts if mount.name in used_poles]
    free_poles = _pole_tubes(free_mounts, FREE_POLE_RADIUS_M)
    poles_in_use = _pole_tubes(used_mounts, USED_POLE_RADIUS_M)
    scene_parts.add_mesh(api, name="/site/free poles", mesh=free_poles, colour=_FREE_POLE)
    scene_parts.add_mesh(api, name="/site/poles in use", mesh=poles_in_use, colour=POLE_INK)


def _pole_tubes(mounts: Sequence[Mount], radius: float) -> Mesh:
    """Return tubes from the foot of each mount to its highest place for sensors. radius: m."""
    tubes = []
    for mount in mounts:
        top = mount.position + np.array([0.0, 0, mount.max_height])
        tubes.append(tube(np.stack([mount.position, top]), radius))
    return merge(tubes)


def ground_mesh(site: Site) -> Mesh:
    """Return the ground in the area and `GROUND_MARGIN_M` around it, with holes at ponds."""
    ponds = [shapely.Polygon(solid.footprint) for solid in site.solids if solid.kind == "pond"]
    return drape(site, [shapely.box(*_extent(site))], lift=0.0, without=ponds)


def drape(
    site: Site,
    shapes: Sequence[shapely.Polygon],
    *,
    lift: float,
    without: Sequence[shapely.Polygon] = (),
) -> Mesh:
    """Return polygons as a mesh that follows the relief, `lift` metres over the ground.

    Polygons are cut into square tiles, and only their part in or near the area is kept.

    shapes, without: polygons to draw, and polygons to cut out, in the site's frame (m)."""
    xmin, ymin, xmax, ymax = _extent(site)
    grid = np.meshgrid(np.arange(xmin, xmax, TILE_M), np.arange(ymin, ymax, TILE_M))
    x, y = (coordinates.ravel() for coordinates in grid)  # lower left corner of each tile
    drawn_shape = shapely.union_all(list(shapes)).difference(shapely.union_all(list(without)))
    tiles = shapely.intersection(drawn_shape, shapely.box(x, y, x + TILE_M, y + TILE_M))
    is_drawn = ~shapely.is_empty(tiles) & (shapely.area(tiles) > MIN_TILE_AREA_M2)
    return lift_to_ground(site, triangulate(tiles[is_drawn]), lift)


def lift_to_ground(site: Site, flat_mesh: Mesh, lift: float) -> Mesh:
    """Return the mesh with every vertex `lift` metres over the ground below it."""
    return Mesh(lift_points(site, flat_mesh.vertices[:, :2], lift), flat_mesh.triangles)


def lift_points(
    site: Site, xy: Float64[np.ndarray, "n 2"], lift: float
) -> Float64[np.ndarray, "n 3"]:
    """Return points (x, y, z in m) `lift` metres over the ground. xy: their x and y (m)."""
    return np.column_stack([xy, site.ground(xy) + lift])


def _extent(site: Site) -> tuple[float, float, float, float]:
    """Return xmin, ymin, xmax and ymax (m) of the drawn ground: the area with a margin."""
    xmin, ymin, xmax, ymax = site.area.tolist()
    return (
        xmin - GROUND_MARGIN_M,
        ymin - GROUND_MARGIN_M,
        xmax + GROUND_MARGIN_M,
        ymax + GROUND_MARGIN_M,
    )
