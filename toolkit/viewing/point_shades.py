"""Colours of points: by sensor, height, intensity or age, on scales that stay the same from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float, UInt8
from toolkit.plots.palette import sensor_colour
from toolkit.viewing.drawn_sample import Colouring, DrawnCloud, DrawnSample

UNKNOWN_SHADE = (150, 150, 150)  # of points without what they are to be coloured by
_SPREAD = (2.0, 98.0)  # percentiles that the scales span
_STEPS = 256

Span = tuple[float, float]


@dataclass(frozen=True)
class Scales:
    """From where to where the colours go: height (m), intensity (as the set gives it), age (s)."""

    height: Span = (0.0, 1.0)
    intensity: Span = (0.0, 1.0)
    age: Span = (0.0, 1.0)

    @staticmethod
    def of(sample: DrawnSample) -> Scales:
        """Such that nearly all points of a sample lie on them."""
        clouds = sample.clouds
        newest = newest_of(sample)
        return Scales(
            _span([cloud.points[:, 2] for cloud in clouds]),
            _span([cloud.intensity for cloud in clouds if cloud.intensity is not None]),
            _span([newest - cloud.time for cloud in clouds if cloud.time is not None]),
        )

    def described(self, colouring: Colouring) -> str:
        """What the colours of a colouring go from and to.

        >>> Scales(height=(-0.1, 3.04)).described("height")
        'height, -0.1 to 3.04 m'
        """
        if colouring == "sensor":
            return "sensor"
        low, high = {"height": self.height, "intensity": self.intensity, "age": self.age}[colouring]
        unit = {"height": " m", "intensity": "", "age": " s"}[colouring]
        return f"{colouring}, {low:.3g} to {high:.3g}{unit}"


def newest_of(sample: DrawnSample) -> float:
    """When the newest point of a sample was measured, seconds from the sample's time; 0 where no time is known."""
    times = [float(cloud.time.max()) for cloud in sample.clouds if cloud.time is not None and len(cloud.time)]
    return max(times, default=0.0)


def shades(
    cloud: DrawnCloud, colouring: Colouring, scales: Scales, *, index: int, newest: float
) -> UInt8[np.ndarray, "n 3"]:
    """Red, green and blue of the points of sensor number `index`; dark is low, or new; newest: as `newest_of`."""
    if colouring == "sensor":
        return _uniform(tuple(bytes.fromhex(sensor_colour(index)[1:])), len(cloud.points))
    age = None if cloud.time is None else newest - cloud.time
    values = {"height": cloud.points[:, 2], "intensity": cloud.intensity, "age": age}[colouring]
    if values is None:
        return _uniform(UNKNOWN_SHADE, len(cloud.points))
    low, high = {"height": scales.height, "intensity": scales.intensity, "age": scales.age}[colouring]
    share = np.clip((values.astype(np.float64) - low) / max(high - low, 1e-9), 0.0, 1.0)
    return _scale()[(share * (_STEPS - 1)).astype(np.int64)]


def _uniform(colour: tuple[int, ...], count: int) -> np.ndarray:
    return np.tile(np.array(colour, np.uint8), (count, 1))


def _scale() -> UInt8[np.ndarray, "_ 3"]:
    """Viridis without its lightest end, which is lost on white."""
    from matplotlib import colormaps

    rgba = np.asarray(colormaps["viridis"](np.linspace(0.0, 0.92, _STEPS)))
    return np.round(255 * rgba[:, :3]).astype(np.uint8)


def _span(columns: list[Float[np.ndarray, " _"]]) -> Span:
    values = np.concatenate([np.zeros(0), *columns])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, _SPREAD).tolist()
    return low, high
