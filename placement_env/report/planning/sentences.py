"""Sentences of a plan: verdict, why this set, assumptions and unknowns."""

import math
from collections.abc import Sequence

from placement_env.analysis.intervals import BLOCK_FRAMES
from placement_env.cases import iou_text
from placement_env.classes import join_names
from placement_env.defaults import VEHICLES
from placement_env.handover.mounted import FRAME_RATE_HZ, PoleLoad, describe_narrow_links
from placement_env.report.content import TEXTS, BreakdownRow, Judgement, Plan, PlanOption, Verdict
from placement_env.report.planning.choice import Rule
from placement_env.report.planning.question import PART_FRAMES, Question
from placement_env.report.planning.sampled_judge import sample_frames
from placement_env.search.description import MIN_LEVEL_OBJECTS
from placement_env.search.exclusions import describe_money
from placement_env.search.first_look import describe_first_frames
from toolkit.detection.codec import PAPER
from toolkit.detection.scheme import scheme_codec
from toolkit.display import describe_count
from toolkit.objects import LABELS
from toolkit.sites.site import Site
from toolkit.sites.surroundings.things import count_things, describe_things
from toolkit.traffic.spawner import LIFE

MIN_OVERRATED_SETS = 3  # judged sets needed to measure by how much predictions overrate


def describe_cases(question: Question) -> str:
    """Describe the cases of the compared AP, "" for the usual cases.

    The words come between commas, for use in the middle of a sentence: ", at the worst of 3 levels
    of traffic,"."""
    cases = question.cases
    words = []
    if cases.failing:
        words.append(cases.describe_failures())
    if cases.levels > 1:
        words.append(cases.describe_levels())
    if len(cases.names) > 1:
        words.append(cases.describe_errors())
    return f", {', '.join(words)}," if words else ""


def build_verdict(
    question: Question,
    compared: PlanOption,
    final: PlanOption,
    excluded: tuple[str, ...],
    rule: Rule = "best",
    *,
    links: Sequence[PoleLoad] = (),
) -> Verdict:
    """State the answer in words.

    Without a required AP the verdict has no `met`. Otherwise it is met if the AP of the final
    traffic reaches it, and gives reasons if not. Links that are too narrow are named first. Raises
    ValueError for a set that is not judged.

    Args:
        question: The question.
        compared: The chosen set with its figures from the comparison.
        final: The same set with its figures on the final traffic.
        excluded: Sentences on what excludes candidates.
        rule: Reason for the choice (`Choice.rule`).
        links: Loads of the poles' links in the final traffic."""
    judgement = final.counted
    if judgement is None:
        raise ValueError("the chosen set is not judged: judge it first")
    count = describe_count(len(final.sensors), "sensor")
    price = describe_money(final.price, question.currency)
    vehicles = describe_count(judgement.vehicles, judgement.kind)
    frames = describe_count(judgement.frames, "frame")
    interval = judgement.describe_interval()
    if not math.isnan(judgement.low):
        interval = f"95 % interval {interval}"
    result = (
        f"AP {judgement.format_ap()} ({interval}, {vehicles} in "
        f"{frames}){describe_cases(question)} at IoU {iou_text(question.cases.threshold)} with "
        f"{count} for {price}"
    )
    min_ap = question.min_ap
    narrow_links = describe_narrow_links(links, question.setting.link_share)
    links_before = f"{narrow_links} " if narrow_links else ""
    if min_ap is None:
        answer_text = (
            "cheapest set that cannot be told from the best" if rule == "as good" else "best set"
        )
        sentence = f"The {answer_text} found within the budget has {result}."
        return Verdict(met=None, sentence=f"{links_before}{sentence}")
    if judgement.ap >= min_ap:
        certainty = "the interval reaches below it, so more traffic may say otherwise"
        if judgement.low >= min_ap:
            certainty = "the whole interval lies above it"
        sentence = f"The requirement of AP {min_ap:g} is met: {result}; {certainty}."
        return Verdict(met=True, sentence=f"{links_before}{sentence}")
    reasons = explain_shortfall(question, compared, judgement, excluded)
    if narrow_links:
        reasons = (narrow_links, *reasons)
    sentence = f"The requirement of AP {min_ap:g} is not met: the best set found has {result}."
    return Verdict(met=False, sentence=sentence, reasons=reasons)


