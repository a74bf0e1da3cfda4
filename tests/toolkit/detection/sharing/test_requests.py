"""Requests of the fusion centre as bytes."""

import struct
import zlib

import numpy as np
import pytest

from toolkit.detection.link.message import MessageKind, read_message
from toolkit.detection.sharing.requests import Request, decode_request, encode_request

PLACES = np.array([[10.0, -3.25, 2.5], [-40.75, 12.0, 1.0], [0.0, 0.0, 7.75]])
ASKED = Request(1234, PLACES, np.array([1.0, 0.5, 0.0625]))


def test_what_was_asked_arrives_in_its_order():
    message = encode_request(ASKED, "d0", time=1.5, number=7)
    header, content = read_message(message)
    assert (header.kind, header.number, header.time) == (MessageKind.REQUEST, 7, 1.5)
    assert len(content) == 16 + 3 + 3 + 2 + 2  # x of 8 bits, y of 6, radius and gain of 5 each
    got = decode_request(message, "d0")
    assert got.grant == 1234
    np.testing.assert_array_equal(got.places, PLACES)
    np.testing.assert_array_equal(got.gains, ASKED.gains)


def test_places_arrive_to_an_eighth_of_a_metre_and_large_numbers_are_cut():
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(-60, 60, (20, 2)), rng.uniform(0, 12, 20)])
    got = decode_request(encode_request(Request(0, places, rng.uniform(0, 3, 20)), "d0"), "d0")
    assert np.abs(got.places[:, :2] - places[:, :2]).max() <= 0.125
    np.testing.assert_allclose(got.places[:, 2], places[:, 2].clip(0, 7.75), atol=0.125)
    assert got.gains.max() == 31 / 16


def test_no_places_take_fifty_bytes():
    message = encode_request(Request(400, np.zeros((0, 3)), np.zeros(0)), "d0")
    assert len(message) == 50
    assert len(decode_request(message, "d0")) == 0


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (Request(-1, PLACES, ASKED.gains), "grants 0 to"),
        (Request(1 << 32, PLACES, ASKED.gains), "grants 0 to"),
        (Request(0, PLACES * np.nan, ASKED.gains), "finite"),
        (Request(0, np.zeros((70000, 3)), np.zeros(70000)), "at most 65535 places"),
    ],
)
def test_what_cannot_be_asked_is_refused(request_, said):
    with pytest.raises(ValueError, match=said):
        encode_request(request_, "d0")


def test_another_sensors_request_and_damaged_ones_are_refused():
    message = encode_request(ASKED, "d0")
    with pytest.raises(ValueError, match="whose sensor is"):
        decode_request(message, "d1")
    for length in range(len(message)):
        with pytest.raises(ValueError, match=r"cut off|checksum"):
            decode_request(message[:length], "d0")
    body = message[:-4]
    for changed in (body[:31] + body[32:], body + b"\0", body[:44] + b"\xff" + body[45:], body[:40]):
        with pytest.raises(ValueError, match=r"request|places|fit|bits"):
            decode_request(changed + struct.pack("<I", zlib.crc32(changed)), "d0")
