"""Messages read by `page_reader`, and forged ones."""

import struct
import zlib
from collections import Counter

import numpy as np
import pytest

from examples.differences import messages as difference_messages
from tests.toolkit.detection.link.page_reader import (
    read_boxes,
    read_mask,
    read_packed,
    read_values,
    read_variable,
    unfold,
)
from toolkit.boxes import check_boxes
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.link import foreground, image_coding, range_images
from toolkit.detection.link.message import MessageHeader, MessageKind, read_message, write_message
from toolkit.detection.messages import Message, Origin, RangeImage
from toolkit.detection.view import suppress
from toolkit.geometry import pose
from toolkit.objects import Detections
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

SENSOR = Sensor("s", DepthCamera(width=72, height=52), pose(0.0, 0.0, 5.0))
SHAPE = ROWS, COLUMNS = SENSOR.model.shape
SCENE = EmptyScene.from_render(SENSOR, np.full(SHAPE, 30, np.float32))


def read_images(messages):
    """Steps of the sent pixels, and the missing ones, of every message."""
    for message in messages:
        kind, number, step, data = (
            message[3],
            int.from_bytes(message[8:12], "little"),
            message[20],
            message[30:-4],
        )
        if kind == 2:
            sent, at = read_mask(data, 0, ROWS, COLUMNS)
            values, at = read_values(data, at, sent, {}, COLUMNS)
            reference, last = {pixel: (16 * value, 1) for pixel, value in values.items()}, number
        else:
            back, goes_on, checksum = struct.unpack("<BBI", data[:6])
            assert last == number - back
            columns = zip(*[(pixel, *reference[pixel]) for pixel in sorted(reference)], strict=True)
            numbers = [last, step, *(each for column in columns for each in column)]
            assert checksum == zlib.crc32(struct.pack(f"<{len(numbers)}q", *numbers))
            square = {pixel: (pixel // COLUMNS // 8, pixel % COLUMNS // 8) for pixel in reference}
            squares = sorted(set(square.values()))
            bits = "".join(f"{byte:08b}" for byte in data[6 : 6 + -(-len(squares) // 8)])
            still = {each for each, bit in zip(squares, bits, strict=False) if bit == "1"}
            expected = {pixel for pixel in reference if square[pixel] in still}
            otherwise, at = read_mask(data, 6 + -(-len(squares) // 8), ROWS, COLUMNS)
            sent = otherwise ^ expected
            residuals, at = read_packed(data, at)
            values = {}
            for pixel, residual in zip(sorted(sent & expected), residuals, strict=True):
                fine = reference[pixel][0]
                whole = (fine + 8) // 16
                values[pixel] = whole + (
                    unfold(residual) if fine >= 16 * whole else -unfold(residual)
                )
            others, at = read_values(data, at, sent - expected, values, COLUMNS)
            values |= others
            if goes_on:
                after, most = {}, max(1, (80 + step // 2) // step)
                for pixel, value in values.items():
                    fine, images = reference.get(pixel, (0, 0))
                    if images and abs(value - (fine + 8) // 16) <= most:
                        images = min(images + 1, 8)
                        after[pixel] = fine + (16 * value - fine + images // 2) // images, images
                    else:
                        after[pixel] = 16 * value, 1
                reference, last = after, number
        missing, at = read_mask(data, at, ROWS, COLUMNS) if at < len(data) else (set(), at)
        assert at == len(data)
        yield values, missing


def image(number):
    """A rough wall that stands in noise, a car that passes, pixels that come and go."""
    rng, measured = np.random.default_rng(number), np.zeros(SHAPE, np.float32)
    measured[:22, 2:30] = np.random.default_rng(9).uniform(11, 12, (22, 28)) + rng.normal(
        0, 0.02, (22, 28)
    )
    measured[24, 2:30][rng.random(28) < 0.5] = 12.3
    measured[20:26, number : number + 5] = 8 - 0.1 * number
    return RangeImage(SENSOR, measured, time=number / 10, number=number)


def masked(number):
    missing = np.zeros(SHAPE, bool)
    missing[:3, 31:33] = number % 2
    return missing & (image(number).measurement == 0)


@pytest.mark.parametrize(("refers_to", "step"), [("previous", 0.02), ("key", 0.08)])
def test_images_read_as_the_page_says(refers_to, step):
    sender = difference_messages.DifferenceSender(
        SCENE, step=step, refers_to=refers_to, key_every=10
    )
    messages = [sender.write(image(k), masked(k)) for k in range(12)]
    assert [message[3] for message in messages] == [2, *[5] * 9, 2, 5]
    for k, (values, missing) in enumerate(read_images(messages)):
        steps = np.rint(image(k).measurement.astype(float) / step).ravel()
        assert values == {pixel: steps[pixel] for pixel in np.flatnonzero(image(k).measurement)}
        assert missing == set(np.flatnonzero(masked(k)))
    values = np.concatenate(
        [
            (1 << np.arange(32)) + 1,
            (1 << np.arange(32)) - 1,
            [7, 8, 11, 12, image_coding.MAX_PACKED],
        ]
    )
    assert read_packed(b"xx" + image_coding.pack_integers(values), 2)[0] == values.tolist()
    stored = zlib.compressobj(0, zlib.DEFLATED, -15)  # other encoders deflate otherwise
    symbols = stored.compress(bytes([1, 15])) + stored.flush()
    fixed = zlib.compressobj(9, zlib.DEFLATED, -15, 9, zlib.Z_FIXED)
    # both symbols, and half of the code for the end
    endless = (fixed.compress(bytes([1, 15])) + fixed.flush())[:-1]
    cut = [(symbols[:-1], "got 1"), (b"", "got 0"), (symbols + b"\0", "got 2"), (endless, "got 2")]
    for deflated, said in ((symbols, None), *cut):
        data = bytes([2, len(deflated)]) + deflated + bytes([0b01101000])
        if said is None:
            assert image_coding.unpack_integers(data, 0, 2)[0].tolist() == [1, 0b1101101]
            continue
        with pytest.raises(ValueError, match=f"inflate to 2 symbols, {said}"):
            image_coding.unpack_integers(data, 0, 2)


BOXES = Detections(
    np.array(
        [
            [9.0, -40, 0.8, 4.5, 1.8, 1.5, 0.1],
            [3, 2, 0.9, 0.6, 0.6, 1.8, -3],
            [3, 9, 2, 12, 2.5, 3.4, 2.5],
        ]
    ),
    np.array([0.97, 0.2, 0.5]),
    np.array([0, 2, 3]),
)
CODEC = range_images.RangeImages()


def test_boxes_read_as_the_page_says():
    message = CODEC.encode_boxes(BOXES, Origin(SENSOR, 1.5, 7)).content
    assert (message[:4], message[8:12]) == (b"cv\x02\x03", b"\x07\0\0\0")
    assert struct.unpack("<IQHHHI", message[4:8] + message[12:30]) == (
        zlib.crc32(b"s"),
        1_500_000,
        20,
        0,
        0,
        0,
    )
    columns = np.transpose(read_boxes(message))
    np.testing.assert_allclose(columns[:6].T / 50, BOXES.boxes[:, :6], atol=0.01)
    np.testing.assert_allclose(columns[6] / 2, np.rad2deg(BOXES.boxes[:, 6]) % 360, atol=0.25)
    np.testing.assert_allclose(1 - (columns[7] / 511) ** 2, BOXES.scores, atol=2e-3)
    assert columns[8].tolist() == [0, 2, 3]
    alike = CODEC.encode_boxes(BOXES[[1, 1, 1]], Origin(SENSOR)).content
    assert CODEC.decode_boxes(Message(alike, 0), SENSOR).boxes[:, 0].tolist() == [3.0] * 3


FORGED = {
    "count": lambda head: (65535, head),
    "one count more": lambda head: (1001, [(1, 0), *head[1:]]),
    "far": lambda head: (1, [(0, 20_000_000), *head[1:]]),
    "beside": lambda head: (1, [head[0], (0, -100_001), *head[2:]]),
    "no size": lambda head: (1, [*head[:3], (0, 0), *head[4:]]),
    "size below 0": lambda head: (1, [*head[:5], (0, -75), *head[6:]]),
    "huge": lambda head: (1, [*head[:4], (0, 5001), *head[5:]]),
    "yaw": lambda head: (1, [*head[:6], (0, 720), *head[7:]]),
    "score": lambda head: (1, [*head[:7], (0, -1), head[8]]),
    "label": lambda head: (1, [*head[:8], (0, 4)]),
}


@pytest.mark.parametrize("forgery", FORGED)
def test_forged_boxes_are_refused(forgery):
    said = "at most 1000|must lie within|must be positive|must be 0 to|labels must be"
    sound = [(0, 100), (0, -50), (0, 40), (0, 200), (0, 100), (0, 75), (0, 700), (0, 300), (0, 2)]
    header = MessageHeader(MessageKind.BOXES, zlib.crc32(b"s"))
    for (count, heads), fits in (((1, sound), True), (FORGED[forgery](sound), False)):
        content = struct.pack("<H", count) + b"".join(struct.pack("<Bi", *head) for head in heads)
        content += b"".join(bytes(-(-width * count // 8)) for width, _ in heads)
        message = Message(write_message(header, content), 0)
        if fits:
            assert len(CODEC.decode_boxes(message, SENSOR)) == 1
            continue
        with pytest.raises(ValueError, match=said):
            CODEC.decode_boxes(message, SENSOR)


def write_variable(number):
    return (
        bytes([number & 127 | 128]) + write_variable(number >> 7)
        if number > 127
        else bytes([number])
    )


NUMBERS = (0, 1, 2, 7, 8, 255, 1 << 15, (1 << 16) - 1, 1 << 24, (1 << 31) - 1, (1 << 32) - 1)


def forge_packed(rng, numbers):
    """Packed numbers of which a number, the count, a length or the symbols are others."""
    numbers, how = list(numbers), rng.integers(6)
    if how < 3:
        for _ in range(rng.integers(1, 4)):
            at, number = int(rng.integers(len(numbers) + 1)), int(rng.choice(NUMBERS))
            numbers[at : at + int(rng.integers(3))] = [number] * int(rng.choice([1, 1, 1, 3, 2000]))
        return image_coding.pack_integers(np.array(numbers, np.int64))
    sound = image_coding.pack_integers(np.array(numbers, np.int64))
    count, at = read_variable(sound, 0)
    length, at = read_variable(sound, at)
    deflated, rest = sound[at : at + length], sound[at + length :]
    if how == 3:
        count = int(
            rng.choice([0, count + 1, max(count - 1, 0), ROWS * COLUMNS, 1 << 31, (1 << 35) - 1])
        )
    elif how == 4:
        length = int(rng.choice([0, length + 1, max(length - 1, 0), 1 << 31, (1 << 35) - 1]))
    else:
        symbols = [rng.bytes(count), bytes([65]) * count, bytes(1 << 20)][rng.integers(3)]
        deflated = zlib.compress(symbols, wbits=-15)
        length = len(deflated)
    return write_variable(count) + write_variable(length) + deflated + rest


def forge(rng, message):
    """A message with a sound checksum and something else that does not fit."""
    header, content = read_message(message)
    fields, how = dict(vars(header)), rng.integers(8)
    if how == 0:
        name = str(rng.choice(list(fields)))
        most = {"step_mm": 16, "rows": 16, "columns": 16, "time_us": 64}.get(name, 32)
        choice = [1, int(fields[name]) + 1, max(int(fields[name]) - 1, 1), (1 << most) - 1, 0]
        at, size = {
            "kind": (3, 1),
            "sensor": (4, 4),
            "number": (8, 4),
            "time_us": (12, 8),
            "step_mm": (20, 2),
            "rows": (22, 2),
            "columns": (24, 2),
            "scene": (26, 4),
        }[name]
        body = bytearray(message[:-4])
        body[at : at + size] = (
            int(rng.choice(np.array(choice, object))) % (1 << 8 * size)
        ).to_bytes(size, "little")
        return bytes(body) + struct.pack("<I", zlib.crc32(body))
    forged = bytearray(content)
    if how == 1:
        for at in rng.integers(0, len(forged), rng.integers(1, 4)):
            forged[at] = rng.integers(256)
    elif how == 2:
        forged = (
            forged[: rng.integers(len(forged))] if rng.random() < 0.7 else forged + rng.bytes(9)
        )
    elif header.kind == MessageKind.BOXES:
        for _ in range(rng.integers(1, 3)):
            place = int(rng.integers(10))
            if place == 9:
                forged[:2] = struct.pack("<H", rng.choice([0, 1, 2, 4, 999, 1001, 65535]))
            elif rng.random() < 0.5:
                forged[2 + 5 * place] = rng.choice([0, 1, 8, 31, 32, 255])
            else:
                least = rng.choice([-(1 << 31), -1, 0, 1, 719, 20_000_000, (1 << 31) - 1])
                forged[3 + 5 * place : 7 + 5 * place] = struct.pack("<i", least)
    else:
        packed, end, parts = [], 0, 2
        if header.kind == MessageKind.DIFFERENCE:
            squares = {
                (p // COLUMNS // 8, p % COLUMNS // 8) for p in np.flatnonzero(image(0).measurement)
            }
            end, parts = 6 + -(-len(squares) // 8), 3
        while end < len(forged):
            at = end + (len(packed) in (0, parts))  # a mask begins with a byte of its own
            numbers, end = read_packed(bytes(forged), at)
            packed.append((at, end, numbers))
        at, end, numbers = packed[rng.integers(len(packed))]
        forged[at:end] = forge_packed(rng, numbers)
    return write_message(MessageHeader(**fields), bytes(forged))


def attack(rng, count):
    """Forged messages of each kind, and what became of them."""
    sender, reader = (
        difference_messages.DifferenceSender(SCENE),
        difference_messages.DifferenceReader(SCENE),
    )
    whole, change = (sender.write(image(k)) for k in range(2))
    sound = {
        "range image": CODEC.encode_image(image(0)).content,
        "foreground": foreground.encode_foreground(image(1), SCENE, masked(1)),
        "boxes": CODEC.encode_boxes(BOXES, Origin(SENSOR, 1.5, 7)).content,
        "difference": change,
    }
    outcomes = {kind: Counter() for kind in sound}
    for k in range(count):
        kind = list(sound)[k % len(sound)]
        forged = forge(rng, sound[kind])
        reader.read(whole)
        try:
            if kind == "boxes":
                found = CODEC.decode_boxes(Message(forged, 0), SENSOR)
                check_boxes(found.boxes)
                assert (
                    np.abs(found.boxes[:, :3] - SENSOR.position).max(initial=0)
                    <= range_images.MAX_BOX_DISTANCE_M
                )
                assert ((found.scores >= 0) & (found.scores <= 1)).all()
                assert len(suppress(found)) <= len(found) <= 8 * len(forged)
            elif kind == "range image":
                got = CODEC.decode_image(Message(forged, 0), SENSOR)
                assert got.shape == SHAPE
                assert (got >= 0).all()
                assert (got < SENSOR.model.max_range).all()
            else:
                read = reader.read(forged)
                assert (read.image[read.sent] > 0).all()
                assert np.isfinite(read.image).all()
                reader.read(change) if kind == "difference" and forged == change else None
        except ValueError:
            outcomes[kind]["refused"] += 1
        else:
            outcomes[kind]["unchanged" if forged == sound[kind] else "read"] += 1
    reader.read(whole)
    assert reader.read(change).sent.sum() == (image(1).measurement > 0).sum()
    return outcomes


def test_forged_messages_are_refused_or_read_in_bounds():
    outcomes = attack(np.random.default_rng(0), 300)
    assert {kind: sum(each.values()) for kind, each in outcomes.items()} == dict.fromkeys(
        outcomes, 75
    )
    assert all(each["refused"] > each["read"] for each in outcomes.values())
