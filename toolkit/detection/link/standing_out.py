"""What of an image a sensor sends: what stands out from its empty scene, and where nothing is of what the scene has.

A pixel in the crop stands out where its measurement lies farther than some spreads from both medians of the scene. A
pixel is missing where the centre would draw a point of the empty scene, and the sensor has none in the crop: nothing
returned, from a blinded lens or dark wet paint, or something stands close before the sensor, outside the crop. Returns
drop out here and there in every image, and are better drawn than sent: missing pixels are sent where at least half of
those about them (5 x 5) that should show the scene are missing too, three or all of them; and everywhere when all are.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float32, Int64
from toolkit.calibration.empty_scene import SIGMAS, EmptyScene
from toolkit.detection.view import Captured, Lift
from toolkit.points import Crop, cropped, unproject
from toolkit.sensors.model import returned
from toolkit.sensors.sensor import Sensor

COMPANY = 2  # pixels to either side, among which a missing pixel is looked for company
LEAST_COMPANY = 3  # missing pixels, itself among them, unless all are


class DrawnScene(NamedTuple):
    """The points of an empty scene in the crop (world frame), and their pixels, counted row after row."""

    points: Float32[np.ndarray, "n 3"]
    pixels: Int64[np.ndarray, " n"]


class StandsOut(NamedTuple):
    """pixels: those to be sent, counted row after row, ascending; missing: where nothing is of what the scene has."""

    pixels: Int64[np.ndarray, " n"]
    missing: Bool[np.ndarray, "rows columns"]


def standing_out(captured: Captured, scene: EmptyScene, sigmas: float = SIGMAS) -> StandsOut:
    """What a sensor sends of an image."""
    measured, shows = captured.measurement, scene.shows(captured.measurement, sigmas)
    pixels = np.sort(captured.pixels[~shows.ravel()[captured.pixels]])
    drawn = np.zeros(measured.shape, bool)
    drawn.ravel()[drawn_scene(captured, scene).pixels] = True
    here = np.zeros(measured.shape, bool)
    here.ravel()[captured.pixels] = True
    gone = drawn & ~here & (~shows | ~returned(measured, scene.model.max_range))
    return StandsOut(pixels, _in_company(gone, drawn & ~(gone & shows)))


def drawn_scene(captured: Captured, scene: EmptyScene) -> DrawnScene:
    """What the centre draws of the empty scene of a sensor that sends nothing; captured: for sensor and crop."""
    return _drawn(scene, captured.sensor, Crop.of(captured.area, captured.height), captured.lift)


@lru_cache(maxsize=64)
def _drawn(scene: EmptyScene, sensor: Sensor, crop: Crop, lift: Lift | None) -> DrawnScene:
    if lift is None:
        xyz, pixels = cropped(sensor, scene.first, crop)
        return DrawnScene(np.ascontiguousarray(xyz[:, pixels].T), pixels)
    xyz, valid = unproject(sensor, scene.first)
    points = lift(np.ascontiguousarray(xyz[:, valid].T))
    kept = crop.holds(points)
    return DrawnScene(points[kept], np.flatnonzero(valid)[kept])


def _in_company(gone: Bool[np.ndarray, "rows columns"], expected: Bool[np.ndarray, "rows columns"]) -> np.ndarray:
    """The pixels that are gone together with at least half of the expected ones about them."""
    certain = gone & expected
    if not certain.any():
        return np.zeros_like(gone)
    if certain.sum() == expected.sum():
        return gone
    missing, there = _about(certain), _about(expected)
    enough = (missing >= LEAST_COMPANY) | (missing == there)
    return gone & (missing > 0) & (2 * missing >= there) & enough


def _about(mask: Bool[np.ndarray, "rows columns"]) -> Int64[np.ndarray, "rows columns"]:
    """How many pixels of a mask lie in the square about each pixel."""
    side = 2 * COMPANY + 1
    sums = np.pad(np.pad(mask, COMPANY).astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
