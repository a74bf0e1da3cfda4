"""Figures of a sensor: returns per frame, range and noise, as promised and as measured.

The promise is the image of the empty planned site, rendered for each planned sensor, and the noise
of its model in the catalogue. Road users change the number of returns by little: they are in front
of ground that returns anyway."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64, ImageRanges
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.frame import Frame, SensorCloud
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor, SensorModel, is_return
from toolkit.sites.site import Site

RANGE_QUANTILE = 0.95  # share of a sensor's returns within its range
MAX_RANGE_FRAMES = 50  # frames, evenly spread, in which ranges are measured
MIN_SHOWN_SHARE = 0.9  # share of the frames that show a pixel whose noise is measured


@dataclass(frozen=True)
class SensorFigures:
    """Figures of one sensor.

    Attributes:
        returns: returns per frame.
        range_m: distance (m) within which `RANGE_QUANTILE` of the returns are, NaN without any.
        noise_m: median standard deviation (m) of a measurement, NaN if unknown."""

    returns: float
    range_m: float
    noise_m: float


def render_scenes(site: Site) -> dict[str, EmptyScene]:
    """Return the empty scene that each of a site's sensors should see, by name of the sensor."""
    renderer = Renderer(site, (), site.sensors)
    return {
        sensor.name: EmptyScene.from_render(sensor, image)
        for sensor, image in zip(site.sensors, renderer.background, strict=True)
    }


def promise_figures(scene: EmptyScene) -> SensorFigures:
    """Return the figures that a sensor should have. scene: rendered empty scene of the plan."""
    distances = image_distances(scene.first, scene.model)
    return SensorFigures(
        returns=float(len(distances)), range_m=_find_range(distances), noise_m=_find_noise(scene)
    )


def measure_figures(
    frames: Sequence[Frame], name: str, returns: Float64[np.ndarray, " n"], scene: EmptyScene | None
) -> SensorFigures:
    """Return the figures that a sensor has in a recording.

    Args:
        frames: Some frames, in which the range is measured.
        name: Name of the sensor.
        returns: Its number of returns in every frame.
        scene: Its empty scene, learnt from the recording; None if it could not be."""
    distances = [find_distances(frame, name) for frame in frames]
    return SensorFigures(
        returns=float(np.mean(returns)) if len(returns) else 0.0,
        range_m=_find_range(np.concatenate([np.zeros(0), *distances])),
        noise_m=float("nan") if scene is None else _find_noise(scene),
    )


def find_distances(frame: Frame, name: str) -> Float64[np.ndarray, " n"]:
    """Return the distance (m) of each return of a sensor in a frame, none if it is missing."""
    for sensor, measurement in zip(frame.sensors, frame.measurements, strict=True):
        if sensor.name == name:
            return _measured_distances(sensor, measurement)
    return np.zeros(0)


def image_distances(image: ImageRanges, model: SensorModel) -> Float64[np.ndarray, " n"]:
    """Return the distance (m) of each return of an image from the sensor.

    A depth is shorter than the distance, by the length of the pixel's ray."""
    has_return = is_return(image, model.max_range)
    ray_lengths = np.linalg.norm(model.rays()[has_return].astype(np.float64), axis=-1)
    return np.asarray(image[has_return] * ray_lengths, np.float64)


def _measured_distances(
    sensor: Sensor, measurement: ImageRanges | SensorCloud
) -> Float64[np.ndarray, " n"]:
    """Return the distances (m) of a measurement, an image or a cloud."""
    if isinstance(measurement, SensorCloud):
        points = measurement.in_sensor()
        return np.linalg.norm(points[np.isfinite(points).all(axis=1)], axis=1)
    return image_distances(measurement, sensor.model)


def _find_range(distances: Float64[np.ndarray, " n"]) -> float:
    return float(np.quantile(distances, RANGE_QUANTILE)) if len(distances) else float("nan")


def _find_noise(scene: EmptyScene) -> float:
    """Return the median spread (m) of the pixels that nearly always show one surface."""
    is_shown = (scene.first > 0) & (scene.share >= MIN_SHOWN_SHARE)
    return float(np.median(scene.spread[is_shown])) if is_shown.any() else float("nan")
