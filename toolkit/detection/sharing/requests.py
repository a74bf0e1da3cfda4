"""What the fusion centre asks a sensor for: places whose foreground it wants, the most wanted first, and how many bits
the answer may take. Little-endian, after the header of `toolkit.detection.link.message`:

    grant      uint32: bits that the answer may take
    count      uint16: places
    origin     2 int32: least x and y (steps of 0.25 m)
    widths     2 uint8: bits of each x and y less these
    places     x, y, radius (5 bits, steps of 0.25 m), gain (5 bits, steps of 1/16); each column filled with zeros to
               a whole byte
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.detection.link.bit_packing import read_fixed, write_fixed
from toolkit.detection.link.message import (
    MessageHeader,
    MessageKind,
    check_header,
    read_message,
    sensor_number,
    time_in_us,
    write_message,
)

PLACE_STEP, GAIN_STEP = 0.25, 1 / 16
_HEAD = struct.Struct("<IHiiBB")
_WIDTH = 5  # bits of radius and gain
_LARGEST = (1 << _WIDTH) - 1
MOST_GRANT = (1 << 32) - 1


@dataclass(frozen=True, eq=False)
class Request:
    """Bits granted for the answer; x, y and radius (m) of the places and what each is worth, the most wanted first."""

    grant: int
    places: Float64[np.ndarray, "n 3"]
    gains: Float64[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.places)


def encode_request(request: Request, sensor: str, *, time: float = 0.0, number: int = 0) -> bytes:
    """The message to a sensor (name). Places arrive to 0.125 m, radii up to 7.75 m, gains up to 31/16. Raises
    ValueError for a grant, a count or a place that does not fit."""
    if not 0 <= request.grant <= MOST_GRANT:
        raise ValueError(f"a request grants 0 to {MOST_GRANT} bits, got {request.grant}")
    if len(request) > 65535:
        raise ValueError(f"a request has at most 65535 places, got {len(request)}: leave out the least wanted")
    numbers = np.column_stack([request.places / PLACE_STEP, request.gains / GAIN_STEP])
    if not (np.isfinite(numbers).all() and np.abs(numbers).max(initial=0) < 1 << 30):
        raise ValueError("places and gains of a request must be finite, and lie within 268435 km")
    table = np.rint(numbers).astype(np.int64)
    table[:, 2:] = table[:, 2:].clip(0, _LARGEST)
    least = table[:, :2].min(axis=0) if len(table) else np.zeros(2, np.int64)
    table[:, :2] -= least
    widths = [int(column.max(initial=0)).bit_length() for column in table[:, :2].T]
    head = _HEAD.pack(request.grant, len(table), *least.tolist(), *widths)
    columns = zip(table.T, (*widths, _WIDTH, _WIDTH), strict=True)
    header = MessageHeader(MessageKind.REQUEST, sensor_number(sensor), number, time_in_us(time))
    return write_message(header, head + b"".join(write_fixed(column, width) for column, width in columns))


def decode_request(message: bytes, sensor: str) -> Request:
    """What `encode_request` wrote. Raises ValueError for a message that is damaged or for another sensor."""
    header, content = read_message(message)
    check_header(header, MessageKind.REQUEST, sensor=sensor_number(sensor))
    if len(content) < _HEAD.size:
        raise ValueError(f"a request has at least {_HEAD.size} bytes, got {len(content)}: it is cut off")
    grant, count, *least, wide, high = _HEAD.unpack_from(content)
    if max(wide, high) > 31:
        raise ValueError(f"places of a request have up to 31 bits, got {wide} and {high}")
    columns: list[Int64[np.ndarray, " n"]] = []
    start = _HEAD.size
    for width in (wide, high, _WIDTH, _WIDTH):
        numbers, start = read_fixed(content, start, count, width)
        columns.append(numbers)
    if start != len(content):
        raise ValueError(f"{count} places are followed by {len(content) - start} bytes")
    x, y, radius, gain = columns
    places = np.column_stack([x + least[0], y + least[1], radius]) * PLACE_STEP
    return Request(grant, places, gain * GAIN_STEP)
