"""One search from its settings to what is printed."""

import json
from dataclasses import replace

import pytest

from placement_env.cases import Cases
from placement_env.search.order import SearchOrder
from placement_env.search.search_run import run_search
from placement_env.setting import Setting, Weights
from toolkit.display import format_share
from toolkit.objects import Detections
from toolkit.runtime.run import Run
from toolkit.runtime.text_values import replace_infinite
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR
from toolkit.sites.files import load_site

SITE = load_site("tjunction")


@pytest.fixture(scope="module")
def common(tmp_path_factory):
    def order(cases=Cases(), detector=None, fidelity="coverage", weights=Weights(), **fields):
        setting = Setting(SITE, fidelity=fidelity, cases=cases, detector=detector, weights=weights)
        run = Run(frames=2, seed=3, cache=cache)
        return SearchOrder(
            **{"setting": setting, "run": run, "budget": 2, "judge": "coverage", **fields}
        )

    cache = tmp_path_factory.mktemp("cache")
    return order


def test_portfolios_say_fresh_traffic(common):
    found = run_search(common(contenders=True))
    said = json.loads(json.dumps(replace_infinite(found.summary)))["assessment"]
    assert found.met
    assert (said["by"], said["frames"]) == ("coverage", 2)
    assert said["curse"] == pytest.approx(found.summary["ap"] - said["ap"])
    assert {name for each in said["contenders"] for name in each["searches"]} >= {"greedy", "swap"}
    assert all(len(each["sensors"]) == len(each["subset"]) for each in said["contenders"])
    ap = format_share(said["ap"], said["objects"])
    assert found.lines[0].startswith(
        f"portfolio: {{{', '.join(map(str, found.summary['subset']))}}} AP {ap} by "
    )
    assert any(
        "had no part in the choice, not a detector: it may err alike everywhere:" in x
        for x in found.lines
    )
    assert found.lines[-1].startswith("estimate of the search: coverage ")


def test_questions_name_all_error_profiles(common):
    def profiles(*errors, by="worst"):
        cases = Cases(errors=errors, errors_by=by)
        return common(judge="detector", detector=Wary(), cases=cases).question["errors"]

    assert profiles("poor") == profiles(POOR) == POOR.origin
    assert profiles("paper", "poor") == {
        "profiles": [PAPER_ERRORS.origin, POOR.origin],
        "combine": "worst",
    }
    assert profiles("paper", "poor", by="mean")["combine"] == "mean"


def test_orders_without_sensors_and_refusals(common):
    found = run_search(common(weights=Weights(price=9.0)))
    assert (found.met, found.summary["sensors"]) == (False, [])
    assert found.lines == (
        "no sensors: no sensor is worth what it costs: lower --comm and --price",
    )
    with pytest.raises(ValueError, match=r"no surrogate of tjunction for early at IoU 0\.65"):
        common(judge="surrogate", cases=Cases(iou=0.65))
    with pytest.raises(ValueError, match="a table does not know"):
        common(fidelity="table")
    assert common(judge="detector").detects
    assert not common().detects
    assert not common(judge="detector", method="swap").detects


@pytest.mark.parametrize("method", ["greedy", "portfolio"])
@pytest.mark.parametrize("confidence", [0.0, 1.0, 2.0])
def test_a_confidence_is_refused_whatever_the_method(common, method, confidence):
    with pytest.raises(ValueError, match="confidence must lie between 0 and 1"):
        common(method=method, confidence=confidence)


class Wary:
    digest = "wary"

    def __call__(self, points, /):
        return Detections.empty()


def test_several_error_profiles_are_judged_and_said(common):
    both = Cases(errors=("paper", "poor"))
    asked = {"judge": "detector", "detector": Wary(), "budget": 1}
    found = run_search(common(cases=both, **asked))
    said = json.loads(json.dumps(replace_infinite(found.summary)))
    assert said["errors"] == {"profiles": [PAPER_ERRORS.origin, POOR.origin], "combine": "worst"}
    assert said["assessment"]["by_errors"] == [
        {"name": name, "ap": 0.0, "low": None, "high": None}
        for name in ("paper", "poor")  # few frames
    ]
    assert said["provenance"]["errors"] == PAPER_ERRORS.origin  # of the search
    assert "by_errors" not in said
    assert any(
        line.startswith("  the worst over error profiles: paper AP 0.00") for line in found.lines
    )


def test_curves_and_single_profiles_say_their_errors(common):
    both, poor = Cases(errors=("paper", "poor")), Cases(errors="poor")
    asked = {"judge": "detector", "detector": Wary(), "budget": 1}
    curve = run_search(common(cases=both, curve=True, **asked))
    profiles = [PAPER_ERRORS.origin, POOR.origin]
    assert curve.summary["errors"] == {"profiles": profiles, "combine": "worst"}
    assert [each["name"] for each in curve.summary["curve"][0]["by_errors"]] == ["paper", "poor"]
    assert any(line.startswith("    at each error profile: paper AP 0.00") for line in curve.lines)
    alone = run_search(common(cases=poor, **asked))
    assert alone.summary["errors"] == POOR.origin
    assert not alone.summary["assessment"]["by_errors"]
    assert "errors" not in run_search(common(cases=poor)).summary  # judged by coverage


@pytest.mark.slow
def test_a_long_search_tells_a_first_answer_and_looks_at_fewer_frames(common, limits):
    limits("placement_env.search.search_run", SEARCH_FRAMES=2)
    limits("placement_env.search.first_look", LOOK_FRAMES=2)
    told = []
    order = common(tell=told.append)
    found = run_search(replace(order, run=replace(order.run, frames=5)))
    first, *others = told
    assert first.startswith("first answer, by greedy on 2 frames: ")
    predicted = [float(line.rpartition(" ")[2]) for line in others if line.startswith("better: ")]
    assert predicted == sorted(predicted)
    assert all(line.startswith(("better: ", "ahead after ")) for line in others)
    assert found.summary["provenance"]["frames"] == 3
    assert found.summary["assessment"]["frames"] == 5
