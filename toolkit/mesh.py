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
    """Join meshes into one; an empty mesh for no meshes."""
    no_mesh = Mesh(vertices=np.zeros((0, 3)), triangles=np.zeros((0, 3), np.int64))
    meshes = [no_mesh, *meshes]
    # triangles hold row numbers of vertices, which grow by the vertices of the meshes before
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


def loft(rings: Float[np.ndarray, "s p 3"]) -> Mesh:
    """Return a closed skin over a row of rings, with both ends capped.

    Args:
        rings: s closed rings of p points x, y, z each. Faces point outwards if every ring runs
            counter-clockwise as seen from the last ring.
    """
    ring_count, points_per_ring, _ = rings.shape
    bottom_centre = rings[0].mean(0)[None]
    top_centre = rings[-1].mean(0)[None]
    vertices = np.concatenate([rings.reshape(-1, 3), bottom_centre, top_centre])
    triangles = _loft_triangles(ring_count, points_per_ring)
    return Mesh(vertices.astype(np.float64), triangles.copy())  # the cached ones stay as they are


@lru_cache(maxsize=256)
def _loft_triangles(ring_count: int, points_per_ring: int) -> Int64[np.ndarray, "m 3"]:
    """Return the triangles of `loft`: two for each piece of the skin, then both caps.

    ring_count: number of rings. Vertices are the points ring by ring, then the centres of the first
    and of the last ring.
    """
    # these are row numbers of vertices; first in the first ring
    point = np.arange(points_per_ring)
    next_point = (point + 1) % points_per_ring
    # a piece of the skin is a quadrilateral: its lower edge from a to b, and its upper edge
    ring_start = np.arange(ring_count - 1)[:, None] * points_per_ring
    a = (ring_start + point).ravel()
    b = (ring_start + next_point).ravel()
    above_a = a + points_per_ring
    above_b = b + points_per_ring
    bottom_centre = np.full(points_per_ring, ring_count * points_per_ring)
    top_centre = bottom_centre + 1
    last_ring_start = (ring_count - 1) * points_per_ring
    corners = [
        (a, b, above_b),
        (a, above_b, above_a),
        (next_point, point, bottom_centre),
        (point + last_ring_start, next_point + last_ring_start, top_centre),
    ]
    triangles = [np.stack(corner_columns, axis=1) for corner_columns in corners]
    return np.concatenate(triangles).astype(np.int64)


def tube(
    path: np.typing.ArrayLike, radii: np.typing.ArrayLike, sides: int = 8, flat: float = 1.0
) -> Mesh:
    """Return a round bar along a line.

    Args:
        path: Points (s, 3) of the line, m.
        radii: One radius, or one for each point, m.
        sides: Number of sides of its cross-section.
        flat: Scale of its breadth along y, or along z for a bar that runs along y.
    """
    line = np.asarray(path, np.float64)
    radius = np.broadcast_to(np.asarray(radii, np.float64), len(line))
    # at the first point, the points between, and the last point
    tangent = np.concatenate(
        [line[1:2] - line[:1], (line[2:] - line[:-2]) / 2, line[-1:] - line[-2:-1]]
    )
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    # the reference must not be parallel to the bar
    runs_along_y = np.abs(tangent[:, 1]).max() >= 0.95
    reference = np.array([0.0, 0.0, 1.0]) if runs_along_y else np.array([0.0, 1.0, 0.0])
    # two directions of the cross-section, perpendicular to the line and to each other
    first_axis = _cross(reference[None], tangent)
    first_axis /= np.maximum(np.linalg.norm(first_axis, axis=1, keepdims=True), 1e-9)
    second_axis = _cross(tangent, first_axis) * flat
    angle = np.arange(sides) * 2 * np.pi / sides
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    circle = first_axis[:, None] * cos + second_axis[:, None] * sin
    return loft(line[:, None] + circle * radius[:, None, None])


def ellipsoid(centre: Vector, radii: Vector, rings: int = 5, sides: int = 8) -> Mesh:
    """Return an ellipsoid with its poles along z; `rings` between the poles, of `sides` points."""
    return loft(_unit_sphere(rings, sides) * radii + centre)


