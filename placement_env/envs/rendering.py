"""Pictures and text summaries of a set of sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from placement_env.classes import VEHICLES
from placement_env.envs.scenario import find_area
from placement_env.objective import Objective
from toolkit.arrays import Shaped
from toolkit.boxes import footprints
from toolkit.plots import plan_view as above
from toolkit.plots.canvas import (
    INK,
    PAPER_WHITE,
    blank_figure,
    house_style,
    point_colours,
    point_names,
    point_scale,
    render_pixels,
    shorten,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_VEHICLES = 300  # drawn
MARGIN = 6.0  # m around area and sensors
_SIDE, _HEAD, _FOOT = 6.4, 0.5, 0.42  # inches of a square picture, and of the strips above and below its map


def bird_view(objective: Objective, members: list[int]) -> Shaped[np.ndarray, "height width 3"]:
    """Draw the area from above (RGB, uint8), a square of the same size for every site.

    Shows lanes, solids and the detection area, vehicles coloured by the points on them (darker is more, pale grey
    none), places where sensors may hang, and the chosen sensors with their fields of view.
    """
    sensors, site = objective.candidates.sensors, objective.site
    places, area = np.array([sensor.position[:2] for sensor in sensors]).reshape(-1, 2), find_area(objective)
    feet = np.concatenate([[area[:2], area[2:]], places])
    side = _SIDE - _HEAD - _FOOT
    low, high = feet.min(axis=0) - MARGIN, feet.max(axis=0) + MARGIN
    middle, reach = (low + high) / 2, (high - low).max() / 2 * np.array([_SIDE / side, 1.0])
    scale = side / (2 * reach[1])  # inches a metre
    with house_style():
        figure = blank_figure(_SIDE, _SIDE)
        axes = figure.add_axes((0, _FOOT / _SIDE, 1, side / _SIDE))
        axes.set(xlim=(middle[0] - reach[0], middle[0] + reach[0]), ylim=(middle[1] - reach[1], middle[1] + reach[1]))
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        if site is not None:
            above.draw_ground(axes, site)
        above.draw_area(axes, area)
        vehicles = _draw_vehicles(axes, objective, members)
        above.draw_poles(axes, np.unique(places, axis=0), size=3.5)
        chosen = [sensors[member] for member in members]
        above.draw_wedges(axes, chosen, () if site is None else site.solids)
        above.draw_sensors(axes, chosen, 72 * scale)
        towards = np.array([0.0, 1.0]) if site is None else above.north(site)
        above.draw_north(_draw_strips(figure, scale), (1.85, _FOOT / 2), towards)
        title = f"{shorten(_name(objective), 30)}: {len(members)} sensor{'s' * (len(members) != 1)}"
        figure.text(0.02, 1 - 0.16 / _SIDE, title, fontsize=10, fontweight="bold", va="center")
        figure.text(0.02, 1 - 0.36 / _SIDE, f"{vehicles}; by {objective.fidelity}", fontsize=8, va="center")
        return render_pixels(figure)


def _name(objective: Objective) -> str:
    return "a site" if objective.site is None else objective.site.name


def _draw_vehicles(axes: Axes, objective: Objective, members: list[int]) -> str:
    """Draw some vehicles, coloured by the members' points, and return a caption."""
    from matplotlib.collections import PolyCollection

    noun = "vehicles" if objective.classes.names == VEHICLES.names else " and ".join(objective.classes.names)
    if objective.visibility is None or not len(objective.visibility.boxes):
        return f"no {noun}"
    boxes = objective.visibility.boxes
    some = np.linspace(0, len(boxes) - 1, min(len(boxes), MOST_VEHICLES)).round().astype(np.int64)
    points = objective.visibility.points[members][:, some].astype(np.float64).sum(axis=0)
    shown = PolyCollection(
        list(footprints(boxes[some])), facecolor=point_colours(points), edgecolor=INK, linewidth=0.3, zorder=2.1
    )
    axes.add_collection(shown, autolim=False)
    drawn = f", {len(some)} drawn" if len(some) < len(boxes) else ""
    return f"N = {len(boxes)} {noun} in {objective.visibility.frames} frames{drawn}"


def _draw_strips(figure: Figure, scale: float) -> Axes:
    """Draw scale bar and legend below the map, in inches."""
    strip = figure.add_axes((0, 0, 1, _FOOT / _SIDE))
    strip.set(xlim=(0, _SIDE), ylim=(0, _FOOT))
    strip.set_axis_off()
    length = above.scale_length(1.2 / scale)
    for half, colour in ((0.0, INK), (0.5, PAPER_WHITE)):
        left, right = 0.13 + half * length * scale, 0.13 + (half + 0.5) * length * scale
        strip.fill([left, right, right, left], [0.24, 0.24, 0.31, 0.31], facecolor=colour, edgecolor=INK, linewidth=0.8)
    strip.text(0.13, 0.18, f"{length:g} m", fontsize=7.5, va="top")
    strip.text(2.35, 0.27, "points on\na vehicle", fontsize=7, va="center")
    colours, _ = point_scale()
    for step, name in enumerate(point_names()):
        left = 3.0 + 0.42 * step
        corners = [left, left + 0.42, left + 0.42, left]
        strip.fill(corners, [0.22, 0.22, 0.36, 0.36], facecolor=colours(step), edgecolor=INK, linewidth=0.3)
        strip.text(left + 0.21, 0.18, name, fontsize=6.5, ha="center", va="top")
    return strip


def summary(objective: Objective, members: list[int]) -> str:
    """Describe site, scheme, chosen sensors and their score."""
    score = objective.score(members)
    names = ", ".join(objective.names[member] for member in members) or "no sensors"
    return (
        f"{_name(objective)}, {objective.scheme.name} fusion, by {score.fidelity}\n{names}\n"
        f"AP {score.ap:.3f}, recall {score.recall:.3f}, {score.kbit_per_sensor:.1f} kbit per sensor, "
        f"{score.kbit:.1f} kbit, price {score.price:g}: reward {score.reward:.3f}\n"
    )