def explain_shortfall(
    question: Question, best: PlanOption, final: Judgement, excluded: tuple[str, ...]
) -> tuple[str, ...]:
    """Explain in sentences why the required AP is not reached.

    Args:
        question: The question, which must have a required AP.
        best: Best set in the comparison.
        final: Result of the same set in the final traffic.
        excluded: Sentences on what excludes candidates, which come last."""
    price = describe_money(best.price, question.currency)
    compared_ap = ""
    if best.counted:
        compared_ap = f" and {best.counted.format_ap()} in the traffic it was chosen on"
    reasons = [
        f"The best set found, {describe_count(len(best.sensors), 'sensor')} for {price}, has AP "
        f"{final.format_ap()} ({final.describe_interval()}){describe_cases(question)} on "
        f"{describe_count(final.vehicles, final.kind)} in the final traffic{compared_ap}; "
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
    chosen_option: PlanOption,
    rule: Rule,
    *,
    considered: int,
    fidelity: str,
) -> tuple[str, ...]:
    """Explain in sentences with figures why this set was chosen.

    Args:
        question: The question.
        plan: The plan with compared sets, schemes and failures.
        chosen_option: The chosen set with its figures from the comparison.
        rule: Reason for the choice (`Choice.rule`).
        considered: Number of sets that the searches scored.
        fidelity: Name of the estimate that the searches scored sets by."""
    judged_text = plan.describe_judged("best of these on all of it")
    search_names = " and ".join(chosen_option.searches) or "a neighbour of a search's answer"
    compared_judgement = chosen_option.counted
    lines = [
        f"{considered:,} sets were scored by the {fidelity}, a quick estimate; "
        f"{len(plan.considered)} of them were compared by the detector on traffic that no search "
        f"saw, the {judged_text}.",
        TEXTS["rules"][rule],
    ]
    if cases := describe_cases(question).strip(", "):
        lines.append(
            "The AP by which sets are compared is "
            f"{'' if question.cases.failing else 'that '}{cases}."
        )
    score = "coverage" if fidelity == "coverage" else "predicted AP"
    figures = ""
    if compared_judgement is not None:
        figures = (
            f"; its {score} is {_describe_prediction(plan, chosen_option, fidelity)}, "
            f"its AP among the judged sets {compared_judgement.format_ap()} "
            f"({compared_judgement.describe_interval()})"
        )
    lines.append(f"It comes from {search_names}{figures}.")
    if rule == "as good" and compared_judgement is not None:
        lines += _describe_best(plan, compared_judgement, question.currency)
    if rule in ("best", "as good"):
        lines.append(_describe_near_sets(len(plan.near_optimal)))
    lines += _describe_other_schemes(plan)
    single_failures = [case for case in plan.failures if len(case.failed) == 1]
    if single_failures:
        worst = min(single_failures, key=lambda case: case.judged.ap)
        lines.append(
            f"The failure of {worst.failed[0]} hurts most: AP {worst.judged.format_ap()} is left."
        )
    return tuple(lines)


def _describe_best(plan: Plan, chosen: Judgement, currency: str) -> list[str]:
    """Return a sentence that compares the best set with the chosen one; empty if it is not judged.

    chosen: result of the chosen set in the comparison; currency: "" for prices in ordinary
    poles."""
    best = plan.best
    if best is None or best.counted is None:
        return []
    count = describe_count(len(best.sensors), "sensor")
    price = describe_money(best.price, currency)
    gain = best.counted.ap - chosen.ap
    return [f"The best set, {count}, has AP {best.counted.format_ap()} for {price}, {gain:+.3f}."]


def _describe_near_sets(count: int) -> str:
    """Return a sentence on how many other sets are as good as the best. count: their number."""
    other_sets = "No other is"
    if count:
        other_sets = f"{describe_count(count, 'other judged set')} {'is' if count == 1 else 'are'}"
    return f"{other_sets} surely within 0.01 of the best on the same frames."


def _describe_other_schemes(plan: Plan) -> list[str]:
    """Return a sentence that compares the planned fusion scheme with the others.

    It has their AP and kbit at the plan's IoU. The list is empty if the plan lacks figures of other
    schemes."""
    rows = [row for row in plan.schemes if row.iou == plan.iou]
    planned_row = next((row for row in rows if row.scheme == plan.scheme), None)
    other_schemes = ", ".join(
        f"{row.scheme} {row.judged.format_ap()} for {row.kbit_per_sensor:.1f} kbit"
        for row in rows
        if row is not planned_row
    )
    if planned_row is None or not other_schemes:
        return []
    return [
        f"{plan.scheme.capitalize()} fusion gives AP {planned_row.judged.format_ap()} for "
        f"{planned_row.kbit_per_sensor:.1f} kbit per sensor and frame; with the same sensors: "
        f"{other_schemes}."
    ]


