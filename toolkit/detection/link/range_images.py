"""`RangeImages`: the codec that sends points as the pixels of the image they were measured in, and boxes, as bytes.

What arrives lies within half a step of what was measured, along the pixel's ray, for every pixel of every image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.detection.codec import Message, RangeImage
from toolkit.detection.link.box_coding import BOX_STEP, decode_boxes, encode_boxes
from toolkit.detection.link.image_coding import decode_pixels, encode_pixels
from toolkit.detection.link.message import (
    OVERHEAD,
    MessageHeader,
    MessageKind,
    check_header,
    read_message,
    sensor_number,
    step_in_mm,
    time_in_us,
    write_message,
)
from toolkit.objects import Detections
from toolkit.sensors.model import SensorModel, returned
from toolkit.sensors.sensor import Sensor

BITS_PER_PIXEL, BITS_PER_BOX = 5.0, 75.0  # expected, at 2 cm; see docs/concepts/messages.md
STEPS = (0.02, 0.04, 0.08)  # m, those that are usual


@dataclass(frozen=True)
class RangeImages:
    """Range images in whole steps (m). Raises ValueError for a step that messages cannot say."""

    step: float = 0.02

    def __post_init__(self) -> None:
        step_in_mm(self.step)

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    def encode_image(self, image: RangeImage, /) -> Message:
        """The pixels of an image that return something, as bytes."""
        sent = returned(image.measurement, image.sensor.model.max_range)
        header = image_header(MessageKind.RANGE_IMAGE, image, self.step)
        content = write_message(header, encode_pixels(to_steps(image.measurement, sent, self.step), sent))
        return Message(content, 8 * len(content))

    def decode_image(self, message: Message, sensor: Sensor, /) -> Float32[np.ndarray, "rows columns"]:
        """The image, 0 where nothing was sent. Raises ValueError for a message that is damaged or of another sensor."""
        header, content = read_message(message.content)
        rows, columns = sensor.model.shape
        expected = {"sensor": sensor_number(sensor.name), "rows": rows, "columns": columns}
        check_header(header, MessageKind.RANGE_IMAGE, **expected)
        return from_steps(*decode_pixels(content, (rows, columns)), header.step, sensor.model)

    def encode_points(self, points: Float32[np.ndarray, "n 3"], /) -> Message:
        """Raises ValueError: points alone do not say which pixels they are."""
        raise ValueError(
            f"{self} sends images, got {len(points)} points alone: take PaperCodec where there are no images"
        )

    def decode_points(self, message: Message, /) -> Float32[np.ndarray, "m 3"]:
        """Raises ValueError, as `encode_points`."""
        raise ValueError(f"{self} sends images, got points of {message.bits} bits")

    def encode_boxes(self, detections: Detections, /) -> Message:
        """Boxes in steps of 2 cm and 0.5°, as bytes."""
        content = write_message(
            MessageHeader(MessageKind.BOXES, step_mm=step_in_mm(BOX_STEP)), encode_boxes(detections)
        )
        return Message(content, 8 * len(content))

    def decode_boxes(self, message: Message, /) -> Detections:
        """The boxes. Raises ValueError for a message that is damaged."""
        header, content = read_message(message.content)
        check_header(header, MessageKind.BOXES, step_mm=step_in_mm(BOX_STEP))
        return decode_boxes(content)

    def bits(self, *, points: Any = 0, boxes: Any = 0, messages: Any = 1) -> Float64[np.ndarray, "*shape"]:
        """Expected bits: an estimate, since the size of a message depends on what it shows."""
        content = np.asarray(points, np.float64) * BITS_PER_PIXEL + np.asarray(boxes) * BITS_PER_BOX
        return np.asarray(content + np.asarray(messages) * 8.0 * OVERHEAD)


def image_header(kind: MessageKind, image: RangeImage, step: float, scene: int = 0) -> MessageHeader:
    """The header of a message that holds an image."""
    rows, columns = image.sensor.model.shape
    return MessageHeader(
        kind,
        sensor_number(image.sensor.name),
        image.number,
        time_in_us(image.time),
        step_in_mm(step),
        rows,
        columns,
        scene,
    )


def to_steps(
    measurement: Float32[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"], step: float
) -> Int64[np.ndarray, "rows columns"]:
    """Measurements in whole steps, 0 where none is sent."""
    steps = np.zeros(measurement.shape, np.int64)
    steps[sent] = np.rint(measurement[sent].astype(np.float64) / step)
    return steps


def from_steps(
    steps: Int64[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"], step: float, model: SensorModel
) -> Float32[np.ndarray, "rows columns"]:
    """What the steps of the pixels that were sent measure (m), never nothing and never from the model's range on."""
    last = np.nextafter(np.float32(model.max_range), np.float32(0))
    measured = np.zeros(steps.shape, np.float32)
    measured[sent] = np.clip(steps[sent] * step, step / 4, min(float(last), float(np.finfo(np.float32).max)))
    return measured
