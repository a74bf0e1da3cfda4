"""One search from its settings to what is printed."""

import json

import pytest

from placement_env.candidates.pool import paper_candidates
from placement_env.fidelity.combined.error_profiles import ErrorProfiles
from placement_env.report.searching import SearchOrder, answered, question_of
from placement_env.setting import Weights
from toolkit.objects import Detections
from toolkit.runtime.files import replace_infinite
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR
from toolkit.sites.files import load_site

SITE = load_site("tjunction")


@pytest.fixture(scope="module")
def common(tmp_path_factory):
    return {
        "site": SITE,
        "candidates": paper_candidates(SITE),
        "method": "portfolio",
        "budget": 2,
        "fidelity": "coverage",
        "judge": "coverage",
        "frames": 2,
        "settings": {"seed": 3, "cache": tmp_path_factory.mktemp("cache")},
    }


def test_a_portfolio_says_what_fresh_traffic_says(common):
    found = answered(SearchOrder(**common))
    said = json.loads(json.dumps(replace_infinite(found.summary)))["assessment"]
    assert found.met
    assert (said["by"], said["frames"]) == ("coverage", 2)
    assert said["curse"] == pytest.approx(found.summary["ap"] - said["ap"])
    assert {name for each in said["contenders"] for name in each["searches"]} >= {
        "greedy",
        "swap",
    }
    assert all(len(each["sensors"]) == len(each["subset"]) for each in said["contenders"])
    assert found.lines[0].startswith(
        f"portfolio: {{{', '.join(map(str, found.summary['subset']))}}} AP {said['ap']:.4f}"
    )
    assert any("neither searches nor race saw, not a detector: it may err alike everywhere:" in x for x in found.lines)
    assert found.lines[-1].startswith("searched by: AP ")


def test_without_a_sensor(common):
    found = answered(SearchOrder(**common | {"weights": Weights(price=9.0)}))
    assert (found.met, found.summary["sensors"]) == (False, [])
    assert found.lines == ("no sensors: no sensor is worth what it costs: lower --comm and --price",)


def test_it_refuses_before_anything_is_rendered(common):
    with pytest.raises(ValueError, match=r"no surrogate of tjunction for early at IoU 0\.65"):
        SearchOrder(**common | {"judge": "surrogate", "settings": {"iou": 0.65}})
    with pytest.raises(ValueError, match="a table does not know"):
        SearchOrder(**common | {"fidelity": "table"})
    assert SearchOrder(**common | {"judge": "detector"}).detects
    assert not SearchOrder(**common).detects
    assert not SearchOrder(**common | {"judge": "detector", "method": "swap"}).detects


class Wary:
    """Never sees anything."""

    digest = "wary"

    def __call__(self, points, /):
        return Detections.empty()


def test_a_question_says_all_its_error_profiles(common):
    detected = common | {"judge": "detector", "detector": Wary()}
    asked = [
        question_of(SearchOrder(**detected | {"errors": errors}))["errors"]
        for errors in ("poor", POOR, ("poor",), ("paper", "poor"), ErrorProfiles((PAPER_ERRORS, POOR), "mean"))
    ]
    assert asked[0] == asked[1] == asked[2] == POOR.origin
    assert asked[3] == {"profiles": [PAPER_ERRORS.origin, POOR.origin], "combine": "worst"}
    assert asked[4] == asked[3] | {"combine": "mean"}


def test_several_error_profiles_are_judged_and_said(common):
    asked = common | {"judge": "detector", "detector": Wary(), "errors": ("paper", "poor"), "budget": 1}
    found = answered(SearchOrder(**asked))
    said = json.loads(json.dumps(replace_infinite(found.summary)))
    assert said["errors"] == {"profiles": [PAPER_ERRORS.origin, POOR.origin], "combine": "worst"}
    assert said["assessment"]["by_errors"] == [
        {"name": name, "ap": 0.0, "low": 0.0, "high": 0.0} for name in ("paper", "poor")
    ]
    assert said["provenance"]["errors"] == PAPER_ERRORS.origin  # of the search
    assert "by_errors" not in said
    assert any(line.startswith("  the worst over error profiles: paper AP 0.0000") for line in found.lines)
    curve = answered(SearchOrder(**asked | {"curve": True}))
    assert curve.summary["errors"] == said["errors"]
    assert [each["name"] for each in curve.summary["curve"][0]["by_errors"]] == ["paper", "poor"]
    assert any(line.startswith("    at each error profile: paper AP 0.0000") for line in curve.lines)
    alone = answered(SearchOrder(**asked | {"errors": "poor"}))
    assert alone.summary["errors"] == POOR.origin
    assert "errors" not in answered(SearchOrder(**common | {"errors": "poor"})).summary  # judged by coverage
    assert alone.summary["assessment"]["by_errors"] == ()
