"""Sentences of a plan: verdict and refusals, why this set, assumptions and unknowns."""

import math
from collections.abc import Sequence

from placement_env.cases import iou_text
from placement_env.classes import VEHICLES, join_names
from placement_env.handover.mounted import LinkLoad, describe_narrow_links
from placement_env.report.content import TEXTS, BreakdownRow, Judgement, Plan, PlanOption, Verdict
from placement_env.report.planning.judging import Rule
from placement_env.report.planning.question import Question
from placement_env.search.first_look import LOOK_FRAMES
from placement_env.search.order import FEWEST_AT_LEVEL, describe_money
from toolkit.detection.codec import PAPER
from toolkit.detection.scheme import scheme_codec
from toolkit.display import describe_count
from toolkit.objects import LABELS
from toolkit.sites.site import Site
from toolkit.sites.surroundings import count_things, describe_things

FEWEST_OVERRATED = 3  # judged sets that show by how much predictions overrate


def refuse_question(question: Question) -> tuple[str, ...]:
    """Reasons against any plan that need no simulation."""
    if question.sensors == 0:
        return ("The budget is 0 sensors, so there is nothing to build: allow 1 or more.",)
    why = (
        f"Site {question.site.name!r} has no road network, so there is no traffic to plan for: "
        "import one from a map, or build one with toolkit.sites.network.",
    )
    return () if question.site.network else why


def refuse_traffic(
    question: Question, missing: Sequence[str], frames: int, part: str
) -> tuple[str, ...]:
    """Reason that one part of the traffic lacks counted classes."""
    return (
        f"No {' and no '.join(missing)} enters the detection area of site {question.site.name!r} "
        f"in {describe_count(frames, 'frame')} of {part} traffic: increase --frames, change "
        "--seed, or enlarge the area.",
    )


def describe_cases(question: Question) -> str:
    """Cases of the AP by which sets are compared, "" for usual ones."""
    cases = question.cases
    words = [cases.describe_failures()] if cases.failing else []
    words += [cases.describe_levels()] if cases.levels > 1 else []
    words += [cases.describe_errors()] if len(cases.names) > 1 else []
    return f", {', '.join(words)}," if words else ""


def build_verdict(
    question: Question,
    compared: PlanOption,
    final: PlanOption,
    excluded: tuple[str, ...],
    rule: Rule = "best",
    *,
    links: Sequence[LinkLoad] = (),
) -> Verdict:
    """The answer in words. compared, final: the chosen set when sets were compared, and in the
    final traffic; links: their loads there."""
    judged = final.counted
    if judged is None:
        raise ValueError("the chosen set is not judged: judge it first")
    count = describe_count(len(final.sensors), "sensor")
    price = describe_money(final.price, question.currency)
    vehicles = describe_count(judged.vehicles, judged.kind)
    frames = describe_count(judged.frames, "frame")
    ends = f"{'' if math.isnan(judged.low) else '95 % interval '}{judged.describe_interval()}"
    result = (
        f"AP {judged.format_ap()} ({ends}, {vehicles} in {frames}){describe_cases(question)} at "
        f"IoU {iou_text(question.cases.threshold)} with {count} for {price}"
    )
    least = question.min_ap
    narrow = describe_narrow_links(links, question.setting.link_share)
    if least is None:
        what = "cheapest set that cannot be told from the best" if rule == "as good" else "best set"
        return Verdict(
            None,
            " ".join(filter(None, (narrow, f"The {what} found within the budget has {result}."))),
        )
    if judged.ap >= least:
        unsure = "the interval reaches below it, so more traffic may say otherwise"
        sure = "the whole interval lies above it" if judged.low >= least else unsure
        met = f"The requirement of AP {least:g} is met: {result}; {sure}."
        return Verdict(True, " ".join(filter(None, (narrow, met))))
    reasons = (
        *([narrow] if narrow else []),
        *explain_shortfall(question, compared, judged, excluded),
    )
    return Verdict(
        False,
        f"The requirement of AP {least:g} is not met: the best set found has {result}.",
        reasons,
    )


def explain_shortfall(
    question: Question, best: PlanOption, final: Judgement, excluded: tuple[str, ...]
) -> tuple[str, ...]:
    """Explain why the required AP is not reached. best: as it was chosen; final: the same set in
    the final traffic."""
    price = describe_money(best.price, question.currency)
    before = (
        f" and {best.counted.format_ap()} in the traffic it was chosen on" if best.counted else ""
    )
    reasons = [
        f"The best set found, {describe_count(len(best.sensors), 'sensor')} for {price}, has AP "
        f"{final.format_ap()} ({final.describe_interval()}){describe_cases(question)} on "
        f"{describe_count(final.vehicles, final.kind)} in the final traffic{before}; "
        f"{question.min_ap:g} is required at IoU {iou_text(question.cases.threshold)}."
    ]
    if question.sensors is not None and len(best.sensors) >= question.sensors:
        reasons.append(
            f"The budget of {describe_count(question.sensors, 'sensor')} is used up: more might "
            "reach it."
        )
    if question.money is not None:
        left = describe_money(question.money - best.price, question.currency)
        reasons.append(f"Of {describe_money(question.money, question.currency)} it leaves {left}.")
    return (*reasons, *excluded)


