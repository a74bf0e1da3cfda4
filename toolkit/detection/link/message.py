"""Messages from a sensor to the fusion centre, as in docs/reference/message-format.md.

A reader takes nothing on trust: it raises ValueError for a message that is cut off, damaged, or of
another version, sensor or scene.

Capacities of links are nominal and shared by all senders, so that a share well below 1 is needed.
802.11p: the default rate in a channel of 10 MHz (IEEE 802.11-2020, clause 17). LTE-V2X: a transport
block of 7992 bits each ms, that is 50 resource blocks of 10 MHz, QPSK (3GPP TS 36.213, table
7.1.7.2.1-1, index 9). Ethernet: a cable (100BASE-TX). A packet of up to 1400 bytes fits an Ethernet
frame with the headers of IP and UDP."""

import struct
import zlib
from collections.abc import Iterable
from dataclasses import astuple, dataclass
from enum import IntEnum

import numpy as np

from toolkit.arrays import Int64
from toolkit.runtime.text_tables import align_columns

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
PACKET_BYTES = 1400  # largest part of a message in one packet
CAPACITIES_MBIT_PER_S = {"802.11p": 6.0, "LTE-V2X": 8.0, "Ethernet": 100.0}


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


@dataclass(frozen=True)
class LinkLoad:
    """Load of some sensors on a shared link.

    Attributes:
        rate: messages per second of each sensor (Hz).
        mbit_per_s: mean load of all sensors together (Mbit/s).
        packets: mean number of packets (`PACKET_BYTES`) per message.
        one_packet: share (0 to 1) of messages that fit one packet.
        shares: load divided by the link's capacity, by name in `CAPACITIES_MBIT_PER_S`; above 1 for
            an overloaded link.
    """

    rate: float
    mbit_per_s: float
    packets: float
    one_packet: float
    shares: dict[str, float]


@dataclass(frozen=True)
class SetLoad:
    """Load of one scheme and sensor set on a shared link.

    scheme: name of the scheme; sensors: indices of the sensors."""

    scheme: str
    sensors: tuple[int, ...]
    load: LinkLoad

    def as_dict(self) -> dict[str, object]:
        """Return scheme, sensors and the fields of the load as one flat dict for JSON."""
        return {"scheme": self.scheme, "sensors": self.sensors, **vars(self.load)}


def link_load(bits: Int64[np.ndarray, "frames sensors"], rate: float) -> LinkLoad:
    """Load of sensors that each send a message in every frame.

    bits: bits of each message; rate: frames per second (Hz). Raises ValueError for a rate that is
    not above 0 and finite, and without messages."""
    if not 0 < rate < np.inf:
        raise ValueError(f"rate must be above 0 Hz, got {rate:g}: such as 10")
    if not bits.size:
        raise ValueError(
            f"there must be a message on a link, got {bits.shape[0]} frames of {bits.shape[1]} "
            "sensors"
        )
    # rounded up; a message without bits needs no packet
    packets = -(-bits // (8 * PACKET_BYTES))
    mbit = float(bits.sum(axis=1).mean()) * rate / 1e6  # in a second, from all sensors
    return LinkLoad(
        rate=float(rate),
        mbit_per_s=mbit,
        packets=float(packets.mean()),
        one_packet=float((packets <= 1).mean()),
        shares={name: mbit / capacity for name, capacity in CAPACITIES_MBIT_PER_S.items()},
    )


def format_loads(loads: Iterable[SetLoad]) -> str:
    """Format the load of each scheme and sensor set as a table, one line each."""
    table = [
        ["scheme", "sensors", "Mbit/s", "packets/message", "in one packet", *CAPACITIES_MBIT_PER_S]
    ]
    for set_load in loads:
        load = set_load.load
        names = [set_load.scheme, ",".join(map(str, set_load.sensors)) or "none"]
        shares = [f"{100 * load.shares[link]:.2f} %" for link in CAPACITIES_MBIT_PER_S]
        figures = [f"{load.mbit_per_s:.3f}", f"{load.packets:.2f}", f"{load.one_packet:.3f}"]
        table.append([*names, *figures, *shares])
    return align_columns(table, texts=2)  # the first two columns are texts, the rest numbers
