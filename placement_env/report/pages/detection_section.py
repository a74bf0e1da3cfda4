"""Section of the report on AP by place, traffic, error profile and class."""

from collections.abc import Sequence

from placement_env.cases import iou_text
from placement_env.report import charts, content
from placement_env.report.pages.columns import (
    JUDGED_COLUMNS,
    iou_value,
    is_comparable_judgement,
    judgement_cells,
    text_columns,
)
from placement_env.report.pages.document import (
    Column,
    Content,
    PageDrawing,
    Paragraph,
    ReportBlock,
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import ap_text, list_aps, percent
from toolkit.display import describe_count


def detection_section(plan: content.Plan) -> Content:
    """Break the AP of the chosen set down by place, level of traffic, error profile and class.

    The conclusion names the weakest and the best place, if there is enough traffic to compare."""
    parts = (
        ("zone", plan.by_zone),
        ("distance", plan.by_range),
        ("lane approach", plan.by_approach),
    )
    rows = (*plan.by_zone, *plan.by_range, *plan.by_approach)
    judgements = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not (judgements or plan.by_class):
        return build_content("There was no vehicle to detect.")
    conclusion = "There was no vehicle to detect in any part of the site."
    if judgements:
        conclusion = (
            "There are too few frames to compare parts of the site: 80 or more give an AP its "
            "interval."
        )
    comparable = [
        (name, judgement) for name, judgement in judgements if is_comparable_judgement(judgement)
    ]
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
    return build_content(conclusion, *blocks, *_class_ap(plan), *_coverage(plan))


def _ap_of_pair(pair: tuple[str, content.Judgement]) -> float:
    return pair[1].ap


def _breakdown(name: str, rows: Sequence[content.BreakdownRow]) -> tuple[ReportBlock, ...]:
    """Return chart and table of one breakdown of the AP, nothing without rows.

    name: noun for a part, such as "zone" or "distance"."""
    if not rows:
        return ()
    judgements = [(row.name, row.judged) for row in rows if row.judged is not None]
    if not judgements:
        return (Paragraph(f"AP by {name} is unknown: there was no vehicle to detect."),)
    comparable = [
        (part_name, judgement)
        for part_name, judgement in judgements
        if is_comparable_judgement(judgement)
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
    drawing = PageDrawing(chart, caption, f"AP with intervals by {name}: {list_aps(judgements)}")
    columns = (
        *text_columns(name.capitalize()),
        *JUDGED_COLUMNS,
        Column("points per vehicle", digits=0),
    )
    cells = [(row.name, *judgement_cells(row.judged), row.mean_points) for row in rows]
    return drawing, *build_table(f"AP and share of vehicles found, by {name}", columns, cells)


def _coverage(plan: content.Plan) -> tuple[ReportBlock, ...]:
    """Return a sentence on the class covered least, and a table with the coverage of all classes.

    A class's coverage is the share of its road users with enough points on them."""
    if not plan.by_class:
        return ()
    shares = [row.share for row in plan.by_class if row.share is not None and row.objects]
    text = "No road user of any class crossed the site."
    if shares:
        lowest_share = min(shares)
        lowest_row = next(row for row in plan.by_class if row.share == lowest_share and row.objects)
        text = (
            f"The class covered least is {lowest_row.label}: {percent(lowest_share)} of "
            f"{describe_count(lowest_row.objects, 'road user')} had at least "
            f"{describe_count(lowest_row.least_points, 'point')} on them. These are shares of "
            "coverage, not AP."
        )
    columns = (
        *text_columns("Class"),
        Column("road users", digits=0),
        Column("points required", digits=0),
        Column("covered", "%"),
    )
    rows = [(row.label, row.objects, row.least_points, row.share) for row in plan.by_class]
    return Paragraph(text), *build_table("Coverage by class of road user (not AP)", columns, rows)


def _class_ap(plan: content.Plan) -> tuple[ReportBlock, ...]:
    """Return a sentence on the class with the lowest AP, and a table with the AP of all classes.

    One class is no comparison, so nothing comes back for it."""
    if len(plan.class_ap) < 2:
        return ()
    worst = min(plan.class_ap, key=lambda row: row.judged.ap)
    text = (
        f"The class detected worst is {worst.label}: {ap_text(worst.judged)} at IoU "
        f"{iou_text(worst.iou)}."
    )
    columns = (*text_columns("Class"), Column("IoU"), Column("weight"), *JUDGED_COLUMNS)
    rows = [
        (row.label, iou_value(row.iou), row.weight, *judgement_cells(row.judged))
        for row in plan.class_ap
    ]
    return Paragraph(text), *build_table("AP of each class with the chosen set", columns, rows)
