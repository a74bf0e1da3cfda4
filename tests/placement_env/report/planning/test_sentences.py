"""What a plan says in sentences, with its figures."""

import math
from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.classes import Classes
from placement_env.report.content import (
    FailureCase,
    Judgement,
    Plan,
    PlanOption,
    SchemeFigures,
    Verdict,
)
from placement_env.report.planning import refusals, sentences
from placement_env.report.planning.question import Stock
from toolkit.detection.link.range_images import RangeImages
from toolkit.runtime.run import Run
from toolkit.sites.site import Mount, Relief, Site, Solid

SITE = Site("street", np.array([-20.0, -20, 20, 20]))
FINAL = Judgement(0.91, 0.85, 0.95, 0.92, 0.9, 812, 120)
OPTION = PlanOption(("a", "b"), 2.0, 500.0, 1000.0, 0.93, FINAL, ("greedy", "swap"))
EVERY = ("vehicle", "cyclist", "pedestrian", "heavy")


def explain(question, considered=9, near=(), schemes=(), failures=()):
    plan = Plan(
        {},
        "street",
        "Reader",
        0.7,
        "early",
        "",
        Verdict(None, ""),
        OPTION,
        considered=(OPTION,),
        near_optimal=near,
        schemes=schemes,
        failures=failures,
    )
    return sentences.explain_choice(
        question, plan, OPTION, "best", considered=considered, fidelity="surrogate"
    )


def assume(question, fidelity="surrogate", sampled=False, frames=80):
    assumptions = sentences.list_assumptions(
        question, fidelity, "Reader", frames=frames, sampled=sampled
    )
    return " ".join(assumptions)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        *(({}, ""), ({"levels": 3}, ", at the worst of 3 levels of traffic,")),
        (
            {"levels": 2, "levels_by": "mean", "failing": 1},
            (
                ", what is left in the worst case when 1 sensor fails, averaged over 2 levels of "
                "traffic,"
            ),
        ),
    ],
)
def test_cases_of_the_ap(ask, asked, words):
    question = ask(SITE, **asked)
    assert sentences.describe_cases(question) == words
    assert (
        f"120 frames){words} at IoU 0.7"
        in sentences.build_verdict(question, OPTION, OPTION, ()).sentence
    )
    compared = [
        line
        for line in explain(question)
        if line.startswith("The AP by which sets are compared is ")
    ]
    assert len(compared) == bool(words)
    if asked == {"levels": 3}:
        assert compared == [
            "The AP by which sets are compared is that at the worst of 3 levels of traffic."
        ]


def test_error_profiles_are_among_the_assumptions(ask):
    both = ask(SITE, errors=("paper", "poor"))
    assert sentences.describe_cases(both) == ", at the worst of the error profiles paper and poor,"
    said = assume(both)
    assert "errors of profile paper (OwnNoise) and of profile poor (Glass, Paint, DropOut" in said
    assert (
        "The AP by which they are compared is that at the worst of the error profiles paper and "
        "poor; every"
    ) in said
    assert "are with profile paper, the first one given" in said
    assert "Poses are exact" not in said
    assert "Poses are exact" in assume(ask(SITE))
    assert "judged in 45 of the 120 frames" in assume(ask(SITE), frames=120)
    assert "of the 80 frames" not in assume(ask(SITE), frames=80)
    named = (
        "errors of profile typical (Glass, DropOut, MixedPixels, OwnNoise, RangeNoise, Calibration)"
    )
    assert named in assume(ask(SITE, errors=("typical",)))


def test_verdicts_say_whether_the_ap_is_met_and_how_surely(ask):
    asked = sentences.build_verdict(ask(SITE), OPTION, OPTION, ())
    assert asked.met is None
    words = (
        "AP 0.910 (95 % interval 0.850 to 0.950, 812 vehicles in 120 frames) at IoU 0.7 with 2 "
        "sensors"
    )
    assert words in asked.sentence
    met = sentences.build_verdict(ask(SITE, min_ap=0.9), OPTION, OPTION, ())
    assert (met.met, "reaches below it" in met.sentence) == (True, True)
    sure = sentences.build_verdict(ask(SITE, min_ap=0.8), OPTION, OPTION, ())
    assert "the whole interval lies above it" in sure.sentence
    missed = sentences.build_verdict(ask(SITE, min_ap=0.95), OPTION, OPTION, ("Because.",))
    assert (missed.met, missed.reasons[-1]) == (False, "Because.")
    assert "is not met" in missed.sentence


def test_a_verdict_under_failures_is_on_what_is_left(ask):
    # the AP asked for is what is left
    frail = replace(OPTION, left=replace(FINAL, ap=0.5, low=0.4, high=0.6))
    verdict = sentences.build_verdict(ask(SITE, min_ap=0.8, failing=1), OPTION, frail, ())
    assert (verdict.met, "has AP 0.500" in verdict.sentence) == (False, True)


