"""Whole numbers as bytes and back."""

import zlib

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.detection.link import image_coding

numbers = st.lists(
    st.one_of(st.integers(0, 20), st.integers(0, image_coding.MAX_PACKED)), max_size=60
)


@settings(deadline=None, max_examples=60)
@given(numbers, st.binary(max_size=5))
def test_what_was_packed_comes_back(values, before):
    packed = image_coding.pack_integers(np.array(values, np.int64))
    again, end = image_coding.unpack_integers(before + packed + b"more", len(before), len(values))
    assert again.tolist() == values
    assert end == len(before) + len(packed)


def test_numbers_are_packed_in_few_bytes():
    values = np.unique([(1 << k) + d for k in range(32) for d in (-1, 0, 1)])
    assert (
        image_coding.unpack_integers(image_coding.pack_integers(values), 0, len(values))[0].tolist()
        == values.tolist()
    )
    # One large number: its symbol 8 + 2 (7 - 4) + 1 in the deflated part, its 5 lower bits, filled
    # with zeros.

    packed = image_coding.pack_integers(np.array([1, 0b1101101]))
    assert packed[0] == 2
    assert zlib.decompress(packed[2 : 2 + packed[1]], -15) == bytes([1, 15])
    assert packed[2 + packed[1] :] == bytes([0b01101000])
    values = np.abs(np.rint(np.random.default_rng(0).normal(0, 2, 5000))).astype(np.int64)
    share = np.bincount(values) / len(values)
    entropy = -(share[share > 0] * np.log2(share[share > 0])).sum()
    assert 8 * len(image_coding.pack_integers(values)) < 1.08 * entropy * len(values)
    values = np.array([5, 0, 7, 1])
    assert image_coding.write_bits(values, 3) == bytes([0b10100011, 0b10010000])
    again, end = image_coding.read_bits(
        b"xx" + image_coding.write_bits(values, 3), 2, np.full(4, 3)
    )
    assert (again.tolist(), end) == (values.tolist(), 4)
    assert image_coding.read_bits(b"", 0, np.zeros(4, np.int64))[0].tolist() == [0] * 4
    with pytest.raises(ValueError, match="12 bits do not fit the 1 bytes"):
        image_coding.read_bits(b"x", 0, np.full(4, 3))


@pytest.mark.parametrize("values", [[-1], [image_coding.MAX_PACKED + 1], [3, -5]])
def test_numbers_that_cannot_be_packed_are_refused(values):
    with pytest.raises(ValueError, match="numbers from 0"):
        image_coding.pack_integers(np.array(values))


def test_damaged_bytes_and_bombs_are_refused():
    packed = image_coding.pack_integers(np.arange(199))
    with pytest.raises(ValueError, match="at most 198 packed numbers are possible, got 199"):
        image_coding.unpack_integers(packed, 0, 198)
    for length in range(len(packed)):
        with pytest.raises(ValueError, match=r"cut off|inflate|fit"):
            image_coding.unpack_integers(packed[:length], 0, 200)
    with pytest.raises(ValueError, match="does not end"):
        image_coding.unpack_integers(b"\xff" * 9, 0, 10)
    for symbols in (b"\xc8", b"\x01\xc8", b"\xc8\x01", b"\x42"):
        deflated = _deflate(symbols)
        with pytest.raises(ValueError, match=f"symbols up to 65, got {max(symbols)}"):
            image_coding.unpack_integers(
                bytes([len(symbols), len(deflated)]) + deflated + bytes(99), 0, 2
            )
    with pytest.raises(ValueError, match="filled with zeros"):
        image_coding.unpack_integers(packed[:-1] + bytes([packed[-1] | 1]), 0, 200)
    deflated = _deflate(b"\x00" * 10_000_000)
    head = b"\x05" + bytes(
        [len(deflated) & 127 | 128, len(deflated) >> 7 & 127 | 128, len(deflated) >> 14]
    )
    with pytest.raises(ValueError, match="inflate to 5 symbols, got 6"):
        image_coding.unpack_integers(head + deflated, 0, 10)


def _deflate(data):
    return zlib.compress(data, wbits=-15)


STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_HUFFMAN_ONLY, zlib.Z_FIXED)


