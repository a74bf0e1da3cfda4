"""Colours of points: by sensor, height, intensity or age."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from toolkit.arrays import UInt8
from toolkit.plots.palette import sensor_colour
from toolkit.viewing.drawn import DrawnCloud, DrawnSample, find_newest
from toolkit.viewing.scene import rgb

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
    impossible: set[Colouring] = set()
    if all(cloud.time is None for cloud in clouds):
        impossible.add("age")
    if all(cloud.intensity is None for cloud in clouds):
        impossible.add("intensity")
    return tuple(colouring for colouring in COLOURINGS if colouring not in impossible)


@dataclass(frozen=True)
class Scales:
    """Ranges of values that the colours span: pairs of lowest and highest.

    height: m; intensity: in the data set's unit; age: s before the newest point of the frame."""

    height: _Span = (0.0, 1.0)
    intensity: _Span = (0.0, 1.0)
    age: _Span = (0.0, 1.0)

    @staticmethod
    def from_sample(sample: DrawnSample) -> "Scales":
        """Choose ranges that cover nearly all points of a frame: 2nd to 98th percentile.

        A range without values stays 0 to 1."""
        spans = {}  # lowest and highest value by colouring
        newest_time = find_newest(sample)
        for colouring in COLOURINGS[1:]:  # all but "sensor", which has no range
            cloud_values = [np.zeros(0)]
            for cloud in sample.clouds:
                values = _find_values(cloud, colouring, newest_time)
                if values is not None:
                    cloud_values.append(values)
            all_values = np.concatenate(cloud_values)
            finite_values = all_values[np.isfinite(all_values)]
            if len(finite_values):
                spans[colouring] = tuple(np.percentile(finite_values, _SPREAD).tolist())
        return Scales(**spans)

    def describe(self, colouring: Colouring) -> str:
        """Text of a colouring and its range, such as "height, -1 to 4 m"."""
        if colouring == "sensor":
            return "sensor"
        low, high = getattr(self, colouring)
        unit = {"height": " m", "age": " s"}.get(colouring, "")
        return f"{colouring}, {low:.3g} to {high:.3g}{unit}"


def _find_values(cloud: DrawnCloud, colouring: Colouring, newest_time: float) -> np.ndarray | None:
    """Value of each point by which it is coloured, None if the data set lacks it.

    colouring: not "sensor"; newest_time: time (s) of the newest point of all the frame's clouds."""
    if colouring == "age":
        return None if cloud.time is None else newest_time - cloud.time
    if colouring == "height":
        return cloud.points[:, 2]  # z
    return cloud.intensity


def colour_points(
    cloud: DrawnCloud,
    colouring: Colouring,
    scales: Scales,
    *,
    sensor_index: int,
    newest_time: float,
) -> UInt8[np.ndarray, "n 3"]:
    """Red, green and blue (0 to 255) of each point of a cloud; dark is low, or new.

    scales: ranges of the colours; sensor_index: gives the colour of the sensor; newest_time: time
    (s) of the newest point of all the frame's clouds (`find_newest`). Points without the attribute
    are grey."""
    from matplotlib import colormaps

    if colouring == "sensor":
        return _repeat_colour(rgb(sensor_colour(sensor_index)), len(cloud.points))
    values = _find_values(cloud, colouring, newest_time)
    if values is None:
        return _repeat_colour(UNKNOWN_SHADE, len(cloud.points))
    low, high = getattr(scales, colouring)
    # place of each value in the range, 0 to 1; 1e-9: no division by 0 for a range of no width
    shares = np.clip((values.astype(np.float64) - low) / max(high - low, 1e-9), 0.0, 1.0)
    # without its bright end, which is hardly seen on white
    viridis = np.asarray(colormaps["viridis"](np.linspace(0.0, 0.92, _STEPS)))
    step_colours = np.round(255 * viridis[:, :3]).astype(np.uint8)  # without opacity
    steps = (shares * (_STEPS - 1)).astype(np.int64)  # index of each point's colour
    return step_colours[steps]


def _repeat_colour(colour: tuple[int, int, int], point_count: int) -> UInt8[np.ndarray, "n 3"]:
    """One colour (red, green, blue) as a row for each point."""
    return np.tile(np.array(colour, np.uint8), (point_count, 1))
