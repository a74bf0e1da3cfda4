"""Objects and outcomes on a map.

An object is filled by its class. Each outcome has a line as well as a colour: a hit is solid, a
miss dashed with a cross, a false alarm dash-dotted with a triangle, an object that does not count
dotted."""

from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Shaped
from toolkit.boxes import footprints
from toolkit.objects import LABELS, Objects
from toolkit.plots.line_style import Entry, Outcome, PlotStyle
from toolkit.plots.palette import CLASS, INK, OUTCOME, PAPER_WHITE

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_objects(axes: "Axes", objects: Objects) -> None:
    """Draw the footprints of boxes, filled in the colours of their classes."""
    for label, name in enumerate(LABELS):
        class_boxes = objects.boxes[objects.labels == label]
        for corners in footprints(class_boxes):
            axes.fill(*corners.T, facecolor=CLASS[name], edgecolor=INK, linewidth=0.5, zorder=2.6)


def draw_outcome(axes: "Axes", boxes: Shaped[np.ndarray, "n 7"], outcome: Outcome) -> None:
    """Draw boxes of one outcome: outline, a line from centre to front, and the outcome's mark.

    boxes: rows of x, y, z, length, width, height (m), yaw (rad)."""
    style = OUTCOME[outcome]
    line: PlotStyle = {
        "color": style.colour,
        "linestyle": style.line,
        "linewidth": style.width,
        "zorder": style.order,
    }
    yaws = boxes[:, 6]
    for corners, yaw in zip(footprints(boxes), yaws, strict=True):
        centre = corners.mean(axis=0)
        direction = np.array([np.cos(yaw), np.sin(yaw)])
        # nine tenths of the distance to a corner
        front = centre + direction * np.linalg.norm(corners[0] - centre) * 0.9
        closed_outline = np.vstack([corners, corners[:1]])
        axes.plot(*closed_outline.T, **line)
        axes.plot(
            *np.vstack([centre, front]).T, color=style.colour, linewidth=0.8, zorder=style.order
        )
    if style.marker and len(boxes):
        mark: PlotStyle = {
            "markerfacecolor": style.colour,
            "markeredgecolor": PAPER_WHITE,
            "markeredgewidth": 0.8,
        }
        axes.plot(
            *boxes[:, :2].T, style.marker, markersize=style.size, zorder=style.order + 0.5, **mark
        )


def text_colour(background: str) -> str:
    """Black or white (#rrggbb), whichever is more legible on a background (#rrggbb)."""
    red, green, blue = (int(background[k : k + 2], 16) / 255 for k in (1, 3, 5))
    # relative luminance, with a gamma of 2.2; dark text from about a fifth on
    luminance = 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2
    return INK if luminance > 0.22 else PAPER_WHITE


def outcome_entry(outcome: Outcome, label: str) -> Entry:
    """Legend entry of the boxes of one outcome: a line with its mark, and the label."""
    from matplotlib.lines import Line2D

    style = OUTCOME[outcome]
    mark: PlotStyle = {
        "marker": style.marker,
        "markersize": 0.8 * style.size,
        "markeredgecolor": "white",
    }
    line = Line2D([], [], color=style.colour, linestyle=style.line, linewidth=style.width, **mark)
    return line, label
