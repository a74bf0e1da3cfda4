"""Parts of a scene: meshes, lines, points, labels and groups."""

from typing import TYPE_CHECKING, Literal

import numpy as np

from toolkit.arrays import Float32, Float64, Shaped, UInt8
from toolkit.mesh import Mesh
from toolkit.viewing.scene import Spot, rgb

if TYPE_CHECKING:
    from viser import FrameHandle, LabelHandle, LineSegmentsHandle, PointCloudHandle, SceneApi

# part of a label that is at its position
Anchor = Literal["bottom-center", "center-center", "center-left"]


def add_mesh(
    api: "SceneApi", name: str, mesh: Mesh, colour: str, *, opacity: float | None = None
) -> None:
    """Add a mesh of one colour, without shadows and seen from both sides, if it has triangles.

    api: scene of viser; name: path of its node; colour: #rrggbb; opacity: 0 to 1, None for
    opaque."""
    if not len(mesh.triangles):
        return
    api.add_mesh_simple(
        name,
        vertices=mesh.vertices.astype(np.float32),
        faces=mesh.triangles.astype(np.uint32),
        color=rgb(colour),
        opacity=opacity,
        flat_shading=True,
        cast_shadow=False,
        receive_shadow=False,
        side="double",
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
    """Add line segments of one colour, or return None without segments.

    name: path of the node; segments: start and end of each (m); colour: #rrggbb; width: pixels;
    visible: whether the node is seen at first."""
    if not len(segments):
        return None
    return api.add_line_segments(
        name,
        points=segments.astype(np.float32),
        colors=rgb(colour),
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
    """Add points as squares, in one colour or each in a colour of its row.

    name: path of the node; colour: red, green and blue (0 to 255); size: side of a square (m);
    visible: whether the node is seen at first; precision: type of the coordinates; float16 is half
    as large, in steps of 3 cm beyond 32 m."""
    return api.add_point_cloud(
        name,
        points=points,
        colors=colour,
        point_size=size,
        point_shading="flat",
        precision=precision,
        visible=visible,
    )


def add_label(
    api: "SceneApi",
    name: str,
    text: str,
    position: Spot | Float64[np.ndarray, "3"],
    *,
    scale: float = 1.0,
    anchor: Anchor = "bottom-center",
    visible: bool = True,
) -> "LabelHandle":
    """Add a text that faces the camera and keeps its size on the screen.

    name: path of the node; position: x, y and z of its anchor (m); scale: size of its letters,
    as a multiple of the usual one; anchor: part of the text that is at the position; visible:
    whether the node is seen at first."""
    return api.add_label(
        name, text, position=position, font_screen_scale=scale, anchor=anchor, visible=visible
    )


def add_group(api: "SceneApi", name: str, *, visible: bool = True) -> "FrameHandle":
    """Add an empty node, with which all nodes below it are shown or hidden.

    name: path of the node; visible: whether they are seen at first."""
    return api.add_frame(name, show_axes=False, visible=visible)


def thin_evenly(rows: Shaped[np.ndarray, "n ..."], max_rows: int) -> Shaped[np.ndarray, "m ..."]:
    """Take at most `max_rows` rows, such as points, evenly over all."""
    if len(rows) <= max_rows:
        return rows
    return rows[np.linspace(0, len(rows), max_rows, endpoint=False).astype(np.int64)]
