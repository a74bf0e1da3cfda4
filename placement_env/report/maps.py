"""Maps of a plan as SVG text: sensors, coverage and density of the ground, and blind spots.

Cells are an image drawn between streets and solids; everything else is lines. The same arguments
give the same text."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from placement_env.candidates.candidates import Candidates
from placement_env.handover.ground import GroundGrid, visible_polygons
from placement_env.report.content import Planned
from toolkit.arrays import Bool, Float64
from toolkit.grid_sums import sum_squares_around
from toolkit.plots import canvas, ground_map, map_sheet, palette, pole_marks, sensor_marks
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

MAP_INCHES = 7.0  # greater side of a map
SMOOTHING_SIDE_M = 1.5  # side of the square over which density is averaged
PIXELS_PER_CELL = 3  # along a cell's side, because viewers smooth images
MAX_LABELLED_POLES = 30  # with more, poles have no names
HEADING_SHARE = 0.05  # length of a heading's stroke, as a share of the map's extent


def draw_planned(planned: Planned, out: str | Path) -> None:
    """Write the plan view of a plan as a picture, in the format of the path's suffix."""
    with canvas.house_style():
        sheet = _draw_plan_sheet(planned.site, planned.site.sensors, planned.ground)
        canvas.write_figure(sheet.figure, out)


def draw_pool(candidates: Candidates, out: str | Path) -> None:
    """Write a picture of the candidates' mounts, with a stroke for each direction of a sensor.

    out: path, whose suffix gives the format."""
    x, y, _ = np.array([mount.position for mount in candidates.mounts]).reshape(-1, 3).T
    # columns of factors: mount, height, heading, tilt, model; pairs of mount and heading that occur
    mount_headings = np.unique(candidates.factors[:, [0, 2]], axis=0)
    mount_indices, heading_indices = mount_headings.T
    headings = candidates.axes.headings[heading_indices]  # rad, counter-clockwise from +x
    width = float(np.ptp(x))
    depth = float(np.ptp(y))
    stroke_length = HEADING_SHARE * max(width, depth, 1.0)
    with canvas.house_style():
        # inches: as high as the proportions of the mounts ask for, and 1 for the title
        height = float(np.clip(5.0 * depth / max(width, 1.0), 1.0, 6.0)) + 1.0
        figure = canvas.blank_figure(6.0, height, constrained=True)
        axes = figure.add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        axes.set_title(f"{len(candidates)} candidate sensors on {len(x)} mounts")
        strokes = np.stack([stroke_length * np.cos(headings), stroke_length * np.sin(headings)])
        feet = np.stack([x, y])[:, mount_indices]
        # axes: x or y, start or end, stroke
        axes.plot(*np.stack([feet, feet + strokes], axis=1), color=palette.BAR, linewidth=0.8)
        pole_marks.draw_poles(axes, np.stack([x, y], axis=1))
        labelled_mounts = candidates.mounts if len(x) <= MAX_LABELLED_POLES else ()
        for mount in labelled_mounts:
            axes.annotate(
                mount.name,
                xy=tuple(mount.position[:2]),
                xytext=(4, 4),
                textcoords="offset points",
                fontsize=7,
            )
        canvas.write_figure(figure, out)


def plan_view(
    site: Site,
    sensors: Sequence[Sensor],
    poles: Sequence[str] = (),
    poles_unused: Sequence[str] = (),
    ground: GroundGrid | None = None,
) -> str:
    """Draw the site with the chosen sensors, the poles, and the ground each sensor sees, as SVG.

    poles: names of mounts with a sensor; poles_unused: names of other mounts; ground: ground that
    these sensors see, None to draw fields of view up to the first building.

    Raises ValueError for an unknown pole, and for a ground of other sensors."""
    with canvas.house_style():
        sheet = _draw_plan_sheet(site, sensors, ground, used_poles=poles, unused_poles=poles_unused)
        return canvas.svg_text(sheet.figure, "Plan view of the chosen sensors")


