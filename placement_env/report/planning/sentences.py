"""Sentences of a plan: the verdict, why this set, what is assumed and what is not known."""

from __future__ import annotations

from placement_env.cases import iou_text
from placement_env.classes import VEHICLES
from placement_env.fidelity.coverage import LEAST
from placement_env.report.content import FailureCase, Judgement, PlanOption, SchemeFigures, Verdict
from placement_env.report.planning.question import Question
from placement_env.report.planning.selection import Rule
from placement_env.search.description import describe_money
from toolkit.detection.codec import PAPER
from toolkit.detection.scheme import scheme_codec
from toolkit.detection.schemes import find_scheme
from toolkit.objects import LABELS
from toolkit.sensors.error_profiles import ErrorProfile, only_own_noise


def plural(count: int, noun: str) -> str:
    """A number of things.

    >>> plural(1, "sensor"), plural(3, "vehicle")
    ('1 sensor', '3 vehicles')
    """
    return f"{count} {noun}" + ("" if count == 1 else "s")


def figure(judged: Judgement) -> str:
    """An AP with its interval and what it is of."""
    vehicles, frames = plural(judged.vehicles, judged.kind), plural(judged.frames, "frame")
    return f"AP {judged.ap:.3f} (95 % interval {judged.low:.3f} to {judged.high:.3f}, {vehicles} in {frames})"


def of_what(question: Question) -> str:
    """What an AP by which sets are compared is of: "" for that of the intact set in all traffic with one profile of
    errors."""
    cases = question.cases
    said = [cases.describe_failures()] if cases.failing else []
    said += [cases.describe_levels()] if cases.levels > 1 else []
    said += [cases.describe_errors()] if len(cases.names) > 1 else []
    return f", {', '.join(said)}," if said else ""


def verdict_of(question: Question, chosen: PlanOption, final: Judgement, reasons: tuple[str, ...]) -> Verdict:
    """The answer. final: by which it is compared with the requirement; reasons: why a requirement is not met."""
    count, price = plural(len(chosen.sensors), "sensor"), describe_money(chosen.price, question.currency)
    said = f"{figure(final)}{of_what(question)} at IoU {iou_text(question.iou)} with {count} for {price}"
    if question.min_ap is None:
        return Verdict(None, f"The best set found within the budget has {said}.")
    if final.ap >= question.min_ap:
        sure = (
            "the whole interval lies above it"
            if final.low >= question.min_ap
            else "the interval reaches below it, so more traffic may say otherwise"
        )
        return Verdict(True, f"The requirement of AP {question.min_ap:g} is met: {said}; {sure}.")
    return Verdict(False, f"The requirement of AP {question.min_ap:g} is not met: the best found has {said}.", reasons)


RULES: dict[Rule, str] = {
    "best": "It has the greatest AP of the judged sets; equal ones go by the mean AP at IoU 0.7, 0.8 and 0.9, then by "
    "price.",
    "interval": "It is the cheapest of the judged sets whose whole 95 % interval lies above the required AP.",
    "estimate": "It is the cheapest of the judged sets whose AP reaches the requirement; of none does the whole "
    "95 % interval lie above it.",
    "none": "None of the judged sets reaches the requirement; it has the greatest AP of them.",
}


def why(
    question: Question,
    options: tuple[PlanOption, ...],
    chosen: PlanOption,
    rule: Rule,
    *,
    considered: int,
    fidelity: str,
    near: int,
    schemes: tuple[SchemeFigures, ...],
    failures: tuple[FailureCase, ...],
) -> tuple[str, ...]:
    """Why this set, with figures."""
    judged = [option.judged for option in options if option.judged is not None]
    compared = of_what(question).strip(", ")
    of_that = "" if question.cases.failing else "that "
    searches = " and ".join(chosen.searches) or "a neighbour of what a search answered"
    second = chosen.counted
    sentences = [
        f"{considered:,} sets were scored by the {fidelity}; {len(options)} of them raced by the detector on traffic "
        f"that no search saw, and {len(judged)} were judged on all of it.",
        RULES[rule],
        *([f"The AP by which sets are compared is {of_that}{compared}."] if compared else []),
        f"It comes from {searches}; its predicted AP is {chosen.predicted:.3f}, "
        f"its AP among the judged sets {second.ap:.3f} ({second.low:.3f} to {second.high:.3f})."
        if second
        else f"It comes from {searches}.",
        f"{plural(near, 'other judged set')} {'has' if near == 1 else 'have'} an interval that overlaps with its own: "
        "the detector cannot tell them apart on this traffic."
        if near
        else "No other judged set has an interval that overlaps with its own.",
    ]
    own = next((row for row in schemes if row.scheme == question.scheme and row.iou == question.iou), None)
    others = [row for row in schemes if row.iou == question.iou and row.scheme != question.scheme]
    if own is not None and others:
        said = ", ".join(f"{row.scheme} {row.judged.ap:.3f} for {row.kbit_per_sensor:.1f} kbit" for row in others)
        sentences.append(
            f"{question.scheme.capitalize()} fusion gives AP {own.judged.ap:.3f} for {own.kbit_per_sensor:.1f} kbit "
            f"per sensor and frame; with the same sensors: {said}."
        )
    alone = [case for case in failures if len(case.failed) == 1]
    if alone:
        worst = min(alone, key=lambda case: case.judged.ap)
        sentences.append(f"It is hurt most when {worst.failed[0]} fails: AP {worst.judged.ap:.3f} is left.")
    return tuple(sentences)


