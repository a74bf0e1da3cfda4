"""Pictures of a site from above, under their titles: streets, solids and the detection area, poles
and sensors, or one frame. The strip below the map holds scale bar, north arrow and legend, so that
none of them covers the map. A sensor is a disc with its number or short name, because there may be
more sensors than colours. An object is filled by its class. Each outcome has a line of its own
besides a colour: a hit is solid, a miss dashed with a cross, a false alarm dash-dotted with a
triangle, an object that does not count dotted."""

from collections.abc import Sequence
from math import ceil, floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Bool, Float, Float64, Mask, Shaped
from toolkit.boxes import footprints
from toolkit.objects import LABELS, Detections, Objects
from toolkit.plots import canvas
from toolkit.plots.canvas import (
    CLASS,
    GROUND,
    INK,
    OUTCOME,
    PAPER_WHITE,
    SOLID,
    Outcome,
    PlotStyle,
    add_legend,
    blank_figure,
    house_style,
    plain,
    sensor_colour,
    shorten,
    write_figure,
)
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid
from toolkit.sites.streets import find_lane_arrows, find_street_names

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Transform


AROUND = 10.0  # m around the area
MOST_INCHES = 10.0  # of the map, in both directions
# inches around the map, and of a row of the legend
LEFT = 0.62
RIGHT = 0.2
HEAD = 0.62
AXIS = 0.5
LEGEND_ROW = 0.22
LANE_ARROW_M = 4.0
LANE_ARROW_INK = "#6b6b70"
LONGEST_STREET_NAME = 40  # letters on a map
SCALE_WIDTH = 2.6  # inches of scale bar and north arrow

Entry = tuple["Artist", str]  # of a legend: artist and name
_Place = Float64[np.ndarray, "2"]


class MapSheet(NamedTuple):
    """A figure with the axes of a map (m, site frame), and the points (1/72 inch) per metre."""

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
    inches: float = MOST_INCHES,
) -> MapSheet:
    """Draw the site from above under its title, without sensors. holds: places that the map must
    include besides the area; legend: its entries, in order; inches: longer side of the map."""
    low, high = extent(site, holds)
    scale = inches / float((high - low).max())
    width, height = ((high - low) * scale).tolist()
    full = max(width + LEFT + RIGHT, 6.5)
    inner = full - LEFT - RIGHT
    longest = max((len(label) for _, label in legend), default=1)
    columns = max(1, min(len(legend), int((inner - SCALE_WIDTH) / (0.058 * longest + 0.58))))
    strip = AXIS + max(0.55, LEGEND_ROW * ceil(len(legend) / columns) + 0.1)
    total = HEAD + height + strip
    figure = blank_figure(full, total)

    def part(left: float, bottom: float, width: float, height: float) -> "Axes":  # inches
        return figure.add_axes((left / full, bottom / total, width / full, height / total))

    axes = part(LEFT + (inner - width) / 2, strip, width, height)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)")
    for spine in axes.spines.values():
        spine.set_visible(True)
    draw_ground(axes, site)
    draw_streets(axes, site, low, high)
    draw_area(axes, site.area)
    figure.text(
        LEFT / full, 1 - 0.26 / total, plain(title), fontsize=12, fontweight="bold", va="center"
    )
    figure.text(LEFT / full, 1 - 0.48 / total, plain(subtitle), fontsize=9, va="center")
    below = part(LEFT, 0.05, inner, strip - AXIS - 0.05)
    below.set_axis_off()
    below.set(xlim=(0, inner), ylim=(-(strip - AXIS - 0.05), 0))
    length = scale_length(min(1.6, width) / scale)
    for start, colour in ((0.0, INK), (0.5, "white")):  # a bar of two halves
        left = start * length * scale
        right = (start + 0.5) * length * scale
        bar = [left, right, right, left]
        below.fill(bar, [-0.2, -0.2, -0.12, -0.12], facecolor=colour, edgecolor=INK, linewidth=0.8)
    for share, label in ((0.0, "0"), (1.0, f"{length:g} m")):
        below.text(
            share * length * scale,
            -0.25,
            label,
            ha="center" if share else "left",
            va="top",
            fontsize=8,
        )
    draw_north(below, (2.2, -0.25), north(site))
    if legend:
        legend_style: PlotStyle = {
            "bbox_to_anchor": (SCALE_WIDTH, 0.0),
            "bbox_transform": below.transData,
        }
        legend_style |= {
            "loc": "upper left",
            "borderaxespad": 0.0,
            "columnspacing": 1.4,
            "handlelength": 2.8,
        }
        handles, labels = zip(*legend, strict=True)
        add_legend(
            below, handles, [plain(label) for label in labels], ncols=columns, **legend_style
        )
    return MapSheet(figure, axes, 72 * scale)


