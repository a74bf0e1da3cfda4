"""Scenes of viser: empty, served, and written as one page of HTML.

viser builds the scene and writes it, with its viewer, as one page. Its server does nothing else; it
listens on 127.0.0.1, at a port of the system's choice, while the scene is written."""

import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from viser import ViserServer

Spot = tuple[float, float, float]  # x, y, z (m)
Handle = Any  # node or control of viser
Look = dict[str, Any]  # keyword arguments of viser
FOLDER = Path(__file__).parent
VERTICAL_FOV = float(np.deg2rad(50.0))  # field of view of the camera that a scene opens with (rad)
# origin of a page that this machine serves
_LOCAL = re.compile(r"http://(127\.0\.0\.1|localhost)(:\d+)?")


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue (0 to 255) of a colour #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def check_viser() -> None:
    """Check that viser is installed. Raises ImportError, with the command to install it, if it is
    missing."""
    if not find_spec("viser"):
        raise ImportError("scenes in 3D need viser: pip install coview[report]")


@contextmanager
def viser_server(port: int = 0, token: str = "") -> "Iterator[ViserServer]":
    """Open a viser server for this machine only, with an empty scene, light and up direction.

    port: 0 for a port of the system's choice, else this port or, if it is taken, a later one;
    token: secret with which the address ends, "" to refuse every request. Nothing is printed, and
    viser does not rebuild its viewer, for which it would use the network: parts of viser,
    websockets and rich are replaced meanwhile, and put back. Raises ImportError without viser."""
    check_viser()
    import rich
    from viser import ViserServer

    client_builder: Any = import_module("viser._client_autobuild")
    socket_server: Any = import_module("websockets.asyncio.server")
    console = rich.get_console()
    # what is replaced, to be put back
    ensure_client_is_built = client_builder.ensure_client_is_built
    serve = socket_server.serve
    was_quiet = console.quiet
    console.quiet = True
    client_builder.ensure_client_is_built = lambda: None
    socket_server.serve = partial(_serve_guarded, serve, token)
    try:
        server = ViserServer(host="127.0.0.1", port=port, verbose=False)
        socket_server.serve = serve  # our guard is for this server only
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
        console.quiet = was_quiet
        socket_server.serve = serve
        client_builder.ensure_client_is_built = ensure_client_is_built


def _serve_guarded(
    serve: Handle, token: str, *arguments: object, process_request: Handle, **options: object
) -> Handle:
    """Start a server of websockets that refuses requests without the token and foreign pages.

    serve: websockets' function, to which `arguments` and `options` go; token: first part of the
    path of every request that is served, "" to refuse all; process_request: viser's handler, which
    sees the path without the token. A socket must come from a page of this machine."""

    def guard(connection: Handle, request: Handle) -> Handle:
        """Answer a request with an error, or let viser's `process_request` answer it.

        A request needs the secret `token` in its path; viser gets the path without it. Pages get
        our script. connection, request: of websockets; the request is changed in place."""
        path_token, _, page_path = request.path.removeprefix("/").partition("/")
        # a comparison whose duration does not depend on the token
        if not token or not secrets.compare_digest(path_token.encode(), token.encode()):
            return connection.respond(403, "open the whole address that coview prints\n")
        opens_socket = "Upgrade" in request.headers
        origin = request.headers.get("Origin", "")
        if opens_socket and not _LOCAL.fullmatch(origin):  # not a page of this machine
            return connection.respond(403, "open the viewer in a browser of this machine\n")
        request.path = f"/{page_path}"
        # uncompressed, so that a script can be inserted into the page
        request.headers.pop("Accept-Encoding", None)
        answer = process_request(connection, request)
        if answer is not None and answer.headers.get("Content-Type", "").startswith("text/html"):
            answer.body = _insert_script(answer.body.decode(), "prompt.js").encode()
            del answer.headers["Content-Length"]  # setting it would add a second one
            answer.headers["Content-Length"] = str(len(answer.body))
        return answer

    return serve(*arguments, process_request=guard, **options)


def set_view(
    server: "ViserServer", position: tuple[float, ...], look_at: tuple[float, ...]
) -> None:
    """Set the camera with which the scene opens.

    position: x, y, z of the camera (m); look_at: x, y, z of the point at which it looks (m)."""
    camera = server.initial_camera
    camera.position = np.array(position)
    camera.look_at = np.array(look_at)
    camera.fov = VERTICAL_FOV
    camera.near = 0.5  # m; nothing nearer to the camera is drawn


def overview(area: tuple[float, float, float, float], height: float = 0.0) -> tuple[Spot, Spot]:
    """Position and target (m) of a camera that sees a whole area, at a slant from the south.

    area: xmin, ymin, xmax, ymax (m); height: height of the ground (m)."""
    xmin, ymin, xmax, ymax = area
    x = (xmin + xmax) / 2
    y = (ymin + ymax) / 2
    size = max(xmax - xmin, ymax - ymin)
    # a little west of the middle, well to the south and above
    position = (x - 0.15 * size, y - 0.75 * size, height + 0.65 * size)
    return position, (x, y, height)


def show_area(server: "ViserServer", area: tuple[float, float, float, float]) -> None:
    """Let the scene open with a whole area in view (`overview`).

    area: xmin, ymin, xmax, ymax (m), on ground at height 0."""
    set_view(server, *overview(area))


def scene_html(server: "ViserServer") -> str:
    """Return the scene as a page for an iframe.

    It reports when it is ready, and switches nodes by messages."""
    # the last node: the page is ready when the viewer has it, see control.js
    server.scene.add_frame("/end", show_axes=False)
    return _insert_script(server.get_scene_serializer().as_html(), "control.js")


def _insert_script(html: str, script_name: str) -> str:
    """Insert a script into the viewer's page, and hide its notes on software rendering.

    html: the page; script_name: name of a file of this folder."""
    head_end = html.index("</head>")
    script = (FOLDER / script_name).read_text(encoding="utf-8")
    style = "<style>.mantine-Notification-root{display:none!important}</style>"
    return f"{html[:head_end]}{style}<script>\n{script}</script>{html[head_end:]}"