def _of_errors(question: Question) -> str:
    """What is assumed of the sensors' errors."""
    first, *others = question.cases.profiles
    if only_own_noise(first) and not others:
        return "Poses are exact: no calibration error, no sway of poles, no clocks that differ."
    which = " and ".join(f"of profile {each.name} ({_terms(each)})" for each in (first, *others))
    over = question.cases.describe_errors()
    rest = (
        f" The AP by which they are compared is that {over}; every other figure of the report, kbit and pictures are "
        f"with profile {first.name}, the first that was asked for, unless another stands beside it."
    )
    return (
        f"Sets are compared and judged with the sensors' errors {which}; searches, "
        f"and the kbit they weigh, know the noise of the sensors' models alone.{rest if others else ''}"
    )


def _terms(errors: ErrorProfile) -> str:
    return ", ".join(dict.fromkeys(type(term).__name__ for term in errors.terms))


def _of_codec(question: Question) -> str:
    codec = scheme_codec(find_scheme(question.scheme), question.codec)
    if codec == PAPER:
        return "count 96 bits for a point and 256 for a box, as the paper does, without headers or compression"
    return f"are of messages as {codec.digest} writes them: in searches by what it expects, in judgements as sent"


def assumptions(question: Question, *, search_fidelity: str, detector: str, worth_sampled: bool) -> tuple[str, ...]:
    """Assumptions behind the figures."""
    classes = question.classes
    others = [label for label in LABELS if label not in classes.names]
    of = (
        "of vehicles alone, heavy ones not counted,"
        if classes.names == VEHICLES.names
        else f"of {classes.names[0]} alone,"
        if len(classes) == 1
        else f"the {classes.described(question.iou)},"
    )
    sentences = [
        "Traffic is simulated (SUMO) and measurements are cast rays with noise of the sensors' models; nothing was "
        "measured at the place itself.",
        f"AP is {of} centred in the detection area, by the "
        f"detector {detector} at IoU {iou_text(question.iou)} in {question.scheme} fusion.",
        "Searches, comparison and judgement have traffic of their own each (seeds "
        f"{question.seed}, {question.seed + 1} and {question.seed + 2}): no AP stated for the chosen set is from "
        "traffic that it was searched or chosen on.",
        "Intervals are from a bootstrap over blocks of 4 frames, the life of an object; they are of this detector in "
        "this kind of traffic, not of other weather, traffic or sensors.",
        f"kbit {_of_codec(question)}; links are compared with them at 10 frames a second.",
        _of_errors(question),
    ]
    if not isinstance(question.iou, float):
        sentences.append(
            f"Every AP is the mean of those at IoU {', '.join(f'{iou:g}' for iou in question.iou)}, as in COCO, unless "
            f"another IoU stands beside it; pictures of single frames show what hits at IoU {question.iou[0]:g}."
        )
    if others:
        sentences.append(
            f"No AP is asked for {', '.join(others)}: of these a share is stated that the set has at least "
            f"{LEAST:g} points on, which is coverage and no AP."
        )
    if question.catalogue is None:
        sentences.append(
            "No catalogue was given: sensors cost nothing beside their poles, prices are in ordinary poles."
        )
    elif question.catalogue.pole_price is None:
        sentences.append(
            "The catalogue names no pole_price: the prices of poles are taken to be in "
            f"{question.currency or 'its unit'}."
        )
    if search_fidelity == "coverage":
        sentences.append("There is no surrogate for this scheme and IoU, so searches went by coverage.")
    if worth_sampled:
        sentences.append(
            "With so many sensors what each is worth, and the order of building, go by the fidelity of the searches."
        )
    return tuple(sentences)


def unknown(final: Judgement) -> tuple[str, ...]:
    """What the plan cannot say."""
    sentences = [
        "How the detector does on real measurements of this place.",
        "Whether a set that no search looked at would do better: nothing is proven optimal.",
        "Rain, fog, dirt, glare, and what grows, parks or is built there later.",
        "Power, permits, and what it costs to run the sensors.",
    ]
    if final.low == final.high:
        sentences.append(
            f"How far AP {final.ap:.3f} may be off: all samples of this traffic agree, which more of it might not."
        )
    return tuple(sentences)
