"""Section of the report on the sets that compete with the chosen one."""

from collections.abc import Sequence

from placement_env.classes import join_names
from placement_env.report import charts, content
from placement_env.report.pages.columns import (
    JUDGED_COLUMNS,
    judgement_cells,
    price_column,
    text_columns,
)
from placement_env.report.pages.document import (
    Column,
    Content,
    PageDrawing,
    Paragraph,
    TableBlock,
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import ap_figure, number_text, price_text
from toolkit.display import describe_count

MAX_LISTED_SETS = 8  # sets of each kind in the table of other sets


def others_section(plan: content.Plan, chosen_option: content.PlanOption) -> Content:
    """List sets that are as good as the best, and sets that no other beats in AP, kbit and price.

    All figures are from the comparison, on the same traffic.

    chosen_option: the chosen set with its figures from the final traffic."""
    compared_option = _find_compared(plan, chosen_option)
    close_options = plan.near_optimal
    front_options = [
        option
        for option in plan.front
        if option not in close_options and option.sensors != chosen_option.sensors
    ]
    if not (close_options or front_options):
        return build_content(
            "No other judged set comes near the chosen one, costs less or sends less."
        )
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
    drawing = PageDrawing(
        charts.front_chart(plan.front, compared_option, plan.currency),
        f"The chosen set costs {price_text(chosen_option.price, plan.currency)} and sends "
        f"{number_text(chosen_option.kbit_per_sensor, 0)} kbit per sensor and frame.",
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
    return build_content(conclusion, *_explain_traffic(plan, chosen_option), drawing, *sets)


def _find_compared(plan: content.Plan, chosen_option: content.PlanOption) -> content.PlanOption:
    """Return the chosen set with its figures from the comparison.

    If the plan lacks them, the option itself comes back, with its figures from the final
    traffic."""
    for option in (*plan.front, *plan.considered):
        if option.sensors == chosen_option.sensors:
            return option
    return chosen_option


def _explain_traffic(plan: content.Plan, option: content.PlanOption) -> tuple[Paragraph, ...]:
    """Explain why the chosen set has another AP in this section; empty if it has the same.

    A paragraph names the cases of the AP, unless it is for the intact set in all traffic, and
    another the traffic of the comparison.

    option: the chosen set with its figures from the final traffic."""
    compared_judgement = _find_compared(plan, option).counted
    final = option.counted
    if compared_judgement is None or final is None:
        return ()
    case_text = _describe_cases(option)
    texts = []
    if case_text:
        texts.append(
            f"The AP of each set in this section is that {case_text}, as the question asks."
        )
    if compared_judgement != final:
        texts.append(
            "The AP of each set in this section is from the traffic on which the sets were "
            f"compared. There the chosen set has {ap_figure(compared_judgement)}; its "
            f"{ap_figure(final)} in the rest of the report is from other traffic, which "
            "had no say in the choice and is therefore the figure to trust."
        )
    return tuple(map(Paragraph, texts))


def _describe_cases(option: content.PlanOption) -> str:
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
    """Return a table with a row for each option, with its figures from the comparison.

    Args:
        caption: Sentence above the table.
        plan: Plan with the currency and the name of the searches' estimate.
        chosen_option: The chosen set, whose row is marked.
        options: Sets to list."""
    by_coverage = plan.provenance.get("search_fidelity") == "coverage"
    predicted_title = "coverage" if by_coverage else "predicted AP"
    columns = (
        *text_columns("Sensors"),
        Column(predicted_title, digits=3),
        *JUDGED_COLUMNS,
        Column("per sensor", "kbit"),
        price_column("price", plan.currency),
    )
    rows = []
    for option in options:
        mark = " (chosen)" if option.sensors == chosen_option.sensors else ""
        names = join_names(option.sensors) + mark
        judged_cells = judgement_cells(option.counted)
        rows.append((names, option.predicted, *judged_cells, option.kbit_per_sensor, option.price))
    return build_table(caption, columns, rows)
