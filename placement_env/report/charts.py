"""Charts of a plan as SVG text. Each AP has its interval and its number of vehicles."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from placement_env.cases import iou_text
from placement_env.handover.mounted import FRAME_RATE_HZ, PoleLoad
from placement_env.report import content
from placement_env.search.result import Result
from toolkit.plots import canvas
from toolkit.plots.curves import curve_axes
from toolkit.plots.line_style import PlotStyle
from toolkit.plots.palette import BAR, INK, OUTCOME, SENSORS
from toolkit.plots.sensor_marks import sensor_labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_INCHES = 0.27  # height of a row
HEAD_INCHES = 0.7  # above the rows
FOOT_INCHES = 0.55  # below the rows
MAX_NAME_LETTERS = 44  # longer names of rows are shortened
LETTER_INCHES = 0.066  # width of a letter of a row's name, roughly
INTERVAL_NOTE = f"lines: {content.CONFIDENCE:.0%} intervals"
FRONT_INCHES = 4.3  # height of the front chart
MAX_FIGURE_SENSORS = 14  # with more, the cells of the table of pairs hold no figures


def interval_bars(
    rows: Sequence[tuple[str, content.Judgement | None]],
    title: str,
    *,
    alt: str = "",
    labels: Sequence[str] = (),
    hatched: bool = False,
    right: float = 1.7,
) -> str:
    """Draw a bar of AP for each row, with its interval and number of vehicles, as SVG.

    Args:
        rows: Name and result of each bar, None without vehicles.
        title: Heading of the chart.
        alt: Text for screen readers, "" for the title.
        labels: Text right of each bar, empty for AP and number of vehicles.
        hatched: True to hatch all bars but the first, whose AP is an upright line.
        right: Inches kept free for labels."""
    names = [name for name, _ in rows]
    judgements = [judgement for _, judgement in rows]
    with canvas.house_style():
        hatch_note = "; hatched: with failures" if hatched else ""
        subtitle = f"{describe_sample(judgements)}{hatch_note}"
        figure, axes = row_axes(title, subtitle, names, right=right)
        axes.set(xlim=(0, 1), xlabel="AP")
        for row, judgement in enumerate(judgements):
            if judgement is None:
                axes.text(0.01, row, "not judged: no vehicles", va="center", fontsize=7.5)
                continue
            hatch = "////" if hatched and row else None
            face = "white" if hatch else BAR
            interval = [judgement.low, judgement.high]
            axes.barh(
                row,
                judgement.ap,
                height=0.62,
                facecolor=face,
                edgecolor=BAR,
                hatch=hatch,
                linewidth=1.0,
                zorder=2,
            )
            # white below the dark line, which would not show on the bar
            axes.plot(
                interval, [row, row], color="white", linewidth=3.4, zorder=3, solid_capstyle="butt"
            )
            axes.plot(
                interval, [row, row], "|-", color=INK, linewidth=1.4, markersize=7, zorder=3.1
            )
            _write_right(axes, row, labels[row] if labels else ap_label(judgement))
        if hatched and judgements[0]:
            axes.axvline(judgements[0].ap, color=INK, linewidth=0.9, dashes=(4, 2), zorder=1.5)
        return canvas.svg_text(figure, alt or title)


def draw_history(result: Result, out: str | Path) -> None:
    """Write a picture of the best reward over the number of sets that a search scored.

    result: of the search, with its history; out: path, whose suffix gives the format."""
    with canvas.house_style():
        figure, axes = curve_axes(f"{result.method}: best reward so far", 0)
        axes.step(
            result.history.evaluations, result.history.reward, where="post", color=BAR, marker="."
        )
        axes.set(xlabel="sets scored", ylabel="reward")
        canvas.write_figure(figure, out)


def scheme_chart(schemes: Sequence[content.SchemeFigures]) -> str:
    """Draw the AP of the fusion schemes at each IoU as SVG, with the kbit per sensor they send."""
    # name and result of each bar
    rows = [
        (f"{figures.scheme}, IoU {iou_text(figures.iou)}", figures.judged) for figures in schemes
    ]
    labels = [
        f"{ap_label(figures.judged)}; {figures.kbit_per_sensor:.4g} kbit/sensor"
        for figures in schemes
    ]
    return interval_bars(
        rows, "Fusion schemes", alt="AP of the fusion schemes", labels=labels, right=2.6
    )


def failure_chart(intact: content.Judgement, failures: Sequence[content.FailureCase]) -> str:
    """Draw the AP that remains after each failure, below the intact set's, as SVG."""
    # name and result of each bar
    rows: list[tuple[str, content.Judgement | None]] = [("all work", intact)]
    rows += [(f"without {set_label(case.failed)}", case.judged) for case in failures]
    return interval_bars(
        rows, "What is left when sensors fail", alt="AP left when sensors fail", hatched=True
    )


