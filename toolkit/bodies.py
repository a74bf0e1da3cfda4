"""Bodies of what moves: a triangle mesh per car, two-wheeler, person and lorry, in a box that fits it exactly.

A body's frame is its ground truth box: origin at the centre of the box, x forward, y left, z up. The box is tight
around the whole mesh, mirrors, umbrellas and loads included, and wheels or soles touch its floor at z = -height / 2.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from toolkit.arrays import Float, Float32, Int, Int32
from toolkit.cars import CARS, car
from toolkit.lorries import lorries
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.people import pedestrians
from toolkit.riders import two_wheelers

HELD_OUT = tuple(shape.name for shape in CARS[-5:])  # cars no detector of ours has been trained on


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


def catalogue(meshes: str | Path | None = None, held_out: bool = False) -> tuple[Body, ...]:
    """Every body traffic may use: cars, two-wheelers, pedestrians, lorries and buses, and the meshes of a folder.

    held_out: take the five cars of `HELD_OUT` in place of all others, to test on bodies never trained on;
    meshes: a folder of mesh files, see `toolkit.meshes`; theirs come last.

    >>> [sum(body.label == label for body in catalogue()) for label in range(4)]
    [21, 7, 14, 5]
    """
    ours = tuple(body for body in _procedural() if body.label != VEHICLE or (body.name in HELD_OUT) == held_out)
    if meshes is None:
        return ours
    from toolkit.meshes import load_meshes

    return ours + load_meshes(meshes)


def vary(body: Body, rng: np.random.Generator, spread: float = 0.03) -> Body:
    """The body stretched along each of its axes by a factor N(1, spread), cut at two spreads; its box follows."""
    factors = 1 + spread * np.clip(rng.standard_normal(3), -2, 2)
    return Body(body.name, body.label, (body.vertices * factors).astype(np.float32), body.triangles)


@lru_cache(maxsize=1)
def _procedural() -> tuple[Body, ...]:
    groups = (
        (VEHICLE, {shape.name: car(shape) for shape in CARS}), (CYCLIST, two_wheelers()),
        (PEDESTRIAN, pedestrians()), (HEAVY, lorries()),
    )  # fmt: skip
    return tuple(centred(name, label, *mesh) for label, group in groups for name, mesh in group.items())