def deflate_by(strategy, content):
    """Deflate as hard as zlib can, by one of its strategies, without a header."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15, 9, strategy)
    return packer.compress(content) + packer.flush()


def deflated_symbols(packed):
    """Deflated symbols within packed numbers, which follow two lengths."""
    _, start = image_coding.read_varint(packed, 0)
    length, start = image_coding.read_varint(packed, start)
    return packed[start : start + length]


def images(rng):
    """Steps and masks from empty to full, smooth to noise."""
    shape = tuple(rng.integers(1, 20, 2).tolist())
    kind = rng.integers(4)
    mask = rng.random(shape) < rng.choice([0.0, 0.1, 0.5, 0.95, 1.0])
    if kind == 0:
        steps = rng.integers(0, image_coding.MAX_RANGE_STEPS, shape)
    elif kind == 1:
        steps = np.full(shape, rng.integers(0, 5000))
    else:
        steps = np.add.outer(np.arange(shape[0]) * 3, np.arange(shape[1])) * kind + rng.integers(
            0, 4, shape
        )
    return steps.astype(np.int64), mask


@settings(deadline=None, max_examples=80)
@given(st.integers(0, 2**32))
def test_every_image_comes_back_exactly(seed):
    steps, mask = images(np.random.default_rng(seed))
    again, marked = image_coding.decode_pixels(image_coding.encode_pixels(steps, mask), mask.shape)
    np.testing.assert_array_equal(marked, mask)
    np.testing.assert_array_equal(again, np.where(mask, steps, 0))


def test_the_prediction_is_that_of_loco_i():
    """Left 7 and up 3 about upper left: the edge's other side, or the plane between."""
    for upper_left, guess in ((9, 3), (7, 3), (1, 7), (3, 7), (5, 5), (4, 6)):
        steps, mask = np.array([[upper_left, 3], [7, 100]]), np.ones((2, 2), bool)
        assert image_coding.predict_steps(steps, mask)[3] == guess
        residuals = np.array([upper_left, 3 - upper_left, 7 - upper_left, 100 - guess])
        assert image_coding.add_residuals(mask, residuals)[1, 1] == 100
    mask = np.zeros((3, 5), bool)
    mask[0, 4] = mask[2, 0] = True
    assert image_coding.predict_steps(np.full((3, 5), 700), mask).tolist() == [0, 700]
    # Forty rows of sixty pixels, smooth but for a noise of half a step.
    rng = np.random.default_rng(0)
    mask = np.zeros((150, 200), bool)
    mask[60:100, 70:130] = True
    steps = 500 + np.add.outer(np.zeros(150), np.arange(200) * 0.3) + rng.normal(0, 0.5, (150, 200))
    assert (
        8 * len(image_coding.encode_pixels(np.rint(steps).astype(np.int64), mask))
        < 2.1 * mask.sum()
    )
    assert (
        len(image_coding.encode_pixels(np.zeros((150, 200), np.int64), np.zeros((150, 200), bool)))
        < 10
    )
    for value in (-1, image_coding.MAX_RANGE_STEPS):
        with pytest.raises(ValueError, match="steps, got"):
            image_coding.encode_pixels(np.array([[value]]), np.ones((1, 1), bool))
        with pytest.raises(ValueError, match=f"a measurement of {value} steps is none"):
            image_coding.add_residuals(np.ones((1, 1), bool), np.array([value]))
    assert (
        image_coding.add_residuals(
            np.ones((1, 1), bool), np.array([image_coding.MAX_RANGE_STEPS - 1])
        )
        < image_coding.MAX_RANGE_STEPS
    )


@pytest.mark.parametrize(
    ("mask", "guess"),
    [
        ([[0, 1, 0], [1, 1, 0]], 5),  # left 8 and up 2: between
        ([[0, 1, 0], [0, 1, 0]], 2),  # up
        ([[0, 0, 0], [1, 1, 0]], 8),  # left
        ([[0, 0, 1], [0, 1, 0]], 4),  # upper right
        ([[1, 0, 0], [0, 1, 0]], 6),  # upper left
    ],
)
def test_what_is_not_there_is_not_predicted_from(mask, guess):
    steps = np.array([[6, 2, 4], [8, 50, 0]])
    mask = np.array(mask, bool)
    assert image_coding.predict_steps(steps, mask)[-1] == guess
    np.testing.assert_array_equal(
        image_coding.decode_pixels(image_coding.encode_pixels(steps, mask), (2, 3))[0],
        np.where(mask, steps, 0),
    )


