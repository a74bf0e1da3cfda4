"""Palette of all pictures: colours of sensors, classes, grounds and outcomes."""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.plots.line_style import Dashes, LineStyle, Outcome

if TYPE_CHECKING:
    from matplotlib.colors import BoundaryNorm, ListedColormap

INK = "#1a1a1a"
PAPER_WHITE = "#ffffff"
FAINT = "#6b6b6b"
# colours of sensors by index, used again from the ninth sensor on
SENSORS = ("#279efb", "#f500c7", "#0b921a", "#8a4291", "#f57f7c", "#78683d", "#e21978", "#4463f6")
BAR = SENSORS[7]  # colour of bars in charts
CLASS = {"vehicle": "#ae93ab", "cyclist": "#53d9ff", "pedestrian": "#9fca03", "heavy": "#f3d482"}
GROUND = {"lanes": "#e3e3e6", "footways": "#f3efe6"}
# lowest solid first
SOLID = {
    "pond": "#cfe4ee",
    "island": "#d9d9d2",
    "kerb": "#bdb9b0",
    "building": "#c9c2b8",
    "hedge": "#cfe0c3",
    "tree": "#cfe0c3",
}
OTHER_SOLID = "#9a958c"
POLE_INK = "#1a1a1a"
# hatching over solids that coview drew
DRAWN_INK = "#a05a9c"
DRAWN_HATCH = "//////"
# ground that no sensor sees; darker if that matters more
BLIND = {"lanes": "#b3001b", "footways": "#e8853a", "elsewhere": "#f6cfa0"}
OUTCOME: dict[Outcome, LineStyle] = {
    "hit": LineStyle("#004a3a", "solid", 1.7, order=4.0),
    "missed": LineStyle(
        colour="#f21c09", line=(0, (3.5, 1.6)), width=2.1, marker="X", size=10.0, order=4.4
    ),
    "false alarm": LineStyle(
        colour="#5600f4", line=(0, (7, 1.6, 1.2, 1.6)), width=1.9, marker="^", size=9.0, order=4.2
    ),
    "not scored": LineStyle(FAINT, (0, (1, 1.4)), 1.3, order=3.8),
    "detection": LineStyle(INK, (0, (4, 1.5)), 1.4, order=4.0),
}
# colours and dashes of curves; neighbours differ in both
LINES: tuple[tuple[str, Dashes], ...] = tuple(
    (
        SENSORS[k % 8],
        ("solid", (0, (6, 2)), (0, (1.5, 1.5)), (0, (7, 1.5, 1.5, 1.5)))[(k + k // 8) % 4],
    )
    for k in (7, 1, 2, 5, 0, 3, 4, 6, 15, 9, 10, 13, 8, 11, 12, 14)
)
POINT_STEPS = (1, 2, 5, 10, 20, 50, 100)  # counts of points at which the colour changes
VIEW_COLOURS = ("#fde3cb", "#85bbdd", "#2f7fbc", "#08306b")  # seen by 0, 1, 2, 3 or more sensors


def sensor_colour(index: int) -> str:
    """Colour (#rrggbb) of a sensor by its index, the same in every picture."""
    return SENSORS[index % len(SENSORS)]


def point_scale() -> "tuple[ListedColormap, BoundaryNorm]":
    """Colour map and norm that give the colour of a number of points.

    The scale has a step for 0, then one that begins at each of `POINT_STEPS`, ever darker."""
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm, ListedColormap

    step_colours = colormaps["viridis_r"](np.linspace(0.0, 1.0, len(POINT_STEPS)))
    colour_map = ListedColormap(["#ededed", *map(tuple, step_colours)])
    bounds = [0, *POINT_STEPS, 1e9]  # 1e9: the last step is open
    return colour_map, BoundaryNorm(bounds, ncolors=len(POINT_STEPS) + 1)


def point_colours(points: Float[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n 4"]:
    """Red, green, blue and opacity (0 to 1) for numbers of points, in a last axis of 4."""
    colours, norm = point_scale()
    return np.asarray(colours(norm(points)), np.float64)


def point_names() -> list[str]:
    """Names of the steps of `point_scale`, such as "0", "2–4" and "100+"."""
    names = ["0"]
    for low, next_low in pairwise(POINT_STEPS):
        high = next_low - 1
        names.append(f"{low}" if low == high else f"{low}–{high}")
    return [*names, f"{POINT_STEPS[-1]}+"]
