"""First page of a report: the decision in an operator's words, with one map."""

import math
from collections import Counter

from placement_env.analysis.intervals import (
    AP_TOLERANCE,
    BLOCK_FRAMES,
    MIN_BLOCKS,
    describe_sureness,
    frames_for_width,
)
from placement_env.cases import iou_text
from placement_env.classes import join_names
from placement_env.handover.ground import GroundGrid
from placement_env.handover.mounted import FRAME_RATE_HZ, describe_narrow_links, describe_radio
from placement_env.links import describe_share
from placement_env.report import content
from placement_env.report.maps import plan_view
from placement_env.report.pages.document import (
    Bullets,
    Content,
    Fact,
    Facts,
    PageDrawing,
    Paragraph,
    build_content,
)
from placement_env.report.pages.figure_texts import interval_text, number_text, percent, price_text
from placement_env.search.exclusions import describe_money
from toolkit.display import describe_count
from toolkit.sensors.models import MODELS
from toolkit.sites.site import Site
from toolkit.sites.surroundings.things import describe_things

PLURALS = {
    "vehicle": "vehicles",
    "cyclist": "cyclists",
    "pedestrian": "pedestrians",
    "heavy": "heavy vehicles",
}
SENDS = {
    "early": "Sending points",
    "late": "Sending boxes alone",
    "hybrid": "Sending boxes and distant points",
}
DEFAULT_WIDTH_AP = 0.02  # width of a narrow interval
MAX_STREETS = 3  # streets with blind spots that are named
MAX_DRAWN_KINDS = 5  # kinds of drawn things that are named
NOT_PRICED = (
    "power",
    "cable",
    "data links",
    "permit",
    "traffic management during the works",
    "upkeep",
)


def decision_section(plan: content.Plan, site: Site, ground: GroundGrid | None) -> Content:
    """Answer the question on one page: what to build, its results, their certainty, next steps.

    Without a chosen set the page gives the verdict and its reasons. site: site with the chosen
    sensors; ground: ground that they see, None if unknown."""
    chosen_option = plan.chosen
    if chosen_option is None:
        if not plan.verdict.reasons:
            return build_content(plan.verdict.sentence)
        return build_content(plan.verdict.sentence, Bullets(plan.verdict.reasons))
    # lines of the summary in their order, None for a line that is left out
    facts = [_describe_requirement(plan)]
    facts += _describe_classes(plan)
    facts += [_describe_blind_lanes(plan), _describe_failure(plan, chosen_option)]
    facts.append(_describe_links(plan))
    facts += _describe_confidence(plan, chosen_option)
    facts += [
        _describe_drawn_things(plan),
        _describe_other_costs(plan),
        _describe_next_steps(plan, chosen_option),
    ]
    return build_content(
        _describe_build(plan, chosen_option),
        Facts(tuple(filter(None, facts))),
        _draw_plan_view(plan, chosen_option, site, ground),
        Paragraph(_explain_figures(plan)),
    )


def _draw_plan_view(
    plan: content.Plan, chosen_option: content.PlanOption, site: Site, ground: GroundGrid | None
) -> PageDrawing:
    """Draw the map of the sensors and their poles, with its caption and text for screen readers.

    site: site with the chosen sensors; ground: ground that they see, None if unknown."""
    # only poles that the site has can be drawn
    site_poles = {mount.name for mount in site.mounts}
    poles = [name for name in _list_poles(plan) if name in site_poles]
    free_poles = [name for name in plan.poles_unused if name in site_poles]
    stay = "stays" if len(plan.poles_unused) == 1 else "stay"
    caption = (
        f"{describe_count(len(plan.sensors), 'sensor')} on "
        f"{describe_count(len(_list_poles(plan)), 'pole')}; "
        f"{describe_count(len(plan.poles_unused), 'pole')} that could carry one {stay} free."
    )
    alt = (
        f"The site from above with the sensors {join_names(chosen_option.sensors)}, their poles, "
        "and the ground each sees"
    )
    svg = plan_view(site, site.sensors, poles=poles, poles_unused=free_poles, ground=ground)
    return PageDrawing(svg, caption, alt)


