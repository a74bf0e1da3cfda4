"""coview propose: an answer by the map alone."""

import json


def test_it_proposes_sensors_at_once(run):
    code, printed, err = run("propose", "tjunction", "--candidates", "paper", "--budget", 2, "--json")
    assert code == 0, err
    answer = json.loads(printed)
    assert len(answer["sensors"]) == 2
    assert 0.2 < answer["predicted_ap"] < 1
    assert answer["candidates"] == 6
    assert "random junctions" in answer["policy"]
    code, printed, _ = run("propose", "tjunction", "--candidates", "paper", "--budget", 2, "--no-look")
    assert code == 0
    assert printed.splitlines()[:-1] == answer["sensors"]
    assert "is predicted, not judged" in printed


def test_terms_are_kept(run):
    paper = ("propose", "tjunction", "--candidates", "paper", "--no-look")
    code, printed, _ = run(*paper, "--budget", 4, "--money", 2, "--json")
    assert (code, len(json.loads(printed)["sensors"])) == (0, 2)
    code, printed, _ = run(*paper, "--price", 9)
    assert code == 1
    assert "no candidate is worth it" in printed


def test_wrong_arguments(refused, tmp_path):
    assert "--budget" in refused("propose", "tjunction", "--budget", 0)
    assert "--money" in refused("propose", "tjunction", "--money", -1)
    assert "no policy at" in refused("propose", "tjunction", "--policy", tmp_path / "none")
    (tmp_path / "bad").write_bytes(b"damaged")
    assert "is damaged" in refused("propose", "tjunction", "--policy", tmp_path / "bad")
