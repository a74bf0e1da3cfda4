"""Sections on what to build: the answer, the chosen set and its rivals, links, materials, mounting and the method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from placement_env.cases import iou_text
from placement_env.handover.ground import Ground
from placement_env.handover.mounted import RATE
from placement_env.report.charts import front_chart, link_chart
from placement_env.report.content import CONFIDENCE, Plan, PlanOption
from placement_env.report.maps import plan_view
from placement_env.report.pages.document import (
    Bullets,
    Column,
    Content,
    Drawing,
    Paragraph,
    ReportBlock,
    SceneView,
    TableBlock,
    number,
    say,
    table,
)
from placement_env.report.pages.wording import (
    JUDGED_COLUMNS,
    ap_figure,
    ap_text,
    count_text,
    in_percent,
    join_names,
    judged_cells,
    percent,
    price_column,
    price_text,
    text_columns,
)
from toolkit.sites.site import Site


def requirement_section(plan: Plan) -> Content:
    """Answer to the question, with obstacles and reading help."""
    obstacles = (Paragraph("What stands in the way:"), Bullets(plan.verdict.reasons)) if plan.verdict.reasons else ()
    help_text = (
        "AP (average precision) rates from 0 to 1 how well the detector finds vehicles: 1 means that it finds "
        "every vehicle and reports none that is not there. A vehicle counts as found if the intersection of the "
        f"reported box and the true box is at least {iou_text(plan.iou)} of their union (IoU). Every AP comes with "
        f"an interval, which contains it with {CONFIDENCE:.0%} confidence, and with the number of vehicles it was "
        "measured on: few vehicles make a wide interval. Every AP was measured on traffic that the search for the "
        "best set never saw. A kbit is a thousand bits; data are stated per sensor and frame, at ten frames a "
        "second."
    )
    asked = [(str(key).replace("_", " "), value_text(value)) for key, value in plan.question.items()]
    question = table("The question that this plan answers", text_columns("Asked", "Value"), asked)
    return say(plan.verdict.sentence, *obstacles, Paragraph(help_text), *question)


def value_text(value: object) -> str:
    """Value of the question or provenance, as readers write."""
    if value is None or value == "" or value == [] or value == () or value == {}:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {value_text(each)}" for key, each in value.items())
    return ", ".join(map(value_text, value)) if isinstance(value, list | tuple) else str(value)


def chosen_section(plan: Plan, chosen: PlanOption, site: Site, ground: Ground | None) -> Content:
    """The set to build, and why."""
    judged = f"the detector reaches {ap_text(chosen.judged)}" if chosen.judged else "the detector did not judge it"
    if chosen.counted is not None and chosen.counted is not chosen.judged:
        judged += f", and {ap_text(chosen.counted)} {_cases_text(chosen)}, as the question asks"
    conclusion = (
        f"Build {count_text(len(chosen.sensors), 'sensor')}, {join_names(chosen.sensors)}, for "
        f"{price_text(chosen.price, plan.currency)}: {judged}; each sensor sends {number(chosen.kbit_per_sensor, 0)} "
        f"kbit per frame with {plan.scheme} fusion."
    )
    mounts = {mount.name for mount in site.mounts}
    unused = [name for name in plan.poles_unused if name in mounts]
    poles = [sensor.pole for sensor in plan.sensors if sensor.pole in mounts]
    view = Drawing(
        plan_view(site, site.sensors, poles, unused, ground),
        f"{count_text(len(plan.sensors), 'sensor')} on {count_text(len({s.pole for s in plan.sensors}), 'pole')}; "
        f"{count_text(len(plan.poles_unused), 'pole')} that could carry one "
        f"{'stays' if len(plan.poles_unused) == 1 else 'stay'} free.",
        f"The site from above with the sensors {join_names(chosen.sensors)}, their poles, and the ground each sees",
    )
    scene = SceneView(
        "Drag to turn the junction, scroll to zoom; hide sensors and boxes with the switches.",
        "The junction in 3D, with points, vehicles and detections of some frames, is in report.html beside this file.",
    )
    return say(conclusion, *((Bullets(plan.why),) if plan.why else ()), view, scene)


def front_section(plan: Plan, chosen: PlanOption) -> Content:
    """Gain from more money or a faster link."""
    if len(plan.front) < 2:
        return say("No other set beats the chosen one in AP, data sent or price.")
    judged = [(option, option.counted) for option in plan.front if option.counted is not None]
    cheapest = price_text(min(each.price for each in plan.front), plan.currency)
    prices = f"the cheapest costs {cheapest}"
    if judged:
        best, ap = max(judged, key=lambda each: each[1].ap)
        highest = f"the highest AP, {ap_figure(ap)}, costs {price_text(best.price, plan.currency)}"
        prices = f"prices start at {cheapest}, and {highest}"
    drawing = Drawing(
        front_chart(plan.front, _when_compared(plan, chosen), plan.currency),
        f"The chosen set costs {price_text(chosen.price, plan.currency)} and sends "
        f"{number(chosen.kbit_per_sensor, 0)} kbit per sensor and frame.",
        "AP over kbit per sensor and over price for every set that no other beats in all three",
    )
    return say(
        f"No set beats these {len(plan.front)} in AP, data sent and price at once: {prices}.",
        *_explain_traffic(plan, chosen),
        drawing,
        *_option_table("Sets that no other beats in AP, kbit and price at once", plan, chosen, plan.front),
    )


def alternatives_section(plan: Plan, chosen: PlanOption) -> Content:
    """Sets that the measurements cannot tell from the chosen one."""
    close = plan.near_optimal
    if not close:
        return say("No other judged set has an interval that overlaps that of the chosen set.")
    cheaper = sum(each.price < chosen.price for each in close)
    conclusion = (
        f"The judged traffic cannot tell {count_text(len(close), 'other set')} from the chosen one, because the "
        f"intervals overlap; {cheaper or 'none'} of them {'is' if cheaper < 2 else 'are'} cheaper."
    )
    caption = "The chosen set and the sets whose interval overlaps its own"
    sets = _option_table(caption, plan, chosen, (_when_compared(plan, chosen), *close))
    return say(conclusion, *_explain_traffic(plan, chosen), *sets)


def _when_compared(plan: Plan, chosen: PlanOption) -> PlanOption:
    """The chosen set with its figures from the comparison."""
    return next((each for each in (*plan.front, *plan.considered) if each.sensors == chosen.sensors), chosen)


def _explain_traffic(plan: Plan, chosen: PlanOption) -> tuple[Paragraph, ...]:
    """Explain why the chosen set has another AP here than in the rest of the report."""
    compared, cases = _when_compared(plan, chosen).counted, _cases_text(chosen)
    if compared is None or chosen.counted is None:
        return ()
    asked = (Paragraph(f"The AP of each set in this section is that {cases}, as the question asks."),) if cases else ()
    if compared == chosen.counted:
        return asked
    return (
        *asked,
        Paragraph(
            "The AP of each set in this section is from the traffic on which the sets were compared. There the chosen "
            f"set has {ap_figure(compared)}; its {ap_figure(chosen.counted)} in the rest of the report is from "
            "other traffic, which had no say in the choice and is therefore the figure to trust."
        ),
    )


def _cases_text(chosen: PlanOption) -> str:
    """Cases behind the AP by which sets are compared, "" for the intact set in all traffic."""
    left = "" if chosen.left is None else "after the failures"
    levels = "" if chosen.over_levels is None else "over the levels of traffic"
    errors = "" if chosen.over_errors is None else "over the error profiles"
    return " and ".join(each for each in (left, levels, errors) if each)


def _option_table(
    caption: str, plan: Plan, chosen: PlanOption, options: Sequence[PlanOption]
) -> tuple[TableBlock, ...]:
    predicted, costs = Column("predicted AP", digits=3), price_column("price", plan.currency)
    columns = (*text_columns("Sensors"), predicted, *JUDGED_COLUMNS, Column("per sensor", "kbit"), costs)
    rows = [
        (
            join_names(each.sensors) + (" (chosen)" if each.sensors == chosen.sensors else ""),
            *(each.predicted, *judged_cells(each.counted), each.kbit_per_sensor, each.price),
        )
        for each in options
    ]
    return table(caption, columns, rows)


def links_section(plan: Plan) -> Content:
    """Load of the links against their capacity."""
    if not plan.links:
        return say("No link carries anything.")
    narrow = [each.pole for each in plan.links if not each.fits]
    fullest, total = max(plan.links, key=lambda each: each.share), sum(each.mbit_s for each in plan.links)
    conclusion = (
        f"{count_text(len(narrow), 'link')} of {len(plan.links)} cannot carry what is sent: {join_names(narrow)}."
        if narrow
        else f"Every link carries what is sent; the fullest, at {fullest.pole}, is used to {percent(fullest.share)}: "
        f"its largest frames need {number(fullest.peak_mbit_s, 2)} of {number(fullest.capacity_mbit_s, 2)} Mbit/s."
    )
    loads = [Column(name, "Mbit/s", 2) for name in ("mean", "largest frame", "capacity")]
    columns = (*text_columns("Pole"), *loads, Column("used", "%"), *text_columns("fits"))
    rows = [
        (e.pole, e.mbit_s, e.peak_mbit_s, e.capacity_mbit_s, in_percent(e.share), "yes" if e.fits else "no")
        for e in plan.links
    ]
    each = "; ".join(f"{e.pole}: {number(e.mbit_s, 2)} of {number(e.capacity_mbit_s, 2)}" for e in plan.links)
    drawing = Drawing(
        link_chart(plan.links),
        f"All links together carry {number(total, 2)} Mbit/s to the fusion centre.",
        f"Mbit/s of each link against its capacity: {each}",
    )
    return say(conclusion, drawing, *table(f"Load at {RATE:g} frames a second", columns, rows))


def materials_section(plan: Plan) -> Content:
    """Items to order."""
    if not plan.materials:
        return say("There is nothing to order.")
    dearest = max(plan.materials, key=lambda each: each.price)
    total, part, each = (
        price_text(price, plan.currency)
        for price in (sum(item.price for item in plan.materials), dearest.price, dearest.unit_price)
    )
    units = () if plan.currency else (Paragraph("Prices are in units of one ordinary pole."),)
    prices = (price_column(title, plan.currency) for title in ("each", "total"))
    columns = (*text_columns("Item"), Column("count", digits=0), *prices)
    rows = [(item.item, item.count, item.unit_price, item.price) for item in plan.materials]
    return say(
        f"The total is {total}; the largest part, {part}, is “{dearest.item}” ({dearest.count} at {each}).",
        *units,
        *table("What to order", columns, rows),
    )


def schedule_section(plan: Plan) -> Content:
    """Place and aim of each sensor."""
    if not plan.sensors:
        return say("There is nothing to mount.")
    low, high = (pick(sensor.height for sensor in plan.sensors) for pick in (min, max))
    heights = f"{low:.1f} to {high:.1f}" if high - low >= 0.05 else f"{plan.sensors[0].height:.1f}"
    poles = count_text(len({sensor.pole for sensor in plan.sensors}), "pole")
    on_earth = all(s.longitude is not None and s.latitude is not None for s in plan.sensors)
    columns = (
        *text_columns("Sensor", "Pole", "Model"),
        *(Column(name, "m", 2) for name in ("east x", "north y", "height")),
        *(Column(name, "°", 6) for name in (("longitude", "latitude") if on_earth else ())),
        *(Column(name, "°") for name in ("bearing", "tilt down")),
    )
    rows = [
        (
            *(s.name, s.pole, s.model, s.x, s.y, s.height),
            *((s.longitude, s.latitude) if on_earth else ()),
            *(s.bearing_deg, s.tilt_deg),
        )
        for s in plan.sensors
    ]
    note = "Bearings are compass bearings of the optical axis, clockwise from north; tilt is below the horizon; "
    note += "height is above the foot of the pole. x and y are metres in the frame of the site."
    if not on_earth:
        note += " The site has no geographic reference, so there are no longitudes and latitudes."
    return say(
        f"Mount {count_text(len(plan.sensors), 'sensor')} on {poles}, {heights} m above the foot of the pole.",
        Paragraph(note),
        *table("Sensor by sensor", columns, rows),
    )


def method_section(plan: Plan) -> Content:
    """Computation, assumptions, unknowns and provenance."""
    judged = plan.chosen.judged if plan.chosen else None
    amount = f", {count_text(judged.vehicles, judged.kind)} in {count_text(judged.frames, 'frame')}" if judged else ""
    conclusion = (
        f"Every AP here is that of {plan.detector} in simulated traffic{amount}: it ranks places for sensors, and does "
        "not replace a trial on the street."
        if plan.detector
        else "No detector judged anything, because no set of sensors may be built."
    )
    blocks: list[ReportBlock] = []
    if plan.considered:
        judged_sets = sum(each.judged is not None for each in plan.considered)
        found = {name for option in plan.considered for name in option.searches}
        by = f", found by the searches {join_names(sorted(found))}" if found else ""
        sets = f"{count_text(len(plan.considered), 'set')} of sensors reached the final comparison{by}; "
        blocks.append(Paragraph(f"{sets}the detector judged {judged_sets} of them on all of its traffic."))
    for heading, sentences in (("What it assumes:", plan.assumptions), ("What it does not know:", plan.unknown)):
        if sentences:
            blocks += [Paragraph(heading), Bullets(sentences)]
    caption = "Origin of the figures: the same inputs, seeds and versions give the same plan"
    origin = table(caption, text_columns("Input, seed or version", "Value"), [*_flatten(plan.provenance)])
    return say(conclusion, *blocks, *origin)


def _flatten(provenance: Mapping[str, object], before: str = "") -> Iterator[tuple[str, str]]:
    for name, value in provenance.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{before}{name}: ")
        else:
            yield f"{before}{name}".replace("_", " "), value_text(value)