def link_chart(links: Sequence[PoleLoad]) -> str:
    """Draw the Mbit/s of each link against its capacity, as SVG.

    A bar is the mean, a line goes to the load that the link must carry. Capacities far beyond all
    loads are only written."""
    too_narrow: PlotStyle = {
        "facecolor": "white",
        "edgecolor": OUTCOME["missed"].colour,
        "hatch": "xxxx",
    }
    with canvas.house_style():
        subtitle = (
            f"{FRAME_RATE_HZ:g} frames a second; bar: mean, line: load, upright: capacity of the "
            "link"
        )
        poles = [link.pole for link in links]
        figure, axes = row_axes("Load of the links", subtitle, poles, right=2.3)
        loads = [max(link.mbit_s, link.load_mbit_s) for link in links]
        max_shown = 4 * max(loads, default=0.0)  # larger capacities would shrink all bars
        capacities = [link.capacity_mbit_s for link in links if link.capacity_mbit_s <= max_shown]
        low, high = canvas.pad_limits([*loads, *capacities])
        for row, link in enumerate(links):
            style: PlotStyle = {"facecolor": BAR} if link.fits else too_narrow
            axes.barh(row, link.mbit_s, height=0.5, zorder=2, **style)
            axes.plot(
                [link.mbit_s, link.load_mbit_s], [row, row], color=INK, linewidth=1.4, zorder=3
            )
            if link.capacity_mbit_s <= high:
                axes.plot(
                    [link.capacity_mbit_s] * 2,
                    [row - 0.33, row + 0.33],
                    color=INK,
                    linewidth=2.4,
                    zorder=3.2,
                )
            state = f"{link.share:.0%}: {'fits' if link.fits else 'TOO MUCH'}"
            _write_right(
                axes, row, f"{link.mbit_s:.3g} of {link.capacity_mbit_s:.3g} Mbit/s, {state}"
            )
        axes.set(xlim=(low, high), xlabel="Mbit/s")
        return canvas.svg_text(figure, "Load of the links")


