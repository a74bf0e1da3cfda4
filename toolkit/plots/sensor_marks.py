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

VIEW_RANGE_M = 25.0  # fields of view are drawn this far
DISC_POINTS = 15.0  # diameter of a sensor's disc
MAX_DISC_LETTERS = 3  # letters of a name that fit into the disc
MIN_HIDING_M = 2.0  # buildings above this height cut off fields of view
MIN_VIEW_RAYS = 24  # rays of a field of view; wide ones have one for each degree
MapPlaces = Float64[np.ndarray, "_ 2"]  # x and y


def sensor_labels(names: Sequence[str]) -> list[str]:
    """Labels on the discs of sensors: their names if all are short, else numbers from 1."""
    if all(len(name) <= MAX_DISC_LETTERS for name in names):
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
    # centres of discs, and ends of headings, x and y (m)
    disc_gap = DISC_POINTS + 1
    discs = spread_discs(places * points_per_metre, headings, disc_gap) / points_per_metre
    directions = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    heading_ends = discs + DISC_POINTS / points_per_metre * directions
    for index, label in enumerate(sensor_labels([sensor.name for sensor in sensors])):
        colour = sensor_colour(index)
        disc = discs[index]
        axes.plot(
            *np.stack([disc, heading_ends[index]]).T,
            color=INK,
            linewidth=2.2,
            zorder=6,
            solid_capstyle="butt",
        )
        if (disc != places[index]).any():
            axes.plot(*np.stack([places[index], disc]).T, color=INK, linewidth=0.8, zorder=6)
            axes.plot(*places[index], "o", color=INK, markersize=3, zorder=6)
        axes.plot(*disc, "o", markersize=DISC_POINTS + 3, color=PAPER_WHITE, zorder=6.5)
        look: PlotStyle = {
            "markerfacecolor": colour,
            "markeredgecolor": INK,
            "markeredgewidth": 0.9,
        }
        axes.plot(*disc, "o", markersize=DISC_POINTS, zorder=7, **look)
        font: PlotStyle = {"fontsize": 7.5, "fontweight": "bold", "color": text_colour(colour)}
        axes.text(disc[0], disc[1], label, ha="center", va="center_baseline", zorder=8, **font)


def draw_wedges(axes: "Axes", sensors: Sequence[Sensor], solids: Sequence[Solid] = ()) -> None:
    """Draw fields of view from above up to `VIEW_RANGE_M`, cut off at tall buildings.

    solids: solids of the site; only buildings higher than `MIN_HIDING_M` count."""
    tall_buildings = [
        shapely.Polygon(solid.footprint)
        for solid in solids
        if solid.kind == "building" and solid.top - solid.base > MIN_HIDING_M
    ]
    for index, sensor in enumerate(sensors):
        colour = sensor_colour(index)
        outline = wedge(sensor, tall_buildings)
        axes.fill(*outline.T, color=colour, alpha=0.09, linewidth=0, zorder=2.2)
        closed_outline = np.concatenate([outline, outline[:1]])
        axes.plot(*closed_outline.T, color=colour, linewidth=0.9, alpha=0.9, zorder=2.3)


def wedge(sensor: Sensor, buildings: Sequence[shapely.Polygon]) -> Float64[np.ndarray, "k 2"]:
    """Outline (x, y in m) of a sensor's field of view from above, up to `VIEW_RANGE_M`.

    buildings: footprints (m). Each ray ends at the first building that the sensor is not in. The
    outline begins at the sensor unless the view is all around."""
    start = sensor.position[:2]
    place = shapely.Point(start)
    near_buildings = [
        building for building in buildings if 0 < building.distance(place) < VIEW_RANGE_M
    ]
    obstacles = shapely.union_all(near_buildings)
    shapely.prepare(obstacles)
    fov = sensor.model.horizontal_fov  # rad
    ray_count = max(MIN_VIEW_RAYS, int(np.rad2deg(fov)) + 1)
    angles = sensor_heading(sensor) + np.linspace(-fov / 2, fov / 2, ray_count)
    ends = start + VIEW_RANGE_M * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if not obstacles.is_empty:
        rays = shapely.linestrings(np.stack([np.broadcast_to(start, ends.shape), ends], axis=1))
        # distance to the first building along each ray, NaN if the ray meets no building
        free_length = shapely.distance(place, shapely.intersection(rays, obstacles))
        length = np.where(np.isnan(free_length), VIEW_RANGE_M, free_length)
        ends = start + (ends - start) * (length / VIEW_RANGE_M)[:, None]
    is_all_around = fov > 2 * np.pi - 1e-6
    return ends if is_all_around else np.vstack([start, ends])


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
    # directions of a shift in the order in which they are tried, from the heading
    turns = np.deg2rad([0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180])
    for k in range(1, len(places)):
        angles = headings[k] + turns
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        # rings of growing radius around the place; ring 0 is the place itself
        for ring in range(4 * len(places)):
            spots = places[k] + ring * 0.55 * gap * directions
            # distance from each of the 12 spots to the nearest earlier disc; 1e-9 allows rounding
            clearance = np.linalg.norm(spots[:, None] - discs[None, :k], axis=2).min(axis=1)
            is_free = clearance >= gap * (1 - 1e-9)
            if is_free.any():
                discs[k] = spots[int(np.argmax(is_free))]  # the first free one
                break
    return discs


def sensor_entries(sensors: Sequence[Sensor]) -> list[Entry]:
    """Legend entries of sensors whose disc holds a number, since their name is too long for it."""
    from matplotlib.lines import Line2D

    mark: PlotStyle = {"marker": "o", "markersize": 8, "markeredgecolor": INK, "linestyle": "none"}
    names = [sensor.name for sensor in sensors]
    entries: list[Entry] = []
    for index, (name, label) in enumerate(zip(names, sensor_labels(names), strict=True)):
        if name != label:
            line = Line2D([], [], color=sensor_colour(index), **mark)
            entries.append((line, f"{label}  {shorten(name, 34)}"))
    return entries


def sensor_places(sensors: Sequence[Sensor]) -> MapPlaces:
    """Positions of sensors on the map: x and y (m) in the world."""
    return np.array([sensor.position[:2] for sensor in sensors]).reshape(-1, 2)
