"""One frame of a recording as a picture from above: points in one colouring, boxes and their
outcomes, sensors."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolkit.boxes import footprints
from toolkit.frame import Frame, Recording
from toolkit.objects import Detections, Objects
from toolkit.plots.canvas import blank_figure, house_style, shorten, write_figure
from toolkit.plots.line_style import Entry, Outcome, PlotStyle
from toolkit.plots.outcome_marks import draw_outcome, outcome_entry
from toolkit.plots.palette import FAINT, INK, OUTCOME, PAPER_WHITE, sensor_colour
from toolkit.plots.plan_view import draw_frame
from toolkit.viewing import drawn
from toolkit.viewing.colouring import Colouring, Scales, colour_points
from toolkit.viewing.drawing import Drawing
from toolkit.viewing.outcomes import MARKED
from toolkit.viewing.recording_scene import find_view_area

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STILL_POINTS = 200_000  # in a cloud
_INCHES = 9.0  # longer side of the map
_POINT_AREA = 1.0  # square points of 1/72 inch
_GRID_M = 10.0


def write_still(
    sample: drawn.DrawnSample,
    out: str | Path,
    *,
    title: str = "",
    colouring: Colouring = "sensor",
    sensors: Sequence[str] = (),
    half: tuple[float, float] | None = None,
) -> None:
    """Write a frame as a picture, PNG or SVG by the ending, with the same bytes each time.

    title: first line above the map, the frame's name when empty; colouring: colouring of points;
    sensors: names in the order of their colours, the frame's when empty; half: half the width and
    height (m) of a map around the origin; None for the area with most points."""
    sensor_order = list(sensors or dict.fromkeys(cloud.name for cloud in sample.clouds))
    scales = Scales.from_sample(sample)
    subtitle = f"{sample.describe()}; points by {scales.describe(colouring)}"
    if half is None:
        area = find_view_area(sample)
    else:
        half_width, half_height = half
        area = (-half_width, -half_height, half_width, half_height)
    with house_style():
        figure, axes = _make_sheet(area)
        _draw_clouds(axes, sample, sensor_order, colouring, scales)
        entries = [*_draw_labels(axes, sample), *_draw_outcomes(axes, sample)]
        _draw_trails(axes, sample)
        _draw_tags(axes, sample.tags)
        entries += _draw_sensors(axes, sample, sensor_order)
        figure.suptitle(shorten(title or sample.name, 90), fontsize=11.0)
        axes.set_title(shorten(subtitle, 180), fontsize=7.5)
        if entries:
            handles, labels = zip(*entries, strict=True)
            figure.legend(handles, labels, loc="outside lower center", ncols=4)
        write_figure(figure, out)


def _make_sheet(area: tuple[float, float, float, float]) -> tuple["Figure", "Axes"]:
    """Figure with axes of an area, with a grid of 10 m; area: xmin, ymin, xmax, ymax (m)."""
    xmin, ymin, xmax, ymax = area
    width = xmax - xmin
    height = ymax - ymin
    scale = _INCHES / max(width, height)  # inches per metre
    # width and height in inches, with room for labels, titles and legend
    figure = blank_figure(width * scale + 1.2, height * scale + 2.0, constrained=True)
    axes = figure.add_subplot()
    axes.set(xlim=(xmin, xmax), ylim=(ymin, ymax), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.set_xticks(_GRID_M * np.arange(np.ceil(xmin / _GRID_M), xmax // _GRID_M + 1))
    axes.set_yticks(_GRID_M * np.arange(np.ceil(ymin / _GRID_M), ymax // _GRID_M + 1))
    axes.grid(True)
    return figure, axes


def _draw_clouds(
    axes: "Axes",
    sample: drawn.DrawnSample,
    sensor_order: list[str],
    colouring: Colouring,
    scales: Scales,
) -> None:
    """Draw the points of all sensors, at most `STILL_POINTS` of each.

    sensor_order: names of sensors in the order of their colours; colouring: what colours show;
    scales: ranges of the colours."""
    newest_time = drawn.find_newest(sample)
    for sample_cloud in sample.clouds:
        cloud = drawn.limit_points(sample_cloud, STILL_POINTS)
        sensor_index = sensor_order.index(cloud.name)
        # red, green and blue from 0 to 1
        colours = (
            colour_points(
                cloud, colouring, scales, sensor_index=sensor_index, newest_time=newest_time
            )
            / 255.0
        )
        x, y, _ = cloud.points.T
        axes.scatter(x, y, s=_POINT_AREA, c=colours, linewidths=0, rasterized=True, zorder=3)


def _draw_labels(axes: "Axes", sample: drawn.DrawnSample) -> list[Entry]:
    """Draw labelled boxes as outlines, and return a legend entry, or none without boxes."""
    from matplotlib.patches import Patch

    boxes = _join_kinds(sample.truth)
    for corners in footprints(boxes):
        axes.fill(*corners.T, facecolor="none", edgecolor=FAINT, linewidth=1.0, zorder=3.6)
    if not len(boxes):
        return []
    return [(Patch(facecolor="none", edgecolor=FAINT), f"labelled ({len(boxes)})")]


def _draw_outcomes(axes: "Axes", sample: drawn.DrawnSample) -> list[Entry]:
    """Draw boxes by outcome, or all detections if outcomes are unknown; return legend entries."""
    # `part`: part of a scene that holds the boxes of one outcome
    boxes_by_outcome: dict[Outcome, np.ndarray] = {
        MARKED[part]: _join_kinds(boxes_by_kind) for part, boxes_by_kind in sample.outcomes.items()
    }
    if not boxes_by_outcome and sample.detections:
        boxes_by_outcome = {"detection": _join_kinds(sample.detections)}
    entries = []
    for outcome, boxes in boxes_by_outcome.items():
        draw_outcome(axes, boxes, outcome)
        entries.append(outcome_entry(outcome, f"{outcome} ({len(boxes)})"))
    return entries


def _draw_trails(axes: "Axes", sample: drawn.DrawnSample) -> None:
    """Draw where tracks were as lines from above; they have no legend entry.

    Each of the frame's trails is a sequence of segments, each with a start and an end (m)."""
    colour = OUTCOME["detection"].colour
    for segments in sample.trails.values():
        for start, end in segments:
            axes.plot(
                [start[0], end[0]], [start[1], end[1]], color=colour, linewidth=1.2, zorder=3.4
            )


