"""The objective on a stand-in fidelity: memory, order, terms, feasibility."""

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from placement_env.candidates.candidates import Axes, Candidates, pool
from placement_env.cases import Cases
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.setting import Setting, Weights
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera
from toolkit.sites.site import Mount, Site


class Counting:
    """Each candidate adds a share of AP and 100 kbit times its index; counts what it is asked."""

    name = "counting"

    def __init__(self, candidates: int) -> None:
        self.asked = 0
        self.share = (candidates + np.arange(candidates)) / 1024  # sums of these are exact

    def __call__(self, subsets: np.ndarray, /) -> Estimate:
        self.asked += len(subsets)
        ap = subsets @ self.share
        return Estimate(ap, ap / 2, subsets @ (100.0 * np.arange(len(self.share))))


@cache
def candidates(
    mounts: int = 3, headings: int = 2, capacity: float = 2000.0, price: float = 2.0
) -> Candidates:
    site = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
    poles = [
        Mount(f"m{i}", np.array([10.0 * i - 10, 12, 0]), price=price, capacity=capacity)
        for i in range(mounts)
    ]
    return pool(
        site,
        heights=(5.0,),
        headings=headings,
        tilts=(0.3,),
        models=(DepthCamera(),),
        mounts=poles,
        blind=True,
    )


def objective(weights: Weights = Weights(), scheme: str = "early", **kwargs: float) -> Objective:
    some = candidates(**kwargs)  # type: ignore[arg-type]
    return Objective(
        Setting(candidates=some, fidelity=Counting(len(some)), scheme=scheme, weights=weights)
    )  # type: ignore[arg-type]


def test_terms_add_up_to_the_reward() -> None:
    score = objective(Weights(comm=0.001, price=0.01)).score([1, 4])
    assert (score.subset, score.kbit, score.kbit_per_sensor) == ((1, 4), 500.0, 250.0)
    assert score.price == 4.0
    assert (score.terms["comm"], score.terms["price"]) == (-0.25, -0.04)
    assert score.reward == pytest.approx(sum(score.terms.values()), abs=1e-15)


def test_without_costs_the_reward_is_the_ap() -> None:
    score = objective().score([0, 3])
    assert score.reward == score.ap > 0


def test_the_empty_set_scores_nothing_and_is_not_scored() -> None:
    some = objective(Weights(1.0, 1.0))
    score = some.score([])
    assert (score.ap, score.recall, score.kbit, score.price, score.reward) == (0, 0, 0, 0, 0)
    assert some.scored_by.asked == 0  # type: ignore[attr-defined]
    assert some.scores(np.zeros((0, len(some.candidates)), bool)).reward.shape == (0,)


def test_a_known_set_is_not_scored_again() -> None:
    some = objective()
    first = some.score([4, 0])
    again = some.score([some.names[0], some.names[4], 0])
    assert (first.cache_hit, again.cache_hit) == (False, True)
    assert first.reward == again.reward
    assert some.scored_by.asked == 1  # type: ignore[attr-defined]


def test_a_pickled_objective_forgets_and_a_reweighed_one_remembers() -> None:
    some = objective()
    some.score([4, 0])
    assert not pickle.loads(pickle.dumps(some)).score([4, 0]).cache_hit
    reweighed = some.with_weights(Weights(price=0.01))
    assert reweighed.score([4, 0]).cache_hit
    reweighed.forget()
    assert (reweighed.score([4, 0]).cache_hit, some.score([4, 0]).cache_hit) == (False, True)


def test_sets_that_share_a_mount_may_not_be_built() -> None:
    some = objective()
    rows = np.array([some.row(members) for members in ([], [0, 2, 4], [0, 1], [5, 3, 2])])
    assert some.feasible(rows).tolist() == [True, True, False, False]
    assert some.allowed([2]).tolist() == [True, True, False, False, True, True]
    assert some.allowed(some.row([2])).tolist() == some.allowed([2]).tolist()


def test_each_mount_is_paid_once() -> None:
    assert objective().score([0, 1]).price == 2.0
    scored = objective(mounts=3, headings=2, price=2.0)
    subsets = np.array([scored.row(members) for members in ((), (0,), (0, 1), (0, 2, 4), range(6))])
    assert scored.price(subsets).tolist() == [0.0, 2.0, 2.0, 6.0, 6.0]
    assert scored.price(np.zeros((0, 6), bool)).shape == (0,)


