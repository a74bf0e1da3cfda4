"""`LiveSession`: a live planner that is served from before it is ready. Its first page says so, or
opens a map or site.

What takes long to import is imported once the page is served."""

import gc
import re
import secrets
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from coview.live_tables import START, note_html
from toolkit.runtime.writing import write_bytes
from toolkit.sites.files import save_site
from toolkit.sites.maps.opendrive_site import import_opendrive
from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece
from toolkit.viewing.scene import viser_server

if TYPE_CHECKING:
    from viser import ViserServer

    from coview.live_page import LivePage
    from placement_env.live.planner import LivePlanner
    from placement_env.live.project import ProjectFile

OPENED_MAP_ENDINGS = (".osm", ".xodr")
OPENED_SITE_ENDINGS = (".json", ".geojson")
MAX_UPLOAD_BYTES = 60_000_000
MAX_STEM_LETTERS = 60  # letters of a file's name that are kept, without its ending
OFFERED_SIZE_M = (80.0, 60.0)  # width and length of the piece of a map, as the page offers it
LIVE_PORT = 8090  # usual port, unless it is taken


class StartPage:
    """Panel that opens a map or site, before there is a planner.

    server: server of the page; folder: folder for uploads and imported sites; then: function that
    is called with the name or file of the chosen site."""

    def __init__(self, server: "ViserServer", folder: Path, then: Callable[[str], None]) -> None:
        """Add the fields that choose a site.

        folder: for uploads and sites from maps; then: function that opens a site by name or file.
        """
        self._folder = folder  # for uploads and sites made from maps
        self._then = then  # opens a site, given by name or file
        self._busy = threading.Lock()  # held while a site is opened
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(68, 99, 246))
        gui.main_panel.dock_right()
        gui.set_panel_label("coview live")
        gui.add_html(START)
        self._where = gui.add_text("Path or site", "tjunction")
        self._centre = gui.add_text(
            "Centre", "", hint="longitude latitude, or x y (m) in OpenDRIVE; the map's own middle"
        )
        self._size = gui.add_vector2(
            "Size (m)", OFFERED_SIZE_M, min=(1.0, 1.0), max=(1000.0, 1000.0), step=1.0
        )
        gui.add_button("Open").on_click(
            lambda _: self._open(lambda: Path(self._where.value.strip()))
        )
        upload = gui.add_upload_button("Upload a map or site")
        upload.on_upload(
            lambda _: self._open(
                lambda: keep_upload(upload.value.name, upload.value.content, self._folder)
            )
        )
        self._note_html = gui.add_html("")

    def _open(self, find: Callable[[], Path]) -> None:
        """Open the map or site whose path `find` returns, and show errors."""
        if not self._busy.acquire(blocking=False):
            return  # another one is being opened
        try:
            self._note_html.content = note_html("opening", "")
            self._then(self._import(find()))
        except Exception as error:  # whatever a map holds: the page lives on
            if not isinstance(error, ValueError | OSError | ImportError):
                traceback.print_exc()
            self._note_html.content = note_html("", str(error) or type(error).__name__)
        finally:
            self._busy.release()

    def _import(self, path: Path) -> str:
        """Return the name or file of a site. A map is first imported and saved as a site.

        path: path of a map or site, or a site's name. The map's piece is chosen by the fields of
        the page: centre and size."""
        if path.suffix.lower() not in OPENED_MAP_ENDINGS:
            return str(path)
        typed = self._centre.value
        centre = _parse_centre(typed) if typed.strip() else find_middle(path)
        width, length = self._size.value
        piece = MapPiece(path, centre=centre, size=(width, length), seed=0)
        site = import_osm(piece) if path.suffix.lower() == ".osm" else import_opendrive(piece)
        target = self._folder / f"{path.stem}.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        save_site(site, target)
        return str(target)


def keep_upload(name: str, content: bytes, folder: Path) -> Path:
    """Write an upload to a folder, under a safe name, and return its path.

    name: name of the uploaded file; content: its bytes. Raises ValueError for another kind of file,
    and one of more than `MAX_UPLOAD_BYTES`."""
    ending = Path(name).suffix.lower()
    endings = (*OPENED_MAP_ENDINGS, *OPENED_SITE_ENDINGS)
    if ending not in endings or len(content) > MAX_UPLOAD_BYTES:
        raise ValueError(
            f"an upload must end with {', '.join(endings)} and hold at most "
            f"{MAX_UPLOAD_BYTES // 10**6} MB, got {name!r:.70} of {len(content) / 1e6:.1f} MB"
        )
    # letters, digits, _ and - stay; all else, such as spaces and .., becomes -
    safe_stem = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(name).stem)[:MAX_STEM_LETTERS] or "map"
    path = folder / f"{safe_stem}{ending}"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content)
    return path


