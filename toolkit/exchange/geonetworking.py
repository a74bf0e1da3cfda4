"""Ethernet frames of GeoNetworking: single-hop broadcasts with a message for a port of BTP.

The headers follow ETSI EN 302 636-4-1 V1.4.1 (basic, common and extended, not secured) and EN 302
636-5-1 (BTP-B). All numbers are big-endian."""

import struct
from dataclasses import dataclass

PACKET_BYTES = 1398  # largest payload of GeoNetworking, BTP's header included (itsGnMaxSduSize)
BTP_HEADER_BYTES = 4
GEONETWORKING = 0x8947  # EtherType
ROADSIDE_UNIT = 15  # type of station
_BROADCAST = b"\xff" * 6
_LOCAL_MAC = 0x0200 << 32  # addresses that no manufacturer gives; the station's number follows
_ETHERNET = struct.Struct(">6s6sH")  # destination, source, EtherType
_BASIC = struct.Struct(">BBBB")  # version and next header, reserved, lifetime, hops left
_COMMON = struct.Struct(">BBBBHBB")  # next header, type, traffic class, flags, length, hops, 0
_POSITION = struct.Struct(">H6sIiiHH")  # address, time, latitude, longitude, speed, heading
_SINGLE_HOP = struct.Struct(">I")  # data of the medium, unused
_BTP_B = struct.Struct(">HH")  # port and its information
_VERSION_AND_COMMON_HEADER = 0x11  # version 1, a common header follows
_LIFETIME_1_S = 0x05  # 1 times 1 s
_BTP_B_FOLLOWS = 0x20
_SINGLE_HOP_BROADCAST = 0x50
_TRAFFIC_CLASS = 2
_HOPS = 1
_MAX_MS = 2**32  # the count in a header begins again after 49.7 days


@dataclass(frozen=True)
class RoadsideStation:
    """Sender of messages that does not move.

    Attributes:
        number: Its number, 0 to 2^32 - 1.
        latitude: Latitude (0.1 microdegree north, WGS84).
        longitude: Longitude (0.1 microdegree east, WGS84).
    """

    number: int
    latitude: int
    longitude: int

    @property
    def mac(self) -> bytes:
        """Address in Ethernet, 6 bytes."""
        return (_LOCAL_MAC | self.number).to_bytes(6, "big")


def wrap_message(message: bytes, port: int, station: RoadsideStation, its_ms: int) -> bytes:
    """Return the Ethernet frame that broadcasts a message to the stations in reach.

    Args:
        message: Message of at most `PACKET_BYTES` - `BTP_HEADER_BYTES`.
        port: Its port of BTP.
        station: Sender.
        its_ms: Time of the sender's position (ms since 2004-01-01 UTC, with leap seconds).
    """
    payload = _BTP_B.pack(port, 0) + message
    common_header = _COMMON.pack(
        _BTP_B_FOLLOWS, _SINGLE_HOP_BROADCAST, _TRAFFIC_CLASS, 0, len(payload), _HOPS, 0
    )
    position = _POSITION.pack(
        ROADSIDE_UNIT << 10,  # bits 1 to 5 of the address
        station.mac,
        its_ms % _MAX_MS,
        station.latitude,
        station.longitude,
        0,  # accuracy unknown, speed 0
        0,
    )
    return b"".join(
        (
            _ETHERNET.pack(_BROADCAST, station.mac, GEONETWORKING),
            _BASIC.pack(_VERSION_AND_COMMON_HEADER, 0, _LIFETIME_1_S, _HOPS),
            common_header,
            position,
            _SINGLE_HOP.pack(0),
            payload,
        )
    )
