"""Parts that drawn bodies are made of."""

from typing import NamedTuple

import numpy as np

from toolkit.mesh import Mesh, box, ellipsoid, merge

NOTHING = merge([])


class DrawnMesh(NamedTuple):
    """Mesh of a drawn body.

    Attributes:
        kind: kind of body, such as `bicycle`.
        mesh: all that belongs to the ground truth box.
        outside: parts that stick out of the box, such as wing mirrors."""

    kind: str
    mesh: Mesh
    outside: Mesh = NOTHING


def stretch(mesh: Mesh, size: tuple[float, float, float]) -> Mesh:
    """Stretch a mesh to a size, and put it on z = 0 with its middle at x = y = 0.

    size: length, width, height (m)."""
    low = mesh.vertices.min(axis=0)
    high = mesh.vertices.max(axis=0)
    origin = (low + high) / 2
    origin[2] = low[2]  # z
    factors = np.array(size) / (high - low)
    return Mesh((mesh.vertices - origin) * factors, mesh.triangles)


def plank(size: tuple[float, float, float], x: float, y: float, z: float) -> Mesh:
    """Cuboid with its foot at height z and its middle at x, y (m).

    size: length, width, height (m), along x, y, z."""
    return box(size, centre=(x, y, z + size[2] / 2))


def mound(size: tuple[float, float, float], x: float, z: float) -> Mesh:
    """Heap, a dome with its flat foot at height z and its middle at x and y = 0 (m).

    size: length, width, height (m)."""
    length, width, height = size
    dome = ellipsoid((x, 0.0, z), radii=(length / 2, width / 2, height), rings=7, sides=12)
    # lift the lower half to the foot
    return Mesh(np.maximum(dome.vertices, [-np.inf, -np.inf, z]), dome.triangles)
