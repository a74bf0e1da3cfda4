"""The live planner's first page, which opens maps and sites, and the session that serves it."""

import gc
import signal
import threading
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

import coview.live_page
from coview import live_start
from coview.live_start import (
    LiveSession,
    StartPage,
    find_middle,
    interrupted_by_sigterm,
    keep_upload,
)
from toolkit.sites.files import load_site

BOUNDS = '<osm><bounds minlat="49" minlon="8" maxlat="50" maxlon="9"/><node/></osm>'


class Panel:
    """Panel of a browser: its controls by label, which tests fill in and press."""

    def __init__(self):
        self.controls, self.pages, self.main_panel = (
            {},
            [],
            SimpleNamespace(dock_right=lambda: None),
        )
        self.resets = 0

    def __getattr__(self, kind):
        if not kind.startswith("add_"):
            return lambda *values, **options: None
        return lambda label, value=None, **options: self._add(kind, label, value, options)

    def _add(self, kind, label, value, options):
        handle = SimpleNamespace(label=label, value=value, content=label, options=options)
        handle.on_click = handle.on_upload = lambda then: setattr(
            handle, "press", lambda: then(None)
        )
        if kind == "add_html":
            self.pages.append(handle)
        self.controls[label] = handle
        return handle

    def reset(self):
        self.resets += 1
        self.controls.clear()

    @property
    def said(self):
        return self.pages[-1].content


class Server:
    """Server of pages that nobody visits."""

    def __init__(self):
        self.gui, self.slept, self.closed = Panel(), 0, False
        self.port, self.token = 0, ""

    def get_port(self):
        return 18999

    def sleep_forever(self):
        self.slept += 1
        raise KeyboardInterrupt


@pytest.fixture
def server(monkeypatch):
    made = Server()

    @contextmanager
    def serve(port, token):
        made.port, made.token = port, token
        yield made
        made.closed = True

    monkeypatch.setattr(live_start, "viser_server", serve)
    return made


@pytest.fixture
def imported(monkeypatch):
    """Pieces of maps that were imported, each as a built-in site."""
    pieces = []

    def add_importer(name):
        def keep(piece):
            pieces.append((name, piece))
            return load_site("tjunction")

        monkeypatch.setattr(live_start, name, keep)

    add_importer("import_osm")
    add_importer("import_opendrive")
    return pieces


@pytest.mark.parametrize(
    ("text", "middle"),
    [
        ('<osm><bounds minlat="49" minlon="8" maxlat="50" maxlon="9"/><node/></osm>', (8.5, 49.5)),
        ('<OpenDRIVE><header north="30" south="-10" east="4" west="2"/></OpenDRIVE>', (3.0, 10.0)),
        (
            '<OpenDRIVE xmlns="urn:x"><header north="3" south="1" east="4" west="2"/></OpenDRIVE>',
            (3.0, 2.0),
        ),
        ("<osm><node/><bounds/></osm>", None),
        ("<osm><bounds/></osm>", None),
        ('<osm><bounds minlat="x" minlon="8" maxlat="50" maxlon="9"/></osm>', None),
        ("no map", None),
    ],
)
def test_the_middle_is_that_of_the_map_bounds(tmp_path, text, middle):
    path = tmp_path / "map.osm"
    path.write_text(text)
    if middle is None:
        with pytest.raises(ValueError, match=r"map\.osm states no bounds: give the centre"):
            find_middle(path)
    else:
        assert find_middle(path) == middle


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("../../a b.OSM", "a-b.osm"),
        ("<b>.json", "-b-.json"),
        (f"{'x' * 300}.xodr", f"{'x' * 60}.xodr"),
        ("a.exe", None),
    ],
)
def test_uploads_get_safe_names(tmp_path, name, kept):
    if kept is None:
        with pytest.raises(ValueError, match="an upload must end with"):
            keep_upload(name, b"", tmp_path)
    else:
        assert keep_upload(name, b"text", tmp_path) == tmp_path / kept
        assert (tmp_path / kept).read_bytes() == b"text"


def make_start(server, folder):
    opened = []
    return StartPage(server, folder / "a" / "b", opened.append), opened


def test_a_site_is_opened_by_its_name_or_path(server, tmp_path, imported):
    _, opened = make_start(server, tmp_path)
    controls = server.gui.controls
    controls["Open"].press()
    controls["Path or site"].value = " some/site.json "
    controls["Open"].press()
    assert opened == ["tjunction", "some/site.json"]
    assert not imported
    assert "opening" in server.gui.said


@pytest.mark.parametrize(
    ("name", "typed", "kind", "centre"),
    [
        ("map.OSM", "", "import_osm", (8.5, 49.5)),
        ("map.osm", "8.1, 49.2", "import_osm", (8.1, 49.2)),
        ("map.xodr", "-3 4.5", "import_opendrive", (-3.0, 4.5)),
    ],
)
def test_a_map_becomes_a_site_around_its_middle_or_the_centre(
    server, tmp_path, imported, name, typed, kind, centre
):
    _, opened = make_start(server, tmp_path)
    (tmp_path / name).write_text(BOUNDS)
    controls = server.gui.controls
    controls["Path or site"].value, controls["Centre"].value = str(tmp_path / name), typed
    controls["Size (m)"].value = 70.0, 50.0
    controls["Open"].press()
    ((importer, piece),) = imported
    assert (importer, piece.path, piece.centre) == (kind, tmp_path / name, centre)
    assert (piece.size, piece.seed) == ((70.0, 50.0), 0)
    site = tmp_path / "a" / "b" / "map.json"
    assert opened == [str(site)]
    assert load_site(site).name == "tjunction"


