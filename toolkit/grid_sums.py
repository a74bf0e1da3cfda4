"""Sums over the neighbours of every cell of a grid."""

import numpy as np

from toolkit.arrays import Shaped


def sum_squares_around(
    values: Shaped[np.ndarray, "rows columns"], reach: int
) -> Shaped[np.ndarray, "rows columns"]:
    """Return the sum over the square around each cell, which has 2 · reach + 1 cells on a side.

    Cells beyond the grid count as 0. Sums have the dtype of the values, so give counts as int64 and
    not as bool. reach: cells from the middle of the square to its sides.

    >>> sum_squares_around(np.array([[1, 2, 3], [4, 5, 6]]), 1)
    array([[12, 21, 16],
           [12, 21, 16]])
    """
    # Integral image (cumulative sums along both axes, with a row and a column of 0 in front): the
    # sum over a square is the difference of its values at the square's four corners.
    side = 2 * reach + 1
    padded = np.pad(values, reach)
    sums = np.pad(padded.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
