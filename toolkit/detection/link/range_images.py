"""`RangeImages`: codec for range images and boxes (docs/reference/message-format.md).

Points are sent as the pixels of their image and arrive within half a step of the measurement, along
the pixel's ray. Boxes are sent in their order, in steps of 2 cm and half a degree. Yaw arrives
between -180° and 180°, a score below 0 as 0 and one above 1 as 1. A score s is sent as 511 times
the square root of 1 - s: high scores are close together, and decide which of two boxes of an object
is kept."""

import struct
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float32, Float64, ImageMask, ImageRanges, ImageSteps
from toolkit.boxes import check_boxes
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.link import message as wire
from toolkit.detection.link.image_coding import decode_pixels, encode_pixels, read_bits, write_bits
from toolkit.detection.messages import Amount, Message, Origin, RangeImage
from toolkit.detection.parameters import Parameters
from toolkit.objects import Detections
from toolkit.sensors.sensor import Sensor, SensorModel, is_return

BOX_STEP_M = 0.02  # for centres and sizes
TURN_STEPS = 720  # in a full turn of yaw
MAX_SCORE_STEP = 511  # step of score 0; score 1 is step 0
_COUNT = struct.Struct("<H")  # number of boxes
_COLUMN = struct.Struct("<Bi")  # bits of each number in a column, and the column's minimum
# columns of coded boxes: x, y, z, length, width, height, yaw, score, label
_COLUMNS = 9
_SIZES = slice(3, 6)
_YAW = 6
_SCORE = 7
MAX_BOXES = 1000  # in a message
MAX_BOX_DISTANCE_M = 2000.0  # from the sensor, along any axis
MAX_SENT_SIZE_M = 100.0  # longest side of a box
BITS_PER_PIXEL = 5.0  # expected, at 2 cm; see docs/concepts/messages.md
BITS_PER_BOX = 75.0  # expected, at 2 cm
STEPS_M = (0.02, 0.04, 0.08)  # usual steps of measurements
CODECS = ("paper", "range-images")  # names in the order of `find_codec`


def encode_boxes(detections: Detections, sensor: Sensor) -> bytes:
    """Encode boxes, scores and labels as the content of a message.

    sensor: sensor that detected the boxes, which must be within its reach. Numbers are rounded to
    steps (see the module) and packed column by column, as differences from the column's minimum.
    Raises ValueError for too many boxes, boxes out of reach or range, and scores that are not
    finite."""
    if len(detections) > MAX_BOXES:
        raise ValueError(f"a message holds at most {MAX_BOXES} boxes, got {len(detections)}")
    check_boxes(detections.boxes)
    if not np.isfinite(detections.scores).all():
        raise ValueError("scores must be finite to be sent: drop those that are not")
    places_and_sizes = detections.boxes[:, :6].T / BOX_STEP_M  # a row each
    yaw = detections.boxes[:, 6] / (2 * np.pi) * TURN_STEPS
    score = np.sqrt(1 - np.clip(detections.scores, 0, 1)) * MAX_SCORE_STEP
    # numbers in whole steps; columns as `_COLUMNS` lists them
    table = np.rint(np.column_stack([*places_and_sizes, yaw, score, detections.labels]))
    table[:, _YAW] %= TURN_STEPS
    table[:, _SIZES] = np.maximum(table[:, _SIZES], 1)  # no size may round to 0
    max_step = np.abs(table).max(initial=0)
    if max_step >= 1 << 30:  # minimum fits an int32, a difference from it 31 bits
        raise ValueError(
            f"boxes must lie within {(1 << 30) * BOX_STEP_M / 1000:.0f} km, got "
            f"{max_step * BOX_STEP_M} m"
        )
    _check_reach(table[:, :7] * BOX_STEP_M, sensor)
    heads = []
    bodies = []
    # Equal boxes would take no bits at all, so that a damaged count would go unnoticed: the first
    # column then spends one bit for each box.
    are_equal = len(table) > 1 and not np.ptp(table, axis=0).any()
    for column_index, column in enumerate(table.astype(np.int64).T if len(table) else ()):
        minimum = int(column.min())
        width = int(np.ptp(column)).bit_length() or int(are_equal and not column_index)
        heads.append(_COLUMN.pack(width, minimum))
        bodies.append(write_bits(column - minimum, width))
    return _COUNT.pack(len(detections)) + b"".join(heads + bodies)


