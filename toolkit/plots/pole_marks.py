"""Poles on a map, and their names."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from toolkit.plots import palette
from toolkit.plots.canvas import shorten
from toolkit.plots.line_style import Entry, PlotStyle
from toolkit.plots.palette import PAPER_WHITE
from toolkit.plots.sensor_marks import DISC, MapPlaces

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_poles(
    axes: "Axes", places: MapPlaces, *, carries_sensor: bool = False, size: float = 6.0
) -> None:
    """Draw poles as squares, filled if they carry a sensor.

    places: x and y (m) of each pole; size: side of a square in points (1/72 inch)."""
    axes.plot(*places.T, zorder=5, **{**pole_style(carries_sensor), "markersize": size})


def name_poles(
    axes: "Axes",
    places: MapPlaces,
    names: Sequence[str],
    points_per_metre: float,
    keep_off: MapPlaces,
) -> None:
    """Write names next to poles; a name without room is left out.

    places: x and y (m) of each pole; points_per_metre: scale of the map, in points of 1/72 inch;
    keep_off: x and y (m) of sensors, which take room as poles and other names do."""
    # all boxes are left, bottom, right, top in points; poles take 4 points to every side
    around = [(place * points_per_metre, 4.0) for place in places]
    around += [(place * points_per_metre, DISC / 2 + 1) for place in keep_off]
    occupied = [(*(place - half), *(place + half)) for place, half in around]
    for place, name in zip(places, names, strict=True):
        text = shorten(name, 14)
        width, height = 3.9 * len(text) + 1, 7.5  # of the text, estimated from its font size
        x, y = place * points_per_metre
        # right of the pole, left, above, below
        spots = [
            (x + 5, y - 3.5),
            (x - width - 5, y - 3.5),
            (x - width / 2, y + 5),
            (x - width / 2, y - 12.5),
        ]
        boxes = [(left, low, left + width, low + height) for left, low in spots]
        free = next((box for box in boxes if not _hits_any(box, occupied)), None)
        if free is not None:
            occupied.append(free)
            left, low = np.array(free[:2]) / points_per_metre
            axes.text(left, low, text, fontsize=6.5, va="bottom", zorder=5.5)


def _hits_any(box: tuple[float, ...], obstacles: Sequence[tuple[float, ...]]) -> bool:
    # Boxes are left, bottom, right, top.
    return any(_overlap(box, obstacle) for obstacle in obstacles)


def _overlap(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    # True if two boxes (left, bottom, right, top) share some area.
    return bool(
        first[0] < second[2]
        and second[0] < first[2]
        and first[1] < second[3]
        and second[1] < first[3]
    )


def pole_style(carries_sensor: bool) -> PlotStyle:
    """Properties, for matplotlib, of the square that marks a pole."""
    edge: PlotStyle = {
        "marker": "s",
        "markersize": 6.0,
        "markeredgecolor": palette.POLE_INK,
        "markeredgewidth": 1.3,
    }
    return edge | {
        "markerfacecolor": palette.POLE_INK if carries_sensor else PAPER_WHITE,
        "linestyle": "none",
    }


def pole_entries(*, used: int = 0, unused: int = 0) -> list[Entry]:
    """Legend entries of poles, with their numbers; a kind without poles has no entry.

    used, unused: numbers of poles with and without a sensor."""
    from matplotlib.lines import Line2D

    kinds = (
        (used, True, "pole with a sensor"),
        (unused, False, "pole without a sensor" if used else "pole"),
    )
    return [
        (Line2D([], [], **pole_style(filled)), f"{name} ({count})")
        for count, filled, name in kinds
        if count
    ]
