"""A portfolio: searches that are deceived, a race that is not, and an AP that neither has seen."""

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from placement_env.analysis.case_figures import CaseFigures
from placement_env.analysis.intervals import AP_TOLERANCE, MIN_SURE_FRAMES, figure_interval
from placement_env.cases import Cases
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.racing import Contest, RaceRules
from placement_env.search.portfolio import portfolio, reward_race
from placement_env.search.portfolio.entrants import Effort, Entrants
from placement_env.search.portfolio.evaluators import CasesEvaluator, DetectorEvaluator, race_order
from placement_env.search.portfolio.portfolio import Judging
from placement_env.search.portfolio.schedule import Schedule
from placement_env.setting import Setting, Weights
from toolkit.runtime.run import Run

VALUE = np.array([0.10, 0.30, 0.25, 0.20])  # of each sensor of the street, in truth


class Truth:
    """AP of a set: the sum of its sensors' values, in frames with noise."""

    name, by_profile, cases, max_blocks = "detector", ("itself",), Cases(), np.inf

    def __init__(self, frames=48, shift=0.0, noise=0.01, seconds=0.0):
        self.frames, self.shift, self.noise, self.asked = frames, shift, noise, []
        self.seconds, self.known = seconds, set()

    def count_objects(self, frames):
        return 7 * len(frames)

    def evaluate(self, sets, frames, progress=None):
        self.asked.append((sets.copy(), len(frames)))
        new = {(row.tobytes(), k) for row in sets for k in frames.tolist()} - self.known
        time.sleep(self.seconds * len(new))  # what was detected once is kept
        self.known |= new
        ap = sets @ VALUE + self.shift
        draws = np.random.default_rng(4).standard_normal(500) * self.noise / np.sqrt(len(frames))
        if progress is not None:
            progress(len(frames))
        return CaseFigures.from_ap(
            ap,
            100.0 * sets.sum(axis=1),
            ap[:, None] + np.outer(np.arange(len(sets)), draws),
            objects=self.count_objects(frames),
            frames=len(frames),
        )

    def interval(self, figures, frames):
        return figure_interval(float(figures.ap), figures.resamples, blocks=len(frames) / 4)

    def mean_ap(self, sets, frames):
        return sets @ VALUE

    def measure(self, sets, frames, progress=None):
        return self.evaluate(sets, frames, progress).values


class Deceived:
    """Takes the first sensor for the best."""

    name = "surrogate"

    def __call__(self, subsets):
        ap = subsets @ np.array([0.5, 0.2, 0.15, 0.1])
        return Estimate(ap, ap.copy(), 100.0 * subsets.sum(axis=1))


@pytest.fixture
def deceived(street):
    return Objective(Setting(candidates=street.candidates, fidelity=Deceived(), scheme="late"))


@pytest.fixture
def decided(street):
    """A search that was deceived, its evaluators and the stages that were told."""
    stages = []
    run = Run(progress=lambda *stage: stages.append(stage))
    setting = Setting(candidates=street.candidates, fidelity=Deceived(), scheme="late")
    race, final = Truth(), Truth(frames=80, shift=-0.05)
    judging = Judging(evaluators=(race, final), confidence=0.9, contenders=True)
    found = portfolio.search(Objective(setting, run), 2, judging=judging)
    return SimpleNamespace(found=found, race=race, final=final, stages=stages)


def test_the_winner_is_the_best_by_the_race_and_its_ap_is_from_the_third_part(decided):
    found = decided.found
    said = found.assessment
    assert (found.method, found.best.subset) == (
        "portfolio",
        (1, 2),
    )  # a neighbour of what all searches answered
    assert (said.by, said.frames, said.objects) == ("detector", 80, 560)
    assert said.ap == pytest.approx(0.55 - 0.05)
    assert said.low <= said.ap <= said.high
    assert said.kbit == pytest.approx(200.0)
    assert said.predicted == pytest.approx(0.35)
    assert said.curse == pytest.approx(0.35 - 0.5)
    assert said.expected == pytest.approx(0.55, abs=0.001)
    assert said.confidence >= said.asked == 0.9


