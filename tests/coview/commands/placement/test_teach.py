"""coview teach: a policy of one's own, and how it compares to greedy search."""

import json

import pytest

from placement_env.rl.maps import school_plan
from placement_env.rl.maps.held_out import HeldOut

SMALL = ("--junctions", 1, "--frames", 2, "--places", 2, "--poses", 2, "--passes", 1, "--held-out", 0)


@pytest.fixture
def plans(monkeypatch):
    """What was asked for; nothing is taught."""
    asked = []

    def teach_and_try(plan, *, progress):
        asked.append(plan)
        progress("junctions", 1, 2, {})
        progress("passes", 1, 2, {"ap": 0.5})
        rows = [HeldOut(str(k), 2, {"greedy": 0.8, "taught": 0.7 - 0.1 * k}) for k in range(2)]
        return plan.out / "policy.safetensors", "2 random junctions, 30 passes", rows

    monkeypatch.setattr(school_plan, "teach_and_try", teach_and_try)
    return asked


def test_what_is_asked_for_and_printed(run, plans, tmp_path):
    out = tmp_path / "policy"
    code, printed, err = run(
        "teach", "--out", out, "--junctions", 2, "--first", 7, "--sites", "tjunction", "--reinforce", 3,
        "--held-out", 2, "--held-out-first", 40, "--held-out-sites", "roundabout", "--draws", 2, "--prepared", tmp_path,
        "--frames", 3, "--places", 4, "--poses", 5, "--passes", 6, "--budgets", 2, 5, "--seed", 8, "--workers", 9,
    )  # fmt: skip
    assert code == 0, err
    (plan,) = plans
    assert (plan.out, plan.prepared, plan.sites, plan.held_out_sites) == (
        out,
        tmp_path,
        ("tjunction",),
        ("roundabout",),
    )
    assert (list(plan.seeds), list(plan.held_out_seeds)) == ([7, 8], [40, 41])
    assert (plan.draws, plan.frames, plan.places, plan.poses, plan.passes, plan.steps) == (2, 3, 4, 5, 6, 3)
    assert (plan.budgets, plan.seed, plan.workers) == ((2, 5), 8, 9)
    first, _, _, greedy, taught = printed.splitlines()
    assert first == f"{out}/policy.safetensors: taught at 2 random junctions, 30 passes"
    assert greedy == "greedy  0.8000  +0.0000 ± 0.0000  at worst +0.0000"
    assert taught == "taught  0.6500  +0.1500 ± 0.0500  at worst +0.2000"


def test_as_json(run, plans, tmp_path):
    code, printed, _ = run("teach", "--out", tmp_path, "--json")
    assert code == 0
    told = json.loads(printed)
    assert told["policy"] == str(tmp_path / "policy.safetensors")
    assert told["source"] == "2 random junctions, 30 passes"
    assert [row["name"] for row in told["held_out"]] == ["greedy", "taught"]
    assert told["held_out"][1]["behind"] == pytest.approx(0.15)
    (plan,) = plans
    assert (len(plan.seeds), plan.steps, list(plan.held_out_seeds)[:2]) == (300, 0, [30000, 30001])


def test_wrong_arguments(refused, tmp_path):
    out = ("teach", "--out", tmp_path / "policy")
    for option in ("--junctions", "--first", "--reinforce", "--held-out", "--held-out-first"):
        assert f"{option} must be at least 0" in refused(*out, option, -1)
    assert "--workers must be at least 1" in refused(*out, "--workers", 0)
    assert "got no seeds and no sites" in refused(*out, "--junctions", 0, "--held-out", 0)
    assert "no site" in refused(*out, "--sites", tmp_path / "none.json")
    assert "cannot be held out" in refused(*out, "--first", 29999, "--junctions", 2)
    (tmp_path / "file").write_text("")
    assert "is no folder" in refused("teach", "--out", tmp_path / "file" / "policy")
    assert not (tmp_path / "policy").exists()


@pytest.mark.slow
def test_a_real_one_proposes(run, tmp_path):
    code, printed, err = run("teach", "--out", tmp_path / "policy", *SMALL, "--reinforce", 2)
    assert code == 0, err
    assert "1 random junctions, 1 passes, 2 steps by reward" in printed
    policy = tmp_path / "policy" / "policy.safetensors"
    code, printed, err = run("propose", "tjunction", "--candidates", "paper", "--policy", policy, "--no-look", "--json")
    assert code in (0, 1), err
    assert json.loads(printed)["policy"] == "1 random junctions, 1 passes, 2 steps by reward"
