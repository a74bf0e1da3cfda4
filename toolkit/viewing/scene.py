"""Scenes of viser: empty, filled, and written as pages. Meshes and lines are added to them. viser
builds the scene and writes it, with its viewer, as one page of HTML. Its server does nothing else;
it listens on 127.0.0.1, at a port of the system's choice, while the scene is written."""

import json
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from toolkit.arrays import BoxRows, Float32, Float64, UInt8
from toolkit.boxes import corners
from toolkit.mesh import Mesh

if TYPE_CHECKING:
    from viser import LineSegmentsHandle, PointCloudHandle, SceneApi, ViserServer

Spot = tuple[float, float, float]
Handle = Any  # of a node or control of viser
Look = dict[str, Any]  # keyword arguments of viser
_FOLDER = Path(__file__).parent
VERTICAL_FOV = float(np.deg2rad(50.0))  # of the camera that a scene opens with (rad)


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def check_viser() -> None:
    """Check that viser is installed. Raises ImportError, with the command to install it, if it is
    missing."""
    if not find_spec("viser"):
        raise ImportError("scenes in 3D need viser: pip install coview[report]")


@contextmanager
def viser_server(port: int = 0, token: str = "") -> "Iterator[ViserServer]":
    """Open a viser server for this machine alone. Its scene is empty, with light and up direction.
    port: 0 for one of the system's choice, else this or, if it is taken, one after it; token: that
    its address ends with, "" to serve nobody. Nothing is printed, and viser does not rebuild its
    viewer, for which it would use the network. Raises ImportError without viser."""
    check_viser()
    import rich
    from viser import ViserServer

    builder: Any = import_module("viser._client_autobuild")
    sockets: Any = import_module("websockets.asyncio.server")
    console = rich.get_console()
    build = builder.ensure_client_is_built
    quiet = console.quiet
    console.quiet = True
    builder.ensure_client_is_built = lambda: None
    serve = sockets.serve
    sockets.serve = partial(_serve_guarded, sockets.serve, token)
    try:
        server = ViserServer(host="127.0.0.1", port=port, verbose=False)
        sockets.serve = serve
        try:
            server.scene.set_up_direction("+z")
            server.scene.configure_environment_map(None)
            server.scene.configure_default_lights(False)
            server.scene.add_light_ambient("/light/sky", intensity=1.6)
            server.scene.add_light_directional(
                "/light/sun", intensity=1.8, position=(-30.0, -50.0, 80.0)
            )
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = quiet
        sockets.serve = serve
        builder.ensure_client_is_built = build


_LOCAL = re.compile(r"http://(127\.0\.0\.1|localhost)(:\d+)?")


def _serve_guarded(
    serve: Handle, token: str, *arguments: object, process_request: Handle, **options: object
) -> Handle:
    """Serve requests below /token/ alone, and sockets to pages of this machine alone."""

    def guard(connection: Handle, request: Handle) -> Handle:
        path_token, _, page_path = request.path.removeprefix("/").partition("/")
        if not token or not secrets.compare_digest(path_token.encode(), token.encode()):
            return connection.respond(403, "open the whole address that coview prints\n")
        if "Upgrade" in request.headers and not _LOCAL.fullmatch(request.headers.get("Origin", "")):
            return connection.respond(403, "open the viewer in a browser of this machine\n")
        request.path = f"/{page_path}"
        request.headers.pop("Accept-Encoding", None)  # a page that comes plain can be added to
        answer = process_request(connection, request)
        if answer is not None and answer.headers.get("Content-Type", "").startswith("text/html"):
            answer.body = _with_head(answer.body.decode(), "prompt.js").encode()
            del answer.headers["Content-Length"]
            answer.headers["Content-Length"] = str(len(answer.body))
        return answer

    return serve(*arguments, process_request=guard, **options)


def set_view(
    server: "ViserServer", position: tuple[float, ...], look_at: tuple[float, ...]
) -> None:
    """Set the camera's place and target when the scene opens."""
    server.initial_camera.position = np.array(position)
    server.initial_camera.look_at = np.array(look_at)
    server.initial_camera.fov = VERTICAL_FOV
    server.initial_camera.near = 0.5


def overview(area: tuple[float, float, float, float], height: float = 0.0) -> tuple[Spot, Spot]:
    """Spot and target of a camera that sees an area. It sees the whole area, at a slant from the
    south. area: xmin, ymin, xmax, ymax (m); height: of the ground."""
    xmin, ymin, xmax, ymax = area
    x = (xmin + xmax) / 2
    y = (ymin + ymax) / 2
    size = max(xmax - xmin, ymax - ymin)
    return (x - 0.15 * size, y - 0.75 * size, height + 0.65 * size), (x, y, height)


