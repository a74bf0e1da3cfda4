"""Sections on what to build.

They are the answer, the chosen set and its rivals, links, materials, mounting, and the method.
"""

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
    Cell,
    Column,
    Drawing,
    Paragraph,
    ReportBlock,
    SceneView,
    Section,
    table,
)
from placement_env.report.pages.wording import (
    JUDGED_COLUMNS,
    NOTHING_CHOSEN,
    ap_figure,
    ap_text,
    count_text,
    figure_cell,
    format_cells,
    join_names,
    number,
    percent,
    price_column,
    price_text,
    share_cell,
    text_cell,
)
from toolkit.sites.site import Site

OPTION_COLUMNS = (Column("Sensors", number=False), Column("predicted AP"), *JUDGED_COLUMNS)


def requirement_section(plan: Plan) -> Section:
    """Answer to the question, with obstacles and reading help."""
    blocks: list[ReportBlock] = []
    if plan.verdict.reasons:
        blocks += [Paragraph("What stands in the way:"), Bullets(plan.verdict.reasons)]
    blocks.append(
        Paragraph(
            "AP (average precision) rates from 0 to 1 how well the detector finds vehicles: 1 means that it finds "
            "every vehicle and reports none that is not there. A vehicle counts as found if the intersection of the "
            f"reported box and the true box is at least {iou_text(plan.iou)} of their union (IoU). Every AP comes with "
            f"an interval, which contains it with {CONFIDENCE:.0%} confidence, and with the number of vehicles it was "
            "measured on: few vehicles make a wide interval. Every AP was measured on traffic that the search for the "
            "best set never saw. A kbit is a thousand bits; data are stated per sensor and frame, at ten frames a "
            "second."
        )
    )
    asked = [(Cell(str(key).replace("_", " ")), Cell(value_text(value))) for key, value in plan.question.items()]
    columns = (Column("Asked", number=False), Column("Value", number=False))
    return Section(
        "requirement",
        "The answer" if plan.verdict.met is None else "Is the requirement met?",
        plan.verdict.sentence,
        (*blocks, *table("The question that this plan answers", columns, asked)),
    )


def value_text(value: object) -> str:
    """Value of the question or provenance, as readers write."""
    if value is None or value == "" or value == [] or value == () or value == {}:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {value_text(each)}" for key, each in value.items())
    return ", ".join(map(value_text, value)) if isinstance(value, list | tuple) else str(value)


def chosen_section(plan: Plan, site: Site, ground: Ground | None) -> Section:
    """The set to build, and why."""
    key, title = "chosen", "The chosen set, and why"
    if plan.chosen is None:
        return Section(key, title, NOTHING_CHOSEN)
    chosen = plan.chosen
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
    return Section(key, title, conclusion, (*((Bullets(plan.why),) if plan.why else ()), view, scene))


def front_section(plan: Plan) -> Section:
    """Gain from more money or a faster link."""
    key, title = "front", "What more money or faster links buy"
    if plan.chosen is None:
        return Section(key, title, NOTHING_CHOSEN)
    if len(plan.front) < 2:
        return Section(key, title, "No other set beats the chosen one in AP, data sent or price.")
    judged = [(option, option.counted) for option in plan.front if option.counted is not None]
    best = max(judged, key=lambda each: each[1].ap, default=None)
    cheapest = min(plan.front, key=lambda each: each.price)
    prices = (
        f"the cheapest costs {price_text(cheapest.price, plan.currency)}"
        if best is None
        else f"prices start at {price_text(cheapest.price, plan.currency)}, and the highest AP, "
        f"{ap_figure(best[1])}, costs {price_text(best[0].price, plan.currency)}"
    )
    conclusion = f"No set beats these {len(plan.front)} in AP, data sent and price at once: {prices}."
    drawing = Drawing(
        front_chart(plan.front, _when_compared(plan, plan.chosen), plan.currency),
        f"The chosen set costs {price_text(plan.chosen.price, plan.currency)} and sends "
        f"{number(plan.chosen.kbit_per_sensor, 0)} kbit per sensor and frame.",
        "AP over kbit per sensor and over price for every set that no other beats in all three",
    )
    options = table("Sets that no other beats in AP, kbit and price at once", *_option_table(plan, plan.front))
    return Section(key, title, conclusion, (*_explain_traffic(plan, plan.chosen), drawing, *options))


