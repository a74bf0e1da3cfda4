"""Rules for the numbers that users give, each said in one place."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np


def whole(value: Any) -> bool:
    """Whether it is a whole number; a truth value is none.

    >>> whole(3), whole(np.int8(3)), whole(3.0), whole(True)
    (True, True, False, False)
    """
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_whole(name: str, value: Any, *, least: int) -> None:
    """Raises ValueError where a number is no whole one from `least` up."""
    if not whole(value) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")


def check_range(name: str, value: Any, *, least: int, unit: str) -> None:
    """Raises ValueError where a number, or the ends of a range, are no whole numbers from `least` up."""
    ends = tuple(value) if isinstance(value, list | tuple) else (value, value)
    if len(ends) != 2 or not all(whole(end) and end >= least for end in ends) or ends[0] > ends[1]:
        raise ValueError(
            f"{name} must be at least {least} {unit}, a whole number or (lowest, highest) of two, got {value!r}"
        )


def check_iou(iou: Any) -> None:
    """Raises ValueError where an IoU threshold does not lie above 0 and up to 1."""
    if not isinstance(iou, Real) or isinstance(iou, bool) or not 0 < float(iou) <= 1:
        raise ValueError(f"iou must lie in (0, 1], got {iou!r}: the paper has 0.7")