def explain_choice(
    question: Question,
    plan: Plan,
    chosen: PlanOption,
    rule: Rule,
    *,
    considered: int,
    fidelity: str,
) -> tuple[str, ...]:
    """Explain why this set, with figures. chosen: as it was when sets were compared; considered:
    sets scored."""
    judged = sum(option.judged is not None for option in plan.considered)
    searches = " and ".join(chosen.searches) or "a neighbour of a search's answer"
    second = chosen.counted
    near = len(plan.near_optimal)
    best = plan.best
    lines = [
        f"{considered:,} sets were scored by the {fidelity}, a quick estimate; "
        f"{len(plan.considered)} of them were compared by the detector on traffic that no search "
        f"saw, the {judged} best of these on all of it.",
        TEXTS["rules"][rule],
    ]
    if cases := describe_cases(question).strip(", "):
        lines.append(
            "The AP by which sets are compared is "
            f"{'' if question.cases.failing else 'that '}{cases}."
        )
    score = "coverage" if fidelity == "coverage" else "predicted AP"
    figures = second and (
        f"; its {score} is {_describe_prediction(plan, chosen, fidelity)}, "
        f"its AP among the judged sets {second.format_ap()} "
        f"({second.describe_interval()})"
    )
    lines.append(f"It comes from {searches}{figures or ''}.")
    if rule == "as good" and best is not None and best.counted is not None and second is not None:
        price = describe_money(best.price, question.currency)
        more = f"{best.counted.format_ap()} for {price}, {best.counted.ap - second.ap:+.3f}"
        lines.append(f"The best set, {describe_count(len(best.sensors), 'sensor')}, has AP {more}.")
    if rule in ("best", "as good"):
        others = (
            f"{describe_count(near, 'other judged set')} {'is' if near == 1 else 'are'}"
            if near
            else "No other is"
        )
        lines.append(f"{others} surely within 0.01 of the best on the same frames.")
    at = [row for row in plan.schemes if row.iou == plan.iou]
    own = next((row for row in at if row.scheme == plan.scheme), None)
    others = ", ".join(
        f"{row.scheme} {row.judged.format_ap()} for {row.kbit_per_sensor:.1f} kbit"
        for row in at
        if row is not own
    )
    if own is not None and others:
        lines.append(
            f"{plan.scheme.capitalize()} fusion gives AP {own.judged.format_ap()} for "
            f"{own.kbit_per_sensor:.1f} kbit per sensor and frame; with the same sensors: "
            f"{others}."
        )
    alone = [case for case in plan.failures if len(case.failed) == 1]
    if alone:
        worst = min(alone, key=lambda case: case.judged.ap)
        lines.append(
            f"The failure of {worst.failed[0]} hurts most: AP {worst.judged.format_ap()} is left."
        )
    return tuple(lines)


def _describe_prediction(plan: Plan, chosen: PlanOption, fidelity: str) -> str:
    """Prediction of the searches, less what predictions overrate the judged sets by."""
    off = [
        option.predicted - option.counted.ap
        for option in plan.considered
        if option.counted is not None
    ]
    if fidelity == "coverage" or len(off) < FEWEST_OVERRATED:
        return f"{chosen.predicted:.3f}"
    mean = sum(off) / len(off)
    if mean <= 0:
        return f"{chosen.predicted:.3f}"
    return (
        f"{chosen.predicted - mean:.3f} ({mean:.3f} deducted, by which predictions overrate the "
        "judged sets)"
    )