def test_the_choice_is_explained_by_sets_schemes_and_failures(ask):
    schemes = (SchemeFigures("early", 0.7, FINAL, 500.0), SchemeFigures("late", 0.7, FINAL, 2.0))
    failures = (
        FailureCase(("a",), FINAL),
        FailureCase(("b",), Judgement(0.4, 0.3, 0.5, 0.4, 0.9, 812, 120)),
    )
    said = " ".join(explain(ask(SITE), 12345, near=(OPTION,), schemes=schemes, failures=failures))
    assert "12,345 sets were scored by the surrogate, a quick estimate; 1 of them" in said
    assert "greedy and swap" in said
    assert "1 other judged set is surely within 0.01 of the best on the same frames" in said
    assert "late 0.910 for 2.0 kbit" in said
    assert "The failure of b hurts most: AP 0.400 is left" in said


def test_plain_assumptions_name_seeds_classes_and_prices(ask):
    plain = assume(ask(SITE, seed=4))
    assert "seeds 4, 1000007 and 2000010" in plain
    assert "cyclist, pedestrian and heavy did not count in the choice" in plain
    assert "AP is of vehicles alone, heavy ones not counted, centred in the detection area" in plain
    assert "No catalogue was given" in plain
    assert "by coverage" not in plain


def test_weights_coverage_and_samples_are_among_the_assumptions(ask):
    other = assume(
        ask(SITE, classes=Classes(EVERY, (3.0, 1.0, 1.0, 3.0))), "coverage", sampled=True
    )
    assert "did not count" not in other
    assert (
        "AP is the mean of 0.38 vehicle, 0.12 cyclist (IoU 0.5), 0.12 pedestrian (IoU 0.5) and "
        "0.38 heavy"
    ) in other
    assert "searches went by coverage" in other
    assert "For a set this large" in other


def test_assumptions_name_the_class_and_the_codec(ask):
    assert "AP is of pedestrian alone, centred" in assume(
        ask(SITE, classes=Classes(("pedestrian",)))
    )
    assert "kbit count 96 bits for a point and 256 for a box" in assume(ask(SITE))
    assert "kbit are of messages as RangeImages(step=0.04) writes" in assume(
        ask(SITE, codec=RangeImages(0.04))
    )
    assert "kbit are of messages as RangeImages(step=0.02) writes" in assume(
        ask(SITE, scheme="foreground")
    )


def test_an_ap_without_an_interval_is_among_the_unknowns():
    assert len(sentences.list_unknowns(FINAL)) == 4
    few = Judgement(1.0, math.nan, math.nan, 1.0, 1.0, 3, 4)
    assert "How far AP 1.00 may be off" in sentences.list_unknowns(few)[-1]


def test_refusals_say_what_is_missing(ask, street):
    assert "budget is 0 sensors" in refusals.refuse_question(ask(street.site, sensors=0))[0]
    question = ask(street.site)
    assert "has no road network" in refusals.refuse_question(question)[0]
    assert refusals.refuse_traffic(question, ["vehicle"], 1, "simulated") == (
        "No vehicle enters the detection area of site 'street' in 1 frame of simulated traffic: "
        "increase --frames, change --seed, or enlarge the area.",
    )
    assert refusals.refuse_traffic(question, ["cyclist", "heavy"], 3, "judging")[0].startswith(
        "No cyclist and no heavy enters"
    )


def test_a_shortfall_says_how_much_is_missing(ask, street):
    final = Judgement(0.8, 0.7, 0.9, 0.8, 1.0, 50, 20)
    best = PlanOption(("a", "b"), 5500.0, 1.0, 2.0, 0.9, replace(final, ap=0.85))
    question = ask(street.site, sensors=2, money=6000.0, min_ap=0.95)
    first, number, left, excluded = sentences.explain_shortfall(
        question, best, final, ("The links exclude all.",)
    )
    assert "2 sensors" in first
    assert (
        "AP 0.80 (0.70 to 0.90) on 50 vehicles in the final traffic and 0.85 in the traffic it was"
        in first
    )
    assert "0.95 is required" in first
    assert "The budget of 2 sensors is used up" in number
    assert "it leaves the price of 500 ordinary poles" in left
    assert excluded == "The links exclude all."
    assert (
        len(sentences.explain_shortfall(ask(street.site, sensors=9, min_ap=0.95), best, final, ()))
        == 1
    )


def test_a_requirement_that_is_just_reached_is_met(ask):
    met = sentences.build_verdict(ask(SITE, min_ap=0.91), OPTION, OPTION, ())
    assert (met.met, "reaches below it" in met.sentence) == (True, True)
    sure = sentences.build_verdict(ask(SITE, min_ap=0.85), OPTION, OPTION, ())
    assert (sure.met, "the whole interval lies above it" in sure.sentence) == (True, True)
    unjudged = replace(OPTION, judged=None)
    with pytest.raises(ValueError, match="the chosen set is not judged"):
        sentences.build_verdict(ask(SITE), unjudged, unjudged, ())
    few = replace(FINAL, low=math.nan, high=math.nan)
    said = sentences.build_verdict(ask(SITE), OPTION, replace(OPTION, judged=few), ()).sentence
    assert "AP 0.910 (no interval from fewer than 80 frames, 812 vehicles" in said