def _describe_prediction(plan: Plan, chosen_option: PlanOption, fidelity: str) -> str:
    """State the predicted AP of the chosen set, less the mean error on the judged sets.

    Nothing is deducted from coverage, which is no AP, with fewer than `MIN_OVERRATED_SETS` judged
    sets, or if predictions do not overrate them on average.

    fidelity: name of the estimate that predicts, such as "coverage"."""
    predicted = chosen_option.predicted
    errors = [  # above 0 if the prediction was too high
        option.predicted - option.counted.ap
        for option in plan.considered
        if option.counted is not None
    ]
    if fidelity == "coverage" or len(errors) < MIN_OVERRATED_SETS:
        return f"{predicted:.3f}"
    mean_error = sum(errors) / len(errors)
    if mean_error <= 0:
        return f"{predicted:.3f}"
    return (
        f"{predicted - mean_error:.3f} ({mean_error:.3f} deducted, by which predictions "
        "overrate the judged sets)"
    )


def list_assumptions(
    question: Question, fidelity: str, detector: str, *, frames: int, sampled: bool
) -> tuple[str, ...]:
    """List in sentences the assumptions behind the figures.

    Args:
        question: The question.
        fidelity: Name of the estimate that the searches scored sets by.
        detector: Name of the detector.
        frames: Number of frames in which the chosen set was judged.
        sampled: True if that estimate, not the detector, scored subsets of the chosen set."""
    lines = [
        *_list_methods(question, detector),
        *_list_scoring_limits(question),
        *_list_stock_limits(question),
    ]
    if fidelity == "coverage":
        lines.append("There is no surrogate for this scheme and IoU, so searches went by coverage.")
    if question.drawings > 1:
        lines.append(
            f"Figures of whole sets are means over {question.drawings} drawings of what no map "
            "knows; zones, classes, schemes, kbit and pictures are of the first."
        )
    frame_count = len(sample_frames(frames))
    if frame_count < frames:
        lines.append(
            f"Failures, worth, order of building and other schemes were judged in {frame_count} of "
            f"the {frames} frames; their AP and shares found are the chosen set's in all frames, "
            "times the ratio in these. The same goes for compared sets of sizes that fall behind, "
            "next to the best compared set."
        )
    if sampled:
        lines.append(
            "For a set this large, the worth of each sensor and the order of building go by the "
            "fidelity of the searches."
        )
    return tuple(lines)


def _list_methods(question: Question, detector: str) -> list[str]:
    """List in sentences how traffic, AP, intervals, kbit and errors were computed."""
    cases = question.cases
    search_seed = question.part("search").seed
    comparison_seed = question.part("comparison").seed
    judgement_seed = question.part("judgement").seed
    return [
        "Traffic is simulated (SUMO) and measurements are ray-cast with the noise of the "
        "sensors' models; nothing was measured at the place itself.",
        describe_origins(question.site),
        f"AP is {_describe_objects(question)} centred in the detection area, by the detector "
        f"{detector} at IoU {iou_text(cases.threshold)} in {question.setting.fusion.name} fusion.",
        f"Searches, comparison and judgement each have their own traffic (seeds {search_seed}, "
        f"{comparison_seed} and {judgement_seed}): no AP stated for the chosen set is from traffic "
        "that it was searched or chosen on.",
        f"Intervals are from a bootstrap over blocks of {BLOCK_FRAMES} frames, two lives of an "
        "object, widened for few blocks; they hold for this detector in this kind of traffic, not "
        "for other weather, traffic or sensors.",
        f"kbit {_describe_codec(question)}; links are compared with them at {FRAME_RATE_HZ:g} "
        "frames a second.",
        _describe_errors(question),
    ]


def _describe_objects(question: Question) -> str:
    """Describe the classes over which AP is computed, to follow the words "AP is".

    Such as "the mean of 0.75 vehicle and 0.25 cyclist (IoU 0.5),"; an IoU is named if it is not the
    objective's."""
    classes = question.setting.counted
    if len(classes) > 1:
        return f"the {classes.described(question.cases.threshold)},"
    if classes.names == VEHICLES.names:
        return "of vehicles alone, heavy ones not counted,"
    return f"of {classes.names[0]} alone,"


def _list_scoring_limits(question: Question) -> list[str]:
    """List in sentences which IoU thresholds and classes the figures are for.

    Empty for a single threshold if all classes count."""
    ious = question.cases.ious
    lines = []
    if len(ious) > 1:
        iou_texts = ", ".join(f"{iou:g}" for iou in ious)
        lines.append(
            f"Every AP is the mean over IoU {iou_texts}, as in COCO, unless another IoU stands "
            f"beside it; pictures of single frames show hits at IoU {ious[0]:g}."
        )
    other_labels = [label for label in LABELS if label not in question.setting.counted.names]
    if other_labels:
        lines.append(
            f"{join_names(other_labels)} did not count in the choice; the AP stated for them is "
            "that of the same detections."
        )
    return lines