def draw_ground(axes: "Axes", site: Site) -> None:
    """Draw lanes, footways and solids."""
    for kind, colour in GROUND.items():
        fill_polygons(
            axes, [shapely.Polygon(polygon) for polygon in getattr(site, kind)], colour, order=1.0
        )
    by_kind: dict[str, list[shapely.Polygon]] = {kind: [] for kind in ("other", *SOLID)}
    for solid in site.solids:
        by_kind[solid.kind if solid.kind in SOLID else "other"].append(
            shapely.Polygon(solid.footprint)
        )
    for rank, (kind, shapes) in enumerate(by_kind.items()):
        fill_polygons(axes, shapes, SOLID.get(kind, canvas.OTHER_SOLID), order=1.5 + 0.01 * rank)
    drawn = shapely.union_all([shapely.Polygon(solid.footprint) for solid in _drawn_solids(site)])
    hatched: PlotStyle = {"hatch": canvas.DRAWN_HATCH, "edgecolor": canvas.DRAWN_INK}
    for part in shapely.get_parts(drawn):
        outline = shapely.get_coordinates(part.exterior)
        axes.fill(*outline.T, zorder=1.6, facecolor="none", linewidth=0.0, **hatched)


def draw_streets(axes: "Axes", site: Site, low: _Place, high: _Place) -> None:
    """Draw the names of streets, and arrows in the lanes' directions, between two corners of a
    map."""
    from matplotlib.patheffects import withStroke

    head: PlotStyle = {"color": LANE_ARROW_INK, "linewidth": 0.7, "zorder": 1.3}
    for x, y, angle in find_lane_arrows(site, low, high).tolist():
        along = np.array([np.cos(angle), np.sin(angle)])
        aside = np.array([-np.sin(angle), np.cos(angle)])
        tip = np.array([x, y]) + LANE_ARROW_M / 2 * along
        corners = [
            tip - 0.4 * LANE_ARROW_M * along + side * 0.2 * LANE_ARROW_M * aside for side in (1, -1)
        ]
        axes.plot(*np.stack([tip - LANE_ARROW_M * along, tip]).T, **head)
        axes.plot(*np.stack([corners[0], tip, corners[1]]).T, **head)
    halo = [withStroke(linewidth=2.2, foreground=PAPER_WHITE)]
    for street in find_street_names(site, low, high):
        text: PlotStyle = {
            "fontsize": 7.0,
            "ha": "center",
            "va": "center",
            "rotation_mode": "anchor",
            "zorder": 4.5,
        }
        rotation = float(np.rad2deg(street.angle))
        name = plain(shorten(street.name, LONGEST_STREET_NAME))
        axes.text(
            street.x,
            street.y,
            name,
            rotation=rotation,
            color=INK,
            path_effects=halo,
            clip_on=True,
            **text,
        )


def _drawn_solids(site: Site) -> list[Solid]:
    """Solids that maps hatch: drawn ones, unless the whole site is drawn."""
    return [
        s
        for s in site.solids
        if s.origin == "drawn" and s.kind != "trunk" and site.road_origin != "drawn"
    ]


