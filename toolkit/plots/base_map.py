"""The sheet that plans are drawn on: streets, solids and area from above, title, scale bar, north arrow and legend.

The strip below the map holds scale bar, north arrow and legend, so that none of them ever lies over what is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, log10
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.plots.canvas import blank_figure, plain
from toolkit.plots.palette import GROUND, INK, OTHER_SOLID, SOLID

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from toolkit.sites.site import Site

AROUND = 10.0  # m round the area
MOST_INCHES = 10.0  # of the map, either way
LEFT, RIGHT, HEAD, AXIS, LEGEND_ROW = 0.62, 0.2, 0.62, 0.5, 0.22  # inches round the map, and of a row of the legend
SCALE_WIDTH = 2.6  # inches that scale bar and north arrow take

Entry = tuple[Any, str]  # of a legend: what it shows, an artist of matplotlib, and its name


class MapSheet(NamedTuple):
    """A figure, its map in metres of the site, and how many points of 1/72 inch a metre is."""

    figure: Figure
    axes: Axes
    points_per_metre: float


def map_sheet(
    site: Site,
    title: str,
    subtitle: str = "",
    *,
    holds: Float[np.ndarray, "n 2"] | None = None,
    legend: Sequence[Entry] = (),
    inches: float = MOST_INCHES,
) -> MapSheet:
    """The site from above under its title, with everything but sensors. holds: places that the map must reach besides
    the area; legend: its entries, in order; inches: the greater side of the map."""
    low, high = extent(site, holds)
    scale = inches / float((high - low).max())
    width, height = ((high - low) * scale).tolist()
    full = max(width + LEFT + RIGHT, 6.5)
    columns, rows = _legend_grid([label for _, label in legend], full - LEFT - RIGHT - SCALE_WIDTH)
    strip = AXIS + max(0.55, LEGEND_ROW * rows + 0.1)
    figure = blank_figure(full, HEAD + height + strip)
    left = LEFT + (full - LEFT - RIGHT - width) / 2
    axes = _part(figure, left, strip, width, height)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)")
    for spine in axes.spines.values():
        spine.set_visible(True)
    draw_ground(axes, site)
    draw_area(axes, site.area)
    _titles(figure, title, subtitle, full)
    below = _part(figure, LEFT, 0.05, full - LEFT - RIGHT, strip - AXIS - 0.05)
    below.set_axis_off()
    below.set(xlim=(0, full - LEFT - RIGHT), ylim=(-(strip - AXIS - 0.05), 0))
    _scale_bar(below, scale, width)
    draw_north(below, (2.2, -0.25), north(site))
    _legend(below, legend, columns)
    return MapSheet(figure, axes, 72 * scale)


def draw_ground(axes: Axes, site: Site) -> None:
    """Lanes, footways and solids, seen from above."""
    for kind, colour in GROUND.items():
        fill_polygons(axes, [shapely.Polygon(polygon) for polygon in getattr(site, kind)], colour, order=1.0)
    by_kind: dict[str, list[shapely.Polygon]] = {kind: [] for kind in ("other", *SOLID)}
    for solid in site.solids:
        by_kind[solid.kind if solid.kind in SOLID else "other"].append(shapely.Polygon(solid.footprint))
    for rank, (kind, shapes) in enumerate(by_kind.items()):
        fill_polygons(axes, shapes, SOLID.get(kind, OTHER_SOLID), order=1.5 + 0.01 * rank)


def fill_polygons(
    axes: Axes, shapes: Sequence[shapely.Geometry], colour: str, *, order: float, alpha: float = 1.0, edge: float = 0.4
) -> None:
    """The union of polygons, holes and all, in one colour; edge: width of its outline in points of 1/72 inch."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    parts = [part for part in shapely.get_parts(shapely.union_all(list(shapes))) if part.geom_type == "Polygon"]
    turned = [shapely.geometry.polygon.orient(part) for part in parts]
    rings = [ring for part in turned for ring in (part.exterior, *part.interiors)]  # holes run the other way round
    if not rings:
        return
    outline = Path.make_compound_path(*(Path(shapely.get_coordinates(ring), closed=True) for ring in rings))
    filled = to_rgba(colour, alpha)
    axes.add_patch(PathPatch(outline, facecolor=filled, edgecolor=colour, linewidth=edge, zorder=order))


