"""Whole numbers from 0 on as few bytes: small ones and the sizes of large ones deflated, the lower bits as they are.

A number below 8 is its own symbol; one of e > 3 bits has the symbol 8 + 2 (e - 4) + its second bit, and its lower e - 2
bits follow apart. On the wire:

    count     variable length, 7 bits a byte, lowest first
    length    variable length: of the next part
    symbols   a byte for each number, raw deflate (RFC 1951), by the strategy that makes it the shortest
    bits      the lower bits of all large numbers, highest first, filled with zeros to a whole byte
"""

from __future__ import annotations

import zlib

import numpy as np

from toolkit.arrays import Int64

LARGEST = (1 << 32) - 1
_SMALL, _FIRST_SIZE = 8, 4  # numbers that are their own symbol; bits of the smallest that is not
_STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_HUFFMAN_ONLY, zlib.Z_FIXED)


def pack_integers(values: Int64[np.ndarray, " n"]) -> bytes:
    """Numbers as bytes. Raises ValueError for one below 0 or above 2^32 - 1."""
    if len(values) and not (values.min() >= 0 and values.max() <= LARGEST):
        raise ValueError(f"numbers from 0 to {LARGEST} are packed, got {values.min()} to {values.max()}")
    size = np.frexp(values.astype(np.float64))[1].astype(np.int64)
    low = np.where(values < _SMALL, 0, size - 2)
    second = (values >> low) & 1
    symbols = np.where(values < _SMALL, values, _SMALL + 2 * (size - _FIRST_SIZE) + second)
    deflated = _deflated(symbols.astype(np.uint8).tobytes())
    return _variable(len(values)) + _variable(len(deflated)) + deflated + _written(values, low)


def unpack_integers(data: bytes, start: int, most: int) -> tuple[Int64[np.ndarray, " n"], int]:
    """Numbers that begin at `start`, and where they end. Raises ValueError where there are more than `most`, or bytes
    that `pack_integers` does not write."""
    count, start = _read_variable(data, start)
    if count > most:
        raise ValueError(f"there are {count} packed numbers where at most {most} can be")
    length, start = _read_variable(data, start)
    symbols = _inflated(data[start : start + length], count).astype(np.int64)
    if len(symbols) and symbols.max() > _SMALL + 2 * (32 - _FIRST_SIZE) + 1:
        raise ValueError(f"packed numbers have symbols up to {_SMALL + 57}, got {symbols.max()}")
    half, second = np.divmod(np.maximum(symbols - _SMALL, 0), 2)
    low = np.where(symbols < _SMALL, 0, half + _FIRST_SIZE - 2)
    bits, end = _read_bits(data, start + length, low)
    return np.where(symbols < _SMALL, symbols, (2 + second << low) | bits), end


def write_fixed(values: Int64[np.ndarray, " n"], width: int) -> bytes:
    """Numbers of `width` bits each, highest first, filled with zeros to a whole byte."""
    return _written(values, np.full(len(values), width))


def read_fixed(data: bytes, start: int, count: int, width: int) -> tuple[Int64[np.ndarray, " n"], int]:
    """What `write_fixed` wrote, and where it ends. Raises ValueError where bytes are missing or filled otherwise."""
    if count * width > 8 * (len(data) - start):
        raise ValueError(f"{count} numbers of {width} bits do not fit the {len(data) - start} bytes that follow")
    return _read_bits(data, start, np.full(count, width))


def _written(values: np.ndarray, width: np.ndarray) -> bytes:
    """The lower bits of each number, so many of each."""
    place = _places(width)
    return np.packbits((np.repeat(values, width) >> place) & 1).tobytes()


def _read_bits(data: bytes, start: int, width: np.ndarray) -> tuple[np.ndarray, int]:
    total = int(width.sum())
    end = start + -(-total // 8)
    if end > len(data):
        raise ValueError(f"{total} bits do not fit the {len(data) - start} bytes that follow: the message is cut off")
    bits = np.unpackbits(np.frombuffer(data, np.uint8, end - start, start)).astype(np.int64)
    if bits[total:].any():
        raise ValueError("bits are filled with zeros to a whole byte, got others")
    sums = np.concatenate([[0], np.cumsum(bits[:total] << _places(width))])
    ends = np.cumsum(width)
    return sums[ends] - sums[ends - width], end


def _places(width: np.ndarray) -> np.ndarray:
    """The place of every bit in its number, from the highest down."""
    ends = np.cumsum(width)
    return np.repeat(ends, width) - 1 - np.arange(int(width.sum()))


def _deflated(data: bytes) -> bytes:
    made = []
    for strategy in _STRATEGIES:
        packer = zlib.compressobj(9, zlib.DEFLATED, -15, 9, strategy)
        made.append(packer.compress(data) + packer.flush())
    return min(made, key=len)


def _inflated(data: bytes, count: int) -> np.ndarray:
    """So many bytes. Raises ValueError where there are others."""
    opener = zlib.decompressobj(-15)
    try:
        content = opener.decompress(data, count + 1)
    except zlib.error as error:
        raise ValueError(f"packed numbers cannot be inflated ({error})") from None
    if len(content) != count or not opener.eof or opener.unused_data:
        raise ValueError(f"packed numbers inflate to {count} symbols, got {len(content)}")
    return np.frombuffer(content, np.uint8)


def _variable(number: int) -> bytes:
    """7 bits a byte, lowest first; the highest bit says that more follow."""
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def _read_variable(data: bytes, start: int) -> tuple[int, int]:
    number = 0
    for place in range(5):
        if start + place >= len(data):
            break
        byte = data[start + place]
        number |= (byte & 127) << 7 * place
        if byte < 128:
            return number, start + place + 1
    raise ValueError("a number of variable length does not end: the message is cut off or damaged")
