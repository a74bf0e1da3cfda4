"""Maps of a plan as SVG text: sensors, coverage and density of the ground, and blind spots. Cells
lie between streets and solids as an image; everything else is lines. The same arguments give the
same text."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from placement_env.candidates.candidates import Candidates
from placement_env.handover.ground import Ground, visible_polygons
from placement_env.report.content import Planned
from toolkit.arrays import Bool, Float64
from toolkit.plots import canvas, plan_view as above
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

MAP_INCHES = 7.0  # of a map's greater side
SMOOTHED = 1.5  # m; side of the square over which density is averaged
ENLARGED = 3  # pixels along a cell's side, because viewers smooth images
NAMED = 30  # poles up to which they are named
STROKE = 0.05  # of a map's extent: length of a heading


def draw_planned(planned: Planned, out: str | Path) -> None:
    """Write the plan view of a plan as a picture."""
    with canvas.house_style():
        canvas.write_figure(
            _plan_sheet(planned.site, planned.site.sensors, planned.ground).figure, out
        )


def draw_pool(candidates: Candidates, out: str | Path) -> None:
    """Draw the mounts of candidates, with a stroke for each direction that some sensor looks in."""
    x, y, _ = np.array([mount.position for mount in candidates.mounts]).reshape(-1, 3).T
    looks = np.unique(candidates.factors[:, [0, 2]], axis=0)
    headings = candidates.axes.headings[looks[:, 1]]
    reach = STROKE * max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    with canvas.house_style():
        height = float(np.clip(5.0 * np.ptp(y) / max(np.ptp(x), 1.0), 1.0, 6.0)) + 1.0
        figure = canvas.blank_figure(6.0, height, constrained=True)
        axes = figure.add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        axes.set_title(f"{len(candidates)} candidate sensors on {len(x)} mounts")
        ends = np.stack([reach * np.cos(headings), reach * np.sin(headings)])
        feet = np.stack([x, y])[:, looks[:, 0]]
        axes.plot(*np.stack([feet, feet + ends], axis=1), color=canvas.BAR, linewidth=0.8)
        above.draw_poles(axes, np.stack([x, y], axis=1))
        for mount in candidates.mounts if len(x) <= NAMED else ():
            axes.annotate(
                mount.name,
                tuple(mount.position[:2]),
                (4, 4),
                textcoords="offset points",
                fontsize=7,
            )
        canvas.write_figure(figure, out)


def plan_view(
    site: Site,
    sensors: Sequence[Sensor],
    poles: Sequence[str] = (),
    poles_unused: Sequence[str] = (),
    ground: Ground | None = None,
) -> str:
    """Draw the site with the chosen sensors, poles (names of mounts), and the ground each sensor
    sees.

    Without `ground`, fields of view up to the first building are drawn. Raises ValueError for an
    unknown pole, and for a ground of other sensors."""
    with canvas.house_style():
        sheet = _plan_sheet(site, sensors, ground, poles, poles_unused)
        return canvas.svg_text(sheet.figure, "Plan view of the chosen sensors")


def _plan_sheet(
    site: Site,
    sensors: Sequence[Sensor],
    ground: Ground | None,
    poles: Sequence[str] = (),
    poles_unused: Sequence[str] = (),
) -> above.MapSheet:
    used, unused = (_places(site, names) for names in (poles, poles_unused))
    entries = above.pole_entries(used=len(used), unused=len(unused))
    legend = [*above.ground_entries(site), *entries, *above.sensor_entries(sensors)]
    subtitle = "coloured: fields of view up to 25 m, cut off at buildings"
    if ground is not None:
        _check(ground, sensors)
        subtitle = "coloured: ground that each sensor sees, by casting rays at the empty site"
    places = above.sensor_places(sensors)
    title = canvas.shorten(f"{site.name}: where the sensors stand", 70)
    holds = np.concatenate([places, used, unused])
    sheet = above.map_sheet(site, title, subtitle, holds=holds, legend=legend, inches=MAP_INCHES)
    if ground is None:
        above.draw_wedges(sheet.axes, sensors, site.solids)
    else:
        open_ground = ground.open_ground  # smoothing drops slivers
        calm = [
            open_ground & (smooth(seen * 1.0, open_ground, ground.cell) > 0.5)
            for seen in ground.seen
        ]
        smoothed = replace(ground, seen=np.array(calm, bool).reshape(ground.seen.shape))
        for index, polygons in enumerate(visible_polygons(smoothed)):
            above.fill_polygons(
                sheet.axes, polygons, canvas.sensor_colour(index), order=2.2, alpha=0.09, edge=1.2
            )
    above.draw_poles(sheet.axes, unused)
    above.draw_poles(sheet.axes, used, used=True)
    if len(unused) <= NAMED:
        above.name_poles(sheet.axes, unused, poles_unused, sheet.points_per_metre, keep_off=places)
    above.draw_sensors(sheet.axes, sensors, sheet.points_per_metre)
    return sheet


def coverage_map(site: Site, ground: Ground, sensors: Sequence[Sensor]) -> str:
    """Map the number of sensors that see each place, up to 3. Raises ValueError for a ground of
    other sensors."""
    views = np.minimum(ground.views, 3)
    shares = [
        float((views[ground.open_ground] == k).mean()) if ground.open_ground.any() else 0.0
        for k in range(4)
    ]
    names = ["no sensor", "1 sensor", "2 sensors", "3 or more"]
    legend = [
        (c, f"{n} ({s:.0%})") for c, n, s in zip(canvas.VIEW_COLOURS, names, shares, strict=True)
    ]
    cells = _Cells(_colours(canvas.VIEW_COLOURS)[views], ground.open_ground, legend)
    title = "how many sensors see the ground"
    alt = "Map of how many sensors see each place"
    return _cell_map(site, ground, sensors, cells, title, alt)


def density_map(site: Site, ground: Ground, sensors: Sequence[Sensor]) -> str:
    """Map the points on the ground, per m², of all sensors in a frame. Raises ValueError for a
    ground of others."""
    density = smooth(ground.density.sum(axis=0, dtype=np.float64), ground.open_ground, ground.cell)
    from matplotlib.colors import to_hex

    steps = map(to_hex, canvas.point_colours(np.array([0.0, 1, 2, 5, 10, 20, 50, 100])))
    legend = [
        (shade, f"{name} /m²")
        for shade, name in zip(steps, ["under 1", *canvas.point_names()[1:]], strict=True)
    ]
    cells = _Cells(canvas.point_colours(density), ground.open_ground, legend)
    title = "points on the ground in a frame"
    alt = "Map of the density of points on the ground"
    return _cell_map(
        site, ground, sensors, cells, title, alt, f"; mean over {SMOOTHED:g} x {SMOOTHED:g} m"
    )


def blind_map(site: Site, ground: Ground, sensors: Sequence[Sensor]) -> str:
    """Map the open ground that no sensor sees, by kind. Raises ValueError for a ground of other
    sensors."""
    blind = ground.open_ground & (ground.views == 0)
    kinds = np.where(ground.lanes, 0, np.where(ground.footways, 1, 2))
    areas = [float((blind & (kinds == k)).sum()) * ground.cell**2 for k in range(3)]
    legend = [
        (canvas.BLIND[k], f"{k}, unseen ({m2:.0f} m²)")
        for k, m2 in zip(canvas.BLIND, areas, strict=True)
    ]
    cells = _Cells(_colours(tuple(canvas.BLIND.values()))[kinds], blind, legend)
    return _cell_map(
        site, ground, sensors, cells, "ground that no sensor sees", "Map of blind spots"
    )


class _Cells(NamedTuple):
    """Cells in their colours; which are shown; colours with their names."""

    colours: Float64[np.ndarray, "ny nx 4"]
    shown: Bool[np.ndarray, "ny nx"]
    legend: Sequence[tuple[str, str]]


def _cell_map(
    site: Site,
    ground: Ground,
    sensors: Sequence[Sensor],
    cells: _Cells,
    title: str,
    alt: str,
    note: str = "",
) -> str:
    from matplotlib.patches import Patch

    _check(ground, sensors)
    count = f"{len(sensors)} sensor{'s' * (len(sensors) != 1)}"
    subtitle = f"N = {count}; rays cast at the empty site, cells of {ground.cell:g} m{note}"
    patches = [
        (Patch(facecolor=colour, edgecolor="#808080", linewidth=0.5), name)
        for colour, name in cells.legend
    ]
    entries = [*patches, *above.sensor_entries(sensors)]
    title = canvas.shorten(f"{site.name}: {title}", 70)
    image = np.concatenate([cells.colours[..., :3], cells.shown[..., None]], axis=-1)
    image = (image * 255).round().astype(np.uint8).repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)
    half = ground.cell / 2
    place = (ground.x[0] - half, ground.x[-1] + half, ground.y[0] - half, ground.y[-1] + half)
    with canvas.house_style():
        holds = above.sensor_places(sensors)
        sheet = above.map_sheet(
            site, title, subtitle, holds=holds, legend=entries, inches=MAP_INCHES
        )
        limits = {"xlim": sheet.axes.get_xlim(), "ylim": sheet.axes.get_ylim()}
        sheet.axes.imshow(
            image, extent=place, origin="lower", interpolation="none", zorder=1.2, aspect="auto"
        )
        sheet.axes.set(**limits)
        lanes = shapely.union_all([shapely.Polygon(lane) for lane in site.lanes])
        for line in shapely.get_parts(shapely.boundary(shapely.simplify(lanes, 0.05))):
            sheet.axes.plot(
                *shapely.get_coordinates(line).T,
                color=canvas.INK,
                linewidth=0.5,
                alpha=0.7,
                zorder=1.4,
            )
        above.draw_sensors(sheet.axes, sensors, sheet.points_per_metre)
        return canvas.svg_text(sheet.figure, alt)


def smooth(
    values: Float64[np.ndarray, "ny nx"], counted: Bool[np.ndarray, "ny nx"], cell: float
) -> Float64[np.ndarray, "ny nx"]:
    """Average the counted cells in a square of side `SMOOTHED` around each cell; 0 without any."""
    reach = max(0, round((SMOOTHED / cell - 1) / 2))

    def box_sums(grid: np.ndarray) -> np.ndarray:
        whole = np.pad(grid.astype(np.float64), reach)
        whole = np.pad(whole.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        side = 2 * reach + 1
        return (
            whole[side:, side:]
            - whole[:-side, side:]
            - whole[side:, :-side]
            + whole[:-side, :-side]
        )

    count = box_sums(counted)
    return np.where(count > 0.5, box_sums(np.where(counted, values, 0)) / np.maximum(count, 1), 0.0)


def _places(site: Site, names: Sequence[str]) -> Float64[np.ndarray, "n 2"]:
    mounts = {mount.name: mount.position[:2] for mount in site.mounts}
    missing = [name for name in names if name not in mounts]
    if missing:
        raise ValueError(
            f"site {site.name!r} has no pole {missing[0]!r}: name some of its {len(mounts)} mounts"
        )
    return np.array([mounts[name] for name in names], np.float64).reshape(-1, 2)


def _check(ground: Ground, sensors: Sequence[Sensor]) -> None:
    if len(ground.seen) != len(sensors):
        raise ValueError(
            f"the ground has {len(ground.seen)} sensors, got {len(sensors)}: pass the same sensors"
        )


def _colours(names: Sequence[str]) -> Float64[np.ndarray, "n 4"]:
    from matplotlib.colors import to_rgba_array

    return np.asarray(to_rgba_array(list(names)), np.float64)
