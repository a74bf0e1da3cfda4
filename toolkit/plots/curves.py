"""Curves: precision, point density and training progress.

Precision is drawn over recall, and density is points on objects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float, Int
from toolkit.plots.canvas import blank_figure, house_style, plain, shorten, write_figure
from toolkit.plots.palette import LINES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROW = 0.19  # inches of a row of the legend
FEW = 100.0  # points on an object; the axis is linear up to here


def draw_pr_curves(
    curves: Mapping[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]], out: Path | str, *, title: str = ""
) -> None:
    """Draw precision over recall. curves: maps a legend entry to (recall, precision)."""
    with house_style():
        figure, axes = curve_axes(title or "Precision over recall", len(curves))
        for number, (recall, precision) in enumerate(curves.values()):
            colour, dashes = LINES[number % len(LINES)]
            axes.plot(recall, precision, color=colour, linestyle=dashes)
        axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.01), ylim=(0, 1.01))
        name_curves(axes, list(curves))
        write_figure(figure, out)


def draw_density_cdf(counts: Mapping[str, Int[np.ndarray, " _"]], out: Path | str, *, title: str = "") -> None:
    """Draw the share of objects over their points.

    There is one cumulative curve for each sensor set (paper, impact of point density).

    The axis is linear up to `FEW` points and logarithmic beyond.
    """
    with house_style():
        figure, axes = curve_axes(title or "Points on an object", len(counts))
        for number, points in enumerate(counts.values()):
            ordered = np.concatenate([[0], np.sort(points)])
            share = np.arange(len(ordered)) / max(len(points), 1)
            colour, dashes = LINES[number % len(LINES)]
            axes.step(ordered, share, where="post", color=colour, linestyle=dashes)
        most = max((int(points.max()) for points in counts.values() if len(points)), default=0)
        axes.set_xscale("symlog", linthresh=FEW, linscale=1.5)
        beyond = [1.0 * step * 10**power for power in range(2, 7) for step in (1, 2, 5)]
        ticks = [*range(0, int(FEW), 20), *(tick for tick in beyond if tick <= 1.05 * most or tick == FEW)]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set(xlabel="points on the object", ylabel="share of objects", ylim=(0, 1.01))
        axes.set_xlim(0, max(1.1 * most, FEW))
        name_curves(axes, [f"{name} (N = {len(points)})" for name, points in counts.items()])
        write_figure(figure, out)


def draw_training(curves: Mapping[str, tuple[Sequence[float], Sequence[float]]], out: Path | str) -> None:
    """Draw the losses and AP of a training. The files are losses.png, and ap.png if AP was measured. curves: name ->
    (epochs, values)."""
    for picture, measured in (("losses.png", False), ("ap.png", True)):
        chosen = {name: curve for name, curve in curves.items() if name.startswith("AP") == measured}
        if not chosen:
            continue
        with house_style():
            figure, axes = curve_axes("AP of validation" if measured else "Losses of training", len(chosen))
            for number, (epochs, values) in enumerate(chosen.values()):
                colour, dashes = LINES[number % len(LINES)]
                axes.plot(
                    epochs, values, color=colour, linestyle=dashes, marker="o" if measured else None, markersize=4
                )
            axes.set(xlabel="epoch", ylabel="AP" if measured else "loss", yscale="linear" if measured else "log")
            name_curves(axes, list(chosen))
            write_figure(figure, Path(out) / picture)


def curve_axes(title: str, curves: int) -> tuple[Figure, Axes]:
    """Figure with one axes and room for a legend. The legend is below the axes, with a row for each curve."""
    figure = blank_figure(6.0, 4.2 + _ROW * curves, constrained=True)
    axes = figure.subplots()
    axes.set_title(plain(title), loc="left", fontweight="bold")
    axes.grid()
    return figure, axes


def name_curves(axes: Axes, names: Sequence[str]) -> None:
    """Name the lines of the axes in a legend below. There it covers none of them."""
    if not names:
        return
    lines = axes.get_lines()[: len(names)]
    legend = axes.figure.legend(lines, [str(k) for k in range(len(names))], loc="outside lower left", handlelength=3.4)
    for text, name in zip(legend.get_texts(), names, strict=True):
        text.set_text(shorten(name, 80))  # the call above would drop names that begin with "_"
