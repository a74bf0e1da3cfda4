"""Sets worth a judgement: feasible, of every size, within the money, the same again."""

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from placement_env.cases import Cases
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import IOUS
from placement_env.fidelity.point_count import PointCount
from placement_env.objective import Objective
from placement_env.search import greedy, swap
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.exact import cheapest, cpsat, exhaustive
from placement_env.search.portfolio import entrants as module_of_entrants
from placement_env.search.portfolio.entrants import (
    SWAP_EVALUATIONS,
    THRIFT_AP,
    Effort,
    Entrants,
    find_entrants,
    join_entrants,
    keep_entrants,
)
from placement_env.search.progress import as_rows
from placement_env.search.verification import neighbours
from placement_env.setting import Setting
from toolkit.detection.paper_codec import PaperCodec
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Run

TWO = Effort((1, 2))


def test_every_size_has_its_best_set(street):
    found = find_entrants(street.objective, Effort((1, 2, 3)))
    assert street.objective.feasible(found.sets).all()
    sizes = found.sets.sum(axis=1)
    assert (np.diff(sizes) >= 0).all()
    assert {size: found.predicted[sizes == size].max() for size in (1, 2, 3)} == {
        1: 0.5,
        2: 0.75,
        3: 1.0,
    }
    assert len(np.unique(found.sets, axis=0)) == len(found.sets)
    three = int(np.flatnonzero(sizes == 3)[found.predicted[sizes == 3].argmax()])
    assert {"exhaustive", "greedy"} <= set(found.searches[three])
    assert found.considered > 14
    assert np.array_equal(found.predicted, street.objective.scores(found.sets).ap)


def test_sets_above_the_largest_price_do_not_enter(street):
    # the sets cost 11, 11, 10.5 and 23
    tight = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=street.objective.scored_by,
            scheme="late",
            most_price=22.0,
        )
    )
    found = find_entrants(tight, Effort((1, 2, 3, 4)))
    assert tight.price(found.sets).max() == 22.0
    assert found.sets.sum(axis=1).max() == 2


def test_the_same_seed_finds_the_same_entrants(street):
    first, again = (
        find_entrants(street.objective, Effort((1, 2)), seed=3),
        find_entrants(street.objective, Effort((1, 2)), seed=3),
    )
    assert np.array_equal(first.sets, again.sets)
    assert (first.searches, first.considered) == (again.searches, again.considered)


def test_nothing_enters_where_nothing_may_be_built(street):
    poor = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=street.objective.scored_by,
            scheme="late",
            most_price=1.0,
        )
    )
    found = find_entrants(poor, Effort((1, 2)))
    assert (found.sets.shape, found.predicted.shape, found.searches) == ((0, 4), (0,), ())


def test_poles_that_must_carry_a_sensor_do_so_in_sets_of_just_as_many_and_more(street):
    setting = Setting(
        candidates=street.candidates,
        fidelity=street.objective.scored_by,
        scheme="late",
        keep=("post1", "post2"),
    )
    found = find_entrants(Objective(setting), Effort((1, 2, 3)))
    assert sorted(set(found.sets.sum(axis=1).tolist())) == [2, 3]
    assert found.sets[found.sets.sum(axis=1) == 2].astype(int).tolist() == [[0, 1, 1, 0]]
    assert found.sets[:, [1, 2]].all()


def test_large_pools(make):
    stages = []
    objective = Objective(
        make(mounts=6, poses=4).setting, Run(progress=lambda *stage: stages.append(stage))
    )
    found = find_entrants(objective, Effort((1, 2), neighbours=3))
    done = [(done, total) for name, done, total in stages if name == "searches"]
    assert [each for each, _ in done] == sorted(each for each, _ in done)
    assert done[0][0] == 0
    assert done[-1][0] == done[-1][1]
    assert not any("exhaustive" in names for names in found.searches)
    assert 4 <= len(found.sets) <= 14


def test_a_required_ap_brings_the_cheapest_sets_around_it(street):
    """Sensors 0 and 1 cost 11, 2 costs 10.5; one finds half, two find three quarters, three find
    all."""
    usual, asked = (
        find_entrants(street.objective, Effort((1, 2, 3), min_ap=each)) for each in (None, 0.5)
    )
    names = {name for each in asked.searches for name in each}
    assert {"swap for AP 0.45", "swap for AP 0.5", "swap for AP 0.55", "swap for AP 0.6"} <= names
    assert not any("for AP" in name for each in usual.searches for name in each)
    reach = asked.predicted >= 0.5
    assert street.objective.price(asked.sets[reach]).min() == 11.0


