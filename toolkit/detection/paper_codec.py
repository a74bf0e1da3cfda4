"""`PaperCodec`: lossless messages with the paper's fixed bits for each point and box.

It counts as the paper does (section IV-A): a point costs 3 float32, a box 8 (its 7 numbers and a
score)."""

import math
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float32, Float64, Points
from toolkit.detection.messages import Amount, Message, Origin
from toolkit.detection.parameters import Parameters
from toolkit.objects import Detections
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True)
class PaperCodec(Parameters):
    """Lossless codec with fixed bits for each point and box.

    Raises ValueError for a cost that is not finite or below 0."""

    bits_per_point: int | float = 96
    bits_per_box: int | float = 256

    def __post_init__(self) -> None:
        """Raise ValueError for numbers of bits that are negative or not finite."""
        for name, bits in vars(self).items():
            if (
                isinstance(bits, bool)
                or not isinstance(bits, int | float)
                or not 0 <= bits < math.inf
            ):
                raise ValueError(
                    f"{name} must be finite bits, 0 or more, got {bits!r}: the paper has 96, 256"
                )

    def encode_points(self, points: Points, /) -> Message:
        """Return a message that holds the points as they are."""
        return Message(points, round(len(points) * self.bits_per_point))

    def decode_points(self, message: Message, /) -> Float32[np.ndarray, "n 3"]:
        """Return the very array that was encoded."""
        return message.content

    def encode_boxes(self, detections: Detections, origin: Origin | None = None, /) -> Message:
        """Return a message that holds the boxes as they are; origin is not used."""
        return Message(detections, round(len(detections.boxes) * self.bits_per_box))

    def decode_boxes(self, message: Message, sensor: Sensor | None = None, /) -> Detections:
        """Return the very detections that were encoded; sensor is not used."""
        return message.content

    def bits(
        self, *, points: Amount = 0, boxes: Amount = 0, messages: Amount = 1
    ) -> Float64[np.ndarray, "*shape"]:
        """Return the bits of points and boxes; a message itself costs nothing.

        points, boxes: numbers of points and boxes in all messages. Arrays are broadcast."""
        point_bits = np.asarray(points, np.float64) * self.bits_per_point
        return np.asarray(point_bits + np.asarray(boxes) * self.bits_per_box)
