"""The head of an OpenDRIVE file: what it is, where its roads are, its projection."""

import pytest

from toolkit.sites.opendrive.header import opendrive_header, usable


def test_place_and_projection(street, tmp_path):
    path = street(tmp_path)
    assert opendrive_header(path, (0.0, 0.0)) is None
    with pytest.raises(ValueError, match=r"street\.xodr: centre 900 0 lies outside the map"):
        opendrive_header(path, (900.0, 0.0))
    text = path.read_text().replace('revMinor="7"/>', "><geoReference>+proj=utm +zone=32</geoReference></header>")
    path.write_text(text)
    assert opendrive_header(path, (0.0, 0.0)) == "+proj=utm +zone=32"


def test_a_projection_that_names_none_is_said(tmp_path):
    assert usable("+proj=utm +zone=32", tmp_path / "a.xodr") == "+proj=utm +zone=32"
    assert usable("EPSG:25832", tmp_path / "a.xodr") == "EPSG:25832"
    with pytest.warns(UserWarning, match=r"a\.xodr: its geoReference names no projection \('\+lat_0=4'\)"):
        assert usable("+lat_0=4", tmp_path / "a.xodr") is None