def scene_html(server: "ViserServer") -> str:
    """Return the scene as a page for an iframe, which tells when it is ready and switches nodes by
    messages."""
    server.scene.add_frame("/end", show_axes=False)
    return _with_head(server.get_scene_serializer().as_html(), "control.js")


def _with_head(html: str, script: str) -> str:
    """Page of the viewer with a script of ours, without its notes on software rendering."""
    head_end = html.index("</head>")
    ours = (_FOLDER / script).read_text(encoding="utf-8")
    style = "<style>.mantine-Notification-root{display:none!important}</style>"
    return f"{html[:head_end]}{style}<script>\n{ours}</script>{html[head_end:]}"


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


EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
SPIKE = 2.5  # m, height of the mark on a false alarm

Segments = Float64[np.ndarray, "_ 2 3"]


def box_edges(boxes: BoxRows) -> Segments:
    """Twelve edges of each box."""
    return corners(boxes)[:, EDGES].reshape(-1, 2, 3)


def headings(boxes: BoxRows) -> Segments:
    """Line on each box's roof, from middle to front."""
    middle = boxes[:, :3] + np.array([0.0, 0, 0.5]) * boxes[:, 5:6]
    ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))])
    return np.stack([middle, middle + ahead * boxes[:, 3:4] / 2], axis=1).astype(np.float64)


def roof_crosses(boxes: BoxRows) -> Segments:
    """Both diagonals of each box's roof: a missed vehicle."""
    return corners(boxes)[:, [[4, 6], [5, 7]]].reshape(-1, 2, 3)


def spikes(boxes: BoxRows) -> Segments:
    """Upright with a cross bar per box: a false alarm."""
    top = boxes[:, :3] + np.array([0.0, 0, 1]) * (boxes[:, 5:6] / 2)
    tip, bar = (top + np.array([0.0, 0, height]) for height in (SPIKE, 0.7 * SPIKE))
    upright = np.stack([top, tip], 1)
    bars = [
        np.stack([bar - side, bar + side], 1)
        for side in (np.array([0.8, 0, 0]), np.array([0, 0.8, 0]))
    ]
    return np.concatenate([upright, *bars]).astype(np.float64)


def arrows(boxes: BoxRows) -> Segments:
    """Arrow down onto each box: an object that nobody sees."""
    tip = boxes[:, :3] + np.array([0.0, 0, 1]) * (boxes[:, 5:6] / 2 + 0.3)
    ends = SPIKE * np.array(
        [(0.0, 0, 1.4), (0.4, 0, 0.5), (-0.4, 0, 0.5), (0, 0.4, 0.5), (0, -0.4, 0.5)]
    )
    return np.concatenate([np.stack([tip, tip + end], 1) for end in ends]).astype(np.float64)


def dashes(segments: Segments, *, dash: float, gap: float) -> Segments:
    """Split segments into dashes. dash, gap: lengths in metres."""
    parts = [np.zeros((0, 2, 3))]
    for start, end in segments:
        length = float(np.linalg.norm(end - start))
        begins = np.arange(0.0, max(length, 1e-9), dash + gap)
        along = np.stack([begins, np.minimum(begins + dash, length)], 1) / max(length, 1e-9)
        parts.append(start + along[:, :, None] * (end - start))
    return np.concatenate(parts)


def thin_evenly(points: Float32[np.ndarray, "n 3"], max_points: int) -> Float32[np.ndarray, "m 3"]:
    """Take at most this many of the points, evenly."""
    if len(points) <= max_points:
        return points
    return points[np.linspace(0, len(points), max_points, endpoint=False).astype(np.int64)]


POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; style-src "
    "'unsafe-inline'; img-src data: blob:; font-src data:; connect-src data: blob:; worker-src "
    "blob: data:; frame-src 'self' blob: data:; media-src data:; form-action 'none'; base-uri "
    "'none'"
)


def render_page(template: Path, data: object, script: str = "", **values: object) -> str:
    """Render a page around a scene. data: of the scene, None without one. Raises ImportError
    without jinja2."""
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError:
        raise ImportError("pages need jinja2: pip install coview[report]") from None

    environment = Environment(
        loader=FileSystemLoader(template.parent), autoescape=True, undefined=StrictUndefined
    )
    environment.trim_blocks = environment.lstrip_blocks = True
    scene_values = {"policy": POLICY, "scene_data": None if data is None else script_data(data)}
    script += (_FOLDER / "scene.js").read_text(encoding="utf-8")
    return environment.get_template(template.name).render(**scene_values, script=script, **values)


def script_data(value: object) -> str:
    r"""JSON that may stand inside a script element. Its texts may hold anything."""
    return (
        json.dumps(value)
        .replace("<", "\\u003c")
        .replace("\u2028", "\\u2028")
        .replace("\u2029", "\\u2029")
    )