def test_races_and_entrants_are_counted(decided):
    said, race = decided.found.assessment, decided.race
    assert said.entrants == len(race.asked[0][0])
    assert said.raced == race.asked[-1][1] == 24


def test_the_best_of_the_searches_is_judged_beside_the_winner(decided, deceived):
    said, race, final = decided.found.assessment, decided.race, decided.final
    (own,) = said.contenders
    assert own.searches == ("exhaustive", "greedy", "swap", "thrifty swap")
    assert own.subset == (0, 1)
    assert (own.predicted, own.ap, own.curse) == pytest.approx((0.7, 0.35, 0.35))
    assert [len(sets) for sets, _ in final.asked] == [2]
    unasked = Truth(frames=80)
    alone = portfolio.search(deceived, 2, judging=Judging(evaluators=(race, unasked))).assessment
    assert (alone.contenders, [len(sets) for sets, _ in unasked.asked]) == ((), [1])


def test_stages_and_certificate_are_of_searches_race_and_judgement(decided):
    found, stages = decided.found, decided.stages
    said = found.assessment
    assert {stage[0] for stage in stages} == {
        "sets scored",
        "searches",
        "frames raced",
        "frames judged",
    }
    assert found.certificate.note == (
        f"the best of {said.entrants} sets compared by the detector; an estimate ruled out the "
        "others"
    )


class Rough(Truth):
    """The same where the third sensor is the worst."""

    def evaluate(self, sets, frames, progress=None):
        found = super().evaluate(sets, frames, progress)
        less = 0.2 * sets[:, 2]
        return CaseFigures.from_ap(
            found.ap - less, found.kbit, found.resamples - less[:, None], frames=len(frames)
        )


def test_profiles_are_judged_and_what_does_not_fit_refused(deceived):
    """With exact sensors 1 and 2 are the best two; with the others 1 and 3."""
    errors = Cases(errors=("paper", "poor"))
    race, final = (
        CasesEvaluator((Truth(shift=shift), Rough(shift=shift)), errors) for shift in (0.0, -0.05)
    )
    found = portfolio.search(deceived, 2, judging=Judging(evaluators=(race, final)))
    assert found.best.subset == (1, 3)
    said = found.assessment
    assert (said.ap, said.errors_by) == (pytest.approx(0.45), "worst")
    assert [(each.name, each.ap) for each in said.by_errors] == [
        ("paper", pytest.approx(0.45)),
        ("poor", said.ap),
    ]
    final = CasesEvaluator(
        (Truth(shift=0.1), Rough(shift=-0.1)), Cases(errors=("paper", "poor"), errors_by="mean")
    )
    said = portfolio.search(deceived, 2, judging=Judging(evaluators=(race, final))).assessment
    assert (said.ap, said.errors_by) == (pytest.approx(0.5), "mean")
    assert [each.ap for each in said.by_errors] == pytest.approx([0.6, 0.4])
    assert all(each.low <= each.ap <= each.high for each in said.by_errors)
    alone = portfolio.search(deceived, 2, judging=Judging(evaluators=(Truth(), Truth()))).assessment
    assert (alone.by_errors, alone.errors_by) == ((), "")
    with pytest.raises(ValueError, match="a portfolio needs fresh traffic"):
        portfolio.search(deceived, 2)
    for confidence in (0.0, 1.0):
        with pytest.raises(
            ValueError, match=f"confidence must lie between 0 and 1, got {confidence}"
        ):
            Judging(confidence=confidence)
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        portfolio.search(deceived, 0, judging=Judging(evaluators=(Truth(), Truth())))


