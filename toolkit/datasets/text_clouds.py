"""Clouds in text files: rows of numbers, and names of their columns above."""

import csv
import io
import re
import warnings
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64
from toolkit.point_columns import find_axes, warn_of_offset
from toolkit.runtime import reading

MIN_NUMBERED_ROWS = 5  # rows whose first cells 0, 1, 2, ... are no coordinates
MAX_SHOWN = 60  # characters of a row in an error
_DECIMAL_COMMA = (
    r'(?m)^[^#/\n]*\d,\d+[^\S\r\n]+-?\d|"[-+]?\d+,\d+"'  # with blanks or quotes between the cells
)
_COMMENT = "#|//"


def read_text_columns(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a text file by name, as float64.

    Names are in a line or comment above the rows; without names the first three are x, y, z.
    Other columns are read if they are named and purely numeric."""
    text = reading.read_text(path)
    rows = _drop_count(split_rows(text.replace('"', "") if '"' in text else text))
    warn_of_offset(_first_comments(text))
    names: list[str] = []
    if rows and not any(map(_is_number, rows[0])):
        names = _split_header(_line_at(text, 0))
        rows = _drop_count(rows[1:])
    elif rows:
        names = _header_in_comments(text, len(rows[0]))
    widths = {len(row) - (not row[-1]) for row in rows}  # a row may end in its separator
    counts = sorted(widths | ({len(names) - (not names[-1])} if names else set()))
    if re.search(_DECIMAL_COMMA, text):
        raise ValueError(f"{path} must have no decimal commas: write points for them")
    if len(counts) > 1:
        got = f"got rows of {' and '.join(map(str, counts[:4]))}"
        raise ValueError(f"{path} must have as many cells in each row as names, {got}")
    if rows and not names:
        rows = _check_numbering(path, rows)
    column_by_name = _find_columns(path, names) if names else {"x": 0, "y": 1, "z": 2}
    try:
        table = {name: _parse_column(rows, column) for name, column in column_by_name.items()}
    except (ValueError, IndexError):
        columns = [*column_by_name.values()]
        row = next(row for row in rows if not _has_numbers(row, columns))
        got = f"got {', '.join(row)[:MAX_SHOWN]!r}"
        raise ValueError(
            f"{path} must hold x y z in every row, numbers with decimal points only, {got}"
        ) from None
    if not names and max(widths, default=0) >= 6 and "," in text and "." not in text:
        warnings.warn(
            f"{path}: all numbers are whole: if its commas are decimal, write points for them",
            stacklevel=2,
        )
    for column, name in enumerate(names):
        is_extra = name and name not in column_by_name
        if is_extra and all(_has_numbers(row, [column]) for row in rows):
            table[name.lower()] = _parse_column(rows, column)
    return table


def _find_columns(path: Path, names: list[str]) -> dict[str, int]:
    """Return the index of the columns with x, y and z, by their names, in this order.

    path: the file, for errors; names: names of all columns, "" for a column without one. Raises
    ValueError for a repeated name, or if no columns are named as coordinates."""
    repeated_names = {name for name in names if name and names.count(name) > 1}
    if repeated_names:
        raise ValueError(
            f"{path} must have each column once, got {', '.join(sorted(repeated_names))} again"
        )
    with reading.name_errors(path):
        coordinate_names = find_axes(names).names
    return {name: names.index(name) for name in coordinate_names}


def _parse_column(rows: Sequence[Sequence[str]], column: int) -> Float64[np.ndarray, " n"]:
    return np.array([float(row[column]) for row in rows])


def _has_numbers(row: Sequence[str], columns: Sequence[int]) -> bool:
    return all(len(row) > column and _is_number(row[column]) for column in columns)


def _drop_count(rows: list[list[str]]) -> list[list[str]]:
    """Return rows without a first row that holds how many follow.

    PTS files and CloudCompare's text have such a row."""
    return rows[1:] if rows and rows[0] == [str(len(rows) - 1)] else rows


def _check_numbering(path: Path, rows: list[list[str]]) -> list[list[str]]:
    """Return the rows of a file without names, less a first row that numbers the columns.

    path: the file, for messages; rows: cells of each row. Raises ValueError if the first column
    numbers the rows, so that x would be their number."""
    width = len(rows[0])
    if width >= 3 and len(rows) > 1 and rows[0] == [str(k) for k in range(width)]:
        warnings.warn(
            f"{path}: its first row, {' '.join(rows[0])}, numbers the columns and is left out",
            stacklevel=4,
        )
        rows = rows[1:]
    first_cell = rows[0][0]
    if width < 4 or len(rows) < MIN_NUMBERED_ROWS or first_cell not in ("0", "1"):
        return rows
    row_numbers = [str(int(first_cell) + k) for k in range(len(rows))]
    if [row[0] for row in rows] == row_numbers:
        raise ValueError(
            f"{path} numbers its rows in the first column: name the columns in a line above"
        )
    return rows


def split_rows(text: str) -> list[list[str]]:
    """Return the cells of each line that has any, without comments.

    Cells are separated by ; or, in a line without one, by a comma, and by blanks in both."""
    rows = []
    for full_line in text.splitlines():
        line = re.split(_COMMENT, full_line)[0].strip()
        if line:
            separator = ";" if ";" in line else ","
            rows.append(re.split(rf"\s*{separator}\s*|\s+", line))
    return rows


def _line_at(text: str, number: int) -> str:
    """Return a line of a text by its number, from 0, among the lines with more than a comment."""
    lines = (re.split(_COMMENT, line)[0].strip() for line in io.StringIO(text, newline=None))
    lines_with_cells = (line for line in lines if line)
    return next(islice(lines_with_cells, number, None))


def _split_header(line: str) -> list[str]:
    """Return the names of columns in a line, without quotes and blanks around them."""
    # a unit in brackets belongs to the name before it
    header = re.sub(r"\s+(?=[(\[])", "", line.strip())
    separator = next((mark for mark in (";", ",", "\t") if mark in header), None)
    if separator is None:
        return [name.strip("\"'") for name in header.split()]
    try:
        cells = next(csv.reader([header], delimiter=separator, skipinitialspace=True))
    except csv.Error:  # such as a cell of more than 131,072 characters, which names no column
        cells = header.split(separator)
    return [cell.strip().strip("'") for cell in cells]


def _header_in_comments(text: str, width: int) -> list[str]:
    """Return the names of columns in the last comment above the rows, [] if they do not fit.

    They fit if they are as many as a row's cells and include coordinates. width: number of
    cells."""
    comments = _first_comments(text)
    names = _split_header(comments[-1]) if comments else []
    try:
        find_axes(names)  # raises without x, y and z
    except ValueError:
        return []
    return names if len(names) == width else []


def _first_comments(text: str) -> list[str]:
    """Return the comments above the first row of a text, without their marks."""
    comments = []
    for line in io.StringIO(text, newline=None):
        comment = re.match(rf"\s*(?:{_COMMENT})+(.*)", line)
        if comment is None and line.strip():  # the first row
            break
        if comment is not None and comment[1].strip():
            comments.append(comment[1])
    return comments


def _is_number(cell: str) -> bool:
    """Return True if a cell can be read as a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
