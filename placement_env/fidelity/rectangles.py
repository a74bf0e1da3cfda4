"""Rectangles of azimuth and elevation, on a fine grid of places over all directions.

Azimuth is measured from the sensor's heading. A sensor tilted slightly more than a table of rays is
looked up in that table, with the rectangles turned by the difference."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float32

AZIMUTHS = 3600  # places of azimuth in a turn
ELEVATIONS = 3600  # places of elevation from straight down to straight up
PI = np.float32(np.pi)
AZIMUTHS_PER_RAD = np.float32(AZIMUTHS / (2 * np.pi))  # places of azimuth in a radian
ELEVATIONS_PER_RAD = np.float32(ELEVATIONS / np.pi)  # places of elevation in a radian


class Edges(NamedTuple):
    """Edges of rectangles, in places of a table of rays.

    Attributes:
        left: Edge of the smaller azimuth, in places from straight behind the sensor on.
        right: Edge of the larger azimuth, up to a turn farther.
        low: Lower edge, in places of elevation from straight down on.
        high: Upper edge, in the same places."""

    left: Float32[np.ndarray, " n"]
    right: Float32[np.ndarray, " n"]
    low: Float32[np.ndarray, " n"]
    high: Float32[np.ndarray, " n"]


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
    def from_edges(
        left: np.ndarray, right: np.ndarray, bottom: np.ndarray, top: np.ndarray
    ) -> "Rectangles":
        """Build from edges (rad, float32): azimuths left < right, elevations bottom < top.

        Edges become places in a grid of all directions, from azimuth -π and from straight down."""
        middle = (left + right) / 2
        return Rectangles(
            left=(left + PI) * AZIMUTHS_PER_RAD,
            right=(right + PI) * AZIMUTHS_PER_RAD,
            low=(bottom + PI / 2) * ELEVATIONS_PER_RAD,
            high=(top + PI / 2) * ELEVATIONS_PER_RAD,
            cos=np.cos(middle),
            sin=np.sin(middle),
            # limited, as the tangent has no bound near straight up and down
            tan=np.clip(np.tan((bottom + top) / 2), -3, 3),
        )

    def find_edges(self, heading: np.float32, extra_tilt: np.float32) -> Edges:
        """Edges as a sensor sees them, in places of its table of rays.

        Azimuth is counted from the sensor's heading. All edges of a rectangle are moved by the
        extra tilt as its middle is, to first order.

        Args:
            heading: Heading of the sensor, in places of azimuth.
            extra_tilt: Places of elevation by which the sensor is tilted more than the table."""
        left = self.left - heading
        right = self.right - heading
        if not extra_tilt:
            return Edges(left, right, self.low, self.high)
        angle = heading / AZIMUTHS_PER_RAD
        cos, sin = np.cos(angle), np.sin(angle)
        # cosine and sine of the middle's azimuth, counted from the heading
        middle_cos = self.cos * cos + self.sin * sin
        middle_sin = self.sin * cos - self.cos * sin
        up = extra_tilt * middle_cos
        sideways = (extra_tilt * AZIMUTHS_PER_RAD / ELEVATIONS_PER_RAD) * self.tan * middle_sin
        return Edges(
            left=left + sideways, right=right + sideways, low=self.low + up, high=self.high + up
        )
