"""The first page of a report: the decision in words that an operator knows, with one map."""

import math
from collections import Counter

from placement_env.analysis.intervals import (
    AP_TOLERANCE,
    BLOCK_FRAMES,
    FEWEST_BLOCKS,
    describe_sureness,
    frames_for_width,
)
from placement_env.cases import iou_text
from placement_env.classes import join_names
from placement_env.handover.ground import Ground
from placement_env.handover.mounted import RATE, describe_narrow_links
from placement_env.links import describe_share
from placement_env.report import content
from placement_env.report.maps import plan_view
from placement_env.report.pages.document import (
    Bullets,
    Content,
    Drawing,
    Fact,
    Facts,
    Paragraph,
    interval_text,
    number,
    percent,
    price_text,
    say,
)
from placement_env.search.order import describe_money
from toolkit.display import describe_count
from toolkit.sensors.models import MODELS
from toolkit.sites.site import Site
from toolkit.sites.surroundings import describe_things

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
USUAL_WIDTH = 0.02  # of an interval that is narrow
MOST_STREETS = 3  # with blind spots, by name
MOST_KINDS = 5  # of drawn things, by name
NOT_PRICED = (
    "power",
    "cable",
    "data links",
    "permit",
    "traffic management during the works",
    "upkeep",
)


def decision_section(plan: content.Plan, site: Site, ground: Ground | None) -> Content:
    """Answer the question on one page: what to build, what it does, how sure that is, and what
    comes next."""
    chosen = plan.chosen
    if chosen is None:
        return say(
            plan.verdict.sentence,
            *((Bullets(plan.verdict.reasons),) if plan.verdict.reasons else ()),
        )
    facts = (
        _describe_requirement(plan),
        *_describe_classes(plan),
        _describe_blind(plan),
        _describe_failure(plan),
    )
    facts = (
        *facts,
        _describe_links(plan),
        *_describe_confidence(plan, chosen),
        _describe_drawn(plan),
    )
    facts = (*facts, _describe_price(plan), _describe_next(plan, chosen))
    mounts = {mount.name for mount in site.mounts}
    poles, free = ([n for n in names if n in mounts] for names in (_poles(plan), plan.poles_unused))
    stay = "stays" if len(plan.poles_unused) == 1 else "stay"
    view = Drawing(
        plan_view(site, site.sensors, poles, free, ground),
        f"{describe_count(len(plan.sensors), 'sensor')} on "
        f"{describe_count(len(_poles(plan)), 'pole')}; "
        f"{describe_count(len(plan.poles_unused), 'pole')} that could carry one {stay} free.",
        (
            f"The site from above with the sensors {join_names(chosen.sensors)}, their poles, and "
            "the ground each sees"
        ),
    )
    return say(
        _describe_build(plan, chosen),
        Facts(tuple(filter(None, facts))),
        view,
        Paragraph(_explain(plan)),
    )


def _poles(plan: content.Plan) -> list[str]:
    return list(dict.fromkeys(sensor.pole for sensor in plan.sensors))


def count_sensors(count: int, model: str) -> str:
    """Write a number of sensors of a model: kinds have a plural, names of products have none.

    >>> count_sensors(2, "depth-camera"), count_sensors(2, "Ouster OS1")
    ('2 depth cameras', '2 × Ouster OS1')
    """
    if model.replace(" ", "-") in MODELS:
        return describe_count(count, model.replace("-", " "))
    return f"{count} × {model}"


def _describe_build(plan: content.Plan, chosen: content.PlanOption) -> str:
    models = Counter(sensor.model for sensor in plan.sensors)
    things = join_names([count_sensors(count, model) for model, count in models.items()])
    poles = _poles(plan)
    money = plan.question.get("money")
    where = f"on {'pole' if len(poles) == 1 else 'poles'} {join_names(poles)}"
    if len(poles) < len(plan.sensors):
        where = f"on {describe_count(len(poles), 'pole')}: {join_names(poles)}"
    most = plan.question.get("sensors")
    limits = (
        [f"at most {price_text(money, plan.currency)}"] if isinstance(money, int | float) else []
    )
    limits += [f"at most {describe_count(most, 'sensor')}"] if isinstance(most, int) else []
    allowed = f" Allowed were {' and '.join(limits)}." if limits else ""
    if isinstance(keep := plan.question.get("keep"), list) and keep:
        allowed += f" {join_names(keep)} had to carry a sensor, as asked."
    cost = describe_money(chosen.price, plan.currency)
    price = f"The price is {cost if plan.currency else cost.replace('the price', 'that', 1)}."
    narrow = describe_narrow_links(plan.links, plan.link_share)
    answer = f"Build {things} {where}. {price}{allowed}{_compare_with_best(plan, chosen)}"
    return f"{narrow} With wider links: {answer[0].lower()}{answer[1:]}" if narrow else answer


