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
        left: Edge of the smaller azimuth, in places of azimuth from -pi on.
        right: Edge of the larger azimuth, up to a turn farther.
        low: Lower edge, in places of elevation from straight down on.
        high: Upper edge, in the same places.
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
        """Build from edges (rad, float32): azimuths left < right, elevations bottom < top."""
        middle = (left + right) / 2
        tan = np.clip(np.tan((bottom + top) / 2), -3, 3)
        azimuths = (left + PI) * PER_TURN, (right + PI) * PER_TURN
        elevations = (bottom + PI / 2) * PER_STEEP, (top + PI / 2) * PER_STEEP
        return Rectangles(*azimuths, *elevations, np.cos(middle), np.sin(middle), tan)

    def list_places(self, heading: np.float32, more: np.float32) -> tuple[np.ndarray, ...]:
        """Edges left, right, low and high as a sensor sees them, in places of its table of rays.

        Azimuth is counted from the sensor's heading. The rectangles are turned by the extra tilt,
        to first order, by as much as their middles.

        Args:
            heading: Heading of the sensor, in places of azimuth.
            more: Places of elevation by which the sensor is tilted more than the table."""
        left = self.left - heading
        right = self.right - heading
        if not more:
            return left, right, self.low, self.high
        angle = heading / PER_TURN
        cos, sin = np.cos(angle), np.sin(angle)
        up = more * (self.cos * cos + self.sin * sin)
        aside = (more * PER_TURN / PER_STEEP) * self.tan * (self.sin * cos - self.cos * sin)
        return left + aside, right + aside, self.low + up, self.high + up
