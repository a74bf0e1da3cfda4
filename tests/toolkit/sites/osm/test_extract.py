"""OpenStreetMap extracts: their projection, their outlines, and files that are none."""

import gzip

import pytest

from toolkit.sites.maps import import_osm

CENTRE = (13.4, 52.505)


def test_multipolygons_holes_and_missing_members(tmp_path, crossroads, imported, top, box):
    draft = crossroads()
    half = draft.way((15, 15), (35, 15), (35, 28))
    rest = draft.way((35, 28), (15, 28), (15, 15))
    court = draft.way(*box(22, 19, 28, 24))
    draft.relation(
        [(half, "outer"), (rest, "outer"), (court, "inner")], type="multipolygon", building="yes", height="10"
    )
    torn = draft.way((-15, 15), (-35, 15), (-35, 28))
    draft.relation([(torn, "outer"), (999999, "outer")], type="multipolygon", building="yes")
    site = imported(draft, tmp_path)
    assert top(site, 18, 17) == [10.0]
    assert top(site, 25, 21.5) == []
    assert top(site, -25, 18) == []


def test_gzip_and_wrong_formats(tmp_path, crossroads):
    path = tmp_path / "town.osm.gz"
    path.write_bytes(gzip.compress(str(crossroads()).encode()))
    assert import_osm(path, centre=CENTRE, size=(60, 60)).name == "town"
    whole = path.read_bytes()
    path.write_bytes(whole[:150] + bytes(60) + whole[210:])
    with pytest.raises(ValueError, match="damaged gzip"):
        import_osm(path, centre=CENTRE, size=(60, 60))
    path.write_bytes(whole[:200])
    with pytest.raises(ValueError, match="damaged gzip"):
        import_osm(path, centre=CENTRE, size=(60, 60))
    (tmp_path / "town.pbf").write_bytes(b"1")
    with pytest.raises(ValueError, match=r"only \.osm, \.osm\.xml and \.osm\.gz are read"):
        import_osm(tmp_path / "town.pbf", centre=CENTRE, size=(60, 60))


def test_entities_are_refused(tmp_path, put):
    bomb = '<?xml version="1.0"?><!DOCTYPE osm [<!ENTITY a "aaaa">]><osm><node id="1" lat="0" lon="0"/></osm>'
    with pytest.raises(ValueError, match="not OpenStreetMap XML"):
        import_osm(put(bomb, tmp_path), centre=(0, 0), size=(60, 60))


def test_truncated_map(tmp_path, put, crossroads):
    text = str(crossroads())
    path = put(text[: len(text) // 2], tmp_path)
    with pytest.raises(ValueError, match="damaged XML"):
        import_osm(path, centre=CENTRE, size=(60, 60))
