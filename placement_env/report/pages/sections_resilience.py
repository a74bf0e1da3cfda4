"""Sections on single sensors: what each is worth, what is left when some fail, and which to build first."""

from __future__ import annotations

from collections.abc import Sequence

from placement_env.report.content import BuildStep, FailureCase, Plan, overlap
from placement_env.report.drawings.charts import failure_chart, order_chart
from placement_env.report.drawings.worth import worth_chart
from placement_env.report.pages.document import Cell, Column, Drawing, Paragraph, Section, table
from placement_env.report.pages.sections_answer import NOTHING_CHOSEN
from placement_env.report.pages.wording import (
    JUDGED_COLUMNS,
    NONE,
    ap_text,
    counted,
    figure_cell,
    judged_cells,
    listed,
    number,
    percent,
    price_column,
    price_text,
    text_cell,
)

SHAPLEY = (
    "The worth of a sensor (its Shapley value) is the AP that it adds, on average over every order in which the "
    "sensors could be built; the values of all sensors add up to the AP of the whole set. Two sensors have a synergy "
    "above 0 where they add more together than each alone, and below 0 where they see much the same."
)


def worth_section(plan: Plan) -> Section:
    """What each sensor is worth, and which go well together."""
    key, title = "worth", "What each sensor is worth"
    if plan.chosen is None or not plan.worth:
        return Section(
            key, title, NOTHING_CHOSEN if plan.chosen is None else "The worth of the sensors was not worked out."
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
        good = f" {listed(best)} complement each other best ({pairs[best]:+.3f})." if pairs[best] > 0 else ""
        bad = f" {listed(worst)} do most of the same work ({pairs[worst]:+.3f})." if pairs[worst] < 0 else ""
        together = good + bad
    conclusion = (
        f"{most.sensor} is worth most, {number(most.shapley)} AP, and {least.sensor} least, {number(least.shapley)}."
        f"{together}"
    )
    names = [each.sensor for each in plan.worth]
    columns = (Column("Sensor", number=False), Column("worth", "AP"), *(Column(f"with {name}", "AP") for name in names))
    rows = [
        (text_cell(each.sensor), figure_cell(each.shapley, 3), *(_synergy(each.synergy.get(name)) for name in names))
        for each in plan.worth
    ]
    alt = "Worth of each sensor in AP: " + "; ".join(f"{each.sensor} {number(each.shapley)}" for each in plan.worth)
    total = sum(each.shapley for each in plan.worth)
    said = f"{most.sensor} accounts for {percent(most.shapley / total if total else None)} of what all sensors add."
    blocks = (Paragraph(SHAPLEY), Drawing(worth_chart(plan.worth), said, alt))
    return Section(
        key, title, conclusion, (*blocks, *table("Worth, and synergy with each other sensor", columns, rows))
    )


def _synergy(value: float | None) -> Cell:
    return Cell(NONE) if value is None else Cell(f"{value:+.3f}", value)


def failures_section(plan: Plan) -> Section:
    """What is left when one or two sensors fail."""
    key, title = "failures", "What is left when sensors fail"
    if plan.chosen is None or plan.chosen.judged is None or not plan.failures:
        said = "No failure leaves a sensor that works." if plan.chosen else NOTHING_CHOSEN
        return Section(key, title, said)
    intact = plan.chosen.judged
    counts = sorted({len(each.failed) for each in plan.failures})
    worst = [
        min((each for each in plan.failures if len(each.failed) == count), key=lambda each: each.judged.ap)
        for count in counts
    ]
    conclusion = f"All sensors together give {ap_text(intact)}. " + " ".join(_loss(each) for each in worst)
    harmless = [each for each in plan.failures if overlap(each.judged, intact)]
    said = (
        f"{len(harmless)} of {counted(len(plan.failures), 'case')} cost so little that the interval still overlaps "
        "that of the whole set."
    )
    columns = (Column("Failed", number=False), *JUDGED_COLUMNS, Column("lost", "AP"))
    rows = [
        (text_cell(listed(each.failed)), *judged_cells(each.judged), figure_cell(intact.ap - each.judged.ap, 3))
        for each in plan.failures
    ]
    alt = "AP left: " + "; ".join(f"without {listed(each.failed)}: {ap_text(each.judged)}" for each in plan.failures)
    drawing = Drawing(failure_chart(intact, plan.failures), said, alt)
    return Section(key, title, conclusion, (drawing, *table("What is left, case by case", columns, rows)))


def _loss(case: FailureCase) -> str:
    which = f"{listed(case.failed)} {'hurts' if len(case.failed) == 1 else 'hurt'} most"
    return f"When {counted(len(case.failed), 'sensor')} may fail, {which}: {ap_text(case.judged)} is left."


def order_section(plan: Plan) -> Section:
    """Which sensor to build first."""
    key, title = "order", "Which sensor to build first"
    if plan.chosen is None or not plan.order:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "No order of building was worked out.")
    first, last = plan.order[0], plan.order[-1]
    conclusion = (
        f"Build {first.sensor} first: for {price_text(first.price, plan.currency)} it alone gives "
        f"{ap_text(first.judged)}"
        + (f"; the last, {last.sensor}, brings it to {ap_text(last.judged)}." if last is not first else ".")
    )
    columns = (Column("Step"), Column("Sensor", number=False), price_column("spent", plan.currency), *JUDGED_COLUMNS)
    rows = [
        (figure_cell(float(i), 0), text_cell(each.sensor), figure_cell(each.price, 2), *judged_cells(each.judged))
        for i, each in enumerate(plan.order, 1)
    ]
    alt = "AP after each sensor built: " + "; ".join(f"{each.sensor}: {ap_text(each.judged)}" for each in plan.order)
    drawing = Drawing(order_chart(plan.order, plan.currency), _gains(plan.order), alt)
    return Section(key, title, conclusion, (drawing, *table("In this order, after each sensor", columns, rows)))


def _gains(order: Sequence[BuildStep]) -> str:
    """From which sensor on building no longer pays for certain."""
    last = order[-1].judged
    enough = next(i for i, each in enumerate(order, 1) if overlap(each.judged, last))
    if enough == len(order):
        return "Every sensor adds more than the intervals leave open."
    return f"From {counted(enough, 'sensor')} on, the interval overlaps that of all: what more adds is uncertain."