def fill_polygons(
    axes: "Axes",
    shapes: Sequence[shapely.Geometry],
    colour: str,
    *,
    order: float,
    alpha: float = 1.0,
    edge: float = 0.4,
) -> None:
    """Fill the union of polygons in one colour. Its holes stay empty. edge: width of the outline in
    points."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    parts = [
        part
        for part in shapely.get_parts(shapely.union_all(list(shapes)))
        if part.geom_type == "Polygon"
    ]
    turned = [shapely.geometry.polygon.orient(part) for part in parts]
    # holes run the other way round
    rings = [ring for part in turned for ring in (part.exterior, *part.interiors)]
    if not rings:
        return
    outline = Outline.make_compound_path(
        *(Outline(shapely.get_coordinates(ring), closed=True) for ring in rings)
    )
    filled = to_rgba(colour, alpha)
    axes.add_patch(
        PathPatch(outline, facecolor=filled, edgecolor=colour, linewidth=edge, zorder=order)
    )


def draw_area(axes: "Axes", area: Float64[np.ndarray, "4"]) -> None:
    """Draw the outline of the detection area."""
    xmin, ymin, xmax, ymax = area
    outline = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax], [xmin, ymin]])
    axes.plot(*outline.T, color=INK, linewidth=1.1, dashes=(8, 2, 2, 2), zorder=2.0)


def draw_north(
    axes: "Axes", place: tuple[float, float], direction: Float64[np.ndarray, "2"]
) -> None:
    """Draw an arrow that points north through a place of the axes, with the letter at its tip."""
    from matplotlib.transforms import ScaledTranslation

    def away(points: float) -> "Transform":
        x, y = direction * points / 72
        return axes.transData + ScaledTranslation(x, y, axes.figure.dpi_scale_trans)

    style = {
        "arrowstyle": "-|>",
        "color": INK,
        "linewidth": 1.4,
        "shrinkA": 0,
        "shrinkB": 0,
        "mutation_scale": 13,
    }
    axes.annotate(
        "",
        xy=place,
        xycoords=away(11.0),
        xytext=place,
        textcoords=away(-11.0),
        arrowprops=style,
        zorder=9,
    )
    axes.text(
        *place,
        "N",
        transform=away(17.0),
        ha="center",
        va="center",
        fontsize=9,
        fontweight="bold",
        zorder=9,
    )


def north(site: Site) -> Float64[np.ndarray, "2"]:
    """Unit vector towards north, +y of the map, in the site's frame."""
    towards = site.map_SE3_site[1, :2]
    length = float(np.hypot(*towards))
    return towards / length if length > 1e-9 else np.array([0.0, 1.0])