def test_entrants_of_several_searches_are_joined(street):
    one, two = np.eye(4, dtype=bool)[[0, 1]], np.array([[0, 1, 0, 0], [1, 1, 0, 0]], bool)
    found = [
        Entrants(one, np.zeros(2), (("greedy",), ()), 5),
        Entrants(two, np.zeros(2), (("swap",), ("greedy",)), 6),
    ]
    joined = join_entrants([street.objective, street.objective], found)
    assert joined.sets.astype(int).tolist() == [[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0]]
    assert joined.searches == (("greedy",), ("swap",), ("greedy",))
    assert joined.predicted.tolist() == street.objective.scores(joined.sets).ap.tolist()
    assert joined.considered == 11
    assert join_entrants([street.objective], found[:1]) is found[0]


def test_they_are_kept_under_all_that_they_depend_on(street, fail):
    cache = Cache()
    first = keep_entrants(street.objective, TWO, cache, depends_on="a", seed=1)
    assert first.searches == find_entrants(street.objective, TWO, seed=1).searches
    rich = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=street.objective.scored_by,
            scheme="late",
            most_price=900.0,
        )
    )
    fail(module_of_entrants, "find_entrants")
    again = keep_entrants(street.objective, TWO, cache, depends_on="a", seed=1)
    assert np.array_equal(first.sets, again.sets)
    assert np.array_equal(first.predicted, again.predicted)
    assert (first.searches, first.considered) == (again.searches, again.considered)
    for objective, effort, changes in (
        *(
            (street.objective, Effort((1, 2, 3)), {}),
            (street.objective, Effort((1, 2), evaluations=9), {}),
        ),
        *(
            (street.objective, TWO, {"depends_on": "b"}),
            (street.objective, TWO, {"seed": 2}),
            (rich, TWO, {}),
        ),
    ):
        with pytest.raises(AssertionError, match="find_entrants was called"):
            keep_entrants(objective, effort, cache, **{"depends_on": "a", "seed": 1, **changes})


def test_none_are_kept_too(street):
    poor = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=street.objective.scored_by,
            scheme="late",
            most_price=1.0,
        )
    )
    cache = Cache()
    for _ in range(2):
        none = keep_entrants(poor, TWO, cache)
        assert (none.searches, none.sets.shape) == ((), (0, 4))


def test_searches_get_the_seed_the_effort_and_the_price_that_are_asked(street, spy):
    """Prices of the candidates are 11, 11, 10.5 and 23 units: 13.875 in the mean."""
    calls = spy(swap, "search")
    find_entrants(
        street.objective, Effort((2,), seconds=50.0, evaluations=40, neighbours=0), seed=7
    )
    asked = {"seed": 7, "starts": swap.DEFAULT_STARTS, "evaluations": 40, "seconds": 50.0}
    assert all(asked.items() <= call.named.items() for call in calls)
    prices = [objective.weights.price for (objective, _), _ in calls]
    assert [price for price in prices if price] == [pytest.approx(THRIFT_AP / 13.875)]
    calls.clear()
    find_entrants(street.objective, Effort((2,)), seed=7)
    assert {call.named["evaluations"] for call in calls} == {SWAP_EVALUATIONS}


@pytest.mark.parametrize(("most", "searched"), [(10, True), (9, False)])
def test_all_sets_are_scored_up_to_a_number_of_them(street, limits, most, searched):
    """Of four sensors there are 4 + 6 sets of one or two."""
    limits("placement_env.search.portfolio.entrants", MAX_EXHAUSTIVE_SETS=most)
    found = find_entrants(street.objective, Effort((2,)))
    assert any("exhaustive" in names for names in found.searches) == searched


@pytest.fixture
def searches(street, monkeypatch):
    """The searches of a size in their order: name, and what it is asked. None of them runs."""

    def noting(name):
        return lambda *given, **named: (name, *given, named)

    for module in (swap, greedy, exhaustive, cpsat, cheapest):
        monkeypatch.setattr(module, "search", noting(module.__name__.rsplit(".", 1)[-1]))
    monkeypatch.setattr(module_of_entrants, "entropy_objective", lambda objective: "by entropy")
    monkeypatch.setattr(module_of_entrants, "points_objective", lambda objective: None)
    monkeypatch.setattr(module_of_entrants, "Surrogate", type(street.objective.scored_by))
    street.objective.visibility = "seen"

    class Part:
        def __init__(self, name=""):
            self.name = name

        def part(self, name):
            return f"part {name}"

    def listed(effort, size=2, objective=street.objective, others=None):
        found = module_of_entrants.list_searches(objective, size, effort, 7, Part(), others or {})
        return [(name, run()) for name, run in found]

    return listed


