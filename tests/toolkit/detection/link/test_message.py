"""Header, content and checksum of messages, byte by byte, and what becomes of damaged ones."""

import struct
import zlib

import pytest

from toolkit.detection.link.message import (
    OVERHEAD_BYTES,
    MessageHeader,
    MessageKind,
    check_header,
    read_message,
    sensor_number,
    step_in_mm,
    time_in_us,
    write_message,
)

HEADER = MessageHeader(MessageKind.FOREGROUND, 0x01020304, 5, 6_000_007, 20, 150, 200, 0xA0B0C0D0)


def test_bytes_of_messages_are_those_of_the_table():
    message = write_message(HEADER, b"content")
    assert message[:12] == b"cv\x02\x02\x04\x03\x02\x01\x05\x00\x00\x00"
    assert struct.unpack("<Q", message[12:20]) == (6_000_007,)
    assert struct.unpack("<HHHI", message[20:30]) == (20, 150, 200, 0xA0B0C0D0)
    assert message[30:-4] == b"content"
    assert struct.unpack("<I", message[-4:]) == (zlib.crc32(message[:-4]),)
    assert len(message) == OVERHEAD_BYTES + 7 == 41
    assert read_message(message) == (HEADER, b"content")


def test_steps_and_times_are_whole_numbers():
    assert (HEADER.time, HEADER.step) == (6.000007, 0.02)
    assert [step_in_mm(step) for step in (0.001, 0.02, 0.04, 0.08, 65.535)] == [
        1,
        20,
        40,
        80,
        65535,
    ]
    assert time_in_us(1.25) == 1_250_000
    assert time_in_us(0.0) == 0
    for step in (0.0, 1e-10, -0.02, 0.0205, 65.536, 66.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="step must be"):
            step_in_mm(step)
    assert time_in_us(2.0**42) == 2**42 * 10**6
    for time in (-0.1, float("nan"), float("inf"), 2.0**43):
        with pytest.raises(ValueError, match="time of a message"):
            time_in_us(time)
    assert sensor_number("a") != sensor_number("b")


def test_other_versions_and_every_damage_are_refused():
    message = write_message(HEADER, b"")
    for at, byte, said in (
        (0, 1, "begins with"),
        (2, 1, "version must be 2, got 1"),
        (3, 9, "kind 1 .*got 9"),
    ):
        body = bytearray(message[:-4])
        body[at] = byte
        with pytest.raises(ValueError, match=said):
            read_message(bytes(body) + struct.pack("<I", zlib.crc32(body)))
    message = write_message(HEADER, b"some content")
    for length in range(len(message)):
        with pytest.raises(ValueError, match=r"cut off|checksum"):
            read_message(message[:length])
    for bit in range(8 * len(message)):
        damaged = bytearray(message)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(ValueError, match="checksum"):
            read_message(bytes(damaged))
    check_header(HEADER, MessageKind.FOREGROUND, rows=150, sensor=0x01020304)
    with pytest.raises(ValueError, match="of kind boxes, got foreground"):
        check_header(HEADER, MessageKind.BOXES)
    with pytest.raises(ValueError, match="scene is 1, got 2695938256"):
        check_header(HEADER, MessageKind.FOREGROUND, scene=1)


# bytes
SIZES = {"sensor": 4, "number": 4, "time_us": 8, "step_mm": 2, "rows": 2, "columns": 2, "scene": 4}


@pytest.mark.parametrize("field", SIZES)
def test_numbers_that_do_not_fit_are_refused(field):
    least, end = int(field == "step_mm"), 1 << 8 * SIZES[field]
    for value in (least, end - 1):
        header = MessageHeader(MessageKind.BOXES, **{field: value})
        assert read_message(write_message(header, b""))[0] == header
    for value in (least - 1, end):
        with pytest.raises(ValueError, match=field):
            MessageHeader(MessageKind.BOXES, **{field: value})


def test_a_header_is_of_nothing_in_particular_unless_said():
    assert MessageHeader(MessageKind.BOXES) == MessageHeader(
        MessageKind.BOXES, 0, 0, 0, 20, 0, 0, 0
    )
