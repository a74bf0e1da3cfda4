"""Sections on detection: AP by zone, range, approach, level of traffic, errors and class, and what schemes give."""

from __future__ import annotations

from collections.abc import Sequence

from placement_env.fidelity.combined.mean_iou import iou_text
from placement_env.report.content import BreakdownRow, Plan, SchemeFigures, overlap
from placement_env.report.drawings.charts import interval_bars, scheme_chart
from placement_env.report.pages.document import Column, Drawing, Paragraph, ReportBlock, Section, table
from placement_env.report.pages.sections_answer import NOTHING_CHOSEN
from placement_env.report.pages.wording import (
    JUDGED_COLUMNS,
    ap_text,
    counted,
    figure_cell,
    interval,
    iou_cell,
    judged_cells,
    measured,
    number,
    percent,
    share_cell,
    text_cell,
)

SCHEMES_EXPLAINED = (
    "Under early fusion every sensor sends its points and one detector looks at all of them; under late fusion every "
    "sensor detects for itself and sends only what it found; under hybrid fusion a sensor sends what it found near by "
    "and points from further away."
)


def detection_section(plan: Plan) -> Section:
    """How well vehicles are detected, and where."""
    key, title = "detection", "How well vehicles are detected, and where"
    parts = (("zone", plan.by_zone), ("distance", plan.by_range), ("lane approach", plan.by_approach))
    judged = [row for _, rows in parts for row in rows if row.judged is not None]
    if plan.chosen is None or not (judged or plan.by_class):
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "No vehicle was there to be detected.")
    conditions = (("level of traffic", plan.by_level), ("error profile", plan.by_errors))
    blocks = [block for name, rows in (*parts, *conditions) for block in _part(name, rows)]
    return Section(key, title, _weakest(judged), (*blocks, *_classes(plan)))


def _weakest(judged: Sequence[BreakdownRow]) -> str:
    if not judged:
        return "No vehicle was there to be detected in any part of the site."
    low = min(judged, key=lambda row: row.judged.ap if row.judged else 1.0)
    high = max(judged, key=lambda row: row.judged.ap if row.judged else 0.0)
    assert low.judged is not None
    assert high.judged is not None
    if overlap(low.judged, high.judged):
        return (
            f"No part of the site is clearly worse than another: the weakest, “{low.name}”, has {ap_text(low.judged)}."
        )
    best = f"best at “{high.name}”, {ap_text(high.judged)}"
    return f"Detection is weakest at “{low.name}”, {ap_text(low.judged)}, and {best}."


def _part(name: str, rows: Sequence[BreakdownRow]) -> tuple[ReportBlock, ...]:
    judged = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not judged:
        return (Paragraph(f"AP by {name} is not known: no vehicle was there to be detected."),) if rows else ()
    (worst, low), (best, high) = (pick(judged, key=lambda each: each[1].ap) for pick in (min, max))
    apart = "which the intervals do not tell apart" if overlap(low, high) else "which the intervals tell apart"
    said = (
        f"By {name}, AP runs from {number(low.ap)} at “{worst}” to {number(high.ap)} at “{best}”, {apart}."
        if len(judged) > 1
        else f"By {name}, only “{worst}” held vehicles: {ap_text(low)}."
    )
    alt = f"AP with intervals by {name}: " + "; ".join(f"{each}: {ap_text(j)}" for each, j in judged)
    columns = (Column(name.capitalize(), number=False), *JUDGED_COLUMNS, Column("points per vehicle"))
    cells = [(text_cell(row.name), *judged_cells(row.judged), figure_cell(row.mean_points, 0)) for row in rows]
    return (
        Drawing(interval_bars(judged, f"AP by {name}"), said, alt),
        *table(f"AP and share of vehicles found, by {name}", columns, cells),
    )


