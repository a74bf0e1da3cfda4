"""`Codec`: how points and boxes are encoded, what arrives of them at the fusion centre, and how many bits that takes.

A codec of your own is a class with the members of `Codec`; it is passed as an object, `codec=MyCodec()`, and nothing
else needs to know of it. `PAPER` is the paper's counting (section IV-A): a point costs 3 float32, a box 8, its 7
numbers and a score, and nothing is lost on the way.

A codec may code images in place of points: one that is an `ImageCodec` too gets the image that the points were measured
in, wherever that is known, and the centre makes points of the image that arrives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.objects import Detections
from toolkit.sensors.sensor import Sensor


class Message(NamedTuple):
    """What travels from a sensor to the fusion centre. content: bytes, or whatever the codec decodes again."""

    content: Any
    bits: int


@runtime_checkable
class Codec(Protocol):
    """Turns points and boxes into messages and back. A codec that loses nothing hands back the very array it was given,
    so that what was detected in it is shared."""

    @property
    def digest(self) -> str:
        """Name and parameters: what is kept on disk is kept under it."""
        ...

    def encode_points(self, points: Float32[np.ndarray, "n 3"], /) -> Message:
        """Points of one sensor in one frame (m, world frame)."""
        ...

    def decode_points(self, message: Message, /) -> Float32[np.ndarray, "m 3"]:
        """What of them the fusion centre gets."""
        ...

    def encode_boxes(self, detections: Detections, /) -> Message:
        """What one sensor detected in one frame."""
        ...

    def decode_boxes(self, message: Message, /) -> Detections:
        """What of it the fusion centre gets."""
        ...

    def bits(self, *, points: Any = 0, boxes: Any = 0, messages: Any = 1) -> Any:
        """Expected bits of so many messages that hold so many points and boxes together: numbers, or arrays of one
        shape. For fidelities that count points and do not see them; an estimate where the size depends on content."""
        ...


@dataclass(frozen=True, eq=False)
class RangeImage:
    """What one sensor sends of an image: measurements (m), 0 where it sends none; time (s) and number of the frame."""

    sensor: Sensor
    measurement: Float32[np.ndarray, "rows columns"]
    time: float = 0.0
    number: int = 0


@runtime_checkable
class ImageCodec(Protocol):
    """Turns range images into messages and back."""

    def encode_image(self, image: RangeImage, /) -> Message:
        """Some pixels of one sensor in one frame."""
        ...

    def decode_image(self, message: Message, sensor: Sensor, /) -> Float32[np.ndarray, "rows columns"]:
        """What of them the fusion centre gets: an image of the sensor, 0 where nothing arrived."""
        ...


@dataclass(frozen=True)
class PaperCodec:
    """So many bits for each point and box; all arrives as it was sent.

    Raises ValueError for a cost that is not finite or below 0.

    >>> PaperCodec().bits(points=np.array([0, 1000]), boxes=2)
    array([  512., 96512.])
    """

    bits_per_point: int | float = 96
    bits_per_box: int | float = 256

    def __post_init__(self) -> None:
        for name, bits in vars(self).items():
            if isinstance(bits, bool) or not isinstance(bits, int | float) or not 0 <= bits < math.inf:
                raise ValueError(
                    f"{name} must be a finite number of bits, 0 or more, got {bits!r}: the paper has 96, 256"
                )

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    def encode_points(self, points: Float32[np.ndarray, "n 3"], /) -> Message:
        """Points as they are."""
        return Message(points, round(len(points) * self.bits_per_point))

    def decode_points(self, message: Message, /) -> Float32[np.ndarray, "n 3"]:
        """The very points."""
        return message.content

    def encode_boxes(self, detections: Detections, /) -> Message:
        """Boxes as they are."""
        return Message(detections, round(len(detections) * self.bits_per_box))

    def decode_boxes(self, message: Message, /) -> Detections:
        """The very boxes."""
        return message.content

    def bits(self, *, points: Any = 0, boxes: Any = 0, messages: Any = 1) -> Float64[np.ndarray, "*shape"]:
        """Bits of so many points and boxes, in however many messages."""
        bits = np.asarray(points, np.float64) * self.bits_per_point + np.asarray(boxes) * self.bits_per_box
        return np.asarray(bits)


PAPER = PaperCodec()


def check_codec(codec: Codec) -> Codec:
    """The codec, or ValueError where it is none."""
    if isinstance(codec, type) or not isinstance(codec, Codec):
        raise ValueError(f"codec must be an object with the members of toolkit.detection.codec.Codec, got {codec!r}")
    return codec
