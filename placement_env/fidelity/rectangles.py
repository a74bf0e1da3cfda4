"""Rectangles of azimuth and elevation, on a fine grid of places over all directions.

Azimuth is measured from the sensor's heading. A sensor tilted slightly more than a table of rays is
looked up in that table, with the rectangles turned by the difference."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float32

AZIMUTHS = 3600  # places of azimuth in a turn
ELEVATIONS = 3600  # places of elevation from straight down to straight up
PI = np.float32(np.pi)
PER_TURN = np.float32(AZIMUTHS / (2 * np.pi))  # places of azimuth in a radian
PER_STEEP = np.float32(ELEVATIONS / np.pi)  # places of elevation in a radian


class Rectangles(NamedTuple):
    """Rectangles of azimuth and elevation of the world.

    Attributes:
        left: Left edge, in places of azimuth.
        right: Right edge, up to a turn farther.
        low: Lower edge, in places of elevation.
        high: Upper edge.
        cos: Cosine of the azimuth of the middle.
        sin: Sine of the azimuth of the middle.
        tan: Tangent of the elevation of the middle, limited to 3."""

    left: Float32[np.ndarray, " n"]
    right: Float32[np.ndarray, " n"]
    low: Float32[np.ndarray, " n"]
    high: Float32[np.ndarray, " n"]
    cos: Float32[np.ndarray, " n"]
    sin: Float32[np.ndarray, " n"]
    tan: Float32[np.ndarray, " n"]

    @staticmethod
    def of(
        left: np.ndarray, right: np.ndarray, bottom: np.ndarray, top: np.ndarray
    ) -> "Rectangles":
        """Build from angles (n,) (rad, float32)."""
        middle = (left + right) / 2
        tan = np.clip(np.tan((bottom + top) / 2), -3, 3)
        azimuths = (left + PI) * PER_TURN, (right + PI) * PER_TURN
        elevations = (bottom + PI / 2) * PER_STEEP, (top + PI / 2) * PER_STEEP
        return Rectangles(*azimuths, *elevations, np.cos(middle), np.sin(middle), tan)

    def list_places(self, heading: np.float32, more: np.float32) -> tuple[np.ndarray, ...]:
        """Left, right, low and high from the heading on, to first order in the extra tilt of the
        middle."""
        left = self.left - heading
        right = self.right - heading
        if not more:
            return left, right, self.low, self.high
        angle = heading / PER_TURN
        cos, sin = np.cos(angle), np.sin(angle)
        up = more * (self.cos * cos + self.sin * sin)
        aside = (more * PER_TURN / PER_STEEP) * self.tan * (self.sin * cos - self.cos * sin)
        return left + aside, right + aside, self.low + up, self.high + up
