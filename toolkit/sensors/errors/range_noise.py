"""Noise of what is measured: the model's own, and noise that grows with range.

    sigma(z) = constant + proportional · z + quadratic · z²

Stereo: sigma = z² · sigma_d / (f · B), with focal length f and disparity noise sigma_d in pixels and baseline B in
metres (Gallup, Frahm, Mordohai, Pollefeys: Variable baseline/resolution stereo, CVPR 2008). Time of flight: the light
that returns falls with z², so that sigma grows with z where its own shot noise prevails, with z² where ambient light or
electronics do (Lange and Seitz: Solid-state time-of-flight range camera, IEEE J. Quantum Electronics 37, 2001).
Pulsed lidars: data sheets give a constant of 1 to 3 cm; beam divergence and pulse shape add a part that is proportional
(Glennie and Lichti: Static calibration and analysis of the Velodyne HDL-64E S2, Remote Sensing 2, 2010).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.profile import check_least
from toolkit.sensors.errors.reading import Reading
from toolkit.sensors.model import Measure


@dataclass(frozen=True)
class OwnNoise:
    """The noise that the sensor's model says it has, as `toolkit.datasets.dataset.noisy` draws it: of the paper's
    cameras 1.5 cm at every depth."""

    needs_velocities: ClassVar[bool] = False

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading with the model's noise."""
        return reading.measuring(reading.truth.sensor.model.noisy(reading.measurement, draws.own_noise()))


@dataclass(frozen=True)
class RangeNoise:
    """Normal noise, drawn for every pixel and frame, of sigma = constant + proportional · z + quadratic · z² (m), z
    being what is measured. measures: of sensors that measure "depth" or "range" only, None for all."""

    needs_velocities: ClassVar[bool] = False

    constant: float = 0.0
    proportional: float = 0.0
    quadratic: float = 0.0
    measures: Measure | None = None

    def __post_init__(self) -> None:
        check_least(self, constant=0, proportional=0, quadratic=0)
        if self.measures not in (None, "depth", "range"):
            raise ValueError(f"measures must be depth, range or None for all sensors, got {self.measures!r}")

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading with noise added; what noise carries to 0 or behind the sensor is no return."""
        if self.measures not in (None, reading.truth.sensor.model.measures):
            return reading
        if not (self.constant or self.proportional or self.quadratic):
            return reading
        z = np.where(reading.valid, reading.measurement, np.float32(0))
        noise = draws.of_frame().standard_normal(z.shape, dtype=np.float32)
        sigma = np.float32(self.constant) + np.float32(self.proportional) * z + np.float32(self.quadratic) * z**2
        return reading.measuring(np.where(reading.valid, np.maximum(z + noise * sigma, 0), np.float32(0)))


def stereo_noise(*, baseline: float, focal: float, disparity: float = 0.1) -> RangeNoise:
    """Of a stereo camera: baseline (m), focal length and standard deviation of the disparity (pixels).

    >>> round(stereo_noise(baseline=1.0, focal=2000.0).quadratic, 9)
    5e-05
    """
    if not (baseline > 0 and focal > 0):
        raise ValueError(f"baseline and focal length must be above 0, got {baseline} m and {focal} pixels")
    return RangeNoise(quadratic=disparity / (focal * baseline), measures="depth")


def time_of_flight_noise(*, at_10_m: float = 0.02, ambient: float = 0.5) -> RangeNoise:
    """Of a time-of-flight camera: sigma at 10 m (m), and the share of it that ambient light and electronics have."""
    if not 0 <= ambient <= 1:
        raise ValueError(f"ambient must be a share from 0 to 1, got {ambient}")
    return RangeNoise(proportional=at_10_m * (1 - ambient) / 10, quadratic=at_10_m * ambient / 100)


def lidar_noise(*, constant: float = 0.02, proportional: float = 0.0005) -> RangeNoise:
    """Of a lidar, beside the model's own: a constant (m), and a part per metre of range."""
    return RangeNoise(constant=constant, proportional=proportional, measures="range")
