"""Sections on the performance of the set.

They cover visible ground, detection by place and case, schemes, and each sensor's worth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from placement_env.cases import iou_text
from placement_env.handover.ground import Ground, GroundShares
from placement_env.report.charts import failure_chart, interval_bars, order_chart, scheme_chart, worth_chart
from placement_env.report.content import BreakdownRow, BuildStep, FailureCase, Judgement, Plan, SchemeFigures, overlap
from placement_env.report.maps import blind_map, coverage_map, density_map
from placement_env.report.pages.document import Cell, Column, Drawing, Paragraph, ReportBlock, Section, table
from placement_env.report.pages.wording import (
    JUDGED_COLUMNS,
    NONE,
    NOTHING_CHOSEN,
    ap_figure,
    ap_text,
    count_text,
    figure_cell,
    format_cells,
    interval_text,
    iou_cell,
    join_names,
    number,
    percent,
    price_column,
    price_text,
    share_cell,
    text_cell,
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


def ground_section(plan: Plan, site: Site, ground: Ground | None) -> Section:
    """Visible ground, density of points and blind spots. It also shows the number of sensors that see each place."""
    key, title = "ground", "What the sensors see of the ground"
    if plan.ground is None or ground is None:
        why = "." if plan.chosen else ", because no set of sensors was chosen."
        return Section(key, title, f"The visible ground was not computed{why}")
    shares = plan.ground
    conclusion = (
        f"At least one sensor sees {percent(shares.seen_by[0])} of the open ground, and two or more see "
        f"{percent(shares.seen_by[1])}; no sensor sees {number(shares.blind_m2, 0)} m², or "
        f"{percent(shares.blind_lanes)} of the lanes."
    )
    rows = [
        (text_cell(name), figure_cell(area, 0), share_cell(area / shares.open_m2 if shares.open_m2 else None))
        for name, area in shares.sensor_m2.items()
    ]
    columns = (Column("Sensor", number=False), Column("sees", "m²"), Column("of the open ground", "%"))
    areas = table("Ground that each sensor sees; ground that two sensors see counts for both", columns, rows)
    return Section(key, title, conclusion, (*_maps(plan, shares, site, ground), *areas))


def _maps(plan: Plan, shares: GroundShares, site: Site, ground: Ground) -> tuple[ReportBlock, ...]:
    twice, lanes = shares.seen_by[1], ground.lanes & ground.open_ground
    names = join_names([sensor.name for sensor in plan.sensors])
    return (
        Drawing(
            coverage_map(site, ground, site.sensors),
            f"Where two or more sensors look, on {percent(twice)} of the open ground, one may fail and the place is "
            "still seen.",
            f"Map of how many of the sensors {names} see each place of the ground",
        ),
        Drawing(
            density_map(site, ground, site.sensors),
            _describe_density(ground, lanes),
            "Map of the points per square metre that all sensors together put on the ground in a frame",
        ),
        Drawing(
            blind_map(site, ground, site.sensors),
            f"{number(shares.blind_m2, 0)} m², {percent(shares.blind)} of the open ground, are hidden from every "
            "sensor or lie outside their fields of view.",
            "Map of the ground that no sensor sees: lanes, footways and the rest",
        ),
    )


def _describe_density(ground: Ground, lanes: np.ndarray) -> str:
    if not lanes.any():
        return "No lane lies in the area; the density is that of all open ground."
    density = ground.density.sum(0, dtype=np.float64)[lanes]
    return (
        f"Half of the lanes' ground gets {number(float(np.median(density)), 1)} points per m² or more in a frame; "
        f"{percent(float((density < SPARSE).mean()))} of it gets fewer than {SPARSE:g}, too few to tell what is there."
    )


def detection_section(plan: Plan) -> Section:
    """AP by place, traffic, error profile and class.

    Places are zones, distances and approaches; traffic is split by level.
    """
    key, title = "detection", "How well vehicles are detected, and where"
    parts = (("zone", plan.by_zone), ("distance", plan.by_range), ("lane approach", plan.by_approach))
    judged = [(row.name, row.judged) for _, rows in parts for row in rows if row.judged is not None]
    if plan.chosen is None or not (judged or plan.by_class):
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "There was no vehicle to detect.")
    conditions = (("level of traffic", plan.by_level), ("error profile", plan.by_errors))
    blocks = [block for name, rows in (*parts, *conditions) for block in _breakdown(name, rows)]
    return Section(key, title, _find_weakest(judged), (*blocks, *_class_ap(plan), *_coverage(plan)))


def _find_weakest(judged: Sequence[tuple[str, Judgement]]) -> str:
    if not judged:
        return "There was no vehicle to detect in any part of the site."
    (worst, low), (best, high) = (pick(judged, key=lambda each: each[1].ap) for pick in (min, max))
    if overlap(low, high):
        return f"No part of the site is clearly worse than another: the weakest, “{worst}”, has {ap_text(low)}."
    return f"Detection is weakest at “{worst}”, {ap_text(low)}, and best at “{best}”, {ap_text(high)}."


def _breakdown(name: str, rows: Sequence[BreakdownRow]) -> tuple[ReportBlock, ...]:
    judged = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not judged:
        return (Paragraph(f"AP by {name} is unknown: there was no vehicle to detect."),) if rows else ()
    (worst, low), (best, high) = (pick(judged, key=lambda each: each[1].ap) for pick in (min, max))
    apart = "the intervals overlap" if overlap(low, high) else "the intervals do not overlap"
    caption = (
        f"By {name}, AP ranges from {number(low.ap)} at “{worst}” to {number(high.ap)} at “{best}”; {apart}."
        if len(judged) > 1
        else f"By {name}, only “{worst}” had vehicles: {ap_text(low)}."
    )
    alt = f"AP with intervals by {name}: " + "; ".join(f"{each}: {ap_text(j)}" for each, j in judged)
    columns = (Column(name.capitalize(), number=False), *JUDGED_COLUMNS, Column("points per vehicle"))
    cells = [(text_cell(row.name), *format_cells(row.judged), figure_cell(row.mean_points, 0)) for row in rows]
    return (
        Drawing(interval_bars(judged, f"AP by {name}"), caption, alt),
        *table(f"AP and share of vehicles found, by {name}", columns, cells),
    )


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
    columns = (Column("Class", number=False), Column("road users"), Column("points required"), Column("covered", "%"))
    rows = [
        (
            text_cell(row.label),
            *(figure_cell(float(n), 0) for n in (row.objects, row.least_points)),
            share_cell(row.share),
        )
        for row in plan.by_class
    ]
    return (Paragraph(text), *table("Coverage by class of road user (not AP)", columns, rows))


def _class_ap(plan: Plan) -> tuple[ReportBlock, ...]:
    """AP of each class, if several count."""
    if len(plan.class_ap) < 2:
        return ()
    low = min(plan.class_ap, key=lambda row: row.judged.ap)
    text = f"The class detected worst is {low.label}: {ap_text(low.judged)} at IoU {iou_text(low.iou)}."
    columns = (Column("Class", number=False), Column("IoU"), Column("weight"), *JUDGED_COLUMNS)
    rows = [
        (text_cell(row.label), iou_cell(row.iou), figure_cell(row.weight), *format_cells(row.judged))
        for row in plan.class_ap
    ]
    return (Paragraph(text), *table("AP of each class with the chosen set", columns, rows))


def schemes_section(plan: Plan) -> Section:
    """Early, late and hybrid fusion of the same sensors."""
    key, title = "schemes", "Sending points or sending detections"
    asked = [each for each in plan.schemes if each.iou == plan.iou]
    if plan.chosen is None or not plan.schemes:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "No other fusion scheme was judged.")
    columns = (Column("Scheme", number=False), Column("IoU"), *JUDGED_COLUMNS, Column("per sensor", "kbit"))
    rows = [
        (text_cell(e.scheme), iou_cell(e.iou), *format_cells(e.judged), figure_cell(e.kbit_per_sensor))
        for e in plan.schemes
    ]
    alt = "AP with intervals of the fusion schemes: " + "; ".join(
        f"{each.scheme} at IoU {iou_text(each.iou)}: {ap_text(each.judged)}" for each in plan.schemes
    )
    blocks: tuple[ReportBlock, ...] = (
        Paragraph(SCHEMES_EXPLAINED),
        Drawing(scheme_chart(plan.schemes), _compare_data(plan.schemes), alt),
        *table("The chosen sensors with each fusion scheme", columns, rows),
    )
    return Section(key, title, _compare_schemes(plan, asked or plan.schemes), blocks)


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


def _compare_data(judged: Sequence[SchemeFigures]) -> str:
    """Compare the schemes that send most and least."""
    most, least = (pick(judged, key=lambda each: each.kbit_per_sensor) for pick in (max, min))
    if least.kbit_per_sensor <= 0 or most is least:
        return f"A sensor sends {number(most.kbit_per_sensor, 0)} kbit per frame with {most.scheme} fusion."
    times = most.kbit_per_sensor / least.kbit_per_sensor
    return f"{most.scheme.capitalize()} fusion sends {times:.1f} times as much as {least.scheme} fusion."


def worth_section(plan: Plan) -> Section:
    """Worth of each sensor, and good pairs."""
    key, title = "worth", "What each sensor is worth"
    if plan.chosen is None or not plan.worth:
        return Section(
            key, title, NOTHING_CHOSEN if plan.chosen is None else "The worth of the sensors was not computed."
        )
    if len(plan.worth) == 1:
        only = plan.worth[0]
        return Section(
            key, title, f"There is one sensor, {only.sensor}, and all of the AP is its own: {number(only.shapley)}."
        )
    most, least = (pick(plan.worth, key=lambda each: each.shapley) for pick in (max, min))
    pairs = {tuple(sorted((each.sensor, other))): value for each in plan.worth for other, value in each.synergy.items()}
    together = ""
    if pairs:
        best, worst = max(pairs, key=lambda pair: pairs[pair]), min(pairs, key=lambda pair: pairs[pair])
        good = f" {join_names(best)} complement each other best ({pairs[best]:+.3f})." if pairs[best] > 0 else ""
        bad = f" {join_names(worst)} duplicate each other most ({pairs[worst]:+.3f})." if pairs[worst] < 0 else ""
        together = good + bad
    conclusion = (
        f"{most.sensor} is worth most, {number(most.shapley)} AP, and {least.sensor} least, {number(least.shapley)}."
        f"{together}"
    )
    names = [each.sensor for each in plan.worth]
    columns = (Column("Sensor", number=False), Column("worth", "AP"), *(Column(f"with {name}", "AP") for name in names))
    rows = [
        (
            text_cell(each.sensor),
            figure_cell(each.shapley, 3),
            *(_synergy_cell(each.synergy.get(name)) for name in names),
        )
        for each in plan.worth
    ]
    alt = "Worth of each sensor in AP: " + "; ".join(f"{each.sensor} {number(each.shapley)}" for each in plan.worth)
    total = sum(each.shapley for each in plan.worth)
    caption = f"{most.sensor} accounts for {percent(most.shapley / total if total else None)} of what all sensors add."
    blocks = (Paragraph(SHAPLEY), Drawing(worth_chart(plan.worth), caption, alt))
    return Section(
        key, title, conclusion, (*blocks, *table("Worth, and synergy with each other sensor", columns, rows))
    )


def _synergy_cell(value: float | None) -> Cell:
    return Cell(NONE) if value is None else Cell(f"{value:+.3f}", value)


def failures_section(plan: Plan) -> Section:
    """AP left when one or two sensors fail."""
    key, title = "failures", "What is left when sensors fail"
    if plan.chosen is None or plan.chosen.judged is None or not plan.failures:
        return Section(key, title, "No failure leaves a working sensor." if plan.chosen else NOTHING_CHOSEN)
    intact = plan.chosen.judged
    counts = sorted({len(each.failed) for each in plan.failures})
    worst = [
        min((each for each in plan.failures if len(each.failed) == count), key=lambda each: each.judged.ap)
        for count in counts
    ]
    conclusion = f"All sensors together give {ap_text(intact)}. " + " ".join(map(_describe_loss, worst))
    harmless = [each for each in plan.failures if overlap(each.judged, intact)]
    caption = (
        f"In {len(harmless)} of {count_text(len(plan.failures), 'case')} the loss is so small that the interval still "
        "overlaps that of the whole set."
    )
    columns = (Column("Failed", number=False), *JUDGED_COLUMNS, Column("lost", "AP"))
    rows = [
        (text_cell(join_names(each.failed)), *format_cells(each.judged), figure_cell(intact.ap - each.judged.ap, 3))
        for each in plan.failures
    ]
    left = "; ".join(f"without {join_names(each.failed)}: {ap_text(each.judged)}" for each in plan.failures)
    drawing = Drawing(failure_chart(intact, plan.failures), caption, f"AP left: {left}")
    return Section(key, title, conclusion, (drawing, *table("What is left, case by case", columns, rows)))


def _describe_loss(case: FailureCase) -> str:
    count = len(case.failed)
    fail = f"{count_text(count, 'sensor')} {'fails' if count == 1 else 'fail'}"
    return f"If {fail}, the worst loss is that of {join_names(case.failed)}: {ap_text(case.judged)} is left."


def order_section(plan: Plan) -> Section:
    """Order in which to build the sensors."""
    key, title = "order", "Which sensor to build first"
    if plan.chosen is None or not plan.order:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "No order of building was computed.")
    first, last = plan.order[0], plan.order[-1]
    conclusion = (
        f"Build {first.sensor} first: for {price_text(first.price, plan.currency)} it alone gives "
        f"{ap_text(first.judged)}"
        + (f"; the last, {last.sensor}, brings it to {ap_text(last.judged)}." if last is not first else ".")
    )
    columns = (Column("Step"), Column("Sensor", number=False), price_column("spent", plan.currency), *JUDGED_COLUMNS)
    rows = [
        (figure_cell(float(i), 0), text_cell(each.sensor), figure_cell(each.price, 2), *format_cells(each.judged))
        for i, each in enumerate(plan.order, 1)
    ]
    alt = "AP after each sensor built: " + "; ".join(f"{each.sensor}: {ap_text(each.judged)}" for each in plan.order)
    drawing = Drawing(order_chart(plan.order, plan.currency), _find_saturation(plan.order), alt)
    return Section(key, title, conclusion, (drawing, *table("In this order, after each sensor", columns, rows)))


def _find_saturation(order: Sequence[BuildStep]) -> str:
    """Number of sensors beyond which gains are uncertain."""
    last = order[-1].judged
    enough = next(i for i, each in enumerate(order, 1) if overlap(each.judged, last))
    if enough == len(order):
        return "Every sensor adds more than the intervals leave open."
    return (
        f"From {count_text(enough, 'sensor')} on, the interval overlaps that of all: the gain from more is uncertain."
    )
