"""Whole numbers for quantities in ETSI's messages (TS 102 894-2), with codes for what is beyond.

Numbers are rounded up: n means at most n units and more than n - 1, so that the middle of what a
number means is half a unit below it."""

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.datasets.problem_kinds import Problems, add_problem

_DECIMALS = 6  # digits of a unit that count, so that 0.07 m are 7 cm in binary, too
_TENTHS_PER_TURN = 3600


@dataclass(frozen=True)
class NumberRange:
    """Numbers that a message has for a quantity.

    Attributes:
        unit: Size of one, in the quantity's unit.
        below: Code for quantities below the range; the next number is the lowest.
        above: Code for quantities above the range; the number before it is the highest.
        problem: Kind under which quantities out of range are counted.
    """

    unit: float
    below: int
    above: int
    problem: str

    def encode(
        self, values: Float64[np.ndarray, "*shape"], problems: Problems
    ) -> Int64[np.ndarray, "*shape"]:
        """Return the number of each finite value, in the shape of the values.

        problems: values out of range are counted in it."""
        numbers = round_up(values, self.unit)
        is_beyond = (numbers <= self.below) | (numbers >= self.above)
        add_problem(problems, self.problem, int(is_beyond.sum()))
        return np.clip(numbers, self.below, self.above)


def round_up(values: Float64[np.ndarray, "*shape"], unit: float) -> Int64[np.ndarray, "*shape"]:
    """Return the least whole numbers of units that finite values do not exceed.

    >>> round_up(np.array([0.07, 0.071, -0.071]), 0.01)
    array([ 7,  8, -7])
    """
    return np.ceil(np.round(values / unit, _DECIMALS)).astype(np.int64)


def encode_angles(angles: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Return angles (rad) as tenths of a degree, 0 to 3599; 3600 must not be used.

    >>> encode_angles(np.deg2rad([0.0, 90.01, 359.99, -0.05]))
    array([  0, 901,   0,   0])
    """
    return round_up(np.rad2deg(angles), 0.1) % _TENTHS_PER_TURN


def encode_degrees(degrees: float) -> int:
    """Return a latitude or longitude in 0.1 microdegree, the nearest number."""
    return round(degrees * 1e7)
