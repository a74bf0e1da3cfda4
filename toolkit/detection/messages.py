"""Messages from sensors to the fusion centre, and the range images that they may carry."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import ImageRanges, Shaped
from toolkit.sensors.sensor import Sensor

# number, or an array of numbers, of points, boxes, messages or bits
Amount = float | Shaped[np.ndarray, "*shape"]


class Message(NamedTuple):
    """Message from a sensor to the fusion centre.

    content: bytes, or any object that the codec decodes again; bits: bits that the message takes on
    the link."""

    content: Any
    bits: int


class Origin(NamedTuple):
    """Sensor of a message, at its assumed pose, with time (s) and number of the measurement."""

    sensor: Sensor
    time: float = 0.0
    number: int = 0


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Pixels of a frame's image that a sensor sends.

    sensor: at its assumed pose; measurement: measurements (m), 0 in pixels that are not sent; time,
    number: time (s) and number of the frame."""

    sensor: Sensor
    measurement: ImageRanges
    time: float = 0.0
    number: int = 0
