"""The budget curve as a picture. It shows AP with its interval over numbers of sensors or money."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from placement_env.search.portfolio.curve import CurvePoint
from toolkit.plots.canvas import (
    CHART_INCHES,
    blank_figure,
    draw_heading,
    house_style,
    pad_limits,
    shorten,
    write_figure,
)
from toolkit.plots.palette import BAR, INK

CURVE_HEIGHT = 4.0  # inches
CURVE_HEAD = 0.7  # inches of it above the axes


def draw_curve(points: Sequence[CurvePoint], out: Path | str, *, judge: str, currency: str = "") -> None:
    """Write the picture as PNG or SVG, by suffix.

    The line goes through the sets that pay; other sets are hollow, and crosses show predictions. judge: fidelity that
    measured the AP.
    """
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    with house_style():
        figure = blank_figure(CHART_INCHES, CURVE_HEIGHT)
        subtitle = f"AP by the {judge} on traffic of its own; lines: 95% intervals"
        draw_heading(figure, "What a budget buys", subtitle)
        axes = figure.add_axes((0.09, 0.22, 0.88, 1 - CURVE_HEAD / CURVE_HEIGHT - 0.22))
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
        price = f"price ({shorten(currency, 12) or 'ordinary poles'})"
        label = price if by_money else "sensors"
        axes.set(xlim=pad_limits(places), ylim=(0, 1.03), xlabel=label, ylabel="AP")
        marks = [
            Line2D([], [], color=INK, marker=marker, markerfacecolor=face, linestyle="none")
            for marker, face in (("o", BAR), ("o", "white"), ("x", INK))
        ]
        names = ["best of its budget", "no more than a cheaper one", "predicted by the search"]
        figure.legend(marks, names, loc="lower left", ncols=3, bbox_to_anchor=(0.07, 0.0))
        write_figure(figure, out)