def _list_poles(plan: content.Plan) -> list[str]:
    """List the poles in use, in the order of their first sensors."""
    return list(dict.fromkeys(sensor.pole for sensor in plan.sensors))


def count_sensors(count: int, model: str) -> str:
    """Write a number of sensors of a model, such as "2 depth cameras".

    The name of a kind of sensor gets a plural, the name of a product follows the number and ×.
    model: name of a kind (a key of `MODELS`, also with spaces) or of a product.

    >>> count_sensors(2, "depth-camera"), count_sensors(2, "Ouster OS1")
    ('2 depth cameras', '2 × Ouster OS1')
    """
    if model.replace(" ", "-") in MODELS:
        return describe_count(count, model.replace("-", " "))
    return f"{count} × {model}"


def _describe_build(plan: content.Plan, option: content.PlanOption) -> str:
    """Return the conclusion of the page: models to build, poles, price and limits.

    Links that are too narrow are named first. option: the chosen set."""
    model_counts = Counter(sensor.model for sensor in plan.sensors)
    models_text = join_names([count_sensors(count, name) for name, count in model_counts.items()])
    poles = _list_poles(plan)
    poles_text = f"on {'pole' if len(poles) == 1 else 'poles'} {join_names(poles)}"
    if len(poles) < len(plan.sensors):
        poles_text = f"on {describe_count(len(poles), 'pole')}: {join_names(poles)}"
    cost = describe_money(option.price, plan.currency)
    if not plan.currency:
        # "The price is" comes before it, so "price" must not be repeated
        cost = cost.replace("the price", "that", 1)
    limits = _describe_limits(plan)
    more_money = _compare_with_best(plan, option)
    answer = f"Build {models_text} {poles_text}. The price is {cost}.{limits}{more_money}"
    narrow_links = describe_narrow_links(plan.links, plan.link_share)
    if narrow_links:
        return f"{narrow_links} With wider links: {answer[0].lower()}{answer[1:]}"
    return answer


def _describe_limits(plan: content.Plan) -> str:
    """Describe the limits of money, sensors and poles that the question set, "" without any.

    The text begins with a space, to follow another sentence."""
    money = plan.question.get("money")
    max_sensors = plan.question.get("sensors")
    limits = []
    if isinstance(money, int | float):
        limits.append(f"at most {price_text(money, plan.currency)}")
    if isinstance(max_sensors, int):
        limits.append(f"at most {describe_count(max_sensors, 'sensor')}")
    text = f" Allowed were {' and '.join(limits)}." if limits else ""
    kept_poles = plan.question.get("keep")
    if isinstance(kept_poles, list) and kept_poles:
        text += f" {join_names(kept_poles)} had to carry a sensor, as asked."
    return text


def _compare_with_best(plan: content.Plan, option: content.PlanOption) -> str:
    """Describe what more money would have bought, "" if the answer is the best set.

    The text begins with a space, to follow another sentence. option: the chosen set."""
    best = plan.best
    if best is None or best.sensors == option.sensors or best.price <= option.price:
        return ""
    extra_price = price_text(best.price - option.price, plan.currency)
    count = describe_count(len(best.sensors), "sensor").capitalize()
    return (
        f" {count} for {extra_price} more would find hardly more: surely less than "
        f"{AP_TOLERANCE:g} of AP."
    )


def _describe_requirement(plan: content.Plan) -> Fact | None:
    """Return the verdict on the required AP, an alarm if it is not met; None without one."""
    if plan.verdict.met is None:
        return None
    text = " ".join((plan.verdict.sentence, *plan.verdict.reasons))
    return Fact("Asked for", text, alarm=not plan.verdict.met)


