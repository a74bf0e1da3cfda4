"""Pixels of an image that stand out from the sensor's empty scene, or are missing.

A pixel in the crop stands out if its measurement is farther than some spreads from both medians of
the scene. A pixel is missing if the centre would draw a point of the empty scene but the sensor
measures no point in the crop: nothing returned, or an object is close to the sensor. Single returns
drop out in every image, and are better drawn than sent. Missing pixels are therefore sent only if,
within 5 x 5 pixels, at least half of the pixels that should show the scene are missing too, and at
least three or all; and everywhere if all pixels are missing."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float32, ImageMask, Int64
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.pixel_clusters import SCENE_SIGMAS
from toolkit.detection.view import Captured, Lift
from toolkit.frame import unproject
from toolkit.grid_sums import sum_squares_around
from toolkit.points import Crop
from toolkit.sensors.sensor import Sensor, is_return

NEIGHBOUR_PX = 2  # to either side that are searched for other missing pixels
MIN_MISSING_NEIGHBOURS = 3  # counting the pixel itself, unless all are missing


class DrawnScene(NamedTuple):
    """Points of an empty scene in the crop, with their pixels.

    points: x, y, z (m), lifted like measured points; pixels: flat index (row by row) of each point,
    ascending."""

    points: Float32[np.ndarray, "n 3"]
    pixels: Int64[np.ndarray, " n"]


class StandsOut(NamedTuple):
    """Pixels of an image that differ from the sensor's empty scene.

    pixels: flat indices (row by row, ascending) of the pixels to send; missing: mask of the pixels
    in which the centre must not draw the empty scene."""

    pixels: Int64[np.ndarray, " n"]
    missing: ImageMask


def standing_out(captured: Captured, scene: EmptyScene, sigmas: float = SCENE_SIGMAS) -> StandsOut:
    """Return the pixels of an image that differ from its empty scene, as flat indices.

    The centre fills all other pixels from the scene. So it must also be told which ones the scene
    would show although nothing was measured there: these are `missing`, kept only if their
    neighbours are missing too.

    captured: image, with the crop that selects its points; scene: the sensor's image without
    objects; sigmas: a measurement within this many standard deviations of the scene shows it."""
    measurement = captured.measurement
    shows_scene = scene.shows(measurement, sigmas)
    # captured.pixels are flat indices of the points in the crop, so masks are raveled (as views)
    sent_pixels = np.sort(captured.pixels[~shows_scene.ravel()[captured.pixels]])
    is_drawn = np.zeros(measurement.shape, bool)
    is_drawn.ravel()[draw_scene(captured, scene).pixels] = True
    is_measured = np.zeros(measurement.shape, bool)
    is_measured.ravel()[captured.pixels] = True
    # the centre would draw the scene's point, but none was measured in the crop
    has_return = is_return(measurement, scene.model.max_range)
    is_gone = is_drawn & ~is_measured & (~shows_scene | ~has_return)
    # `shows_scene` is also True for no return if the scene has none now and then: such pixels are
    # no evidence of an object
    is_expected = is_drawn & ~(is_gone & shows_scene)
    return StandsOut(pixels=sent_pixels, missing=keep_neighbours(is_gone, is_expected))


def draw_scene(captured: Captured, scene: EmptyScene) -> DrawnScene:
    """Points that the centre draws for a sensor that sends nothing: its empty scene, cropped.

    captured: image that defines the sensor's pose, the crop and the lift. Results are cached."""
    crop = Crop.from_place(captured.area, captured.height)
    return _crop_scene(scene, captured.sensor, crop, lift=captured.lift)


@lru_cache(maxsize=64)
def _crop_scene(scene: EmptyScene, sensor: Sensor, crop: Crop, lift: Lift | None) -> DrawnScene:
    """Return the points of a sensor's empty scene that are in a crop, with their pixels.

    lift: applied to the points (m) before the crop, None to leave them. The result is cached, so
    its arrays are shared and must never be changed."""
    # xyz: (3, rows, columns); is_valid: pixels (rows, columns) that have a point
    xyz, is_valid = unproject(sensor, scene.first)
    points = np.ascontiguousarray(xyz[:, is_valid].T)
    lifted_points = points if lift is None else lift(points)
    is_kept = crop.holds(lifted_points)
    return DrawnScene(points=lifted_points[is_kept], pixels=np.flatnonzero(is_valid)[is_kept])


def keep_neighbours(is_gone: ImageMask, is_expected: ImageMask) -> np.ndarray:
    """Return the mask of the gone pixels that have enough gone neighbours within 5 x 5 pixels.

    is_gone: pixels in which the sensor lacks a point of the empty scene; is_expected: pixels that
    should show a point of the scene. Enough are at least half of the expected pixels around, and at
    least `MIN_MISSING_NEIGHBOURS` or all. All gone pixels are kept if every expected one is gone,
    and no pixel if every expected one shows a point."""
    is_missing = is_gone & is_expected
    if not is_missing.any():
        return np.zeros_like(is_gone)
    if is_missing.sum() == is_expected.sum():
        return is_gone
    # in the 5 x 5 pixels around each pixel, itself included; there are none beyond the image
    missing_count = sum_squares_around(is_missing.astype(np.int64), NEIGHBOUR_PX)
    expected_count = sum_squares_around(is_expected.astype(np.int64), NEIGHBOUR_PX)
    is_enough = (missing_count >= MIN_MISSING_NEIGHBOURS) | (missing_count == expected_count)
    return is_gone & (missing_count > 0) & (2 * missing_count >= expected_count) & is_enough
