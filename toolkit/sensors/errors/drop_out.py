"""Returns that fail: at random, by range and incidence, and whole rows of the image.

A diffuse surface returns the power P = rho · cos(incidence) / R² (lidar equation: Jelalian, Laser Radar Systems, 1992;
Lambert's law). It is measured where P exceeds a threshold; surfaces differ in rho, here log-logistically, so that

    p(return) = 1 / (1 + (P0 / P)^steepness),   P0: that of a surface at right angles at `half_range`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.profile import check_least, check_share
from toolkit.sensors.errors.reading import Reading


@dataclass(frozen=True)
class DropOut:
    """share: of all returns that fail whatever they show; half_range: the range (m) from which half of the surfaces at
    right angles return, 0 for no loss by range and incidence; steepness: of the law above."""

    needs_velocities: ClassVar[bool] = False

    share: float = 0.0
    half_range: float = 0.0
    steepness: float = 2.0

    def __post_init__(self) -> None:
        check_share(self, "share")
        check_least(self, half_range=0, steepness=0)

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading without what failed."""
        if not (self.share or self.half_range):
            return reading
        kept = np.full(reading.measurement.shape, 1.0 - self.share)
        if self.half_range:
            truth = reading.truth
            kept *= chance_of_return(truth.ranges, truth.cosines, self.half_range, self.steepness)
        return reading.without(draws.of_frame().random(kept.shape) >= kept)


@dataclass(frozen=True)
class DeadRows:
    """share: of the rows of the image that never return anything, drawn for each row of each sensor and constant over a
    recording: lasers or lines of a detector that failed."""

    needs_velocities: ClassVar[bool] = False

    share: float = 0.0

    def __post_init__(self) -> None:
        check_share(self, "share")

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading without these rows."""
        if not self.share:
            return reading
        rows = len(reading.measurement)
        dead = draws.of_sensor().random((rows, 1)) < self.share
        return reading.without(np.broadcast_to(dead, reading.measurement.shape))


def chance_of_return(
    ranges: Float[np.ndarray, "*n"],
    cosines: Float[np.ndarray, "*n"],
    half_range: float,
    steepness: float,
    reflectivity: float | Float[np.ndarray, "*n"] = 1.0,
) -> Float64[np.ndarray, "*n"]:
    """p(return) of surfaces at some ranges (m) and cosines of incidence; reflectivity: against that of others.

    >>> chance_of_return(np.array([0.0, 100.0]), np.array([1.0, 1.0]), 100.0, 2.0).tolist()
    [1.0, 0.5]
    """
    power = np.asarray(reflectivity) * cosines * half_range**2
    lacking = np.asarray(ranges, np.float64) ** 2 / np.maximum(power, 1e-12)
    return 1 / (1 + lacking**steepness)
