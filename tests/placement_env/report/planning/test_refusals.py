"""Why nothing may be built, with the figures that exclude."""

from dataclasses import replace

import numpy as np

from placement_env.objective import Objective
from placement_env.report.content import Judgement, PlanOption
from placement_env.report.planning.question import Question
from placement_env.report.planning.refusals import (
    buildable,
    short_of,
    without_objects,
    without_traffic,
)
from placement_env.search.description import describe_exclusions
from placement_env.setting import Setting


def test_nothing_is_excluded(street):
    assert describe_exclusions(street.objective) == ()
    assert buildable(street.objective, None).all()


def test_links_kbit_and_money(street):
    mounts = tuple(replace(mount, capacity=250.0) for mount in street.candidates.mounts)
    poor = Objective(
        Setting(
            candidates=replace(street.candidates, mounts=mounts),
            fidelity=street.objective.scored_by,
            scheme="early",
            most_price=10.8,
        )
    )
    links, kbit, money = describe_exclusions(poor, 150.0, "EUR")
    assert links.startswith("The links exclude 2 of 4 candidates: the least that any of these sends is 300.0 kbit")
    assert "over a link of 250 kbit" in links
    assert kbit.startswith("The limit of 150 kbit per sensor and frame excludes 3 of 4 candidates")
    assert kbit.endswith("the least that any candidate sends is 100.0 kbit.")
    assert money == "The sum of 10.8 EUR excludes 3 of 4 candidates: the cheapest of all costs 10.5 EUR."
    assert buildable(poor, 150.0).tolist() == [False, False, True, False]
    assert buildable(poor, 50.0).tolist() == [False] * 4


def test_budget_and_network(street):
    assert "budget is 0 sensors" in without_traffic(Question(site=street.site, sensors=0))[0]
    (reason,) = without_traffic(Question(site=street.site))
    assert "has no road network" in reason
    question = Question(site=street.site)
    assert without_objects(question, ["vehicle"], 1, "simulated") == (
        "No vehicle comes into the detection area of site 'street' in 1 frame of simulated traffic: say more --frames, "
        "another --seed, or a larger area.",
    )
    assert without_objects(question, ["cyclist", "heavy"], 3, "judging")[0].startswith("No cyclist and no heavy comes")


def test_short_of_the_requirement(street):
    said = Judgement(0.8, 0.7, 0.9, 0.8, 1.0, 50, 20)
    best = PlanOption(("a", "b"), 5500.0, 1.0, 2.0, 0.9, replace(said, ap=0.85))
    question = Question(site=street.site, sensors=2, money=6000.0, min_ap=0.95)
    first, number, left, excluded = short_of(question, best, said, ("The links exclude all.",))
    assert "2 sensors" in first
    assert "AP 0.800 (0.700 to 0.900) on 50 vehicles in the final traffic and 0.850 in the traffic it was" in first
    assert "0.95 is required" in first
    assert "The budget of 2 sensors is used up" in number
    assert "it leaves the price of 500 ordinary poles" in left
    assert excluded == "The links exclude all."
    assert len(short_of(replace(question, sensors=9, money=None), best, said, ())) == 1
    assert np.isfinite(said.ap)
