"""Augmentations of whole scenes: sensors with errors, fewer points, ground that lies a little off zero or slopes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from models.training.packed import PackedFrames, Rig
from toolkit.arrays import Float, Float32
from toolkit.geometry import levelled
from toolkit.objects import Objects
from toolkit.sensors.errors.drop_out import DeadRows, DropOut
from toolkit.sensors.errors.mixed_pixels import MixedPixels
from toolkit.sensors.errors.pose_errors import Calibration
from toolkit.sensors.errors.profile import ErrorProfile, ErrorTerm
from toolkit.sensors.errors.range_noise import OwnNoise, lidar_noise, stereo_noise
from toolkit.sensors.errors.reading import TrueImage
from toolkit.sensors.errors.vehicle_surfaces import Glass, Paint
from toolkit.sensors.errors.weather import rain
from toolkit.sensors.sensor import Sensor

FEWEST_KEPT = 0.1  # share of the points
LIFT = 0.07  # m, deviation of the ground's height; surveys and imported sites are so far off
SLOPE = 0.006  # deviation of the ground's slope along x and along y; at 20 m that is 12 cm
BEYOND = 150.0  # m: where what stands outside the crop, of which a packed file says nothing, is taken to be


def random_errors(rng: np.random.Generator) -> ErrorProfile:
    """Errors of some strength each, from none to a little more than the profile `poor` has; few examples have all."""

    def strength(chance: float, most: float) -> float:
        return float(rng.uniform(0, most)) if rng.random() < chance else 0.0

    terms: tuple[ErrorTerm, ...] = (
        Glass(share=strength(0.6, 1.0)),
        Paint(share=strength(0.3, 0.4)),
        DropOut(share=strength(0.8, 0.06), half_range=float(rng.uniform(150, 400)) if rng.random() < 0.3 else 0.0),
        MixedPixels(share=strength(0.7, 0.3)),
        rain(strength(0.2, 15.0)),
        DeadRows(share=strength(0.3, 0.04)),
        OwnNoise(),
        stereo_noise(baseline=1.0, focal=2000.0, disparity=strength(0.7, 0.2)),
        lidar_noise(constant=0.0, proportional=strength(0.7, 0.001)),
        Calibration(rotation=float(np.deg2rad(strength(0.8, 0.6))), translation=strength(0.8, 0.06)),
    )
    return ErrorProfile("random", terms)


def with_errors(
    frames: PackedFrames, k: int, errors: ErrorProfile, seed: int, sensors: Iterable[int] | None = None
) -> list[Float32[np.ndarray, "_ 3"]]:
    """Points inside the crop of each chosen sensor (None: all) of frame k, with errors drawn from the seed; as if the
    ground were level."""
    rig, objects = frames.rig(k), frames.objects(k)
    pixels, steps = frames.changed(k)
    chosen = range(len(rig.sensors)) if sensors is None else sensors
    return [_read(rig, s, frames.metres(steps[s]), pixels[s], (objects, errors, seed, k)) for s in chosen]


def _read(
    rig: Rig,
    s: int,
    depth: Float32[np.ndarray, " n"],
    changed: np.ndarray,
    drawn: tuple[Objects, ErrorProfile, int, int],
) -> Float32[np.ndarray, "_ 3"]:
    """Points of sensor s, placed where it is believed to be. What lies outside the crop can mix with what is inside,
    and is not seen itself."""
    objects, errors, seed, k = drawn
    sensor = rig.sensors[s]
    beyond = np.float32(min(BEYOND, 0.99 * sensor.model.max_range))
    image = np.full(sensor.model.shape, beyond)
    flat = image.ravel()
    flat[rig.pixels[s]] = rig.depth[s]
    flat[changed] = np.where(depth > 0, depth, beyond)
    reading = errors.read(TrueImage(sensor, image, objects), seed=seed, sensor=s, frame=k)
    measured = reading.measurement.ravel()
    seen = np.flatnonzero(reading.valid.ravel() & ((flat < beyond) | (measured < 0.9 * beyond))).astype(np.uint32)
    believed = Rig((Sensor(sensor.name, sensor.model, reading.pose),), rig.area, rig.height, (), ())
    points = believed.world(0, seen, measured[seen])
    return levelled(points[rig.in_crop(points)], rig.slope)


def thinned(points: Float32[np.ndarray, "n 3"], rng: np.random.Generator) -> Float32[np.ndarray, "k 3"]:
    """A random share of the points, from a tenth to all of them."""
    return points[rng.random(len(points)) < rng.uniform(FEWEST_KEPT, 1.0)]


def tilted(
    points: Float32[np.ndarray, "n 3"],
    boxes: Float[np.ndarray, "m 7"],
    centre: Float[np.ndarray, "2"],
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "n 3"], Float[np.ndarray, "m 7"]]:
    """Everything on ground that is lifted by N(0, 7 cm) and slopes by N(0, 0.6 %) along x and along y about `centre`.
    Boxes stay upright."""
    lift, slope = rng.normal(0, LIFT), rng.normal(0, SLOPE, 2)
    points, boxes = points.copy(), boxes.copy()
    points[:, 2] += lift + (points[:, :2] - centre) @ slope
    boxes[:, 2] += lift + (boxes[:, :2] - centre) @ slope
    return points, boxes
