"""Charts of a plan as SVG text. AP is always shown with its interval and the number of vehicles."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from placement_env.cases import iou_text
from placement_env.handover.mounted import RATE, LinkLoad
from placement_env.report import content
from placement_env.search.result import Result
from toolkit.plots import canvas
from toolkit.plots.canvas import BAR, INK, OUTCOME, SENSORS, PlotStyle
from toolkit.plots.curves import curve_axes
from toolkit.plots.plan_view import sensor_labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# inches of a row, and above and below the rows
ROW = 0.27
HEAD = 0.7
FOOT = 0.55
LETTERS = 44  # of a row's name
INTERVAL = f"lines: {content.CONFIDENCE:.0%} intervals"
FRONT_HEIGHT = 4.3  # inches
MOST_FIGURES = 14  # sensors up to which the cells of the table of pairs hold figures


def interval_bars(
    rows: Sequence[tuple[str, content.Judgement | None]],
    title: str,
    *,
    alt: str = "",
    labels: Sequence[str] = (),
    hatched: bool = False,
    right: float = 1.7,
) -> str:
    """Bar of AP for each row, with its interval and the number of vehicles.

    alt: for screen readers in place of the title; labels: in place of the usual ones beside the
    bars; hatched: all bars but the first, whose AP is an upright line; right: inches kept free for
    labels."""
    names = [name for name, _ in rows]
    judged = [each for _, each in rows]
    with canvas.house_style():
        subtitle = f"{describe_sample(judged)}{'; hatched: with failures' * hatched}"
        figure, axes = row_axes(title, subtitle, names, right=right)
        axes.set(xlim=(0, 1), xlabel="AP")
        for row, each in enumerate(judged):
            if each is None:
                axes.text(0.01, row, "not judged: no vehicles", va="center", fontsize=7.5)
                continue
            hatch = "////" if hatched and row else None
            face = "white" if hatch else BAR
            ends = [each.low, each.high]
            axes.barh(
                row,
                each.ap,
                height=0.62,
                facecolor=face,
                edgecolor=BAR,
                hatch=hatch,
                linewidth=1.0,
                zorder=2,
            )
            axes.plot(
                ends, [row, row], color="white", linewidth=3.4, zorder=3, solid_capstyle="butt"
            )
            axes.plot(ends, [row, row], "|-", color=INK, linewidth=1.4, markersize=7, zorder=3.1)
            _write_beside(axes, row, labels[row] if labels else ap_label(each))
        if hatched and judged[0]:
            axes.axvline(judged[0].ap, color=INK, linewidth=0.9, dashes=(4, 2), zorder=1.5)
        return canvas.svg_text(figure, alt or title)


def draw_history(result: Result, out: str | Path) -> None:
    """Write the best reward of a search over the sets it scored as a picture."""
    with canvas.house_style():
        figure, axes = curve_axes(f"{result.method}: best reward so far", 0)
        axes.step(
            result.history.evaluations, result.history.reward, where="post", color=BAR, marker="."
        )
        axes.set(xlabel="sets scored", ylabel="reward")
        canvas.write_figure(figure, out)


def scheme_chart(schemes: Sequence[content.SchemeFigures]) -> str:
    """AP of the fusion schemes at each IoU, and the data they send."""
    rows = [(f"{each.scheme}, IoU {iou_text(each.iou)}", each.judged) for each in schemes]
    labels = [
        f"{ap_label(each.judged)}; {each.kbit_per_sensor:.4g} kbit/sensor" for each in schemes
    ]
    return interval_bars(
        rows, "Fusion schemes", alt="AP of the fusion schemes", labels=labels, right=2.6
    )


def failure_chart(intact: content.Judgement, failures: Sequence[content.FailureCase]) -> str:
    """AP left when sensors fail, beside the whole set's."""
    rows = [
        ("all work", intact),
        *((f"without {set_label(each.failed)}", each.judged) for each in failures),
    ]
    return interval_bars(
        rows, "What is left when sensors fail", alt="AP left when sensors fail", hatched=True
    )