def _list_stock_limits(question: Question) -> list[str]:
    """List in sentences what prices leave out, and how many poses the search was narrowed to."""
    stock = question.stock
    lines = []
    if stock.catalogue is None:
        lines.append(
            "No catalogue was given: sensors cost nothing besides their poles, prices are in "
            "ordinary poles."
        )
    elif stock.catalogue.pole_price is None:
        lines.append(
            "The catalogue names no pole_price: the prices of poles are taken to be in "
            f"{question.currency or 'its unit'}."
        )
    if stock.only:  # names of the poses that were searched, empty for all
        # number of frames of the search, by default the usual one
        search_frames = question.part("search").frames_or(PART_FRAMES["search"])
        lines.append(
            f"The poles offer more poses than can be searched: the {len(stock.only):,} that see "
            f"most in the {describe_first_frames(search_frames)} went on."
        )
    return lines


def describe_origins(site: Site) -> str:
    """List in a sentence the things of a site that are in no map but drawn at random."""
    if site.road_origin == "drawn":
        return "Everything at the site is drawn at random, the road too: there is no such place."
    drawn_counts = count_things(site)["drawn"]  # number of drawn things by their kind
    drawn_counts.pop("pole", None)  # poles are places to build at, not obstacles
    if not drawn_counts:
        return (
            "Nothing at the site is marked as drawn; files from before there were marks have none."
        )
    ground = ""
    if site.relief.amplitude:
        ground = f", and ground uneven within {site.relief.amplitude:g} m"
    return (
        f"In no map, but drawn at random: {describe_things(drawn_counts)}{ground}. They hide road "
        "users as real ones would, and other things stand there in truth."
    )


def _describe_codec(question: Question) -> str:
    """Describe how kbit are counted, to follow the word "kbit"."""
    codec = scheme_codec(question.setting.fusion, question.setting.codec)
    if codec == PAPER:
        return (
            f"count {PAPER.bits_per_point:g} bits for a point and {PAPER.bits_per_box:g} for a "
            "box, as the paper does, without headers or compression"
        )
    return (
        f"are of messages as {codec.digest} writes them: as expected in searches, as sent in "
        "judgements"
    )


def _describe_errors(question: Question) -> str:
    """Describe in sentences the sensor errors that count in comparison and judgement.

    Searches, and the kbit that they weigh against AP, know only the noise of the sensors' models.
    `describe_errors` of the cases gives words such as "at the worst of the error profiles a and b",
    which follow "The AP by which they are compared is that"."""
    cases = question.cases
    if cases.noise_only:
        return "Poses are exact: no calibration error, no sway of poles, no clocks that differ."
    profile_texts = []
    for name, profile in zip(cases.names, cases.profiles, strict=True):
        terms = ", ".join(dict.fromkeys(type(term).__name__ for term in profile.terms))
        profile_texts.append(f"of profile {name} ({terms})")
    text = (
        f"Sets are compared and judged with the sensors' errors {' and '.join(profile_texts)}, "
        f"drawn anew for every {LIFE} frames as if the sensors were mounted again; searches, and "
        "the kbit they weigh, know the noise of the sensors' models alone."
    )
    if len(cases.names) > 1:
        text += (
            f" The AP by which they are compared is that {cases.describe_errors()}; every other "
            f"figure of the report, kbit and pictures are with profile {cases.names[0]}, the first "
            "one given, unless another stands beside it."
        )
    return text


def list_unknowns(final: Judgement, levels: Sequence[BreakdownRow] = ()) -> tuple[str, ...]:
    """List questions that the plan cannot answer.

    final: result of the chosen set on the final traffic; levels: its results by level of traffic;
    levels with too few objects are named."""
    lines = [
        "How the detector does on real measurements of this place.",
        "Whether a set that no search looked at would do better: nothing is proven optimal.",
        "Rain, fog, dirt, glare, and what grows, parks or is built there later.",
        "Power, permits, and what it costs to run the sensors.",
    ]
    sparse_levels = [
        f"{row.name} ({row.judged.vehicles})"
        for row in levels
        if row.judged and row.judged.vehicles < MIN_LEVEL_OBJECTS
    ]
    if sparse_levels:
        lines.append(
            f"What holds at {join_names(sparse_levels)}: fewer than {MIN_LEVEL_OBJECTS} to find "
            "say little; increase --frames."
        )
    if math.isnan(final.low):
        lines.append(f"How far AP {final.format_ap()} may be off: {final.describe_interval()}.")
    return tuple(lines)
