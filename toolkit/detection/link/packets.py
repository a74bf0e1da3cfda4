"""Packets of a radio link: their number and the time that they occupy the channel.

A message goes into packets of up to `PACKET_BYTES`, the largest payload of GeoNetworking
(`itsGnMaxSduSize` of ETSI EN 302 636-4-1). A packet on the air has up to 88 more bytes of
GeoNetworking's headers and 38 of 802.11 (MAC header of 26, LLC of 8, checksum of 4). Airtime is of
802.11p in a channel of 10 MHz at its default rate of 6 Mbit/s: 40 µs of preamble and signal field,
then symbols of 8 µs with 48 bits each for 16 service bits, the bytes and 6 tail bits (IEEE
802.11-2020, clause 17). Waiting for a free channel is not part of it."""

import numpy as np

from toolkit.arrays import Int64
from toolkit.exchange.geonetworking import PACKET_BYTES

HEADER_BYTES = 88 + 38  # headers of GeoNetworking and 802.11 in every packet
_PREAMBLE_US = 40
_SYMBOL_US = 8
_SYMBOL_BITS = 48
_SERVICE_AND_TAIL_BITS = 22


def count_packets(bits: Int64[np.ndarray, "*shape"]) -> Int64[np.ndarray, "*shape"]:
    """Return the number of packets of each message; a message without bits needs no packet.

    bits: bits of each message.

    >>> count_packets(np.array([0, 8, 8 * 1398, 8 * 1398 + 1])).tolist()
    [0, 1, 1, 2]
    """
    return -(-bits // (8 * PACKET_BYTES))  # rounded up


def find_airtime_us(bits: Int64[np.ndarray, "*shape"]) -> Int64[np.ndarray, "*shape"]:
    """Return the time (µs) that the packets of each message occupy a channel of 802.11p.

    bits: bits of each message. All packets of a message but the last are full.

    >>> find_airtime_us(np.array([0, 8, 8 * 1398])).tolist()
    [0, 216, 2080]
    """
    packets = count_packets(bits)
    full_packets = np.maximum(packets - 1, 0)
    full_us = _packet_airtime_us(np.int64(8 * PACKET_BYTES))
    last_us = _packet_airtime_us(bits - full_packets * 8 * PACKET_BYTES)
    airtime_us: Int64[np.ndarray, "*shape"] = np.where(packets, full_packets * full_us + last_us, 0)
    return airtime_us


def _packet_airtime_us(bits: np.ndarray | np.int64) -> np.ndarray | np.int64:
    """Return the airtime (µs) of packets with `bits` of a message each."""
    data_bits = _SERVICE_AND_TAIL_BITS + 8 * HEADER_BYTES + bits
    return _PREAMBLE_US + _SYMBOL_US * -(-data_bits // _SYMBOL_BITS)