def test_an_upload_is_kept_and_opened(server, tmp_path, imported):
    _, opened = make_start(server, tmp_path)
    upload = server.gui.controls["Upload a map or site"]
    upload.value = SimpleNamespace(name="my map.osm", content=BOUNDS.encode())
    upload.press()
    assert imported[0][1].path == tmp_path / "a" / "b" / "my-map.osm"
    assert opened == [str(tmp_path / "a" / "b" / "my-map.json")]


@pytest.mark.parametrize(
    ("size", "fits"),
    [(live_start.MAX_UPLOAD_BYTES, True), (live_start.MAX_UPLOAD_BYTES + 1, False)],
)
def test_an_upload_has_a_limit(tmp_path, size, fits):
    if fits:
        assert keep_upload("a.json", bytes(size), tmp_path).stat().st_size == size
    else:
        with pytest.raises(ValueError, match=r"at most 60 MB, got 'a\.json' of 60\.0 MB"):
            keep_upload("a.json", bytes(size), tmp_path)


def test_a_map_without_bounds_asks_for_the_centre(server, tmp_path, imported):
    _, opened = make_start(server, tmp_path)
    path = tmp_path / "map.osm"
    path.write_text("<osm><node/></osm>")
    server.gui.controls["Path or site"].value = str(path)
    server.gui.controls["Open"].press()
    assert "map.osm states no bounds: give the centre" in server.gui.said
    assert not opened
    assert not imported


@pytest.mark.parametrize("typed", ["8 x", "8", "8 49 3"])
def test_a_centre_that_is_not_two_numbers_is_refused(server, tmp_path, imported, typed):
    _, opened = make_start(server, tmp_path)
    controls = server.gui.controls
    controls["Path or site"].value, controls["Centre"].value = "map.osm", typed
    controls["Open"].press()
    assert "the centre must be two numbers" in server.gui.said
    assert not opened
    assert not imported


@pytest.mark.parametrize(
    ("error", "words", "trace"),
    [
        (ValueError("no site"), "no site", False),
        (OSError("gone"), "gone", False),
        (KeyError(), "KeyError", True),
    ],
)
def test_what_fails_is_said_and_the_page_opens_another(
    server, tmp_path, capsys, error, words, trace
):
    opened = []

    def then(site):
        opened.append(site)
        if len(opened) == 1:
            raise error

    StartPage(server, tmp_path, then)
    server.gui.controls["Open"].press()
    assert words in server.gui.said
    assert ("Traceback" in capsys.readouterr().err) == trace
    server.gui.controls["Open"].press()
    assert len(opened) == 2


def test_one_map_is_opened_at_a_time(server, tmp_path):
    opened = []

    def then(site):
        opened.append(site)
        server.gui.controls["Open"].press()  # by another browser, meanwhile

    StartPage(server, tmp_path, then)
    server.gui.controls["Open"].press()
    assert len(opened) == 1


@pytest.mark.parametrize("port", [0, -1, 2**16])
def test_a_port_is_one_of_a_machine(port):
    with pytest.raises(ValueError, match=r"port must lie in 1\.\.65535, got"):
        LiveSession(SimpleNamespace(), port=port)


@pytest.fixture
def pages(monkeypatch):
    """Pages of planners that were made, each with what it was made of, and whether it is closed."""
    made = []

    def make(server, planner, project, folder):
        page = SimpleNamespace(planner=planner, project=project, folder=folder, closed=0)
        page.close = lambda: setattr(page, "closed", page.closed + 1)
        made.append(page)
        return page

    monkeypatch.setattr(coview.live_page, "LivePage", make)
    yield made
    gc.unfreeze()


def start_session(planner, **options) -> Any:
    return LiveSession(planner, **options)


def make_project():
    project = SimpleNamespace(closed=0)
    project.close = lambda: setattr(project, "closed", project.closed + 1)
    return project


@pytest.mark.parametrize("port", [1, 2**16 - 1])
def test_a_session_serves_a_planner_until_it_closes(server, pages, tmp_path, port):
    planner, project = SimpleNamespace(), make_project()
    session = start_session(planner, port=port, project=project, folder=tmp_path)
    assert session.planner is planner
    assert session.page is pages[0]
    assert (pages[0].planner, pages[0].project, pages[0].folder) == (planner, project, tmp_path)
    assert server.port == port
    assert session.url == f"http://127.0.0.1:18999/{server.token}/"
    assert len(server.token) >= 20
    assert session.url in session._repr_html_()
    session.wait()
    assert server.slept == 1
    session.close()
    assert (pages[0].closed, project.closed, server.closed) == (1, 1, True)


def test_a_session_opens_a_site_or_says_why_not(server, pages, tmp_path):
    project = make_project()

    def begin(site):
        assert not gc.isenabled()
        assert "opening" in server.gui.said
        if site == "cow":
            raise ValueError("there is no site cow")
        return SimpleNamespace(site=site), project

    session = start_session(begin, port=18999, folder=tmp_path)
    assert "Open" in server.gui.controls
    with pytest.raises(ValueError, match="cow"):
        session.open("cow")
    assert "there is no site cow" in server.gui.said
    assert "Open" not in server.gui.controls
    assert gc.isenabled()
    session.open("tjunction")
    assert gc.isenabled()
    assert session.planner is pages[0].planner
    assert pages[0].planner.site == "tjunction"
    assert server.gui.resets == 3
    session.close()
    assert (pages[0].closed, project.closed) == (1, 1)


def test_sigterm_ends_a_block_as_ctrl_c_does_and_nothing_after_it():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), interrupted_by_sigterm():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before
    done = []

    def work():
        with interrupted_by_sigterm():
            done.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [before]