def _classes(plan: Plan) -> tuple[ReportBlock, ...]:
    seen = [row for row in plan.by_class if row.share is not None and row.objects]
    if not plan.by_class:
        return ()
    said = "No road user of any class crossed the site."
    if seen:
        low = min(seen, key=lambda row: row.share or 0.0)
        said = (
            f"Of all classes, {low.label} is covered least: {percent(low.share)} of "
            f"{counted(low.objects, 'road user')} had at least "
            f"{counted(low.least_points, 'point')} on them. These are shares of coverage, not AP"
            + (": the detector knows vehicles only." if not plan.class_ap or len(plan.class_ap) < 2 else ".")
        )
    columns = (
        Column("Class", number=False),
        Column("road users"),
        Column("points asked for"),
        Column("covered", "%"),
    )
    rows = [
        (
            text_cell(row.label),
            *(figure_cell(float(n), 0) for n in (row.objects, row.least_points)),
            share_cell(row.share),
        )
        for row in plan.by_class
    ]
    return (*_class_ap(plan), Paragraph(said), *table("Coverage by class of road user (no AP)", columns, rows))


def _class_ap(plan: Plan) -> tuple[ReportBlock, ...]:
    """AP of each class that counts, where several do."""
    if len(plan.class_ap) < 2:
        return ()
    low = min(plan.class_ap, key=lambda row: row.judged.ap)
    said = (
        f"Of the classes that count, {low.label} is detected least: {ap_text(low.judged)} at IoU {iou_text(low.iou)}."
    )
    columns = (Column("Class", number=False), Column("IoU"), Column("weight"), *JUDGED_COLUMNS)
    rows = [
        (text_cell(row.label), iou_cell(row.iou), figure_cell(row.weight), *judged_cells(row.judged))
        for row in plan.class_ap
    ]
    return (Paragraph(said), *table("AP of each class with the chosen set", columns, rows))


def schemes_section(plan: Plan) -> Section:
    """Early, late and hybrid fusion of the same sensors."""
    key, title = "schemes", "Sending points or sending detections"
    asked = [each for each in plan.schemes if each.iou == plan.iou]
    if plan.chosen is None or not plan.schemes:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "No other scheme of fusion was judged.")
    columns = (Column("Scheme", number=False), Column("IoU"), *JUDGED_COLUMNS, Column("per sensor", "kbit"))
    rows = [
        (text_cell(e.scheme), iou_cell(e.iou), *judged_cells(e.judged), figure_cell(e.kbit_per_sensor))
        for e in plan.schemes
    ]
    conclusion = _compared(plan, asked or list(plan.schemes))
    alt = "AP with intervals of the fusion schemes: " + "; ".join(
        f"{each.scheme} at IoU {iou_text(each.iou)}: {ap_text(each.judged)}" for each in plan.schemes
    )
    return Section(
        key,
        title,
        conclusion,
        (
            Paragraph(SCHEMES_EXPLAINED),
            Drawing(scheme_chart(plan.schemes), _price_of_points(plan.schemes), alt),
            *table("The chosen sensors under each scheme of fusion", columns, rows),
        ),
    )


def _compared(plan: Plan, judged: Sequence[SchemeFigures]) -> str:
    best = max(judged, key=lambda each: each.judged.ap)
    least = min(judged, key=lambda each: each.kbit_per_sensor)
    mine = next((each for each in judged if each.scheme == plan.scheme), best)
    sent = f"{mine.scheme} fusion sends {number(mine.kbit_per_sensor, 0)} kbit per sensor and frame, "
    sent += "the least" if mine is least else f"{least.scheme} fusion, the least, {number(least.kbit_per_sensor, 0)}"
    if mine is best:
        return f"{mine.scheme.capitalize()} fusion, as planned, has the highest AP, {measured(mine.judged)}; {sent}."
    apart = "their intervals overlap" if overlap(mine.judged, best.judged) else "their intervals do not overlap"
    return (
        f"{best.scheme.capitalize()} fusion has the highest AP, {number(best.judged.ap)} ({interval(best.judged)}), "
        f"against {number(mine.judged.ap)} ({interval(mine.judged)}) of {mine.scheme} fusion as planned, and {apart}; "
        f"{sent}."
    )


def _price_of_points(judged: Sequence[SchemeFigures]) -> str:
    """What the scheme that sends most costs the links."""
    most, least = (pick(judged, key=lambda each: each.kbit_per_sensor) for pick in (max, min))
    if least.kbit_per_sensor <= 0 or most is least:
        return f"A sensor sends {number(most.kbit_per_sensor, 0)} kbit of a frame under {most.scheme} fusion."
    times = most.kbit_per_sensor / least.kbit_per_sensor
    return f"{most.scheme.capitalize()} fusion sends {times:.1f} times as much as {least.scheme} fusion."
