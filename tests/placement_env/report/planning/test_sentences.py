"""What a plan says in sentences, with its figures."""

import numpy as np
import pytest

from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.report.content import FailureCase, Judgement, PlanOption, SchemeFigures
from placement_env.report.planning.question import Question
from placement_env.report.planning.sentences import assumptions, of_what, unknown, verdict_of, why
from placement_env.search.description import describe_money
from toolkit.detection.link.range_images import RangeImages
from toolkit.sensors.error_profiles import PAPER_ERRORS, TYPICAL
from toolkit.sites.site import Site

SITE = Site("street", np.array([-20.0, -20, 20, 20]))
FINAL = Judgement(0.91, 0.85, 0.95, 0.92, 0.9, 812, 120)
OPTION = PlanOption(("a", "b"), 2.0, 500.0, 1000.0, 0.93, FINAL, ("greedy", "swap"))


@pytest.mark.parametrize(
    ("amount", "currency", "words"),
    [
        (12345.678, "EUR", "12,345.68 EUR"),
        (1.0, "", "the price of 1 ordinary pole"),
        (0.6, "", "the price of 0.6 ordinary poles"),
    ],
)
def test_money(amount, currency, words):
    assert describe_money(amount, currency) == words


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({}, ""),
        ({"levels": 3}, ", at the worst of 3 levels of traffic,"),
        (
            {"levels": 2, "levels_by": "mean", "failing": 1},
            ", what is left in the worst case when 1 sensor fails, averaged over 2 levels of traffic,",
        ),
    ],
)
def test_what_an_ap_is_of(asked, words):
    question = Question(site=SITE, cases=Cases(**asked))
    assert of_what(question) == words
    assert f"120 frames){words} at IoU 0.7" in verdict_of(question, OPTION, FINAL, ()).sentence
    said = why(question, (OPTION,), OPTION, "best", considered=9, fidelity="surrogate", near=0, schemes=(), failures=())
    compared = [each for each in said if each.startswith("The AP by which sets are compared is ")]
    assert len(compared) == bool(words)
    if asked == {"levels": 3}:
        assert compared == ["The AP by which sets are compared is that at the worst of 3 levels of traffic."]


def test_several_error_profiles_are_said():
    over = Cases(errors=("paper", "poor"))
    assert of_what(Question(site=SITE, cases=over)) == ", at the worst of the error profiles paper and poor,"
    mean = Question(site=SITE, cases=Cases(errors=("typical", "poor"), errors_by="mean", failing=1, levels=2))
    assert of_what(mean) == (
        ", what is left in the worst case when 1 sensor fails, at the worst of 2 levels of traffic, "
        "averaged over the error profiles typical and poor,"
    )
    said = " ".join(
        assumptions(Question(site=SITE, cases=over), search_fidelity="surrogate", detector="x", worth_sampled=False)
    )
    assert "errors of profile paper (OwnNoise) and of profile poor (Glass, Paint, DropOut" in said
    assert "The AP by which they are compared is that at the worst of the error profiles paper and poor; every" in said
    assert "are with profile paper, the first that was asked for" in said
    assert "Poses are exact" not in said


def test_verdicts():
    asked = Question(site=SITE)
    assert verdict_of(asked, OPTION, FINAL, ()).met is None
    said = verdict_of(asked, OPTION, FINAL, ()).sentence
    assert "AP 0.910 (95 % interval 0.850 to 0.950, 812 vehicles in 120 frames) at IoU 0.7 with 2 sensors" in said
    met = verdict_of(Question(site=SITE, min_ap=0.9), OPTION, FINAL, ())
    assert (met.met, "reaches below it" in met.sentence) == (True, True)
    sure = verdict_of(Question(site=SITE, min_ap=0.8), OPTION, FINAL, ())
    assert "the whole interval lies above it" in sure.sentence
    missed = verdict_of(Question(site=SITE, min_ap=0.95), OPTION, FINAL, ("Because.",))
    assert (missed.met, missed.reasons) == (False, ("Because.",))
    assert "is not met" in missed.sentence


def test_why_names_figures():
    schemes = (SchemeFigures("early", 0.7, FINAL, 500.0), SchemeFigures("late", 0.7, FINAL, 2.0))
    failures = (FailureCase(("a",), FINAL), FailureCase(("b",), Judgement(0.4, 0.3, 0.5, 0.4, 0.9, 812, 120)))
    said = " ".join(
        why(
            Question(site=SITE), (OPTION,), OPTION, "best", considered=12345, fidelity="surrogate", near=1,
            schemes=schemes, failures=failures,
        )
    )  # fmt: skip
    assert "12,345 sets were scored by the surrogate; 1 of them raced" in said
    assert "greedy and swap" in said
    assert "1 other judged set has an interval that overlaps" in said
    assert "late 0.910 for 2.0 kbit" in said
    assert "hurt most when b fails: AP 0.400 is left" in said


def test_assumptions_follow_the_question():
    plain = " ".join(
        assumptions(Question(site=SITE, seed=4), search_fidelity="surrogate", detector="Reader", worth_sampled=False)
    )
    assert "seeds 4, 5 and 6" in plain
    assert "No AP is asked for cyclist, pedestrian, heavy" in plain
    assert "AP is of vehicles alone, heavy ones not counted, centred in the detection area" in plain
    assert "No catalogue was given" in plain
    assert "by coverage" not in plain
    assert "start from the map" not in plain
    only = Question(site=SITE, classes=Classes(("vehicle", "cyclist", "pedestrian", "heavy"), (3.0, 1.0, 1.0, 3.0)))
    other = " ".join(assumptions(only, search_fidelity="coverage", detector="Reader", worth_sampled=True))
    assert "No AP is asked for" not in other
    assert "AP is the mean of 0.38 vehicle, 0.12 cyclist (IoU 0.5), 0.12 pedestrian (IoU 0.5) and 0.38 heavy" in other
    walkers = Question(site=SITE, classes=("pedestrian",))
    third = " ".join(assumptions(walkers, search_fidelity="coverage", detector="Reader", worth_sampled=True))
    assert "AP is of pedestrian alone, centred" in third
    assert "searches went by coverage" in other
    assert "With so many sensors" in other


def test_how_bits_are_counted_is_said():
    def said(**asked):
        question = Question(site=SITE, **asked)
        return " ".join(assumptions(question, search_fidelity="surrogate", detector="x", worth_sampled=False))

    assert "kbit count 96 bits for a point and 256 for a box" in said()
    assert "kbit are of messages as RangeImages(step=0.04) writes them" in said(codec=RangeImages(0.04))
    assert "kbit are of messages as RangeImages(step=0.02) writes them" in said(scheme="foreground")


def test_errors_of_sensors_are_assumed_aloud():
    def said(errors):
        question = Question(site=SITE, cases=Cases(errors=errors))
        return " ".join(assumptions(question, search_fidelity="surrogate", detector="x", worth_sampled=False))

    assert "Poses are exact" in said(PAPER_ERRORS)
    assert "Poses are exact" not in said(TYPICAL)
    named = "errors of profile typical (Glass, DropOut, MixedPixels, OwnNoise, RangeNoise, Calibration)"
    assert named in said(TYPICAL)


def test_an_interval_without_width_is_named():
    assert len(unknown(FINAL)) == 4
    assert "How far AP 1.000 may be off" in unknown(Judgement(1.0, 1.0, 1.0, 1.0, 1.0, 3, 4))[-1]
