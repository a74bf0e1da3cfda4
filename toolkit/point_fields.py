"""The named columns of a point file as a cloud's attributes: positions, normals, colours, and the rest as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from toolkit.arrays import Shaped

Attributes = dict[str, np.ndarray]  # each (n, columns)

NORMALS = (("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz"))
COLOURS = (("red", "green", "blue"), ("r", "g", "b"))


def attributes_of(columns: Mapping[str, Shaped[np.ndarray, "..."]]) -> Attributes:
    """`positions` from x, y and z, which must be there, `normals` and `colors` where there are some, every other column
    of numbers under its own name. Positions are float32 or float64, whatever else they were.

    >>> {name: array.shape for name, array in attributes_of(dict.fromkeys(["x", "y", "z", "t"], np.zeros(5))).items()}
    {'positions': (5, 3), 't': (5, 1)}
    """
    left = {name: np.asarray(column) for name, column in columns.items()}
    made: Attributes = {"positions": _together(left, "x", "y", "z")}
    if made["positions"].dtype not in (np.float32, np.float64):
        made["positions"] = made["positions"].astype(np.float64)
    for three in NORMALS:
        if set(three) <= left.keys():
            made["normals"] = _together(left, *three).astype(made["positions"].dtype)
            break
    for packed in ("rgb", "rgba"):
        if packed in left and left[packed].dtype.itemsize == 4 and left[packed].shape[1:] in ((), (1,)):
            word = np.ascontiguousarray(left.pop(packed)).reshape(-1).view(np.uint32)
            made["colors"] = np.stack([word >> 16, word >> 8, word], axis=1).astype(np.uint8)
    for three in COLOURS:
        if "colors" not in made and set(three) <= left.keys():
            made["colors"] = _colours(_together(left, *three))
            break
    reserved = {"positions", "normals", "colors"}
    for name, column in left.items():
        if column.dtype.kind in "fiub" and column.ndim <= 2 and name and name not in reserved:
            made[name] = column if column.ndim == 2 else column[:, None]
    return made


def _together(left: dict[str, np.ndarray], *names: str) -> np.ndarray:
    return np.stack([left.pop(name).reshape(-1) for name in names], axis=1)


def _colours(values: np.ndarray) -> np.ndarray:
    """uint8 where they are whole numbers of 0..255, as files have them; else as they are."""
    whole = np.isfinite(values).all() and (values == np.trunc(values)).all() and ((values >= 0) & (values <= 255)).all()
    return values.astype(np.uint8 if whole else np.float32)


def missing(names: Sequence[str]) -> list[str]:
    """Which of x, y and z are not among the names."""
    return [axis for axis in "xyz" if axis not in names]