def test_schemes_at_the_plans_iou_and_single_failures_are_said(ask):
    other = replace(FINAL, ap=0.3)
    schemes = (
        SchemeFigures("early", 0.8, other, 9.0),
        SchemeFigures("late", 0.7, FINAL, 2.0),
        SchemeFigures("early", 0.7, FINAL, 500.0),
        SchemeFigures("late", 0.8, other, 3.0),
    )
    failures = (FailureCase(("a", "b"), other), FailureCase(("b",), FINAL))
    lines = explain(ask(SITE), schemes=schemes, failures=failures, near=(OPTION, OPTION))
    assert lines[-2:] == (
        "Early fusion gives AP 0.910 for 500.0 kbit per sensor and frame; with the same sensors: "
        "late 0.910 for 2.0 kbit.",
        "The failure of b hurts most: AP 0.910 is left.",
    )
    assert "2 other judged sets are surely within 0.01 of the best on the same frames." in lines
    assert not any("fusion gives" in line for line in explain(ask(SITE), schemes=schemes[2:3]))
    assert not any("fusion gives" in line for line in explain(ask(SITE), schemes=schemes[1:2]))
    assert not any("hurts most" in line for line in explain(ask(SITE), failures=failures[:1]))
    found = [line for line in lines if line.startswith("It comes from ")]
    assert found == [
        (
            "It comes from greedy and swap; its predicted AP is 0.930, its AP among the judged "
            "sets 0.910 (0.850 to 0.950)."
        )
    ]


def test_numbers_in_assumptions_are_the_ones_in_use(ask, limits):
    said = assume(ask(SITE, errors=("typical",)))
    assert "over blocks of 8 frames, two lives of an object" in said
    assert "links are compared with them at 10 frames a second" in said
    assert "drawn anew for every 4 frames" in said
    limits(sentences, BLOCK_FRAMES=12, FRAME_RATE_HZ=2.5, LIFE=6)
    changed = assume(ask(SITE, errors=("typical",)))
    for words in ("blocks of 12 frames", "at 2.5 frames a second", "for every 6 frames"):
        assert words in changed


def test_a_narrowed_search_states_the_frames_that_it_looked_at(ask):
    question = ask(SITE, candidates=None)
    narrowed = replace(
        question, setting=replace(question.setting, candidates=Stock(only=("p0", "p1")))
    )
    assert "the 2 that see most in the first 8 frames went on" in assume(narrowed)
    short = replace(narrowed, run=Run(frames=3))
    assert "the 2 that see most in the first 3 frames went on" in assume(short)


def test_mean_thresholds_are_among_the_assumptions(ask):
    several = assume(ask(SITE, iou=(0.7, 0.8)))
    assert "Every AP is the mean over IoU 0.7, 0.8, as in COCO" in several
    assert "hits at IoU 0.7." in several


def test_drawings_are_among_the_assumptions(ask):
    assert "COCO" not in assume(ask(SITE))
    assert "drawings" not in assume(ask(SITE))
    drawn = assume(ask(replace(SITE, furnished="dense"), drawings=3))
    assert "Figures of whole sets are means over 3 drawings of what no map knows" in drawn


def test_assumptions_say_what_prices_are_in(ask):
    bare = assume(ask(SITE, catalogue=SensorCatalogue((), "EUR")))
    assert "The catalogue names no pole_price: the prices of poles are taken to be in EUR." in bare
    assert "its unit" in assume(ask(SITE, catalogue=SensorCatalogue(())))
    priced = assume(ask(SITE, catalogue=SensorCatalogue((), "EUR", 4000.0)))
    assert "pole_price" not in priced
    assert "No catalogue" not in priced
    assert "For a set this large" not in priced
    assert "AP is of vehicles alone" in priced
    alone = assume(ask(SITE, classes=Classes(("vehicle",), combine="worst")))
    assert "AP is of vehicles alone" in alone


def test_origins_are_drawn_things_but_poles_and_the_uneven_ground():
    assert sentences.describe_origins(replace(SITE, road_origin="drawn")).startswith(
        "Everything at the site is drawn"
    )
    assert sentences.describe_origins(SITE).startswith("Nothing at the site is marked as drawn")
    pole = Mount("p", np.zeros(3), origin="drawn")
    assert sentences.describe_origins(replace(SITE, mounts=(pole,))).startswith(
        "Nothing at the site is marked"
    )
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    wall = Solid(square, 0.0, 5.0, "wall", origin="drawn")
    drawn = replace(SITE, mounts=(pole,), solids=(wall,))
    said = sentences.describe_origins(drawn)
    assert said.startswith("In no map, but drawn at random: 1 wall. They hide road")
    uneven = sentences.describe_origins(replace(drawn, relief=Relief(0.05, 1)))
    assert "1 wall, and ground uneven within 0.05 m. They hide" in uneven