def _draw_plan_sheet(
    site: Site,
    sensors: Sequence[Sensor],
    ground: GroundGrid | None,
    *,
    used_poles: Sequence[str] = (),
    unused_poles: Sequence[str] = (),
) -> map_sheet.MapSheet:
    """Draw the map that `plan_view` gives as SVG. Poles are given by their names."""
    used_places = _pole_places(site, used_poles)
    unused_places = _pole_places(site, unused_poles)
    entries = pole_marks.pole_entries(used=len(used_places), unused=len(unused_places))
    legend = [*ground_map.ground_entries(site), *entries, *sensor_marks.sensor_entries(sensors)]
    subtitle = "coloured: fields of view up to 25 m, cut off at buildings"
    if ground is not None:
        _check_sensors(ground, sensors)
        subtitle = "coloured: ground that each sensor sees, by casting rays at the empty site"
    places = sensor_marks.sensor_places(sensors)
    title = canvas.shorten(f"{site.name}: where the sensors stand", 70)
    holds = np.concatenate([places, used_places, unused_places])
    sheet = map_sheet.map_sheet(
        site, title, subtitle, holds=holds, legend=legend, inches=MAP_INCHES
    )
    if ground is None:
        sensor_marks.draw_wedges(sheet.axes, sensors, site.solids)
    else:
        open_ground = ground.open_ground  # smoothing drops slivers
        smooth_views = [
            open_ground & (smooth(seen_cells * 1.0, open_ground, ground.cell) > 0.5)
            for seen_cells in ground.seen
        ]
        smooth_ground = replace(
            ground, seen=np.array(smooth_views, bool).reshape(ground.seen.shape)
        )
        for index, polygons in enumerate(visible_polygons(smooth_ground)):
            ground_map.fill_polygons(
                sheet.axes, polygons, palette.sensor_colour(index), order=2.2, alpha=0.09, edge=1.2
            )
    pole_marks.draw_poles(sheet.axes, unused_places)
    pole_marks.draw_poles(sheet.axes, used_places, carries_sensor=True)
    if len(unused_places) <= MAX_LABELLED_POLES:
        pole_marks.name_poles(
            sheet.axes, unused_places, unused_poles, sheet.points_per_metre, keep_off=places
        )
    sensor_marks.draw_sensors(sheet.axes, sensors, sheet.points_per_metre)
    return sheet


def coverage_map(site: Site, ground: GroundGrid, sensors: Sequence[Sensor]) -> str:
    """Map the number of sensors that see each place, up to 3, as SVG.

    The legend has the share of open ground of each number.

    Raises ValueError if `ground` was computed for other sensors than `sensors`."""
    views = np.minimum(ground.views, 3)  # number of sensors; index into `names` and the colours
    open_views = views[ground.open_ground]
    names = ("no sensor", "1 sensor", "2 sensors", "3 or more")
    legend = []
    for count, (colour, name) in enumerate(zip(palette.VIEW_COLOURS, names, strict=True)):
        share = float((open_views == count).mean()) if len(open_views) else 0.0
        legend.append((colour, f"{name} ({share:.0%})"))
    colours = _rgba_colours(palette.VIEW_COLOURS)[views]
    cells = _Cells(colours, shown=ground.open_ground, legend=legend)
    title = "how many sensors see the ground"
    alt = "Map of how many sensors see each place"
    return _draw_cell_map(site, ground, sensors, cells, title=title, alt=alt)


def density_map(site: Site, ground: GroundGrid, sensors: Sequence[Sensor]) -> str:
    """Map the points per m² of ground, of all sensors in a frame, as SVG.

    Density is averaged over squares of `SMOOTHING_SIDE_M`.

    Raises ValueError for a ground of other sensors."""
    from matplotlib.colors import to_hex

    cell_density = ground.density.sum(axis=0, dtype=np.float64)  # over the sensors
    density = smooth(cell_density, ground.open_ground, ground.cell)
    # lowest density (points per m²) of each colour
    colours = palette.point_colours(np.array([0.0, 1, 2, 5, 10, 20, 50, 100]))
    names = ["under 1", *palette.point_names()[1:]]  # the first name is for 0 points
    legend = [(to_hex(colour), f"{name} /m²") for colour, name in zip(colours, names, strict=True)]
    cells = _Cells(palette.point_colours(density), shown=ground.open_ground, legend=legend)
    title = "points on the ground in a frame"
    alt = "Map of the density of points on the ground"
    note = f"; mean over {SMOOTHING_SIDE_M:g} x {SMOOTHING_SIDE_M:g} m"
    return _draw_cell_map(site, ground, sensors, cells, title=title, alt=alt, note=note)


def blind_map(site: Site, ground: GroundGrid, sensors: Sequence[Sensor]) -> str:
    """Map the open ground that no sensor sees as SVG, by kind: lanes, footways and the rest.

    The legend has the area of each kind.

    Raises ValueError if `ground` was computed for other sensors than `sensors`."""
    is_blind = ground.open_ground & (ground.views == 0)
    # index into `palette.BLIND`: lanes, footways, elsewhere
    kinds = np.where(ground.lanes, 0, np.where(ground.footways, 1, 2))
    legend = []
    for kind, (name, colour) in enumerate(palette.BLIND.items()):
        area = float((is_blind & (kinds == kind)).sum()) * ground.cell**2
        legend.append((colour, f"{name}, unseen ({area:.0f} m²)"))
    colours = _rgba_colours(tuple(palette.BLIND.values()))[kinds]
    cells = _Cells(colours, shown=is_blind, legend=legend)
    title = "ground that no sensor sees"
    return _draw_cell_map(site, ground, sensors, cells, title=title, alt="Map of blind spots")