def _describe_classes(plan: content.Plan) -> tuple[Fact, ...]:
    """Describe what is found of each class that counts, and name other classes in an alarm.

    Empty if no class was judged."""
    # a class that does not count has the weight 0
    counted_texts = [f"{_describe_hits(row)}." for row in plan.class_ap if row.weight]
    if not counted_texts:
        return ()
    counted_texts.append("A road user counts once in every frame in which it is in the area.")
    facts = [Fact("Finds", " ".join(counted_texts))]
    alarms = []
    uncounted_texts = [_describe_hits(row) for row in plan.class_ap if not row.weight]
    if uncounted_texts:
        uncounted_text = ". ".join(uncounted_texts)
        alarms.append(f"Also found, but not counted in the choice: {uncounted_text}.")
    judged_labels = {row.label for row in plan.class_ap}
    unknown_rows = [row for row in plan.by_class if row.objects and row.label not in judged_labels]
    unknown_texts = [f"{row.objects:,} {PLURALS[row.label]}" for row in unknown_rows]
    if unknown_texts:
        names = join_names(unknown_texts)
        alarms.append(f"The detector does not know {names} that crossed the area.")
    if alarms:
        facts.append(Fact("Does not count", " ".join(alarms), alarm=True))
    return tuple(facts)


def _describe_hits(row: content.ClassAP) -> str:
    """Describe in numbers the hits, misses and false reports of one class.

    They are computed back from recall and precision, so they are rounded."""
    judgement = row.judged
    hits = round(judgement.recall * judgement.vehicles)
    text = (
        f"{hits:,} of {judgement.vehicles:,} {PLURALS[row.label]}; {judgement.vehicles - hits:,} "
        "are missed"
    )
    if judgement.precision:  # neither None nor 0
        false_reports = round(hits / judgement.precision - hits)
        reports_are = "report is" if false_reports == 1 else "reports are"
        text += f", and {false_reports or 'no'} {reports_are} false"
    return text


def _describe_blind_lanes(plan: content.Plan) -> Fact | None:
    """Describe the lanes that no sensor sees, with the streets that have most.

    None if the visible ground is unknown."""
    if plan.ground is None:
        return None
    streets = list(plan.blind_streets.items())  # name and area (m²), the largest first
    street_texts = [f"{name} ({area:,.0f} m²)" for name, area in streets[:MAX_STREETS]]
    other_area = sum(area for _, area in streets[MAX_STREETS:])
    if other_area >= 0.5:  # less would be written as 0 m²
        street_texts.append(f"elsewhere ({other_area:,.0f} m²)")
    share = percent(plan.ground.blind_lanes)
    lanes_text = f"{share[0].upper()}{share[1:]} of the lanes is out of every sensor's sight"
    if street_texts:
        lanes_text += f": {join_names(street_texts)}"
    blind_share = percent(plan.ground.blind)
    return Fact("Blind", f"{lanes_text}. Of all open ground, {blind_share} is unseen.")


def _describe_failure(plan: content.Plan, option: content.PlanOption) -> Fact:
    """Describe the failure of one sensor that leaves the lowest recall.

    The number is an estimate if failures were judged in a sample of the frames. A set of one sensor
    gets an alarm. option: the chosen set, judged in all frames."""
    single_failures = [case for case in plan.failures if len(case.failed) == 1]
    if not single_failures:
        return Fact(
            "One failure", "There is no second sensor: if it fails, nothing is found.", alarm=True
        )
    worst = min(single_failures, key=lambda case: case.judged.recall)
    intact = option.judged or worst.judged
    hits = round(worst.judged.recall * intact.vehicles)
    about = "" if worst.judged.frames == intact.frames else "about "
    different_recalls = {case.judged.recall for case in single_failures}
    condition = f"if {worst.failed[0]} fails"
    if len(different_recalls) == 1:
        condition = "whichever sensor fails"
    return Fact(
        "One failure",
        f"At worst, {condition}, {about}{hits:,} of {intact.vehicles:,} are still found.",
    )


