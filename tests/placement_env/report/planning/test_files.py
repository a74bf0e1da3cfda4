"""plan.json: the same plan, the same text; nothing that JSON has not."""

import json
from dataclasses import replace

import numpy as np
import pytest

from placement_env.report.content import Judgement, Plan, Planned, PlanOption, Verdict
from placement_env.report.planning.files import plan_json, write_plan
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


def test_files_are_written_whole_and_those_of_an_earlier_plan_go(tmp_path):
    """Without ground there is nothing to hand over, so the schedule of another plan must not stay beside this one."""
    planned = Planned(replace(PLAN, chosen=None), Site("s", np.array([0.0, 0, 1, 1])))
    out = tmp_path / "new" / "plan"
    out.mkdir(parents=True)
    for name in ("schedule.csv", "plan.json", "mine.txt"):
        (out / name).write_text("old")
    written = write_plan(planned, out)
    assert [path.name for path in written] == ["plan.json", "report.html", "report.pdf"]
    assert (out / "plan.json").read_text(encoding="utf-8") == plan_json(planned.plan)
    assert sorted(each.name for each in out.iterdir()) == ["mine.txt", "plan.json", "report.html", "report.pdf"]
    assert (out / "mine.txt").read_text() == "old"
