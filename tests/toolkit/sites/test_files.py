"""Sites read and written by name or path."""

import json

import numpy as np
import pytest

from toolkit.sites.files import load_site, save_site

NET = '<net version="1.20">\n    <edge id="a"/>\n</net>\n'


def test_a_saved_site_comes_back_equal(tmp_path, small_site, saved):
    site, (path, document) = small_site(), saved(tmp_path)
    loaded = load_site(path)
    assert loaded == site
    assert loaded.network == NET
    assert loaded.hybrid_radius == 15.5
    for before, after in zip(site.sensors, loaded.sensors, strict=True):
        assert np.abs(before.pose - after.pose).max() < 1e-9
        assert before.model.shape == after.model.shape
    save_site(loaded, path)
    assert json.loads(path.read_text()) == document


def test_files_that_are_no_json(tmp_path, small_site):
    path = tmp_path / "cut.json"
    save_site(small_site(), path)
    path.write_text(path.read_text()[:500])
    with pytest.raises(ValueError, match="not JSON from line"):
        load_site(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not a text file"):
        load_site(path)
    path.write_text("[1, 2]")
    with pytest.raises(ValueError, match="FeatureCollection"):
        load_site(path)
    with pytest.raises(FileNotFoundError, match="roundabout, tjunction"):
        load_site("tjunctoin")


def test_a_byte_order_mark_does_no_harm(tmp_path):
    path = tmp_path / "site.json"
    save_site(load_site("tjunction"), path)
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert load_site(path) == load_site("tjunction")
