"""coview simulate: nothing is done twice, nothing is lost."""

import json

import pytest

from toolkit.bodies.fleet import catalogue


def test_it_says_what_it_made_and_does_nothing_twice(recording, run):
    code, out, _ = run(
        "simulate", "tjunction", "--frames", 4, "--seed", 3, "--out", recording, "--json"
    )
    assert (code, json.loads(out)["frames_made_now"]) == (0, 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--frames", 2, "--workers", 0), "workers must be a whole number of at least 1, got 0"),
        (("--frames", 0), "frames must be a whole number of at least 1, got 0"),
        (
            ("--frames", 2, "--every", 0.05),
            "whole number of SUMO's steps of 1.0 or 0.1 s, got 0.05",
        ),
        (("--frames", 2, "--every", 0), "whole number of SUMO's steps"),
    ],
)
def test_wrong_arguments(arguments, message, refused, tmp_path):
    assert message in refused("simulate", "tjunction", *arguments, "--out", tmp_path / "x.hdf5")


def test_an_unknown_site(refused, tmp_path):
    assert "roundabout, tjunction" in refused("simulate", "atlantis", "--out", tmp_path / "x.hdf5")


def test_a_site_is_not_replaced_by_its_recording(refused, run, tmp_path):
    site = tmp_path / "mine.json"
    run("site", "random", "--seed", 1, "--out", site)
    before = site.read_bytes()
    line = refused("simulate", site, "--frames", 1, "--out", site, "--overwrite")
    assert "is what is read" in line
    assert site.read_bytes() == before


def test_another_recording_is_replaced_only_when_told(recording, refused):
    before = recording.read_bytes()
    assert "made from" in refused(
        "simulate", "tjunction", "--frames", 4, "--seed", 4, "--out", recording
    )
    assert recording.read_bytes() == before


def test_fleets(refused, run, tmp_path):
    """How each mesh was taken is printed; what cannot be told is refused in one line."""
    out, folder = tmp_path / "x.hdf5", tmp_path / "meshes"
    folder.mkdir()
    body = next(each for each in catalogue() if each.name == "compact_suv")
    rows = [f"v {x} {y} {z}" for x, y, z in body.vertices.tolist()]
    rows += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in body.triangles.tolist()]
    (folder / "car.obj").write_text("\n".join(rows))
    at = ("simulate", "tjunction", "--frames", 1, "--workers", 1, "--out", out)
    code, text, _ = run(*at, "--fleet", "meshes", "--meshes", folder)
    assert code == 0
    assert (
        "car.obj: vehicle (by its shape), 4.18 x 1.79 x 1.59 m, z up, x forward (its profile "
        "agrees), mirrors"
    ) in text
    assert "needs a folder of meshes" in refused(*at, "--fleet", "both")
    assert "takes no meshes" in refused(*at, "--fleet", "own", "--meshes", folder)
    turned = [row for row in rows if row.startswith("f")]
    (folder / "car.obj").write_text(
        "\n".join([f"v {x} {z} {-y}" for x, y, z in body.vertices.tolist()] + turned)
    )
    line = refused(*at, "--fleet", "meshes", "--meshes", folder, "--overwrite")
    assert "y up and x forward, turn it" in line