def decode_boxes(content: bytes, sensor: Sensor) -> Detections:
    """Decode the boxes, scores and labels that `encode_boxes` wrote.

    content: the message without header and checksum; sensor: sensor that detected the boxes. Raises
    ValueError for bytes that `encode_boxes` does not write."""
    if len(content) < _COUNT.size:
        raise ValueError("the content of boxes begins with their count: it is cut off")
    (count,) = _COUNT.unpack_from(content)
    start = _COUNT.size + _COLUMNS * _COLUMN.size
    if not count:
        if len(content) > _COUNT.size:
            raise ValueError(
                f"a message without boxes must end there, got {len(content) - _COUNT.size} more "
                "bytes"
            )
        return Detections.empty()
    if len(content) < start:
        raise ValueError(
            f"{count} boxes need {start} bytes of columns, got {len(content)}: the message is cut "
            "off"
        )
    heads = list(_COLUMN.iter_unpack(content[_COUNT.size : start]))
    widths = [width for width, _ in heads]
    if max(widths) > 31:
        raise ValueError(f"numbers of boxes have up to 31 bits, got {max(widths)}")
    # a box takes at least one bit, unless it is the only one: see `are_equal` in `encode_boxes`
    if count > (MAX_BOXES if any(widths) else 1):
        raise ValueError(
            f"a message holds at most {MAX_BOXES} boxes, of a bit at least, got {count} of "
            f"{sum(widths)}"
        )
    columns = []
    for width, minimum in heads:
        numbers, start = read_bits(content, start, np.full(count, width))
        columns.append(numbers + minimum)
    if start != len(content):
        raise ValueError(
            f"{count} boxes must end the message, got {len(content) - start} more bytes"
        )
    for name, column_index, maximum in (
        ("yaw", _YAW, TURN_STEPS - 1),
        ("scores", _SCORE, MAX_SCORE_STEP),
    ):
        if not (columns[column_index].min() >= 0 and columns[column_index].max() <= maximum):
            raise ValueError(
                f"{name} must be 0 to {maximum}, got {columns[column_index].min()} to "
                f"{columns[column_index].max()}"
            )
    # steps from 0 to 719 become -360 to 359, that is -180° up to 180°
    yaw = (columns[_YAW] + TURN_STEPS // 2) % TURN_STEPS - TURN_STEPS // 2
    places_and_sizes = [column * BOX_STEP_M for column in columns[:_YAW]]
    boxes = np.column_stack([*places_and_sizes, yaw * (2 * np.pi / TURN_STEPS)])
    _check_reach(check_boxes(boxes), sensor)
    labels = columns[-1]
    return Detections(boxes, 1 - (columns[_SCORE] / MAX_SCORE_STEP) ** 2, labels)


def _check_reach(boxes: Float64[np.ndarray, "n 7"], sensor: Sensor) -> None:
    """Raise ValueError for boxes too far from a sensor, or too large, to be its detections.

    boxes: x, y, z, length, width, height (m) and yaw of each. The distance is the largest along any
    axis."""
    distance = np.abs(boxes[:, :3] - sensor.position).max(initial=0)
    size = boxes[:, _SIZES].max(initial=0)
    if distance > MAX_BOX_DISTANCE_M or size > MAX_SENT_SIZE_M:
        raise ValueError(
            f"boxes in messages must lie within {MAX_BOX_DISTANCE_M:.0f} m of sensor "
            f"{sensor.name!r} and measure at most {MAX_SENT_SIZE_M:.0f} m, got {distance:.0f} m "
            f"away and {size:.0f} m: check the pose, or drop these boxes"
        )


@dataclass(frozen=True)
class RangeImages(Parameters):
    """Codec of range images whose measurements are rounded to whole steps.

    step: step of measurements (m), in whole millimetres. Raises ValueError for other steps."""

    step: float = 0.02

    def __post_init__(self) -> None:
        wire.step_in_mm(self.step)  # raises for other than whole millimetres

    def encode_image(self, image: RangeImage, /) -> Message:
        """Encode the pixels of an image that return something, rounded to steps."""
        is_sent = is_return(image.measurement, image.sensor.model.max_range)
        header = sent_header(wire.MessageKind.RANGE_IMAGE, image, self.step)
        steps = to_steps(image.measurement, is_sent, self.step)
        message = wire.write_message(header, encode_pixels(steps, mask=is_sent))
        return Message(message, bits=8 * len(message))

    def decode_image(self, message: Message, sensor: Sensor, /) -> ImageRanges:
        """Decode an image: measurements (m), 0 in pixels that were not sent.

        sensor: sensor that sent the message. Raises ValueError for a message that is damaged, of
        another kind or of another sensor."""
        header, content = wire.read_message(message.content)
        rows, columns = sensor.model.shape
        expected_fields = {
            "sensor": wire.sensor_number(sensor.name),
            "rows": rows,
            "columns": columns,
            "scene": 0,  # the message refers to no empty scene
        }
        wire.check_header(header, wire.MessageKind.RANGE_IMAGE, **expected_fields)
        steps, is_sent = decode_pixels(content, (rows, columns))
        return from_steps(steps, is_sent, step=header.step, model=sensor.model)

    def encode_points(self, points: Float32[np.ndarray, "n 3"], /) -> Message:
        """Raise ValueError: the pixels of points without an image are unknown."""
        raise ValueError(
            f"{self} sends images, got {len(points)} points alone: use PaperCodec without images"
        )

    def decode_points(self, message: Message, /) -> Float32[np.ndarray, "m 3"]:
        """Raise ValueError: this codec sends images, so no message holds bare points."""
        raise ValueError(f"{self} sends images, got points of {message.bits} bits")

    def encode_boxes(self, detections: Detections, origin: Origin, /) -> Message:
        """Encode boxes in steps of 2 cm and 0.5°.

        origin: sensor that detected them, with time and number of the frame."""
        header = sent_header(wire.MessageKind.BOXES, origin, BOX_STEP_M)
        content = wire.write_message(header, encode_boxes(detections, origin.sensor))
        return Message(content, 8 * len(content))

    def decode_boxes(self, message: Message, sensor: Sensor, /) -> Detections:
        """Decode the boxes of a sensor.

        Raises ValueError for a message that is damaged, of another kind or sensor, or holds boxes
        that the sensor cannot have detected."""
        header, content = wire.read_message(message.content)
        expected_fields = {
            "sensor": wire.sensor_number(sensor.name),
            "step_mm": wire.step_in_mm(BOX_STEP_M),
            "rows": 0,  # boxes have no image and refer to no empty scene
            "columns": 0,
            "scene": 0,
        }
        wire.check_header(header, wire.MessageKind.BOXES, **expected_fields)
        return decode_boxes(content, sensor)

    def bits(
        self, *, points: Amount = 0, boxes: Amount = 0, messages: Amount = 1
    ) -> Float64[np.ndarray, "*shape"]:
        """Estimate the bits of messages; actual bits depend on their content.

        points, boxes: numbers of points and boxes in all messages, where each point is a pixel of a
        range image; messages: number of messages.
        Arrays are broadcast."""
        content = np.asarray(points, np.float64) * BITS_PER_PIXEL + np.asarray(boxes) * BITS_PER_BOX
        return np.asarray(content + np.asarray(messages) * 8.0 * wire.OVERHEAD_BYTES)


def sent_header(
    kind: wire.MessageKind, origin: Origin | RangeImage, step: float, scene: int = 0
) -> wire.MessageHeader:
    """Header of a message that holds an image or boxes.

    origin: the image, or the sensor, time and number of boxes, whose header has 0 rows and columns;
    step: step of the coded numbers (m); scene: number of the empty scene that the content refers
    to, 0 without one."""
    rows, columns = origin.sensor.model.shape if isinstance(origin, RangeImage) else (0, 0)
    return wire.MessageHeader(
        kind,
        sensor=wire.sensor_number(origin.sensor.name),
        number=origin.number,
        time_us=wire.time_in_us(origin.time),
        step_mm=wire.step_in_mm(step),
        rows=rows,
        columns=columns,
        scene=scene,
    )


def to_steps(measurement: ImageRanges, sent: ImageMask, step: float) -> ImageSteps:
    """Convert measurements (m) to whole steps, 0 in pixels that are not sent.

    sent: mask of sent pixels; step: step (m)."""
    steps = np.zeros(measurement.shape, np.int64)
    steps[sent] = np.rint(measurement[sent].astype(np.float64) / step)
    return steps


def from_steps(steps: ImageSteps, sent: ImageMask, step: float, model: SensorModel) -> ImageRanges:
    """Convert steps to measurements (m), 0 in pixels that were not sent.

    sent: mask of sent pixels; step: step (m); model: its range limits the measurements, so that
    every sent pixel is still a return."""
    # largest float32 below the range; `step / 4` keeps a pixel of 0 steps above 0
    max_measurement = np.nextafter(np.float32(model.max_range), np.float32(0))
    measurement = np.zeros(steps.shape, np.float32)
    measurement[sent] = np.clip(steps[sent] * step, step / 4, float(max_measurement))
    return measurement


def find_codec(name: str, *, step: float = 0.02) -> Codec:
    """Return a codec by its name in `CODECS`.

    step: step of measurements (m) of a codec of images. Raises ValueError for an unknown name."""
    # made for every name, so that a bad step is an error for "paper" too
    codecs: dict[str, Codec] = dict(zip(CODECS, (PAPER, RangeImages(step)), strict=True))
    if name not in codecs:
        raise ValueError(f"unknown codec {name!r}: choose among {', '.join(CODECS)}")
    return codecs[name]
