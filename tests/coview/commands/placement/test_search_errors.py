"""coview search over several error profiles."""

import json

import pytest


@pytest.mark.slow
def test_it_searches_and_verifies_over_error_profiles(tmp_path, run):
    few = (
        "--candidates",
        "paper",
        "--budget",
        1,
        "--frames",
        1,
        "--cache",
        tmp_path,
        "--verify",
        "detector",
    )
    code, out, _ = run("search", "tjunction", *few, "--errors", "paper", "poor", "--json")
    worst = json.loads(out)
    assert code == 0
    assert [each["profile"] for each in worst["errors"]["profiles"]] == ["paper", "poor"]
    assert worst["verified"]["provenance"]["errors"] == worst["errors"]
    assert list(worst["verified"]["by_errors"]) == ["paper", "poor"]
    assert worst["verified"]["ap"] == min(worst["verified"]["by_errors"].values())
    mean = json.loads(
        run(
            "search",
            "tjunction",
            *few,
            "--errors",
            "poor",
            "paper",
            "--errors-by",
            "mean",
            "--json",
        )[1]
    )
    each = mean["verified"]["by_errors"].values()
    assert mean["verified"]["ap"] == pytest.approx(sum(each) / 2)
    assert mean["errors"]["combine"] == "mean"
    said = run("search", "tjunction", *few, "--errors", "paper", "poor")[1]
    assert "AP at each error profile: paper " in said
