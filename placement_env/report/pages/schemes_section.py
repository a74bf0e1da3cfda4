"""Section of the report on early, late and hybrid fusion."""

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
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import ap_figure, interval_text, list_aps, number_text


def schemes_section(plan: content.Plan) -> Content:
    """Compare early, late and hybrid fusion of the same sensors, at each judged IoU.

    The conclusion is about the plan's IoU. Without judged schemes the section states that."""
    if not plan.schemes:
        return build_content("No other fusion scheme was judged.")
    dearest = max(plan.schemes, key=lambda figures: figures.kbit_per_sensor)
    cheapest = min(plan.schemes, key=lambda figures: figures.kbit_per_sensor)
    if cheapest.kbit_per_sensor <= 0 or dearest is cheapest:
        caption = (
            f"A sensor sends {number_text(dearest.kbit_per_sensor, 0)} kbit per frame with "
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
            *judgement_cells(figures.judged),
            figures.kbit_per_sensor,
        )
        for figures in plan.schemes
    ]
    at_iou = [figures for figures in plan.schemes if figures.iou == plan.iou]
    return build_content(
        _compare_schemes(plan, at_iou or plan.schemes),
        Paragraph(content.TEXTS["schemes"]),
        PageDrawing(
            charts.scheme_chart(plan.schemes),
            caption,
            f"AP with intervals of the fusion schemes: {aps}",
        ),
        *build_table("The chosen sensors with each fusion scheme", columns, rows),
    )


def _compare_schemes(plan: content.Plan, schemes: Sequence[content.SchemeFigures]) -> str:
    """Compare in a sentence the scheme with the highest AP and the planned one, and their kbit.

    schemes: figures of the schemes at one IoU."""
    best = max(schemes, key=lambda figures: figures.judged.ap)
    cheapest = min(schemes, key=lambda figures: figures.kbit_per_sensor)
    planned = next((figures for figures in schemes if figures.scheme == plan.scheme), best)
    least = "the least"
    if planned is not cheapest:
        least = f"{cheapest.scheme} fusion, the least, {number_text(cheapest.kbit_per_sensor, 0)}"
    sent_text = (
        f"{planned.scheme} fusion sends {number_text(planned.kbit_per_sensor, 0)} kbit per sensor "
        f"and frame, {least}"
    )
    if planned is best:
        return (
            f"{planned.scheme.capitalize()} fusion, as planned, has the highest AP, "
            f"{ap_figure(planned.judged)}; {sent_text}."
        )
    difference = "the difference may be due to chance"
    if best.as_good:
        difference = "on the same frames they cannot be told apart"
    elif not (is_comparable_judgement(best.judged) and is_comparable_judgement(planned.judged)):
        difference = "the frames are too few to compare them"
    elif not content.overlap(best.judged, planned.judged):
        difference = "the difference is not due to chance"
    return (
        f"{best.scheme.capitalize()} fusion has the highest AP, {best.judged.format_ap()} "
        f"({interval_text(best.judged)}), against {planned.judged.format_ap()} "
        f"({interval_text(planned.judged)}) with {planned.scheme} fusion as planned, and "
        f"{difference}; {sent_text}."
    )
