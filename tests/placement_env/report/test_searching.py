"""One search from its settings to what is printed."""

import json

import pytest

from placement_env.candidates.pool import paper_candidates
from placement_env.objective import Weights
from placement_env.report.searching import SearchOrder, answered
from toolkit.runtime.json_files import finite
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
    said = json.loads(json.dumps(finite(found.summary)))["assessment"]
    assert found.met
    assert (said["by"], said["frames"]) == ("coverage", 2)
    assert said["curse"] == pytest.approx(found.summary["ap"] - said["ap"])
    assert {name for each in said["contenders"] for name in each["searches"]} >= {
        "greedy",
        "swap",
        "map policy",
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
