"""Mixed pixels: at the edge of a surface a sensor measures a depth between it and what lies behind.

A beam, or the window of a stereo match, that meets two surfaces gives a mean of both weighed by the light of each
(Hebert and Krotkov: 3D measurements from imaging laser radars, Image and Vision Computing 10, 1992; Tang, Huber and
Akinci: A comparative analysis of depth-discontinuity and mixed-pixel detection algorithms, 3DIM 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.profile import check_least, check_share
from toolkit.sensors.errors.reading import Reading

_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))


@dataclass(frozen=True)
class MixedPixels:
    """share: of the pixels beside an edge that are mixed; gap: least difference to a neighbour that is an edge (m);
    reach: largest difference that mixes (m): of pulsed lidars c/2 times the pulse's length, some 1.5 m, beyond which
    they tell two returns apart.

    Of each pixel one of its four neighbours is drawn; if there is an edge between, the measurement lies between both,
    anywhere with the same probability. A neighbour without return mixes nothing.
    """

    needs_velocities: ClassVar[bool] = False

    share: float = 0.0
    gap: float = 0.3
    reach: float = 1000.0

    def __post_init__(self) -> None:
        check_share(self, "share")
        check_least(self, gap=0, reach=0)

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading with mixed pixels."""
        if not self.share:
            return reading
        image, rng = reading.measurement, draws.of_frame()
        side = rng.integers(len(_NEIGHBOURS), size=image.shape)
        mixed, weight = rng.random(image.shape) < self.share, rng.random(image.shape, np.float32)
        other = np.choose(side, [_moved(np.where(reading.valid, image, np.float32(0)), *step) for step in _NEIGHBOURS])
        apart = np.abs(other - image)
        between = reading.valid & (other > 0) & (apart > self.gap) & (apart < self.reach) & mixed
        return reading.measuring(np.where(between, image + weight * (other - image), image))


def _moved(image: np.ndarray, down: int, right: int) -> np.ndarray:
    """Of each pixel the neighbour so far down and to the right, 0 beyond the edge of the image."""
    padded = np.pad(image, 1)
    rows, columns = image.shape
    return padded[1 + down : 1 + down + rows, 1 + right : 1 + right + columns]
