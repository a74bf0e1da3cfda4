"""Which places can be seen from where: straight lines that nothing standing still at a site interrupts."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from toolkit.arrays import Bool, Float64
from toolkit.mesh import Mesh
from toolkit.sensors.model import NEAR

GRAZE = 1e-3  # m before its end, where a line meets what the end lies on


class SightLines:
    """Lines from one place to many others through a mesh, such as `toolkit.rendering.static_scene.scenery`.

    threads: of Open3D, 0 for all cores.
    """

    def __init__(self, scenery: Mesh, threads: int = 0) -> None:
        self._threads = threads
        self._scene = o3d.t.geometry.RaycastingScene(threads)
        vertices = np.ascontiguousarray(scenery.vertices, np.float32)
        triangles = np.ascontiguousarray(scenery.triangles, np.uint32)
        self._scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))

    def clear(self, start: Float64[np.ndarray, "3"], ends: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which ends are in sight of the start: further off than `NEAR`, as sensors measure nothing nearer, and from
        there on nothing in between, but for the last `GRAZE`.

        >>> from toolkit.mesh import box
        >>> wall = SightLines(box((0.2, 4.0, 4.0), (5.0, 0.0, 0.0)))
        >>> wall.clear(np.zeros(3), np.array([[4.0, 0, 0], [9, 0, 0], [9, 8, 0], [0.1, 0, 0]]))
        array([ True, False,  True, False])
        """
        way = ends - start
        length = np.linalg.norm(way, axis=1)
        far = length > NEAR
        unit = way / np.where(far, length, 1)[:, None]
        lines = np.concatenate([start + NEAR * unit, unit], axis=1).astype(np.float32)
        free = self._scene.cast_rays(o3d.core.Tensor.from_numpy(lines), self._threads)["t_hit"].numpy()
        return far & (free > length - NEAR - GRAZE)
