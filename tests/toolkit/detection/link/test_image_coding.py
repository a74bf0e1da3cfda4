"""Pixels of range images as bytes and back, exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toolkit.detection.link.image_coding import MOST_STEPS, _added_up, _predicted, decode_pixels, encode_pixels


def images(rng):
    """Steps and masks from empty to full, smooth to noise."""
    shape = tuple(rng.integers(1, 20, 2).tolist())
    kind = rng.integers(4)
    mask = rng.random(shape) < rng.choice([0.0, 0.1, 0.5, 0.95, 1.0])
    if kind == 0:
        steps = rng.integers(0, MOST_STEPS, shape)
    elif kind == 1:
        steps = np.full(shape, rng.integers(0, 5000))
    else:
        steps = np.add.outer(np.arange(shape[0]) * 3, np.arange(shape[1])) * kind + rng.integers(0, 4, shape)
    return steps.astype(np.int64), mask


@settings(deadline=None, max_examples=80)
@given(st.integers(0, 2**32))
def test_every_image_comes_back_exactly(seed):
    steps, mask = images(np.random.default_rng(seed))
    again, marked = decode_pixels(encode_pixels(steps, mask), mask.shape)
    np.testing.assert_array_equal(marked, mask)
    np.testing.assert_array_equal(again, np.where(mask, steps, 0))


def test_the_prediction_is_that_of_loco_i():
    """Left 7 and up 3 about upper left: the edge's other side, or the plane between."""
    for upper_left, guess in ((9, 3), (7, 3), (1, 7), (3, 7), (5, 5), (4, 6)):
        steps, mask = np.array([[upper_left, 3], [7, 100]]), np.ones((2, 2), bool)
        assert _predicted(steps, mask)[3] == guess
        residuals = np.array([upper_left, 3 - upper_left, 7 - upper_left, 100 - guess])
        assert _added_up(mask, residuals)[1, 1] == 100


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
    assert _predicted(steps, mask)[-1] == guess
    np.testing.assert_array_equal(decode_pixels(encode_pixels(steps, mask), (2, 3))[0], np.where(mask, steps, 0))


def test_a_pixel_alone_is_predicted_from_the_one_before():
    mask = np.zeros((3, 5), bool)
    mask[0, 4] = mask[2, 0] = True
    assert _predicted(np.full((3, 5), 700), mask).tolist() == [0, 700]


def test_a_car_before_nothing_takes_little():
    """Forty rows of sixty pixels, smooth but for a noise of half a step."""
    rng = np.random.default_rng(0)
    mask = np.zeros((150, 200), bool)
    mask[60:100, 70:130] = True
    steps = 500 + np.add.outer(np.zeros(150), np.arange(200) * 0.3) + rng.normal(0, 0.5, (150, 200))
    assert 8 * len(encode_pixels(np.rint(steps).astype(np.int64), mask)) < 2.1 * mask.sum()
    assert len(encode_pixels(np.zeros((150, 200), np.int64), np.zeros((150, 200), bool))) < 10


def test_measurements_that_cannot_be_are_refused():
    for value in (-1, MOST_STEPS):
        with pytest.raises(ValueError, match="steps, got"):
            encode_pixels(np.array([[value]]), np.ones((1, 1), bool))


def test_what_no_encoder_writes_is_refused():
    from toolkit.detection.link.bit_packing import pack_integers

    def content(distances, residuals, way=0):
        return bytes([way]) + pack_integers(np.array(distances, int)) + pack_integers(np.array(residuals, int))

    assert decode_pixels(content([2, 2], [4, 1]), (1, 5))[0].tolist() == [[0, 2, 1, 0, 0]]
    for wrong, said in (
        (b"", "begins with 0 or 1"),
        (content([2], [0], way=7), "begins with 0 or 1"),
        (content([0, 2], [4]), "lie outside"),
        (content([4, 2], [4]), "lie outside"),
        (content([2, 2], [4, 1, 0]), "2 pixels are marked, got 3 residuals"),
        (content([2, 2], [4, 1]) + b"x", "got 2 residuals and 1 bytes more"),
        (content([2, 2], [1, 1]), "a measurement of -1 steps"),
        (content([1] * 6, []), "6 packed numbers where at most 5"),
    ):
        with pytest.raises(ValueError, match=said):
            decode_pixels(wrong, (1, 5))
