"""Messages that come twice, late, out of order, damaged or not at all."""

import pytest

from toolkit.detection.link.inbox import Arrival, Inbox
from toolkit.detection.link.message import MessageHeader, MessageKind, write_message

TAKEN, DUPLICATE, LATE = Arrival.TAKEN, Arrival.DUPLICATE, Arrival.LATE


def message(number, sensor=7, time=None):
    return write_message(
        MessageHeader(MessageKind.BOXES, sensor, number, int(1e5 * number if time is None else time * 1e6)), b""
    )


def test_in_order_all_are_taken():
    inbox = Inbox(7)
    assert inbox.age(3.0) == float("inf")
    assert [inbox.receive(message(k)) for k in range(5)] == [TAKEN] * 5
    assert (inbox.taken, inbox.duplicates, inbox.late, inbox.lost) == (5, 0, 0, 0)
    assert inbox.latest.number == 4
    assert inbox.age(0.7) == pytest.approx(0.3)


def test_twice_late_and_lost_are_told_apart():
    inbox = Inbox(7)
    arrived = [inbox.receive(message(k)) for k in (3, 4, 4, 7, 5, 5, 3, 1, 8)]
    assert arrived == [TAKEN, TAKEN, DUPLICATE, TAKEN, LATE, DUPLICATE, DUPLICATE, LATE, TAKEN]
    assert (inbox.taken, inbox.duplicates, inbox.late, inbox.lost) == (4, 3, 2, 1)
    assert inbox.latest.number == 8


def test_what_is_damaged_or_anothers_changes_nothing():
    inbox = Inbox(7)
    inbox.receive(message(1))
    for wrong, said in (
        (message(2)[:-1], "cut off"),
        (message(2) + b"x", "checksum"),
        (message(2, sensor=8), "with sensor 7, got 8"),
        (message(2, time=0.05), "clock was set back"),
    ):
        with pytest.raises(ValueError, match=said):
            inbox.receive(wrong)
        assert (inbox.latest.number, inbox.taken, inbox.lost) == (1, 1, 0)
    assert inbox.receive(message(2)) is TAKEN
