"""Charts of a plan as SVG text. Where AP is shown, so are its interval and the number of vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from placement_env.fidelity.combined.mean_iou import iou_text
from placement_env.report.content import (
    RATE,
    BuildStep,
    FailureCase,
    Judgement,
    LinkLoad,
    PlanOption,
    SchemeFigures,
)
from placement_env.report.drawings.axes import (
    BAR,
    HEAD,
    INTERVAL,
    WIDTH,
    ap_words,
    beside,
    chart_text,
    counted_words,
    draw_intervals,
    head_lines,
    padded_limits,
    price_words,
    row_axes,
    set_words,
)
from placement_env.report.drawings.worth import worth_chart as worth_chart
from toolkit.plots.canvas import blank_figure, house_style
from toolkit.plots.palette import INK, OUTCOME, SENSORS

MISSED = OUTCOME["missed"].colour
FRONT_HEIGHT = 4.3  # inches


def interval_bars(rows: Sequence[tuple[str, Judgement]], title: str) -> str:
    """AP with its interval and the number of vehicles, a bar for each row."""
    with house_style():
        judged = [each for _, each in rows]
        figure, axes = row_axes(title, counted_words(judged), [name for name, _ in rows])
        draw_intervals(axes, judged)
        return chart_text(figure, title)


def scheme_chart(schemes: Sequence[SchemeFigures]) -> str:
    """AP of the fusion schemes at each IoU, and what they send."""
    with house_style():
        names = [f"{each.scheme}, IoU {iou_text(each.iou)}" for each in schemes]
        judged = [each.judged for each in schemes]
        figure, axes = row_axes("Fusion schemes", counted_words(judged), names, right=2.6)
        draw_intervals(axes, judged)
        for row, each in enumerate(schemes):
            axes.texts[row].set_text(f"{ap_words(each.judged)}; {each.kbit_per_sensor:.4g} kbit/sensor")
        return chart_text(figure, "AP of the fusion schemes")


def failure_chart(intact: Judgement, failures: Sequence[FailureCase]) -> str:
    """AP that is left when sensors fail, beside that of the whole set; hatched: with failures."""
    with house_style():
        judged = [intact, *(each.judged for each in failures)]
        names = ["all work", *(f"without {set_words(each.failed)}" for each in failures)]
        said = f"{counted_words(judged)}; hatched: with failures"
        figure, axes = row_axes("What is left when sensors fail", said, names)
        draw_intervals(axes, judged, hatched=[False] + [True] * len(failures))
        axes.axvline(intact.ap, color=INK, linewidth=0.9, dashes=(4, 2), zorder=1.5)
        return chart_text(figure, "AP that is left when sensors fail")


def link_chart(links: Sequence[LinkLoad]) -> str:
    """Mbit/s of each link, mean and greatest frame, against its capacity."""
    with house_style():
        said = f"{RATE:g} frames a second; bar: mean, line: greatest frame, upright: capacity of the link"
        figure, axes = row_axes("Load of the links", said, [each.pole for each in links], right=2.3)
        loads = [max(each.mbit_s, each.peak_mbit_s) for each in links]
        near = [each.capacity_mbit_s for each in links if each.capacity_mbit_s <= 4 * max(loads, default=0.0)]
        low, high = padded_limits([*loads, *near])
        for row, each in enumerate(links):
            axes.barh(row, each.mbit_s, height=0.5, zorder=2, **_load_style(each.fits))
            axes.plot([each.mbit_s, each.peak_mbit_s], [row, row], color=INK, linewidth=1.4, zorder=3)
            if each.capacity_mbit_s <= high:
                end = [each.capacity_mbit_s] * 2
                axes.plot(end, [row - 0.33, row + 0.33], color=INK, linewidth=2.4, zorder=3.2)
            state = "fits" if each.fits else "TOO MUCH"
            beside(axes, row, f"{each.mbit_s:.3g} of {each.capacity_mbit_s:.3g} Mbit/s, {each.share:.0%}: {state}")
        axes.set(xlim=(low, high), xlabel="Mbit/s")
        return chart_text(figure, "Load of the links")


def order_chart(order: Sequence[BuildStep], currency: str) -> str:
    """AP after each sensor built, over what is spent by then."""
    with house_style():
        judged = [each.judged for each in order]
        figure = blank_figure(WIDTH, HEAD + 2.9 + 0.2 * len(order))
        below = (0.75 + 0.2 * len(order)) / figure.get_size_inches()[1]
        axes = figure.add_axes((0.11, below, 0.85, 1 - below - HEAD / figure.get_size_inches()[1]))
        head_lines(figure, "Which sensor to build first", counted_words(judged))
        prices, ap = [each.price for each in order], [each.ap for each in judged]
        axes.step([0.0, *prices], [0.0, *ap], where="post", color=BAR, zorder=2)
        for number, (price, each) in enumerate(zip(prices, judged, strict=True)):
            axes.plot([price, price], [each.low, each.high], "_-", color=INK, linewidth=1.3, markersize=7, zorder=3)
            axes.plot(price, each.ap, "o", color=BAR, markeredgecolor=INK, markersize=6, zorder=4)
            axes.annotate(str(number + 1), (price, each.ap), xytext=(6, -10), textcoords="offset points", fontsize=8)
        axes.grid()
        axes.set(xlim=padded_limits(prices), ylim=(0, 1.03), xlabel=f"{price_words(currency)}, spent", ylabel="AP")
        for number, step in enumerate(order):
            line = f"{number + 1}  {set_words([step.sensor])}: {step.price:g}, AP {ap_words(step.judged)}"
            place = 0.08 + 0.2 * (len(order) - 1 - number)
            figure.text(0.11, place / figure.get_size_inches()[1], line, fontsize=7.5, va="bottom")
        return chart_text(figure, "AP after each sensor built")


def front_chart(options: Sequence[PlanOption], chosen: PlanOption, currency: str) -> str:
    """AP over kbit per sensor and over price; the chosen set is marked. Judged sets have intervals; of the others the
    predicted AP is shown hollow."""
    from matplotlib.lines import Line2D

    with house_style():
        figure = blank_figure(WIDTH, FRONT_HEIGHT)
        everyone = [each for each in options if each != chosen]
        judged = [each.judged for each in [*everyone, chosen]]
        count = f"N = {len(everyone) + 1} sensor sets" if everyone else "N = 1 sensor set"
        head_lines(figure, "AP against what is sent and what it costs", f"{count}; {counted_words(judged)}")
        left = [0.09, 0.57]
        sent, prices = ([getattr(each, name) for each in [*everyone, chosen]] for name in ("kbit_per_sensor", "price"))
        for place, label, values in (
            (left[0], "kbit per sensor and frame", sent),
            (left[1], price_words(currency), prices),
        ):
            axes = figure.add_axes((place, 0.24, 0.4, 0.58))
            for x, option in zip(values, [*everyone, chosen], strict=True):
                is_chosen = option is chosen
                if option.counted is not None:
                    ends = [option.counted.low, option.counted.high]
                    axes.plot([x, x], ends, color=INK, linewidth=1.6 if is_chosen else 0.8, zorder=3)
                ap = option.predicted if option.counted is None else option.counted.ap
                style = _chosen_style() if is_chosen else _option_style(option.judged is not None)
                axes.plot(x, ap, zorder=5 if is_chosen else 4, **style)
            axes.grid()
            axes.set(xlim=padded_limits(values), ylim=(0, 1.03))
            axes.set(xlabel=label, ylabel="AP")
        names = ["chosen", "judged by the detector", "predicted only"]
        marks = [Line2D([], [], **style) for style in (_chosen_style(), _option_style(True), _option_style(False))]
        figure.legend(marks, names, loc="lower left", ncols=3, bbox_to_anchor=(0.07, 0.0))
        return chart_text(figure, f"AP against kbit and price; {INTERVAL}")


def _load_style(fits: bool) -> dict[str, Any]:
    return {"facecolor": BAR} if fits else {"facecolor": "white", "edgecolor": MISSED, "hatch": "xxxx"}


def _chosen_style() -> dict[str, Any]:
    return {
        "marker": "*",
        "markersize": 15,
        "color": SENSORS[1],
        "markeredgecolor": INK,
        "markeredgewidth": 0.9,
        "linestyle": "none",
    }


def _option_style(judged: bool) -> dict[str, Any]:
    face = BAR if judged else "white"
    return {"marker": "o", "markersize": 6, "markerfacecolor": face, "markeredgecolor": BAR, "linestyle": "none"}
