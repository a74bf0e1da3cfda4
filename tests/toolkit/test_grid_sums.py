"""Sums over squares against a convolution of SciPy."""

import numpy as np
import pytest
from scipy.ndimage import convolve

from toolkit.grid_sums import sum_squares_around


@pytest.mark.parametrize("dtype", [np.int64, np.float64])
@pytest.mark.parametrize("reach", [0, 1, 3])
def test_sums_around_cells_are_those_of_a_convolution(reach, dtype):
    values = np.random.default_rng(reach).integers(-9, 9, (7, 5)).astype(dtype)
    sums = sum_squares_around(values, reach)
    square = np.ones((2 * reach + 1, 2 * reach + 1))
    np.testing.assert_array_equal(sums, convolve(values, square, mode="constant"))
    assert sums.dtype == dtype


def test_a_grid_without_cells_has_no_sums():
    assert sum_squares_around(np.zeros((0, 4)), 2).shape == (0, 4)
