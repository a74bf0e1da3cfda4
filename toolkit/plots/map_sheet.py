"""Sheet of a map from above, under its title, without sensors.

The strip below the map holds scale bar, north arrow and legend, so that they do not cover
the map."""

from collections.abc import Sequence
from math import ceil, floor, log10
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.plots.canvas import add_legend, blank_figure, replace_unprintable
from toolkit.plots.ground_map import draw_ground, draw_streets
from toolkit.plots.line_style import Entry, PlotStyle
from toolkit.plots.north_arrow import draw_north, north
from toolkit.plots.palette import INK
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAP_MARGIN_M = 10.0  # around the area
MAX_MAP_INCHES = 10.0  # longer side of the map
# inches around the map, and of a row of the legend
LEFT = 0.62
RIGHT = 0.2
HEAD = 0.62
AXIS = 0.5
LEGEND_ROW = 0.22
SCALE_WIDTH = 2.6  # inches of scale bar and north arrow


class MapSheet(NamedTuple):
    """Figure with the axes of a map.

    axes: coordinates in m, site frame; points_per_metre: scale, in points of 1/72 inch."""

    figure: "Figure"
    axes: "Axes"
    points_per_metre: float


def map_sheet(
    site: Site,
    title: str,
    subtitle: str = "",
    *,
    holds: Float[np.ndarray, "n 2"] | None = None,
    legend: Sequence[Entry] = (),
    inches: float = MAX_MAP_INCHES,
) -> MapSheet:
    """Draw the site from above under its title, without sensors.

    holds: x and y (m) of places that the map must include in addition to the area, None without;
    legend: entries of the legend, in order; inches: longer side of the map."""
    low, high = extent(site, holds)
    # all sizes are in inches from here on; the sheet is HEAD, map and strip from top to bottom
    scale = inches / float((high - low).max())
    width, height = ((high - low) * scale).tolist()
    full_width = max(width + LEFT + RIGHT, 6.5)
    inner_width = full_width - LEFT - RIGHT
    columns = _count_columns(legend, inner_width)
    strip = AXIS + max(0.55, LEGEND_ROW * ceil(len(legend) / columns) + 0.1)
    total = HEAD + height + strip
    figure = blank_figure(full_width, total)

    def add_part(left: float, bottom: float, width: float, height: float) -> "Axes":  # inches
        return figure.add_axes(
            (left / full_width, bottom / total, width / full_width, height / total)
        )

    axes = add_part(LEFT + (inner_width - width) / 2, strip, width, height)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)")
    for spine in axes.spines.values():
        spine.set_visible(True)
    draw_ground(axes, site)
    draw_streets(axes, site, low, high)
    draw_area(axes, site.area)
    left = LEFT / full_width
    heading: PlotStyle = {"fontsize": 12, "fontweight": "bold", "va": "center"}
    figure.text(left, 1 - 0.26 / total, replace_unprintable(title), **heading)
    figure.text(left, 1 - 0.48 / total, replace_unprintable(subtitle), fontsize=9, va="center")
    below = add_part(LEFT, bottom=0.05, width=inner_width, height=strip - AXIS - 0.05)
    below.set_axis_off()
    below.set(xlim=(0, inner_width), ylim=(-(strip - AXIS - 0.05), 0))
    _draw_scale(below, scale_length(min(1.6, width) / scale), scale)
    draw_north(below, (2.2, -0.25), north(site))
    if legend:
        _draw_legend(below, legend, columns)
    return MapSheet(figure, axes, 72 * scale)


def _count_columns(legend: Sequence[Entry], inner: float) -> int:
    """Number of columns of a legend in the strip below a map, at least 1.

    inner: width of the strip (inches), which scale bar and arrow share with the legend."""
    max_letters = max((len(label) for _, label in legend), default=1)
    # estimated inches of a letter, and of a mark with the gaps around it
    column_inches = 0.058 * max_letters + 0.58
    return max(1, min(len(legend), int((inner - SCALE_WIDTH) / column_inches)))


def _draw_scale(axes: "Axes", length: float, scale: float) -> None:
    """Draw a scale bar of two halves, with labels below.

    axes: axes in inches; length: length of the bar (m); scale: inches per metre."""
    # shares of the bar at which its halves begin, and their colours
    for start, colour in ((0.0, INK), (0.5, "white")):
        left = start * length * scale
        right = (start + 0.5) * length * scale
        x = [left, right, right, left]
        y = [-0.2, -0.2, -0.12, -0.12]  # below the map
        axes.fill(x, y, facecolor=colour, edgecolor=INK, linewidth=0.8)
    axes.text(0.0, -0.25, "0", ha="left", va="top", fontsize=8)
    axes.text(length * scale, -0.25, f"{length:g} m", ha="center", va="top", fontsize=8)


def _draw_legend(axes: "Axes", legend: Sequence[Entry], columns: int) -> None:
    """Draw the legend right of the scale bar, in some columns; axes: axes in inches."""
    style: PlotStyle = {
        "bbox_to_anchor": (SCALE_WIDTH, 0.0),
        "bbox_transform": axes.transData,
        "loc": "upper left",
        "borderaxespad": 0.0,
        "columnspacing": 1.4,
        "handlelength": 2.8,
    }
    handles, labels = zip(*legend, strict=True)
    add_legend(
        axes, handles, [replace_unprintable(label) for label in labels], ncols=columns, **style
    )


def draw_area(axes: "Axes", area: Float64[np.ndarray, "4"]) -> None:
    """Draw the outline of the detection area; area: xmin, ymin, xmax, ymax (m)."""
    xmin, ymin, xmax, ymax = area
    outline = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax], [xmin, ymin]])
    axes.plot(*outline.T, color=INK, linewidth=1.1, dashes=(8, 2, 2, 2), zorder=2.0)


def extent(
    site: Site, holds: Float[np.ndarray, "n 2"] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corners (x and y, m) of a map, with a margin.

    The map includes the site's area and, with half the margin, the places that it must hold.

    holds: x and y (m) of the places, None without."""
    # the area is xmin, ymin, xmax, ymax
    low = site.area[:2] - MAP_MARGIN_M
    high = site.area[2:] + MAP_MARGIN_M
    if holds is not None and len(holds):
        low = np.minimum(low, holds.min(axis=0) - MAP_MARGIN_M / 2)
        high = np.maximum(high, holds.max(axis=0) + MAP_MARGIN_M / 2)
    return low, high


def scale_length(metres: float) -> float:
    """Largest round length (m) up to a given one: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** floor(log10(metres))
    max_length = metres * (1 + 1e-9)  # lets a round length itself pass in spite of rounding
    return next(round(step * power, 9) for step in (5, 2, 1) if step * power <= max_length)