def test_points_and_other_ious_bring_entrants_of_their_own(searches, monkeypatch):
    monkeypatch.setattr(module_of_entrants, "points_objective", lambda objective: "by points")
    found = dict(
        searches(
            Effort((1, 2), seconds=9.0, evaluations=300), others={"swap at mean IoU": "at mean IoU"}
        )
    )
    assert found["greedy by points"] == (
        "greedy",
        "by points",
        2,
        {"seconds": 9.0, "evaluations": 300},
    )
    search, objective, size, asked = found["swap at mean IoU"]
    assert (search, objective, size) == ("swap", "at mean IoU", 2)
    assert (asked["evaluations"], asked["checkpoint"]) == (75, "part 2.swap at mean IoU")


def test_objectives_at_other_ious_are_those_of_a_setting_there():
    def make(iou):
        return Objective(Setting("tjunction", cases=Cases(iou=iou)), Run(frames=8))

    usual, mean = make(0.7), make(IOUS)
    rows = np.eye(6, dtype=bool)
    assert list(module_of_entrants.at_other_ious(usual)) == ["swap at IoU 0.9", "swap at mean IoU"]
    at_usual = module_of_entrants.at_other_ious(mean)["swap at IoU 0.7"]
    np.testing.assert_array_equal(at_usual.scores(rows).ap, usual.scores(rows).ap)
    at_mean = module_of_entrants.at_other_ious(usual)["swap at mean IoU"]
    np.testing.assert_array_equal(at_mean.scores(rows).ap, mean.scores(rows).ap)
    assert list(module_of_entrants.at_other_ious(make(0.9))) == [
        "swap at IoU 0.7",
        "swap at mean IoU",
    ]
    assert (
        module_of_entrants.at_other_ious(
            Objective(Setting("tjunction", fidelity="coverage"), Run(frames=8))
        )
        == {}
    )


def test_points_count_up_to_enough_on_every_object(made_visibility):
    seen = made_visibility()
    sets = np.random.default_rng(0).random((9, len(seen))) < 0.3
    sums = np.array([seen.points[row].sum(axis=0, dtype=np.float64) for row in sets])
    wanted = np.minimum(np.log1p(sums), math.log(300)).mean(axis=1) / math.log(300)
    np.testing.assert_allclose(PointCount(seen)(sets).ap, wanted, rtol=1e-5)
    assert PointCount(seen)(np.zeros_like(sets[:1])).ap.tolist() == [0.0]


def test_every_search_gets_its_seed_its_time_and_its_place_to_go_on(searches, street):
    found = searches(Effort((1, 2), seconds=9.0, evaluations=300))
    swapping = {"seed": 7, "starts": swap.DEFAULT_STARTS, "seconds": 9.0, "evaluations": 300}
    own, limits = street.objective, {"seconds": 9.0, "evaluations": 300}
    assert found[:5] == [
        ("exhaustive", ("exhaustive", own, 2, limits)),
        ("greedy", ("greedy", own, 2, limits)),
        ("swap", ("swap", own, 2, swapping | {"checkpoint": "part 2.swap"})),
        (
            "swap by perception entropy",
            ("swap", "by entropy", 2, swapping | {"checkpoint": "part 2.entropy"}),
        ),
        ("cpsat", ("cpsat", own, 2, {"seed": 7, "seconds": 9.0, "effort": 10.0})),
    ]
    ((name, (search, thrifty, size, asked)),) = found[5:]
    assert (name, search, size, asked) == (
        "thrifty swap",
        "swap",
        2,
        swapping | {"checkpoint": "part 2.thrifty"},
    )
    assert thrifty.weights.price == pytest.approx(THRIFT_AP / 13.875)
    free = searches(Effort((1, 2)))
    assert free[1] == ("greedy", ("greedy", own, 2, {"seconds": None, "evaluations": None}))
    assert free[2][1][3]["evaluations"] == SWAP_EVALUATIONS
    assert free[4] == ("cpsat", ("cpsat", own, 2, {"seed": 7, "seconds": 600.0, "effort": 10.0}))


