"""Sections of the report on each sensor of the set: Shapley value, failures, order."""

from placement_env.analysis.intervals import AP_TOLERANCE
from placement_env.classes import join_names
from placement_env.report import charts, content
from placement_env.report.pages.columns import (
    JUDGED_COLUMNS,
    judgement_cells,
    price_column,
    text_columns,
)
from placement_env.report.pages.document import (
    Cell,
    Column,
    Content,
    PageDrawing,
    Paragraph,
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import (
    ap_text,
    list_aps,
    number_text,
    percent,
    price_text,
)
from toolkit.display import describe_count


def worth_section(plan: content.Plan) -> Content:
    """Describe the Shapley value of each sensor, and which pairs work well together."""
    if not plan.worth:
        return build_content("The worth of the sensors was not computed.")
    if len(plan.worth) == 1:
        only_sensor = plan.worth[0]
        return build_content(
            f"There is one sensor, {only_sensor.sensor}, and all of the AP is its own: "
            f"{number_text(only_sensor.shapley)}."
        )
    strongest = max(plan.worth, key=lambda sensor_worth: sensor_worth.shapley)
    weakest = min(plan.worth, key=lambda sensor_worth: sensor_worth.shapley)
    conclusion = (
        f"{strongest.sensor} is worth most, {number_text(strongest.shapley)} AP, and "
        f"{weakest.sensor} least, {number_text(weakest.shapley)}.{_describe_pairs(plan)}"
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
        f"{sensor_worth.sensor} {number_text(sensor_worth.shapley)}" for sensor_worth in plan.worth
    )
    return build_content(
        conclusion,
        Paragraph(content.TEXTS["worth"]),
        PageDrawing(
            charts.worth_chart(plan.worth), caption, f"Worth of each sensor in AP: {values}"
        ),
        *build_table("Worth, and synergy with each other sensor", columns, rows),
    )


def _describe_pairs(plan: content.Plan) -> str:
    """Name the pair of sensors that complement each other best, and the most redundant pair.

    The first is named only if its synergy (AP that a pair adds beyond the sum of both) is above 0,
    the second only if it is below 0. The text begins with a space, to follow another sentence; ""
    without a pair."""
    synergies = {}  # by the sorted names of a pair
    for sensor_worth in plan.worth:
        for other_name, value in sensor_worth.synergy.items():
            # both sensors of a pair state the same value, which is kept once
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
    """Describe the AP that remains when one or two sensors fail, case by case.

    chosen_option: the chosen set, whose intact result is the comparison."""
    intact = chosen_option.judged
    if intact is None or not plan.failures:
        return build_content("No failure leaves a working sensor.")
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
        (
            join_names(failure.failed),
            *judgement_cells(failure.judged),
            intact.ap - failure.judged.ap,
        )
        for failure in plan.failures
    ]
    drawing = PageDrawing(
        charts.failure_chart(intact, plan.failures), caption, f"AP left: {ap_list}"
    )
    return build_content(
        conclusion, drawing, *build_table("What is left, case by case", columns, rows)
    )


def order_section(plan: content.Plan) -> Content:
    """Describe the order in which to build the sensors, with price and AP after each."""
    if not plan.order:
        return build_content("No order of building was computed.")
    first_step = plan.order[0]
    last_step = plan.order[-1]
    last_text = ""
    if last_step is not first_step:
        last_text = f"; the last, {last_step.sensor}, brings it to {ap_text(last_step.judged)}"
    price = price_text(first_step.price, plan.currency)
    # AP that the sensors after each step add; the first step that misses little is enough
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
        (i, step.sensor, step.price, *judgement_cells(step.judged))
        for i, step in enumerate(plan.order, 1)
    ]
    return build_content(
        (
            f"Build {first_step.sensor} first: for {price} it alone gives "
            f"{ap_text(first_step.judged)}{last_text}."
        ),
        PageDrawing(
            charts.order_chart(plan.order, plan.currency),
            caption,
            f"AP after each sensor built: {aps}",
        ),
        *build_table("In this order, after each sensor", columns, rows),
    )