def _parse_centre(typed: str) -> tuple[float, float]:
    """Parse two numbers, apart by spaces or a comma. Raises ValueError for any other text."""
    try:
        x, y = map(float, typed.replace(",", " ").split())
    except ValueError:
        raise ValueError(f"the centre must be two numbers, got {typed!r:.60}: give them") from None
    return x, y


def find_middle(path: Path) -> tuple[float, float]:
    """Middle of the bounds that a map states: longitude and latitude, or x and y (m) in OpenDRIVE.

    Raises ValueError for a map that states none, OSError if it cannot be read."""
    # attributes with the western, eastern, southern and northern end, by element
    attributes = {
        "bounds": ("minlon", "maxlon", "minlat", "maxlat"),  # OpenStreetMap
        "header": ("west", "east", "south", "north"),  # OpenDRIVE
    }
    with suppress(ElementTree.ParseError, LookupError, ValueError):
        for _, element in ElementTree.iterparse(path, events=("start",)):
            tag = element.tag.rpartition("}")[2]  # without {NAMESPACE}
            if tag in attributes:
                west, east, south, north = (float(element.attrib[name]) for name in attributes[tag])
                return (west + east) / 2, (south + north) / 2
            if tag in ("node", "road"):  # bounds come before these
                break
    raise ValueError(f"{path} states no bounds: give the centre")


class LiveSession:
    """Server of a live planner. In Jupyter it shows the page in the cell.

    planner: planner to show, or a function that makes a planner and its project file from the name
    or file of a site, which `open` or the page asks for. port: port of the server; project: file
    that keeps the planner's work, None for none; folder: folder for uploads, exports and reports.

    Attributes:
        planner: Planner, missing until a site is opened.
        page: Page that shows it, missing until a site is opened.
        url: Address for browsers of this machine, with a secret token.
    """

    planner: "LivePlanner"
    page: "LivePage"

    def __init__(
        self,
        planner: "LivePlanner | Callable[[str], tuple[LivePlanner, ProjectFile]]",
        *,
        port: int = LIVE_PORT,
        project: "ProjectFile | None" = None,
        folder: Path = Path("out/live"),
    ) -> None:
        """Open a server, and show the planner's page on it.

        planner: planner, or function that makes one and its project file for a site; with a
        function, the first page asks for the name of the site. project: where changes are kept;
        folder: for uploads, exports and reports. Raises ValueError for an invalid port."""
        if not 1 <= port < 2**16:
            raise ValueError(f"port must lie in 1..65535, got {port}: leave it out for {LIVE_PORT}")
        token = secrets.token_urlsafe(16)  # only who knows the URL opens the page
        self._open_parts = ExitStack()  # server, page and project file, which `close` ends
        self._folder = folder
        self._server = self._open_parts.enter_context(viser_server(port, token))
        self.url = f"http://127.0.0.1:{self._server.get_port()}/{token}/"
        if callable(planner):  # it makes the planner of a site that the first page asks for
            self._make_planner = planner
            StartPage(self._server, folder, lambda site: self._show(*planner(site)))
        else:
            self._show(planner, project)

    def open(self, site: str) -> None:
        """Open a site, given by name or file, in place of the first page.

        Raises ValueError, OSError or ImportError if it cannot be opened; the page shows the reason
        too."""
        self._server.gui.reset()
        note = self._server.gui.add_html(note_html(f"opening {site}", ""))
        gc.disable()  # collecting would only cost time: all that is loaded stays
        try:
            self._show(*self._make_planner(site))
        except (ValueError, OSError, ImportError) as error:
            note.content = note_html("", str(error))
            raise
        finally:
            gc.enable()

    def _show(self, planner: "LivePlanner", project: "ProjectFile | None") -> None:
        """Show the page of a planner; `close` will end it and release its project file.

        project: file that keeps the planner's state, None without one."""
        from coview.live_page import LivePage

        self.planner = planner
        self._server.gui.reset()
        if project is not None:
            self._open_parts.callback(project.close)
        gc.freeze()  # collections during a drag skip all that exists by now
        self.page = LivePage(
            server=self._server, planner=planner, project=project, folder=self._folder
        )
        self._open_parts.callback(self.page.close)

    def wait(self) -> None:
        """Serve until Ctrl-C, or SIGTERM within `interrupted_by_sigterm`."""
        with suppress(KeyboardInterrupt):
            self._server.sleep_forever()

    def close(self) -> None:
        """End the page, release the project file, and end the server."""
        self._open_parts.close()

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{escape(self.url)}" width="100%" height="640" style="border:1px solid '
            '#ccc"></iframe>'
        )


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end a block as Ctrl-C does (KeyboardInterrupt), so that open work is saved.

    Outside the main thread it has no effect, as only that thread may handle signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    previous_handler = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous_handler)
