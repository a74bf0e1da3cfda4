"""coview reproduce: the paper's experiments."""

import json

import pytest

from examples.studies.paper import reproduction


@pytest.mark.parametrize("site", ["general", "somewhere.json"])
def test_other_sites_are_refused_in_one_line(site, tmp_path, refused):
    line = refused("reproduce", site, "--out", tmp_path / "out")
    assert f"the paper has figures for tjunction and roundabout, not for '{site}'" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--frames", 0), "--frames must be at least 1, got 0"),
        (("--workers", 0), "workers must be a whole number of at least 1, got 0"),
        (("--table", "none.npz"), "none.npz"),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(arguments, words, tmp_path, refused):
    assert words in refused("reproduce", "tjunction", "--out", tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_one(tmp_path, refused):
    (tmp_path / "file").write_text("")
    assert "is no folder" in refused("reproduce", "tjunction", "--out", tmp_path / "file")


def test_it_hands_on_what_it_was_given_and_prints(tmp_path, run, monkeypatch):
    asked = {}

    def run_reproduction(site, out, **settings):
        asked.update(settings, site=site, out=out)
        return reproduction.Reproduction(site, settings["frames"], 7, (), out / "index.html")

    monkeypatch.setattr(reproduction, "run_reproduction", run_reproduction)
    arguments = ("reproduce", "roundabout", "--frames", 20, "--workers", 2, "--out", tmp_path)
    code, printed, _ = run(*arguments)
    assert code == 0
    assert "roundabout: 20 frames, 7 vehicles" in printed
    assert f"written to {tmp_path / 'index.html'}" in printed
    assert (asked["site"], asked["out"], asked["frames"], asked["processes"].workers) == (
        "roundabout",
        tmp_path,
        20,
        2,
    )
    assert asked["table"] is None
    code, printed, _ = run(*arguments, "--json")
    assert json.loads(printed) == {
        "site": "roundabout",
        "frames": 20,
        "vehicles": 7,
        "experiments": [],
    }
