"""What each sensor of a set is worth: Shapley values, and which two add more, or less, together than apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from placement_env.report.content import SensorWorth
from placement_env.report.drawings.axes import BAR, ROW, WIDTH, chart_text, head_lines
from toolkit.plots.canvas import blank_figure, house_style, shortened
from toolkit.plots.palette import INK
from toolkit.plots.symbols import sensor_labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_FIGURES = 14  # sensors up to which the cells of the table hold figures


def worth_chart(worth: Sequence[SensorWorth]) -> str:
    """Shapley value of each sensor, and how well each two go together: above 0 they add more together than apart."""
    with house_style():
        labels = sensor_labels([each.sensor for each in worth])
        names = [
            label if label == each.sensor else f"{shortened(each.sensor, 28)}  {label}"
            for label, each in zip(labels, worth, strict=True)
        ]
        side = ROW * max(len(names), 2)
        text = 0.25 + 0.066 * max(map(len, names), default=0)
        height = 0.85 + side + 0.55
        figure = blank_figure(WIDTH, height)
        said = f"Shapley value in AP, and interaction of pairs; N = {len(names)} sensors"
        head_lines(figure, "What each sensor is worth", said)
        bottom = 0.55 / height
        bars = figure.add_axes((text / WIDTH, bottom, 0.3, side / height))
        values = [each.shapley for each in worth]
        bars.barh(range(len(worth)), values, height=0.62, color=BAR, zorder=2)
        for row, value in enumerate(values):
            place: dict[str, Any] = {"xytext": (3, 0), "textcoords": "offset points", "va": "center", "fontsize": 7.5}
            bars.annotate(f"{value:+.3f}", (max(value, 0), row), **place)
        bars.axvline(0, color=INK, linewidth=0.8, zorder=3)
        reach = max((abs(value) for value in values), default=0) or 1.0
        bars.set(ylim=(max(len(worth), 1) - 0.5, -0.5), xlabel="Shapley value (AP)")
        bars.set_xlim(1.35 * min(0.0, *values, 0.0), 1.35 * max(reach * 0.2, *values, 0.0))
        bars.set_yticks(range(len(names)))
        bars.set_yticklabels(names)
        bars.grid(axis="x")
        start = text / WIDTH + 0.36
        table = figure.add_axes((start, bottom, min(0.985 - start, side / WIDTH * 1.6), side / height))
        if len(worth):
            _draw_pairs(table, worth, labels)
        return chart_text(figure, "Shapley values and interactions of the sensors")


def _draw_pairs(axes: Axes, worth: Sequence[SensorWorth], names: Sequence[str]) -> None:
    """The interactions as a table of cells: blue below 0, orange above, with their figures."""
    pairs = np.array([[one.synergy.get(other.sensor, np.nan) for other in worth] for one in worth]).reshape(
        len(worth), -1
    )
    most = float(np.nanmax(np.abs(pairs), initial=0.0)) if np.isfinite(pairs).any() else 0.0
    most = most or 1.0
    axes.imshow(pairs, cmap="PuOr_r", vmin=-most, vmax=most, aspect="auto", interpolation="none")
    axes.set_xticks(range(len(names)))
    axes.set_yticks([])
    axes.set_xticklabels(names, fontsize=7.5 if len(names) < 20 else 5)
    axes.set_title("interaction (AP)", fontsize=8.5, loc="left", pad=3)
    axes.tick_params(length=0)
    if len(worth) <= MOST_FIGURES:
        for (row, column), value in np.ndenumerate(pairs):
            if np.isfinite(value):
                colour = "white" if abs(value) > 0.6 * most else INK
                axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=6.5, color=colour)
