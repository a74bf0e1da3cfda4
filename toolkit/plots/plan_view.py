"""Pictures of a site from above: its poles and sensors, or one frame."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float, Mask
from toolkit.objects import LABELS, Detections, Objects
from toolkit.plots.canvas import (
    CLASS,
    INK,
    Entry,
    Outcome,
    PlotStyle,
    house_style,
    sensor_colour,
    shorten,
    write_figure,
)
from toolkit.plots.ground_map import ground_entries
from toolkit.plots.map_sheet import map_sheet
from toolkit.plots.outcome_marks import draw_objects, draw_outcome, outcome_entry
from toolkit.plots.pole_marks import draw_poles, pole_entries
from toolkit.plots.sensor_marks import draw_sensors, draw_wedges, sensor_entries, sensor_places
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

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
