"""`Codec`: messages of points and boxes, and their bits.

To add a codec, write a class with the members of `Codec` and pass an instance,
`codec=MyCodec()`; nothing else needs to know about it. `PAPER` counts as the paper does (section
IV-A): a point costs 3 float32, a box 8 (its 7 numbers and a score), and nothing is lost on the way.
A codec that is also an `ImageCodec` gets the image behind the points if it is known, and the centre
converts the image that arrives to points."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Float32, Float64, ImageRanges, Points, Shaped
from toolkit.objects import Detections
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


@runtime_checkable
class Codec(Protocol):
    """Codec of points and boxes.

    A lossless codec returns the very array that it was given, so that its detections are shared."""

    @property
    def digest(self) -> str:
        """Name and parameters, the key of cached results."""

    def encode_points(self, points: Points, /) -> Message:
        """Encode the points of a sensor in one frame, world frame (m)."""

    def decode_points(self, message: Message, /) -> Float32[np.ndarray, "m 3"]:
        """Decode points that arrive at the fusion centre."""

    def encode_boxes(self, detections: Detections, origin: Origin, /) -> Message:
        """Encode the detections of one sensor in one frame.

        origin: sensor, time and number of the frame."""

    def decode_boxes(self, message: Message, sensor: Sensor, /) -> Detections:
        """Decode detections of a sensor that arrive at the fusion centre."""

    def bits(self, *, points: Amount = 0, boxes: Amount = 0, messages: Amount = 1) -> Amount:
        """Expected bits of messages with some points and boxes.

        points, boxes: numbers of points and boxes in all messages; messages: number of messages.
        Arrays are broadcast."""


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Pixels of a frame's image that a sensor sends.

    sensor: at its assumed pose; measurement: measurements (m), 0 in pixels that are not sent; time,
    number: time (s) and number of the frame."""

    sensor: Sensor
    measurement: ImageRanges
    time: float = 0.0
    number: int = 0


@runtime_checkable
class ImageCodec(Protocol):
    """Extra members of a codec that turns range images into messages and back."""

    def encode_image(self, image: RangeImage, /) -> Message:
        """Encode the pixels of one sensor in one frame that return something."""

    def decode_image(self, message: Message, sensor: Sensor, /) -> ImageRanges:
        """Decode an image of the sensor: measurements (m), 0 in pixels without a measurement."""


class Parameters:
    """Base of dataclasses whose behaviour depends only on their fields."""

    @property
    def digest(self) -> str:
        """Name of the class and its parameters, as in `repr`: the key of cached results."""
        return repr(self)


@dataclass(frozen=True)
class PaperCodec(Parameters):
    """Lossless codec with fixed bits for each point and box.

    Raises ValueError for a cost that is not finite or below 0."""

    bits_per_point: int | float = 96
    bits_per_box: int | float = 256

    def __post_init__(self) -> None:
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
        """Bits of points and boxes, in any number of messages."""
        bits = (
            np.asarray(points, np.float64) * self.bits_per_point
            + np.asarray(boxes) * self.bits_per_box
        )
        return np.asarray(bits)


PAPER = PaperCodec()


def check_codec(codec: Codec) -> Codec:
    """Return the codec; ValueError if it lacks a member of `Codec`."""
    if isinstance(codec, type) or not isinstance(codec, Codec):
        raise ValueError(
            "codec must be an object with the members of toolkit.detection.codec.Codec, got "
            f"{codec!r}"
        )
    return codec
