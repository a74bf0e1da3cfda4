import pytest

from placement_env.candidates.candidates import paper_candidates
from placement_env.setting import Setting, Weights


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"fidelity": "guess"}, "fidelity must be one of"),
        ({"weights": 0.1}, r"pass Weights\(comm=..., price=...\)"),
        ({"most_price": -1}, "most_price must be 0 or more, got -1"),
        ({"rendering": "quick"}, "rendering must be one of auto, full, panorama, got 'quick'"),
        *(
            ({"scheme": "middle"}, "scheme"),
            ({"detector": "general"}, "detector must be a function"),
        ),
        ({"classes": 3}, "classes must be"),
    ],
)
def test_fields_are_checked(fields, message):
    with pytest.raises(ValueError, match=message):
        Setting("tjunction", **fields)


@pytest.mark.parametrize("costs", [{"comm": -1}, {"price": float("nan")}])
def test_costs_are_checked(costs):
    with pytest.raises(ValueError, match="finite and not negative"):
        Weights(**costs)


def test_candidates_are_found_by_name_or_need_a_site():
    own = Setting("tjunction").pool
    assert len(own) == len(Setting("tjunction", candidates="paper").pool) == 6
    assert Setting("tjunction", candidates=paper_candidates).pool.digest() == own.digest()
    assert Setting(candidates=own).pool is own
    assert len(Setting("tjunction", candidates="pool").pool) > 1000
    with pytest.raises(ValueError, match="needs a site"):
        _ = Setting().pool
