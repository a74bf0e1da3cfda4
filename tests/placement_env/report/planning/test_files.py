"""plan.json: the same plan, the same text; nothing that JSON has not."""

import json

import numpy as np
import pytest

from placement_env.report.content import Judgement, Plan, PlanOption, Verdict
from placement_env.report.planning.files import plan_json, write_plan
from placement_env.report.planning.planning import Planned
from toolkit.sites.site import Site

JUDGED = Judgement(0.5, 0.25, 0.75, 0.5, None, 4, 2)
PLAN = Plan(
    {"site": "Straße", "money": float("inf")}, "Straße", "Reader", 0.7, "early", "", Verdict(None, "So."),
    PlanOption(("a",), 1.0, 2.0, 2.0, float("nan"), JUDGED),
)  # fmt: skip


def test_json_of_a_plan():
    text = plan_json(PLAN)
    read = json.loads(text, parse_constant=pytest.fail)
    assert (read["question"], read["chosen"]["predicted"]) == ({"site": "Straße", "money": None}, None)
    assert read["chosen"]["judged"]["precision"] is None
    assert read["chosen"]["judged"]["low"] == 0.25
    assert "Straße" in text
    assert text.endswith("}\n")


def test_files_are_written_whole(tmp_path):
    planned = Planned(PLAN, Site("s", np.array([0.0, 0, 1, 1])))
    (path,) = write_plan(planned, tmp_path / "new" / "plan")
    assert path.name == "plan.json"
    assert path.read_text(encoding="utf-8") == plan_json(PLAN)
    assert [each.name for each in path.parent.iterdir()] == ["plan.json"]