def test_required_aps_are_searched_at_the_last_size_alone_and_between_0_and_1(searches, street):
    assert len(searches(Effort((1, 2, 3), min_ap=0.5))) == 6
    found = searches(Effort((1, 2), seconds=9.0, evaluations=300, min_ap=0.5))[6:]
    around = ("0.45", "0.5", "0.55", "0.6")
    assert [name for name, _ in found] == [
        f"{way} for AP {ap}" for ap in around for way in ("swap", "cheapest")
    ]
    (search, scored, size, asked), exact = found[0][1], found[1][1]
    assert (search, size, asked["evaluations"], asked["checkpoint"]) == (
        "swap",
        2,
        100,
        "part 2.0.45",
    )
    assert scored.visibility == "seen"
    assert scored.weights.price == pytest.approx(THRIFT_AP / 13.875)
    rows = np.array([[1, 0, 0, 0], [0, 0, 1, 0]], bool)
    assert scored.scores(rows).ap.tolist() == [0.45, 0.25]  # more than enough gains nothing
    assert exact[:3] == ("cheapest", street.objective, 2)
    demand = {"seed": 7, "seconds": 9.0, "demand": cheapest.Demand(0.45), "effort": 5.0}
    assert exact[3] == demand
    assert searches(Effort((1, 2), min_ap=0.5))[7][1][3] == demand | {"seconds": 600.0}
    names = [name for name, _ in searches(Effort((1, 2), min_ap=0.05))[6:]]
    assert names[:2] == ["swap for AP 0.05", "cheapest for AP 0.05"]  # not for 0
    names = [name for name, _ in searches(Effort((1, 2), min_ap=0.95))[6:]]
    assert names[-2:] == ["swap for AP 0.95", "cheapest for AP 0.95"]  # not for 1


def test_searches_that_bring_nothing_new_are_left_out(searches, street, limits, monkeypatch):
    alike = tuple(replace(mount, price=1.0) for mount in street.candidates.mounts)
    free = replace(street.candidates, mounts=alike, axes=replace(street.candidates.axes, prices=()))
    same = Objective(Setting(candidates=free, fidelity=street.objective.scored_by, scheme="late"))
    monkeypatch.setattr(module_of_entrants, "entropy_objective", lambda objective: None)
    assert [name for name, _ in searches(Effort((2,)), objective=same)] == [
        "exhaustive",
        "greedy",
        "swap",
    ]
    limits(exhaustive, MAX_CANDIDATES=3)
    assert [name for name, _ in searches(Effort((2,)), objective=same)] == ["greedy", "swap"]
    limits(exhaustive, MAX_CANDIDATES=4)
    assert searches(Effort((2,)), objective=same)[0][0] == "exhaustive"


def test_neighbours_are_the_best_for_each_choice_of_mounts(make, limits):
    """One answer of two sensors among four mounts with two headings each: the best for each other
    pair of mounts."""
    objective = make(mounts=4, poses=2, seed=5)
    answer = np.zeros((1, 8), bool)
    answer[0, [0, 2]] = True
    rows, considered = module_of_entrants.choose_neighbours(objective, answer, 3)
    near = neighbours(np.array([0, 2]), 8)[1:]
    near = near[objective.feasible(near)]
    assert considered == len(near)
    best: dict[tuple[int, ...], np.ndarray] = {}
    for i in np.argsort(-objective.scores(near).reward, kind="stable"):
        best.setdefault(tuple(np.flatnonzero(near[i].reshape(4, 2).any(axis=1)).tolist()), near[i])
    assert [row.tolist() for row in rows] == [row.tolist() for row in list(best.values())[:3]]
    limits(module_of_entrants, MAX_SCORED_NEIGHBOURS=4)
    few, fewer = module_of_entrants.choose_neighbours(objective, answer, 3)
    some = neighbours(np.array([0, 2]), 8)[1:5]
    assert fewer == objective.feasible(some).sum()
    assert 1 <= len(few) <= fewer


def test_predictions_of_several_drawings_are_means_and_sets_go_by_their_size(street):
    class Half:
        name = "surrogate"

        def __call__(self, subsets):
            found = street.objective.scored_by(subsets)
            return found._replace(ap=found.ap / 2)

    other = Objective(Setting(candidates=street.candidates, fidelity=Half(), scheme="late"))
    sets = [
        np.array([[1, 1, 0, 0], [0, 0, 1, 0]], bool),
        np.array([[0, 0, 1, 0], [0, 1, 0, 0]], bool),
    ]
    found = [
        Entrants(sets[0], np.zeros(2), (("a",), ()), 5),
        Entrants(sets[1], np.zeros(2), (("b",), ("c",)), 6),
    ]
    joined = join_entrants([street.objective, other], found)
    assert joined.sets.sum(axis=1).tolist() == [1, 1, 2]
    assert joined.searches == (("b",), ("c",), ("a",))
    assert joined.predicted == pytest.approx(0.75 * street.objective.scores(joined.sets).ap)


