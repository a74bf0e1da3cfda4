"""coview search --curve --out: what is written, and that it goes on where it was killed."""

import pytest

import placement_env.search.portfolio.curve as curve
from toolkit.sites.files import load_site


@pytest.mark.slow
def test_a_curve_that_was_killed_goes_on_with_out(run, refused, tmp_path, monkeypatch):
    few = (
        "--candidates",
        "paper",
        "--budget",
        3,
        "--frames",
        4,
        "--fidelity",
        "coverage",
        "--cache",
        tmp_path / "c",
    )
    asked = ("search", "tjunction", *few, "--curve", "--judge", "coverage")
    raced = []

    def race(*arguments, **settings):
        raced.append(len(arguments[1]))
        if len(raced) == 2:
            raise OSError("killed")
        return contest(*arguments, **settings)

    contest = curve.contest  # type: ignore[attr-defined]
    monkeypatch.setattr(curve, "contest", race)
    refused(*asked, "--out", tmp_path / "o")
    assert not (tmp_path / "o").exists()
    for other in (("--budget", 2), ("--money", 2.5)):
        line = refused(*asked, *other, "--out", tmp_path / "o")
        assert "o.parts holds an unfinished run made from" in line
    code, printed, _ = run(*asked, "--out", tmp_path / "o")
    assert (code, len(raced)) == (0, 4)  # the first race was not run again
    assert (
        "curve.json, curve.csv, curve.png, and the site with each set" in printed.splitlines()[-1]
    )
    assert not (tmp_path / "o.parts").exists()
    assert run(*asked, "--out", tmp_path / "whole")[0] == 0
    assert len(raced) == 7
    files = sorted(path.name for path in (tmp_path / "o").iterdir())
    assert files == [
        "curve.csv",
        "curve.json",
        "curve.png",
        "site_1.json",
        "site_2.json",
        "site_3.json",
    ]
    assert all(
        (tmp_path / "o" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
        for name in files
    )
    assert "curve.json exists" in refused(*asked, "--out", tmp_path / "o")
    assert len(load_site(tmp_path / "o" / "site_2.json").sensors) == 2
