"""The report of a plan, as report.html and report.pdf.

Its sections come in the order in which a reader needs them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from placement_env.analysis.intervals import AP_TOLERANCE, is_comparable
from placement_env.cases import IoUs, iou_text
from placement_env.classes import join_names
from placement_env.handover.ground import Ground
from placement_env.handover.mounted import FRAME_RATE_HZ, MaterialItem
from placement_env.links import describe_share
from placement_env.report import charts, content
from placement_env.report.maps import blind_map, coverage_map, density_map
from placement_env.report.pages.decision import decision_section
from placement_env.report.pages.document import (
    Bullets,
    Cell,
    Column,
    Content,
    Document,
    Drawing,
    Paragraph,
    ReportBlock,
    SceneView,
    Section,
    TableBlock,
    ap_figure,
    ap_text,
    drop_unset,
    interval_text,
    list_aps,
    number,
    percent,
    price_text,
    say,
    settle_names,
    table,
    to_html,
    to_pdf,
    use_pole_names,
)
from placement_env.report.pages.scene import build_scene
from placement_env.report.sensor_views import draw_sensor_views
from toolkit.display import describe_count
from toolkit.runtime.writing import writing_together
from toolkit.sites.georeference import bearing_deg
from toolkit.sites.site import Site

REPORT_FILES = ("report.html", "report.pdf")
NOTHING_CHOSEN = "No set of sensors may be built, so there is nothing to show here."
MAX_EAST_TURN_DEG = 0.5  # an axis of the site that is turned by less counts as east
MAX_LISTED_SETS = 8  # of each kind in the table of other sets
SPARSE_POINTS_M2 = 1.0  # points per m² below which a place is practically unseen
JUDGED_COLUMNS = (
    Column("AP", digits=3),
    Column(f"{content.CONFIDENCE:.0%} interval"),
    Column("found", "%"),
    Column("vehicles", digits=0),
    Column("frames", digits=0),
)


def judged_cells(judged: content.Judgement | None) -> tuple[Cell | str | float | None, ...]:
    """Return the values of `JUDGED_COLUMNS`, with dashes if there is nothing to detect."""
    if judged is None:
        return None, "no vehicle", None, 0, None
    ap = Cell(judged.format_ap(), judged.ap)
    interval = Cell(interval_text(judged), judged.low)
    return ap, interval, judged.recall, judged.vehicles, judged.frames


def text_columns(*titles: str) -> tuple[Column, ...]:
    """Return columns of texts."""
    return tuple(Column(title, digits=None) for title in titles)


def price_column(title: str, currency: str) -> Column:
    """Return a column of prices."""
    return Column(title, currency or "units", 2)


def iou_value(iou: IoUs) -> float | str:
    """Return an IoU threshold for a cell, in words for several thresholds."""
    return iou if isinstance(iou, float) else iou_text(iou)


def value_text(value: object) -> str:
    """Write a value of the question or provenance for readers."""
    if value is None or value == "" or value == [] or value == () or value == {}:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {value_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(value_text, value))
    return str(value)


def others_section(plan: content.Plan, chosen_option: content.PlanOption) -> Content:
    """List sets that are as good as the chosen one, cheaper, better, or send less."""
    compared_option = _when_compared(plan, chosen_option)
    close_options = plan.near_optimal
    front_options = [
        option
        for option in plan.front
        if option not in close_options and option.sensors != chosen_option.sensors
    ]
    if not (close_options or front_options):
        return say("No other judged set comes near the chosen one, costs less or sends less.")
    conclusion = "On the same frames, no other set is surely within 0.01 of the best."
    if close_options:
        conclusion = (
            f"On the same frames, {describe_count(len(close_options), 'other set')} "
            f"{'is' if len(close_options) == 1 else 'are'} surely within 0.01 of the best; none is "
            "cheaper than the chosen set."
        )
    elif compared_option.counted is not None and not compared_option.counted.known:
        conclusion = (
            "The sets were compared on too few frames to say which are as good as the best: take "
            "more --frames."
        )
    best = compared_option
    for option in front_options:
        if option.counted is None:
            continue
        if best.counted is None or option.counted.ap > best.counted.ap:
            best = option
    if best.counted is not None and best is not compared_option:
        conclusion += (
            f" The highest AP, {ap_figure(best.counted)}, costs "
            f"{price_text(best.price, plan.currency)}."
        )
    drawing = Drawing(
        charts.front_chart(plan.front, compared_option, plan.currency),
        f"The chosen set costs {price_text(chosen_option.price, plan.currency)} and sends "
        f"{number(chosen_option.kbit_per_sensor, 0)} kbit per sensor and frame.",
        "AP over kbit per sensor and over price for every set that no other beats in all three",
    )
    sorted_options = sorted(
        (compared_option, *close_options, *front_options),
        key=lambda option: (option.price, -(option.counted.ap if option.counted else 0.0)),
    )
    first_close = close_options[:MAX_LISTED_SETS]
    first_front = front_options[:MAX_LISTED_SETS]
    listed_ids = {id(option) for option in (compared_option, *first_close, *first_front)}
    listed_options = [option for option in sorted_options if id(option) in listed_ids]
    caption = (
        "The chosen set, sets that are as good as the best, and sets that no other beats in AP, "
        "kbit and price"
    )
    sets = _option_table(caption, plan, chosen_option, listed_options)
    return say(conclusion, *_explain_traffic(plan, chosen_option), drawing, *sets)


def _when_compared(plan: content.Plan, chosen_option: content.PlanOption) -> content.PlanOption:
    """Return the chosen set with its figures from the comparison."""
    for option in (*plan.front, *plan.considered):
        if option.sensors == chosen_option.sensors:
            return option
    return chosen_option


def _explain_traffic(plan: content.Plan, option: content.PlanOption) -> tuple[Paragraph, ...]:
    """Explain why the set has another AP here."""
    compared = _when_compared(plan, option).counted
    if compared is None or option.counted is None:
        return ()
    case_text = _cases_text(option)
    texts = []
    if case_text:
        texts.append(
            f"The AP of each set in this section is that {case_text}, as the question asks."
        )
    if compared != option.counted:
        texts.append(
            "The AP of each set in this section is from the traffic on which the sets were "
            f"compared. There the chosen set has {ap_figure(compared)}; its "
            f"{ap_figure(option.counted)} in the rest of the report is from other traffic, which "
            "had no say in the choice and is therefore the figure to trust."
        )
    return tuple(map(Paragraph, texts))


def _cases_text(option: content.PlanOption) -> str:
    """Describe the cases of the compared AP, "" for the intact set in all traffic."""
    failure_text = "" if option.left is None else "after the failures"
    level_text = "" if option.over_levels is None else "over the levels of traffic"
    error_text = "" if option.over_errors is None else "over the error profiles"
    return " and ".join(text for text in (failure_text, level_text, error_text) if text)


def _option_table(
    caption: str,
    plan: content.Plan,
    chosen_option: content.PlanOption,
    options: Sequence[content.PlanOption],
) -> tuple[TableBlock, ...]:
    by_coverage = plan.provenance.get("search_fidelity") == "coverage"
    predicted = Column("coverage" if by_coverage else "predicted AP", digits=3)
    columns = (
        *text_columns("Sensors"),
        predicted,
        *JUDGED_COLUMNS,
        Column("per sensor", "kbit"),
        price_column("price", plan.currency),
    )
    rows = []
    for option in options:
        mark = " (chosen)" if option.sensors == chosen_option.sensors else ""
        names = join_names(option.sensors) + mark
        judged = judged_cells(option.counted)
        rows.append((names, option.predicted, *judged, option.kbit_per_sensor, option.price))
    return table(caption, columns, rows)


def links_section(plan: content.Plan) -> Content:
    """Compare the load of the links with their capacity."""
    if not plan.links:
        return say("No link carries anything.")
    narrow_poles = [link.pole for link in plan.links if not link.fits]
    fullest = max(plan.links, key=lambda link: link.share)
    total = sum(link.mbit_s for link in plan.links)
    conclusion = (
        f"Every link carries what is sent; the fullest, at {fullest.pole}, is used to "
        f"{percent(fullest.share)}: it needs {number(fullest.load_mbit_s, 2)} of "
        f"{number(fullest.capacity_mbit_s, 2)} Mbit/s."
    )
    if narrow_poles:
        conclusion = (
            f"{describe_count(len(narrow_poles), 'link')} of {len(plan.links)} cannot carry what "
            f"is sent: {join_names(narrow_poles)}."
        )
    loads = [Column(name, "Mbit/s", 2) for name in ("mean", "load", "largest frame", "capacity")]
    columns = (*text_columns("Pole"), *loads, Column("used", "%"), *text_columns("fits"))
    load_rule = f"what is sent does not exceed in {describe_share(plan.link_share)}"
    rows = [
        (
            link.pole,
            link.mbit_s,
            link.load_mbit_s,
            link.peak_mbit_s,
            link.capacity_mbit_s,
            link.share,
            "yes" if link.fits else "no",
        )
        for link in plan.links
    ]
    load_texts = "; ".join(
        f"{link.pole}: {number(link.mbit_s, 2)} of {number(link.capacity_mbit_s, 2)}"
        for link in plan.links
    )
    drawing = Drawing(
        charts.link_chart(plan.links),
        f"All links together carry {number(total, 2)} Mbit/s to the fusion centre.",
        f"Mbit/s of each link against its capacity: {load_texts}",
    )
    caption = (
        f"Load at {FRAME_RATE_HZ:g} frames a second. A link must carry its load, which {load_rule}"
    )
    return say(conclusion, drawing, *table(caption, columns, rows))


def materials_section(plan: content.Plan) -> Content:
    """List the items to order."""
    if not plan.materials:
        return say("There is nothing to order.")
    dearest_item = max(plan.materials, key=lambda item: item.price)
    total = price_text(sum(item.price for item in plan.materials), plan.currency)
    dearest_price = price_text(dearest_item.price, plan.currency)
    unit_price = price_text(dearest_item.unit_price, plan.currency)
    conclusion = (
        f"The total is {total}; the largest part, {dearest_price}, is "
        f"“{dearest_item.item}” ({dearest_item.count} at {unit_price})."
    )
    columns = (
        *text_columns("Item"),
        Column("count", digits=0),
        price_column("each", plan.currency),
        price_column("total", plan.currency),
    )
    blocks: list[ReportBlock] = []
    if not plan.currency:
        blocks.append(Paragraph("Prices are in units of one ordinary pole."))
    blocks += table("What to order", columns, _item_rows(plan.materials))
    blocks += table("What the rates add to the price", columns, _item_rows(plan.running))
    return say(conclusion, *blocks)


def _item_rows(items: Sequence[MaterialItem]) -> list[tuple[str, int, float, float]]:
    return [(item.item, item.count, item.unit_price, item.price) for item in items]


def schedule_section(plan: content.Plan, site: Site) -> Content:
    """List the position and aim of each sensor."""
    if not plan.sensors:
        return say("There is nothing to mount.")
    lowest = min(sensor.height for sensor in plan.sensors)
    highest = max(sensor.height for sensor in plan.sensors)
    heights = f"{plan.sensors[0].height:.1f}"
    if highest - lowest >= 0.05:
        heights = f"{lowest:.1f} to {highest:.1f}"
    poles = describe_count(len({sensor.pole for sensor in plan.sensors}), "pole")
    on_earth = all(
        sensor.longitude is not None and sensor.latitude is not None for sensor in plan.sensors
    )
    along_x = bearing_deg(site, 0.0)
    along_y = bearing_deg(site, np.pi / 2)
    x, y = ("east x", "north y") if abs(along_x - 90.0) < MAX_EAST_TURN_DEG else ("x", "y")
    has_names = any(sensor.name != sensor.pole for sensor in plan.sensors)
    titles = ("Sensor", "Pole", "Model") if has_names else ("Pole", "Model")
    columns = list(text_columns(*titles))
    columns += [Column(name, "m", 2) for name in (x, y, "height")]
    if on_earth:
        columns += [Column("longitude", "°", 6), Column("latitude", "°", 6)]
    columns += [Column("bearing", "°"), Column("tilt down", "°")]
    rows = []
    for sensor in plan.sensors:
        row: list[str | float | None] = [sensor.name] if has_names else []
        row += [sensor.pole, sensor.model, sensor.x, sensor.y, sensor.height]
        if on_earth:
            row += [sensor.longitude, sensor.latitude]
        row += [sensor.bearing_deg, sensor.tilt_deg]
        rows.append(row)
    note = (
        "Bearings are compass bearings of the optical axis, clockwise from north; tilt is below "
        "the horizon; height is above the foot of the pole. x and y are metres from the site's "
        f"origin: x runs towards {along_x:.0f}°, y towards {along_y:.0f}°."
    )
    if not on_earth:
        note += " The site has no geographic reference, so there are no longitudes and latitudes."
    return say(
        (
            f"Mount {describe_count(len(plan.sensors), 'sensor')} on {poles}, {heights} m above "
            "the foot of the pole."
        ),
        Paragraph(note),
        *table("Sensor by sensor", columns, rows),
    )


def method_section(plan: content.Plan) -> Content:
    """Describe the computation, assumptions, unknowns and provenance."""
    judgement = plan.chosen.judged if plan.chosen else None
    sample = ""
    if judgement:
        sample = (
            f", {describe_count(judgement.vehicles, judgement.kind)} in "
            f"{describe_count(judgement.frames, 'frame')}"
        )
    conclusion = "No detector judged anything, because no set of sensors may be built."
    if plan.detector:
        conclusion = (
            f"Every AP here is that of {plan.detector} in simulated traffic{sample}: it ranks "
            "places for sensors, and does not replace a trial on the street."
        )
    blocks: list[ReportBlock] = []
    if plan.why:
        blocks += [Paragraph(plan.verdict.sentence), Bullets(plan.why)]
    if plan.considered:
        judged_count = sum(considered.judged is not None for considered in plan.considered)
        searches = {name for option in plan.considered for name in option.searches}
        searches_text = (
            f", found by the searches {join_names(sorted(searches))}" if searches else ""
        )
        sets_text = (
            f"{describe_count(len(plan.considered), 'set')} of sensors reached the final "
            f"comparison{searches_text}; "
        )
        blocks.append(
            Paragraph(
                f"{sets_text}the detector judged {judged_count} of them on all of its traffic."
            )
        )
    if plan.assumptions:
        blocks += [Paragraph("What it assumes:"), Bullets(plan.assumptions)]
    if plan.unknown:
        blocks += [Paragraph("What it does not know:"), Bullets(plan.unknown)]
    question_rows = [
        (str(key).replace("_", " "), value_text(value)) for key, value in plan.question.items()
    ]
    settings = table(
        "The question that this plan answers", text_columns("Asked", "Value"), question_rows
    )
    caption = "Origin of the figures: the same inputs, seeds and versions give the same plan"
    origin = table(
        caption, text_columns("Input, seed or version", "Value"), [*_flatten(plan.provenance)]
    )
    return say(conclusion, *blocks, *settings, *origin)


def _flatten(provenance: Mapping[str, object], before: str = "") -> Iterator[tuple[str, str]]:
    for name, value in provenance.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{before}{name}: ")
        else:
            yield f"{before}{name}".replace("_", " "), value_text(value)


def ground_section(plan: content.Plan, site: Site, ground: Ground | None) -> Content:
    """Describe the visible ground, the density of points and the blind spots."""
    if plan.ground is None or ground is None:
        why = "" if plan.chosen else ", because no set of sensors was chosen"
        return say(f"The visible ground was not computed{why}.")
    shares = plan.ground
    seen_twice = percent(plan.ground.seen_by[1])
    conclusion = (
        f"At least one sensor sees {percent(shares.seen_by[0])} of the open ground, and two or "
        f"more see {seen_twice}; no sensor sees {number(shares.blind_m2, 0)} m², or "
        f"{percent(shares.blind_lanes)} of the lanes."
    )
    names = join_names([sensor.name for sensor in plan.sensors])
    coverage = Drawing(
        coverage_map(site, ground, site.sensors),
        (
            f"Where two or more sensors look, on {seen_twice} of the open ground, one may fail and "
            "the place is still seen."
        ),
        f"Map of how many of the sensors {names} see each place of the ground",
    )
    density = Drawing(
        density_map(site, ground, site.sensors),
        _describe_density(ground),
        "Map of the points per square metre that all sensors together put on the ground in a frame",
    )
    blind = Drawing(
        blind_map(site, ground, site.sensors),
        f"{number(shares.blind_m2, 0)} m², {percent(shares.blind)} of the open ground, are hidden "
        "from every sensor or lie outside their fields of view.",
        "Map of the ground that no sensor sees: lanes, footways and the rest",
    )
    rows = [
        (name, area, area / shares.open_m2 if shares.open_m2 else None)
        for name, area in shares.sensor_m2.items()
    ]
    columns = (*text_columns("Sensor"), Column("sees", "m²", 0), Column("of the open ground", "%"))
    caption = "Ground that each sensor sees; ground that two sensors see counts for both"
    scene = SceneView(
        "Drag to turn the junction, scroll to zoom; hide sensors and boxes with the switches.",
        (
            "The junction in 3D, with points, vehicles and detections of some frames, is in "
            "report.html beside this file."
        ),
    )
    return say(conclusion, coverage, density, blind, *table(caption, columns, rows), scene)


def _describe_density(ground: Ground) -> str:
    """Describe the density of points on the lanes."""
    is_lane = ground.lanes & ground.open_ground
    if not is_lane.any():
        return "No lane lies in the area; the density is that of all open ground."
    density = ground.density.sum(0, dtype=np.float64)[is_lane]
    dense = density[density >= SPARSE_POINTS_M2]
    typical = float(np.median(dense)) if len(dense) else None
    return (
        f"{percent(float((density < SPARSE_POINTS_M2).mean()))} of the lanes' ground gets "
        f"fewer than {SPARSE_POINTS_M2:g} point per m² in a frame, too few to tell what is "
        f"there; the other lanes get {number(typical, 0)} per m² in the middle case."
    )


def detection_section(plan: content.Plan) -> Content:
    """Break the AP down by place, level of traffic, error profile and class."""
    parts = (
        ("zone", plan.by_zone),
        ("distance", plan.by_range),
        ("lane approach", plan.by_approach),
    )
    rows = (*plan.by_zone, *plan.by_range, *plan.by_approach)
    judgements = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not (judgements or plan.by_class):
        return say("There was no vehicle to detect.")
    conclusion = "There was no vehicle to detect in any part of the site."
    if judgements:
        conclusion = (
            "There are too few frames to compare parts of the site: 80 or more give an AP its "
            "interval."
        )
    comparable = [(name, judgement) for name, judgement in judgements if _is_comparable(judgement)]
    if len(comparable) > 1:
        worst, low = min(comparable, key=_ap_of_pair)
        best, high = max(comparable, key=_ap_of_pair)
        conclusion = (
            f"Detection is weakest at “{worst}”, {ap_text(low)}, and best at “{best}”, "
            f"{ap_text(high)}."
        )
        if content.overlap(low, high):
            no_difference = "No part of the site is clearly worse than another"
            conclusion = f"{no_difference}: the weakest, “{worst}”, has {ap_text(low)}."
    conditions = (("level of traffic", plan.by_level), ("error profile", plan.by_errors))
    blocks: list[ReportBlock] = []
    for name, breakdown_rows in (*parts, *conditions):
        blocks += _breakdown(name, breakdown_rows)
    return say(conclusion, *blocks, *_class_ap(plan), *_coverage(plan))


def _ap_of_pair(pair: tuple[str, content.Judgement]) -> float:
    return pair[1].ap


def _is_comparable(judged: content.Judgement) -> bool:
    """Return whether an AP has an interval and enough road users to be compared."""
    return judged.known and is_comparable(judged.frames, judged.vehicles)


def _breakdown(name: str, rows: Sequence[content.BreakdownRow]) -> tuple[ReportBlock, ...]:
    if not rows:
        return ()
    judgements = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not judgements:
        return (Paragraph(f"AP by {name} is unknown: there was no vehicle to detect."),)
    comparable = [
        (part_name, judgement) for part_name, judgement in judgements if _is_comparable(judgement)
    ]
    caption = (
        f"By {name}, there is too little to compare: an AP of few frames or road users is left to "
        "chance."
    )
    if len(judgements) == 1:
        part_name, judgement = judgements[0]
        caption = f"By {name}, only “{part_name}” had vehicles: {ap_text(judgement)}."
    elif len(comparable) > 1:
        worst, low = min(comparable, key=_ap_of_pair)
        best, high = max(comparable, key=_ap_of_pair)
        overlaps = "overlap" if content.overlap(low, high) else "do not overlap"
        caption = (
            f"By {name}, AP ranges from {low.format_ap()} at “{worst}” to {high.format_ap()} at "
            f"“{best}”; the intervals {overlaps}."
        )
    chart = charts.interval_bars(judgements, f"AP by {name}")
    drawing = Drawing(chart, caption, f"AP with intervals by {name}: {list_aps(judgements)}")
    columns = (
        *text_columns(name.capitalize()),
        *JUDGED_COLUMNS,
        Column("points per vehicle", digits=0),
    )
    cells = [(row.name, *judged_cells(row.judged), row.mean_points) for row in rows]
    return drawing, *table(f"AP and share of vehicles found, by {name}", columns, cells)


def _coverage(plan: content.Plan) -> tuple[ReportBlock, ...]:
    if not plan.by_class:
        return ()
    covered_rows = [
        (row, row.share) for row in plan.by_class if row.share is not None and row.objects
    ]
    text = "No road user of any class crossed the site."
    if covered_rows:
        lowest_row, share = min(covered_rows, key=lambda pair: pair[1])
        text = (
            f"The class covered least is {lowest_row.label}: {percent(share)} of "
            f"{describe_count(lowest_row.objects, 'road user')} had at least "
            f"{describe_count(lowest_row.least_points, 'point')} on them. These are shares of "
            "coverage, not AP."
        )
    count_columns = Column("road users", digits=0), Column("points required", digits=0)
    rows = [(row.label, row.objects, row.least_points, row.share) for row in plan.by_class]
    columns = (*text_columns("Class"), *count_columns, Column("covered", "%"))
    return Paragraph(text), *table("Coverage by class of road user (not AP)", columns, rows)


def _class_ap(plan: content.Plan) -> tuple[ReportBlock, ...]:
    if len(plan.class_ap) < 2:
        return ()
    low = min(plan.class_ap, key=lambda row: row.judged.ap)
    text = (
        f"The class detected worst is {low.label}: {ap_text(low.judged)} at IoU "
        f"{iou_text(low.iou)}."
    )
    columns = (*text_columns("Class"), Column("IoU"), Column("weight"), *JUDGED_COLUMNS)
    rows = [
        (row.label, iou_value(row.iou), row.weight, *judged_cells(row.judged))
        for row in plan.class_ap
    ]
    return Paragraph(text), *table("AP of each class with the chosen set", columns, rows)


def schemes_section(plan: content.Plan) -> Content:
    """Compare early, late and hybrid fusion of the same sensors."""
    if not plan.schemes:
        return say("No other fusion scheme was judged.")
    dearest = max(plan.schemes, key=lambda figures: figures.kbit_per_sensor)
    cheapest = min(plan.schemes, key=lambda figures: figures.kbit_per_sensor)
    if cheapest.kbit_per_sensor <= 0 or dearest is cheapest:
        caption = (
            f"A sensor sends {number(dearest.kbit_per_sensor, 0)} kbit per frame with "
            f"{dearest.scheme} fusion."
        )
    else:
        caption = (
            f"{dearest.scheme.capitalize()} fusion sends "
            f"{dearest.kbit_per_sensor / cheapest.kbit_per_sensor:.1f} times as much as "
            f"{cheapest.scheme} fusion."
        )
    aps = list_aps(
        (f"{figures.scheme} at IoU {iou_text(figures.iou)}", figures.judged)
        for figures in plan.schemes
    )
    columns = (
        *text_columns("Scheme"),
        Column("IoU"),
        *JUDGED_COLUMNS,
        Column("per sensor", "kbit"),
    )
    rows = [
        (
            figures.scheme,
            iou_value(figures.iou),
            *judged_cells(figures.judged),
            figures.kbit_per_sensor,
        )
        for figures in plan.schemes
    ]
    at_iou = [figures for figures in plan.schemes if figures.iou == plan.iou]
    return say(
        _compare_schemes(plan, at_iou or plan.schemes),
        Paragraph(content.TEXTS["schemes"]),
        Drawing(
            charts.scheme_chart(plan.schemes),
            caption,
            f"AP with intervals of the fusion schemes: {aps}",
        ),
        *table("The chosen sensors with each fusion scheme", columns, rows),
    )


def _compare_schemes(plan: content.Plan, schemes: Sequence[content.SchemeFigures]) -> str:
    best = max(schemes, key=lambda figures: figures.judged.ap)
    cheapest = min(schemes, key=lambda figures: figures.kbit_per_sensor)
    planned = next((figures for figures in schemes if figures.scheme == plan.scheme), best)
    least = "the least"
    if planned is not cheapest:
        least = f"{cheapest.scheme} fusion, the least, {number(cheapest.kbit_per_sensor, 0)}"
    sent_text = (
        f"{planned.scheme} fusion sends {number(planned.kbit_per_sensor, 0)} kbit per sensor and "
        f"frame, {least}"
    )
    if planned is best:
        return (
            f"{planned.scheme.capitalize()} fusion, as planned, has the highest AP, "
            f"{ap_figure(planned.judged)}; {sent_text}."
        )
    difference = "the difference may be due to chance"
    if best.as_good:
        difference = "on the same frames they cannot be told apart"
    elif not (_is_comparable(best.judged) and _is_comparable(planned.judged)):
        difference = "the frames are too few to compare them"
    elif not content.overlap(best.judged, planned.judged):
        difference = "the difference is not due to chance"
    return (
        f"{best.scheme.capitalize()} fusion has the highest AP, {best.judged.format_ap()} "
        f"({interval_text(best.judged)}), against {planned.judged.format_ap()} "
        f"({interval_text(planned.judged)}) with {planned.scheme} fusion as planned, and "
        f"{difference}; {sent_text}."
    )


def worth_section(plan: content.Plan) -> Content:
    """Describe what each sensor adds, and which pairs work well together."""
    if not plan.worth:
        return say("The worth of the sensors was not computed.")
    if len(plan.worth) == 1:
        only_sensor = plan.worth[0]
        return say(
            f"There is one sensor, {only_sensor.sensor}, and all of the AP is its own: "
            f"{number(only_sensor.shapley)}."
        )
    strongest = max(plan.worth, key=lambda sensor_worth: sensor_worth.shapley)
    weakest = min(plan.worth, key=lambda sensor_worth: sensor_worth.shapley)
    conclusion = (
        f"{strongest.sensor} is worth most, {number(strongest.shapley)} AP, and {weakest.sensor} "
        f"least, {number(weakest.shapley)}.{_describe_pairs(plan)}"
    )
    names = [sensor_worth.sensor for sensor_worth in plan.worth]
    total = sum(sensor_worth.shapley for sensor_worth in plan.worth)
    columns = [*text_columns("Sensor"), Column("worth", "AP", 3)]
    columns += [Column(f"with {name}", "AP") for name in names]
    rows = []
    for sensor_worth in plan.worth:
        row: list[Cell | str | float | None] = [sensor_worth.sensor, sensor_worth.shapley]
        for name in names:
            value = sensor_worth.synergy.get(name)
            row.append(None if value is None else Cell(f"{value:+.3f}", value))
        rows.append(row)
    caption = (
        f"{strongest.sensor} accounts for {percent(strongest.shapley / total if total else None)} "
        "of what all sensors add."
    )
    values = "; ".join(
        f"{sensor_worth.sensor} {number(sensor_worth.shapley)}" for sensor_worth in plan.worth
    )
    return say(
        conclusion,
        Paragraph(content.TEXTS["worth"]),
        Drawing(charts.worth_chart(plan.worth), caption, f"Worth of each sensor in AP: {values}"),
        *table("Worth, and synergy with each other sensor", columns, rows),
    )


def _describe_pairs(plan: content.Plan) -> str:
    """Name the pair of sensors that complement each other best, and the most redundant pair."""
    synergies = {}
    for sensor_worth in plan.worth:
        for other_name, value in sensor_worth.synergy.items():
            synergies[tuple(sorted((sensor_worth.sensor, other_name)))] = value
    if not synergies:
        return ""
    best = max(synergies, key=lambda pair: synergies[pair])
    worst = min(synergies, key=lambda pair: synergies[pair])
    text = ""
    if synergies[best] > 0:
        text += f" {join_names(best)} complement each other best ({synergies[best]:+.3f})."
    if synergies[worst] < 0:
        text += f" {join_names(worst)} duplicate each other most ({synergies[worst]:+.3f})."
    return text


def failures_section(plan: content.Plan, chosen_option: content.PlanOption) -> Content:
    """Describe the AP that remains when one or two sensors fail."""
    intact = chosen_option.judged
    if intact is None or not plan.failures:
        return say("No failure leaves a working sensor.")
    conclusion = f"All sensors together give {ap_text(intact)}."
    for count in sorted({len(failure.failed) for failure in plan.failures}):
        cases = [failure for failure in plan.failures if len(failure.failed) == count]
        case = min(cases, key=lambda failure: failure.judged.ap)
        conclusion += (
            f" If {describe_count(count, 'sensor')} {'fails' if count == 1 else 'fail'}, the "
            f"worst loss is that of {join_names(case.failed)}: {ap_text(case.judged)} is left."
        )
    harmless = sum(intact.ap - failure.judged.ap <= AP_TOLERANCE for failure in plan.failures)
    case_count = describe_count(len(plan.failures), "case")
    caption = f"In {harmless} of {case_count} no more than {AP_TOLERANCE:g} of the AP is lost."
    ap_list = list_aps(
        (f"without {join_names(failure.failed)}", failure.judged) for failure in plan.failures
    )
    columns = (*text_columns("Failed"), *JUDGED_COLUMNS, Column("lost", "AP", 3))
    rows = [
        (join_names(failure.failed), *judged_cells(failure.judged), intact.ap - failure.judged.ap)
        for failure in plan.failures
    ]
    drawing = Drawing(charts.failure_chart(intact, plan.failures), caption, f"AP left: {ap_list}")
    return say(conclusion, drawing, *table("What is left, case by case", columns, rows))


def order_section(plan: content.Plan) -> Content:
    """Describe the order in which to build the sensors."""
    if not plan.order:
        return say("No order of building was computed.")
    first_step = plan.order[0]
    last_step = plan.order[-1]
    last_text = ""
    if last_step is not first_step:
        last_text = f"; the last, {last_step.sensor}, brings it to {ap_text(last_step.judged)}"
    price = price_text(first_step.price, plan.currency)
    missing_aps = [last_step.judged.ap - step.judged.ap for step in plan.order]
    enough = next(i for i, missing in enumerate(missing_aps, 1) if missing <= AP_TOLERANCE)
    caption = (
        f"From {describe_count(enough, 'sensor')} on, more sensors add no more than "
        f"{AP_TOLERANCE:g} of AP."
    )
    if enough == len(plan.order):
        caption = f"Every sensor adds more than {AP_TOLERANCE:g} of AP."
    aps = list_aps((step.sensor, step.judged) for step in plan.order)
    columns = (
        Column("Step", digits=0),
        *text_columns("Sensor"),
        price_column("spent", plan.currency),
        *JUDGED_COLUMNS,
    )
    rows = [
        (i, step.sensor, step.price, *judged_cells(step.judged))
        for i, step in enumerate(plan.order, 1)
    ]
    return say(
        (
            f"Build {first_step.sensor} first: for {price} it alone gives "
            f"{ap_text(first_step.judged)}{last_text}."
        ),
        Drawing(
            charts.order_chart(plan.order, plan.currency),
            caption,
            f"AP after each sensor built: {aps}",
        ),
        *table("In this order, after each sensor", columns, rows),
    )


def views_section(
    plan: content.Plan, site: Site, moments: Sequence[content.SceneMoment]
) -> Content:
    """Show pictures of what each sensor sees, with its points on vehicles."""
    pictures = draw_sensor_views(site, site.sensors, moments)
    marks_note = (
        " Its points on vehicles of one moment are green where all sensors together find the "
        "vehicle, else red."
    )
    views = [
        Drawing(
            svg,
            f"{sensor.name}: the empty site, lighter where nearer.{marks_note if moments else ''}",
            f"Distances that sensor {sensor.name} measures at the empty site",
        )
        for sensor, svg in zip(site.sensors, pictures, strict=False)
    ]
    count = len(pictures)
    sensors = len(plan.sensors)
    which_sensors = (
        "Each sensor" if count == sensors else f"Each of the first {count} of {sensors} sensors"
    )
    return say(f"{which_sensors} looks at the junction from its pole as drawn here.", *views)


def build_document(
    plan: content.Plan,
    site: Site,
    ground: Ground | None,
    moments: Sequence[content.SceneMoment] = (),
) -> Document:
    """Build the document.

    site: site with the chosen sensors mounted; ground: ground that they see, None if unknown;
    moments: frames with the clouds of these sensors."""
    contents = dict.fromkeys(content.TEXTS["titles"], say(NOTHING_CHOSEN))
    contents["decision"] = decision_section(plan, site, ground)
    contents["ground"] = ground_section(plan, site, ground)
    contents["method"] = method_section(plan)
    if plan.chosen is not None:
        contents |= {
            "schedule": schedule_section(plan, site),
            "views": views_section(plan, site, moments),
            "materials": materials_section(plan),
            "detection": detection_section(plan),
            "failures": failures_section(plan, plan.chosen),
            "links": links_section(plan),
            "order": order_section(plan),
            "others": others_section(plan, plan.chosen),
            "schemes": schemes_section(plan),
            "worth": worth_section(plan),
        }
    sections = tuple(
        Section(key, title, *contents[key]) for key, title in content.TEXTS["titles"].items()
    )
    judged = f"{plan.detector}; AP at IoU {iou_text(plan.iou)}; {plan.scheme} fusion"
    head = [plan.head[key] for key in ("client", "date", "author") if plan.head.get(key)]
    subtitle = "; ".join([*head, judged if plan.detector else "No set was judged"])
    title = plan.head.get("title") or f"Deployment plan for {plan.site}"
    return Document(title, subtitle, sections, logo=plan.head.get("logo", ""))


def add_note(document: Document, note: str) -> Document:
    """Return the document with a note at the end of its first section, if there is a note."""
    if not note:
        return document
    first_section = document.sections[0]
    first_section = replace(first_section, blocks=(*first_section.blocks, Paragraph(note)))
    return replace(document, sections=(first_section, *document.sections[1:]))


def write_report(planned: content.Planned, out: Path) -> None:
    """Write `REPORT_FILES` into a folder, made if missing.

    Both are written or neither, with the same bytes each time. Raises ImportError without the
    packages of `coview[report]`, OSError if the folder cannot be written."""
    mounts = planned.candidates.mounts if planned.candidates else planned.site.mounts
    plan, site, note = settle_names(
        use_pole_names(planned.plan), replace(planned.site, mounts=mounts)
    )
    ground = planned.ground
    document = drop_unset(add_note(build_document(plan, site, ground, planned.moments), note))
    scene = None if plan.chosen is None else build_scene(plan, site, ground, planned.moments)
    with writing_together(out) as folder:
        (folder / "report.html").write_text(to_html(document, scene), encoding="utf-8")
        (folder / "report.pdf").write_bytes(to_pdf(document))
