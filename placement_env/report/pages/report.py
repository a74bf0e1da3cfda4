"""The report of a plan, as report.html and report.pdf. Its sections come in the order in which a
reader needs them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from placement_env.analysis.intervals import AP_TOLERANCE, is_comparable
from placement_env.cases import IoUs, iou_text
from placement_env.classes import join_names
from placement_env.handover.ground import Ground
from placement_env.handover.mounted import RATE
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
from toolkit.runtime.files import writing_together
from toolkit.sites.georeference import bearing_deg
from toolkit.sites.site import Site

ALIGNED = 0.5  # degrees up to which an axis of the site counts as east
MOST_SETS = 8  # of each kind in the table of other sets
JUDGED_COLUMNS = (
    Column("AP", digits=3),
    Column(f"{content.CONFIDENCE:.0%} interval"),
    Column("found", "%"),
    Column("vehicles", digits=0),
    Column("frames", digits=0),
)


def judged_cells(judged: content.Judgement | None) -> tuple[Cell | str | float | None, ...]:
    """Values of `JUDGED_COLUMNS`; dashes without anything to detect."""
    if judged is None:
        return None, "no vehicle", None, 0, None
    ap = Cell(judged.format_ap(), judged.ap)
    return (
        ap,
        Cell(interval_text(judged), judged.low),
        judged.recall,
        judged.vehicles,
        judged.frames,
    )


def text_columns(*titles: str) -> tuple[Column, ...]:
    """Columns of texts."""
    return tuple(Column(title, digits=None) for title in titles)


def price_column(title: str, currency: str) -> Column:
    """Column of prices."""
    return Column(title, currency or "units", 2)


def iou_value(iou: IoUs) -> float | str:
    """IoU threshold for a cell; words for several, whose mean counts."""
    return iou if isinstance(iou, float) else iou_text(iou)


def value_text(value: object) -> str:
    """Value of the question or provenance, as readers write."""
    if value is None or value == "" or value == [] or value == () or value == {}:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {value_text(each)}" for key, each in value.items())
    return ", ".join(map(value_text, value)) if isinstance(value, list | tuple) else str(value)


def others_section(plan: content.Plan, chosen: content.PlanOption) -> Content:
    """Sets that are as good as the chosen one, cheaper, better, or send less."""
    mine = _when_compared(plan, chosen)
    close = plan.near_optimal
    fronts = [each for each in plan.front if each not in close and each.sensors != chosen.sensors]
    if not (close or fronts):
        return say("No other judged set comes near the chosen one, costs less or sends less.")
    conclusion = (
        f"On the same frames, {describe_count(len(close), 'other set')} "
        f"{'is' if len(close) == 1 else 'are'} surely within 0.01 of the best; none is cheaper "
        "than the chosen set."
        if close
        else "On the same frames, no other set is surely within 0.01 of the best."
    )
    if not close and mine.counted is not None and not mine.counted.known:
        conclusion = (
            "The sets were compared on too few frames to say which are as good as the best: take "
            "more --frames."
        )
    best, judged = max(
        ((each, each.counted) for each in (mine, *fronts) if each.counted is not None),
        key=lambda each: each[1].ap,
        default=(mine, None),
    )
    if judged is not None and best is not mine:
        conclusion += (
            f" The highest AP, {ap_figure(judged)}, costs {price_text(best.price, plan.currency)}."
        )
    drawing = Drawing(
        charts.front_chart(plan.front, mine, plan.currency),
        f"The chosen set costs {price_text(chosen.price, plan.currency)} and sends "
        f"{number(chosen.kbit_per_sensor, 0)} kbit per sensor and frame.",
        "AP over kbit per sensor and over price for every set that no other beats in all three",
    )
    shown = sorted(
        (mine, *close, *fronts),
        key=lambda each: (each.price, -(each.counted.ap if each.counted else 0.0)),
    )
    kept = {id(each) for each in (mine, *close[:MOST_SETS], *fronts[:MOST_SETS])}
    caption = (
        "The chosen set, sets that are as good as the best, and sets that no other beats in AP, "
        "kbit and price"
    )
    sets = _option_table(caption, plan, chosen, [each for each in shown if id(each) in kept])
    return say(conclusion, *_explain_traffic(plan, chosen), drawing, *sets)


def _when_compared(plan: content.Plan, chosen: content.PlanOption) -> content.PlanOption:
    """The chosen set with its figures from the comparison."""
    return next(
        (each for each in (*plan.front, *plan.considered) if each.sensors == chosen.sensors), chosen
    )


def _explain_traffic(plan: content.Plan, chosen: content.PlanOption) -> tuple[Paragraph, ...]:
    """Explain why the set has another AP here."""
    compared = _when_compared(plan, chosen).counted
    cases = _cases_text(chosen)
    if compared is None or chosen.counted is None:
        return ()
    asked = (
        (Paragraph(f"The AP of each set in this section is that {cases}, as the question asks."),)
        if cases
        else ()
    )
    if compared == chosen.counted:
        return asked
    return (
        *asked,
        Paragraph(
            "The AP of each set in this section is from the traffic on which the sets were "
            f"compared. There the chosen set has {ap_figure(compared)}; its "
            f"{ap_figure(chosen.counted)} in the rest of the report is from other traffic, which "
            "had no say in the choice and is therefore the figure to trust."
        ),
    )


def _cases_text(chosen: content.PlanOption) -> str:
    """Cases behind the AP by which sets are compared, "" for the intact set in all traffic."""
    left = "" if chosen.left is None else "after the failures"
    levels = "" if chosen.over_levels is None else "over the levels of traffic"
    errors = "" if chosen.over_errors is None else "over the error profiles"
    return " and ".join(each for each in (left, levels, errors) if each)


def _option_table(
    caption: str,
    plan: content.Plan,
    chosen: content.PlanOption,
    options: Sequence[content.PlanOption],
) -> tuple[TableBlock, ...]:
    by_coverage = plan.provenance.get("search_fidelity") == "coverage"
    predicted = Column("coverage" if by_coverage else "predicted AP", digits=3)
    costs = price_column("price", plan.currency)
    columns = (
        *text_columns("Sensors"),
        predicted,
        *JUDGED_COLUMNS,
        Column("per sensor", "kbit"),
        costs,
    )
    rows = [
        (
            join_names(each.sensors) + (" (chosen)" if each.sensors == chosen.sensors else ""),
            *(each.predicted, *judged_cells(each.counted), each.kbit_per_sensor, each.price),
        )
        for each in options
    ]
    return table(caption, columns, rows)


def links_section(plan: content.Plan) -> Content:
    """Load of the links against their capacity."""
    if not plan.links:
        return say("No link carries anything.")
    narrow = [each.pole for each in plan.links if not each.fits]
    fullest = max(plan.links, key=lambda each: each.share)
    total = sum(each.mbit_s for each in plan.links)
    conclusion = (
        (
            f"{describe_count(len(narrow), 'link')} of {len(plan.links)} cannot carry what is "
            f"sent: {join_names(narrow)}."
        )
        if narrow
        else (
            f"Every link carries what is sent; the fullest, at {fullest.pole}, is used to "
            f"{percent(fullest.share)}: it needs {number(fullest.load_mbit_s, 2)} of "
            f"{number(fullest.capacity_mbit_s, 2)} Mbit/s."
        )
    )
    loads = [Column(name, "Mbit/s", 2) for name in ("mean", "load", "largest frame", "capacity")]
    columns = (*text_columns("Pole"), *loads, Column("used", "%"), *text_columns("fits"))
    rule = f"what is sent does not exceed in {describe_share(plan.link_share)}"
    rows = [
        (
            e.pole,
            e.mbit_s,
            e.load_mbit_s,
            e.peak_mbit_s,
            e.capacity_mbit_s,
            e.share,
            "yes" if e.fits else "no",
        )
        for e in plan.links
    ]
    each = "; ".join(
        f"{e.pole}: {number(e.mbit_s, 2)} of {number(e.capacity_mbit_s, 2)}" for e in plan.links
    )
    drawing = Drawing(
        charts.link_chart(plan.links),
        f"All links together carry {number(total, 2)} Mbit/s to the fusion centre.",
        f"Mbit/s of each link against its capacity: {each}",
    )
    caption = f"Load at {RATE:g} frames a second. A link must carry its load, which {rule}"
    return say(conclusion, drawing, *table(caption, columns, rows))


def materials_section(plan: content.Plan) -> Content:
    """Items to order."""
    if not plan.materials:
        return say("There is nothing to order.")
    dearest = max(plan.materials, key=lambda each: each.price)
    sums = sum(item.price for item in plan.materials), dearest.price, dearest.unit_price
    total, part, each = (price_text(price, plan.currency) for price in sums)
    units = () if plan.currency else (Paragraph("Prices are in units of one ordinary pole."),)
    prices = (price_column(title, plan.currency) for title in ("each", "total"))
    columns = (*text_columns("Item"), Column("count", digits=0), *prices)
    rows = [(item.item, item.count, item.unit_price, item.price) for item in plan.materials]
    later = [(item.item, item.count, item.unit_price, item.price) for item in plan.running]
    return say(
        (
            f"The total is {total}; the largest part, {part}, is “{dearest.item}” "
            f"({dearest.count} at {each})."
        ),
        *units,
        *table("What to order", columns, rows),
        *(table("What the rates add to the price", columns, later) if later else ()),
    )


def schedule_section(plan: content.Plan, site: Site) -> Content:
    """Place and aim of each sensor."""
    if not plan.sensors:
        return say("There is nothing to mount.")
    low, high = (pick(sensor.height for sensor in plan.sensors) for pick in (min, max))
    heights = f"{low:.1f} to {high:.1f}" if high - low >= 0.05 else f"{plan.sensors[0].height:.1f}"
    poles = describe_count(len({sensor.pole for sensor in plan.sensors}), "pole")
    on_earth = all(s.longitude is not None and s.latitude is not None for s in plan.sensors)
    along_x, along_y = (bearing_deg(site, heading) for heading in (0.0, np.pi / 2))
    x, y = ("east x", "north y") if abs(along_x - 90.0) < ALIGNED else ("x", "y")
    named = any(s.name != s.pole for s in plan.sensors)
    columns = (
        *text_columns(*(("Sensor", "Pole", "Model") if named else ("Pole", "Model"))),
        *(Column(name, "m", 2) for name in (x, y, "height")),
        *(Column(name, "°", 6) for name in (("longitude", "latitude") if on_earth else ())),
        *(Column(name, "°") for name in ("bearing", "tilt down")),
    )
    rows = [
        (
            *((s.name, s.pole, s.model) if named else (s.pole, s.model)),
            *(s.x, s.y, s.height),
            *((s.longitude, s.latitude) if on_earth else ()),
            *(s.bearing_deg, s.tilt_deg),
        )
        for s in plan.sensors
    ]
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
    """Computation, assumptions, unknowns and provenance."""
    judged = plan.chosen.judged if plan.chosen else None
    amount = ""
    if judged:
        amount = (
            f", {describe_count(judged.vehicles, judged.kind)} in "
            f"{describe_count(judged.frames, 'frame')}"
        )
    conclusion = (
        f"Every AP here is that of {plan.detector} in simulated traffic{amount}: it ranks places "
        "for sensors, and does not replace a trial on the street."
        if plan.detector
        else "No detector judged anything, because no set of sensors may be built."
    )
    why = (Paragraph(plan.verdict.sentence), Bullets(plan.why)) if plan.why else ()
    blocks: list[ReportBlock] = [*why]
    if plan.considered:
        judged_sets = sum(each.judged is not None for each in plan.considered)
        found = {name for option in plan.considered for name in option.searches}
        by = f", found by the searches {join_names(sorted(found))}" if found else ""
        sets = (
            f"{describe_count(len(plan.considered), 'set')} of sensors reached the final "
            f"comparison{by}; "
        )
        blocks.append(
            Paragraph(f"{sets}the detector judged {judged_sets} of them on all of its traffic.")
        )
    for heading, sentences in (
        ("What it assumes:", plan.assumptions),
        ("What it does not know:", plan.unknown),
    ):
        if sentences:
            blocks += [Paragraph(heading), Bullets(sentences)]
    asked = [
        (str(key).replace("_", " "), value_text(value)) for key, value in plan.question.items()
    ]
    settings = table("The question that this plan answers", text_columns("Asked", "Value"), asked)
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


SPARSE = 1.0  # points per m² below which a place is practically unseen


def ground_section(plan: content.Plan, site: Site, ground: Ground | None) -> Content:
    """Visible ground, density of points and blind spots."""
    if plan.ground is None or ground is None:
        why = "" if plan.chosen else ", because no set of sensors was chosen"
        return say(f"The visible ground was not computed{why}.")
    shares = plan.ground
    twice = percent(plan.ground.seen_by[1])
    conclusion = (
        f"At least one sensor sees {percent(shares.seen_by[0])} of the open ground, and two or "
        f"more see {twice}; no sensor sees {number(shares.blind_m2, 0)} m², or "
        f"{percent(shares.blind_lanes)} of the lanes."
    )
    covered = Drawing(
        coverage_map(site, ground, site.sensors),
        (
            f"Where two or more sensors look, on {twice} of the open ground, one may fail and the "
            "place is still seen."
        ),
        (
            f"Map of how many of the sensors {join_names([s.name for s in plan.sensors])} see each "
            "place of the ground"
        ),
    )
    lanes = ground.lanes & ground.open_ground
    caption = "No lane lies in the area; the density is that of all open ground."
    if lanes.any():
        density = ground.density.sum(0, dtype=np.float64)[lanes]
        enough = density[density >= SPARSE]
        typical = float(np.median(enough)) if len(enough) else None
        caption = (
            f"{percent(float((density < SPARSE).mean()))} of the lanes' ground gets fewer than "
            f"{SPARSE:g} point per m² in a frame, too few to tell what is there; the other lanes "
            f"get {number(typical, 0)} per m² in the middle case."
        )
    alt = (
        "Map of the points per square metre that all sensors together put on the ground in a frame"
    )
    dense = Drawing(density_map(site, ground, site.sensors), caption, alt)
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
    return say(conclusion, covered, dense, blind, *table(caption, columns, rows), scene)


def detection_section(plan: content.Plan) -> Content:
    """AP by place, level of traffic, error profile and class."""
    parts = (
        ("zone", plan.by_zone),
        ("distance", plan.by_range),
        ("lane approach", plan.by_approach),
    )
    judged = [(row.name, row.judged) for _, rows in parts for row in rows if row.judged is not None]
    if not (judged or plan.by_class):
        return say("There was no vehicle to detect.")
    conclusion = "There was no vehicle to detect in any part of the site."
    if judged:
        conclusion = (
            "There are too few frames to compare parts of the site: 80 or more give an AP its "
            "interval."
        )
    comparable = [(name, each) for name, each in judged if _is_comparable(each)]
    if len(comparable) > 1:
        (worst, low), (best, high) = _extremes(comparable)
        conclusion = (
            f"Detection is weakest at “{worst}”, {ap_text(low)}, and best at “{best}”, "
            f"{ap_text(high)}."
        )
        if content.overlap(low, high):
            alike = "No part of the site is clearly worse than another"
            conclusion = f"{alike}: the weakest, “{worst}”, has {ap_text(low)}."
    conditions = (("level of traffic", plan.by_level), ("error profile", plan.by_errors))
    blocks = [block for name, rows in (*parts, *conditions) for block in _breakdown(name, rows)]
    return say(conclusion, *blocks, *_class_ap(plan), *_coverage(plan))


def _extremes(
    judged: Sequence[tuple[str, content.Judgement]],
) -> list[tuple[str, content.Judgement]]:
    return [pick(judged, key=lambda each: each[1].ap) for pick in (min, max)]


def _is_comparable(judged: content.Judgement) -> bool:
    """True if an AP has an interval, and road users enough, to be held against another."""
    return judged.known and is_comparable(judged.frames, judged.vehicles)


def _breakdown(name: str, rows: Sequence[content.BreakdownRow]) -> tuple[ReportBlock, ...]:
    judged = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not judged:
        return (
            (Paragraph(f"AP by {name} is unknown: there was no vehicle to detect."),)
            if rows
            else ()
        )
    comparable = [(place, each) for place, each in judged if _is_comparable(each)]
    caption = (
        f"By {name}, there is too little to compare: an AP of few frames or road users is left to "
        "chance."
    )
    if len(judged) == 1:
        caption = f"By {name}, only “{judged[0][0]}” had vehicles: {ap_text(judged[0][1])}."
    elif len(comparable) > 1:
        (worst, low), (best, high) = _extremes(comparable)
        apart = (
            "the intervals overlap"
            if content.overlap(low, high)
            else "the intervals do not overlap"
        )
        ends = f"from {low.format_ap()} at “{worst}” to {high.format_ap()} at “{best}”"
        caption = f"By {name}, AP ranges {ends}; {apart}."
    chart = charts.interval_bars(judged, f"AP by {name}")
    columns = (
        *text_columns(name.capitalize()),
        *JUDGED_COLUMNS,
        Column("points per vehicle", digits=0),
    )
    cells = [(row.name, *judged_cells(row.judged), row.mean_points) for row in rows]
    found = table(f"AP and share of vehicles found, by {name}", columns, cells)
    return Drawing(chart, caption, f"AP with intervals by {name}: {list_aps(judged)}"), *found


def _coverage(plan: content.Plan) -> tuple[ReportBlock, ...]:
    if not plan.by_class:
        return ()
    seen = [(row, row.share) for row in plan.by_class if row.share is not None and row.objects]
    text = "No road user of any class crossed the site."
    if seen:
        low, share = min(seen, key=lambda each: each[1])
        text = (
            f"The class covered least is {low.label}: {percent(share)} of "
            f"{describe_count(low.objects, 'road user')} had at least "
            f"{describe_count(low.least_points, 'point')} on them. These are shares of coverage, "
            "not AP."
        )
    counts = Column("road users", digits=0), Column("points required", digits=0)
    rows = [(row.label, row.objects, row.least_points, row.share) for row in plan.by_class]
    columns = (*text_columns("Class"), *counts, Column("covered", "%"))
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
    """Early, late and hybrid fusion of the same sensors."""
    if not plan.schemes:
        return say("No other fusion scheme was judged.")
    most, least = (pick(plan.schemes, key=lambda each: each.kbit_per_sensor) for pick in (max, min))
    caption = (
        (
            f"A sensor sends {number(most.kbit_per_sensor, 0)} kbit per frame with {most.scheme} "
            "fusion."
        )
        if least.kbit_per_sensor <= 0 or most is least
        else (
            f"{most.scheme.capitalize()} fusion sends "
            f"{most.kbit_per_sensor / least.kbit_per_sensor:.1f} times as much as {least.scheme} "
            "fusion."
        )
    )
    aps = list_aps(
        (f"{each.scheme} at IoU {iou_text(each.iou)}", each.judged) for each in plan.schemes
    )
    columns = (
        *text_columns("Scheme"),
        Column("IoU"),
        *JUDGED_COLUMNS,
        Column("per sensor", "kbit"),
    )
    rows = [
        (e.scheme, iou_value(e.iou), *judged_cells(e.judged), e.kbit_per_sensor)
        for e in plan.schemes
    ]
    return say(
        _compare_schemes(
            plan, [each for each in plan.schemes if each.iou == plan.iou] or plan.schemes
        ),
        Paragraph(content.TEXTS["schemes"]),
        Drawing(
            charts.scheme_chart(plan.schemes),
            caption,
            f"AP with intervals of the fusion schemes: {aps}",
        ),
        *table("The chosen sensors with each fusion scheme", columns, rows),
    )


def _compare_schemes(plan: content.Plan, judged: Sequence[content.SchemeFigures]) -> str:
    best = max(judged, key=lambda each: each.judged.ap)
    least = min(judged, key=lambda each: each.kbit_per_sensor)
    mine = next((each for each in judged if each.scheme == plan.scheme), best)
    sent = (
        f"{mine.scheme} fusion sends {number(mine.kbit_per_sensor, 0)} kbit per sensor and frame, "
    )
    sent += (
        "the least"
        if mine is least
        else f"{least.scheme} fusion, the least, {number(least.kbit_per_sensor, 0)}"
    )
    if mine is best:
        return (
            f"{mine.scheme.capitalize()} fusion, as planned, has the highest AP, "
            f"{ap_figure(mine.judged)}; {sent}."
        )
    apart = "the difference may be due to chance"
    if best.as_good:
        apart = "on the same frames they cannot be told apart"
    elif not (_is_comparable(best.judged) and _is_comparable(mine.judged)):
        apart = "the frames are too few to compare them"
    elif not content.overlap(best.judged, mine.judged):
        apart = "the difference is not due to chance"
    return (
        f"{best.scheme.capitalize()} fusion has the highest AP, {best.judged.format_ap()} "
        f"({interval_text(best.judged)}), against {mine.judged.format_ap()} "
        f"({interval_text(mine.judged)}) with {mine.scheme} fusion as planned, and {apart}; "
        f"{sent}."
    )


def worth_section(plan: content.Plan) -> Content:
    """Worth of each sensor, and good pairs."""
    if not plan.worth:
        return say("The worth of the sensors was not computed.")
    if len(plan.worth) == 1:
        only = plan.worth[0]
        return say(
            f"There is one sensor, {only.sensor}, and all of the AP is its own: "
            f"{number(only.shapley)}."
        )
    most, least = (pick(plan.worth, key=lambda each: each.shapley) for pick in (max, min))
    said = f"{most.sensor} is worth most, {number(most.shapley)} AP"
    conclusion = f"{said}, and {least.sensor} least, {number(least.shapley)}."
    pairs = {
        tuple(sorted((each.sensor, other))): value
        for each in plan.worth
        for other, value in each.synergy.items()
    }
    if pairs:
        best, worst = (pick(pairs, key=lambda pair: pairs[pair]) for pick in (max, min))
        if pairs[best] > 0:
            conclusion += f" {join_names(best)} complement each other best ({pairs[best]:+.3f})."
        if pairs[worst] < 0:
            conclusion += f" {join_names(worst)} duplicate each other most ({pairs[worst]:+.3f})."
    names = [each.sensor for each in plan.worth]
    total = sum(each.shapley for each in plan.worth)
    columns = (
        *text_columns("Sensor"),
        Column("worth", "AP", 3),
        *(Column(f"with {name}", "AP") for name in names),
    )
    synergies = [[each.synergy.get(name) for name in names] for each in plan.worth]
    rows = [
        (
            each.sensor,
            each.shapley,
            *(None if value is None else Cell(f"{value:+.3f}", value) for value in own),
        )
        for each, own in zip(plan.worth, synergies, strict=True)
    ]
    caption = (
        f"{most.sensor} accounts for {percent(most.shapley / total if total else None)} of what "
        "all sensors add."
    )
    values = "; ".join(f"{each.sensor} {number(each.shapley)}" for each in plan.worth)
    return say(
        conclusion,
        Paragraph(content.TEXTS["worth"]),
        Drawing(charts.worth_chart(plan.worth), caption, f"Worth of each sensor in AP: {values}"),
        *table("Worth, and synergy with each other sensor", columns, rows),
    )


def failures_section(plan: content.Plan, chosen: content.PlanOption) -> Content:
    """AP left when one or two sensors fail."""
    intact = chosen.judged
    if intact is None or not plan.failures:
        return say("No failure leaves a working sensor.")
    conclusion = f"All sensors together give {ap_text(intact)}."
    for count in sorted({len(each.failed) for each in plan.failures}):
        case = min(
            (e for e in plan.failures if len(e.failed) == count), key=lambda each: each.judged.ap
        )
        conclusion += (
            f" If {describe_count(count, 'sensor')} {'fails' if count == 1 else 'fail'}, the "
            f"worst loss is that of {join_names(case.failed)}: {ap_text(case.judged)} is left."
        )
    harmless = sum(intact.ap - each.judged.ap <= AP_TOLERANCE for each in plan.failures)
    cases = describe_count(len(plan.failures), "case")
    caption = f"In {harmless} of {cases} no more than {AP_TOLERANCE:g} of the AP is lost."
    left = list_aps((f"without {join_names(each.failed)}", each.judged) for each in plan.failures)
    columns = (*text_columns("Failed"), *JUDGED_COLUMNS, Column("lost", "AP", 3))
    rows = [
        (join_names(e.failed), *judged_cells(e.judged), intact.ap - e.judged.ap)
        for e in plan.failures
    ]
    drawing = Drawing(charts.failure_chart(intact, plan.failures), caption, f"AP left: {left}")
    return say(conclusion, drawing, *table("What is left, case by case", columns, rows))


def order_section(plan: content.Plan) -> Content:
    """Order in which to build the sensors."""
    if not plan.order:
        return say("No order of building was computed.")
    first = plan.order[0]
    last = plan.order[-1]
    then = (
        "" if last is first else f"; the last, {last.sensor}, brings it to {ap_text(last.judged)}"
    )
    price = price_text(first.price, plan.currency)
    rest = [last.judged.ap - each.judged.ap for each in plan.order]
    enough = next(i for i, missing in enumerate(rest, 1) if missing <= AP_TOLERANCE)
    caption = (
        f"From {describe_count(enough, 'sensor')} on, more sensors add no more than "
        f"{AP_TOLERANCE:g} of AP."
    )
    if enough == len(plan.order):
        caption = f"Every sensor adds more than {AP_TOLERANCE:g} of AP."
    aps = list_aps((each.sensor, each.judged) for each in plan.order)
    columns = (
        Column("Step", digits=0),
        *text_columns("Sensor"),
        price_column("spent", plan.currency),
        *JUDGED_COLUMNS,
    )
    rows = [
        (i, each.sensor, each.price, *judged_cells(each.judged))
        for i, each in enumerate(plan.order, 1)
    ]
    return say(
        f"Build {first.sensor} first: for {price} it alone gives {ap_text(first.judged)}{then}.",
        Drawing(
            charts.order_chart(plan.order, plan.currency),
            caption,
            f"AP after each sensor built: {aps}",
        ),
        *table("In this order, after each sensor", columns, rows),
    )


REPORT_FILES = ("report.html", "report.pdf")
NOTHING_CHOSEN = "No set of sensors may be built, so there is nothing to show here."


def views_section(plan: content.Plan, site: Site, moments: Sequence[content.Moment]) -> Content:
    """Pictures of what each sensor sees, with its points on the vehicles of a moment."""
    drawn = draw_sensor_views(site, site.sensors, moments)
    marked = (
        " Its points on vehicles of one moment are green where all sensors together find the "
        "vehicle, else red."
    )
    views = [
        Drawing(
            svg,
            f"{sensor.name}: the empty site, lighter where nearer.{marked if moments else ''}",
            f"Distances that sensor {sensor.name} measures at the empty site",
        )
        for sensor, svg in zip(site.sensors, drawn, strict=False)
    ]
    count = len(drawn)
    sensors = len(plan.sensors)
    shown = "Each sensor" if count == sensors else f"Each of the first {count} of {sensors} sensors"
    return say(f"{shown} looks at the junction from its pole as drawn here.", *views)


def build_document(
    plan: content.Plan, site: Site, ground: Ground | None, moments: Sequence[content.Moment] = ()
) -> Document:
    """Build the document. site: with the chosen sensors mounted; ground: that they see, None if
    unknown; moments: with the clouds of these sensors."""
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
    """Return the document with a note at the end of its first section, unchanged without one."""
    if not note:
        return document
    head, *rest = document.sections
    return replace(
        document, sections=(replace(head, blocks=(*head.blocks, Paragraph(note))), *rest)
    )


def write_report(planned: content.Planned, out: Path) -> None:
    """Write `REPORT_FILES` into a folder, made if missing. Both are written or neither, with the
    same bytes each time. Raises ImportError without the packages of `coview[report]`, OSError if
    the folder cannot be written."""
    offered = planned.candidates.mounts if planned.candidates else planned.site.mounts
    plan, site, note = settle_names(
        use_pole_names(planned.plan), replace(planned.site, mounts=offered)
    )
    ground = planned.ground
    document = drop_unset(add_note(build_document(plan, site, ground, planned.moments), note))
    scene = None if plan.chosen is None else build_scene(plan, site, ground, planned.moments)
    with writing_together(out) as folder:
        (folder / "report.html").write_text(to_html(document, scene), encoding="utf-8")
        (folder / "report.pdf").write_bytes(to_pdf(document))
