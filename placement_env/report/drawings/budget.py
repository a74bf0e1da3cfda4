"""The budget curve as a picture: AP with its interval for every number of sensors, or over money."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from placement_env.report.drawings.axes import BAR, HEAD, INTERVAL, WIDTH, head_lines, padded_limits, price_words
from placement_env.search.portfolio.curve import CurvePoint
from toolkit.plots.canvas import blank_figure, house_style, write_figure
from toolkit.plots.palette import INK

CURVE_HEIGHT = 4.0  # inches


def draw_curve(points: Sequence[CurvePoint], out: Path | str, *, judge: str, currency: str = "") -> None:
    """Write the picture (PNG or SVG, by the file's name). The line goes through the sets that pay; the others are
    hollow, and crosses say what was predicted. judge: fidelity that the AP are by."""
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    with house_style():
        figure = blank_figure(WIDTH, CURVE_HEIGHT)
        head_lines(figure, "What a budget buys", f"AP by the {judge} on traffic of its own; {INTERVAL}")
        top = 1 - HEAD / CURVE_HEIGHT
        axes = figure.add_axes((0.09, 0.22, 0.88, top - 0.22))
        by_money = any(math.isfinite(point.money) for point in points)
        places = [point.price if by_money else float(point.sensors) for point in points]
        pays = sorted((x, point.ap) for x, point in zip(places, points, strict=True) if point.pays)
        axes.step([x for x, _ in pays], [ap for _, ap in pays], where="post", color=BAR, zorder=2)
        for x, point in zip(places, points, strict=True):
            axes.plot([x, x], [point.low, point.high], "_-", color=INK, linewidth=1.3, markersize=7, zorder=3)
            axes.plot(x, point.predicted, "x", color=INK, markersize=5, zorder=3.5)
            face = BAR if point.pays else "white"
            axes.plot(x, point.ap, "o", markerfacecolor=face, markeredgecolor=INK, markersize=7, zorder=4)
        axes.grid()
        if not by_money:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        label = price_words(currency) if by_money else "sensors"
        axes.set(xlim=padded_limits(places), ylim=(0, 1.03), xlabel=label, ylabel="AP")
        marks = [
            Line2D([], [], color=INK, marker=marker, markerfacecolor=face, linestyle="none")
            for marker, face in (("o", BAR), ("o", "white"), ("x", INK))
        ]
        names = ["best of its budget", "no more than a cheaper one", "predicted by the search"]
        figure.legend(marks, names, loc="lower left", ncols=3, bbox_to_anchor=(0.07, 0.0))
        write_figure(figure, out)
