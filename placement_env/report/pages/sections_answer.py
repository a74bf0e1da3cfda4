"""Sections that answer: requirement met or not, the chosen set and why, what else was nearly as good."""

from __future__ import annotations

from typing import Any

from placement_env.fidelity.combined.mean_iou import iou_text
from placement_env.report.content import CONFIDENCE, Ground, Plan, PlanOption
from placement_env.report.drawings.charts import front_chart
from placement_env.report.drawings.maps import plan_view
from placement_env.report.pages.document import (
    Bullets,
    Cell,
    Column,
    Drawing,
    Paragraph,
    ReportBlock,
    SceneView,
    Section,
    table,
)
from placement_env.report.pages.wording import (
    JUDGED_COLUMNS,
    ap_text,
    counted,
    figure_cell,
    judged_cells,
    listed,
    measured,
    number,
    price_column,
    price_text,
    text_cell,
)
from toolkit.sites.site import Site

NOTHING_CHOSEN = "No set of sensors may be built, so there is nothing to show here."
OPTION_COLUMNS = (Column("Sensors", number=False), Column("predicted AP"), *JUDGED_COLUMNS)


def requirement_section(plan: Plan) -> Section:
    """Whether what was asked for is reached, what stands in the way, and how to read the figures."""
    blocks: list[ReportBlock] = []
    if plan.verdict.reasons:
        blocks += [Paragraph("What excludes what:"), Bullets(plan.verdict.reasons)]
    blocks.append(
        Paragraph(
            "AP (average precision) is a mark from 0 to 1 for how well the detector finds vehicles: 1 means that it "
            "finds every vehicle and reports none that is not there. A vehicle counts as found where the reported box "
            f"and the true one share at least {iou_text(plan.iou)} of the space that both take up together "
            f"(IoU). Beside every AP stand an interval, in which it lies with {CONFIDENCE:.0%} confidence, and the "
            "number of vehicles it was measured on: with few vehicles the interval is wide. Every AP was measured on "
            "traffic that the search for the best set never saw. kbit are thousands of bits that a sensor sends for "
            "one frame, of which there are ten a second."
        )
    )
    asked = [(Cell(str(key).replace("_", " ")), Cell(in_words(value))) for key, value in plan.question.items()]
    columns = (Column("Asked", number=False), Column("Value", number=False))
    return Section(
        "requirement",
        "The answer" if plan.verdict.met is None else "Is the requirement met?",
        plan.verdict.sentence,
        (*blocks, *table("The question this plan answers", columns, asked)),
    )


def in_words(value: Any) -> str:
    """A value of the question or the provenance as a reader writes it."""
    if value is None or value == "" or value == [] or value == () or value == {}:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{key}: {in_words(each)}" for key, each in value.items())
    return ", ".join(map(in_words, value)) if isinstance(value, list | tuple) else str(value)


def chosen_section(plan: Plan, site: Site, ground: Ground | None) -> Section:
    """What to build, and why this and nothing else."""
    key, title = "chosen", "The chosen set, and why"
    if plan.chosen is None:
        return Section(key, title, NOTHING_CHOSEN)
    chosen = plan.chosen
    judged = f"the detector reaches {ap_text(chosen.judged)}" if chosen.judged else "it was not judged by the detector"
    if chosen.counted is not None and chosen.counted is not chosen.judged:
        judged += f", and {ap_text(chosen.counted)} {_asked_of(chosen)} that the question asks for"
    conclusion = (
        f"Build {counted(len(chosen.sensors), 'sensor')}, {listed(chosen.sensors)}, for "
        f"{price_text(chosen.price, plan.currency)}: {judged}; a sensor sends {number(chosen.kbit_per_sensor, 0)} "
        f"kbit of a frame under {plan.scheme} fusion."
    )
    mounts = {mount.name for mount in site.mounts}
    unused = [name for name in plan.poles_unused if name in mounts]
    poles = [sensor.pole for sensor in plan.sensors if sensor.pole in mounts]
    view = Drawing(
        plan_view(site, site.sensors, poles, unused, ground),
        f"{counted(len(plan.sensors), 'sensor')} on {counted(len({s.pole for s in plan.sensors}), 'pole')}; "
        f"{counted(len(plan.poles_unused), 'pole')} that could carry one "
        f"{'stays' if len(plan.poles_unused) == 1 else 'stay'} free.",
        f"The site from above with the sensors {listed(chosen.sensors)}, their poles, and the ground that each sees",
    )
    scene = SceneView(
        "Drag to turn the junction, scroll to come closer; hide sensors and boxes with the switches.",
        "The junction in 3D, with points, vehicles and detections of some frames, is in report.html beside this file.",
    )
    return Section(key, title, conclusion, (*((Bullets(plan.why),) if plan.why else ()), view, scene))


