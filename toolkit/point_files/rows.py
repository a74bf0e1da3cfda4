"""Rows of points in files: as text and as bytes."""

import math
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np

MAX_FIELDS = 1000  # fields of a point


def whole_numbers(words: list[str]) -> list[int]:
    """Whole numbers of a header. Raises ValueError for other words."""
    try:
        return [int(word) for word in words]
    except ValueError:
        raise ValueError(
            f"its header has {' '.join(words)[:40]!r} where whole numbers belong"
        ) from None


def read_rows(
    path: Path, skipped: int, row: np.dtype, rows: int, *, last: bool = True
) -> list[np.ndarray]:
    """Columns of a table in a text file, with a row in each line.

    Args:
        path: The file.
        skipped: Number of lines before the table.
        row: Type of a row, with a field for each column.
        rows: Number of rows.
        last: True if no further lines may follow the table."""
    names = row.names or ()
    kinds = [row[name].base for name in names]
    shapes = [row[name].shape for name in names]
    table = _parse_text(path, skipped, row, max_rows=None if last else rows)
    if table is None:
        width = sum(map(math.prod, shapes))
        raise ValueError(
            f"it is damaged or cut off: a row has not {width} cells, or one is not a number"
        )
    if len(table) != rows:
        cut = "it is cut off, " if len(table) < rows else ""
        raise ValueError(f"{cut}{len(table)} of {rows} rows are there")
    return [_fit(table[name], kind) for name, kind in zip(names, kinds, strict=True)]


def _parse_text(path: Path, skipped: int, row: np.dtype, max_rows: int | None) -> np.ndarray | None:
    """Table of a text file, None if its rows have other cells than `row`.

    skipped: number of lines before the table; row: type of a row; max_rows: None for all. Columns
    are float64, or of their type in `row` if it has 8 bytes and the text allows it: whole numbers
    may be written as floats."""
    exact_fields = []  # whole numbers of 8 bytes are not exact as floats
    float_fields = []
    for name in row.names or ():
        kind = row[name].base
        shape = row[name].shape
        exact_fields.append((name, kind if kind.itemsize == 8 else "f8", shape))
        float_fields.append((name, "f8", shape))
    for fields in (exact_fields, float_fields):
        with warnings.catch_warnings(), suppress(ValueError, OverflowError, DeprecationWarning):
            # NumPy only warns when it reads a number such as 1.5 as a whole one
            warnings.simplefilter("error", DeprecationWarning)
            warnings.simplefilter("ignore", UserWarning)  # no rows at all
            return np.loadtxt(
                path,
                np.dtype(fields),
                comments=None,
                encoding="latin-1",
                skiprows=skipped,
                max_rows=max_rows,
                ndmin=1,
            )
    return None


def _fit(column: np.ndarray, kind: np.dtype) -> np.ndarray:
    """Return a column as numbers of type `kind`. Raises ValueError if it does not fit."""
    if kind.kind in "iu" and column.dtype.kind == "f":
        limits = np.iinfo(kind)
        if not ((column >= limits.min) & (column <= limits.max)).all():
            raise ValueError(f"a number of its table does not fit its type {kind}")
    with np.errstate(all="ignore"):
        return column.astype(kind)


def read_binary(body: bytes, row: np.dtype, points: int) -> list[np.ndarray]:
    """Columns of a table in a binary file. Raises ValueError for too few bytes or a row too many.

    body: bytes of the table; row: type of a row, with a field for each column; points: number of
    rows."""
    needed = points * row.itemsize
    if len(body) < needed:
        raise ValueError(f"it is cut off, {len(body)} of {needed} bytes are there")
    if len(body) >= needed + row.itemsize:  # fewer bytes after the table are no row
        raise ValueError(
            f"its header says {points} points, {needed} bytes, but {len(body)} are there"
        )
    table = np.frombuffer(body, row, points)
    return [np.ascontiguousarray(table[name]) for name in row.names or ()]
