import numpy as np
import pytest

from placement_env.rl.maps import held_out, school_plan, schooling
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.school_plan import SchoolPlan, teach_and_try

SMALL = {"passes": 1, "places": 4, "poses": 3, "budgets": (2,)}


@pytest.fixture
def made(monkeypatch, made_up):
    def prepare_from(source, folder, *, frames, places, poses):
        return made_up(source.seed, places, poses)

    monkeypatch.setattr(schooling, "prepare_from", prepare_from)
    monkeypatch.setattr(held_out, "other_traffic", lambda source, *_, **__: made_up(source.seed, 4, 3).visibility)
    monkeypatch.setattr(held_out, "sent_when_empty", lambda *_: lambda members: np.full(len(members), 100.0))


def test_imitation_alone(made, tmp_path):
    plan = SchoolPlan(out=tmp_path, seeds=[0], held_out_seeds=[5, 6], **SMALL)
    path, source, rows = teach_and_try(plan)
    assert path == tmp_path / "policy.safetensors"
    assert source == MapPolicy.load(path).source == "1 random junctions, 1 passes"
    assert [row.junction for row in rows] == ["000005", "000006"]
    assert [name for name in rows[0].ap if "looked" not in name] == ["greedy", "shipped", "taught"]
    assert all(0 < ap < 1 for row in rows for ap in row.ap.values())


def test_rewards_after_it(made, monkeypatch, tmp_path):
    asked, told = {}, []
    monkeypatch.setattr(school_plan, "tried_at", lambda *given, **_: asked.update(policies=given[2]) or [])
    plan = SchoolPlan(out=tmp_path, seeds=[0], steps=1, **SMALL)
    path, source, rows = teach_and_try(plan, progress=lambda *stage: told.append(stage[0]))
    assert rows == []
    assert told == ["junctions", "passes", "steps"]
    assert source.endswith("1 steps by reward")
    weights = {name: policy.network.out.weight.tolist() for name, policy in asked["policies"].items()}
    assert list(weights) == ["shipped", "taught", "reinforced"]
    assert weights["taught"] == MapPolicy.load(tmp_path / "imitated.safetensors").network.out.weight.tolist()
    assert weights["reinforced"] == MapPolicy.load(path).network.out.weight.tolist() != weights["taught"]


def test_sources_and_folders(tmp_path):
    plan = SchoolPlan(out=tmp_path, seeds=range(2), sites=["tjunction"], draws=2, held_out_sites=["roundabout"])
    assert [source.name for source in plan.taught][:2] == ["000000", "000001"]
    assert [source.seed for source in plan.taught] == [0, 1, 0, 1]
    assert len(plan.held_out) == 2
    assert plan.folder.folder == tmp_path / "junctions"
    assert SchoolPlan(out=tmp_path, prepared=tmp_path / "else").folder.folder == tmp_path / "else"
    settings = {"frames": 3, "places": 4, "poses": 5}
    assert SchoolPlan(out=tmp_path, **settings).folder.settings == settings


def test_errors(tmp_path):
    with pytest.raises(ValueError, match="cannot be held out, 000003 is both: choose other ones"):
        SchoolPlan(out=tmp_path, seeds=range(5), held_out_seeds=[9, 3, 4])
    with pytest.raises(ValueError, match="cannot be held out, site-"):
        SchoolPlan(out=tmp_path, sites=["tjunction"], held_out_sites=["tjunction"])
    for wrong in ({"passes": 0}, {"steps": -1}, {"workers": 0}, {"seed": -1}, {"budgets": (2, 0)}, {"draws": 0}):
        with pytest.raises(ValueError, match="must be a whole number"):
            SchoolPlan(out=tmp_path, seeds=[0], **wrong)
    with pytest.raises(ValueError, match="frames must be a whole number"):
        teach_and_try(SchoolPlan(out=tmp_path, seeds=[0], frames=0))
