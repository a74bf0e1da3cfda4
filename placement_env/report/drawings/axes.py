"""Axes of the report's charts: rows of AP with intervals, and the figures that go beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from placement_env.report.content import CONFIDENCE, Judgement
from toolkit.plots.canvas import blank_figure, plain, shortened, svg_text
from toolkit.plots.palette import INK, SENSORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 7.0  # inches of a chart
ROW, HEAD, FOOT = 0.27, 0.7, 0.55  # inches of a row, and above and below them
LETTERS = 44  # of a row's name
BAR = SENSORS[7]
INTERVAL = f"lines: {CONFIDENCE:.0%} intervals"


def row_axes(title: str, said: str, names: Sequence[str], *, right: float = 1.7) -> tuple[Figure, Axes]:
    """A figure with a row for each name, the first on top; right: inches kept free beside them for figures."""
    names = [shortened(name, LETTERS) for name in names]
    left = 0.35 + 0.066 * max(map(len, names), default=0)
    height = HEAD + FOOT + ROW * max(len(names), 1)
    figure = blank_figure(WIDTH, height)
    share = (left / WIDTH, FOOT / height, (WIDTH - left - right) / WIDTH, ROW * max(len(names), 1) / height)
    axes = figure.add_axes(share)
    axes.set(ylim=(max(len(names), 1) - 0.5, -0.5))
    axes.set_yticks(range(len(names)), [""] * len(names))
    for label, name in zip(axes.get_yticklabels(), names, strict=True):
        label.set_text(name)
    axes.set_yticklabels(names)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    head_lines(figure, title, said)
    return figure, axes


def head_lines(figure: Figure, title: str, said: str) -> None:
    """Title and a line below it, at the top left of a chart."""
    _, height = figure.get_size_inches()
    figure.text(0.015, 1 - 0.22 / height, shortened(title, 88), fontsize=11, fontweight="bold", va="center")
    figure.text(0.015, 1 - 0.47 / height, plain(said), fontsize=8.5, va="center")


def draw_intervals(axes: Axes, judged: Sequence[Judgement | None], *, hatched: Sequence[bool] = ()) -> None:
    """A bar for each AP with its interval as a line, and its figures to the right of the axes."""
    axes.set(xlim=(0, 1), xlabel="AP")
    for row, each in enumerate(judged):
        if each is None:
            axes.text(0.01, row, "not judged: no vehicles", va="center", fontsize=7.5)
            continue
        hatch = "////" if row < len(hatched) and hatched[row] else None
        face = "white" if hatch else BAR
        axes.barh(row, each.ap, height=0.62, facecolor=face, edgecolor=BAR, hatch=hatch, linewidth=1.0, zorder=2)
        draw_interval(axes, each, row)
        beside(axes, row, ap_words(each))


def draw_interval(axes: Axes, judged: Judgement, row: int) -> None:
    """The interval of an AP, lying at a row, with a cross line at its ends."""
    axes.plot([judged.low, judged.high], [row, row], color="white", linewidth=3.4, zorder=3, solid_capstyle="butt")
    axes.plot([judged.low, judged.high], [row, row], "|-", color=INK, linewidth=1.4, markersize=7, zorder=3.1)


def beside(axes: Axes, row: int, text: str) -> None:
    """Text right of the axes at a row."""
    axes.annotate(
        text, (1, row), xycoords=("axes fraction", "data"), xytext=(8, 0), textcoords="offset points",
        va="center", fontsize=7.5, annotation_clip=False,
    )  # fmt: skip


def ap_words(judged: Judgement) -> str:
    """AP and the number of vehicles.

    >>> ap_words(Judgement(0.912, 0.88, 0.94, 0.95, 0.97, 120, 40))
    '0.912, N = 120'
    """
    return f"{judged.ap:.3f}, N = {judged.vehicles}"


def counted_words(judged: Sequence[Judgement | None]) -> str:
    """How many vehicles and frames the figures come from, the greatest of them."""
    some = [each for each in judged if each is not None]
    if not some:
        return "no vehicles were judged"
    vehicles, frames = max(each.vehicles for each in some), max(each.frames for each in some)
    up_to = "up to " if len({(each.vehicles, each.frames) for each in some}) > 1 else ""
    return f"judged by the detector, N = {up_to}{vehicles} {some[0].kind}s in {frames} frames; {INTERVAL}"


def price_words(currency: str) -> str:
    """The unit of prices.

    >>> price_words("EUR"), price_words("")
    ('price (EUR)', 'price (ordinary poles)')
    """
    return f"price ({shortened(currency, 12)})" if currency else "price (ordinary poles)"


def chart_text(figure: Figure, title: str) -> str:
    """The chart as SVG text."""
    return svg_text(figure, title)


def set_words(names: Sequence[str]) -> str:
    """Sensors of a set in a few letters.

    >>> set_words(["d0", "d1"]), set_words([])
    ('d0, d1', 'none')
    """
    return shortened(", ".join(names) or "none", LETTERS)


def padded_limits(values: Sequence[float], least: float = 0.0) -> tuple[float, float]:
    """Limits of an axis that begin at 0 and leave room above the greatest value.

    >>> padded_limits([2.0, 4.0]), padded_limits([])
    ((0.0, 4.4), (0.0, 1.0))
    """
    most = max(float(np.max(values)) if len(values) else 0.0, least)
    return 0.0, 1.1 * most if most > 0 else 1.0
