"""Bodies of moving objects: a triangle mesh and the ground truth box it stands in.

A body's frame is its box: origin at the centre, x forward, y left, z up; wheels or soles touch its
floor. The box is tight around the whole mesh, umbrellas and loads included, unless `truth` says
otherwise: wing mirrors of drawn bodies stick out of their boxes, as annotators of real data leave
them out."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from toolkit.arrays import Float, Float32, Float64, Int, Int32, Rng
from toolkit.mesh import Mesh, merge


@dataclass(frozen=True, eq=False)
class Body:
    """Rigid mesh and its ground truth box, in the frame of the box (x forward, y left, z up)."""

    name: str
    label: int  # class number, an index of `toolkit.objects.LABELS`
    vertices: Float32[np.ndarray, "k 3"] = field(repr=False)  # m, from the middle of the box
    triangles: Int32[np.ndarray, "m 3"] = field(repr=False)
    truth: tuple[float, float, float] | None = (
        None  # length, width, height (m) of the box if parts stick out of it
    )

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and height of the ground truth box (m)."""
        if self.truth is not None:
            return self.truth
        length, width, height = np.ptp(self.vertices, axis=0).tolist()
        return length, width, height

    @cached_property
    def bounds(self) -> Float64[np.ndarray, "6"]:
        """Middle x, y, z and length, width, height (m) of a box around the whole mesh.

        The middle is in the body's frame: 0, 0, 0 unless parts stick out of the truth box."""
        if self.truth is None:
            return np.array([0.0, 0.0, 0.0, *self.size])
        low = self.vertices.min(axis=0).astype(np.float64)
        high = self.vertices.max(axis=0).astype(np.float64)
        return np.concatenate([(low + high) / 2, high - low])


def make_body(
    name: str, label: int, vertices: Float[np.ndarray, "k 3"], triangles: Int[np.ndarray, "m 3"]
) -> Body:
    """Make a body from a mesh, with a tight box around it.

    vertices: m, x forward, z up, from any origin; triangles: rows of `vertices` of the corners of
    each; label: class number. The body's origin is the middle of the box."""
    vertices = np.asarray(vertices, np.float64)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return Body(
        name,
        label,
        vertices=(vertices - middle).astype(np.float32),
        triangles=np.asarray(triangles, np.int32),
    )


def make_boxed_body(name: str, label: int, mesh: Mesh, outside: Mesh) -> Body:
    """Make a body from two meshes of one frame, with a tight box around the first only.

    outside: parts that stick out of the box, such as wing mirrors; label: class number."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    merged = merge([mesh, outside])
    length, width, height = (high - low).tolist()
    vertices = (merged.vertices - (low + high) / 2).astype(np.float32)
    return Body(
        name,
        label,
        vertices,
        triangles=merged.triangles.astype(np.int32),
        truth=(length, width, height),
    )


def include_mirrors(body: Body) -> Body:
    """Return the body with its box around the whole mesh, mirrors included."""
    return make_body(body.name, body.label, body.vertices, body.triangles)


def stretch_randomly(body: Body, rng: Rng) -> Body:
    """Stretch a body and its box along each axis by a factor N(1, 0.03), cut at 0.94 and 1.06.

    A body without a separate box (`truth`) has the one around its mesh, which stretches with
    the mesh."""
    factors = 1 + 0.03 * np.clip(rng.standard_normal(3), -2, 2)
    length, width, height = (np.array(body.size) * factors).tolist()
    return replace(
        body,
        vertices=(body.vertices * factors).astype(np.float32),
        truth=None if body.truth is None else (length, width, height),
    )