def guess_slowly(steps, mask, given):
    """Predictions of the mask's pixels in the order of rows, by the words of LOCO-I, one after the
    other."""
    there, last, guesses = mask | given, 0, []
    for row, column in np.argwhere(mask).tolist():

        def near(up, across, row=row, column=column):
            i, j = row - up, column + across
            inside = i >= 0 and 0 <= j < mask.shape[1]
            return int(steps[i, j]) if inside and there[i, j] else None

        left, up, upper_left, upper_right = near(0, -1), near(1, 0), near(1, -1), near(1, 1)
        if left is not None and up is not None:
            plane = (
                (left + up) / 2
                if upper_left is None
                else np.median([left, up, left + up - upper_left])
            )
            guesses.append(int(np.floor(plane)))
        else:
            guesses.append(
                next(each for each in (up, left, upper_right, upper_left, last) if each is not None)
            )
        last = int(steps[row, column])
    return guesses


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 2**32))
def test_predictions_are_those_of_one_pixel_after_the_other(seed):
    """Small steps, nought among them, beside pixels of another image that are known and others that
    are not."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 7, 2).tolist())
    kinds, steps = rng.choice(3, shape, p=rng.dirichlet([1.0, 1.0, 1.0])), rng.integers(0, 4, shape)
    mask, known = kinds == 0, kinds == 1
    for given_pixels in (np.zeros(shape, bool), known):
        predicted = image_coding.predict_steps(
            steps, mask, given_pixels if given_pixels.any() else None
        )
        assert predicted.tolist() == guess_slowly(steps, mask, given_pixels)
        again = image_coding.add_residuals(mask, steps[mask] - predicted, (steps, given_pixels))
        assert again.tolist() == np.where(mask, steps, 0).tolist()


def test_what_no_encoder_writes_is_refused():

    def content(distances, residuals, way=0):
        return (
            bytes([way])
            + image_coding.pack_integers(np.array(distances, int))
            + image_coding.pack_integers(np.array(residuals, int))
        )

    assert image_coding.decode_pixels(content([2, 2], [4, 1]), (1, 5))[0].tolist() == [
        [0, 2, 1, 0, 0]
    ]
    for wrong, said in (
        *((b"", "begin with 0 or 1"), (content([2], [0], way=7), "begin with 0 or 1")),
        *((content([0, 2], [4]), "lie outside"), (content([4, 2], [4]), "lie outside")),
        (content([2, 2], [4, 1, 0]), "2 pixels are marked, got 3 residuals"),
        *(
            (content([2, 2], [4, 1]) + b"x", "got 1 bytes more"),
            (content([2, 2], [1, 1]), "a measurement of -1 steps"),
        ),
        (content([1] * 6, []), "at most 5 packed numbers are possible, got 6"),
    ):
        with pytest.raises(ValueError, match=said):
            image_coding.decode_pixels(wrong, (1, 5))


def test_the_shorter_way_of_a_mask_and_the_shortest_deflation_are_taken():
    """A stripe down the image changes twice in every row, but where it begins alone differs from
    left and up. One run through two rows changes along the rows twice."""
    stripe, run = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    stripe[:, 7:19] = True
    run[12, 9:], run[13, :30] = True, True
    for mask, way in ((stripe, 1), (run, 0)):
        packed = image_coding.encode_mask(mask)
        assert packed[0] == way
        assert image_coding.decode_mask(packed, 0, mask.shape)[0].tolist() == mask.tolist()
    for values in (
        np.arange(300) % 7,
        np.zeros(300, int),
        np.random.default_rng(0).integers(0, 2**20, 50),
        np.array([3]),
    ):
        deflated = deflated_symbols(image_coding.pack_integers(values))
        symbols = zlib.decompress(deflated, wbits=-15)
        assert len(deflated) == min(len(deflate_by(each, symbols)) for each in STRATEGIES)


@pytest.mark.parametrize(
    ("number", "content"),
    [
        (0, b"\0"),
        (127, b"\x7f"),
        (128, b"\x80\x01"),
        (300, b"\xac\x02"),
        (1 << 14, b"\x80\x80\x01"),
    ],
)
def test_numbers_of_variable_length_take_seven_bits_a_byte(number, content):
    assert image_coding.write_varint(number) == content
    assert image_coding.read_varint(b"x" + content + b"x", 1) == (number, 1 + len(content))


def test_of_equally_short_deflations_the_first_is_taken():
    """Messages of one image are the same bytes everywhere; each of four symbols has a code of its
    own in any way."""
    packed = image_coding.pack_integers(np.array([0, 1, 2, 3]))
    assert deflated_symbols(packed) == deflate_by(zlib.Z_DEFAULT_STRATEGY, bytes([0, 1, 2, 3]))