def test_what_sets_cost_counts_and_nothing_may_pay(street):
    poor = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=Deceived(),
            scheme="late",
            weights=Weights(price=0.01),
        )
    )
    ran = reward_race.contest(poor, np.eye(4, dtype=bool), Truth())
    prices = poor.price(np.eye(4, dtype=bool))
    assert ran.ranking[0] == (VALUE - 0.01 * prices).argmax()
    assert ran.figures[0] == pytest.approx((VALUE - 0.01 * prices).max())
    linked = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=Deceived(),
            scheme="late",
            weights=Weights(comm=0.001),
        )
    )
    sets = np.array([[0, 1, 1, 0], [0, 0, 0, 0]], bool)
    assert reward_race.weigh_costs(linked, sets, np.array([400.0, 0.0])) == pytest.approx(
        [0.2, 0.0]
    )
    costly = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=Deceived(),
            scheme="late",
            weights=Weights(price=1.0),
        )
    )
    found = portfolio.search(costly, 2, judging=Judging(evaluators=(Truth(), Truth())))
    assert (found.best.subset, found.assessment) == ((), None)
    poor = Objective(
        Setting(candidates=street.candidates, fidelity=Deceived(), scheme="late", most_price=1.0)
    )
    assert (
        portfolio.search(poor, 2, judging=Judging(evaluators=(Truth(), Truth()))).best.subset == ()
    )
    barely = Objective(
        Setting(
            candidates=street.candidates,
            fidelity=Deceived(),
            scheme="late",
            weights=Weights(price=0.01),
        )
    )
    said = portfolio.search(barely, 1, judging=Judging(evaluators=(Truth(), Truth()))).assessment
    assert said.expected == pytest.approx(
        said.ap, abs=0.001
    )  # an AP, with the price that the race took off
    worse = Truth(shift=-1.0)
    lost = portfolio.search(barely, 1, judging=Judging(evaluators=(worse, worse)))
    assert (lost.best.subset, lost.assessment) == ((), None)
    assert "none of the" in lost.certificate.note


@pytest.fixture
def end_contests(monkeypatch):
    """Let every contest end with the figures that a function gives for so many sets."""

    def set_figures(figures_of):
        def contest(objective, sets, *_, **__):
            count, figures = len(sets), figures_of(len(sets))
            return Contest(np.arange(count), figures, np.full(count, 24), 1.0, 1, figures)

        monkeypatch.setattr(portfolio, "contest", contest)

    return set_figures


@pytest.fixture
def end_races(monkeypatch):
    """Let races end one after another with these results, and return the arguments of each."""

    def set_results(*results):
        asked, remaining = [], iter(results)

        def race_until(rewards, sets, order, rules, *, predicted):
            asked.append(SimpleNamespace(rewards=rewards, order=order))
            return next(remaining)

        monkeypatch.setattr(reward_race, "race_until", race_until)
        return asked

    return set_results


def test_sets_race_by_ap_less_costs_in_the_order_of_a_seed(street, spy):
    races = spy(reward_race, "race_until")
    weights = Weights(comm=0.001, price=0.01)
    both = Objective(
        Setting(candidates=street.candidates, fidelity=Deceived(), scheme="late", weights=weights)
    )
    sets, frames = np.array([[0, 1, 1, 0], [1, 0, 0, 0]], bool), np.array([9, 3, 0, 11, 8])
    reward_race.contest(both, sets, Truth(frames=20), confidence=0.9, seed=3, max_set_frames=700.0)
    ((rewards, _, order, rules), named) = races.pop()
    assert order.tolist() == race_order(20, seed=3).tolist() != race_order(20).tolist()
    assert rules == RaceRules(0.9, 0.01, 12, 2, least=24, kept=0.5, most=700.0, most_behind=200.0)
    cost = [0.1 + 0.01 * 21.5, 0.1 + 0.01 * 11.0]  # of 100 kbit per sensor, and of the sensors
    assert named["predicted"] == pytest.approx([0.35 - cost[0], 0.5 - cost[1]])
    found = rewards(sets, frames)
    assert found.figure == pytest.approx([0.55 - cost[0], 0.1 - cost[1]])
    assert found.resamples.mean(axis=1) == pytest.approx(found.figure, abs=1e-3)
    assert (found.frames, found.blocks) == (None, 2.0)
    reward_race.contest(both, sets, Truth(frames=7))
    ((_, _, order, rules), _) = races.pop()
    assert rules.first == 7
    assert order.tolist() == race_order(7, seed=0).tolist()


