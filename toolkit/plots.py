"""Pictures: the junction from above with sensors, clouds, truth and detections; PR curves; density curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float, Int
from toolkit.boxes import footprints
from toolkit.objects import LABELS, Detections, Objects
from toolkit.runtime.files import writing
from toolkit.sensors.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from toolkit.sites.site import Site

TRUTH = {"vehicle": "#d62728", "cyclist": "#2ca02c", "pedestrian": "#1f77b4", "heavy": "#7f7f7f"}
DETECTION_COLOUR = "#111111"
GROUND = {"lanes": "#e3e3e6", "footways": "#f3efe6"}
SOLID = {"building": "#c9c2b8", "pond": "#cfe4ee", "hedge": "#cfe0c3", "tree": "#cfe0c3"}
VIEW_RANGE = 25.0  # metres of a sensor's field of view that are drawn


def sensor_colour(index: int) -> tuple[float, float, float]:
    """The colour of a sensor's points, the same in every picture."""
    from matplotlib import colormaps

    red, green, blue = colormaps["tab10"](index % 10)[:3]
    return red, green, blue


def draw_site(site: Site, out: Path | str) -> None:
    """The site from above: streets, solids, poles, sensors and their fields of view."""
    figure, axes = _canvas(site)
    _sensors(axes, site.sensors)
    _write(figure, out)


def draw_frame(
    site: Site,
    out: Path | str,
    *,
    clouds: Sequence[Float[np.ndarray, "_ 3"]] = (),
    sensors: Sequence[Sensor] = (),
    truth: Objects | None = None,
    detections: Detections | None = None,
    title: str = "",
) -> None:
    """One frame from above: clouds coloured by sensor, truth by class (solid), detections in black (dashed)."""
    figure, axes = _canvas(site)
    for index, points in enumerate(clouds):
        axes.scatter(points[:, 0], points[:, 1], s=0.5, color=[sensor_colour(index)], linewidths=0, rasterized=True)
    _sensors(axes, sensors or site.sensors)
    if truth is not None:
        for label, name in enumerate(LABELS):
            _boxes(axes, truth.boxes[truth.labels == label], TRUTH[name], "solid", f"{name} (truth)")
    if detections is not None:
        _boxes(axes, detections.boxes, DETECTION_COLOUR, "dashed", "detection")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=6, frameon=False, fontsize=8)
    axes.set_title(title, fontsize=10)
    _write(figure, out)


def draw_pr_curves(
    curves: Mapping[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]], out: Path | str, *, title: str = ""
) -> None:
    """Precision over recall; `curves` maps a legend entry to (recall, precision)."""
    figure, axes = _figure(5.5, 4.2)
    for name, (recall, precision) in curves.items():
        axes.plot(recall, precision, label=name, linewidth=1.4)
    axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.01), ylim=(0, 1.01), title=title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="lower left")
    _write(figure, out)


def draw_density_cdf(counts: Mapping[str, Int[np.ndarray, " _"]], out: Path | str) -> None:
    """Share of objects with at most so many points, for each sensor set (paper, impact of point density)."""
    figure, axes = _figure(5.5, 4.2)
    for name, points in counts.items():
        ordered = np.sort(points)
        share = np.arange(1, len(ordered) + 1) / max(len(ordered), 1)
        axes.step(ordered, share, where="post", label=name, linewidth=1.4)
    axes.set(xlabel="points on the object", ylabel="share of objects", xlim=(0, None), ylim=(0, 1.01))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    _write(figure, out)


def draw_training(curves: Mapping[str, tuple[Sequence[float], Sequence[float]]], out: Path | str) -> None:
    """A training's losses.png, and ap.png where AP was measured, into a folder; `curves`: name -> (epochs, values)."""
    for picture, measured in (("losses.png", False), ("ap.png", True)):
        chosen = {name: curve for name, curve in curves.items() if name.startswith("AP") == measured}
        if not chosen:
            continue
        figure, axes = _figure(5.5, 4.2)
        for name, (epochs, values) in chosen.items():
            axes.plot(epochs, values, label=name, linewidth=1.4, marker="." if measured else None)
        axes.set(xlabel="epoch", ylabel="AP" if measured else "loss", yscale="linear" if measured else "log")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
        _write(figure, Path(out) / picture)


def _canvas(site: Site) -> tuple[Figure, Axes]:
    xmin, ymin, xmax, ymax = site.area
    width, height = xmax - xmin + 20, ymax - ymin + 20
    figure, axes = _figure(11.0, 11.0 * height / width + 0.6)
    for kind, colour in GROUND.items():
        for polygon in getattr(site, kind):
            axes.fill(*np.asarray(polygon).T, color=colour, linewidth=0)
    for solid in site.solids:
        axes.fill(*np.asarray(solid.footprint).T, color=SOLID.get(solid.kind, "#9a958c"), linewidth=0, zorder=1.5)
    axes.plot([xmin, xmax, xmax, xmin, xmin], [ymin, ymin, ymax, ymax, ymin], color="#1f4e9c", linewidth=1.2)
    axes.set(xlim=(xmin - 10, xmax + 10), ylim=(ymin - 10, ymax + 10), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    return figure, axes


def _sensors(axes: Axes, sensors: Sequence[Sensor]) -> None:
    for index, sensor in enumerate(sensors):
        x, y, _ = sensor.position
        colour = sensor_colour(index)
        view, forward = sensor.model.horizontal_fov, sensor.world_SE3_body[:2, 0]
        heading = np.arctan2(forward[1], forward[0])
        rim = heading + np.linspace(-view / 2, view / 2, 40)
        edge_x, edge_y = x + VIEW_RANGE * np.cos(rim), y + VIEW_RANGE * np.sin(rim)
        axes.fill(np.r_[x, edge_x], np.r_[y, edge_y], color=colour, alpha=0.07, zorder=2)
        axes.plot(np.r_[x, edge_x, x], np.r_[y, edge_y, y], color=colour, linewidth=0.6, alpha=0.7, zorder=2)
        axes.plot(x, y, "o", color=colour, markersize=8, markeredgecolor="white", zorder=5)
        axes.annotate(sensor.name, (x, y), fontsize=7, xytext=(5, 5), textcoords="offset points", zorder=6)


def _boxes(axes: Axes, boxes: np.ndarray, colour: str, line: str, name: str) -> None:
    for number, (corners, yaw) in enumerate(zip(footprints(boxes), boxes[:, 6], strict=True)):
        ring = np.vstack([corners, corners[:1]])
        label = name if number == 0 else None
        axes.plot(*ring.T, color=colour, linestyle=line, linewidth=1.3, zorder=4, label=label)
        centre = corners.mean(axis=0)
        nose = centre + np.array([np.cos(yaw), np.sin(yaw)]) * np.linalg.norm(corners[0] - centre) * 0.9
        axes.plot(*np.vstack([centre, nose]).T, color=colour, linestyle=line, linewidth=0.9, zorder=4)


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots()


def _write(figure: Figure, out: Path | str) -> None:
    with writing(out) as unfinished:
        figure.savefig(unfinished, dpi=150)