def extent(
    site: Site, holds: Float[np.ndarray, "n 2"] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the area and the places, with a margin."""
    low, high = site.area[:2] - AROUND, site.area[2:] + AROUND
    if holds is not None and len(holds):
        low, high = (
            np.minimum(low, holds.min(axis=0) - AROUND / 2),
            np.maximum(high, holds.max(axis=0) + AROUND / 2),
        )
    return low, high


def scale_length(metres: float) -> float:
    """Largest length up to this one that is 1, 2 or 5 times a power of ten."""
    power = 10.0 ** floor(log10(metres))
    return next(round(step * power, 9) for step in (5, 2, 1) if step * power <= metres * (1 + 1e-9))


VIEW_RANGE = 25.0  # m; fields of view are drawn this far
DISC = 15.0  # diameter of a sensor's disc in points
SHORT = 3  # letters of a name that fit into the disc
TALL = 2.0  # m; buildings above this height cut off fields of view


def sensor_labels(names: Sequence[str]) -> list[str]:
    """Labels on the discs of sensors: their names if all are short, else numbers from 1."""
    if all(len(name) <= SHORT for name in names):
        return list(names)
    return [str(number + 1) for number in range(len(names))]


def draw_sensors(axes: "Axes", sensors: Sequence[Sensor], points_per_metre: float) -> None:
    """Draw a disc for each sensor, with a line for its heading. Discs of sensors in one place
    spread around it."""
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
    """Draw fields of view up to `VIEW_RANGE`, cut off at buildings."""
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
    """Outline of a field of view from above. Each ray ends at the first building that the sensor is
    not in."""
    start = sensor.position[:2]
    view = sensor.model.horizontal_fov
    reach = VIEW_RANGE
    foot = shapely.Point(start)
    blocking = shapely.union_all(
        [b for b in buildings if b.distance(foot) > 0 and b.distance(foot) < reach]
    )
    shapely.prepare(blocking)
    angles = sensor_heading(sensor) + np.linspace(
        -view / 2, view / 2, max(24, int(np.rad2deg(view)) + 1)
    )
    rim = start + reach * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if not blocking.is_empty:
        rays = shapely.linestrings(np.stack([np.broadcast_to(start, rim.shape), rim], axis=1))
        free = shapely.distance(foot, shapely.intersection(rays, blocking))
        rim = start + (rim - start) * (np.where(np.isnan(free), reach, free) / reach)[:, None]
    return rim if view > 2 * np.pi - 1e-6 else np.vstack([start, rim])


def sensor_heading(sensor: Sensor) -> float:
    """Heading of the optical axis, counter-clockwise from +x (rad)."""
    forward = sensor.world_SE3_body[:2, 0]
    return float(np.arctan2(forward[1], forward[0]))


_Places = Float64[np.ndarray, "_ 2"]


def spread_discs(places: _Places, headings: Float64[np.ndarray, " n"], gap: float) -> _Places:
    """Centres of discs `gap` apart, each at its place or, if that is taken, near it, preferably
    along its heading."""
    discs = places.copy()
    turns = np.deg2rad([0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180])
    for k in range(1, len(places)):
        for ring in range(4 * len(places)):
            angles = headings[k] + turns
            around = places[k] + ring * 0.55 * gap * np.stack(
                [np.cos(angles), np.sin(angles)], axis=1
            )
            apart = np.linalg.norm(around[:, None] - discs[None, :k], axis=2).min(axis=1)
            if (apart >= gap * (1 - 1e-9)).any():
                discs[k] = around[int(np.argmax(apart >= gap * (1 - 1e-9)))]
                break
    return discs


def draw_poles(
    axes: "Axes", places: _Places, *, carries_sensor: bool = False, size: float = 6.0
) -> None:
    """Draw poles as squares, filled if they carry a sensor."""
    axes.plot(*places.T, zorder=5, **{**pole_style(carries_sensor), "markersize": size})


def name_poles(
    axes: "Axes", places: _Places, names: Sequence[str], points_per_metre: float, keep_off: _Places
) -> None:
    """Write names beside poles where there is room. Poles, other names and sensors (`keep_off`) may
    take the room."""
    around = [(place * points_per_metre, 4.0) for place in places]
    around += [(place * points_per_metre, DISC / 2 + 1) for place in keep_off]
    occupied = [(*(place - half), *(place + half)) for place, half in around]
    for place, name in zip(places, names, strict=True):
        text = shorten(name, 14)
        width, height = 3.9 * len(text) + 1, 7.5
        x, y = place * points_per_metre
        spots = [
            (x + 5, y - 3.5),
            (x - width - 5, y - 3.5),
            (x - width / 2, y + 5),
            (x - width / 2, y - 12.5),
        ]
        boxes = [(left, low, left + width, low + height) for left, low in spots]
        free = next((box for box in boxes if not _hits_any(box, occupied)), None)
        if free is not None:
            occupied.append(free)
            left, low = np.array(free[:2]) / points_per_metre
            axes.text(left, low, text, fontsize=6.5, va="bottom", zorder=5.5)


def _hits_any(box: tuple[float, ...], obstacles: Sequence[tuple[float, ...]]) -> bool:
    return any(_overlap(box, obstacle) for obstacle in obstacles)


def _overlap(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    return bool(
        first[0] < second[2]
        and second[0] < first[2]
        and first[1] < second[3]
        and second[1] < first[3]
    )


def pole_style(carries_sensor: bool) -> PlotStyle:
    """Matplotlib's properties of a pole."""
    edge: PlotStyle = {
        "marker": "s",
        "markersize": 6.0,
        "markeredgecolor": canvas.POLE_INK,
        "markeredgewidth": 1.3,
    }
    return edge | {
        "markerfacecolor": canvas.POLE_INK if carries_sensor else PAPER_WHITE,
        "linestyle": "none",
    }


def draw_objects(axes: "Axes", objects: Objects) -> None:
    """Draw boxes filled by class."""
    for label, name in enumerate(LABELS):
        class_boxes = objects.boxes[objects.labels == label]
        for corners in footprints(class_boxes):
            axes.fill(*corners.T, facecolor=CLASS[name], edgecolor=INK, linewidth=0.5, zorder=2.6)


def draw_outcome(axes: "Axes", boxes: Shaped[np.ndarray, "n 7"], outcome: Outcome) -> None:
    """Draw boxes that share an outcome: outline, a line from centre to front, and the outcome's
    mark."""
    style = OUTCOME[outcome]
    line: PlotStyle = {
        "color": style.colour,
        "linestyle": style.line,
        "linewidth": style.width,
        "zorder": style.order,
    }
    for corners, yaw in zip(footprints(boxes), boxes[:, 6], strict=True):
        centre = corners.mean(axis=0)
        nose = (
            centre
            + np.array([np.cos(yaw), np.sin(yaw)]) * np.linalg.norm(corners[0] - centre) * 0.9
        )
        axes.plot(*np.vstack([corners, corners[:1]]).T, **line)
        axes.plot(
            *np.vstack([centre, nose]).T, color=style.colour, linewidth=0.8, zorder=style.order
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
    """Black or white, whichever is more legible on a colour by its luminance."""
    red, green, blue = (int(background[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return (
        INK if 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2 > 0.22 else PAPER_WHITE
    )


POINT_SIZE = 1.3  # square points of 1/72 inch


class FrameOutcome(NamedTuple):
    """Outcome of a frame's n truths and m detections. `toolkit.detection.metrics.matches` decides.
    iou: at which a detection hits; *_hit: truths and detections that hit; *_ignored: those that do
    not count."""

    iou: float
    truth_hit: Mask
    truth_ignored: Mask
    detection_hit: Bool[np.ndarray, " m"]
    detection_ignored: Bool[np.ndarray, " m"]


def draw_site(site: Site, out: Path | str) -> None:
    """Draw the site with streets, solids, poles, sensors and their fields of view, as PNG or SVG by
    the suffix."""
    poles = np.array([mount.position[:2] for mount in site.mounts]).reshape(-1, 2)
    counts = ((len(site.sensors), "sensor"), (len(poles), "pole"))
    title = f"Site {shorten(site.name, 60)}"
    counted = ", ".join(f"{n} {word}{'s' * (n != 1)}" for n, word in counts)
    legend = [
        *ground_entries(site),
        *pole_entries(unused=len(poles)),
        *sensor_entries(site.sensors),
    ]
    holds = np.concatenate([poles, sensor_places(site.sensors)])
    with house_style():
        sheet = map_sheet(site, title, counted, holds=holds, legend=legend)
        draw_wedges(sheet.axes, site.sensors, site.solids)
        draw_poles(sheet.axes, poles)
        draw_sensors(sheet.axes, site.sensors, sheet.points_per_metre)
        write_figure(sheet.figure, out)


def draw_frame(
    site: Site,
    out: Path | str,
    *,
    clouds: Sequence[Float[np.ndarray, "_ 3"]] = (),
    sensors: Sequence[Sensor] = (),
    truth: Objects | None = None,
    detections: Detections | None = None,
    outcome: FrameOutcome | None = None,
    title: str = "",
) -> None:
    """Draw one frame. Clouds are coloured by sensor, truth is filled by class. The picture is PNG
    or SVG by the suffix. With an `outcome`, hits, misses and false alarms each have a line and a
    mark of their own. Raises ValueError for an outcome of other truths or detections."""
    from matplotlib.patches import Patch

    drawn_sensors = sensors or site.sensors
    truth = truth or Objects.empty()
    detected = detections or Detections.empty()
    scored = ""
    kinds = np.bincount(truth.labels, minlength=len(LABELS))
    filled = zip(LABELS, kinds, strict=True)
    look: PlotStyle = {"edgecolor": INK, "linewidth": 0.5}
    legend: list[Entry] = [
        (Patch(facecolor=CLASS[name], **look), f"{name} ({n})") for name, n in filled if n
    ]
    if outcome is None:
        outlines: dict[Outcome, np.ndarray] = {"detection": detected.boxes} if len(detected) else {}
    elif len(outcome.truth_hit) != len(truth) or len(outcome.detection_hit) != len(detected):
        counts = f"{len(outcome.truth_hit)} truths and {len(outcome.detection_hit)} detections"
        raise ValueError(
            f"the outcome has {counts}, the frame {len(truth)} and {len(detected)}: match the same "
            "frame"
        )
    else:
        scored = f" ({(~outcome.truth_ignored).sum()} scored)"
        outlines = {
            "hit": detected.boxes[outcome.detection_hit],
            "missed": truth.boxes[~outcome.truth_hit & ~outcome.truth_ignored],
            "false alarm": detected.boxes[~outcome.detection_hit & ~outcome.detection_ignored],
            "not scored": detected.boxes[outcome.detection_ignored],
        }
    for kind, boxes in outlines.items():
        if len(boxes) or kind != "not scored":
            rule = f", IoU ≥ {outcome.iou:g}" if outcome is not None and kind == "hit" else ""
            legend.append(outcome_entry(kind, f"{kind}{rule} ({len(boxes)})"))
    legend += sensor_entries(drawn_sensors)
    count = (
        f"N = {len(truth)} objects{scored}, {sum(map(len, clouds))} points"
        if len(truth) or len(clouds)
        else ""
    )
    title = shorten(title or f"Site {site.name}", 110)
    with house_style():
        sheet = map_sheet(site, title, count, holds=sensor_places(drawn_sensors), legend=legend)
        for index, points in enumerate(clouds):
            x, y = points[:, :2].T
            colour = [sensor_colour(index)]
            sheet.axes.scatter(
                x, y, s=POINT_SIZE, color=colour, linewidths=0, rasterized=True, zorder=3
            )
        draw_wedges(sheet.axes, drawn_sensors, site.solids)
        draw_objects(sheet.axes, truth)
        for name, boxes in outlines.items():
            draw_outcome(sheet.axes, boxes, name)
        draw_sensors(sheet.axes, drawn_sensors, sheet.points_per_metre)
        write_figure(sheet.figure, out)


def sensor_entries(sensors: Sequence[Sensor]) -> list[Entry]:
    """Legend entries of sensors drawn as numbered discs."""
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


def pole_entries(*, used: int = 0, unused: int = 0) -> list[Entry]:
    """Legend entries of poles, with their numbers."""
    from matplotlib.lines import Line2D

    kinds = (
        (used, True, "pole with a sensor"),
        (unused, False, "pole without a sensor" if used else "pole"),
    )
    return [
        (Line2D([], [], **pole_style(filled)), f"{name} ({count})")
        for count, filled, name in kinds
        if count
    ]


def ground_entries(site: Site) -> list[Entry]:
    """Legend entries of the ground and the area's outline."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    kinds = {solid.kind for solid in site.solids}
    present_kinds: tuple[tuple[str, str, object], ...] = (
        *(("lane", GROUND["lanes"], site.lanes), ("footway", GROUND["footways"], site.footways)),
        *((kind, SOLID[kind], kind in kinds) for kind in ("building", "pond")),
        ("trees, hedges", SOLID["tree"], kinds & {"tree", "hedge"}),
    )
    edge: PlotStyle = {"edgecolor": "#b0b0b0", "linewidth": 0.5}
    entries = [
        (Patch(facecolor=colour, **edge), name)
        for name, colour, is_drawn in present_kinds
        if is_drawn
    ]
    if _drawn_solids(site):
        drawn: PlotStyle = {
            "hatch": canvas.DRAWN_HATCH,
            "edgecolor": canvas.DRAWN_INK,
            "linewidth": 0.5,
        }
        entries.append((Patch(facecolor="white", **drawn), "drawn, in no map"))
    return [
        (Line2D([], [], color=INK, linewidth=1.1, dashes=(8, 2, 2, 2)), "detection area"),
        *entries,
    ]


def outcome_entry(outcome: Outcome, label: str) -> Entry:
    """Legend entry of the boxes of one outcome."""
    from matplotlib.lines import Line2D

    style = OUTCOME[outcome]
    mark: PlotStyle = {
        "marker": style.marker,
        "markersize": 0.8 * style.size,
        "markeredgecolor": "white",
    }
    return Line2D(
        [], [], color=style.colour, linestyle=style.line, linewidth=style.width, **mark
    ), label


def sensor_places(sensors: Sequence[Sensor]) -> _Places:
    """Positions of sensors on the map."""
    return np.array([sensor.position[:2] for sensor in sensors]).reshape(-1, 2)
