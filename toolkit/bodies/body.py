"""Bodies of what moves: a triangle mesh per car, two-wheeler, person and truck, in a box that fits it exactly.

A body's frame is its ground truth box: origin at the centre of the box, x forward, y left, z up. The box is tight
around the whole mesh, mirrors, umbrellas and loads included, and wheels or soles touch its floor at z = -height / 2.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from toolkit.arrays import Float, Float32, Int, Int32


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid mesh: vertices (k, 3) m, centred on their bounds; triangles (m, 3), rows of `vertices`; a class label."""

    name: str
    label: int
    vertices: Float32[np.ndarray, "k 3"] = field(repr=False)
    triangles: Int32[np.ndarray, "m 3"] = field(repr=False)

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and height of the tight box (m)."""
        length, width, height = np.ptp(self.vertices, axis=0).tolist()
        return length, width, height


def centred(name: str, label: int, vertices: Float[np.ndarray, "k 3"], triangles: Int[np.ndarray, "m 3"]) -> Body:
    """A body from a mesh anywhere: the origin goes to the centre of its bounds."""
    vertices = np.asarray(vertices, np.float64)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return Body(name, label, (vertices - middle).astype(np.float32), np.asarray(triangles, np.int32))


def vary(body: Body, rng: np.random.Generator, spread: float = 0.03) -> Body:
    """The body stretched along each of its axes by a factor N(1, spread), cut at two spreads; its box follows."""
    factors = 1 + spread * np.clip(rng.standard_normal(3), -2, 2)
    return Body(body.name, body.label, (body.vertices * factors).astype(np.float32), body.triangles)
