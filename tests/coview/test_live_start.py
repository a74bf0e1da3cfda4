"""Maps that the live planner's first page opens."""

import threading

import pytest

from coview.live_start import StartPage, find_middle


@pytest.mark.parametrize(
    ("text", "middle"),
    [
        ('<osm><bounds minlat="49" minlon="8" maxlat="50" maxlon="9"/><node/></osm>', (8.5, 49.5)),
        ('<OpenDRIVE><header north="30" south="-10" east="4" west="2"/></OpenDRIVE>', (3.0, 10.0)),
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
        with pytest.raises(ValueError):
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
    page = object.__new__(StartPage)
    page._folder, page._busy = tmp_path, threading.Lock()
    if kept is None:
        with pytest.raises(ValueError, match="an upload must end with"):
            page._keep(name, b"")
    else:
        assert page._keep(name, b"text") == tmp_path / kept
        assert (tmp_path / kept).read_bytes() == b"text"