def alternatives_section(plan: Plan) -> Section:
    """Sets that the measurements cannot tell from the chosen one."""
    key, title = "alternatives", "Sets that are nearly as good"
    if plan.chosen is None:
        return Section(key, title, NOTHING_CHOSEN)
    close = plan.near_optimal
    if not close:
        return Section(key, title, "No other judged set has an interval that overlaps that of the chosen set.")
    cheaper = sum(each.price < plan.chosen.price for each in close)
    conclusion = (
        f"The judged traffic cannot tell {count_text(len(close), 'other set')} from the chosen one, because the "
        f"intervals overlap; {cheaper or 'none'} of them {'is' if cheaper < 2 else 'are'} cheaper."
    )
    options = (_when_compared(plan, plan.chosen), *close)
    sets = table("The chosen set and the sets whose interval overlaps its own", *_option_table(plan, options))
    return Section(key, title, conclusion, (*_explain_traffic(plan, plan.chosen), *sets))


def _when_compared(plan: Plan, chosen: PlanOption) -> PlanOption:
    """The chosen set with its figures from the comparison."""
    return next((each for each in (*plan.front, *plan.considered) if each.sensors == chosen.sensors), chosen)


def _explain_traffic(plan: Plan, chosen: PlanOption) -> tuple[Paragraph, ...]:
    """Explain why the chosen set has another AP here. The comparison is with the rest of the report."""
    compared = _when_compared(plan, chosen)
    if compared.counted is None or chosen.counted is None:
        return ()
    cases = _cases_text(chosen)
    asked = (Paragraph(f"The AP of each set in this section is that {cases}, as the question asks."),) if cases else ()
    if compared.counted == chosen.counted:
        return asked
    return (
        *asked,
        Paragraph(
            "The AP of each set in this section is from the traffic on which the sets were compared. There the chosen "
            f"set has {ap_figure(compared.counted)}; its {ap_figure(chosen.counted)} in the rest of the report is from "
            "other traffic, which had no say in the choice and is therefore the figure to trust."
        ),
    )


def _cases_text(chosen: PlanOption) -> str:
    """Cases behind the AP by which sets are compared. It is "" for the intact set in all traffic."""
    left = "" if chosen.left is None else "after the failures"
    levels = "" if chosen.over_levels is None else "over the levels of traffic"
    errors = "" if chosen.over_errors is None else "over the error profiles"
    return " and ".join(each for each in (left, levels, errors) if each)


def _option_table(plan: Plan, options: Sequence[PlanOption]) -> tuple[tuple[Column, ...], list[tuple[Cell, ...]]]:
    columns = (*OPTION_COLUMNS, Column("per sensor", "kbit"), price_column("price", plan.currency))
    rows = []
    for option in options:
        mark = " (chosen)" if plan.chosen is not None and option.sensors == plan.chosen.sensors else ""
        rows.append(
            (
                text_cell(join_names(option.sensors) + mark),
                figure_cell(option.predicted, 3),
                *format_cells(option.counted),
                figure_cell(option.kbit_per_sensor),
                figure_cell(option.price, 2),
            )
        )
    return columns, rows


def links_section(plan: Plan) -> Section:
    """Load of the links against their capacity."""
    key, title = "links", "What the links carry"
    if plan.chosen is None or not plan.links:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "No link carries anything.")
    narrow = [each for each in plan.links if not each.fits]
    fullest = max(plan.links, key=lambda each: each.share)
    conclusion = (
        f"{count_text(len(narrow), 'link')} of {len(plan.links)} cannot carry what is sent: "
        f"{join_names([each.pole for each in narrow])}."
        if narrow
        else f"Every link carries what is sent; the fullest, at {fullest.pole}, is used to {percent(fullest.share)}: "
        f"its largest frames need {number(fullest.peak_mbit_s, 2)} of {number(fullest.capacity_mbit_s, 2)} Mbit/s."
    )
    columns = (
        Column("Pole", number=False),
        *(Column(name, "Mbit/s") for name in ("mean", "largest frame", "capacity")),
        Column("used", "%"),
        Column("fits", number=False),
    )
    rows = [
        (
            text_cell(each.pole),
            *(figure_cell(value, 2) for value in (each.mbit_s, each.peak_mbit_s, each.capacity_mbit_s)),
            share_cell(each.share),
            text_cell("yes" if each.fits else "no"),
        )
        for each in plan.links
    ]
    alt = "Mbit/s of each link against its capacity: " + "; ".join(
        f"{each.pole}: {number(each.mbit_s, 2)} of {number(each.capacity_mbit_s, 2)}" for each in plan.links
    )
    total = sum(each.mbit_s for each in plan.links)
    caption = f"All links together carry {number(total, 2)} Mbit/s to the fusion centre."
    drawing = Drawing(link_chart(plan.links), caption, alt)
    return Section(key, title, conclusion, (drawing, *table(f"Load at {RATE:g} frames a second", columns, rows)))


