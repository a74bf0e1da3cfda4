"""The best AP of every number of sensors."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from placement_env.analysis.case_figures import CaseFigures
from placement_env.cases import Cases
from placement_env.objective import Objective
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.portfolio import curve
from placement_env.search.portfolio.curve import budget_curve, list_amounts
from placement_env.search.portfolio.entrants import Effort
from placement_env.search.portfolio.evaluators import CasesEvaluator, DetectorEvaluator, race_order
from placement_env.search.portfolio.portfolio import Judging
from placement_env.search.portfolio.reward_race import MAX_SET_FRAMES
from placement_env.search.portfolio.schedule import Schedule
from placement_env.setting import Setting


def test_searches_go_on_where_the_checkpoint_left_them(street, spy, tmp_path):
    calls, kept = spy(curve, "keep_entrants"), Checkpoint(tmp_path)
    effort = Effort((1,), neighbours=0)
    assert len(list(curve.search_budgets(street.objective, effort, (), 7, kept))) == 1
    (call,) = calls
    assert call.named == {"others": {}, "seed": 7, "checkpoint": kept}


def test_each_number_has_its_winner_that_pays(street):
    """Cars: sensors 0 and 1 see two each, 2 one, beside a ghost, 3 one that 0 sees too."""
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    points = budget_curve(street.objective, 3, judging=Judging(evaluators=(evaluator, evaluator)))
    assert [point.sensors for point in points] == [1, 2, 3]
    assert [point.ap for point in points] == pytest.approx([0.5, 0.75, 0.8])
    assert points[1].subset == (0, 1)
    assert points[2].subset == (0, 1, 2)
    assert [point.price for point in points] == pytest.approx([11.0, 22.0, 32.5])
    assert all(np.isnan([point.low, point.high]).all() for point in points)  # two blocks of frames
    assert all(point.pays for point in points)
    assert all(np.isnan(point.confidence) for point in points)  # there are two blocks of frames
    row = street.objective.row(points[2].subset)[None]
    assert points[2].predicted == street.objective.scores(row).ap[0]
    assert "greedy" in points[1].searches
    assert points[1].kbit == pytest.approx(
        street.detected.partial(street.objective.row([0, 1])[None], 8).kbit[0]
    )


def test_a_number_that_finds_less_does_not_pay(street):
    class Worse(CasesEvaluator):
        """Finds half as much with three sensors."""

        def evaluate(self, sets, frames, progress=None):
            found = super().evaluate(sets, frames, progress)
            share = np.where(sets.sum(axis=1) == 3, 0.5, 1.0)
            return CaseFigures(found.values * share[:, None])

    worse = Worse((DetectorEvaluator(street.detected),))
    points = budget_curve(street.objective, 3, judging=Judging(evaluators=(worse, worse)))
    assert [point.pays for point in points] == [True, True, False]


def test_points_have_ap_by_profile_and_nothing_has_no_curve(street):
    class Less(DetectorEvaluator):
        def measure(self, sets, frames, progress=None):
            return super().measure(sets, frames, progress) - 0.25

    exact = DetectorEvaluator(street.detected)
    both = CasesEvaluator((exact, Less(street.detected)), Cases(errors=("paper", "poor")))
    points = budget_curve(street.objective, 2, judging=Judging(evaluators=(both, both)))
    assert [point.ap for point in points] == pytest.approx([0.25, 0.5])
    assert [[(each.name, each.ap) for each in point.by_errors] for point in points] == [
        [("paper", 0.5), ("poor", 0.25)],
        [("paper", 0.75), ("poor", 0.5)],
    ]
    assert [
        point.by_errors
        for point in budget_curve(
            street.objective, 2, judging=Judging(evaluators=(CasesEvaluator((exact,)),) * 2)
        )
    ] == [(), ()]
    poor = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=street.objective.scored_by,
            scheme="late",
            most_price=1.0,
        )
    )
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    assert budget_curve(poor, 2, judging=Judging(evaluators=(evaluator, evaluator))) == ()
    with pytest.raises(ValueError, match="budget must be a whole number"):
        budget_curve(poor, 0, judging=Judging(evaluators=(evaluator, evaluator)))
    with pytest.raises(ValueError, match="needs fresh traffic"):
        budget_curve(street.objective, 1)


def test_amounts_of_money_have_their_winners(street):
    """The sensors cost 11, 11, 10.5 and 23 and see cars 0 and 1, 1 and 2, 3 beside a ghost, and
    0."""
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    assert street.objective.price(np.eye(4, dtype=bool)).tolist() == [11.0, 11.0, 10.5, 23.0]
    amounts = list_amounts(street.objective, 3, 33.0)
    assert amounts == (10.5, 11.0, 21.0, 21.5, 22.0, 23.0, 31.5, 32.0, 32.5, 33.0)
    points = budget_curve(
        street.objective, 3, amounts=amounts, judging=Judging(evaluators=(evaluator, evaluator))
    )
    assert [(point.money, point.price, point.subset) for point in points[-2:]] == [
        (22.0, 22.0, (0, 1)),
        (32.5, 32.5, (0, 1, 2)),
    ]
    assert [point.ap for point in points[-2:]] == pytest.approx([0.75, 0.8])
    assert [point.money for point in points] == sorted({point.money for point in points})
    assert all(point.price <= point.money for point in points)
    assert len({point.subset for point in points}) == len(points)
    assert street.objective.most_price == np.inf


def test_amounts_above_the_largest_price_are_held_to_it(street):
    poor = street.objective.with_weights(street.objective.weights, most_price=22.0)
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    points = budget_curve(
        poor, 4, amounts=(10.0, 50.0), judging=Judging(evaluators=(evaluator, evaluator))
    )
    assert [(point.money, point.subset) for point in points] == [(50.0, (0, 1))]
    assert list_amounts(poor, 1, 100.0) == (10.5, 11.0)


def test_too_many_amounts_are_spread_evenly(street, make):
    assert list_amounts(street.objective, 4, 50.0, 3) == (
        11.0,
        33.0,
        46.0,
    )  # up to 16.7, 33.3 and 50
    many = make(40, 1, seed=3)
    spread = list_amounts(many, 8, 10.0)
    assert len(spread) == 12
    assert np.allclose(spread, np.linspace(0, 10, 13)[1:], atol=0.01)
    assert max(spread) <= 10.0
    with pytest.raises(ValueError, match="budget must be a whole number"):
        list_amounts(many, 0, 10.0)
    assert list_amounts(many, 2, 0.1) == ()


class Mortal(CasesEvaluator):
    lives: list[int]

    def __init__(self, detected, lives):
        super().__init__((DetectorEvaluator(detected),))
        object.__setattr__(self, "lives", [lives])

    def evaluate(self, sets, frames, progress=None):
        self.lives[0] -= 1
        if self.lives[0] < 0:
            raise KeyboardInterrupt
        return super().evaluate(sets, frames, progress)


@pytest.mark.parametrize("amounts", [(), (11.0, 22.0, 33.0)])
def test_killed_again_and_again_it_gives_the_same_curve(street, tmp_path, amounts):
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    whole = budget_curve(
        street.objective, 3, amounts=amounts, judging=Judging(evaluators=(evaluator, evaluator))
    )
    assert len(whole) == 3
    answers: tuple[Any, ...] = ()
    ended = []
    for lives in range(100):
        try:
            mortal = Mortal(street.detected, max(2, lives))
            kept = Checkpoint(tmp_path, every=0.0)
            answers = budget_curve(
                street.objective,
                3,
                amounts=amounts,
                judging=Judging(evaluators=(mortal, evaluator)),
                checkpoint=kept,
            )
            break
        except KeyboardInterrupt:
            ended.append(
                (Checkpoint(tmp_path, part="search.races").load() or {"ended": 0})["ended"]
            )
    assert answers == whole
    assert sorted(ended) == ended
    assert ended[-1] in (1, 2)
    asked = Mortal(street.detected, 0)  # no race is run twice
    again = budget_curve(
        street.objective,
        3,
        amounts=amounts,
        judging=Judging(evaluators=(asked, evaluator)),
        checkpoint=kept,
    )
    assert again == whole


def test_the_states_of_amounts_are_their_own(street):
    names = []

    class Noting(Checkpoint):
        def part(self, name):
            names.append(name)
            return super().part(name)

    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    amounts = (22.0, 22.0000001)
    budget_curve(
        street.objective,
        2,
        amounts=amounts,
        judging=Judging(evaluators=(evaluator, evaluator)),
        checkpoint=Noting(None),
    )
    assert {"22.0", "22.0000001", "races"} <= set(names)


@pytest.mark.parametrize("amounts", [(), (22.0, 33.0)])
def test_searches_get_the_seed_and_the_judge_frames_in_order_or_spread(street, spy, amounts):
    calls = spy(curve, "keep_entrants")

    class Noting(CasesEvaluator):
        def evaluate(self, sets, frames, progress=None):
            judged.append(frames.tolist())
            return super().evaluate(sets, frames, progress)

    raced, judged = CasesEvaluator((DetectorEvaluator(street.detected),)), list[list[int]]()
    final = Noting((DetectorEvaluator(street.detected),))
    for seconds, order in ((None, np.arange(final.frames)), (60.0, race_order(final.frames))):
        judged.clear()
        budget_curve(
            street.objective,
            2,
            amounts=amounts,
            seed=7,
            seconds=seconds,
            judging=Judging(evaluators=(raced, final)),
        )
        assert judged[0] == order[: len(judged[0])].tolist()
    assert race_order(final.frames).tolist() != list(range(final.frames))
    assert {call.named["seed"] for call in calls} == {7}


@pytest.mark.parametrize("wrong", [{"seconds": 0.0}, {"evaluations": 0}])
def test_a_curve_has_limits_that_say_something(street, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        budget_curve(street.objective, 2, **wrong)


class Levelled(CasesEvaluator):
    """Finds `least` with three sensors, and no more than `most` with any number."""

    least, most = 0.0, 1.0

    def evaluate(self, sets, frames, progress=None):
        found = super().evaluate(sets, frames, progress)
        ap = np.minimum(np.where(sets.sum(axis=1) == 3, max(self.least, 0.0), found.ap), self.most)
        resamples = found.resamples - found.ap[:, None] + ap[:, None]
        return CaseFigures.from_ap(ap, found.kbit, resamples, objects=32, frames=len(frames))


def levelled(street, **figures):
    made = Levelled((DetectorEvaluator(street.detected),))
    vars(made).update(figures)
    return Judging(evaluators=(made, made), neighbours=0)


def test_a_winner_stays_where_more_money_finds_nothing_better(street):
    """All three sensors find less than the two for 22 units do, and win no race against them."""
    points = budget_curve(
        street.objective, 3, amounts=(22.0, 32.5), judging=levelled(street, least=0.25)
    )
    assert [(point.money, point.subset) for point in points] == [(22.0, (0, 1))]


def test_only_more_ap_for_more_money_pays(street):
    points = budget_curve(street.objective, 3, judging=levelled(street, least=0.75, most=0.75))
    assert [(point.ap, point.pays) for point in points] == [
        (0.5, True),
        (0.75, True),
        (0.75, False),
    ]
    vars(street.objective)["price"] = lambda rows: np.ones(len(rows))
    points = budget_curve(street.objective, 3, judging=levelled(street, least=0.8))
    assert [(point.ap, point.pays) for point in points] == [
        (0.5, False),
        (0.75, False),
        (0.8, True),
    ]


def test_races_and_searches_share_their_time_and_know_the_seed(street, spy):
    """Of 60 s the searches have three tenths, eight for each number; each race an equal share of
    the rest, with the judgement."""
    races, searches = spy(curve, "contest"), spy(curve, "keep_entrants")
    limits = spy(Schedule, "limit")
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    asked = {
        "seed": 7,
        "judging": Judging(evaluators=(evaluator, evaluator), confidence=0.6, neighbours=3),
    }
    budget_curve(street.objective, 2, seconds=60.0, evaluations=500, **asked)
    assert [call.args[1] for call in searches] == [Effort((1, 2), 60 * 0.3 / (8 * 2), 500, 3)]
    rules = {"seed": 7, "confidence": 0.6, "max_set_frames": np.inf}
    assert [rules.items() <= call.named.items() for call in races] == [True] * 2
    shares = [call.named for call in limits]
    assert shares == [{"share": 1 / 3, "min_frames": 1}, {"share": 1 / 2, "min_frames": 1}, {}]
    budget_curve(street.objective, 3, amounts=(11.0, 22.0), seconds=60.0, **asked)
    efforts = [call.args[1] for call in searches[1:]]
    assert efforts == [Effort((3,), 60 * 0.3 / (8 * 2), None, 3)] * 2
    budget_curve(street.objective, 1, **asked)
    assert (searches[-1].args[1].seconds, races[-1].named["max_set_frames"]) == (
        None,
        MAX_SET_FRAMES,
    )
    budget_curve(street.objective, 1, judging=asked["judging"])
    assert races[-1].named["seed"] == 0


def test_amounts_are_prices_of_sets_each_once(street):
    assert len(list_amounts(street.objective, 3, 33.0, 10)) == 10  # as many as there are
    assert list_amounts(street.objective, 4, 42.8, 4) == (10.5, 21.0, 32.0, 42.5)
    assert list_amounts(street.objective, 2, 0.0) == ()
    double = replace(
        street.candidates,
        mounts=tuple(replace(mount, max_sensors=2) for mount in street.candidates.mounts),
    )
    both = Objective(Setting(candidates=double, fidelity=street.objective.scored_by, scheme="late"))
    assert 21.0 in list_amounts(both, 2, 21.0)  # a second sensor on the same pole costs 10
    assert max(list_amounts(both, 2, 20.9)) == 20.5
    prices = (0.1, 0.2, 0.3, 5.0)
    mounts = tuple(
        replace(m, price=p) for m, p in zip(street.candidates.mounts, prices, strict=True)
    )
    cheap = replace(
        street.candidates, mounts=mounts, axes=replace(street.candidates.axes, prices=())
    )
    tenths = Objective(
        Setting(candidates=cheap, fidelity=street.objective.scored_by, scheme="late")
    )
    assert list_amounts(tenths, 3, 0.6) == pytest.approx(
        (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    )  # 0.1 + 0.2 is 0.3


def test_the_winner_of_the_amount_before_stays_however_many_there_are(street):
    """All three sensors find less than two, which only the winner of 22 units brings into the race
    for 32.5."""
    asked = levelled(street, least=0.25)
    points = budget_curve(street.objective, 3, amounts=(32.5, 11.0, 22.0), judging=asked)
    assert [(point.money, len(point.subset)) for point in points] == [(11.0, 1), (22.0, 2)]
    assert points[1].subset == (0, 1)


def test_fewer_sensors_than_poles_that_must_carry_one_are_refused(street):
    setting = replace(street.objective.setting, keep=("post1", "post2"))
    with pytest.raises(ValueError, match="2 poles must carry a sensor"):
        budget_curve(Objective(setting), 1, judging=levelled(street))


def test_an_amount_that_is_the_price_of_a_set_to_the_cent_is_taken(street):
    assert list_amounts(street.objective, 3, 33.0, 3) == (11.0, 33 * 2 / 3, 33.0)
    assert (
        list_amounts(street.objective, 3, 33.0, 8)[0] == 11.0
    )  # no set costs a fourth or an eighth of 33


def test_many_sums_are_held_coarsely(street, limits):
    """Of prices 10.5, 11 and 23, and nothing, those that lie in the same half of 24 count once, the
    dearest."""
    limits(curve, MAX_SUMS=4)
    assert list_amounts(street.objective, 1, 24.0) == (
        10.5,
        11.0,
        23.0,
    )  # four with nothing: all are held
    limits(curve, MAX_SUMS=2)
    assert list_amounts(street.objective, 1, 24.0) == (11.0, 23.0)
