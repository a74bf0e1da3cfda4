"""coview site: show, draw, import."""

import pytest


def test_show(run, tmp_path):
    code, out, _ = run("site", "show", "roundabout", "--out", tmp_path / "site.png")
    assert code == 0
    assert "96 x 96 m" in out
    assert (tmp_path / "site.png").stat().st_size > 10_000


PLACE = ("--centre", 0, 0, "--size", 9, 9, "--out", "x.json")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("import", *PLACE), "--opendrive"),
        (("import", "--opendrive", "a.xodr", "--lefthand", *PLACE), "--lefthand is for --osm"),
        (("import", "--opendrive", "a.xodr", *PLACE[:-1], "a.xodr"), "is what is read"),
        (("random", "--seed", -3, "--out", "x.json"), "--seed must be at least 0, got -3"),
    ],
)
def test_wrong_arguments(arguments, message, refused):
    assert message in refused("site", *arguments)


def test_a_site_is_replaced_only_when_told(run, refused, tmp_path):
    mine = tmp_path / "mine.json"
    assert run("site", "random", "--seed", 1, "--out", mine)[0] == 0
    before = mine.read_bytes()
    assert "--overwrite" in refused("site", "random", "--seed", 2, "--out", mine)
    assert "is what is read" in refused("site", "show", mine, "--out", mine, "--overwrite")
    assert mine.read_bytes() == before
    assert run("site", "random", "--seed", 2, "--out", mine, "--overwrite")[0] == 0
    assert mine.read_bytes() != before