class _Cells(NamedTuple):
    """Cells of a map with their legend.

    colours: red, green, blue and alpha (not used) from 0 to 1; shown: True for
    cells to draw, others are transparent; legend: colours and names."""

    colours: Float64[np.ndarray, "ny nx 4"]
    shown: Bool[np.ndarray, "ny nx"]
    legend: Sequence[tuple[str, str]]


def _draw_cell_map(
    site: Site,
    ground: GroundGrid,
    sensors: Sequence[Sensor],
    cells: _Cells,
    *,
    title: str,
    alt: str,
    note: str = "",
) -> str:
    """Draw a map of coloured cells with streets and sensors, as SVG.

    title: follows the site's name; alt: text for screen readers; note: end of the subtitle. Raises
    ValueError for a ground of other sensors."""
    from matplotlib.patches import Patch

    _check_sensors(ground, sensors)
    count = f"{len(sensors)} sensor{'s' * (len(sensors) != 1)}"
    subtitle = f"N = {count}; rays cast at the empty site, cells of {ground.cell:g} m{note}"
    patches = [
        (Patch(facecolor=colour, edgecolor="#808080", linewidth=0.5), name)
        for colour, name in cells.legend
    ]
    entries = [*patches, *sensor_marks.sensor_entries(sensors)]
    title = canvas.shorten(f"{site.name}: {title}", 70)
    # alpha is 1 for cells to draw
    image = np.concatenate([cells.colours[..., :3], cells.shown[..., None]], axis=-1)
    image = (
        (image * 255)
        .round()
        .astype(np.uint8)
        .repeat(PIXELS_PER_CELL, axis=0)
        .repeat(PIXELS_PER_CELL, axis=1)
    )
    half_cell = ground.cell / 2
    extent = (
        ground.x[0] - half_cell,
        ground.x[-1] + half_cell,
        ground.y[0] - half_cell,
        ground.y[-1] + half_cell,
    )
    with canvas.house_style():
        holds = sensor_marks.sensor_places(sensors)
        sheet = map_sheet.map_sheet(
            site, title, subtitle, holds=holds, legend=entries, inches=MAP_INCHES
        )
        limits = {"xlim": sheet.axes.get_xlim(), "ylim": sheet.axes.get_ylim()}
        sheet.axes.imshow(
            image, extent=extent, origin="lower", interpolation="none", zorder=1.2, aspect="auto"
        )
        sheet.axes.set(**limits)
        lanes = shapely.union_all([shapely.Polygon(lane) for lane in site.lanes])
        for line in shapely.get_parts(shapely.boundary(shapely.simplify(lanes, 0.05))):
            sheet.axes.plot(
                *shapely.get_coordinates(line).T,
                color=palette.INK,
                linewidth=0.5,
                alpha=0.7,
                zorder=1.4,
            )
        sensor_marks.draw_sensors(sheet.axes, sensors, sheet.points_per_metre)
        return canvas.svg_text(sheet.figure, alt)


def smooth(
    values: Float64[np.ndarray, "ny nx"], counted: Bool[np.ndarray, "ny nx"], cell: float
) -> Float64[np.ndarray, "ny nx"]:
    """Return the mean of the counted cells in a square around each cell; 0 if it has none.

    The square has sides of about `SMOOTHING_SIDE_M`, an odd number of cells; beyond the grid there
    are no cells.

    values: figure of each cell; counted: True for cells that take part; cell: side of a cell (m).
    """
    reach = max(0, round((SMOOTHING_SIDE_M / cell - 1) / 2))  # cells from the middle to a side
    counts = sum_squares_around(counted.astype(np.float64), reach)
    totals = sum_squares_around(np.where(counted, values, 0.0), reach)
    return np.where(counts > 0.5, totals / np.maximum(counts, 1), 0.0)  # counts are whole


def _pole_places(site: Site, names: Sequence[str]) -> Float64[np.ndarray, "n 2"]:
    """Return x and y (m) of the feet of poles, in the order of their names.

    Raises ValueError for a name that no pole has."""
    mounts = {mount.name: mount.position[:2] for mount in site.mounts}
    missing_names = [name for name in names if name not in mounts]
    if missing_names:
        raise ValueError(
            f"site {site.name!r} has no pole {missing_names[0]!r}: name some of its {len(mounts)} "
            "mounts"
        )
    return np.array([mounts[name] for name in names], np.float64).reshape(-1, 2)


def _check_sensors(ground: GroundGrid, sensors: Sequence[Sensor]) -> None:
    """Raise ValueError if a ground was cast for another number of sensors."""
    if len(ground.seen) != len(sensors):
        raise ValueError(
            f"the ground has {len(ground.seen)} sensors, got {len(sensors)}: pass the same sensors"
        )


def _rgba_colours(names: Sequence[str]) -> Float64[np.ndarray, "n 4"]:
    """Red, green, blue and alpha (0 to 1) of colours. names: such as #rrggbb."""
    from matplotlib.colors import to_rgba_array

    return np.asarray(to_rgba_array(list(names)), np.float64)
