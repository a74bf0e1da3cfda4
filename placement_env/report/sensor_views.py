"""Views from planned sensors: the empty site by distance, and points on road users."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from placement_env.report.content import SceneMoment
from toolkit.arrays import Float, Float64
from toolkit.boxes import points_in_boxes
from toolkit.geometry import invert, transform
from toolkit.plots import canvas
from toolkit.plots.palette import OUTCOME
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_VIEWS = 8  # pictures of a report
VIEW_INCHES = 4.8  # width of a picture without its margins
MIN_VIEW_INCHES = 1.0  # height of a picture without its title
MAX_OFF_RAY = 0.02  # from a point's direction to the nearest ray, as a chord of the unit sphere
NEAR_M = 3.0  # distance that is drawn lightest
FAR_M = 100.0  # distance that is drawn darkest
TITLE_INCHES = 0.3


def draw_sensor_views(
    site: Site, sensors: Sequence[Sensor], moments: Sequence[SceneMoment]
) -> list[str]:
    """Draw what each sensor sees at the empty site, and its points on vehicles, as SVG texts.

    There is one picture for each of the first `MAX_VIEWS` sensors. The vehicles are from the first
    moment: points on detected vehicles are green, points on others that count red.

    site: site without vehicles; sensors: the sensors of the moments' clouds, in order; moments:
    frames of traffic, empty for pictures without vehicles."""
    drawn_sensors = sensors[:MAX_VIEWS]
    # distances that each sensor measures at the site without objects
    backgrounds = Renderer(site, (), drawn_sensors).background
    moment = moments[0] if moments else None
    return [
        _draw_view(sensor, backgrounds[index], moment, index)
        for index, sensor in enumerate(drawn_sensors)
    ]


def _draw_view(
    sensor: Sensor,
    background: Float[np.ndarray, "rows columns"],
    moment: SceneMoment | None,
    index: int,
) -> str:
    """Draw the distances that a sensor measures at the empty site, and its points on vehicles.

    background: distances (m) at the empty site; moment: frame with vehicles, None to draw none;
    index: number of the sensor's cloud in the moment. Returns SVG text."""
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
        # the left of the picture is the sensor's left; pixels have their centres at whole numbers
        sides = (columns - 0.5, -0.5) if _starts_right(sensor) else (-0.5, columns - 0.5)
        axes.set(xlim=sides, ylim=(rows - 0.5, -0.5))
        figure.text(
            0.0,
            (1 + share) / 2,
            canvas.replace_unprintable(sensor.name),
            fontsize=9,
            fontweight="bold",
            va="center",
        )
        return canvas.svg_text(figure, f"What sensor {sensor.name} sees")


def _starts_right(sensor: Sensor) -> bool:
    """Return True if the first columns of the image show the sensor's right, as lidars' do.

    The middle row decides; y of the body frame points left."""
    rays = sensor.model.rays()  # axes: row, column, (x, y, z)
    middle_row = rays[rays.shape[0] // 2] @ sensor.model.body_SE3_sensor[:3, :3].T
    left = middle_row[:, 1]  # y of each column's ray
    quarter = max(len(left) // 4, 1)
    return bool(left[:quarter].sum() < left[-quarter:].sum())


def _shade(background: Float[np.ndarray, "rows columns"]) -> Float64[np.ndarray, "rows columns"]:
    """Return the lightness of each pixel from 0 to 1: light near, dark far, white without a return.

    It falls with the logarithm of the distance. background: distances (m), 0 or not finite without
    a return."""
    ranges = np.asarray(background, np.float64)
    has_return = np.isfinite(ranges) & (ranges > 0)
    distance = np.clip(np.where(has_return, ranges, NEAR_M), NEAR_M, FAR_M)
    log_share = np.log(distance / NEAR_M) / np.log(FAR_M / NEAR_M)  # 0 at NEAR_M, 1 at FAR_M
    return np.where(has_return, 0.92 - 0.75 * log_share, 1.0)


def _mark_points(axes: "Axes", sensor: Sensor, moment: SceneMoment, index: int) -> None:
    """Draw points on vehicles at the pixels whose rays are nearest to them.

    Points on detected vehicles are green, points on missed ones red; points on vehicles that do not
    count are left out. axes: with a unit for each pixel; index: number of the sensor's cloud in the
    moment."""
    cloud = moment.clouds[index]
    if not len(cloud):
        return
    # unit directions of rays and points in the sensor's frame
    rays = sensor.model.rays().reshape(-1, 3)
    directions = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    sensor_points = transform(invert(sensor.pose), cloud.astype(np.float64))
    distances = np.linalg.norm(sensor_points, axis=1, keepdims=True)
    point_directions = sensor_points / distances
    # distance to the nearest ray, and the number of its pixel, row by row
    off_ray, pixel = cKDTree(directions).query(point_directions)
    is_on_ray = off_ray <= MAX_OFF_RAY
    _, columns = sensor.model.shape
    is_missed = ~moment.truth_hit & ~moment.truth_ignored
    colours = ((moment.truth_hit, OUTCOME["hit"].colour), (is_missed, OUTCOME["missed"].colour))
    for is_drawn, colour in colours:
        is_inside = points_in_boxes(cloud, moment.truth.boxes[is_drawn]).any(axis=1)
        row, column = np.divmod(pixel[is_inside & is_on_ray], columns)
        axes.plot(column, row, "s", markersize=1.6, markeredgewidth=0, color=colour)