def test_race_and_judgement_have_parts_and_seeds_of_their_own(street, monkeypatch):
    made = []

    def built(preparation, *given, **named):
        made.append(
            ((preparation.setting, preparation.run, preparation.compares_sets), *given, named)
        )
        return len(made)

    monkeypatch.setattr(portfolio, "build_evaluator", built)
    setting = Setting(candidates=street.candidates, fidelity=Deceived(), scheme="late")
    objective = Objective(setting, Run(seed=4, frames=5))
    judging = Judging(by="coverage", race_frames=33, final_frames=44, setting=setting)
    found: Any = judging.build_evaluators(objective, Schedule(60.0), seed=7)
    assert found == (1, 2)
    assert [(run.seed, run.frames) for (_, run, _), *_ in made] == [
        (1000007, 16),
        (2000010, 20),
    ]  # half, in whole blocks
    assert [compares for (_, _, compares), *_ in made] == [True, False]  # the race alone
    assert [(own, *rest) for (own, *_), *rest in made] == [
        (setting, "coverage", {"seed": 7}),
        (setting, "coverage", {"seed": 7, "tie": 0.0}),  # what is stated is AP alone
    ]
    made.clear()
    judging.build_evaluators(objective, Schedule())
    assert [(run.frames, named) for (_, run, _), _, named in made] == [
        (33, {"seed": 0}),
        (44, {"seed": 0, "tie": 0.0}),
    ]
    assert (Judging().race_frames, Judging().final_frames) == (96, 120)


def test_with_failures_what_is_best_intact_races_too(street, monkeypatch):
    """Searches over failures know of 0 and 2 alone, intact of 1 and 2."""
    asked = []
    sets = {False: np.array([[1, 0, 1, 0]], bool), True: np.array([[0, 1, 1, 0]], bool)}

    def kept(objective, effort, *, seed, checkpoint, others=None):
        intact = not objective.setting.cases.failing
        asked.append((intact, effort, seed, checkpoint))
        return Entrants(sets[intact], objective.scores(sets[intact]).ap, (("greedy",),), 10)

    setting = Setting(
        candidates=street.candidates, fidelity=Deceived(), scheme="late", cases=Cases(failing=1)
    )
    objective = Objective(setting, Run(seed=4))
    plain = replace(setting, cases=Cases(), candidates=None)
    prepared: Any = SimpleNamespace(
        intact_preparation=SimpleNamespace(setting=plain), run=objective.run, setting=setting
    )
    objective.preparation = prepared
    vars(objective)["describe_origin"] = lambda subset: {}
    monkeypatch.setattr(portfolio, "keep_entrants", kept)
    judging = Judging(evaluators=(Truth(), Truth()), neighbours=3)
    found = portfolio.search(objective, 2, seed=7, seconds=60.0, evaluations=90, judging=judging)
    assert found.best.subset == (1, 2)
    assert found.evaluations == 20
    effort = Effort((2,), 60 * 0.3 / 8, 90, 3)
    assert [each[:3] for each in asked] == [(False, effort, 7), (True, effort, 7)]


