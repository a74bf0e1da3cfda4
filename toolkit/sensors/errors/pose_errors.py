"""Where a sensor is believed to be, and is not: calibration, and the sway of its pole.

The image is right, the cloud is placed with a wrong pose. Normal errors of rotation and translation, drawn once per
sensor, are how robustness to them is measured (V2X-ViT, Xu et al., ECCV 2022: 0.2° and 0.2 m of moving vehicles; what
stands still is calibrated better). A pole is a cantilever: a force at its tip turns the tip by theta and moves it by
2/3 · theta · height (Euler and Bernoulli); light and signal poles swing at about 1 Hz, and bend within minutes with
wind and sun.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from toolkit.arrays import Float64
from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.profile import check_least
from toolkit.sensors.errors.reading import Reading
from toolkit.sensors.model import angle


@dataclass(frozen=True)
class Calibration:
    """Constant over a recording. rotation: root mean square of the angle (rad) by which a sensor is turned, about any
    axis through it; translation: of the distance (m) by which it is displaced, in any direction. Both are normal, about
    and along each axis with a standard deviation smaller by the square root of 3."""

    needs_velocities: ClassVar[bool] = False

    rotation: float = angle(0.0)
    translation: float = 0.0

    def __post_init__(self) -> None:
        check_least(self, rotation=0, translation=0)

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading at the pose that was calibrated."""
        if not (self.rotation or self.translation):
            return reading
        turn, move = draws.of_sensor().standard_normal((2, 3)) / np.sqrt(3)
        error = np.eye(4)
        error[:3, :3] = rotation_about(turn * self.rotation)
        error[:3, 3] = move * self.translation
        return replace(reading, pose=reading.pose @ error)


@dataclass(frozen=True)
class PoleSway:
    """Slow sway. amplitude: by which the tip of a pole turns (rad); period (s), from pole to pole up to a third longer
    or shorter. Direction, period and phase are drawn for each pole, all its sensors sway together.

    To first order a sensor that moved, placed where it stood, is one that stood, placed where it did not: so nothing is
    rendered anew. A pole's foot is taken to be at z = 0.
    """

    needs_velocities: ClassVar[bool] = False

    amplitude: float = angle(0.0)
    period: float = 3.0

    def __post_init__(self) -> None:
        check_least(self, amplitude=0, period=1e-3)

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading at the pose of the pole at rest, at the time of the frame."""
        if not self.amplitude:
            return reading
        position = reading.truth.sensor.position
        towards, phase, longer = draws.of_pole(position).random(3)
        period = self.period * (1 + (2 * longer - 1) / 3)
        theta = self.amplitude * np.sin(2 * np.pi * (reading.truth.time / period + phase))
        ahead = np.array([np.cos(2 * np.pi * towards), np.sin(2 * np.pi * towards), 0.0])
        swayed = reading.pose.copy()
        swayed[:3, :3] = rotation_about(theta * np.array([-ahead[1], ahead[0], 0.0])) @ reading.pose[:3, :3]
        swayed[:3, 3] += 2 / 3 * theta * max(position[2], 0.0) * ahead
        return replace(reading, pose=swayed)


def rotation_about(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """The rotation about a vector by its length (rad): Rodrigues' formula.

    >>> rotation_about(np.array([0, 0, np.pi / 2])).round(6).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    length = float(np.linalg.norm(vector))
    if not length:
        return np.eye(3)
    x, y, z = vector / length
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(length) * skew + (1 - np.cos(length)) * skew @ skew