def front_section(plan: Plan) -> Section:
    """What more money or a wider link buys."""
    key, title = "front", "What more money or faster links buy"
    if plan.chosen is None:
        return Section(key, title, NOTHING_CHOSEN)
    if len(plan.front) < 2:
        return Section(key, title, "No other set is better than the chosen one in AP, sent data or price.")
    judged = [option for option in plan.front if option.counted is not None]
    best = max(judged, key=lambda each: each.counted.ap if each.counted else 0.0, default=None)
    cheapest = min(plan.front, key=lambda each: each.price)
    what = (
        f"the cheapest of them costs {price_text(cheapest.price, plan.currency)}"
        if best is None or best.counted is None
        else f"prices run from {price_text(cheapest.price, plan.currency)} up, and the highest AP, "
        f"{measured(best.counted)}, costs {price_text(best.price, plan.currency)}"
    )
    conclusion = f"{counted(len(plan.front), 'set')} cannot be bettered in AP, sent data and price at once: {what}."
    drawing = Drawing(
        front_chart(plan.front, _compared(plan, plan.chosen), plan.currency),
        f"The chosen set costs {price_text(plan.chosen.price, plan.currency)} and sends "
        f"{number(plan.chosen.kbit_per_sensor, 0)} kbit per sensor and frame.",
        "AP over kbit per sensor and over price for every set that none beats in all three",
    )
    options = table("Sets that none beats in AP, kbit and price at once", *_options(plan, plan.front))
    return Section(key, title, conclusion, (*_other_traffic(plan, plan.chosen), drawing, *options))


def alternatives_section(plan: Plan) -> Section:
    """Sets that the measurements do not tell from the chosen one."""
    key, title = "alternatives", "Sets that are nearly as good"
    if plan.chosen is None:
        return Section(key, title, NOTHING_CHOSEN)
    close = plan.near_optimal
    if not close:
        return Section(key, title, "No other set that was judged has an interval that overlaps that of the chosen set.")
    cheaper = [each for each in close if each.price < plan.chosen.price]
    mine = _compared(plan, plan.chosen)
    saves = f"; {len(cheaper)} of them would cost less" if cheaper else "; none of them is cheaper"
    conclusion = (
        f"{counted(len(close), 'other set')} cannot be told from the chosen one by the traffic judged, because the "
        f"intervals overlap{saves}."
    )
    sets = table("The chosen set and those whose interval overlaps its own", *_options(plan, (mine, *close)))
    return Section(key, title, conclusion, (*_other_traffic(plan, plan.chosen), *sets))


def _compared(plan: Plan, chosen: PlanOption) -> PlanOption:
    """The chosen set with the figures that it had when the sets were compared."""
    return next((each for each in (*plan.front, *plan.considered) if each.sensors == chosen.sensors), chosen)


def _other_traffic(plan: Plan, chosen: PlanOption) -> tuple[Paragraph, ...]:
    """Why the chosen set has another AP here than in the rest of the report."""
    compared = _compared(plan, chosen)
    if compared.counted is None or chosen.counted is None:
        return ()
    said = f"The AP of sets in this section are those {_asked_of(chosen)} that the question asks for."
    asked = (Paragraph(said),) if _asked_of(chosen) else ()
    if compared.counted == chosen.counted:
        return asked
    return (
        *asked,
        Paragraph(
            f"The AP of this section are from the traffic on which the sets were compared. There the chosen set has "
            f"{measured(compared.counted)}; its {measured(chosen.counted)} in the rest of the report is from other "
            "traffic, which had no say in the choice and is therefore the one to trust."
        ),
    )


def _asked_of(chosen: PlanOption) -> str:
    """Of what the AP is by which sets are compared; "" for that of the intact set in all traffic."""
    left = "" if chosen.left is None else "of what is left with the failures"
    over = "" if chosen.over_levels is None else "over the levels of traffic"
    errors = "" if chosen.over_errors is None else "over the error profiles"
    return " and ".join(each for each in (left, over, errors) if each)


def _options(plan: Plan, options: Any) -> tuple[tuple[Column, ...], list[tuple[Cell, ...]]]:
    columns = (*OPTION_COLUMNS, Column("per sensor", "kbit"), price_column("price", plan.currency))
    return columns, [
        _option(each, chosen=plan.chosen is not None and each.sensors == plan.chosen.sensors) for each in options
    ]


def _option(option: PlanOption, *, chosen: bool) -> tuple[Cell, ...]:
    return (
        text_cell(listed(option.sensors) + (" (chosen)" if chosen else "")),
        figure_cell(option.predicted, 3),
        *judged_cells(option.counted),
        figure_cell(option.kbit_per_sensor),
        figure_cell(option.price, 2),
    )
