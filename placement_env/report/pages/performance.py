"""Sections on the performance of the set: visible ground, detection by place and case, schemes, and worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from placement_env.cases import iou_text
from placement_env.handover.ground import Ground
from placement_env.report.charts import failure_chart, interval_bars, order_chart, scheme_chart, worth_chart
from placement_env.report.content import BreakdownRow, Judgement, Plan, PlanOption, SchemeFigures, overlap
from placement_env.report.maps import blind_map, coverage_map, density_map
from placement_env.report.pages.document import (
    Cell,
    Column,
    Content,
    Drawing,
    Paragraph,
    ReportBlock,
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
    interval_text,
    iou_value,
    join_names,
    judged_cells,
    list_aps,
    percent,
    price_column,
    price_text,
    text_columns,
)
from toolkit.sites.site import Site

SPARSE = 1.0  # points per m² below which a place is practically unseen
SCHEMES_EXPLAINED = (
    "With early fusion every sensor sends its points and one detector looks at all of them; with late fusion every "
    "sensor detects for itself and sends only what it found; with hybrid fusion a sensor sends what it found nearby "
    "and points from further away."
)
SHAPLEY = (
    "The worth of a sensor (its Shapley value) is the AP that it adds, on average over every order in which the "
    "sensors could be built; the values of all sensors add up to the AP of the whole set. The synergy of two sensors "
    "is above 0 if they add more together than each alone, and below 0 if they see much the same."
)


def ground_section(plan: Plan, site: Site, ground: Ground | None) -> Content:
    """Visible ground, density of points and blind spots."""
    if plan.ground is None or ground is None:
        return say(
            f"The visible ground was not computed{'' if plan.chosen else ', because no set of sensors was chosen'}.",
        )
    shares, twice = plan.ground, percent(plan.ground.seen_by[1])
    conclusion = (
        f"At least one sensor sees {percent(shares.seen_by[0])} of the open ground, and two or more see {twice}; no "
        f"sensor sees {number(shares.blind_m2, 0)} m², or {percent(shares.blind_lanes)} of the lanes."
    )
    covered = Drawing(
        coverage_map(site, ground, site.sensors),
        f"Where two or more sensors look, on {twice} of the open ground, one may fail and the place is still seen.",
        f"Map of how many of the sensors {join_names([s.name for s in plan.sensors])} see each place of the ground",
    )
    caption, lanes = (
        "No lane lies in the area; the density is that of all open ground.",
        ground.lanes & ground.open_ground,
    )
    if lanes.any():
        density = ground.density.sum(0, dtype=np.float64)[lanes]
        caption = (
            f"Half of the lanes' ground gets {number(float(np.median(density)), 1)} points per m² or more in a frame; "
            f"{percent(float((density < SPARSE).mean()))} of it gets fewer than {SPARSE:g}, too few to tell what is "
            "there."
        )
    alt = "Map of the points per square metre that all sensors together put on the ground in a frame"
    dense = Drawing(density_map(site, ground, site.sensors), caption, alt)
    blind = Drawing(
        blind_map(site, ground, site.sensors),
        f"{number(shares.blind_m2, 0)} m², {percent(shares.blind)} of the open ground, are hidden from every "
        "sensor or lie outside their fields of view.",
        "Map of the ground that no sensor sees: lanes, footways and the rest",
    )
    rows = [
        (name, area, in_percent(area / shares.open_m2 if shares.open_m2 else None))
        for name, area in shares.sensor_m2.items()
    ]
    columns = (*text_columns("Sensor"), Column("sees", "m²", 0), Column("of the open ground", "%"))
    caption = "Ground that each sensor sees; ground that two sensors see counts for both"
    return say(conclusion, covered, dense, blind, *table(caption, columns, rows))


def detection_section(plan: Plan) -> Content:
    """AP by place, level of traffic, error profile and class."""
    parts = (("zone", plan.by_zone), ("distance", plan.by_range), ("lane approach", plan.by_approach))
    judged = [(row.name, row.judged) for _, rows in parts for row in rows if row.judged is not None]
    if not (judged or plan.by_class):
        return say("There was no vehicle to detect.")
    conclusion = "There was no vehicle to detect in any part of the site."
    if judged:
        (worst, low), (best, high) = _extremes(judged)
        conclusion = (
            f"No part of the site is clearly worse than another: the weakest, “{worst}”, has {ap_text(low)}."
            if overlap(low, high)
            else f"Detection is weakest at “{worst}”, {ap_text(low)}, and best at “{best}”, {ap_text(high)}."
        )
    conditions = (("level of traffic", plan.by_level), ("error profile", plan.by_errors))
    blocks = [block for name, rows in (*parts, *conditions) for block in _breakdown(name, rows)]
    return say(conclusion, *blocks, *_class_ap(plan), *_coverage(plan))


def _extremes(judged: Sequence[tuple[str, Judgement]]) -> list[tuple[str, Judgement]]:
    return [pick(judged, key=lambda each: each[1].ap) for pick in (min, max)]


def _breakdown(name: str, rows: Sequence[BreakdownRow]) -> tuple[ReportBlock, ...]:
    judged = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not judged:
        return (Paragraph(f"AP by {name} is unknown: there was no vehicle to detect."),) if rows else ()
    (worst, low), (best, high) = _extremes(judged)
    apart = "the intervals overlap" if overlap(low, high) else "the intervals do not overlap"
    caption = (
        f"By {name}, AP ranges from {number(low.ap)} at “{worst}” to {number(high.ap)} at “{best}”; {apart}."
        if len(judged) > 1
        else f"By {name}, only “{worst}” had vehicles: {ap_text(low)}."
    )
    chart = interval_bars(judged, f"AP by {name}")
    columns = (*text_columns(name.capitalize()), *JUDGED_COLUMNS, Column("points per vehicle", digits=0))
    cells = [(row.name, *judged_cells(row.judged), row.mean_points) for row in rows]
    found = table(f"AP and share of vehicles found, by {name}", columns, cells)
    return Drawing(chart, caption, f"AP with intervals by {name}: {list_aps(judged)}"), *found


def _coverage(plan: Plan) -> tuple[ReportBlock, ...]:
    """Coverage of each class of road user."""
    if not plan.by_class:
        return ()
    seen = [(row, row.share) for row in plan.by_class if row.share is not None and row.objects]
    text = "No road user of any class crossed the site."
    if seen:
        low, share = min(seen, key=lambda each: each[1])
        text = (
            f"The class covered least is {low.label}: {percent(share)} of {count_text(low.objects, 'road user')} had "
            f"at least {count_text(low.least_points, 'point')} on them. These are shares of coverage, not AP"
            + (": the detector knows vehicles only." if len(plan.class_ap) < 2 else ".")
        )
    counts = Column("road users", digits=0), Column("points required", digits=0)
    rows = [(row.label, row.objects, row.least_points, in_percent(row.share)) for row in plan.by_class]
    columns = (*text_columns("Class"), *counts, Column("covered", "%"))
    return Paragraph(text), *table("Coverage by class of road user (not AP)", columns, rows)


def _class_ap(plan: Plan) -> tuple[ReportBlock, ...]:
    """AP of each class, if several count."""
    if len(plan.class_ap) < 2:
        return ()
    low = min(plan.class_ap, key=lambda row: row.judged.ap)
    text = f"The class detected worst is {low.label}: {ap_text(low.judged)} at IoU {iou_text(low.iou)}."
    columns = (*text_columns("Class"), Column("IoU"), Column("weight"), *JUDGED_COLUMNS)
    rows = [(row.label, iou_value(row.iou), row.weight, *judged_cells(row.judged)) for row in plan.class_ap]
    return Paragraph(text), *table("AP of each class with the chosen set", columns, rows)


def schemes_section(plan: Plan) -> Content:
    """Early, late and hybrid fusion of the same sensors."""
    if not plan.schemes:
        return say("No other fusion scheme was judged.")
    most, least = (pick(plan.schemes, key=lambda each: each.kbit_per_sensor) for pick in (max, min))
    caption = (
        f"A sensor sends {number(most.kbit_per_sensor, 0)} kbit per frame with {most.scheme} fusion."
        if least.kbit_per_sensor <= 0 or most is least
        else f"{most.scheme.capitalize()} fusion sends {most.kbit_per_sensor / least.kbit_per_sensor:.1f} times as "
        f"much as {least.scheme} fusion."
    )
    aps = list_aps((f"{each.scheme} at IoU {iou_text(each.iou)}", each.judged) for each in plan.schemes)
    columns = (*text_columns("Scheme"), Column("IoU"), *JUDGED_COLUMNS, Column("per sensor", "kbit"))
    rows = [(e.scheme, iou_value(e.iou), *judged_cells(e.judged), e.kbit_per_sensor) for e in plan.schemes]
    return say(
        _compare_schemes(plan, [each for each in plan.schemes if each.iou == plan.iou] or plan.schemes),
        Paragraph(SCHEMES_EXPLAINED),
        Drawing(scheme_chart(plan.schemes), caption, f"AP with intervals of the fusion schemes: {aps}"),
        *table("The chosen sensors with each fusion scheme", columns, rows),
    )


def _compare_schemes(plan: Plan, judged: Sequence[SchemeFigures]) -> str:
    best = max(judged, key=lambda each: each.judged.ap)
    least = min(judged, key=lambda each: each.kbit_per_sensor)
    mine = next((each for each in judged if each.scheme == plan.scheme), best)
    sent = f"{mine.scheme} fusion sends {number(mine.kbit_per_sensor, 0)} kbit per sensor and frame, "
    sent += "the least" if mine is least else f"{least.scheme} fusion, the least, {number(least.kbit_per_sensor, 0)}"
    if mine is best:
        return f"{mine.scheme.capitalize()} fusion, as planned, has the highest AP, {ap_figure(mine.judged)}; {sent}."
    apart = "their intervals overlap" if overlap(mine.judged, best.judged) else "their intervals do not overlap"
    return (
        f"{best.scheme.capitalize()} fusion has the highest AP, {number(best.judged.ap)} "
        f"({interval_text(best.judged)}), against {number(mine.judged.ap)} ({interval_text(mine.judged)}) with "
        f"{mine.scheme} fusion as planned, and {apart}; {sent}."
    )


def worth_section(plan: Plan) -> Content:
    """Worth of each sensor, and good pairs."""
    if not plan.worth:
        return say("The worth of the sensors was not computed.")
    if len(plan.worth) == 1:
        only = plan.worth[0]
        return say(f"There is one sensor, {only.sensor}, and all of the AP is its own: {number(only.shapley)}.")
    most, least = (pick(plan.worth, key=lambda each: each.shapley) for pick in (max, min))
    conclusion = (
        f"{most.sensor} is worth most, {number(most.shapley)} AP, and {least.sensor} least, {number(least.shapley)}."
    )
    pairs = {tuple(sorted((each.sensor, other))): value for each in plan.worth for other, value in each.synergy.items()}
    if pairs:
        best, worst = (pick(pairs, key=lambda pair: pairs[pair]) for pick in (max, min))
        if pairs[best] > 0:
            conclusion += f" {join_names(best)} complement each other best ({pairs[best]:+.3f})."
        if pairs[worst] < 0:
            conclusion += f" {join_names(worst)} duplicate each other most ({pairs[worst]:+.3f})."
    names, total = [each.sensor for each in plan.worth], sum(each.shapley for each in plan.worth)
    columns = (*text_columns("Sensor"), Column("worth", "AP", 3), *(Column(f"with {name}", "AP") for name in names))
    rows = [
        (
            each.sensor,
            each.shapley,
            *(
                Cell(f"{each.synergy[name]:+.3f}", each.synergy[name]) if name in each.synergy else None
                for name in names
            ),
        )
        for each in plan.worth
    ]
    caption = f"{most.sensor} accounts for {percent(most.shapley / total if total else None)} of what all sensors add."
    values = "; ".join(f"{each.sensor} {number(each.shapley)}" for each in plan.worth)
    return say(
        conclusion,
        Paragraph(SHAPLEY),
        Drawing(worth_chart(plan.worth), caption, f"Worth of each sensor in AP: {values}"),
        *table("Worth, and synergy with each other sensor", columns, rows),
    )


def failures_section(plan: Plan, chosen: PlanOption) -> Content:
    """AP left when one or two sensors fail."""
    intact = chosen.judged
    if intact is None or not plan.failures:
        return say("No failure leaves a working sensor.")
    conclusion = f"All sensors together give {ap_text(intact)}."
    for count in sorted({len(each.failed) for each in plan.failures}):
        case = min((e for e in plan.failures if len(e.failed) == count), key=lambda each: each.judged.ap)
        conclusion += (
            f" If {count_text(count, 'sensor')} {'fails' if count == 1 else 'fail'}, the worst loss is that of "
            f"{join_names(case.failed)}: {ap_text(case.judged)} is left."
        )
    harmless = sum(overlap(each.judged, intact) for each in plan.failures)
    caption = (
        f"In {harmless} of {count_text(len(plan.failures), 'case')} the loss is so small that the interval still "
        "overlaps that of the whole set."
    )
    left = list_aps((f"without {join_names(each.failed)}", each.judged) for each in plan.failures)
    columns = (*text_columns("Failed"), *JUDGED_COLUMNS, Column("lost", "AP", 3))
    rows = [(join_names(e.failed), *judged_cells(e.judged), intact.ap - e.judged.ap) for e in plan.failures]
    drawing = Drawing(failure_chart(intact, plan.failures), caption, f"AP left: {left}")
    return say(conclusion, drawing, *table("What is left, case by case", columns, rows))


def order_section(plan: Plan) -> Content:
    """Order in which to build the sensors."""
    if not plan.order:
        return say("No order of building was computed.")
    first, last = plan.order[0], plan.order[-1]
    then = "" if last is first else f"; the last, {last.sensor}, brings it to {ap_text(last.judged)}"
    price = price_text(first.price, plan.currency)
    enough = next(i for i, each in enumerate(plan.order, 1) if overlap(each.judged, last.judged))
    caption = (
        "Every sensor adds more than the intervals leave open."
        if enough == len(plan.order)
        else f"From {count_text(enough, 'sensor')} on, the interval overlaps that of all: the gain from more is "
        "uncertain."
    )
    aps = list_aps((each.sensor, each.judged) for each in plan.order)
    columns = (Column("Step", digits=0), *text_columns("Sensor"), price_column("spent", plan.currency), *JUDGED_COLUMNS)
    rows = [(i, each.sensor, each.price, *judged_cells(each.judged)) for i, each in enumerate(plan.order, 1)]
    return say(
        f"Build {first.sensor} first: for {price} it alone gives {ap_text(first.judged)}{then}.",
        Drawing(order_chart(plan.order, plan.currency), caption, f"AP after each sensor built: {aps}"),
        *table("In this order, after each sensor", columns, rows),
    )