@pytest.fixture
def answering(monkeypatch):
    """Let the searches of each size answer with these sets, after scoring 7, 5 and 3; note the sizes
    that were searched, and size and number of the searches that ran."""

    def set_answers(answers):
        noted = SimpleNamespace(sizes=[], run=[])

        def answer(size, number):
            noted.run.append((size, number))
            best = SimpleNamespace(subset=answers[size][number])
            return SimpleNamespace(best=best, evaluations=7 - 2 * number)

        def list_searches(objective, size, *_):
            noted.sizes.append(size)
            for number in range(len(answers[size])):
                yield f"search {number}", partial(answer, size, number)

        monkeypatch.setattr(module_of_entrants, "list_searches", list_searches)
        return noted

    return set_answers


def test_all_sets_that_were_scored_are_counted_and_finished_searches_not_run_again(
    street, answering, tmp_path
):
    """At each of two sizes two searches score 7 and 5 sets, and neighbours are scored too."""
    asked = answering({size: [(0,), (1,)] for size in TWO.sizes})
    answers = as_rows([(0,), (1,)], 4)
    near, scored = module_of_entrants.choose_neighbours(street.objective, answers, TWO.neighbours)
    assert scored > 2
    for _ in range(2):
        found = find_entrants(street.objective, TWO, checkpoint=Checkpoint(tmp_path, every=0.0))
        assert found.considered == 2 * (7 + 5 + scored)
        assert found.searches == (("search 0",), ("search 1",), *[()] * (len(found.sets) - 2))
        assert found.sets[:2].tolist() == answers.tolist()
        assert {*map(tuple, found.sets[2:])} == {*map(tuple, near)} - {*map(tuple, answers)}
    assert asked.run == [(1, 0), (1, 1), (2, 0), (2, 1)]


def test_entropy_is_of_the_same_candidates_and_what_they_see(street, seen, small_candidates):
    assert module_of_entrants.entropy_objective(street.objective) is None
    objective = Objective(
        Setting(candidates=small_candidates, fidelity=Coverage(seen), scheme="late"),
        visibility=seen,
    )
    entropy = module_of_entrants.entropy_objective(objective)
    assert entropy is not None
    assert entropy.visibility is seen
    assert (entropy.fidelity, entropy.candidates) == ("perception entropy", small_candidates)
    rows = np.ones((1, len(small_candidates)), np.bool_)
    early = Setting(candidates=small_candidates, fidelity=Coverage(seen, "early"), scheme="early")
    sent = []
    for codec in (PaperCodec(), PaperCodec(bits_per_point=1)):
        of_codec = module_of_entrants.entropy_objective(
            Objective(replace(early, codec=codec), visibility=seen)
        )
        assert of_codec is not None
        sent.append(of_codec.scores(rows).kbit[0])
    assert sent[1] < sent[0] / 10


