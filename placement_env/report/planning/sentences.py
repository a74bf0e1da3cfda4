"""Sentences of a plan. They are verdict and refusals, why this set, assumptions and unknowns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from placement_env.cases import iou_text
from placement_env.classes import VEHICLES
from placement_env.fidelity.coverage import LEAST
from placement_env.objective import Objective
from placement_env.report.content import Judgement, Plan, PlanOption, Verdict
from placement_env.report.planning.choosing import Rule
from placement_env.report.planning.question import Question
from placement_env.search.description import describe_money
from toolkit.arrays import Bool
from toolkit.detection.codec import PAPER
from toolkit.detection.scheme import scheme_codec
from toolkit.objects import LABELS


def plural(count: int, noun: str) -> str:
    """Number of things, in words.

    >>> plural(1, "sensor"), plural(3, "vehicle")
    ('1 sensor', '3 vehicles')
    """
    return f"{count} {noun}" + ("" if count == 1 else "s")


def refuse_question(question: Question) -> tuple[str, ...]:
    """Reasons against any plan that need no simulation."""
    if question.sensors == 0:
        return ("The budget is 0 sensors, so there is nothing to build: allow 1 or more.",)
    if not question.site.network:
        return (
            f"Site {question.site.name!r} has no road network, so there is no traffic to plan for: "
            "import one from a map, or build one with toolkit.sites.network.",
        )
    return ()


def refuse_traffic(question: Question, missing: Sequence[str], frames: int, part: str) -> tuple[str, ...]:
    """Reason that traffic lacks counted classes. It concerns one part of the traffic."""
    return (
        f"No {' and no '.join(missing)} enters the detection area of site {question.site.name!r} in "
        f"{plural(frames, 'frame')} of {part} traffic: increase --frames, change --seed, or enlarge the area.",
    )


def select_buildable(objective: Objective, max_kbit: float | None) -> Bool[np.ndarray, " C"]:
    """Select candidates that may be built alone. They send no more than allowed in the average frame."""
    return np.asarray(objective.allowed([]) & (objective.sent <= (np.inf if max_kbit is None else max_kbit)))


def describe_cases(question: Question) -> str:
    """Cases of the AP by which sets are compared. It is "" for the intact set in all traffic at one error profile."""
    cases = question.cases
    words = [cases.describe_failures()] if cases.failing else []
    words += [cases.describe_levels()] if cases.levels > 1 else []
    words += [cases.describe_errors()] if len(cases.names) > 1 else []
    return f", {', '.join(words)}," if words else ""


def build_verdict(question: Question, compared: PlanOption, final: PlanOption, excluded: tuple[str, ...]) -> Verdict:
    """The answer in words. compared, final: the chosen set when sets were compared, and in the final traffic."""
    judged = final.counted
    if judged is None:
        raise ValueError("the chosen set is not judged: judge it first")
    count, price = plural(len(final.sensors), "sensor"), describe_money(final.price, question.currency)
    vehicles, frames = plural(judged.vehicles, judged.kind), plural(judged.frames, "frame")
    figure = f"AP {judged.ap:.3f} (95 % interval {judged.low:.3f} to {judged.high:.3f}, {vehicles} in {frames})"
    at = f"at IoU {iou_text(question.cases.threshold)}"
    result = f"{figure}{describe_cases(question)} {at} with {count} for {price}"
    least = question.min_ap
    if least is None:
        return Verdict(None, f"The best set found within the budget has {result}.")
    if judged.ap >= least:
        sure = (
            "the whole interval lies above it"
            if judged.low >= least
            else "the interval reaches below it, so more traffic may say otherwise"
        )
        return Verdict(True, f"The requirement of AP {least:g} is met: {result}; {sure}.")
    reasons = explain_shortfall(question, compared, judged, excluded)
    return Verdict(False, f"The requirement of AP {least:g} is not met: the best set found has {result}.", reasons)


def explain_shortfall(
    question: Question, best: PlanOption, final: Judgement, excluded: tuple[str, ...]
) -> tuple[str, ...]:
    """Explain why the required AP is not reached. best: as it was chosen; final: the same set in the final traffic."""
    price = describe_money(best.price, question.currency)
    before = f" and {best.counted.ap:.3f} in the traffic it was chosen on" if best.counted else ""
    reasons = [
        f"The best set found, {plural(len(best.sensors), 'sensor')} for {price}, has AP {final.ap:.3f} "
        f"({final.low:.3f} to {final.high:.3f}){describe_cases(question)} on {plural(final.vehicles, final.kind)} in "
        f"the final traffic{before}; {question.min_ap:g} is required at IoU {iou_text(question.cases.threshold)}."
    ]
    if question.sensors is not None and len(best.sensors) >= question.sensors:
        reasons.append(f"The budget of {plural(question.sensors, 'sensor')} is used up: more might reach it.")
    if question.money is not None:
        left = describe_money(question.money - best.price, question.currency)
        reasons.append(f"Of {describe_money(question.money, question.currency)} it leaves {left}.")
    return (*reasons, *excluded)


RULES: dict[Rule, str] = {
    "best": "It has the highest AP of the judged sets; ties are broken by the mean AP at IoU 0.7, 0.8 and 0.9, then by "
    "price.",
    "interval": "It is the cheapest of the judged sets whose whole 95 % interval lies above the required AP.",
    "estimate": "It is the cheapest of the judged sets whose AP reaches the requirement; no judged set has its whole "
    "95 % interval above it.",
    "none": "None of the judged sets reaches the requirement; it has the highest AP of them.",
}


def explain_choice(
    question: Question, plan: Plan, chosen: PlanOption, rule: Rule, *, considered: int, fidelity: str
) -> tuple[str, ...]:
    """Explain why this set, with figures. chosen: as it was when sets were compared; considered: sets scored."""
    judged = sum(option.judged is not None for option in plan.considered)
    cases = describe_cases(question).strip(", ")
    which = "" if question.cases.failing else "that "
    searches = " and ".join(chosen.searches) or "a neighbour of a search's answer"
    second, near = chosen.counted, len(plan.near_optimal)
    lines = [
        f"{considered:,} sets were scored by the {fidelity}; {len(plan.considered)} of them raced by the detector on "
        f"traffic that no search saw, and {judged} were judged on all of it.",
        RULES[rule],
    ]
    if cases:
        lines.append(f"The AP by which sets are compared is {which}{cases}.")
    if second is None:
        lines.append(f"It comes from {searches}.")
    else:
        lines.append(
            f"It comes from {searches}; its predicted AP is {chosen.predicted:.3f}, its AP among the judged sets "
            f"{second.ap:.3f} ({second.low:.3f} to {second.high:.3f})."
        )
    lines.append(
        f"{plural(near, 'other judged set')} {'has' if near == 1 else 'have'} an interval that overlaps its own: the "
        "detector cannot tell them apart on this traffic."
        if near
        else "No other judged set has an interval that overlaps its own."
    )
    at = [row for row in plan.schemes if row.iou == plan.iou]
    own = next((row for row in at if row.scheme == plan.scheme), None)
    others = ", ".join(
        f"{row.scheme} {row.judged.ap:.3f} for {row.kbit_per_sensor:.1f} kbit" for row in at if row is not own
    )
    if own is not None and others:
        lines.append(
            f"{plan.scheme.capitalize()} fusion gives AP {own.judged.ap:.3f} for {own.kbit_per_sensor:.1f} kbit per "
            f"sensor and frame; with the same sensors: {others}."
        )
    alone = [case for case in plan.failures if len(case.failed) == 1]
    if alone:
        worst = min(alone, key=lambda case: case.judged.ap)
        lines.append(f"The failure of {worst.failed[0]} hurts most: AP {worst.judged.ap:.3f} is left.")
    return tuple(lines)


def list_assumptions(question: Question, fidelity: str, detector: str, *, sampled: bool) -> tuple[str, ...]:
    """Assumptions behind the figures. sampled: whether the objective of the searches scored subsets of the set."""
    setting, cases, seed = question.setting, question.cases, question.run.seed
    classes, stock = setting.counted, question.stock
    others = [label for label in LABELS if label not in classes.names]
    objects = (
        "of vehicles alone, heavy ones not counted,"
        if classes.names == VEHICLES.names
        else f"of {classes.names[0]} alone,"
        if len(classes) == 1
        else f"the {classes.described(cases.threshold)},"
    )
    lines = [
        "Traffic is simulated (SUMO) and measurements are ray-cast with the noise of the sensors' models; nothing was "
        "measured at the place itself.",
        f"AP is {objects} centred in the detection area, by the detector {detector} at IoU "
        f"{iou_text(cases.threshold)} in {setting.fusion.name} fusion.",
        f"Searches, comparison and judgement each have their own traffic (seeds {seed}, {seed + 1} and {seed + 2}): no "
        "AP stated for the chosen set is from traffic that it was searched or chosen on.",
        "Intervals are from a bootstrap over blocks of 4 frames, the life of an object; they hold for this detector in "
        "this kind of traffic, not for other weather, traffic or sensors.",
        f"kbit {_describe_codec(question)}; links are compared with them at 10 frames a second.",
        _describe_errors(question),
    ]
    if len(cases.ious) > 1:
        lines.append(
            f"Every AP is the mean over IoU {', '.join(f'{iou:g}' for iou in cases.ious)}, as in COCO, unless another "
            f"IoU stands beside it; pictures of single frames show hits at IoU {cases.ious[0]:g}."
        )
    if others:
        lines.append(
            f"No AP is asked for {', '.join(others)}: for these the share on which the set has at least {LEAST:g} "
            "points is stated, which is coverage and not AP."
        )
    if stock.catalogue is None:
        lines.append("No catalogue was given: sensors cost nothing besides their poles, prices are in ordinary poles.")
    elif stock.catalogue.pole_price is None:
        unit = question.currency or "its unit"
        lines.append(f"The catalogue names no pole_price: the prices of poles are taken to be in {unit}.")
    if fidelity == "coverage":
        lines.append("There is no surrogate for this scheme and IoU, so searches went by coverage.")
    if sampled:
        lines.append(
            "For a set this large, the worth of each sensor and the order of building go by the fidelity of the "
            "searches."
        )
    return tuple(lines)


def _describe_codec(question: Question) -> str:
    codec = scheme_codec(question.setting.fusion, question.setting.codec)
    if codec == PAPER:
        return "count 96 bits for a point and 256 for a box, as the paper does, without headers or compression"
    return f"are of messages as {codec.digest} writes them: as expected in searches, as sent in judgements"


def _describe_errors(question: Question) -> str:
    cases = question.cases
    if cases.noise_only:
        return "Poses are exact: no calibration error, no sway of poles, no clocks that differ."
    terms = [", ".join(dict.fromkeys(type(term).__name__ for term in each.terms)) for each in cases.profiles]
    which = " and ".join(f"of profile {name} ({words})" for name, words in zip(cases.names, terms, strict=True))
    first = (
        f" The AP by which they are compared is that {cases.describe_errors()}; every other figure of the report, kbit "
        f"and pictures are with profile {cases.names[0]}, the first one given, unless another stands beside it."
    )
    return (
        f"Sets are compared and judged with the sensors' errors {which}; searches, and the kbit they weigh, know the "
        f"noise of the sensors' models alone.{first if len(cases.names) > 1 else ''}"
    )


def list_unknowns(final: Judgement) -> tuple[str, ...]:
    """Questions that the plan cannot answer."""
    lines = [
        "How the detector does on real measurements of this place.",
        "Whether a set that no search looked at would do better: nothing is proven optimal.",
        "Rain, fog, dirt, glare, and what grows, parks or is built there later.",
        "Power, permits, and what it costs to run the sensors.",
    ]
    if final.low == final.high:
        lines.append(
            f"How far AP {final.ap:.3f} may be off: all samples of this traffic agree, but more traffic might not."
        )
    return tuple(lines)
