"""Triangle meshes from a few solids: lofts, tubes, ellipsoids, boxes and extruded polygons, all
wound outwards."""

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float, Float64, Int64

Vector = tuple[float | int, float | int, float | int]
Span = tuple[float, float]


class Mesh(NamedTuple):
    """Vertices (m), and triangles counter-clockwise from outside."""

    vertices: Float64[np.ndarray, "k 3"]
    triangles: Int64[np.ndarray, "m 3"]


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Join meshes into one."""
    meshes = [Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), *meshes]
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


def loft(rings: Float[np.ndarray, "s p 3"]) -> Mesh:
    """Skin over s closed rings of p points each, with both ends capped. Outwards where a ring runs
    counter-clockwise seen against the direction in which the rings follow each other."""
    s, p, _ = rings.shape
    vertices = np.concatenate(
        [rings.reshape(-1, 3), rings[0].mean(0)[None], rings[-1].mean(0)[None]]
    )
    return Mesh(vertices.astype(np.float64), _loft_triangles(s, p).copy())


@lru_cache(maxsize=256)
def _loft_triangles(s: int, p: int) -> Int64[np.ndarray, "m 3"]:
    ring, point = np.meshgrid(np.arange(s - 1) * p, np.arange(p), indexing="ij")
    a = (ring + point).ravel()
    b = (ring + (point + 1) % p).ravel()
    first = s * p
    last = s * p + 1
    around = np.arange(p)
    onward = (np.arange(p) + 1) % p
    bottom = (onward, around, np.full(p, first))
    top = (around + (s - 1) * p, onward + (s - 1) * p, np.full(p, last))
    columns = (a, b, b + p), (a, b + p, a + p), bottom, top  # of the skin, then of the caps
    return np.concatenate([np.stack(three, axis=1) for three in columns]).astype(np.int64)


def tube(
    path: np.typing.ArrayLike, radii: np.typing.ArrayLike, sides: int = 8, flat: float = 1.0
) -> Mesh:
    """Round bar along `path` (s, 3), of one radius or s `radii`. flat: scale of its breadth along y
    (x, if along y)."""
    line = np.asarray(path, np.float64)
    along = np.concatenate(
        [line[1:2] - line[:1], (line[2:] - line[:-2]) / 2, line[-1:] - line[-2:-1]]
    )
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    reference = (
        np.array([0.0, 1.0, 0.0]) if np.abs(along[:, 1]).max() < 0.95 else np.array([0.0, 0.0, 1.0])
    )
    across = _cross(reference[None], along)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    aside = _cross(along, across) * flat
    angle = np.arange(sides) * 2 * np.pi / sides
    circle = across[:, None] * np.cos(angle)[:, None] + aside[:, None] * np.sin(angle)[:, None]
    return loft(
        line[:, None]
        + circle * np.broadcast_to(np.asarray(radii, np.float64), len(line))[:, None, None]
    )


def ellipsoid(centre: Vector, radii: Vector, rings: int = 5, sides: int = 8) -> Mesh:
    """Ellipsoid with poles along z."""
    return loft(_unit_sphere(rings, sides) * radii + centre)


@lru_cache(maxsize=64)
def _unit_sphere(rings: int, sides: int) -> Float64[np.ndarray, "_ _ 3"]:
    polar = np.linspace(-np.pi / 2, np.pi / 2, rings + 2)[:, None]
    polar[[0, -1]] *= 0.999
    around = (np.arange(sides) * 2 * np.pi / sides)[None]
    unit = np.stack(
        np.broadcast_arrays(
            np.cos(polar) * np.cos(around), np.cos(polar) * np.sin(around), np.sin(polar)
        )
    )
    return np.moveaxis(unit, 0, -1)


def _cross(
    a: Float64[np.ndarray, "_ 3"], b: Float64[np.ndarray, "_ 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Cross products by row, fast for few rows."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def box(size: Vector, centre: Vector = (0, 0, 0)) -> Mesh:
    """Cuboid with edges along the axes."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2
    rings = np.stack([corners - [0, 0, 0.5], corners - [0, 0, -0.5]])
    return loft(rings * size + centre)


def extrude(polygon: Float[np.ndarray, "k 2"], base: float, top: float) -> Mesh:
    """Vertical prism over a simple polygon without holes."""
    outline = shapely.geometry.polygon.orient(shapely.Polygon(polygon))
    ring = np.asarray(outline.exterior.coords)[:-1]
    walls = loft(np.stack([np.column_stack([ring, np.full(len(ring), z)]) for z in (base, top)]))
    sides = Mesh(walls.vertices, walls.triangles[: 2 * len(ring)])
    lid = triangulate(outline)
    low, high = (
        np.column_stack([lid.vertices[:, :2], np.full(len(lid.vertices), z)]) for z in (base, top)
    )
    return merge([sides, Mesh(high, lid.triangles), Mesh(low, lid.triangles[:, ::-1])])


def triangulate(shape: shapely.Geometry | np.ndarray) -> Mesh:
    """Triangles of polygons with holes, z = 0, facing up."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
    if len(parts) == 0:
        return merge([])
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    corners = np.where((ax * by - ay * bx < 0)[:, None, None], corners[:, ::-1], corners)
    flat = np.concatenate([corners.reshape(-1, 2), np.zeros((3 * len(corners), 1))], axis=1)
    return Mesh(flat, np.arange(3 * len(corners)).reshape(-1, 3))


def place(mesh: Mesh, x: float = 0.0, y: float = 0.0, z: float = 0.0, *, yaw: float = 0.0) -> Mesh:
    """Turn a mesh by `yaw` (rad), then move it."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Mesh(mesh.vertices @ turn + [x, y, z], mesh.triangles)


def scale_mesh(mesh: Mesh, factors: float | Sequence[float]) -> Mesh:
    """Scale a mesh about the origin, by one factor or along each axis."""
    return Mesh(mesh.vertices * factors, mesh.triangles)


def stand(mesh: Mesh) -> Mesh:
    """Move a mesh onto z = 0."""
    return place(mesh, z=-mesh.vertices[:, 2].min())


def flip_sides(mesh: Mesh) -> Mesh:
    """Exchange left and right (y) of a mesh."""
    return Mesh(mesh.vertices * [1.0, -1.0, 1.0], mesh.triangles[:, ::-1])
