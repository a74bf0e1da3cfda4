"""One frame of a recording as a picture from above: points in one colouring, boxes and their
outcomes, sensors."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from toolkit.boxes import footprints
from toolkit.frame import Frame, Recording
from toolkit.objects import Detections, Objects
from toolkit.plots.canvas import (
    FAINT,
    INK,
    OUTCOME,
    PAPER_WHITE,
    Outcome,
    PlotStyle,
    blank_figure,
    house_style,
    sensor_colour,
    shorten,
    write_figure,
)
from toolkit.plots.plan_view import Entry, draw_frame, draw_outcome, outcome_entry
from toolkit.viewing import drawn
from toolkit.viewing.recording_scene import find_view_area

STILL_POINTS = 200_000  # of a cloud
_INCHES = 9.0  # of the greater side of the map
_POINT_SIZE = 1.0  # square points of 1/72 inch
_GRID = 10.0  # m


def write_still(
    sample: drawn.DrawnSample,
    out: str | Path,
    *,
    title: str = "",
    colouring: drawn.Colouring = "sensor",
    sensors: Sequence[str] = (),
    half: tuple[float, float] | None = None,
) -> None:
    """Write a frame as a picture, PNG or SVG by the ending, with the same bytes each time.
    colouring: of points; sensors: names in the order of their colours, the frame's own when empty;
    half: half of the sides (m) of what is shown about the origin, where most points are when
    None."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    xmin, ymin, xmax, ymax = find_view_area(sample) if half is None else (-half[0], -half[1], *half)
    width, height = xmax - xmin, ymax - ymin
    scale = _INCHES / max(width, height)
    scales = drawn.Scales.of(sample)
    newest = drawn.find_newest(sample)
    order = list(sensors or dict.fromkeys(cloud.name for cloud in sample.clouds))
    entries: list[Entry] = []
    with house_style():
        figure = blank_figure(width * scale + 1.2, height * scale + 2.0, constrained=True)
        axes = figure.add_subplot()
        axes.set(
            xlim=(xmin, xmax), ylim=(ymin, ymax), aspect="equal", xlabel="x (m)", ylabel="y (m)"
        )
        axes.set_xticks(_GRID * np.arange(np.ceil(xmin / _GRID), xmax // _GRID + 1))
        axes.set_yticks(_GRID * np.arange(np.ceil(ymin / _GRID), ymax // _GRID + 1))
        axes.grid(True)
        for sample_cloud in sample.clouds:
            cloud = drawn.thinned(sample_cloud, STILL_POINTS)
            colours = (
                drawn.shades(cloud, colouring, scales, index=order.index(cloud.name), newest=newest)
                / 255.0
            )
            x, y, _ = cloud.points.T
            axes.scatter(x, y, s=_POINT_SIZE, c=colours, linewidths=0, rasterized=True, zorder=3)
        labelled = _all(sample.truth)
        for corners in footprints(labelled):
            axes.fill(*corners.T, facecolor="none", edgecolor=FAINT, linewidth=1.0, zorder=3.6)
        if len(labelled):
            entries.append(
                (Patch(facecolor="none", edgecolor=FAINT), f"labelled ({len(labelled)})")
            )
        rows: dict[Outcome, np.ndarray] = {
            drawn.MARKED[name]: _all(boxes) for name, boxes in sample.outcomes.items()
        }
        if not rows and sample.detections:
            rows = {"detection": _all(sample.detections)}
        for outcome, boxes in rows.items():
            draw_outcome(axes, boxes, outcome)
            entries.append(outcome_entry(outcome, f"{outcome} ({len(boxes)})"))
        for tag in sample.tags:
            look: PlotStyle = {
                "color": OUTCOME[tag.outcome].colour,
                "fontsize": 6.5,
                "clip_on": True,
                "zorder": 5.5,
            }
            look["bbox"] = {"facecolor": PAPER_WHITE, "edgecolor": "none", "alpha": 0.7, "pad": 0.4}
            axes.annotate(
                tag.text, tag.place[:2], (0, 7), textcoords="offset points", ha="center", **look
            )
        for cloud in sample.clouds:
            colour = sensor_colour(order.index(cloud.name))
            axes.plot(
                *cloud.place[:2],
                "s",
                color=colour,
                markersize=8,
                markeredgecolor=INK,
                zorder=6,
                clip_on=True,
            )
        for k, name in enumerate(order):
            mark: PlotStyle = {
                "marker": "s",
                "markersize": 7,
                "markeredgecolor": INK,
                "linestyle": "none",
            }
            entries.append((Line2D([], [], color=sensor_colour(k), **mark), shorten(name, 30)))
        figure.suptitle(shorten(title or sample.name, 90), fontsize=11.0)
        axes.set_title(
            shorten(f"{sample.describe()}; points by {scales.describe(colouring)}", 180),
            fontsize=7.5,
        )
        if entries:
            figure.legend(*zip(*entries, strict=True), loc="outside lower center", ncols=4)
        write_figure(figure, out)


def draw_frame_alone(frame: Frame, out: str | Path) -> None:
    """Draw a frame where its points are."""
    view = drawn.Drawing()
    write_still(view.draw(frame, view.origin(frame)), out)


def draw_recording(recording: Recording, out: str | Path) -> None:
    """Draw the first frame of a recording, on its site if that is known. Raises IndexError without
    frames."""
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
    """Draw boxes from above."""
    kinds = drawn.sort_kinds(rows.boxes, rows.labels)
    truth, detections = ({}, kinds) if isinstance(rows, Detections) else (kinds, {})
    write_still(drawn.DrawnSample("boxes", np.nan, (), truth, detections), out)


def _all(boxes: drawn.BoxesByKind) -> np.ndarray:
    return np.concatenate([np.zeros((0, 7)), *boxes.values()])
