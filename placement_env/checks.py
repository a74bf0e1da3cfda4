"""Rules for numbers that users give."""

from collections.abc import Collection
from numbers import Real
from typing import TypeGuard

import numpy as np

from toolkit.runtime.run import check_whole as check_whole


def whole(value: object) -> TypeGuard[int]:
    """True if a value is a whole number; True and False do not count as numbers."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_range(name: str, value: object, *, least: int, unit: str) -> None:
    """Raise ValueError unless a number, or both ends of a range, are whole and at least `least`.

    name: name of the option in the error; value: a number, or a list or tuple (lowest, highest);
    unit: unit of the number in the error."""
    limits = tuple(value) if isinstance(value, list | tuple) else (value, value)
    if (
        len(limits) != 2
        or not all(whole(limit) and limit >= least for limit in limits)
        or limits[0] > limits[1]
    ):
        rule = f"{name} must be at least {least} {unit}, a whole number or (lowest, highest) of two"
        raise ValueError(f"{rule}, got {value!r}")


def check_choice(name: str, value: object, choices: Collection[str]) -> None:
    """Raise ValueError unless a value is one of the choices. name: its option in the error."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")


def check_iou(iou: object) -> None:
    """Raise ValueError unless an IoU threshold is in (0, 1]."""
    if not isinstance(iou, Real) or isinstance(iou, bool) or not 0 < float(iou) <= 1:
        raise ValueError(f"iou must lie in (0, 1], got {iou!r}: the paper has 0.7")
