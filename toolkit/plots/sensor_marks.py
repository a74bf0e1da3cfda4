"""Sensors on a map: discs with headings, and fields of view.

A sensor is a disc with its number or short name, because there may be more sensors than colours."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.plots.canvas import shorten
from toolkit.plots.line_style import Entry, PlotStyle
from toolkit.plots.outcome_marks import text_colour
from toolkit.plots.palette import INK, PAPER_WHITE, sensor_colour
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Solid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VIEW_RANGE = 25.0  # m; fields of view are drawn this far
DISC = 15.0  # diameter of a sensor's disc in points
SHORT = 3  # letters of a name that fit into the disc
TALL = 2.0  # m; buildings above this height cut off fields of view
MapPlaces = Float64[np.ndarray, "_ 2"]


def sensor_labels(names: Sequence[str]) -> list[str]:
    """Labels on the discs of sensors: their names if all are short, else numbers from 1."""
    if all(len(name) <= SHORT for name in names):
        return list(names)
    return [str(number + 1) for number in range(len(names))]


def draw_sensors(axes: "Axes", sensors: Sequence[Sensor], points_per_metre: float) -> None:
    """Draw a disc for each sensor, with a line for its heading.

    Discs of sensors in one place spread around it, with a thin line to the place. points_per_metre:
    scale of the map, in points of 1/72 inch."""
    if not len(sensors):
        return
    places = np.array([sensor.position[:2] for sensor in sensors])
    headings = np.array([sensor_heading(sensor) for sensor in sensors])
    discs = spread_discs(places * points_per_metre, headings, DISC + 1) / points_per_metre
    ahead = discs + DISC / points_per_metre * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    for index, label in enumerate(sensor_labels([sensor.name for sensor in sensors])):
        colour = sensor_colour(index)
        disc = discs[index]
        axes.plot(
            *np.stack([disc, ahead[index]]).T,
            color=INK,
            linewidth=2.2,
            zorder=6,
            solid_capstyle="butt",
        )
        if (disc != places[index]).any():
            axes.plot(*np.stack([places[index], disc]).T, color=INK, linewidth=0.8, zorder=6)
            axes.plot(*places[index], "o", color=INK, markersize=3, zorder=6)
        axes.plot(*disc, "o", markersize=DISC + 3, color=PAPER_WHITE, zorder=6.5)
        look: PlotStyle = {
            "markerfacecolor": colour,
            "markeredgecolor": INK,
            "markeredgewidth": 0.9,
        }
        axes.plot(*disc, "o", markersize=DISC, zorder=7, **look)
        font: PlotStyle = {"fontsize": 7.5, "fontweight": "bold", "color": text_colour(colour)}
        axes.text(disc[0], disc[1], label, ha="center", va="center_baseline", zorder=8, **font)


def draw_wedges(axes: "Axes", sensors: Sequence[Sensor], solids: Sequence[Solid] = ()) -> None:
    """Draw fields of view from above up to `VIEW_RANGE`, cut off at tall buildings.

    solids: solids of the site; only buildings higher than `TALL` count."""
    tall = [
        shapely.Polygon(s.footprint)
        for s in solids
        if s.kind == "building" and s.top - s.base > TALL
    ]
    for index, sensor in enumerate(sensors):
        x, y = wedge(sensor, tall).T
        axes.fill(x, y, color=sensor_colour(index), alpha=0.09, linewidth=0, zorder=2.2)
        axes.plot(
            np.r_[x, x[:1]],
            np.r_[y, y[:1]],
            color=sensor_colour(index),
            linewidth=0.9,
            alpha=0.9,
            zorder=2.3,
        )


def wedge(sensor: Sensor, buildings: Sequence[shapely.Polygon]) -> Float64[np.ndarray, "k 2"]:
    """Outline (x, y in m) of a sensor's field of view from above, up to `VIEW_RANGE`.

    buildings: footprints (m). Each ray ends at the first building that the sensor is not in. The
    outline begins at the sensor unless the view is all around."""
    start = sensor.position[:2]
    view = sensor.model.horizontal_fov
    reach = VIEW_RANGE
    foot = shapely.Point(start)
    blocking = shapely.union_all(
        [b for b in buildings if b.distance(foot) > 0 and b.distance(foot) < reach]
    )
    shapely.prepare(blocking)
    # rays about 1° apart, at least 24
    angles = sensor_heading(sensor) + np.linspace(
        -view / 2, view / 2, max(24, int(np.rad2deg(view)) + 1)
    )
    rim = start + reach * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if not blocking.is_empty:
        rays = shapely.linestrings(np.stack([np.broadcast_to(start, rim.shape), rim], axis=1))
        # distance to the first building along each ray, NaN if the ray meets no building
        free = shapely.distance(foot, shapely.intersection(rays, blocking))
        rim = start + (rim - start) * (np.where(np.isnan(free), reach, free) / reach)[:, None]
    return rim if view > 2 * np.pi - 1e-6 else np.vstack([start, rim])


def sensor_heading(sensor: Sensor) -> float:
    """Heading of a sensor's optical axis in the world, counter-clockwise from +x (rad)."""
    # x axis of the body, which points forward
    forward = sensor.world_SE3_body[:2, 0]
    return float(np.arctan2(forward[1], forward[0]))


def spread_discs(places: MapPlaces, headings: Float64[np.ndarray, " n"], gap: float) -> MapPlaces:
    """Centres of discs that do not overlap, each at its place or, if that is taken, near it.

    places: wanted centres; headings: preferred direction of a shift (rad, from +x); gap: smallest
    distance of two centres, in the unit of the places. Earlier discs keep their places."""
    discs = places.copy()
    turns = np.deg2rad([0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180])
    for k in range(1, len(places)):
        # rings of growing radius around the place; ring 0 is the place itself
        for ring in range(4 * len(places)):
            angles = headings[k] + turns
            around = places[k] + ring * 0.55 * gap * np.stack(
                [np.cos(angles), np.sin(angles)], axis=1
            )
            # distance from each of the 12 spots to the nearest earlier disc; 1e-9 allows rounding
            apart = np.linalg.norm(around[:, None] - discs[None, :k], axis=2).min(axis=1)
            if (apart >= gap * (1 - 1e-9)).any():
                discs[k] = around[int(np.argmax(apart >= gap * (1 - 1e-9)))]
                break
    return discs


def sensor_entries(sensors: Sequence[Sensor]) -> list[Entry]:
    """Legend entries of sensors whose disc holds a number instead of the name."""
    from matplotlib.lines import Line2D

    names = [sensor.name for sensor in sensors]
    entries = list[Entry]()
    for index, (name, label) in enumerate(zip(names, sensor_labels(names), strict=True)):
        if name != label:
            mark: PlotStyle = {
                "marker": "o",
                "markersize": 8,
                "markeredgecolor": INK,
                "linestyle": "none",
            }
            line = Line2D([], [], color=sensor_colour(index), **mark)
            entries.append((line, f"{label}  {shorten(name, 34)}"))
    return entries


def sensor_places(sensors: Sequence[Sensor]) -> MapPlaces:
    """Positions of sensors on the map: x and y (m) in the world."""
    return np.array([sensor.position[:2] for sensor in sensors]).reshape(-1, 2)
