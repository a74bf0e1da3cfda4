"""`Draws`: the random numbers of one error term, of one sensor in one frame, from a seed.

A number depends on the seed, on what it is drawn for and on the term, never on how many were drawn before, so that a
sensor measures the same whichever others are used, in any order of sensors, frames and processes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64, Int64

_SENSOR, _FRAME, _OBJECT, _POLE = range(1, 5)  # what a stream of numbers is drawn for


@dataclass(frozen=True)
class Draws:
    """seed: of the recording's errors; sensor: a number that stands for the sensor; frame: its number; term: a number
    that stands for the error term."""

    seed: int
    sensor: int
    frame: int
    term: int

    def own_noise(self) -> np.random.Generator:
        """The generator of the sensor's own noise: that of `toolkit.datasets.dataset.noisy`, to the bit."""
        return np.random.default_rng([self.seed, self.frame, self.sensor])

    def of_frame(self) -> np.random.Generator:
        """A generator for this sensor in this frame."""
        return np.random.default_rng([self.seed, _FRAME, self.frame, self.sensor, self.term])

    def of_sensor(self) -> np.random.Generator:
        """A generator for this sensor, the same in every frame of a recording."""
        return np.random.default_rng([self.seed, _SENSOR, self.sensor, self.term])

    def of_pole(self, position: Float64[np.ndarray, "3"]) -> np.random.Generator:
        """A generator for all sensors over one point of the ground (to the centimetre), the same in every frame."""
        x, y = (int(np.rint(each * 100)) & 0xFFFFFFFF for each in position[:2].tolist())
        return np.random.default_rng([self.seed, _POLE, x, y, self.term])

    def of_objects(self, ids: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """A number of [0, 1) for each track id, the same for all sensors in every frame."""
        words = [self.seed, _OBJECT, self.term]
        drawn = [np.random.default_rng([*words, int(each) & 0xFFFFFFFFFFFFFFFF]).random() for each in ids.tolist()]
        return np.array(drawn, np.float64)
