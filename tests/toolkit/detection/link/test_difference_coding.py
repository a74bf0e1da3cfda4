"""Pixels of range images as differences from what is known, and back, exactly."""

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toolkit.detection.link.difference_coding import (
    Reference,
    decode_difference,
    encode_difference,
    still_squares,
)
from toolkit.detection.link.image_coding import MOST_STEPS, encode_pixels


def reference_of(steps, sent=None, step_mm=20):
    steps = np.array(steps)
    return Reference.of(3, step_mm, steps, np.ones(steps.shape, bool) if sent is None else np.array(sent, bool))


def sequence(rng, images=4):
    """Images of something that stands still, moves or is none, with noise or without."""
    shape = tuple(rng.integers(1, 30, 2).tolist())
    mask, base = rng.random(shape) < rng.random(), rng.integers(0, 3000, shape)
    for _ in range(images):
        if rng.random() < 0.3:
            mask, base = np.roll(mask, 1, axis=1), np.roll(base, 1, axis=1)
        steps = np.clip(base + rng.integers(-2, 3, shape), 0, None)
        yield steps.astype(np.int64), mask ^ (rng.random(shape) < 0.05)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32), st.booleans())
def test_every_image_comes_back_exactly(seed, any_squares):
    rng = np.random.default_rng(seed)
    reference = None
    for number, (steps, sent) in enumerate(sequence(rng)):
        if reference is not None:
            squares = still_squares(reference, steps, sent)
            squares = rng.random(squares.shape) < 0.5 if any_squares else squares
            content = encode_difference(steps, sent, reference, squares)
            again, marked, end = decode_difference(b"xy" + content + b"z", 2, reference)
            np.testing.assert_array_equal(marked, sent)
            np.testing.assert_array_equal(again, np.where(sent, steps, 0))
            assert end == len(content) + 2
        before = reference or Reference.of(number, 20, steps, sent)
        reference = before.after(number, steps, sent)


def test_means_of_what_stands_still_are_of_eight_images_at_most():
    reference = reference_of([[100, 100, 100]])
    fine = [[100 * 16.0], [100 * 16.0]]
    for image, value in enumerate([102, 98, 101, 101, 100, 99, 104, 104, 104, 104]):
        reference = reference.after(4 + image, np.array([[value, 300, 100]]), np.array([[True, True, False]]))
        share = min(image + 2, 8)
        fine[0].append(fine[0][-1] + (16 * value - fine[0][-1]) / share)
        assert abs(reference.fine[0, 0] - fine[0][-1]) <= 1 + image * 0.5
        assert reference.images[0].tolist() == [share, 1 if image == 0 else min(image + 1, 8), 0]
    assert reference.fine[0, 1:].tolist() == [300 * 16, 0]
    assert reference.number == 13
    exact = reference_of([[10]]).after(4, np.array([[11]]), np.ones((1, 1), bool))
    assert (exact.fine.tolist(), exact.rounded.tolist()) == ([[168]], [[11]])  # 10.5, rounded half up
    assert exact.after(5, np.array([[10]]), np.ones((1, 1), bool)).fine.tolist() == [[165]]  # 168 - 8/3, rounded


@pytest.mark.parametrize(("step_mm", "most"), [(20, 4), (40, 2), (80, 1), (200, 1), (5, 16), (30, 3)])
def test_eight_centimetres_are_no_motion(step_mm, most):
    reference = reference_of([[100, 100, 100, 100, 100]], [[1, 1, 1, 1, 0]], step_mm)
    steps = np.array([[100 + most, 100 - most, 101 + most, 99 - most, 100]])
    assert reference.standing(steps, np.ones((1, 5), bool)).tolist() == [[True, True, False, False, False]]


def test_a_square_stands_still_when_more_than_six_tenths_of_it_do():
    reference = reference_of(np.full((8, 20), 50))
    steps = np.full((8, 20), 50)
    steps[:5, 8:16] = 90  # 24 of 64 stand
    steps[:3, :8] = 90  # 40 of 64
    steps[0, 16:] = 90  # 28 of 32
    assert still_squares(reference, steps, np.ones((8, 20), bool)).tolist() == [[True, False, True]]
    assert not still_squares(reference, steps, np.zeros((8, 20), bool)).any()


def test_what_stands_takes_two_bits_a_pixel_and_what_is_as_known_next_to_none():
    rng = np.random.default_rng(0)
    mask = np.zeros((150, 200), bool)
    mask[60:100, 70:130] = True
    base = 500 + np.add.outer(np.zeros(150), np.arange(200) * 0.3) + np.zeros((150, 200))
    images = [np.rint(base + rng.normal(0, 0.75, base.shape)).astype(np.int64) for _ in range(9)]
    reference = Reference.of(0, 20, images[0], mask)
    for number, image in enumerate(images[1:8]):
        reference = reference.after(number + 1, image, mask)
    content = encode_difference(images[8], mask, reference, still_squares(reference, images[8], mask))
    assert 8 * len(content) < 2.1 * mask.sum() < 0.9 * 8 * len(encode_pixels(images[8], mask))
    same = encode_difference(reference.rounded, mask, reference, still_squares(reference, reference.rounded, mask))
    assert len(same) < 50


def test_the_checksum_is_of_all_that_is_known():
    known = reference_of([[100, 7]], [[1, 0]])
    assert known.checksum == reference_of([[100, 9]], [[1, 0]]).checksum
    assert known.checksum == zlib.crc32(struct.pack("<5q", 3, 20, 0, 1600, 1))
    others = [
        reference_of([[101, 7]], [[1, 0]]), reference_of([[100, 100]], [[0, 1]]), replace(known, number=4),
        replace(known, step_mm=40), replace(known, images=2 * known.images), reference_of([[100, 7]]),
    ]  # fmt: skip
    assert len({each.checksum for each in (known, *others)}) == 7


def test_what_no_encoder_writes_is_refused():
    from toolkit.detection.link.bit_packing import pack_integers
    from toolkit.detection.link.image_coding import encode_mask

    reference, nobody = reference_of([[5, 6, 7]]), np.zeros((1, 3), bool)
    steps, sent = np.array([[5, 6, 7]]), np.ones((1, 3), bool)
    sound = encode_difference(steps, sent, reference, np.ones((1, 1), bool))
    np.testing.assert_array_equal(decode_difference(sound, 0, reference)[0], steps)

    def content(still, others=(), squares=b"\x80"):
        return (
            squares + encode_mask(nobody) + pack_integers(np.array(still, int)) + pack_integers(np.array(others, int))
        )

    for wrong, said in (
        (b"", "do not fit"),
        (content([0, 0, 0], squares=b"\x81"), "filled with zeros"),
        (content([0, 0]), "3 pixels stand still, got 2"),
        (content([0, 0, 0], [1]), "0 pixels are marked, got 1"),
        (content([0, 0, 15]), "cannot be"),
        (content([0, 0, 2 * MOST_STEPS]), "cannot be"),
        (sound[:-1], "inflate to 0 symbols"),
    ):
        with pytest.raises(ValueError, match=said):
            decode_difference(wrong, 0, reference)
    with pytest.raises(ValueError, match="the reference is an image of"):
        encode_difference(np.zeros((2, 3), int), np.ones((2, 3), bool), reference, np.ones((1, 1), bool))
