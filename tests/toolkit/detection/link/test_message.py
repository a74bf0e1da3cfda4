"""Header, content and checksum of messages, byte by byte, and what becomes of damaged ones."""

import struct
import zlib

import pytest

from toolkit.detection.link.message import (
    OVERHEAD,
    Arrival,
    Inbox,
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


def test_bytes_are_those_of_the_table_in_whole_steps():
    message = write_message(HEADER, b"content")
    assert message[:12] == b"cv\x01\x02\x04\x03\x02\x01\x05\x00\x00\x00"
    assert struct.unpack("<Q", message[12:20]) == (6_000_007,)
    assert struct.unpack("<HHHI", message[20:30]) == (20, 150, 200, 0xA0B0C0D0)
    assert message[30:-4] == b"content"
    assert struct.unpack("<I", message[-4:]) == (zlib.crc32(message[:-4]),)
    assert len(message) == OVERHEAD + 7 == 41
    assert read_message(message) == (HEADER, b"content")
    assert (HEADER.time, HEADER.step) == (6.000007, 0.02)
    assert [step_in_mm(step) for step in (0.001, 0.02, 0.04, 0.08, 65.535)] == [1, 20, 40, 80, 65535]
    assert time_in_us(1.25) == 1_250_000
    for step in (0.0, -0.02, 0.0205, 65.536, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="step must be"):
            step_in_mm(step)
    for time in (-0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="time of a message"):
            time_in_us(time)
    assert sensor_number("a") != sensor_number("b")


def test_other_versions_and_every_damage_are_refused():
    message = write_message(HEADER, b"")
    for at, byte, said in ((0, 1, "begins with"), (2, 2, "version must be 1, got 2"), (3, 9, "kind 1 .*got 9")):
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


@pytest.mark.parametrize("field", ["sensor", "number", "time_us", "step_mm", "rows", "columns", "scene"])
def test_numbers_that_do_not_fit_are_refused(field):
    for value in (-1, 1 << 64):
        with pytest.raises(ValueError, match=field):
            MessageHeader(MessageKind.BOXES, **{field: value})


TAKEN, DUPLICATE, LATE = Arrival.TAKEN, Arrival.DUPLICATE, Arrival.LATE


def message(number, sensor=7, time=None):
    return write_message(
        MessageHeader(MessageKind.BOXES, sensor, number, int(1e5 * number if time is None else time * 1e6)), b""
    )


def test_messages_are_taken_in_order_and_damage_changes_nothing():
    inbox = Inbox(7)
    assert inbox.age(3.0) == float("inf")
    assert [inbox.receive(message(k)) for k in range(5)] == [TAKEN] * 5
    assert (inbox.taken, inbox.duplicates, inbox.late, inbox.lost) == (5, 0, 0, 0)
    assert inbox.latest.number == 4
    assert inbox.age(0.7) == pytest.approx(0.3)
    inbox = Inbox(7)
    arrived = [inbox.receive(message(k)) for k in (3, 4, 4, 7, 5, 5, 3, 1, 8)]
    assert arrived == [TAKEN, TAKEN, DUPLICATE, TAKEN, LATE, DUPLICATE, DUPLICATE, LATE, TAKEN]
    assert (inbox.taken, inbox.duplicates, inbox.late, inbox.lost) == (4, 3, 2, 1)
    assert inbox.latest.number == 8
    inbox = Inbox(7)
    inbox.receive(message(1))
    for wrong, said in (
        *((message(2)[:-1], "cut off"), (message(2) + b"x", "checksum"), (message(2, sensor=8), "sensor is 7, got 8")),
        (message(2, time=0.05), "clock was set back"),
    ):
        with pytest.raises(ValueError, match=said):
            inbox.receive(wrong)
        assert (inbox.latest.number, inbox.taken, inbox.lost) == (1, 1, 0)
    assert inbox.receive(message(2)) is TAKEN