def link_chart(links: Sequence[LinkLoad]) -> str:
    """Mbit/s of each link against its capacity."""
    with canvas.house_style():
        text = f"{RATE:g} frames a second; bar: mean, line: load, upright: capacity of the link"
        figure, axes = row_axes("Load of the links", text, [each.pole for each in links], right=2.3)
        loads = [max(each.mbit_s, each.load_mbit_s) for each in links]
        near = [
            each.capacity_mbit_s
            for each in links
            if each.capacity_mbit_s <= 4 * max(loads, default=0.0)
        ]
        low, high = canvas.pad_limits([*loads, *near])
        for row, each in enumerate(links):
            face, edge, hatch = (
                (BAR, None, None) if each.fits else ("white", OUTCOME["missed"].colour, "xxxx")
            )
            axes.barh(
                row, each.mbit_s, height=0.5, zorder=2, facecolor=face, edgecolor=edge, hatch=hatch
            )
            axes.plot(
                [each.mbit_s, each.load_mbit_s], [row, row], color=INK, linewidth=1.4, zorder=3
            )
            if each.capacity_mbit_s <= high:
                axes.plot(
                    [each.capacity_mbit_s] * 2,
                    [row - 0.33, row + 0.33],
                    color=INK,
                    linewidth=2.4,
                    zorder=3.2,
                )
            state = f"{each.share:.0%}: {'fits' if each.fits else 'TOO MUCH'}"
            _write_beside(
                axes, row, f"{each.mbit_s:.3g} of {each.capacity_mbit_s:.3g} Mbit/s, {state}"
            )
        axes.set(xlim=(low, high), xlabel="Mbit/s")
        return canvas.svg_text(figure, "Load of the links")


def order_chart(order: Sequence[content.BuildStep], currency: str) -> str:
    """AP after each sensor built, over money spent."""
    with canvas.house_style():
        judged = [each.judged for each in order]
        figure = canvas.blank_figure(canvas.CHART_INCHES, HEAD + 2.9 + 0.2 * len(order))
        height = figure.get_size_inches()[1]
        below = (0.75 + 0.2 * len(order)) / height
        axes = figure.add_axes((0.11, below, 0.85, 1 - below - HEAD / height))
        canvas.draw_heading(figure, "Which sensor to build first", describe_sample(judged))
        prices = [each.price for each in order]
        ap = [each.ap for each in judged]
        axes.step([0.0, *prices], [0.0, *ap], where="post", color=BAR, zorder=2)
        for number, (price, each) in enumerate(zip(prices, judged, strict=True)):
            axes.plot(
                [price, price],
                [each.low, each.high],
                "_-",
                color=INK,
                linewidth=1.3,
                markersize=7,
                zorder=3,
            )
            axes.plot(price, each.ap, "o", color=BAR, markeredgecolor=INK, markersize=6, zorder=4)
            axes.annotate(
                str(number + 1),
                (price, each.ap),
                xytext=(6, -10),
                textcoords="offset points",
                fontsize=8,
            )
        axes.grid()
        axes.set(
            xlim=canvas.pad_limits(prices),
            ylim=(0, 1.03),
            xlabel=f"{price_label(currency)}, spent",
            ylabel="AP",
        )
        for number, step in enumerate(order):
            line = (
                f"{number + 1}  {set_label([step.sensor])}: {step.price:g}, AP "
                f"{ap_label(step.judged)}"
            )
            place = 0.08 + 0.2 * (len(order) - 1 - number)
            figure.text(0.11, place / height, line, fontsize=7.5, va="bottom")
        return canvas.svg_text(figure, "AP after each sensor built")


