"""One frame of a recording as a picture from above.

It shows points in one colouring, boxes and their outcomes, and sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.plots.base_map import draw_outcome
from toolkit.plots.canvas import blank_figure, house_style, shorten, write_figure
from toolkit.plots.palette import FAINT, INK, OUTCOME, Outcome, sensor_colour
from toolkit.viewing.drawn import MARKED, Colouring, DrawnSample, Scales, find_newest, shades, thinned
from toolkit.viewing.recording_scene import find_view_area

STILL_POINTS = 200_000  # of a cloud
_INCHES = 9.0  # of the greater side of the map
_POINT_SIZE = 1.0  # square points of 1/72 inch
_GRID = 10.0  # m


def write_still(
    sample: DrawnSample,
    out: str | Path,
    *,
    title: str = "",
    colouring: Colouring = "sensor",
    sensors: Sequence[str] = (),
    half: tuple[float, float] | None = None,
) -> None:
    """Write a frame as a picture. It is PNG or SVG by the ending, with the same bytes each time. colouring: of points;
    sensors: names in the order of their colours, the frame's own when empty; half: half of the sides (m) of what is
    shown about the origin, where most points are when None."""
    xmin, ymin, xmax, ymax = find_view_area(sample) if half is None else (-half[0], -half[1], *half)
    width, height = xmax - xmin, ymax - ymin
    scale = _INCHES / max(width, height)
    scales = Scales.of(sample)
    order = list(sensors or dict.fromkeys(cloud.name for cloud in sample.clouds))
    with house_style():
        figure = blank_figure(width * scale + 1.2, height * scale + 2.0, constrained=True)
        axes = figure.add_subplot()
        axes.set(xlim=(xmin, xmax), ylim=(ymin, ymax), aspect="equal", xlabel="x (m)", ylabel="y (m)")
        axes.set_xticks(_GRID * np.arange(np.ceil(xmin / _GRID), xmax // _GRID + 1))
        axes.set_yticks(_GRID * np.arange(np.ceil(ymin / _GRID), ymax // _GRID + 1))
        axes.grid(True)
        _draw_points(axes, sample, colouring, scales, order)
        shown = _drawn_boxes(axes, sample)
        for cloud in sample.clouds:
            colour = sensor_colour(order.index(cloud.name))
            axes.plot(*cloud.place[:2], "s", color=colour, markersize=8, markeredgecolor=INK, zorder=6, clip_on=True)
        figure.suptitle(shorten(title or sample.name, 90), fontsize=11.0)
        said = f"{sample.describe()}; points by {scales.describe(colouring)}"
        axes.set_title(shorten(said, 130), fontsize=7.5)
        entries = [*shown, *_sensor_entries(order)]
        if entries:
            figure.legend(*zip(*entries, strict=True), loc="outside lower center", ncols=4)
        write_figure(figure, out)


def _draw_points(axes: Any, sample: DrawnSample, colouring: Colouring, scales: Scales, order: list[str]) -> None:
    newest = find_newest(sample)
    for each in sample.clouds:
        cloud = thinned(each, STILL_POINTS)
        colours = shades(cloud, colouring, scales, index=order.index(cloud.name), newest=newest) / 255.0
        axes.scatter(*cloud.points[:, :2].T, s=_POINT_SIZE, c=colours, linewidths=0, rasterized=True, zorder=3)


def _drawn_boxes(axes: Any, sample: DrawnSample) -> list[tuple[Any, str]]:
    """Draw the boxes; return their legend entries. The entries say how many there are."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from toolkit.boxes import footprints

    labelled = _all(sample.truth)
    for corners in footprints(labelled):
        axes.fill(*corners.T, facecolor="none", edgecolor=FAINT, linewidth=1.0, zorder=3.6)
    entries: list[tuple[Any, str]] = []
    if len(labelled):
        entries.append((Patch(facecolor="none", edgecolor=FAINT), f"labelled ({len(labelled)})"))
    rows: dict[Outcome, np.ndarray] = {MARKED[name]: _all(boxes) for name, boxes in sample.outcomes.items()}
    if not rows and sample.detections:
        rows = {"detection": _all(sample.detections)}
    for outcome, boxes in rows.items():
        draw_outcome(axes, boxes, outcome)
        style = OUTCOME[outcome]
        mark: dict[str, Any] = {"marker": style.marker, "markersize": 0.8 * style.size, "markeredgecolor": "white"}
        line = Line2D([], [], color=style.colour, linestyle=style.line, linewidth=style.width, **mark)
        entries.append((line, f"{outcome} ({len(boxes)})"))
    return entries


def _sensor_entries(names: Sequence[str]) -> list[tuple[Any, str]]:
    from matplotlib.lines import Line2D

    style: dict[str, Any] = {"marker": "s", "markersize": 7, "markeredgecolor": INK, "linestyle": "none"}
    return [(Line2D([], [], color=sensor_colour(k), **style), shorten(name, 30)) for k, name in enumerate(names)]


def _all(boxes: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros((0, 7)), *boxes.values()])
