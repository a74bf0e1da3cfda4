"""Pictures of a site from above: its poles and sensors, or one frame."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float, Mask
from toolkit.objects import LABELS, Detections, Objects
from toolkit.plots.canvas import house_style, shorten, write_figure
from toolkit.plots.ground_map import ground_entries
from toolkit.plots.line_style import Entry, Outcome, PlotStyle
from toolkit.plots.map_sheet import map_sheet
from toolkit.plots.outcome_marks import draw_objects, draw_outcome, outcome_entry
from toolkit.plots.palette import CLASS, INK, sensor_colour
from toolkit.plots.pole_marks import draw_poles, pole_entries
from toolkit.plots.sensor_marks import draw_sensors, draw_wedges, sensor_entries, sensor_places
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINT_SIZE = 1.3  # square points of 1/72 inch


class FrameOutcome(NamedTuple):
    """Outcome of a frame's n truths and m detections (`toolkit.detection.metrics.matches`).

    Attributes:
        iou: IoU from which a detection hits.
        truth_hit: mask (n,) of the truths that were found.
        truth_ignored: mask (n,) of the truths that do not count.
        detection_hit: mask (m,) of the detections that hit a truth.
        detection_ignored: mask (m,) of the detections that do not count.
    """

    iou: float
    truth_hit: Mask
    truth_ignored: Mask
    detection_hit: Bool[np.ndarray, " m"]
    detection_ignored: Bool[np.ndarray, " m"]


def draw_site(site: Site, out: Path | str) -> None:
    """Draw the site with its poles and sensors, as PNG or SVG by the suffix."""
    poles = np.array([mount.position[:2] for mount in site.mounts]).reshape(-1, 2)  # x and y (m)
    title = f"Site {shorten(site.name, 60)}"
    counts = ((len(site.sensors), "sensor"), (len(poles), "pole"))
    subtitle = ", ".join(f"{count} {noun}{'s' * (count != 1)}" for count, noun in counts)
    legend = [
        *ground_entries(site),
        *pole_entries(unused=len(poles)),  # one mark for all: nothing is chosen here
        *sensor_entries(site.sensors),
    ]
    shown_places = np.concatenate([poles, sensor_places(site.sensors)])
    with house_style():
        sheet = map_sheet(site, title, subtitle, holds=shown_places, legend=legend)
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
    """Draw one frame of a site from above, as PNG or SVG by the suffix.

    clouds: points (m, site frame) of each sensor; sensors: sensors to draw, the site's if empty;
    truth, detections: objects and detected boxes, None without; outcome: which of them match, None
    to draw all detections alike; title: "" for the site's name.

    Clouds are coloured by sensor, truth is filled by class. With an `outcome`, hits, misses and
    false alarms each have a line and a mark. Raises ValueError for an outcome of other truths or
    detections."""
    drawn_sensors = sensors or site.sensors
    truth = truth or Objects.empty()
    detected = detections or Detections.empty()
    outlines = _sort_outlines(truth, detected, outcome)
    legend = [*_class_entries(truth), *_outline_entries(outlines, outcome)]
    legend += sensor_entries(drawn_sensors)
    subtitle = ""
    if len(truth) or len(clouds):
        scored_text = ""
        if outcome is not None:
            scored_text = f" ({(~outcome.truth_ignored).sum()} scored)"
        subtitle = f"N = {len(truth)} objects{scored_text}, {sum(map(len, clouds))} points"
    title = shorten(title or f"Site {site.name}", 110)
    with house_style():
        sheet = map_sheet(site, title, subtitle, holds=sensor_places(drawn_sensors), legend=legend)
        for index, points in enumerate(clouds):
            _draw_points(sheet.axes, points, sensor_colour(index))
        draw_wedges(sheet.axes, drawn_sensors, site.solids)
        draw_objects(sheet.axes, truth)
        for name, boxes in outlines.items():
            draw_outcome(sheet.axes, boxes, name)
        draw_sensors(sheet.axes, drawn_sensors, sheet.points_per_metre)
        write_figure(sheet.figure, out)


def _sort_outlines(
    truth: Objects, detections: Detections, outcome: FrameOutcome | None
) -> dict[Outcome, np.ndarray]:
    """Boxes to outline by outcome, or all detections if no outcome is known.

    Boxes have the columns x, y, z, length, width, height (m) and yaw (rad). Raises ValueError for
    an outcome of other truths or detections."""
    if outcome is None:
        return {"detection": detections.boxes} if len(detections) else {}
    if len(outcome.truth_hit) != len(truth) or len(outcome.detection_hit) != len(detections):
        counts = f"{len(outcome.truth_hit)} truths and {len(outcome.detection_hit)} detections"
        raise ValueError(
            f"the outcome has {counts}, the frame {len(truth)} and {len(detections)}: match the "
            "same frame"
        )
    is_false = ~outcome.detection_hit & ~outcome.detection_ignored
    return {
        "hit": detections.boxes[outcome.detection_hit],
        "missed": truth.boxes[~outcome.truth_hit & ~outcome.truth_ignored],
        "false alarm": detections.boxes[is_false],
        "not scored": detections.boxes[outcome.detection_ignored],
    }


def _class_entries(truth: Objects) -> list[Entry]:
    """Legend entries of the classes that objects have, with the number of objects."""
    from matplotlib.patches import Patch

    look: PlotStyle = {"edgecolor": INK, "linewidth": 0.5}
    entries: list[Entry] = []
    counts = np.bincount(truth.labels, minlength=len(LABELS))  # objects of each class
    for name, count in zip(LABELS, counts, strict=True):
        if count:
            entries.append((Patch(facecolor=CLASS[name], **look), f"{name} ({count})"))
    return entries


def _outline_entries(
    outlines: dict[Outcome, np.ndarray], outcome: FrameOutcome | None
) -> list[Entry]:
    """Legend entries of outlined boxes, with their numbers.

    outlines: boxes (n, 7) by outcome; outcome: gives the IoU from which a detection hits, None
    without one. "not scored" has no entry if it has no boxes."""
    entries = []
    for kind, boxes in outlines.items():
        if kind == "not scored" and not len(boxes):
            continue
        rule = ""
        if kind == "hit" and outcome is not None:
            rule = f", IoU ≥ {outcome.iou:g}"
        entries.append(outcome_entry(kind, f"{kind}{rule} ({len(boxes)})"))
    return entries


def _draw_points(axes: "Axes", points: Float[np.ndarray, "_ 3"], colour: str) -> None:
    """Draw the points (m, site frame) of one sensor; colour: #rrggbb."""
    x, y = points[:, :2].T
    axes.scatter(x, y, s=POINT_SIZE, color=[colour], linewidths=0, rasterized=True, zorder=3)