def order_chart(order: Sequence[content.BuildStep], currency: str) -> str:
    """Draw the AP after each sensor built, over the money spent, as SVG.

    currency: "" for prices of one ordinary pole."""
    with canvas.house_style():
        judgements = [step.judged for step in order]
        figure = canvas.blank_figure(canvas.CHART_INCHES, HEAD_INCHES + 2.9 + 0.2 * len(order))
        height = figure.get_size_inches()[1]
        below = (0.75 + 0.2 * len(order)) / height
        axes = figure.add_axes((0.11, below, 0.85, 1 - below - HEAD_INCHES / height))
        canvas.draw_heading(figure, "Which sensor to build first", describe_sample(judgements))
        prices = [step.price for step in order]
        ap = [judgement.ap for judgement in judgements]
        axes.step([0.0, *prices], [0.0, *ap], where="post", color=BAR, zorder=2)
        for number, (price, judgement) in enumerate(zip(prices, judgements, strict=True)):
            canvas.draw_interval(axes, price, judgement.low, judgement.high)
            axes.plot(
                price, judgement.ap, "o", color=BAR, markeredgecolor=INK, markersize=6, zorder=4
            )
            axes.annotate(
                str(number + 1),
                (price, judgement.ap),
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
            bottom = 0.08 + 0.2 * (len(order) - 1 - number)
            figure.text(0.11, bottom / height, line, fontsize=7.5, va="bottom")
        return canvas.svg_text(figure, "AP after each sensor built")


def front_chart(
    options: Sequence[content.PlanOption], chosen_set: content.PlanOption, currency: str
) -> str:
    """Draw AP over kbit per sensor and over price as SVG, with the chosen set marked.

    Judged sets have intervals; sets with only a predicted AP are hollow.

    options: sets to draw, with or without the chosen one; currency: "" for ordinary poles."""
    from matplotlib.lines import Line2D

    dot: PlotStyle = {"marker": "o", "markersize": 6, "markeredgecolor": BAR, "linestyle": "none"}
    star: PlotStyle = {"marker": "*", "markersize": 15, "color": SENSORS[1], "markeredgecolor": INK}
    marks: dict[str, PlotStyle] = {
        "chosen": {**star, "markeredgewidth": 0.9, "linestyle": "none"},
        "judged by the detector": {**dot, "markerfacecolor": BAR},
        "predicted only": {**dot, "markerfacecolor": "white"},
    }
    with canvas.house_style():
        figure = canvas.blank_figure(canvas.CHART_INCHES, FRONT_INCHES)
        all_sets = [sensor_set for sensor_set in options if sensor_set != chosen_set]
        all_sets.append(chosen_set)
        set_count = f"N = {len(all_sets)} sensor set{'s' * (len(all_sets) > 1)}"
        sample = describe_sample([sensor_set.judged for sensor_set in all_sets])
        canvas.draw_heading(
            figure, "AP against what is sent and what it costs", f"{set_count}; {sample}"
        )
        kbits = [sensor_set.kbit_per_sensor for sensor_set in all_sets]
        prices = [sensor_set.price for sensor_set in all_sets]
        # left edge as a share of the figure, axis label and values of each panel
        panels = ((0.09, "kbit per sensor and frame", kbits), (0.57, price_label(currency), prices))
        for left, label, values in panels:
            axes = figure.add_axes((left, 0.24, 0.4, 0.58))
            for x, option in zip(values, all_sets, strict=True):
                is_chosen = option is chosen_set
                ap = option.predicted
                if option.counted is not None:
                    ap = option.counted.ap
                    interval = [option.counted.low, option.counted.high]
                    width = 1.6 if is_chosen else 0.8
                    axes.plot([x, x], interval, color=INK, linewidth=width, zorder=3)
                status = "judged by the detector"
                if is_chosen:
                    status = "chosen"
                elif option.judged is None:
                    status = "predicted only"
                axes.plot(x, ap, zorder=5 if is_chosen else 4, **marks[status])
            axes.grid()
            axes.set(xlim=canvas.pad_limits(values), ylim=(0, 1.03), xlabel=label, ylabel="AP")
        lines = [Line2D([], [], **style) for style in marks.values()]
        figure.legend(lines, list(marks), loc="lower left", ncols=3, bbox_to_anchor=(0.07, 0.0))
        return canvas.svg_text(figure, f"AP against kbit and price; {INTERVAL_NOTE}")


def worth_chart(worth: Sequence[content.SensorWorth]) -> str:
    """Draw Shapley values of sensors and interactions of pairs, as SVG.

    An interaction above 0 means that two sensors add more together than apart."""
    with canvas.house_style():
        labels = sensor_labels([sensor_worth.sensor for sensor_worth in worth])
        names = [
            label
            if label == sensor_worth.sensor
            else f"{canvas.shorten(sensor_worth.sensor, 28)}  {label}"
            for label, sensor_worth in zip(labels, worth, strict=True)
        ]
        side = ROW_INCHES * max(len(names), 2)
        label_inches = 0.25 + LETTER_INCHES * max(map(len, names), default=0)
        height = 0.85 + side + 0.55
        figure = canvas.blank_figure(canvas.CHART_INCHES, height)
        heading = f"Shapley value in AP, and interaction of pairs; N = {len(names)} sensors"
        canvas.draw_heading(figure, "What each sensor is worth", heading)
        bars = figure.add_axes(
            (label_inches / canvas.CHART_INCHES, 0.55 / height, 0.3, side / height)
        )
        values = [sensor_worth.shapley for sensor_worth in worth]
        bars.barh(range(len(worth)), values, height=0.62, color=BAR, zorder=2)
        for row, value in enumerate(values):
            bar_end = (max(value, 0), row)
            bars.annotate(
                f"{value:+.3f}",
                bar_end,
                xytext=(3, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
            )
        bars.axvline(0, color=INK, linewidth=0.8, zorder=3)
        longest_bar = max((abs(value) for value in values), default=0) or 1.0
        bars.set(ylim=(max(len(worth), 1) - 0.5, -0.5), xlabel="Shapley value (AP)")
        bars.set_xlim(1.35 * min(0.0, *values, 0.0), 1.35 * max(longest_bar * 0.2, *values, 0.0))
        bars.set_yticks(range(len(names)))
        bars.set_yticklabels(names)
        bars.grid(axis="x")
        start = label_inches / canvas.CHART_INCHES + 0.36
        width = min(0.985 - start, side / canvas.CHART_INCHES * 1.6)
        _draw_pairs(figure.add_axes((start, 0.55 / height, width, side / height)), worth, labels)
        return canvas.svg_text(figure, "Shapley values and interactions of the sensors")


def _draw_pairs(axes: "Axes", worth: Sequence[content.SensorWorth], names: Sequence[str]) -> None:
    """Draw a square of cells, one for each pair of sensors, coloured by their interaction (AP).

    names: short labels of the sensors."""
    if not worth:
        return
    # NaN on the diagonal, because a sensor does not interact with itself
    interactions = np.full((len(worth), len(worth)), np.nan)
    for row, first in enumerate(worth):
        for column, second in enumerate(worth):
            interactions[row, column] = first.synergy.get(second.sensor, np.nan)
    # 0 has no colour scale
    max_interaction = float(np.abs(np.nan_to_num(interactions)).max()) or 1.0
    axes.imshow(
        interactions,
        cmap="PuOr_r",
        vmin=-max_interaction,
        vmax=max_interaction,
        aspect="auto",
        interpolation="none",
    )
    axes.set_xticks(range(len(names)))
    axes.set_yticks([])
    axes.set_xticklabels(names, fontsize=7.5 if len(names) < 20 else 5)
    axes.set_title("interaction (AP)", fontsize=8.5, loc="left", pad=3)
    axes.tick_params(length=0)
    # numbers are written only into figures of few sensors
    written = interactions if len(worth) <= MAX_FIGURE_SENSORS else interactions[:0]
    for (row, column), value in np.ndenumerate(written):
        if np.isfinite(value):
            # white on dark cells
            colour = "white" if abs(value) > 0.6 * max_interaction else INK
            axes.text(
                column, row, f"{value:+.2f}", ha="center", va="center", fontsize=6.5, color=colour
            )


def row_axes(
    title: str, subtitle: str, names: Sequence[str], *, right: float = 1.7
) -> "tuple[Figure, Axes]":
    """Return a figure and its axes, with a row for each name from the top, row 0 first.

    names: labels left of the rows, shortened; right: inches kept free right of the rows."""
    labels = [canvas.shorten(name, MAX_NAME_LETTERS) for name in names]
    rows = max(len(labels), 1)
    left = 0.35 + LETTER_INCHES * max(map(len, labels), default=0)
    height = HEAD_INCHES + FOOT_INCHES + ROW_INCHES * rows
    figure = canvas.blank_figure(canvas.CHART_INCHES, height)
    width = (canvas.CHART_INCHES - left - right) / canvas.CHART_INCHES
    # left, bottom, width and height as shares of the figure
    axes = figure.add_axes(
        (left / canvas.CHART_INCHES, FOOT_INCHES / height, width, ROW_INCHES * rows / height)
    )
    axes.set(ylim=(rows - 0.5, -0.5))
    axes.set_yticks(range(len(labels)), [""] * len(labels))  # names follow as literal labels
    axes.set_yticklabels(labels)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    canvas.draw_heading(figure, title, subtitle)
    return figure, axes


def _write_right(axes: "Axes", row: int, text: str) -> None:
    """Write a text right of the axes, at the height of a row."""
    # the x of the text is a share of the axes, the y is in data
    placement: PlotStyle = {
        "xycoords": ("axes fraction", "data"),
        "xytext": (8, 0),
        "textcoords": "offset points",
    }
    axes.annotate(text, xy=(1, row), **placement, va="center", fontsize=7.5, annotation_clip=False)


def ap_label(judged: content.Judgement) -> str:
    """Return a label with the AP and its number of vehicles."""
    return f"{judged.format_ap()}, N = {judged.vehicles}"


def describe_sample(judgements: Sequence[content.Judgement | None]) -> str:
    """Describe the largest number of vehicles and frames behind figures, for a subtitle.

    judgements: results in the chart, None for those without vehicles."""
    known_judgements = [judgement for judgement in judgements if judgement is not None]
    if not known_judgements:
        return "no vehicles were judged"
    vehicles = max(judgement.vehicles for judgement in known_judgements)
    frames = max(judgement.frames for judgement in known_judgements)
    sizes = {(judgement.vehicles, judgement.frames) for judgement in known_judgements}
    up_to = "up to " if len(sizes) > 1 else ""
    kind = known_judgements[0].kind
    return (
        f"judged by the detector, N = {up_to}{vehicles} {kind}s in {frames} frames; {INTERVAL_NOTE}"
    )


def price_label(currency: str) -> str:
    """Return the axis label of prices. currency: "" for prices of one ordinary pole."""
    return f"price ({canvas.shorten(currency, 12)})" if currency else "price (ordinary poles)"


def set_label(names: Sequence[str]) -> str:
    """Return the names of a set's sensors, shortened."""
    return canvas.shorten(", ".join(names) or "none", MAX_NAME_LETTERS)