def test_near_the_first_the_mean_over_thresholds_decides_and_then_the_price(street, end_races):
    """Sets 0 to 3 end at 0.9, 0.895, 0.892 and 0.9 on fewer frames; the second and the third lie
    within 0.0075 or without."""
    figures, means = [0.9, 0.895, 0.892, 0.9], {0: 0.5, 1: 0.6, 2: 0.9, 3: 0.9}
    ended = Contest(
        np.arange(4), np.array(figures), np.array([8, 8, 8, 4]), 0.9, 28, np.array(figures)
    )
    asked = []

    def mean_ap(sets, frames):
        asked.append((sets.argmax(axis=1).tolist(), len(frames)))
        return np.array([means[int(k)] for k in sets.argmax(axis=1)])

    end_races(ended, ended)
    truth = Truth(frames=20)
    vars(truth)["mean_ap"] = mean_ap
    objective = Objective(Setting(candidates=street.candidates, fidelity=Deceived(), scheme="late"))
    ran = reward_race.contest(objective, np.eye(4, dtype=bool), truth)
    assert asked == [([0, 1], 8)]
    assert ran.ranking.tolist() == [1, 0, 2, 3]
    assert ran.expected.tolist() == ran.figures.tolist() == [0.895, 0.9, 0.892, 0.9]
    means.update({0: 0.7, 1: 0.7})
    dear = objective.price(np.eye(4, dtype=bool)) + np.array([1.0, 0, 0, 0])
    vars(objective)["price"] = lambda rows: dear[rows.argmax(axis=1)]
    assert reward_race.contest(objective, np.eye(4, dtype=bool), truth).ranking.tolist() == [
        1,
        0,
        2,
        3,
    ]


def test_seconds_bound_race_and_judgement_on_the_same_frames(deceived):
    race, final = Truth(noise=50.0, seconds=0.03), Truth(frames=60, seconds=0.03)  # 11 s in all
    judging = Judging(evaluators=(race, final), contenders=True)
    found = portfolio.search(deceived, 2, judging=judging, seconds=1.0)
    said = found.assessment
    assert said.raced < MIN_SURE_FRAMES
    assert np.isnan(said.confidence)
    assert 8 <= said.frames < 60  # of the winner, whose judgement ended with the time
    assert said.objects == 7 * said.frames
    assert found.best.subset == (0, 1)  # after so noisy a race it is the objective that ranks
    assert [each.subset for each in said.contenders] == [(0, 1)]
    assert said.ap == pytest.approx(VALUE[list(found.best.subset)].sum())


def test_enough_seconds_judge_all_frames(deceived):
    race, final = Truth(noise=0.0), Truth(frames=60)
    judging = Judging(evaluators=(race, final), contenders=True)
    found = portfolio.search(deceived, 2, judging=judging, seconds=20.0)
    assert found.assessment.frames == 60
    assert found.assessment.confidence > 0.99
    (own,) = found.assessment.contenders
    assert (own.subset, own.ap) == ((0, 1), pytest.approx(0.4))


def test_a_race_with_a_time_may_take_all_of_it(deceived, spy):
    limits, contests = spy(Schedule, "limit"), spy(portfolio, "contest")
    for seconds in (None, 60.0):
        portfolio.search(
            deceived, 2, judging=Judging(evaluators=(Truth(), Truth())), seconds=seconds
        )
    assert [call.named["max_set_frames"] for call in contests] == [
        reward_race.MAX_SET_FRAMES,
        np.inf,
    ]
    # races take half of the time, each judgement what is left
    shares = [call.named for call in limits]
    assert shares == [{"share": 0.5, "min_frames": 1}] * 2 + [{}] * (len(shares) - 2)


def test_it_detects_on_a_real_evaluator(street):
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected),))
    found = portfolio.search(
        street.objective, 3, judging=Judging(evaluators=(evaluator, evaluator))
    )
    ap = street.detected.partial(street.objective.row(found.best.subset)[None], 8).ap[0]
    assert found.assessment.ap == pytest.approx(ap)
    assert found.assessment.ap == pytest.approx(0.8)


def test_the_parts_of_traffic_differ_and_the_same_again_is_the_same(tmp_path):
    objective = Objective(Setting("tjunction", fidelity="coverage"), Run(frames=2, cache=tmp_path))
    judging = Judging(by="coverage", race_frames=3, final_frames=2)
    first, again = (portfolio.search(objective, 2, seed=1, judging=judging) for _ in range(2))
    assert first.assessment == again.assessment
    assert (first.assessment.by, first.assessment.frames) == ("coverage", 2)
    fresh = Objective(Setting("tjunction", fidelity="coverage"), objective.run.part(2))
    assert first.assessment.ap == pytest.approx(fresh.score(first.best.subset).ap)


