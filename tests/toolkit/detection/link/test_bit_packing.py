"""Whole numbers as bytes and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toolkit.detection.link.bit_packing import LARGEST, pack_integers, read_fixed, unpack_integers, write_fixed

numbers = st.lists(st.one_of(st.integers(0, 20), st.integers(0, LARGEST)), max_size=60)


@settings(deadline=None, max_examples=60)
@given(numbers, st.binary(max_size=5))
def test_what_was_packed_comes_back(values, before):
    packed = pack_integers(np.array(values, np.int64))
    again, end = unpack_integers(before + packed + b"more", len(before), len(values))
    assert again.tolist() == values
    assert end == len(before) + len(packed)


def test_every_power_of_two_and_its_neighbours():
    values = np.unique([(1 << k) + d for k in range(32) for d in (-1, 0, 1)])
    assert unpack_integers(pack_integers(values), 0, len(values))[0].tolist() == values.tolist()


def test_bytes_of_some_numbers():
    """One large number: its symbol 8 + 2 (7 - 4) + 1 in the deflated part, its 5 lower bits, filled with zeros."""
    import zlib

    packed = pack_integers(np.array([1, 0b1101101]))
    assert packed[0] == 2
    assert zlib.decompress(packed[2 : 2 + packed[1]], -15) == bytes([1, 15])
    assert packed[2 + packed[1] :] == bytes([0b01101000])


def test_small_numbers_take_little():
    rng = np.random.default_rng(0)
    values = np.abs(np.rint(rng.normal(0, 2, 5000))).astype(np.int64)
    share = np.bincount(values) / len(values)
    entropy = -(share[share > 0] * np.log2(share[share > 0])).sum()
    assert 8 * len(pack_integers(values)) < 1.08 * entropy * len(values)


@pytest.mark.parametrize("values", [[-1], [LARGEST + 1], [3, -5]])
def test_numbers_that_cannot_be_packed_are_refused(values):
    with pytest.raises(ValueError, match="numbers from 0"):
        pack_integers(np.array(values))


def test_damaged_bytes_are_refused():
    packed = pack_integers(np.arange(199))
    with pytest.raises(ValueError, match="199 packed numbers where at most 198"):
        unpack_integers(packed, 0, 198)
    for length in range(len(packed)):
        with pytest.raises(ValueError, match=r"cut off|inflate|fit"):
            unpack_integers(packed[:length], 0, 200)
    with pytest.raises(ValueError, match="does not end"):
        unpack_integers(b"\xff" * 9, 0, 10)
    with pytest.raises(ValueError, match="symbols up to 65, got 200"):
        unpack_integers(b"\x01" + bytes([len(deflated := _deflate(b"\xc8"))]) + deflated, 0, 1)
    with pytest.raises(ValueError, match="filled with zeros"):
        unpack_integers(packed[:-1] + bytes([packed[-1] | 1]), 0, 200)


def _deflate(data):
    import zlib

    return zlib.compress(data, wbits=-15)


def test_a_bomb_is_not_inflated():
    deflated = _deflate(b"\x00" * 10_000_000)
    head = b"\x05" + bytes([len(deflated) & 127 | 128, len(deflated) >> 7 & 127 | 128, len(deflated) >> 14])
    with pytest.raises(ValueError, match="inflate to 5 symbols, got 6"):
        unpack_integers(head + deflated, 0, 10)


def test_numbers_of_fixed_width():
    values = np.array([5, 0, 7, 1])
    assert write_fixed(values, 3) == bytes([0b10100011, 0b10010000])
    again, end = read_fixed(b"xx" + write_fixed(values, 3), 2, 4, 3)
    assert (again.tolist(), end) == (values.tolist(), 4)
    assert read_fixed(b"", 0, 4, 0)[0].tolist() == [0] * 4
    with pytest.raises(ValueError, match="4 numbers of 3 bits do not fit the 1 bytes"):
        read_fixed(b"x", 0, 4, 3)
