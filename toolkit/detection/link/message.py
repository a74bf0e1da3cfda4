"""Messages from a sensor to the fusion centre, as in docs/reference/message-format.md.

A reader takes nothing on trust: it raises ValueError for a message that is cut off, damaged, or of
another version, sensor or scene."""

import struct
import zlib
from dataclasses import astuple, dataclass
from enum import IntEnum

MAGIC = b"cv"
MESSAGE_VERSION = 2
# magic, version, kind, then the fields of `_FIELD_BITS` in their order; little endian
_HEADER = struct.Struct("<2sBBIIQHHHI")
_CHECKSUM = struct.Struct("<I")  # CRC-32 of all bytes before it
OVERHEAD_BYTES = _HEADER.size + _CHECKSUM.size  # a message without its content
_FIELD_BITS = {
    "sensor": 32,
    "number": 32,
    "time_us": 64,
    "step_mm": 16,
    "rows": 16,
    "columns": 16,
    "scene": 32,
}


class MessageKind(IntEnum):
    """Kind of a message's content; the number is a byte of its header."""

    RANGE_IMAGE = 1
    FOREGROUND = 2
    BOXES = 3
    DIFFERENCE = 5


@dataclass(frozen=True)
class MessageHeader:
    """Header of a message. Raises ValueError for a number that does not fit its field.

    Attributes:
        kind: kind of the content.
        sensor: number of the sensor (`sensor_number`).
        number: number of the frame.
        time_us: time of measurement (µs).
        step_mm: step of the coded measurements or boxes (mm), at least 1.
        rows: rows of the sensor's image, 0 for boxes.
        columns: columns of the sensor's image, 0 for boxes.
        scene: number of the empty scene that the content refers to, 0 without one.
    """

    kind: MessageKind
    sensor: int = 0
    number: int = 0
    time_us: int = 0
    step_mm: int = 20
    rows: int = 0
    columns: int = 0
    scene: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError for a number that its bits cannot hold."""
        for name, bits in _FIELD_BITS.items():
            value = getattr(self, name)
            minimum = 1 if name == "step_mm" else 0
            if not minimum <= value < 1 << bits:
                raise ValueError(
                    f"{name} of a message must be {minimum} to {(1 << bits) - 1}, got {value}"
                )

    @property
    def time(self) -> float:
        """Time of measurement (s)."""
        return self.time_us / 1e6

    @property
    def step(self) -> float:
        """Step of the coded measurements or boxes (m)."""
        return self.step_mm / 1000


def sensor_number(name: str) -> int:
    """Number of a sensor in messages: CRC-32 of its name."""
    return zlib.crc32(name.encode())


def step_in_mm(step: float) -> int:
    """Convert a step (m) to whole millimetres, 1 to 65535.

    Raises ValueError for a step out of this range or with a fraction of a millimetre."""
    # Steps from 66 m on cannot be 65535 mm or less. They, NaN and infinity become 0, an error.
    mm = round(step * 1000) if 0 < step < 66 else 0
    if not (1 <= mm <= 65535 and abs(step * 1000 - mm) < 1e-6):
        raise ValueError(
            f"step must be a whole number of millimetres, 0.001 to 65.535 m, got {step}: such as "
            "0.02"
        )
    return mm


def time_in_us(time: float) -> int:
    """Convert a time (s) to whole microseconds.

    Raises ValueError below 0, from 2^43 s on (beyond 64 bits), and for NaN."""
    if not 0 <= time < 2**43:
        raise ValueError(f"time of a message must be seconds from 0 on, got {time}")
    return round(time * 1e6)


def write_message(header: MessageHeader, content: bytes) -> bytes:
    """Return a message as bytes: header, content, and the checksum of both."""
    body = _HEADER.pack(MAGIC, MESSAGE_VERSION, *astuple(header)) + content
    return body + _CHECKSUM.pack(zlib.crc32(body))


def read_message(message: bytes) -> tuple[MessageHeader, bytes]:
    """Return the header and the content (bytes between header and checksum) of a message.

    Raises ValueError for a message that is cut off, damaged, or of another version or kind."""
    if len(message) < OVERHEAD_BYTES:
        raise ValueError(
            f"a message has at least {OVERHEAD_BYTES} bytes, got {len(message)}: it is cut off"
        )
    body = message[: -_CHECKSUM.size]
    if message != body + _CHECKSUM.pack(zlib.crc32(body)):
        raise ValueError(
            f"a message of {len(message)} bytes does not fit its checksum: have it sent again"
        )
    # fields: the other fields of `MessageHeader`, in its order
    magic, version, kind, *fields = _HEADER.unpack_from(body)
    if magic != MAGIC:
        raise ValueError(
            f"a message begins with {MAGIC!r}, got {magic!r}: it is not a coview message"
        )
    if version != MESSAGE_VERSION:
        raise ValueError(
            f"the version must be {MESSAGE_VERSION}, got {version}: update sender or reader"
        )
    if kind not in set(MessageKind):
        kinds = ", ".join(
            f"{message_kind.value} ({message_kind.name.lower()})" for message_kind in MessageKind
        )
        raise ValueError(f"a message is of kind {kinds}, got {kind}")
    return MessageHeader(MessageKind(kind), *fields), body[_HEADER.size :]


def check_header(header: MessageHeader, kind: MessageKind, **expected: int) -> None:
    """Raise ValueError if a header has another kind or other fields than expected.

    expected: value of each field to check, by its name in `MessageHeader`."""
    if header.kind != kind:
        raise ValueError(
            f"expected a message of kind {kind.name.lower()}, got {header.kind.name.lower()}"
        )
    for name, value in expected.items():
        got = getattr(header, name)
        if got != value:
            raise ValueError(
                f"expected a message whose {name} is {value}, got {got}: it belongs to another"
            )
