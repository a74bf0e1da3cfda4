"""Colours of points: by sensor, height, intensity or age."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from toolkit.arrays import UInt8
from toolkit.plots.palette import sensor_colour
from toolkit.viewing.drawn import DrawnCloud, DrawnSample, find_newest

Colouring = Literal["sensor", "height", "intensity", "age"]
COLOURINGS: tuple[Colouring, ...] = ("sensor", "height", "intensity", "age")
UNKNOWN_SHADE = (150, 150, 150)  # for points without the coloured attribute
_SPREAD = (2.0, 98.0)  # percentiles that the scales span
_STEPS = 256  # number of colours of a scale
_Span = tuple[float, float]


def list_colourings(samples: Sequence[DrawnSample]) -> tuple[Colouring, ...]:
    """Colourings that the points of some frames allow, in the order of `COLOURINGS`.

    Intensity and age need a cloud with intensities or times."""
    clouds = [cloud for sample in samples for cloud in sample.clouds]
    timed = any(cloud.time is not None for cloud in clouds)
    bright = any(cloud.intensity is not None for cloud in clouds)
    return tuple(
        colouring
        for colouring in COLOURINGS
        if {"intensity": bright, "age": timed}.get(colouring, True)
    )


@dataclass(frozen=True)
class Scales:
    """Ranges of values that the colours span: pairs of lowest and highest.

    height: m; intensity: in the data set's unit; age: s before the newest point of the frame."""

    height: _Span = (0.0, 1.0)
    intensity: _Span = (0.0, 1.0)
    age: _Span = (0.0, 1.0)

    @staticmethod
    def of(sample: DrawnSample) -> "Scales":
        """Choose ranges that cover nearly all points of a frame: 2nd to 98th percentile.

        A range without values stays 0 to 1."""
        spans = {}
        newest = find_newest(sample)
        for colouring in COLOURINGS[1:]:
            columns = [_values(cloud, colouring, newest) for cloud in sample.clouds]
            values = np.concatenate(
                [np.zeros(0), *(column for column in columns if column is not None)]
            )
            values = values[np.isfinite(values)]
            if len(values):
                spans[colouring] = tuple(np.percentile(values, _SPREAD).tolist())
        return Scales(**spans)

    def describe(self, colouring: Colouring) -> str:
        """Text of a colouring and its range, such as "height, -1 to 4 m"."""
        if colouring == "sensor":
            return "sensor"
        low, high = getattr(self, colouring)
        unit = {"height": " m", "age": " s"}.get(colouring, "")
        return f"{colouring}, {low:.3g} to {high:.3g}{unit}"


def _values(cloud: DrawnCloud, colouring: Colouring, newest: float) -> np.ndarray | None:
    # Value of each point by which it is coloured, None if the set lacks it; newest: time of the
    # newest point of all clouds of the frame (s).
    if colouring == "age":
        return None if cloud.time is None else newest - cloud.time
    return cloud.points[:, 2] if colouring == "height" else cloud.intensity


def shades(
    cloud: DrawnCloud, colouring: Colouring, scales: Scales, *, index: int, newest: float
) -> UInt8[np.ndarray, "n 3"]:
    """Red, green and blue (0 to 255) of each point of a cloud; dark is low, or new.

    scales: ranges of the colours; index: number of the sensor, which gives its colour; newest: time
    of the newest point of all clouds of the frame (s), see `find_newest`. Points without the
    attribute are grey."""
    from matplotlib import colormaps

    values = None if colouring == "sensor" else _values(cloud, colouring, newest)
    if values is None:
        colour = (
            tuple(bytes.fromhex(sensor_colour(index)[1:]))
            if colouring == "sensor"
            else UNKNOWN_SHADE
        )
        return np.tile(np.array(colour, np.uint8), (len(cloud.points), 1))
    low, high = getattr(scales, colouring)
    share = np.clip((values.astype(np.float64) - low) / max(high - low, 1e-9), 0.0, 1.0)
    # without its bright end, which is hardly seen on white
    viridis = np.asarray(colormaps["viridis"](np.linspace(0.0, 0.92, _STEPS)))
    return np.round(255 * viridis[:, :3]).astype(np.uint8)[(share * (_STEPS - 1)).astype(np.int64)]