def materials_section(plan: Plan) -> Section:
    """Items to order."""
    key, title = "materials", "Bill of materials"
    if plan.chosen is None or not plan.materials:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "There is nothing to order.")
    total, dearest = sum(each.price for each in plan.materials), max(plan.materials, key=lambda each: each.price)
    conclusion = (
        f"The total is {price_text(total, plan.currency)}; the largest part, "
        f"{price_text(dearest.price, plan.currency)}, is “{dearest.item}” "
        f"({dearest.count} at {price_text(dearest.unit_price, plan.currency)})."
    )
    columns = (
        Column("Item", number=False),
        Column("count"),
        price_column("each", plan.currency),
        price_column("total", plan.currency),
    )
    rows = [
        (text_cell(e.item), figure_cell(float(e.count), 0), figure_cell(e.unit_price, 2), figure_cell(e.price, 2))
        for e in plan.materials
    ]
    units = () if plan.currency else (Paragraph("Prices are in units of one ordinary pole."),)
    return Section(key, title, conclusion, (*units, *table("What to order", columns, rows)))


def schedule_section(plan: Plan) -> Section:
    """Place and aim of each sensor."""
    key, title = "schedule", "Mounting schedule"
    if plan.chosen is None or not plan.sensors:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "There is nothing to mount.")
    heights = [sensor.height for sensor in plan.sensors]
    poles = len({sensor.pole for sensor in plan.sensors})
    conclusion = (
        f"Mount {count_text(len(plan.sensors), 'sensor')} on {count_text(poles, 'pole')}, "
        + (f"{min(heights):.1f} to {max(heights):.1f}" if max(heights) - min(heights) >= 0.05 else f"{heights[0]:.1f}")
        + " m above the foot of the pole."
    )
    on_earth = all(s.longitude is not None and s.latitude is not None for s in plan.sensors)
    degrees = (Column("longitude", "°"), Column("latitude", "°")) if on_earth else ()
    columns = (
        *(Column(name, number=False) for name in ("Sensor", "Pole", "Model")),
        *(Column(name, "m") for name in ("east x", "north y", "height")),
        *degrees,
        *(Column(name, "°") for name in ("bearing", "tilt down")),
    )
    rows = [
        (
            *(text_cell(text) for text in (s.name, s.pole, s.model)),
            *(figure_cell(value, 2) for value in (s.x, s.y, s.height)),
            *(figure_cell(value, 6) for value in ((s.longitude, s.latitude) if on_earth else ())),
            *(figure_cell(value, 1) for value in (s.bearing_deg, s.tilt_deg)),
        )
        for s in plan.sensors
    ]
    note = "Bearings are compass bearings of the optical axis, clockwise from north; tilt is below the horizon; "
    note += "height is above the foot of the pole. x and y are metres in the frame of the site."
    if not on_earth:
        note += " The site has no geographic reference, so there are no longitudes and latitudes."
    return Section(key, title, conclusion, (Paragraph(note), *table("Sensor by sensor", columns, rows)))


def method_section(plan: Plan) -> Section:
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
    rows = [(text_cell(name), text_cell(value)) for name, value in _flatten(plan.provenance)]
    columns = (Column("Input, seed or version", number=False), Column("Value", number=False))
    caption = "Origin of the figures: the same inputs, seeds and versions give the same plan"
    return Section("method", "How this was worked out", conclusion, (*blocks, *table(caption, columns, rows)))


def _flatten(provenance: Mapping[str, object], before: str = "") -> Iterator[tuple[str, str]]:
    for name, value in provenance.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{before}{name}: ")
        else:
            yield f"{before}{name}".replace("_", " "), value_text(value)
