"""All that moves in one frame, in one ray casting scene, in the world frame: which object a line meets first, how far.

Many lines at once from many places cost less here than body by body, as `toolkit.rendering.renderer` casts them for a
few sensors, since one call finds which object hides which.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import open3d as o3d
import shapely

from toolkit.arrays import Float32, Float64, Int32, Int64
from toolkit.bodies.body import Body
from toolkit.geometry import LEVEL, Slope


class Footprints(NamedTuple):
    """What bodies cover of the ground and how high they reach. points: corners of the convex footprints, world frame,
    one object after the other; first: (n + 1,) where those of each begin; low, high: z (m); rectangles: around each
    footprint: x y of the middle, half the length and width, cosine and sine of the yaw."""

    points: Float64[np.ndarray, "k 2"]
    first: Int64[np.ndarray, " _"]
    low: Float64[np.ndarray, " n"]
    high: Float64[np.ndarray, " n"]
    rectangles: Float64[np.ndarray, "n 6"]


class Moment:
    """Objects of a frame: a body and a box each; threads: of Open3D, 0 for all cores; slope: of the ground, with which
    bodies are sheared (see `toolkit.geometry.levelling`)."""

    def __init__(
        self, bodies: Sequence[Body], boxes: Float64[np.ndarray, "n 7"], threads: int = 0, *, slope: Slope = LEVEL
    ) -> None:
        self.bodies, self.boxes, self._threads, self._slope = tuple(bodies), boxes, threads, np.array(slope)
        self._place(bodies)
        vertices = [self._into_world(body.vertices, row) for row, body in enumerate(bodies)]
        first = np.cumsum([0, *map(len, vertices)])
        triangles = [body.triangles + start for body, start in zip(bodies, first, strict=False)]
        sizes = [len(each) for each in triangles]
        self._object = np.repeat(np.arange(-1, len(bodies), dtype=np.int32), [1, *sizes])  # -1 for no triangle
        self._scene = None
        if sum(sizes):
            self._scene = scene_of(np.concatenate(vertices), np.concatenate(triangles), threads)

    def __len__(self) -> int:
        return len(self.boxes)

    def met(self, lines: Float32[np.ndarray, "n 6"]) -> tuple[Int32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """The object that each line (start, direction; world frame) meets first, -1 for none, and how many times its
        direction it goes until there, infinite where it meets none."""
        if self._scene is None or not len(lines):
            return np.full(len(lines), -1, np.int32), np.full(len(lines), np.inf, np.float32)
        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(lines), self._threads)
        after = found["primitive_ids"].numpy() + np.uint32(1)  # 0 for no triangle
        return self._object.take(after), found["t_hit"].numpy()

    def _place(self, bodies: Sequence[Body]) -> None:
        yaw = self.boxes[:, 6]
        self._turns = np.stack([np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)], axis=1).reshape(-1, 2, 2)
        outlines = [_footprint(body) for body in bodies]
        points = [o @ turn + box[:2] for o, turn, box in zip(outlines, self._turns, self.boxes, strict=True)]
        first = np.cumsum([0, *map(len, points)])
        reach = np.array([(b.vertices[:, 2].min(), b.vertices[:, 2].max()) for b in bodies], np.float64).reshape(-1, 2)
        if self._slope.any():  # by no more than the ground rises below the footprint
            rises = [(p - box[:2]) @ self._slope for p, box in zip(points, self.boxes, strict=True)]
            reach += np.array([(rise.min(), rise.max()) for rise in rises]).reshape(-1, 2)
        low, high = (reach + self.boxes[:, 2:3]).T
        ends = np.array([(o.min(axis=0), o.max(axis=0)) for o in outlines]).reshape(-1, 2, 2)
        middle = np.einsum("ni,nij->nj", ends.mean(axis=1), self._turns) + self.boxes[:, :2]
        around = np.column_stack([middle, np.ptp(ends, axis=1) / 2, self._turns[:, 0]])
        self.ground = Footprints(np.concatenate([np.zeros((0, 2)), *points]), first, low, high, around)

    def _into_world(self, vertices: np.ndarray, row: int) -> np.ndarray:
        placed = vertices.astype(np.float64)
        placed[:, :2] = placed[:, :2] @ self._turns[row]
        placed[:, 2] += placed[:, :2] @ self._slope
        return placed + self.boxes[row, :3]


def scene_of(vertices: np.ndarray, triangles: np.ndarray, threads: int) -> o3d.t.geometry.RaycastingScene:
    """Open3D's scene of a mesh; threads: 0 for all cores."""
    scene = o3d.t.geometry.RaycastingScene(threads)
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(
        tensor(np.ascontiguousarray(vertices, np.float32)), tensor(np.ascontiguousarray(triangles, np.uint32))
    )
    return scene


@lru_cache(maxsize=4096)
def _footprint(body: Body) -> Float64[np.ndarray, "k 2"]:
    """Corners of the convex hull of a body seen from above, body frame, in order."""
    hull = shapely.convex_hull(shapely.MultiPoint(body.vertices[:, :2].astype(np.float64)))
    return np.array(hull.exterior.coords[:-1])