def list_assumptions(
    question: Question, fidelity: str, detector: str, *, sampled: bool
) -> tuple[str, ...]:
    """Assumptions behind the figures. sampled: whether the objective of the searches scored subsets
    of the set."""
    setting = question.setting
    cases = question.cases
    searched, compared, judged = (
        question.part(name).seed for name in ("search", "comparison", "judgement")
    )
    classes = setting.counted
    stock = question.stock
    others = [label for label in LABELS if label not in classes.names]
    one = (
        "vehicles alone, heavy ones not counted,"
        if classes.names == VEHICLES.names
        else f"{classes.names[0]} alone,"
    )
    objects = f"of {one}" if len(classes) == 1 else f"the {classes.described(cases.threshold)},"
    lines = [
        "Traffic is simulated (SUMO) and measurements are ray-cast with the noise of the "
        "sensors' models; nothing was measured at the place itself.",
        describe_origins(question.site),
        f"AP is {objects} centred in the detection area, by the detector {detector} at IoU "
        f"{iou_text(cases.threshold)} in {setting.fusion.name} fusion.",
        f"Searches, comparison and judgement each have their own traffic (seeds {searched}, "
        f"{compared} and {judged}): no AP stated for the chosen set is from traffic that it was "
        "searched or chosen on.",
        "Intervals are from a bootstrap over blocks of 8 frames, two lives of an object, widened "
        "for few blocks; they hold for this detector in this kind of traffic, not for other "
        "weather, traffic or sensors.",
        f"kbit {_describe_codec(question)}; links are compared with them at 10 frames a second.",
        _describe_errors(question),
    ]
    if len(cases.ious) > 1:
        lines.append(
            f"Every AP is the mean over IoU {', '.join(f'{iou:g}' for iou in cases.ious)}, as in "
            "COCO, unless another IoU stands beside it; pictures of single frames show hits at "
            f"IoU {cases.ious[0]:g}."
        )
    if others:
        same = "the AP stated for them is that of the same detections"
        lines.append(f"{join_names(others)} did not count in the choice; {same}.")
    if stock.catalogue is None:
        lines.append(
            "No catalogue was given: sensors cost nothing besides their poles, prices are in "
            "ordinary poles."
        )
    elif stock.catalogue.pole_price is None:
        taken = f"the prices of poles are taken to be in {question.currency or 'its unit'}"
        lines.append(f"The catalogue names no pole_price: {taken}.")
    if stock.only:
        lines.append(
            f"The poles offer more poses than can be searched: the {len(stock.only):,} that see "
            f"most in the first {LOOK_FRAMES} frames went on."
        )
    if fidelity == "coverage":
        lines.append("There is no surrogate for this scheme and IoU, so searches went by coverage.")
    if question.drawings > 1:
        lines.append(
            f"Figures of whole sets are means over {question.drawings} drawings of what no map "
            "knows; zones, classes, schemes, kbit and pictures are of the first."
        )
    if sampled:
        go = "the worth of each sensor and the order of building go by the fidelity of the searches"
        lines.append(f"For a set this large, {go}.")
    return tuple(lines)


def describe_origins(site: Site) -> str:
    """Sentence that lists drawn things of a site."""
    if site.road_origin == "drawn":
        return "Everything at the site is drawn at random, the road too: there is no such place."
    drawn = {kind: n for kind, n in count_things(site)["drawn"].items() if kind != "pole"}
    if not drawn:
        return (
            "Nothing at the site is marked as drawn; files from before there were marks have none."
        )
    ground = (
        f", and ground uneven within {site.relief.amplitude:g} m" if site.relief.amplitude else ""
    )
    return (
        f"In no map, but drawn at random: {describe_things(drawn)}{ground}. They hide road "
        "users as real ones would, and other things stand there in truth."
    )


def _describe_codec(question: Question) -> str:
    codec = scheme_codec(question.setting.fusion, question.setting.codec)
    if codec == PAPER:
        return (
            "count 96 bits for a point and 256 for a box, as the paper does, without headers or "
            "compression"
        )
    return (
        f"are of messages as {codec.digest} writes them: as expected in searches, as sent in "
        "judgements"
    )


def _describe_errors(question: Question) -> str:
    cases = question.cases
    if cases.noise_only:
        return "Poses are exact: no calibration error, no sway of poles, no clocks that differ."
    terms = [
        ", ".join(dict.fromkeys(type(term).__name__ for term in each.terms))
        for each in cases.profiles
    ]
    which = " and ".join(
        f"of profile {name} ({words})" for name, words in zip(cases.names, terms, strict=True)
    )
    first = (
        f" The AP by which they are compared is that {cases.describe_errors()}; every other "
        f"figure of the report, kbit and pictures are with profile {cases.names[0]}, the first "
        "one given, unless another stands beside it."
    )
    return (
        f"Sets are compared and judged with the sensors' errors {which}, drawn anew for every 4 "
        "frames as if the sensors were mounted again; searches, and the kbit they weigh, know "
        f"the noise of the sensors' models alone.{first if len(cases.names) > 1 else ''}"
    )


def list_unknowns(final: Judgement, levels: Sequence[BreakdownRow] = ()) -> tuple[str, ...]:
    """Questions that the plan cannot answer. levels: of traffic."""
    lines = [
        "How the detector does on real measurements of this place.",
        "Whether a set that no search looked at would do better: nothing is proven optimal.",
        "Rain, fog, dirt, glare, and what grows, parks or is built there later.",
        "Power, permits, and what it costs to run the sensors.",
    ]
    few = [
        f"{row.name} ({row.judged.vehicles})"
        for row in levels
        if row.judged and row.judged.vehicles < FEWEST_AT_LEVEL
    ]
    if few:
        why = f"fewer than {FEWEST_AT_LEVEL} to find say little; increase --frames"
        lines.append(f"What holds at {join_names(few)}: {why}.")
    if math.isnan(final.low):
        lines.append(f"How far AP {final.format_ap()} may be off: {final.describe_interval()}.")
    return tuple(lines)
