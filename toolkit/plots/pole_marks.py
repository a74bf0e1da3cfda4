"""Poles on a map, and their names."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from toolkit.plots import palette
from toolkit.plots.canvas import shorten
from toolkit.plots.line_style import Entry, PlotStyle
from toolkit.plots.palette import PAPER_WHITE
from toolkit.plots.sensor_marks import DISC_POINTS, MapPlaces

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class _MapBox(NamedTuple):
    """Rectangle on a map, in points (1/72 inch)."""

    left: float
    bottom: float
    right: float
    top: float


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
    occupied_boxes = []
    for x, y in places * points_per_metre:
        occupied_boxes.append(_MapBox(left=x - 4, bottom=y - 4, right=x + 4, top=y + 4))
    half = DISC_POINTS / 2 + 1  # half the side of the room that a sensor takes
    for x, y in keep_off * points_per_metre:
        occupied_boxes.append(_MapBox(left=x - half, bottom=y - half, right=x + half, top=y + half))
    for place, name in zip(places, names, strict=True):
        text = shorten(name, 14)
        # size of the text in points, estimated from its font size
        width = 3.9 * len(text) + 1
        height = 7.5
        x, y = place * points_per_metre
        # lower left corner of the text right of the pole, left, above, below
        spots = [
            (x + 5, y - 3.5),
            (x - width - 5, y - 3.5),
            (x - width / 2, y + 5),
            (x - width / 2, y - 12.5),
        ]
        boxes = [
            _MapBox(left, bottom, right=left + width, top=bottom + height) for left, bottom in spots
        ]
        free_box = next((box for box in boxes if not _overlaps_any(box, occupied_boxes)), None)
        if free_box is not None:
            occupied_boxes.append(free_box)
            left = free_box.left / points_per_metre
            bottom = free_box.bottom / points_per_metre
            axes.text(left, bottom, text, fontsize=6.5, va="bottom", zorder=5.5)


def _overlaps_any(box: _MapBox, obstacles: Sequence[_MapBox]) -> bool:
    return any(_share_area(box, obstacle) for obstacle in obstacles)


def _share_area(first: _MapBox, second: _MapBox) -> bool:
    """Return True if two boxes overlap, False if they only touch."""
    return bool(
        first.left < second.right
        and second.left < first.right
        and first.bottom < second.top
        and second.bottom < first.top
    )


def pole_style(carries_sensor: bool) -> PlotStyle:
    """Properties, for matplotlib, of the square that marks a pole; filled with a sensor."""
    return {
        "marker": "s",
        "markersize": 6.0,
        "markeredgecolor": palette.POLE_INK,
        "markeredgewidth": 1.3,
        "markerfacecolor": palette.POLE_INK if carries_sensor else PAPER_WHITE,
        "linestyle": "none",
    }


def pole_entries(*, used: int = 0, unused: int = 0) -> list[Entry]:
    """Legend entries of poles, with their numbers; a kind without poles has no entry.

    used, unused: numbers of poles with and without a sensor."""
    from matplotlib.lines import Line2D

    entries: list[Entry] = []
    if used:
        mark = Line2D([], [], **pole_style(carries_sensor=True))
        entries.append((mark, f"pole with a sensor ({used})"))
    if unused:
        name = "pole without a sensor" if used else "pole"
        mark = Line2D([], [], **pole_style(carries_sensor=False))
        entries.append((mark, f"{name} ({unused})"))
    return entries
