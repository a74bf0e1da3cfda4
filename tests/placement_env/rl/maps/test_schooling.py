import pytest

from placement_env.rl.maps import schooling
from placement_env.rl.maps.imitation import Teaching
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.reinforcement import Reinforcement
from placement_env.rl.maps.schooling import train_map_policy

TEACHING = Teaching(passes=2, width=8)


@pytest.fixture
def made(monkeypatch, made_up) -> list[int]:
    """Seeds of junctions that were prepared."""
    seeds: list[int] = []

    def prepare_from(source, folder, *, frames, places, poses):
        seeds.append(source.seed)
        return made_up(source.seed, places, poses)

    monkeypatch.setattr(schooling, "prepare_from", prepare_from)
    return seeds


def test_a_policy_from_nothing(made, made_up, tmp_path):
    told = []
    policy = train_map_policy(
        [0, 1], tmp_path, places=4, poses=3, teaching=TEACHING, progress=lambda *stage: told.append(stage)
    )
    assert made == [0, 1]
    assert [stage for *stage, _ in told] == [
        ["junctions", 1, 2], ["junctions", 2, 2], ["passes", 1, 2], ["passes", 2, 2]
    ]  # fmt: skip
    assert told[-1][-1].keys() == {"hit", "crowd", "kbit", "ap", "regret"}
    assert policy.source == "2 random junctions, 2 passes"
    kept, junction = MapPolicy.load(tmp_path / "policy.safetensors"), made_up(5, 4, 3)
    assert kept.answer(junction.site, junction.candidates, 2) == policy.answer(junction.site, junction.candidates, 2)


def test_what_is_there_is_not_made_again(made, tmp_path):
    train_map_policy([0, 1], tmp_path, places=4, poses=3, teaching=TEACHING)
    told = []
    train_map_policy([0, 1], tmp_path, places=4, poses=3, teaching=TEACHING, progress=lambda *s: told.append(s))
    assert made == [0, 1]
    assert [stage for stage, *_ in told] == ["junctions", "junctions"]
    with pytest.raises(ValueError, match="of other lessons"):
        train_map_policy([0, 1, 2], tmp_path, places=4, poses=3, teaching=TEACHING)


def test_it_goes_on_by_rewards(made, tmp_path):
    asked = {"places": 4, "poses": 3, "teaching": TEACHING, "reinforcement": Reinforcement(steps=2, sets=2)}
    told = []
    policy = train_map_policy([0, 1], tmp_path, **asked, progress=lambda *s: told.append(s))
    assert [stage[:3] for stage in told[-2:]] == [("steps", 1, 2), ("steps", 2, 2)]
    assert told[-1][-1].keys() == {"reward", "entropy", "divergence"}
    assert policy.source == "2 random junctions, 2 passes, 2 steps by reward"
    imitated, kept = MapPolicy.load(tmp_path / "imitated.safetensors"), MapPolicy.load(tmp_path / "policy.safetensors")
    assert imitated.source == "2 random junctions, 2 passes"
    pairs = [(p.network.out.weight.tolist(), p.network.of_view.weight.tolist()) for p in (policy, kept, imitated)]
    assert pairs[0] == pairs[1] != pairs[2]
    told.clear()
    again = train_map_policy([0, 1], tmp_path, **asked, progress=lambda *s: told.append(s))
    assert [stage[0] for stage in told] == ["junctions", "junctions"]
    assert again.network.out.weight.tolist() == pairs[0][0]


def test_own_sites_are_drawn_several_times(made, tmp_path):
    policy = train_map_policy(
        [7], tmp_path, sites=["tjunction"], draws=2, places=4, poses=3, teaching=Teaching(passes=1, width=8)
    )
    assert made == [7, 0, 1]
    assert policy.source == "1 random junctions, 2 own, 1 passes"
    names = sorted(path.name for path in (tmp_path / "lessons").iterdir())
    assert names[0] == "000007.npz"
    assert [name[:5] + name[-6:] for name in names[1:]] == ["site--0.npz", "site--1.npz"]


def test_where_there_is_hardly_anybody_nothing_is_learned(made, monkeypatch, tmp_path):
    monkeypatch.setattr(schooling, "LEAST_VEHICLES", 40)
    with pytest.raises(ValueError, match="is taught by lessons, got none"):
        train_map_policy([0], tmp_path, places=4, poses=3, teaching=TEACHING)


def test_errors(made, tmp_path):
    with pytest.raises(ValueError, match="got no seeds"):
        train_map_policy([], tmp_path)
    with pytest.raises(ValueError, match="000003 is there twice: leave one of them out"):
        train_map_policy([3, 4, 3], tmp_path)
    with pytest.raises(ValueError, match="draws must be a whole number"):
        train_map_policy([], tmp_path, sites=["tjunction"], draws=0)
    with pytest.raises(FileNotFoundError, match="no site"):
        train_map_policy([], tmp_path, sites=[tmp_path / "none.json"])
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "lessons").mkdir()
    (tmp_path / "lessons" / "000000.npz").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="does not fit its checksum"):
        train_map_policy([0], tmp_path)


def test_lessons_of_other_settings_are_not_mixed(made, tmp_path):
    train_map_policy([0, 1], tmp_path, places=4, poses=3, teaching=TEACHING)
    with pytest.raises(ValueError, match=r'settings.json is of other lessons, \{"frames": 16, "places": 4'):
        train_map_policy([0, 1], tmp_path, frames=8, places=4, poses=3, teaching=TEACHING)
    with pytest.raises(ValueError, match="places must be a whole number of at least 1"):
        train_map_policy([0, 1], tmp_path, places=0)
    assert made == [0, 1]


def test_prepared_junctions_are_shared(monkeypatch, made_up, tmp_path):
    folders = []

    def prepare_from(source, folder, **_):
        folders.append(folder)
        return made_up(source.seed, 4, 3)

    monkeypatch.setattr(schooling, "prepare_from", prepare_from)
    train_map_policy([0], tmp_path / "a", teaching=TEACHING)
    train_map_policy([0], tmp_path / "b", teaching=TEACHING, prepared=tmp_path / "shared")
    assert folders == [tmp_path / "a" / "junctions", tmp_path / "shared"]