def _compare_with_best(plan: content.Plan, chosen: content.PlanOption) -> str:
    """Say what more money would have bought where the answer is not the best set."""
    best = plan.best
    if best is None or best.sensors == chosen.sensors or best.price <= chosen.price:
        return ""
    more = price_text(best.price - chosen.price, plan.currency)
    count = describe_count(len(best.sensors), "sensor").capitalize()
    return (
        f" {count} for {more} more would find hardly more: surely less than {AP_TOLERANCE:g} of AP."
    )


def _describe_requirement(plan: content.Plan) -> Fact | None:
    if plan.verdict.met is None:
        return None
    return Fact(
        "Asked for",
        " ".join((plan.verdict.sentence, *plan.verdict.reasons)),
        alarm=not plan.verdict.met,
    )


def _describe_classes(plan: content.Plan) -> tuple[Fact, ...]:
    """Describe what is found of each class that counts, and name in red the classes that do not."""
    lines = [f"{_count_found(row)}." for row in plan.class_ap if row.weight]
    if not lines:
        return ()
    lines.append("A road user counts once in every frame in which it is in the area.")
    judged = {row.label for row in plan.class_ap}
    missing = [_count_found(row) for row in plan.class_ap if not row.weight]
    present = [row for row in plan.by_class if row.objects and row.label not in judged]
    unknown = [f"{row.objects:,} {PLURALS[row.label]}" for row in present]
    said = [f"Also found, but not counted in the choice: {'. '.join(missing)}."] if missing else []
    said += (
        [f"The detector does not know {join_names(unknown)} that crossed the area."]
        if unknown
        else []
    )
    return Fact("Finds", " ".join(lines)), *(
        (Fact("Does not count", " ".join(said), alarm=True),) if said else ()
    )


def _count_found(row: content.ClassAP) -> str:
    """Count what is found, missed and reported in error of one class."""
    each = row.judged
    found = round(each.recall * each.vehicles)
    text = (
        f"{found:,} of {each.vehicles:,} {PLURALS[row.label]}; {each.vehicles - found:,} are missed"
    )
    if each.precision:
        false = round(found / each.precision - found)
        text += f", and {false or 'no'} {'report is' if false == 1 else 'reports are'} false"
    return text


def _describe_blind(plan: content.Plan) -> Fact | None:
    if plan.ground is None:
        return None
    streets = list(plan.blind_streets.items())
    named = [f"{name} ({area:,.0f} m²)" for name, area in streets[:MOST_STREETS]]
    others = sum(area for _, area in streets[MOST_STREETS:])
    named += [f"elsewhere ({others:,.0f} m²)"] if others >= 0.5 else []
    share = percent(plan.ground.blind_lanes)
    lanes = f"{share[0].upper()}{share[1:]} of the lanes is out of every sensor's sight"
    lanes = f"{lanes}: {join_names(named)}." if named else f"{lanes}."
    return Fact("Blind", f"{lanes} Of all open ground, {percent(plan.ground.blind)} is unseen.")


def _describe_failure(plan: content.Plan) -> Fact:
    alone = [case for case in plan.failures if len(case.failed) == 1]
    if not alone:
        return Fact(
            "One failure", "There is no second sensor: if it fails, nothing is found.", alarm=True
        )
    worst = min(alone, key=lambda case: case.judged.recall)
    left = f"{round(worst.judged.recall * worst.judged.vehicles):,} of {worst.judged.vehicles:,}"
    case = (
        "whichever sensor fails"
        if len({c.judged.recall for c in alone}) == 1
        else f"if {worst.failed[0]} fails"
    )
    return Fact("One failure", f"At worst, {case}, {left} are still found.")


def _describe_links(plan: content.Plan) -> Fact | None:
    if not plan.links:
        return None
    narrow = [each.pole for each in plan.links if not each.fits]
    full = max(plan.links, key=lambda each: each.share)
    load = (
        f"{number(full.load_mbit_s, 2)} of {number(full.capacity_mbit_s, 2)} Mbit/s at {RATE:g} "
        "frames a second"
    )
    less = _describe_cheaper_scheme(plan)
    if narrow:
        return Fact(
            "Links",
            f"Too narrow at {join_names(narrow)}; {full.pole} needs {load}.{less}",
            alarm=True,
        )
    frames = describe_share(plan.link_share)
    return Fact(
        "Links", f"Every link carries {frames}. The fullest, {full.pole}, needs {load}.{less}"
    )


def _describe_cheaper_scheme(plan: content.Plan) -> str:
    """Name the scheme that sends least of those as good as the plan's own."""
    rows = [row for row in plan.schemes if row.iou == plan.iou]
    own = next((row for row in rows if row.scheme == plan.scheme), None)
    least = min(
        (row for row in rows if row.as_good), key=lambda row: row.kbit_per_sensor, default=own
    )
    if own is None or least is None or least.kbit_per_sensor >= own.kbit_per_sensor:
        return ""
    sent = " instead of ".join(number(row.kbit_per_sensor, 1) for row in (least, own))
    found = f"AP {least.judged.format_ap()} instead of {own.judged.format_ap()}"
    as_well = f" {SENDS[least.scheme]} would do as well: {found}"
    return f"{as_well}, for {sent} kbit per sensor and frame (--scheme {least.scheme})."