@pytest.mark.parametrize(("seconds", "most"), [(None, reward_race.MAX_SET_FRAMES), (60.0, np.inf)])
def test_the_race_has_the_rules_that_are_asked(seconds, most, deceived, spy):
    races = spy(reward_race, "race_until")
    judging = Judging(evaluators=(Truth(), Truth()), confidence=0.6)
    portfolio.search(deceived, 2, seed=5, seconds=seconds, judging=judging)
    (((_, _, order, rules), _),) = races
    assert (rules.confidence, rules.tolerance, rules.most) == (0.6, AP_TOLERANCE, most)
    assert order.tolist() == race_order(48, seed=5).tolist()


def test_seeds_are_0_unless_given(deceived, spy):
    stages = [spy(portfolio, name) for name in ("contest", "keep_entrants")]
    portfolio.search(deceived, 2, judging=Judging(evaluators=(Truth(), Truth())))
    portfolio.search(deceived, 2, seed=3, judging=Judging(evaluators=(Truth(), Truth())))
    assert [[call.named["seed"] for call in calls] for calls in stages] == [[0, 3]] * 2


def test_a_set_that_is_worth_just_its_price_is_not_built(street, end_contests):
    end_contests(np.zeros)
    judging = Judging(evaluators=(Truth(), Truth()))
    for weights, built in (
        (Weights(price=0.001), False),
        (Weights(comm=1e-5), False),
        (Weights(), True),
    ):
        setting = Setting(
            candidates=street.candidates, fidelity=Deceived(), scheme="late", weights=weights
        )
        assert bool(portfolio.search(Objective(setting), 1, judging=judging).best.subset) is built


@pytest.mark.parametrize("budget", [-1, 1.5])
def test_budgets_that_are_no_number_of_sensors_are_refused(street, budget):
    with pytest.raises(ValueError, match="budget must be a whole number"):
        portfolio.search(street.objective, budget, judging=Judging(evaluators=(Truth(), Truth())))


def test_fewer_sensors_than_poles_that_must_carry_one_are_refused(deceived):
    kept = Objective(replace(deceived.setting, keep=("post1", "post2")))
    with pytest.raises(ValueError, match="2 poles must carry a sensor"):
        portfolio.search(kept, 1, judging=Judging(evaluators=(Truth(), Truth())))


def test_poles_that_must_carry_a_sensor_do_so_whatever_it_is_worth(deceived):
    kept = Objective(replace(deceived.setting, keep=("post1",), weights=Weights(price=1.0)))
    found = portfolio.search(kept, 1, judging=Judging(evaluators=(Truth(), Truth())))
    assert found.best.subset == (1,)


def test_an_answer_says_what_was_scored_and_of_which_sensors(deceived):
    found = portfolio.search(deceived, 2, judging=Judging(evaluators=(Truth(), Truth())))
    assert found.origin["sensors"] == ["post1_eye", "post2_eye"]
    history, scored = found.history, found.evaluations
    assert scored > 10
    assert history.evaluations.tolist() == [scored, scored]
    assert history.reward.tolist() == [found.best.reward] * 2


def test_only_the_first_must_be_worth_what_it_costs(street, end_contests):
    end_contests(lambda count: np.r_[0.1, np.full(count - 1, -0.1)])
    weighed = replace(street.objective.setting, fidelity=Deceived(), weights=Weights(price=0.001))
    assert portfolio.search(
        Objective(weighed), 1, judging=Judging(evaluators=(Truth(), Truth()))
    ).best.subset