def _describe_links(plan: content.Plan) -> Fact | None:
    """Describe the fullest link of all poles, in an alarm if any is too narrow.

    None if nothing is sent."""
    if not plan.links:
        return None
    narrow_poles = [link.pole for link in plan.links if not link.fits]
    fullest = max(plan.links, key=lambda link: link.share)
    needed_rate = number_text(fullest.load_mbit_s, 2)
    capacity = number_text(fullest.capacity_mbit_s, 2)
    load = f"{needed_rate} of {capacity} Mbit/s at {FRAME_RATE_HZ:g} frames a second"
    cheaper_scheme = _describe_cheaper_scheme(plan)
    radio = f"By radio, all sensors send {describe_radio(plan.links)}."
    if narrow_poles:
        text = (
            f"Too narrow at {join_names(narrow_poles)}; {fullest.pole} needs {load}. {radio}"
            f"{cheaper_scheme}"
        )
        return Fact("Links", text, alarm=True)
    frames = describe_share(plan.link_share)
    return Fact(
        "Links",
        f"Every link carries {frames}. The fullest, {fullest.pole}, needs {load}. {radio}"
        f"{cheaper_scheme}",
    )


def _describe_cheaper_scheme(plan: content.Plan) -> str:
    """Name the fusion scheme that sends the least among the schemes as good as the planned one.

    "" if no such scheme sends less than the planned one; otherwise the text begins with a space."""
    rows = [row for row in plan.schemes if row.iou == plan.iou]
    planned_row = next((row for row in rows if row.scheme == plan.scheme), None)
    good_rows = [row for row in rows if row.as_good]
    cheapest = min(good_rows, key=lambda row: row.kbit_per_sensor, default=planned_row)
    if (
        planned_row is None
        or cheapest is None
        or cheapest.kbit_per_sensor >= planned_row.kbit_per_sensor
    ):
        return ""
    ap_text = f"{cheapest.judged.format_ap()} instead of {planned_row.judged.format_ap()}"
    cheapest_kbit = number_text(cheapest.kbit_per_sensor, 1)
    planned_kbit = number_text(planned_row.kbit_per_sensor, 1)
    return (
        f" {SENDS[cheapest.scheme]} would do as well: AP {ap_text}, for {cheapest_kbit} instead of "
        f"{planned_kbit} kbit per sensor and frame (--scheme {cheapest.scheme})."
    )


def _describe_confidence(plan: content.Plan, option: content.PlanOption) -> tuple[Fact, ...]:
    """Describe the AP with its interval and certainty, then the AP over draws of sensor errors.

    option: the chosen set. Without draws of errors there is one fact."""
    judgement = option.counted
    if judgement is None:
        return (Fact("How sure", "The detector did not judge this set.", alarm=True),)
    interval = f"{content.CONFIDENCE:.0%} interval {interval_text(judgement)}"
    if math.isnan(judgement.low):
        interval = "no interval"
    sentences = [
        f"AP {judgement.format_ap()}, {interval}, from "
        f"{describe_count(judgement.frames, 'frame')} of simulated traffic; nothing was "
        "measured on the street.",
        _describe_needed_frames(plan, judgement),
    ]
    if plan.confidence is not None:
        sentences.append(
            f"{describe_sureness(plan.confidence)} sure that no other set that was compared, of "
            f"as many sensors, is better by more than {AP_TOLERANCE:g}."
        )
    sentences.append("A recording from the site would test the detector itself.")
    draw_texts = [
        f"Mounted anew {len(draws.aps)} times with errors of profile {draws.profile}, the sensors "
        f"reach AP {plan.format_drawn_ap(draws.mean, draws)} on average; one time in ten it falls "
        f"below {plan.format_drawn_ap(draws.tenth, draws)}."
        for draws in plan.by_draw
    ]
    certainty = Fact("How sure", " ".join(filter(None, sentences)))  # without empty ones
    if not draw_texts:
        return (certainty,)
    return certainty, Fact("Mounting", " ".join(draw_texts))


def _describe_needed_frames(plan: content.Plan, judgement: content.Judgement) -> str:
    """Describe how many frames would narrow the interval to the requested or the usual width.

    "" if the interval is narrow enough. judgement: result with the interval."""
    question_width = plan.question.get("width")
    width = question_width if isinstance(question_width, float) else DEFAULT_WIDTH_AP
    interval_width = judgement.high - judgement.low
    if math.isnan(interval_width):
        return f"An interval needs {MIN_BLOCKS * BLOCK_FRAMES} --frames or more."
    if interval_width <= width:
        return ""
    frames = frames_for_width(judgement.frames, interval_width, width)
    return f"Some {frames:,} frames would narrow it to {width:g} (--width {width:g})."