def _describe_confidence(plan: content.Plan, chosen: content.PlanOption) -> tuple[Fact, ...]:
    judged = chosen.counted
    if judged is None:
        return (Fact("How sure", "The detector did not judge this set.", alarm=True),)
    ends = f"{content.CONFIDENCE:.0%} interval {interval_text(judged)}"
    lines = [
        f"AP {judged.format_ap()}, {'no interval' if math.isnan(judged.low) else ends}, from "
        f"{describe_count(judged.frames, 'frame')} of simulated traffic; nothing was measured on "
        "the street.",
        _say_frames(plan, judged),
    ]
    if plan.confidence is not None:
        lines.append(
            f"{describe_sureness(plan.confidence)} sure that no other set that was compared, of "
            f"as many sensors, is better by more than {AP_TOLERANCE:g}."
        )
    lines.append("A recording from the site would test the detector itself.")
    drawn = [
        f"Mounted anew {len(each.aps)} times with errors of profile {each.profile}, the sensors "
        f"reach AP {plan.format_drawn_ap(each.mean, each)} on average; one time in ten it falls "
        f"below {plan.format_drawn_ap(each.tenth, each)}."
        for each in plan.by_draw
    ]
    return Fact("How sure", " ".join(filter(None, lines))), *(
        (Fact("Mounting", " ".join(drawn)),) if drawn else ()
    )


def _say_frames(plan: content.Plan, judged: content.Judgement) -> str:
    """Say how many frames would narrow the interval."""
    asked = plan.question.get("width")
    width = asked if isinstance(asked, float) else USUAL_WIDTH
    ends = judged.high - judged.low
    if math.isnan(ends):
        return f"An interval needs {FEWEST_BLOCKS * BLOCK_FRAMES} --frames or more."
    if ends <= width:
        return ""
    frames = frames_for_width(judged.frames, ends, width)
    return f"Some {frames:,} frames would narrow it to {width:g} (--width {width:g})."


def _describe_drawn(plan: content.Plan) -> Fact | None:
    drawn = plan.origins.get("drawn", {})
    if not drawn:
        return None
    common = sorted(drawn, key=lambda kind: -drawn[kind])[:MOST_KINDS]
    others = sum(drawn.values()) - sum(drawn[kind] for kind in common)
    things = describe_things({kind: drawn[kind] for kind in common}) + (
        f" and {others} other things" if others else ""
    )
    text = (
        f"Drawn at random, in no map: {things}. They hide road users; survey what really stands "
        "there."
    )
    return Fact("Not surveyed", f"{text} {_describe_drawings(plan)}", alarm=True)


def _describe_drawings(plan: content.Plan) -> str:
    """Say which poles are in the answer however the unknown things are drawn."""
    if not plan.by_drawing:
        return "With --drawings 3 the plan says which poles depend on them."
    count = len(plan.by_drawing)
    judged = [each.judged for each in plan.by_drawing]
    lowest, highest = (pick(judged, key=lambda each: each.ap) for pick in (min, max))
    kept = [
        f"{pole} in {sum(pole in each.poles for each in plan.by_drawing)}" for pole in _poles(plan)
    ]
    return (
        f"Planned for each of {count} drawings alone, the answer would use {join_names(kept)}. "
        f"This set has AP {lowest.format_ap()} to {highest.format_ap()} at them."
    )


def _describe_price(plan: content.Plan) -> Fact:
    sold = "" if plan.currency else " Sensors cost nothing here, because no catalogue was given."
    rated = {item.item.split(" ")[0] for item in plan.running}
    missing = join_names([name for name in NOT_PRICED if name not in rated])
    beside = ""
    if plan.running:
        total = price_text(sum(item.price for item in plan.running), plan.currency)
        beside = (
            f"Beside it, {total}: {join_names([item.item for item in plan.running])}. Not known: "
        )
    text = f"{beside}{missing}.{sold}"
    return Fact("Not in the price", f"{text[0].upper()}{text[1:]}")


def _describe_next(plan: content.Plan, chosen: content.PlanOption) -> Fact:
    first = plan.order[0].sensor if plan.order else chosen.sensors[0]
    counted = {each.label for each in plan.class_ap if each.weight}
    missing = any(row.objects for row in plan.by_class if row.label not in counted)
    again = "Plan again with --classes for all road users that matter. " if missing else ""
    return Fact(
        "Next",
        f"{again}Check the poles, their heights and the view from each on site. Mount {first} "
        "first, record a day, and hold the detector against it with coview evaluate. To move "
        "sensors by hand, run: coview live FOLDER, with the folder of this report.",
    )


def _explain(plan: content.Plan) -> str:
    return (
        "AP (average precision) rates from 0 to 1 how well road users are found: 1 means that "
        "every one is found and nothing else is reported. IoU (intersection over union) is the "
        "share that a reported box and the true one have in common; a find needs "
        f"{iou_text(plan.iou)}. A kbit is a thousand bits, stated per sensor and frame."
    )