def front_chart(
    options: Sequence[content.PlanOption], chosen: content.PlanOption, currency: str
) -> str:
    """AP over kbit per sensor and over price: judged sets with intervals, others hollow, the chosen
    one marked."""
    from matplotlib.lines import Line2D

    dot: PlotStyle = {"marker": "o", "markersize": 6, "markeredgecolor": BAR, "linestyle": "none"}
    star: PlotStyle = {"marker": "*", "markersize": 15, "color": SENSORS[1], "markeredgecolor": INK}
    marks: dict[str, PlotStyle] = {
        "chosen": {**star, "markeredgewidth": 0.9, "linestyle": "none"},
        "judged by the detector": {**dot, "markerfacecolor": BAR},
        "predicted only": {**dot, "markerfacecolor": "white"},
    }
    with canvas.house_style():
        figure = canvas.blank_figure(canvas.CHART_INCHES, FRONT_HEIGHT)
        everyone = [*(each for each in options if each != chosen), chosen]
        count = f"N = {len(everyone)} sensor set{'s' * (len(everyone) > 1)}"
        sample = describe_sample([each.judged for each in everyone])
        canvas.draw_heading(
            figure, "AP against what is sent and what it costs", f"{count}; {sample}"
        )
        for left, label, values in (
            (0.09, "kbit per sensor and frame", [each.kbit_per_sensor for each in everyone]),
            (0.57, price_label(currency), [each.price for each in everyone]),
        ):
            axes = figure.add_axes((left, 0.24, 0.4, 0.58))
            for x, option in zip(values, everyone, strict=True):
                is_chosen = option is chosen
                ap = option.predicted
                if option.counted is not None:
                    ap = option.counted.ap
                    ends = [option.counted.low, option.counted.high]
                    axes.plot(
                        [x, x], ends, color=INK, linewidth=1.6 if is_chosen else 0.8, zorder=3
                    )
                how = (
                    "chosen"
                    if is_chosen
                    else "predicted only"
                    if option.judged is None
                    else "judged by the detector"
                )
                axes.plot(x, ap, zorder=5 if is_chosen else 4, **marks[how])
            axes.grid()
            axes.set(xlim=canvas.pad_limits(values), ylim=(0, 1.03), xlabel=label, ylabel="AP")
        lines = [Line2D([], [], **style) for style in marks.values()]
        figure.legend(lines, list(marks), loc="lower left", ncols=3, bbox_to_anchor=(0.07, 0.0))
        return canvas.svg_text(figure, f"AP against kbit and price; {INTERVAL}")


