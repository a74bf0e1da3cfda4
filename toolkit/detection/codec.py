"""`Codec`: messages of points and boxes, and their bits.

To add a codec, write a class with the members of `Codec` and pass an instance,
`codec=MyCodec()`; nothing else needs to know about it. `PAPER` counts as the paper does (section
IV-A): a point costs 3 float32, a box 8 (its 7 numbers and a score), and nothing is lost on the way.
A codec that is also an `ImageCodec` gets the image behind the points if it is known, and the centre
converts the image that arrives to points."""

from typing import Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Float32, ImageRanges, Points
from toolkit.detection.messages import Amount, Message, Origin, RangeImage
from toolkit.detection.paper_codec import PaperCodec
from toolkit.objects import Detections
from toolkit.sensors.sensor import Sensor

PAPER = PaperCodec()


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


@runtime_checkable
class ImageCodec(Protocol):
    """Extra members of a codec that turns range images into messages and back."""

    def encode_image(self, image: RangeImage, /) -> Message:
        """Encode the pixels of one sensor in one frame that return something."""

    def decode_image(self, message: Message, sensor: Sensor, /) -> ImageRanges:
        """Decode an image of the sensor: measurements (m), 0 in pixels without a measurement."""


def check_codec(codec: Codec) -> Codec:
    """Return the codec; ValueError if it lacks a member of `Codec`."""
    if isinstance(codec, type) or not isinstance(codec, Codec):
        raise ValueError(
            "codec must be an object with the members of toolkit.detection.codec.Codec, got "
            f"{codec!r}"
        )
    return codec