def draw_area(axes: Axes, area: Float64[np.ndarray, "4"]) -> None:
    """The outline of the detection area."""
    xmin, ymin, xmax, ymax = area
    outline = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax], [xmin, ymin]])
    axes.plot(*outline.T, color=INK, linewidth=1.1, dashes=(8, 2, 2, 2), zorder=2.0)


def draw_north(axes: Axes, place: tuple[float, float], direction: Float64[np.ndarray, "2"]) -> None:
    """An arrow through a place of the axes that points north, with the letter at its tip."""
    from matplotlib.transforms import ScaledTranslation

    def away(points: float) -> Any:
        x, y = direction * points / 72
        return axes.transData + ScaledTranslation(x, y, axes.figure.dpi_scale_trans)

    style = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 13}
    axes.annotate(
        "", xy=place, xycoords=away(11.0), xytext=place, textcoords=away(-11.0), arrowprops=style, zorder=9
    )  # fmt: skip
    axes.text(
        *place, "N", transform=away(17.0), ha="center", va="center", fontsize=9, fontweight="bold", zorder=9
    )  # fmt: skip


def north(site: Site) -> Float64[np.ndarray, "2"]:
    """Unit vector of the site's frame towards the north of its map, which is the map's +y."""
    towards = site.map_SE3_site[1, :2]
    length = float(np.hypot(*towards))
    return towards / length if length > 1e-9 else np.array([0.0, 1.0])


def extent(site: Site, holds: Float[np.ndarray, "n 2"] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner of what is drawn: the area and places with a margin."""
    low, high = site.area[:2] - AROUND, site.area[2:] + AROUND
    if holds is not None and len(holds):
        low, high = np.minimum(low, holds.min(axis=0) - AROUND / 2), np.maximum(high, holds.max(axis=0) + AROUND / 2)
    return low, high


def scale_length(metres: float) -> float:
    """The greatest 1, 2 or 5 times a power of ten that is not above so many metres.

    >>> [scale_length(m) for m in (0.3, 7.0, 19.9, 20.0, 99.0)]
    [0.2, 5.0, 10.0, 20.0, 50.0]
    """
    power = 10.0 ** floor(log10(metres))
    return next(round(step * power, 9) for step in (5, 2, 1) if step * power <= metres * (1 + 1e-9))


def _part(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Axes at inches of the figure."""
    full, high = figure.get_size_inches()
    return figure.add_axes((left / full, bottom / high, width / full, height / high))


def _titles(figure: Figure, title: str, subtitle: str, full: float) -> None:
    _, high = figure.get_size_inches()
    left = LEFT / full
    figure.text(left, 1 - 0.26 / high, plain(title), fontsize=12, fontweight="bold", va="center")
    figure.text(left, 1 - 0.48 / high, plain(subtitle), fontsize=9, va="center")


def _scale_bar(axes: Axes, scale: float, width: float) -> None:
    """A bar of two halves with its length, in an axes whose unit is the inch."""
    length = scale_length(min(1.6, width) / scale)
    inches = length * scale
    for part, colour in ((0.0, INK), (0.5, "white")):
        bar = [part * inches, (part + 0.5) * inches, (part + 0.5) * inches, part * inches]
        axes.fill(bar, [-0.2, -0.2, -0.12, -0.12], facecolor=colour, edgecolor=INK, linewidth=0.8)
    for share, label in ((0.0, "0"), (1.0, f"{length:g} m")):
        axes.text(share * inches, -0.25, label, ha="center" if share else "left", va="top", fontsize=8)


def _legend_grid(labels: Sequence[str], inches: float) -> tuple[int, int]:
    """Columns and rows of a legend that is so wide."""
    longest = max(map(len, labels), default=1)
    columns = max(1, min(len(labels), int(inches / (0.058 * longest + 0.58))))
    return columns, ceil(len(labels) / columns)


def _legend(axes: Axes, legend: Sequence[Entry], columns: int) -> None:
    if not legend:
        return
    handles = [handle for handle, _ in legend]
    shown = axes.legend(
        handles, [str(k) for k in range(len(legend))], ncols=columns, loc="upper left", borderaxespad=0.0,
        bbox_to_anchor=(SCALE_WIDTH, 0.0), bbox_transform=axes.transData, columnspacing=1.4, handlelength=2.8,
    )  # fmt: skip
    for text, (_, label) in zip(shown.get_texts(), legend, strict=True):
        text.set_text(plain(label))  # not by the call above, which drops names that begin with "_"
