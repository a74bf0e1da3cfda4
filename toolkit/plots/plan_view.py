"""Pictures of the junction from above: the site with its poles and sensors, or one frame on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float, Float64
from toolkit.objects import LABELS, Detections, Objects
from toolkit.plots.base_map import (
    Entry,
    draw_objects,
    draw_outcome,
    draw_poles,
    draw_sensors,
    draw_wedges,
    map_sheet,
    pole_style,
    sensor_labels,
)
from toolkit.plots.canvas import house_style, shorten, write_figure
from toolkit.plots.palette import CLASS, INK, OUTCOME, Outcome, PlotStyle, sensor_colour
from toolkit.sensors.sensor import Sensor

if TYPE_CHECKING:
    from toolkit.sites.site import Site

POINT_SIZE = 1.3  # square points of 1/72 inch


class FrameOutcome(NamedTuple):
    """Outcome of a frame's n truths and m detections. `toolkit.detection.metrics.match` decides. iou: at which a
    detection hits; *_hit: truths and detections that hit; *_ignored: those that do not count."""

    iou: float
    truth_hit: Bool[np.ndarray, " n"]
    truth_ignored: Bool[np.ndarray, " n"]
    detection_hit: Bool[np.ndarray, " m"]
    detection_ignored: Bool[np.ndarray, " m"]


def draw_site(site: Site, out: Path | str) -> None:
    """Draw the site with its poles and sensors. Streets, solids and fields of view are drawn too. The picture is PNG or
    SVG by the suffix."""
    poles = np.array([mount.position[:2] for mount in site.mounts]).reshape(-1, 2)
    with house_style():
        sheet = map_sheet(
            site,
            f"Site {shorten(site.name, 60)}",
            ", ".join(
                f"{n} {word}{'s' * (n != 1)}" for n, word in ((len(site.sensors), "sensor"), (len(poles), "pole"))
            ),
            holds=np.concatenate([poles, sensor_places(site.sensors)]),
            legend=[*ground_entries(site), *pole_entries(unused=len(poles)), *sensor_entries(site.sensors)],
        )
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
    """Draw one frame. Clouds are coloured by sensor, truth is filled by class. The picture is PNG or SVG by the suffix.
    With an `outcome`, hits, misses and false alarms each have a line and a mark of their own. Raises ValueError for an
    outcome of other truths or detections."""
    from matplotlib.patches import Patch

    shown = sensors or site.sensors
    truth, found = truth or Objects.empty(), detections or Detections.empty()
    scored, kinds = "", np.bincount(truth.labels, minlength=len(LABELS))
    filled = zip(LABELS, kinds, strict=True)
    look: PlotStyle = {"edgecolor": INK, "linewidth": 0.5}
    legend: list[Entry] = [(Patch(facecolor=CLASS[name], **look), f"{name} ({n})") for name, n in filled if n]
    if outcome is None:
        outlines: dict[Outcome, np.ndarray] = {"detection": found.boxes} if len(found) else {}
    elif len(outcome.truth_hit) != len(truth) or len(outcome.detection_hit) != len(found):
        given = f"{len(outcome.truth_hit)} truths and {len(outcome.detection_hit)} detections"
        raise ValueError(f"the outcome has {given}, the frame {len(truth)} and {len(found)}: match the same frame")
    else:
        scored = f" ({(~outcome.truth_ignored).sum()} scored)"
        outlines = {
            "hit": found.boxes[outcome.detection_hit],
            "missed": truth.boxes[~outcome.truth_hit & ~outcome.truth_ignored],
            "false alarm": found.boxes[~outcome.detection_hit & ~outcome.detection_ignored],
            "not scored": found.boxes[outcome.detection_ignored],
        }
    for kind, boxes in outlines.items():
        if len(boxes) or kind != "not scored":
            rule = f", IoU ≥ {outcome.iou:g}" if outcome is not None and kind == "hit" else ""
            legend.append(outcome_entry(kind, f"{kind}{rule} ({len(boxes)})"))
    legend += sensor_entries(shown)
    count = f"N = {len(truth)} objects{scored}, {sum(map(len, clouds))} points" if len(truth) or len(clouds) else ""
    with house_style():
        sheet = map_sheet(
            site, shorten(title or f"Site {site.name}", 110), count, holds=sensor_places(shown), legend=legend
        )
        for index, points in enumerate(clouds):
            x, y = points[:, :2].T
            colour = [sensor_colour(index)]
            sheet.axes.scatter(x, y, s=POINT_SIZE, color=colour, linewidths=0, rasterized=True, zorder=3)
        draw_wedges(sheet.axes, shown, site.solids)
        draw_objects(sheet.axes, truth)
        for name, boxes in outlines.items():
            draw_outcome(sheet.axes, boxes, name)
        draw_sensors(sheet.axes, shown, sheet.points_per_metre)
        write_figure(sheet.figure, out)


def sensor_entries(sensors: Sequence[Sensor]) -> list[Entry]:
    """Legend entries of sensors drawn as numbered discs."""
    from matplotlib.lines import Line2D

    names, entries = [sensor.name for sensor in sensors], list[Entry]()
    for index, (name, label) in enumerate(zip(names, sensor_labels(names), strict=True)):
        if name != label:
            mark: PlotStyle = {"marker": "o", "markersize": 8, "markeredgecolor": INK, "linestyle": "none"}
            line = Line2D([], [], color=sensor_colour(index), **mark)
            entries.append((line, f"{label}  {shorten(name, 34)}"))
    return entries


def pole_entries(*, used: int = 0, unused: int = 0) -> list[Entry]:
    """Legend entries of poles, with their numbers."""
    from matplotlib.lines import Line2D

    kinds = ((used, True, "pole with a sensor"), (unused, False, "pole without a sensor" if used else "pole"))
    return [(Line2D([], [], **pole_style(filled)), f"{name} ({count})") for count, filled, name in kinds if count]


def ground_entries(site: Site) -> list[Entry]:
    """Legend entries of the ground and the area's outline."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from toolkit.plots.palette import GROUND, SOLID

    kinds = {solid.kind for solid in site.solids}
    there: tuple[tuple[str, str, object], ...] = (
        *(("lane", GROUND["lanes"], site.lanes), ("footway", GROUND["footways"], site.footways)),
        *((kind, SOLID[kind], kind in kinds) for kind in ("building", "pond")),
        ("trees, hedges", SOLID["tree"], kinds & {"tree", "hedge"}),
    )
    edge: PlotStyle = {"edgecolor": "#b0b0b0", "linewidth": 0.5}
    entries = [(Patch(facecolor=colour, **edge), name) for name, colour, some in there if some]
    return [(Line2D([], [], color=INK, linewidth=1.1, dashes=(8, 2, 2, 2)), "detection area"), *entries]


def outcome_entry(outcome: Outcome, label: str) -> Entry:
    """Legend entry of the boxes of one outcome."""
    from matplotlib.lines import Line2D

    style = OUTCOME[outcome]
    mark: PlotStyle = {"marker": style.marker, "markersize": 0.8 * style.size, "markeredgecolor": "white"}
    return Line2D([], [], color=style.colour, linestyle=style.line, linewidth=style.width, **mark), label


def sensor_places(sensors: Sequence[Sensor]) -> Float64[np.ndarray, "n 2"]:
    """Positions of sensors on the map."""
    return np.array([sensor.position[:2] for sensor in sensors]).reshape(-1, 2)