def worth_chart(worth: Sequence[content.SensorWorth]) -> str:
    """Shapley values, and interactions of pairs: above 0, two sensors add more together than
    apart."""
    with canvas.house_style():
        labels = sensor_labels([each.sensor for each in worth])
        names = [
            label if label == each.sensor else f"{canvas.shorten(each.sensor, 28)}  {label}"
            for label, each in zip(labels, worth, strict=True)
        ]
        side = ROW * max(len(names), 2)
        text = 0.25 + 0.066 * max(map(len, names), default=0)
        height = 0.85 + side + 0.55
        figure = canvas.blank_figure(canvas.CHART_INCHES, height)
        heading = f"Shapley value in AP, and interaction of pairs; N = {len(names)} sensors"
        canvas.draw_heading(figure, "What each sensor is worth", heading)
        bars = figure.add_axes((text / canvas.CHART_INCHES, 0.55 / height, 0.3, side / height))
        values = [each.shapley for each in worth]
        bars.barh(range(len(worth)), values, height=0.62, color=BAR, zorder=2)
        for row, value in enumerate(values):
            place = (max(value, 0), row)
            bars.annotate(
                f"{value:+.3f}",
                place,
                xytext=(3, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
            )
        bars.axvline(0, color=INK, linewidth=0.8, zorder=3)
        reach = max((abs(value) for value in values), default=0) or 1.0
        bars.set(ylim=(max(len(worth), 1) - 0.5, -0.5), xlabel="Shapley value (AP)")
        bars.set_xlim(1.35 * min(0.0, *values, 0.0), 1.35 * max(reach * 0.2, *values, 0.0))
        bars.set_yticks(range(len(names)))
        bars.set_yticklabels(names)
        bars.grid(axis="x")
        start = text / canvas.CHART_INCHES + 0.36
        width = min(0.985 - start, side / canvas.CHART_INCHES * 1.6)
        _draw_pairs(figure.add_axes((start, 0.55 / height, width, side / height)), worth, labels)
        return canvas.svg_text(figure, "Shapley values and interactions of the sensors")


def _draw_pairs(axes: "Axes", worth: Sequence[content.SensorWorth], names: Sequence[str]) -> None:
    if not worth:
        return
    pairs = np.array([[one.synergy.get(other.sensor, np.nan) for other in worth] for one in worth])
    most = float(np.abs(np.nan_to_num(pairs)).max()) or 1.0
    axes.imshow(pairs, cmap="PuOr_r", vmin=-most, vmax=most, aspect="auto", interpolation="none")
    axes.set_xticks(range(len(names)))
    axes.set_yticks([])
    axes.set_xticklabels(names, fontsize=7.5 if len(names) < 20 else 5)
    axes.set_title("interaction (AP)", fontsize=8.5, loc="left", pad=3)
    axes.tick_params(length=0)
    for (row, column), value in np.ndenumerate(pairs if len(worth) <= MOST_FIGURES else pairs[:0]):
        if np.isfinite(value):
            colour = "white" if abs(value) > 0.6 * most else INK
            axes.text(
                column, row, f"{value:+.2f}", ha="center", va="center", fontsize=6.5, color=colour
            )


def row_axes(
    title: str, subtitle: str, names: Sequence[str], *, right: float = 1.7
) -> "tuple[Figure, Axes]":
    """Figure with a row for each name. right: inches kept free beside the rows."""
    names, rows = [canvas.shorten(name, LETTERS) for name in names], max(len(names), 1)
    left = 0.35 + 0.066 * max(map(len, names), default=0)
    height = HEAD + FOOT + ROW * rows
    figure = canvas.blank_figure(canvas.CHART_INCHES, height)
    width = (canvas.CHART_INCHES - left - right) / canvas.CHART_INCHES
    axes = figure.add_axes((left / canvas.CHART_INCHES, FOOT / height, width, ROW * rows / height))
    axes.set(ylim=(rows - 0.5, -0.5))
    axes.set_yticks(range(len(names)), [""] * len(names))
    axes.set_yticklabels(names)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    canvas.draw_heading(figure, title, subtitle)
    return figure, axes


def _write_beside(axes: "Axes", row: int, text: str) -> None:
    place: PlotStyle = {
        "xycoords": ("axes fraction", "data"),
        "xytext": (8, 0),
        "textcoords": "offset points",
    }
    axes.annotate(text, (1, row), **place, va="center", fontsize=7.5, annotation_clip=False)


def ap_label(judged: content.Judgement) -> str:
    """AP and the number of vehicles."""
    return f"{judged.format_ap()}, N = {judged.vehicles}"


def describe_sample(judged: Sequence[content.Judgement | None]) -> str:
    """Largest number of vehicles and frames behind figures."""
    some = [each for each in judged if each is not None]
    if not some:
        return "no vehicles were judged"
    vehicles = max(each.vehicles for each in some)
    frames = max(each.frames for each in some)
    up_to = "up to " if len({(each.vehicles, each.frames) for each in some}) > 1 else ""
    return (
        f"judged by the detector, N = {up_to}{vehicles} {some[0].kind}s in {frames} frames; "
        f"{INTERVAL}"
    )


def price_label(currency: str) -> str:
    """Axis label of prices."""
    return f"price ({canvas.shorten(currency, 12)})" if currency else "price (ordinary poles)"


def set_label(names: Sequence[str]) -> str:
    """Sensors of a set in a few letters."""
    return canvas.shorten(", ".join(names) or "none", LETTERS)
