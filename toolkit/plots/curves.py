"""Curves: precision over recall, points on objects, and training progress."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float, Int
from toolkit.plots.canvas import (
    add_legend,
    blank_figure,
    house_style,
    replace_unprintable,
    shorten,
    write_figure,
)
from toolkit.plots.line_style import PlotStyle
from toolkit.plots.palette import LINES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEGEND_ROW_INCHES = 0.19
MAX_LINEAR_POINTS = 100.0  # points on an object; the axis is linear up to here
# x and y of curves, by name
_Curves = Mapping[str, tuple[Sequence[float] | np.ndarray, Sequence[float] | np.ndarray]]


def draw_pr_curves(
    curves: Mapping[str, tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]],
    out: Path | str,
    *,
    title: str = "",
) -> None:
    """Draw precision over recall.

    curves: recall and precision of each curve, by its name in the legend; out: picture to write,
    PNG or SVG by its suffix; title: "" for a usual one."""
    look: PlotStyle = {
        "xlabel": "recall",
        "ylabel": "precision",
        "xlim": (0, 1.01),
        "ylim": (0, 1.01),
    }
    _draw_curves(curves, out, title=title or "Precision over recall", look=look)


def _draw_curves(
    curves: _Curves, out: Path | str, *, title: str, look: PlotStyle, marker: str = ""
) -> None:
    """Write a picture of curves with a legend.

    curves: x and y of each curve, by its name; look: properties of the axes, for matplotlib;
    marker: mark at each point, "" without."""
    with house_style():
        figure, axes = curve_axes(title, len(curves))
        for number, (x, y) in enumerate(curves.values()):
            colour, dashes = LINES[number % len(LINES)]
            axes.plot(x, y, color=colour, linestyle=dashes, marker=marker, markersize=4)
        axes.set(**look)
        name_curves(axes, list(curves))
        write_figure(figure, out)


def draw_density_cdf(
    counts: Mapping[str, Int[np.ndarray, " _"]], out: Path | str, *, title: str = ""
) -> None:
    """Draw the share of objects with at most so many points, a curve for each sensor set.

    counts: number of points on each object, by the name of the set; out: picture to write, PNG or
    SVG by its suffix; title: "" for a usual one. As in the paper (impact of point density). The
    axis is linear up to `MAX_LINEAR_POINTS` points and logarithmic beyond."""
    with house_style():
        figure, axes = curve_axes(title or "Points on an object", len(counts))
        for number, points in enumerate(counts.values()):
            sorted_points = np.concatenate([[0], np.sort(points)])
            share = np.arange(len(sorted_points)) / max(len(points), 1)
            colour, dashes = LINES[number % len(LINES)]
            axes.step(sorted_points, share, where="post", color=colour, linestyle=dashes)
        max_points = max(
            (int(points.max()) for points in counts.values() if len(points)), default=0
        )
        axes.set_xscale("symlog", linthresh=MAX_LINEAR_POINTS, linscale=1.5)
        ticks = _place_ticks(max_points)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set(xlabel="points on the object", ylabel="share of objects", ylim=(0, 1.01))
        axes.set_xlim(0, max(1.1 * max_points, MAX_LINEAR_POINTS))
        name_curves(axes, [f"{name} (N = {len(points)})" for name, points in counts.items()])
        write_figure(figure, out)


def _place_ticks(max_points: int) -> list[float]:
    """Return the ticks of an axis that is linear up to `MAX_LINEAR_POINTS`, logarithmic beyond.

    max_points: largest value; ticks go up to a twentieth above it."""
    linear_ticks = [float(tick) for tick in range(0, int(MAX_LINEAR_POINTS), 20)]
    round_numbers = [1.0 * step * 10**power for power in range(2, 7) for step in (1, 2, 5)]
    log_ticks = [
        tick for tick in round_numbers if tick <= 1.05 * max_points or tick == MAX_LINEAR_POINTS
    ]
    return [*linear_ticks, *log_ticks]


def draw_training(
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]], out: Path | str
) -> None:
    """Draw the curves of a training as losses.png, and ap.png if AP was measured.

    curves: epochs and values of each curve, by name; names that begin with "AP" are APs, all others
    losses; out: folder for the pictures."""
    folder = Path(out)
    losses = {name: curve for name, curve in curves.items() if not name.startswith("AP")}
    aps = {name: curve for name, curve in curves.items() if name.startswith("AP")}
    if losses:
        look: PlotStyle = {"xlabel": "epoch", "ylabel": "loss", "yscale": "log"}
        _draw_curves(losses, folder / "losses.png", title="Losses of training", look=look)
    if aps:
        look = {"xlabel": "epoch", "ylabel": "AP", "yscale": "linear"}
        _draw_curves(aps, folder / "ap.png", title="AP of validation", look=look, marker="o")


def curve_axes(title: str, curves: int) -> "tuple[Figure, Axes]":
    """Figure with one axes, and room for a legend below them.

    curves: number of curves; each has a row in the legend."""
    figure = blank_figure(6.0, 4.2 + LEGEND_ROW_INCHES * curves, constrained=True)
    axes = figure.subplots()
    axes.set_title(replace_unprintable(title), loc="left", fontweight="bold")
    axes.grid()
    return figure, axes


def name_curves(axes: "Axes", names: Sequence[str]) -> None:
    """Name the first lines of the axes, in the order drawn, in a legend below them."""
    if names:
        labels = [shorten(name, 80) for name in names]
        lines = axes.get_lines()[: len(names)]
        add_legend(axes.figure, lines, labels, loc="outside lower left", handlelength=3.4)