def _draw_tags(axes: "Axes", tags: Sequence[drawn.Tag]) -> None:
    """Write the texts of tags above their places, in the colours of their outcomes."""
    for tag in tags:
        look: PlotStyle = {
            "color": OUTCOME[tag.outcome].colour,
            "fontsize": 6.5,
            "clip_on": True,
            "zorder": 5.5,
            "bbox": {"facecolor": PAPER_WHITE, "edgecolor": "none", "alpha": 0.7, "pad": 0.4},
        }
        xy = tag.place[:2]
        axes.annotate(
            tag.text, xy=xy, xytext=(0, 7), textcoords="offset points", ha="center", **look
        )


def _draw_sensors(axes: "Axes", sample: drawn.DrawnSample, sensor_order: list[str]) -> list[Entry]:
    """Draw sensors as squares, and return their legend entries.

    sensor_order: names of sensors in the order of their colours; each has an entry."""
    from matplotlib.lines import Line2D

    look: PlotStyle = {"markersize": 8, "markeredgecolor": INK, "zorder": 6, "clip_on": True}
    for cloud in sample.clouds:
        colour = sensor_colour(sensor_order.index(cloud.name))
        x, y = cloud.place[:2]
        axes.plot(x, y, "s", color=colour, **look)
    legend_look: PlotStyle = {
        "marker": "s",
        "markersize": 7,
        "markeredgecolor": INK,
        "linestyle": "none",
    }
    entries: list[Entry] = []
    for sensor_index, name in enumerate(sensor_order):
        # a mark without a place in the map, for the legend only
        mark = Line2D([], [], color=sensor_colour(sensor_index), **legend_look)
        entries.append((mark, shorten(name, 30)))
    return entries


def draw_frame_alone(frame: Frame, out: str | Path) -> None:
    """Draw a frame from above without a site: its points, sensors and labelled boxes.

    out: picture to write, PNG or SVG by its ending."""
    drawing = Drawing()
    write_still(drawing.draw(frame, drawing.find_origin(frame)), out)


def draw_recording(recording: Recording, out: str | Path) -> None:
    """Draw the first frame of a recording, on the map of its site if that is known.

    out: picture to write, PNG or SVG by its ending. Raises IndexError without frames."""
    frame = recording[0]
    site = recording.site
    if site is None:
        return draw_frame_alone(frame, out)
    clouds = [cloud.in_world() for cloud in frame.clouds]
    title = f"{site.name}: frame 0"
    return draw_frame(
        site, out, clouds=clouds, sensors=frame.sensors, truth=frame.objects, title=title
    )


def draw_boxes(rows: Objects | Detections, out: str | Path) -> None:
    """Draw labelled or detected boxes from above, without points.

    out: picture to write, PNG or SVG by its ending."""
    boxes_by_kind = drawn.sort_kinds(rows.boxes, rows.labels)
    is_detected = isinstance(rows, Detections)
    sample = drawn.DrawnSample(
        name="boxes",
        time=np.nan,
        clouds=(),
        truth={} if is_detected else boxes_by_kind,
        detections=boxes_by_kind if is_detected else {},
    )
    write_still(sample, out)


def _join_kinds(boxes_by_kind: drawn.BoxesByKind) -> np.ndarray:
    """Join the boxes of all kinds into one (n, 7) array."""
    return np.concatenate([np.zeros((0, 7)), *boxes_by_kind.values()])