@pytest.mark.parametrize("count", [3, 6, 7])
def test_half_of_the_neighbours_are_those_that_no_other_beats(
    make, made_visibility, monkeypatch, count
):
    """In reward, perception entropy and coverage at once; the others are the best by reward. The
    front is made up: all, from the last on."""
    seen, candidates, asked = made_visibility(candidates=12), make(mounts=12).candidates, []

    def front(figures):
        asked.append(figures)
        return np.arange(len(figures))[::-1]

    monkeypatch.setattr(exhaustive, "find_front", front)
    setting = Setting(candidates=candidates, fidelity=Coverage(seen, "early"), scheme="early")
    objective = Objective(setting, visibility=seen)
    rows, considered = module_of_entrants.choose_neighbours(objective, as_rows([[0, 1]], 12), count)
    near = neighbours(np.array([0, 1]), 12)[1:]
    near = near[objective.feasible(near)]
    assert considered == len(near)
    near = near[np.argsort(-objective.scores(near).reward, kind="stable")]
    entropy = module_of_entrants.entropy_objective(objective)
    assert entropy is not None
    figures = [
        objective.scores(near).reward,
        entropy.scores(near).ap,
        Coverage(seen, "early")(near).ap,
    ]
    assert asked[0] == pytest.approx(-np.stack(figures, axis=1))
    wanted = [*near[: count - count // 2], *near[::-1][: count // 2]]
    assert [row.tolist() for row in rows] == [row.tolist() for row in wanted]


def test_the_best_neighbours_are_kept_of_many_and_equal_sizes_stay_in_order(make, street, limits):
    objective = make(mounts=8, seed=4)
    limits(module_of_entrants, MAX_FRONT_NEIGHBOURS=2)
    rows, _ = module_of_entrants.choose_neighbours(objective, as_rows([[0, 1]], 8), 9)
    near = neighbours(np.array([0, 1]), 8)[1:]
    near = near[objective.feasible(near)]
    best = near[np.argsort(-objective.scores(near).reward, kind="stable")[:2]]
    assert [row.tolist() for row in rows] == best.tolist()
    singles = np.eye(40, dtype=bool)[np.random.default_rng(0).permutation(40)]
    found = [Entrants(part, np.zeros(20), ((),) * 20, 1) for part in (singles[:20], singles[20:])]
    joined = join_entrants([make(mounts=40), make(mounts=40)], found)
    assert joined.sets.tolist() == singles.tolist()
    pairs = singles[:20] | singles[20:]
    found = [Entrants(part, np.zeros(20), ((),) * 20, 1) for part in (pairs, singles[:20])]
    joined = join_entrants([make(mounts=40), make(mounts=40)], found)
    assert joined.sets.tolist() == [*singles[:20].tolist(), *pairs.tolist()]


def test_sets_that_may_not_be_built_do_not_enter(street, answering):
    poor = street.objective.with_weights(street.objective.weights, most_price=22.0)
    answering({2: [(0, 3), (), (0, 1)]})
    found = find_entrants(poor, Effort((2,), neighbours=0))
    assert found.searches == (("search 2",),)
    assert found.sets.tolist() == [[True, True, False, False]]
    assert found.considered >= 3


def test_where_no_set_of_a_size_was_found_larger_ones_are_not_searched(street, answering):
    asked = answering({1: [(0,)], 2: [(), ()], 3: [(0, 1, 2)]})
    found = find_entrants(street.objective, Effort((1, 2, 3), neighbours=0))
    assert asked.sizes == [1, 2]
    assert found.sets.sum(axis=1).tolist() == [1]


def test_neighbours_of_several_answers_are_ranked_together(make):
    """The poor answer comes first: its neighbours do not go before better ones of the other."""
    objective = make(mounts=7, seed=2)
    every = neighbours(np.array([0, 1]), 7)[1:]
    pairs = every[every.sum(axis=1) == 2]
    by_reward = pairs[np.argsort(objective.scores(pairs).reward, kind="stable")]
    answers = np.stack([by_reward[0], by_reward[-1]])
    rows, considered = module_of_entrants.choose_neighbours(objective, answers, 5)
    near = np.concatenate([neighbours(np.flatnonzero(answer), 7)[1:] for answer in answers])
    near = near[objective.feasible(near)]
    assert considered == len(near)
    rewards = objective.scores(np.unique(near, axis=0)).reward
    assert objective.scores(np.array(rows)).reward == pytest.approx(np.sort(rewards)[::-1][:5])


def test_searches_for_a_required_ap_choose_from_the_same_candidates(searches, street):
    """An objective made from a site has its candidates from the pool, not from the setting."""
    street.objective.setting = replace(street.objective.setting, candidates=None)
    found = dict(searches(Effort((1, 2), seconds=9.0, evaluations=300, min_ap=0.5)))
    assert found["swap for AP 0.5"][1].candidates is street.objective.candidates


def test_entropy_is_of_the_objectives_own_candidates(seen, small_candidates):
    objective = Objective(
        Setting(candidates=small_candidates, fidelity=Coverage(seen), scheme="late"),
        visibility=seen,
    )
    objective.setting = replace(objective.setting, candidates=None)
    entropy = module_of_entrants.entropy_objective(objective)
    assert entropy is not None
    assert entropy.candidates is small_candidates


def test_seeds_are_0_unless_given(street, spy):
    calls, effort = spy(module_of_entrants, "list_searches"), Effort((1,), evaluations=4)
    for seed in ({}, {"seed": 0}, {"seed": 4}):
        find_entrants(street.objective, effort, **seed)
        keep_entrants(street.objective, effort, **seed)
    assert [call.args[3] for call in calls] == [0] * 4 + [4] * 2