@lru_cache(maxsize=64)
def _unit_sphere(rings: int, sides: int) -> Float64[np.ndarray, "_ _ 3"]:
    """Return rings (rings + 2, sides, 3) of a sphere of radius 1, from south to north.

    rings: number of rings between the poles; sides: number of points of each ring."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 2)[:, None]
    latitude[[0, -1]] *= 0.999  # rings about the poles, not points
    longitude = (np.arange(sides) * 2 * np.pi / sides)[None]
    x = np.cos(latitude) * np.cos(longitude)
    y = np.cos(latitude) * np.sin(longitude)
    z = np.sin(latitude)
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def _cross(
    a: Float64[np.ndarray, "_ 3"], b: Float64[np.ndarray, "_ 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Cross products by row, fast for few rows."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def box(size: Vector, centre: Vector = (0, 0, 0)) -> Mesh:
    """Return a cuboid with edges along the axes."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2
    rings = np.stack([corners - [0, 0, 0.5], corners - [0, 0, -0.5]])
    return loft(rings * size + centre)


def extrude(polygon: Float[np.ndarray, "k 2"], base: float, top: float) -> Mesh:
    """Return a vertical prism from z = base to z = top over a simple polygon without holes.

    polygon: corners x, y (m) in either direction."""
    outline = shapely.geometry.polygon.orient(shapely.Polygon(polygon))
    ring = np.asarray(outline.exterior.coords)[:-1]  # the last corner repeats the first
    walls = loft(np.stack([_lift(ring, base), _lift(ring, top)]))
    # without the caps of loft, which are wrong for outlines that are not convex: its first
    # triangles are the sides, two for each corner
    sides = Mesh(walls.vertices, walls.triangles[: 2 * len(ring)])
    cap = triangulate(outline)
    roof = Mesh(_lift(cap.vertices[:, :2], top), cap.triangles)
    floor = Mesh(_lift(cap.vertices[:, :2], base), cap.triangles[:, ::-1])  # facing down
    return merge([sides, roof, floor])


def _lift(plan: Float[np.ndarray, "n 2"], z: float) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([plan, np.full(len(plan), z)])


def triangulate(shape: shapely.Geometry | np.ndarray) -> Mesh:
    """Return triangles of polygons, holes left out, at z = 0 and facing up.

    Triangles do not share vertices. shape: a polygon, several in one, or an array of polygons."""
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
    if len(pieces) == 0:
        return merge([])
    # an outline of a triangle has four coordinates; the last repeats the first
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    # from the first corner to the second (a) and to the third (b); their cross product is twice
    # the triangle's area, negative if the corners run clockwise
    ax, ay = (corners[:, 1] - corners[:, 0]).T
    bx, by = (corners[:, 2] - corners[:, 0]).T
    is_clockwise = ax * by - ay * bx < 0
    corners = np.where(is_clockwise[:, None, None], corners[:, ::-1], corners)
    vertices = np.concatenate([corners.reshape(-1, 2), np.zeros((3 * len(corners), 1))], axis=1)
    return Mesh(vertices, np.arange(3 * len(corners)).reshape(-1, 3))


def place(mesh: Mesh, x: float = 0.0, y: float = 0.0, z: float = 0.0, *, yaw: float = 0.0) -> Mesh:
    """Turn a mesh by `yaw` (rad, counter-clockwise) about z, then move it by x, y and z (m)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])  # rotates row vectors
    return Mesh(mesh.vertices @ rotation + [x, y, z], mesh.triangles)


def scale_mesh(mesh: Mesh, factors: float | Sequence[float]) -> Mesh:
    """Scale a mesh about the origin, by one factor or along each axis."""
    return Mesh(mesh.vertices * factors, mesh.triangles)


def stand(mesh: Mesh) -> Mesh:
    """Move a mesh onto z = 0."""
    return place(mesh, z=-mesh.vertices[:, 2].min())


def flip_sides(mesh: Mesh) -> Mesh:
    """Exchange left and right (y) of a mesh."""
    return Mesh(mesh.vertices * [1.0, -1.0, 1.0], mesh.triangles[:, ::-1])
