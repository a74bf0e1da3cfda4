"""View from each planned sensor: the empty site by distance, and the sensor's points on road users
of one moment."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from placement_env.report.content import Moment
from toolkit.arrays import Float, Float64
from toolkit.boxes import points_in_boxes
from toolkit.geometry import invert, transform
from toolkit.plots import canvas
from toolkit.plots.canvas import OUTCOME
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_VIEWS = 8  # pictures of a report
# width of a picture without its margins, and its least height
VIEW_INCHES = 4.8
MIN_VIEW_INCHES = 1.0
MAX_OFF_RAY = 0.02  # between a point's direction and the nearest ray, a chord of the unit sphere
# distances that are shown lightest and darkest
NEAR_M = 3.0
FAR_M = 100.0
TITLE_INCHES = 0.3


def draw_sensor_views(
    site: Site, sensors: Sequence[Sensor], moments: Sequence[Moment]
) -> list[str]:
    """Draw what each sensor sees at the empty site, and its points on the vehicles of the first
    moment, as SVG.

    sensors: those behind the moments' clouds, in order. Points on what is found are green, else
    red."""
    shown = sensors[:MAX_VIEWS]
    backgrounds = Renderer(site, (), shown).background
    return [
        _draw_view(sensor, background, moments[0] if moments else None, index)
        for index, (sensor, background) in enumerate(zip(shown, backgrounds, strict=True))
    ]


def _draw_view(
    sensor: Sensor, background: Float[np.ndarray, "rows columns"], moment: Moment | None, index: int
) -> str:
    rows, columns = background.shape
    height = max(VIEW_INCHES * rows / columns, MIN_VIEW_INCHES)
    with canvas.house_style():
        figure = canvas.blank_figure(VIEW_INCHES, height + TITLE_INCHES)
        share = height / (height + TITLE_INCHES)
        axes = figure.add_axes((0.0, 0.0, 1.0, share))
        axes.set_axis_off()
        axes.imshow(
            _shade(background),
            aspect="auto",
            cmap="gray",
            vmin=0.0,
            vmax=1.0,
            interpolation="nearest",
        )
        if moment is not None:
            _mark_points(axes, sensor, moment, index)
        sides = (columns - 0.5, -0.5) if _starts_right(sensor) else (-0.5, columns - 0.5)
        axes.set(xlim=sides, ylim=(rows - 0.5, -0.5))
        figure.text(
            0.0,
            (1 + share) / 2,
            canvas.plain(sensor.name),
            fontsize=9,
            fontweight="bold",
            va="center",
        )
        return canvas.svg_text(figure, f"What sensor {sensor.name} sees")


def _starts_right(sensor: Sensor) -> bool:
    """True where the first columns of the image look to the right of the sensor, as lidars' do."""
    rays = sensor.model.rays()
    middle = rays[rays.shape[0] // 2] @ sensor.model.body_SE3_sensor[:3, :3].T
    quarter = max(len(middle) // 4, 1)
    return bool(middle[:quarter, 1].sum() < middle[-quarter:, 1].sum())


def _shade(background: Float[np.ndarray, "rows columns"]) -> Float64[np.ndarray, "rows columns"]:
    """Lightness of each pixel: light near by, dark far away, white where nothing returns."""
    measured = np.asarray(background, np.float64)
    there = np.isfinite(measured) & (measured > 0)
    far = np.log(np.clip(np.where(there, measured, NEAR_M), NEAR_M, FAR_M) / NEAR_M) / np.log(
        FAR_M / NEAR_M
    )
    return np.where(there, 0.92 - 0.75 * far, 1.0)


def _mark_points(axes: "Axes", sensor: Sensor, moment: Moment, index: int) -> None:
    cloud = moment.clouds[index]
    if not len(cloud):
        return
    rays = sensor.model.rays().reshape(-1, 3)
    directions = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    local = transform(invert(sensor.pose), cloud.astype(np.float64))
    away, pixel = cKDTree(directions).query(local / np.linalg.norm(local, axis=1, keepdims=True))
    columns = sensor.model.shape[1]
    missed = ~moment.truth_hit & ~moment.truth_ignored
    for boxes, colour in (
        (moment.truth_hit, OUTCOME["hit"].colour),
        (missed, OUTCOME["missed"].colour),
    ):
        inside = points_in_boxes(cloud, moment.truth.boxes[boxes]).any(axis=1) & (
            away <= MAX_OFF_RAY
        )
        row, column = np.divmod(pixel[inside], columns)
        axes.plot(column, row, "s", markersize=1.6, markeredgewidth=0, color=colour)