def _describe_drawn_things(plan: content.Plan) -> Fact | None:
    """Describe in an alarm the most common things at the site that are in no map.

    They were drawn at random. None without any."""
    drawn_counts = plan.origins.get("drawn", {})  # number of things by their kind
    if not drawn_counts:
        return None
    common_kinds = sorted(drawn_counts, key=lambda kind: -drawn_counts[kind])[:MAX_DRAWN_KINDS]
    other_count = sum(drawn_counts.values()) - sum(drawn_counts[kind] for kind in common_kinds)
    things = describe_things({kind: drawn_counts[kind] for kind in common_kinds})
    if other_count:
        things += f" and {other_count} other things"
    text = (
        f"Drawn at random, in no map: {things}. They hide road users; survey what really stands "
        "there."
    )
    return Fact("Not surveyed", f"{text} {_describe_drawings(plan)}", alarm=True)


def _describe_drawings(plan: content.Plan) -> str:
    """Describe in how many drawings of the unknown things each pole would be in the answer.

    If the site was drawn only once, the text names the option that draws more."""
    if not plan.by_drawing:
        return "With --drawings 3 the plan says which poles depend on them."
    drawing_count = len(plan.by_drawing)
    judgements = [drawing.judged for drawing in plan.by_drawing]
    lowest = min(judgements, key=lambda judgement: judgement.ap)
    highest = max(judgements, key=lambda judgement: judgement.ap)
    pole_texts = []
    for pole in _list_poles(plan):
        # number of drawings at which the answer uses this pole
        use_count = sum(pole in drawing.poles for drawing in plan.by_drawing)
        pole_texts.append(f"{pole} in {use_count}")
    return (
        f"Planned for each of {drawing_count} drawings alone, the answer would use "
        f"{join_names(pole_texts)}. This set has AP {lowest.format_ap()} to "
        f"{highest.format_ap()} at them."
    )


def _describe_other_costs(plan: content.Plan) -> Fact:
    """Describe the costs outside the price: amounts of the catalogue's rates, and unknown costs."""
    sensor_note = ""
    if not plan.currency:
        sensor_note = " Sensors cost nothing here, because no catalogue was given."
    # names of items begin with their rate, such as "power"
    rate_names = {item.item.split(" ")[0] for item in plan.running}
    unknown_costs = join_names([name for name in NOT_PRICED if name not in rate_names])
    rates_text = ""
    if plan.running:
        total = price_text(sum(item.price for item in plan.running), plan.currency)
        items = join_names([item.item for item in plan.running])
        rates_text = f"Beside it, {total}: {items}. Not known: "
    text = f"{rates_text}{unknown_costs}.{sensor_note}"
    return Fact("Not in the price", f"{text[0].upper()}{text[1:]}")


def _describe_next_steps(plan: content.Plan, option: content.PlanOption) -> Fact:
    """Describe what to do next, first on site.

    If road users of classes that do not count were there, planning again comes first.

    option: the chosen set, whose first sensor is mounted first if no order of building is known."""
    first_sensor = plan.order[0].sensor if plan.order else option.sensors[0]
    counted_labels = {class_ap.label for class_ap in plan.class_ap if class_ap.weight}
    has_uncounted = any(row.objects for row in plan.by_class if row.label not in counted_labels)
    plan_again = ""
    if has_uncounted:
        plan_again = "Plan again with --classes for all road users that matter. "
    return Fact(
        "Next",
        f"{plan_again}Check the poles, their heights and the view from each on site. Mount "
        f"{first_sensor} first, record a day, and hold the detector against it with coview "
        "evaluate. To move sensors by hand, run: coview live FOLDER, with the folder of this "
        "report.",
    )


def _explain_figures(plan: content.Plan) -> str:
    """Explain AP, IoU and kbit."""
    return (
        "AP (average precision) rates from 0 to 1 how well road users are found: 1 means that "
        "every one is found and nothing else is reported. IoU (intersection over union) is the "
        "share that a reported box and the true one have in common; a find needs "
        f"{iou_text(plan.iou)}. A kbit is a thousand bits, stated per sensor and frame."
    )
