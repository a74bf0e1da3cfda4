"""The contents of a plan: what goes to plan.json, and the grid of the ground."""

import json

import numpy as np

from placement_env.handover.ground import GroundGrid
from placement_env.report.content import Judgement, Plan, PlanOption, Verdict


def test_plans_become_json_with_every_figure():
    judged = Judgement(0.9, 0.85, 0.95, 0.92, 0.97, 120, 40)
    option = PlanOption(("a", "b"), 2.0, 500.0, 1000.0, 0.93, judged, ("greedy",))
    plan = Plan(
        {"budget": 2},
        "tjunction",
        "voxelnet",
        0.7,
        "early",
        "",
        Verdict(None, "it"),
        option,
        front=(option,),
    )
    read = json.loads(json.dumps(plan.as_dict(), allow_nan=False))
    assert read["chosen"]["judged"]["vehicles"] == 120
    assert read["front"][0]["sensors"] == ["a", "b"]
    assert read["verdict"] == {"met": None, "sentence": "it", "reasons": []}
    grid, empty = np.zeros((2, 3), bool), np.zeros((0, 2, 3))
    ground = GroundGrid(
        np.arange(3) * 0.5,
        np.arange(2) * 0.5,
        empty.astype(bool),
        empty.astype(np.float32),
        *[grid] * 3,
    )
    assert ground.cell == 0.5