def test_whoever_watches_is_told_the_leader_of_the_race_with_its_costs(street, end_races):
    """Sensors 1 and 2 lead on the three frames for which there was time; their price is 21.5."""
    told, figures = [], np.array([0.5, 0.4])
    races = end_races(
        Contest(np.array([0, 1]), np.array([0.9, 0.8]), np.array([7, 7]), 1.0, 14, figures)
    )

    class Cut(Truth):
        def evaluate(self, sets, frames, progress=None):
            return replace(super().evaluate(sets, frames, progress), used=3)

    weighed = replace(street.objective.setting, fidelity=Deceived(), weights=Weights(price=0.01))
    objective = Objective(weighed)
    sets = np.array([[1, 0, 0, 0], [0, 1, 1, 0], [0, 0, 1, 0]], bool)
    reward_race.contest(objective, sets, Cut(frames=20), seed=3, frames=5)
    (race,) = races
    assert race.order.tolist() == race_order(20, seed=3)[:5].tolist()
    race.rewards(sets, race.order)
    objective.watch = lambda *better: told.append(better)
    found = race.rewards(sets, np.array([9, 3, 0, 21, 33]))
    assert told == [((1, 2), pytest.approx(0.55 - 0.215), 3)]
    assert (found.frames, found.blocks) == (
        3,
        2.0,
    )  # 9 lies in the third block, 3 and 0 in the first


def test_sets_that_lie_just_as_near_as_may_be_are_compared_and_one_alone_is_not(
    deceived, end_races
):
    figures, asked = [0.0, -reward_race.NEAR_TIE_AP], []

    def mean_ap(sets, frames):
        asked.append(sets.argmax(axis=1).tolist())
        return np.arange(len(sets), dtype=float)

    end_races(
        *(
            Contest(
                np.arange(2), np.array(figures), np.array([8, k]), 0.9, 8 + k, np.array(figures)
            )
            for k in (8, 4)
        )
    )
    truth = Truth(frames=20)
    vars(truth)["mean_ap"] = mean_ap
    rows = np.eye(4, dtype=bool)[:2]
    assert reward_race.contest(deceived, rows, truth).ranking.tolist() == [1, 0]
    assert asked == [[0, 1]]
    assert reward_race.contest(deceived, rows, truth).ranking.tolist() == [0, 1]
    assert asked == [[0, 1]]  # detections take time


class Clock:
    """A schedule with so much time left when it is asked, and evaluators that do so many frames,
    None for all."""

    seconds = 1.0

    def __init__(self, left, frames):
        self.lefts, self.counts, self.judged = iter(left), iter(frames), []

    @property
    def remaining_s(self):
        return next(self.lefts)

    def limit(self, evaluator):
        def evaluate(sets, frames, report=None):
            self.judged.append((sets.argmax(axis=1).tolist(), len(frames)))
            nothing = np.zeros((len(sets), 1))
            figures = CaseFigures.from_ap(nothing[:, 0], 0.0, nothing)
            return replace(figures, used=next(self.counts))

        return SimpleNamespace(evaluate=evaluate)


@pytest.mark.parametrize(
    ("left", "frames", "asked"),
    [
        ([1.0, 1.0, 1.0], [None, None, None, None], [0, 1, 2, 3]),
        ([1.0, 0.0], [None, None], [0, 1]),  # no time is left for the third
        ([1.0, 1.0], [None, None, 5], [0, 1, 2]),  # the third ran out of it
        ([-1.0], [16], [0]),
        ([1.0, -1.0], [16, None], [0, 1]),
    ],
)
def test_sets_are_judged_one_after_another_while_time_is_left(left, frames, asked):
    clock, final = Clock(left, frames), Truth(frames=40)
    judged, used = portfolio.judge_in_time(np.eye(4, dtype=bool), final, clock, None)  # type: ignore[arg-type]
    count = 40 if frames[0] is None else frames[0]
    assert clock.judged == [([asked[0]], 40), *(([n], count) for n in asked[1:])]
    assert used.tolist() == race_order(40)[:count].tolist()
    done = len(asked) - (frames[-1] == 5)
    assert judged.ap.tolist() == VALUE[:done].tolist()
