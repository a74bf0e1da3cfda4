import pytest

from placement_env.rl.maps import schooling
from placement_env.rl.maps.imitation import Teaching
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.schooling import train_map_policy

TEACHING = Teaching(passes=2, width=8)


@pytest.fixture
def made(monkeypatch, made_up) -> list[int]:
    """Seeds of junctions that were prepared."""
    seeds: list[int] = []

    def prepare(seed, folder, *, frames, places, poses):
        seeds.append(seed)
        return made_up(seed, places, poses)

    monkeypatch.setattr(schooling, "prepare", prepare)
    return seeds


def test_a_policy_from_nothing(made, made_up, tmp_path):
    told = []
    policy = train_map_policy(
        [0, 1], tmp_path, places=4, poses=3, teaching=TEACHING, progress=lambda *stage: told.append(stage)
    )
    assert made == [0, 1]
    assert told == [("junctions", 1, 2), ("junctions", 2, 2), ("passes", 1, 2), ("passes", 2, 2)]
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


def test_errors(made, tmp_path):
    with pytest.raises(ValueError, match="got no seeds"):
        train_map_policy([], tmp_path)
    (tmp_path / "lessons").mkdir()
    (tmp_path / "lessons" / "000000.npz").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="does not fit its checksum"):
        train_map_policy([0], tmp_path)