def test_one_candidate_on_the_second_of_several_mounts_is_scored() -> None:
    pool = candidates()
    axes = Axes(np.array([5.0]), np.array([0.0]), np.array([0.3]), (DepthCamera(),))
    factors = np.array([[1, 0, 0, 0, 0]])
    one = Candidates(pool.sensors[2:3], pool.mounts, factors, axes)
    assert Objective(Setting(candidates=one, fidelity=Counting(1))).score([0]).price == 2.0


def test_unknown_candidates_weights_and_schemes_are_refused() -> None:
    with pytest.raises(FileNotFoundError, match="pol"):
        Objective(Setting("tjunction", candidates="pol"))
    with pytest.raises(ValueError, match="weights must be finite"):
        Weights(comm=-1.0)
    with pytest.raises((ValueError, TypeError), match="of"):
        objective(scheme="middle")


def test_the_provenance_names_site_traffic_and_fidelity() -> None:
    origin = Objective(
        Setting("tjunction", scheme="late", fidelity="table"), Run(frames=2)
    ).provenance
    stated = {name: origin[name] for name in ("site", "frames", "seed", "fidelity")}
    assert stated == {"site": "tjunction", "frames": 2, "seed": 0, "fidelity": "table"}
    further = {"scheme", "codec", "iou", "candidates", "hybrid_radius", "weights", "coview"}
    assert further <= origin.keys()
    assert origin["errors"]["profile"] == "paper"


def test_the_provenance_names_a_custom_fidelity_and_the_codec_of_the_scheme() -> None:
    early, foreground = objective(), objective(scheme="foreground")
    assert early.provenance["fidelity"] == "counting"
    assert early.provenance["codec"] == "PaperCodec(bits_per_point=96, bits_per_box=256)"
    assert foreground.provenance["codec"] == "RangeImages(step=0.02)"
    assert foreground.provenance["scheme"].startswith("Foreground(")


@settings(max_examples=30, deadline=None)
@given(st.lists(st.sets(st.integers(0, 5)), max_size=12))
def test_many_at_once_are_the_same_as_one_by_one(sets: list[set[int]]) -> None:
    some, other = objective(Weights(0.001, 0.01)), objective(Weights(0.001, 0.01))
    together = some.scores(np.array([some.row(members) for members in sets], bool).reshape(-1, 6))
    alone = [other.score(members) for members in sets]
    assert together.reward.tolist() == [score.reward for score in alone]
    assert some.scored_by.asked == len({frozenset(members) for members in sets} - {frozenset()})  # type: ignore[attr-defined]


@pytest.mark.parametrize(("scheme", "fits"), [("early", 3), ("hybrid", 3), ("late", 6)])
def test_a_link_carries_what_it_can(scheme: str, fits: int) -> None:
    some = objective(scheme=scheme, capacity=250.0)
    assert int(some.allowed([]).sum()) == fits
    assert bool(some.feasible(some.row([5])[None])[0]) == (scheme == "late")


@pytest.mark.parametrize("bad", [[6], [-1], ["nobody"], [True, False]])
def test_members_that_there_are_not(bad: list[int | str]) -> None:
    with pytest.raises(ValueError, match="candidates are 0 to 5"):
        objective().score(bad)


@pytest.mark.parametrize(
    ("cases", "fidelity", "message"),
    [
        (Cases(errors="typical"), "table", "errors typical are known to fidelity detector alone"),
        (
            Cases(errors=("typical", "poor")),
            "surrogate",
            "errors typical and poor are known to fidelity detector",
        ),
        (
            Cases(levels=2),
            "table",
            "levels of traffic are known to fidelity coverage and surrogate, got 'table'",
        ),
    ],
)
def test_cases_that_a_fidelity_does_not_know_are_refused(
    cases: Cases, fidelity: Any, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Objective(Setting("tjunction", fidelity=fidelity, cases=cases))


@pytest.mark.parametrize(
    ("part", "message"), [("ap", "no vehicle"), ("kbit", "kbit must be finite")]
)
def test_figures_must_be_finite(part: str, message: str) -> None:
    class Lost(Counting):
        def __call__(self, subsets: np.ndarray, /) -> Estimate:
            return super().__call__(subsets)._replace(**{part: np.full(len(subsets), np.nan)})

    some = candidates()
    with pytest.raises(ValueError, match=message):
        Objective(Setting(candidates=some, fidelity=Lost(len(some)))).score([0])
