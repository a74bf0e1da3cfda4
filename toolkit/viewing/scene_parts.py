"""Parts of a scene: meshes, lines and points."""

from typing import TYPE_CHECKING, Literal

import numpy as np

from toolkit.arrays import Float32, Float64, UInt8
from toolkit.mesh import Mesh
from toolkit.viewing.scene import Look, rgb

if TYPE_CHECKING:
    from viser import LineSegmentsHandle, PointCloudHandle, SceneApi


def add_mesh(
    api: "SceneApi", name: str, mesh: Mesh, colour: str, *, opacity: float | None = None
) -> None:
    """Add a mesh of one colour, if it has triangles."""
    if len(mesh.triangles):
        parts = (mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
        shadows = ("cast", "receive")
        plain: Look = {f"{kind}_shadow": False for kind in shadows} | {"side": "double"}
        api.add_mesh_simple(
            name, *parts, color=rgb(colour), opacity=opacity, flat_shading=True, **plain
        )


def add_lines(
    api: "SceneApi",
    name: str,
    segments: Float64[np.ndarray, "n 2 3"],
    colour: str,
    *,
    width: float,
    visible: bool,
) -> "LineSegmentsHandle | None":
    """Add lines of one colour, if there are any."""
    if not len(segments):
        return None
    return api.add_line_segments(
        name,
        segments.astype(np.float32),
        rgb(colour),
        thickness=width,
        thickness_units="screen",
        visible=visible,
    )


def add_points(
    api: "SceneApi",
    name: str,
    points: Float32[np.ndarray, "n 3"],
    colour: tuple[int, int, int] | UInt8[np.ndarray, "n 3"],
    *,
    size: float,
    visible: bool,
    precision: Literal["float16", "float32"] = "float16",
) -> "PointCloudHandle":
    """Add square points of one colour, or one each."""
    return api.add_point_cloud(
        name,
        points,
        colour,
        point_size=size,
        point_shading="flat",
        precision=precision,
        visible=visible,
    )


def thin_evenly(points: Float32[np.ndarray, "n 3"], max_points: int) -> Float32[np.ndarray, "m 3"]:
    """Take at most this many of the points, evenly."""
    if len(points) <= max_points:
        return points
    return points[np.linspace(0, len(points), max_points, endpoint=False).astype(np.int64)]
