"""What stands on a plan: sensors with their fields of view and labels, poles, boxes of objects and detections.

A sensor is a disc with its number or short name, so that more of them than there are colours are told apart. An object
is filled by its class. What became of it has a line of its own besides a colour: a hit solid, a miss dashed with a
cross, a false alarm dash-dotted with a triangle, what does not count dotted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from toolkit.arrays import Float64, Shaped
from toolkit.boxes import footprints
from toolkit.objects import LABELS, Objects
from toolkit.plots.canvas import shortened
from toolkit.plots.palette import CLASS, INK, OUTCOME, PAPER_WHITE, POLE_INK, Outcome, sensor_colour
from toolkit.sensors.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from toolkit.sites.site import Solid

VIEW_RANGE = 25.0  # metres of a sensor's field of view that are drawn
DISC = 15.0  # points across the disc of a sensor
SHORT = 3  # letters of a name that fit into it
TALL = 2.0  # m: buildings higher than this cut fields of view off


def sensor_labels(names: Sequence[str]) -> list[str]:
    """What stands on the discs of sensors: their names where all are short, else numbers from 1.

    >>> sensor_labels(["d0", "d1"]), sensor_labels(["d0", "north-east pole"])
    (['d0', 'd1'], ['1', '2'])
    """
    if all(len(name) <= SHORT for name in names):
        return list(names)
    return [str(number + 1) for number in range(len(names))]


def draw_sensors(axes: Axes, sensors: Sequence[Sensor], points_per_metre: float) -> None:
    """A disc for each sensor, with a line along its heading; where several hang in one place, the discs stand about
    it."""
    if not len(sensors):
        return
    places = np.array([sensor.position[:2] for sensor in sensors])
    headings = np.array([heading_of(sensor) for sensor in sensors])
    discs = spread_discs(places * points_per_metre, headings, DISC + 1) / points_per_metre
    for index, label in enumerate(sensor_labels([sensor.name for sensor in sensors])):
        colour, (x, y) = sensor_colour(index), places[index]
        ahead = discs[index] + DISC / points_per_metre * np.array([np.cos(headings[index]), np.sin(headings[index])])
        axes.plot(*np.stack([discs[index], ahead]).T, color=INK, linewidth=2.2, zorder=6, solid_capstyle="butt")
        if (discs[index] != places[index]).any():
            axes.plot(*np.stack([places[index], discs[index]]).T, color=INK, linewidth=0.8, zorder=6)
            axes.plot(x, y, "o", color=INK, markersize=3, zorder=6)
        axes.plot(*discs[index], "o", markersize=DISC + 3, color=PAPER_WHITE, zorder=6.5)
        disc: dict[str, Any] = {"markerfacecolor": colour, "markeredgecolor": INK, "markeredgewidth": 0.9}
        axes.plot(*discs[index], "o", markersize=DISC, zorder=7, **disc)
        axes.text(
            discs[index, 0], discs[index, 1], label, ha="center", va="center_baseline", fontsize=7.5, fontweight="bold",
            color=text_colour(colour), zorder=8,
        )  # fmt: skip


def draw_wedges(axes: Axes, sensors: Sequence[Sensor], solids: Sequence[Solid] = ()) -> None:
    """Fields of view up to `VIEW_RANGE`, cut off where a building stands in between."""
    tall = [shapely.Polygon(s.footprint) for s in solids if s.kind == "building" and s.top - s.base > TALL]
    for index, sensor in enumerate(sensors):
        x, y = wedge(sensor, tall).T
        axes.fill(x, y, color=sensor_colour(index), alpha=0.09, linewidth=0, zorder=2.2)
        axes.plot(np.r_[x, x[:1]], np.r_[y, y[:1]], color=sensor_colour(index), linewidth=0.9, alpha=0.9, zorder=2.3)


def wedge(
    sensor: Sensor, buildings: Sequence[shapely.Polygon], reach: float = VIEW_RANGE
) -> Float64[np.ndarray, "k 2"]:
    """The outline of a field of view seen from above, each ray up to the first building that the sensor is not in."""
    start, view = sensor.position[:2], sensor.model.horizontal_fov
    foot = shapely.Point(start)
    blocking = shapely.union_all([b for b in buildings if b.distance(foot) > 0 and b.distance(foot) < reach])
    shapely.prepare(blocking)
    angles = heading_of(sensor) + np.linspace(-view / 2, view / 2, max(24, int(np.rad2deg(view)) + 1))
    rim = start + reach * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if not blocking.is_empty:
        rays = shapely.linestrings(np.stack([np.broadcast_to(start, rim.shape), rim], axis=1))
        free = shapely.distance(foot, shapely.intersection(rays, blocking))
        rim = start + (rim - start) * (np.where(np.isnan(free), reach, free) / reach)[:, None]
    return rim if view > 2 * np.pi - 1e-6 else np.vstack([start, rim])


def heading_of(sensor: Sensor) -> float:
    """Where its optical axis points, counter-clockwise from +x (rad)."""
    forward = sensor.world_SE3_body[:2, 0]
    return float(np.arctan2(forward[1], forward[0]))


def spread_discs(
    places: Float64[np.ndarray, "n 2"], headings: Float64[np.ndarray, " n"], gap: float
) -> Float64[np.ndarray, "n 2"]:
    """Middles of discs `gap` apart, each at its place or, where that is taken, near it and rather along its heading."""
    discs = places.copy()
    turns = np.deg2rad([0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180])
    for k in range(1, len(places)):
        for ring in range(4 * len(places)):
            angles = headings[k] + turns
            around = places[k] + ring * 0.55 * gap * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            apart = np.linalg.norm(around[:, None] - discs[None, :k], axis=2).min(axis=1)
            if (apart >= gap * (1 - 1e-9)).any():
                discs[k] = around[int(np.argmax(apart >= gap * (1 - 1e-9)))]
                break
    return discs


def draw_poles(axes: Axes, places: Float64[np.ndarray, "n 2"], *, used: bool = False, size: float = 6.0) -> None:
    """Poles as squares: filled where they carry a sensor, hollow where they do not."""
    axes.plot(*places.T, zorder=5, **{**pole_style(used), "markersize": size})


def name_poles(
    axes: Axes,
    places: Float64[np.ndarray, "n 2"],
    names: Sequence[str],
    points_per_metre: float,
    keep_off: Float64[np.ndarray, "m 2"],
) -> None:
    """The names of poles beside them, where there is room that no pole, other name or sensor (`keep_off`) takes."""
    taken = [(*(place * points_per_metre - half), *(place * points_per_metre + half))
             for group, half in ((places, 4.0), (keep_off, DISC / 2 + 1)) for place in group]  # fmt: skip
    for place, name in zip(places, names, strict=True):
        text = shortened(name, 14)
        width, height = 3.9 * len(text) + 1, 7.5
        x, y = place * points_per_metre
        spots = [(x + 5, y - 3.5), (x - width - 5, y - 3.5), (x - width / 2, y + 5), (x - width / 2, y - 12.5)]
        boxes = [(left, low, left + width, low + height) for left, low in spots]
        free = [box for box in boxes if not any(_overlap(box, other) for other in taken)]
        if free:
            taken.append(free[0])
            left, low = np.array(free[0][:2]) / points_per_metre
            axes.text(left, low, text, fontsize=6.5, va="bottom", zorder=5.5)


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    return bool(one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3])


def pole_style(used: bool) -> dict[str, Any]:
    """How matplotlib draws a pole."""
    return {
        "marker": "s",
        "markersize": 6.0,
        "markerfacecolor": POLE_INK if used else PAPER_WHITE,
        "markeredgecolor": POLE_INK,
        "markeredgewidth": 1.3,
        "linestyle": "none",
    }


def draw_objects(axes: Axes, objects: Objects) -> None:
    """Boxes filled by class."""
    for label, name in enumerate(LABELS):
        chosen = objects.boxes[objects.labels == label]
        for corners in footprints(chosen):
            axes.fill(*corners.T, facecolor=CLASS[name], edgecolor=INK, linewidth=0.5, zorder=2.6)


def draw_outcome(axes: Axes, boxes: Shaped[np.ndarray, "n 7"], outcome: Outcome) -> None:
    """Outlines of boxes that share an outcome, with a line from the middle to the front and the outcome's mark."""
    style = OUTCOME[outcome]
    line = {"color": style.colour, "linestyle": style.line, "linewidth": style.width, "zorder": style.order}
    for corners, yaw in zip(footprints(boxes), boxes[:, 6], strict=True):
        centre = corners.mean(axis=0)
        nose = centre + np.array([np.cos(yaw), np.sin(yaw)]) * np.linalg.norm(corners[0] - centre) * 0.9
        axes.plot(*np.vstack([corners, corners[:1]]).T, **line)
        axes.plot(*np.vstack([centre, nose]).T, color=style.colour, linewidth=0.8, zorder=style.order)
    if style.marker and len(boxes):
        mark: dict[str, Any] = {"markerfacecolor": style.colour, "markeredgecolor": PAPER_WHITE, "markeredgewidth": 0.8}
        axes.plot(*boxes[:, :2].T, style.marker, markersize=style.size, zorder=style.order + 0.5, **mark)


def text_colour(background: str) -> str:
    """Black or white, whichever reads better on a colour (its luminance above or below that of mid grey)."""
    red, green, blue = (int(background[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return INK if 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2 > 0.22 else PAPER_WHITE
