"""Tables of what was counted on a street."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from toolkit.runtime.text_tables import align_columns
from toolkit.runtime.writing import write_text

StreetRow = Mapping[str, object]


def write_rows(out: Path, columns: Sequence[str], rows: Sequence[StreetRow]) -> None:
    """Write rows as CSV. columns: names of the columns."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_format_cell(row[name]) for name in columns])
    write_text(out, text.getvalue())


def align_rows(columns: Sequence[str], rows: Sequence[StreetRow], *, texts: int) -> str:
    """Lines of a table. columns: names of the columns, the first `texts` of them for texts."""
    cells = [list(columns)]
    for row in rows:
        cells.append([str(_format_cell(row[name])) for name in columns])
    return align_columns(cells, texts=texts)


def _format_cell(value: object) -> object:
    """Value of a cell: a number to two decimals, "" for an infinite or unknown one."""
    if not isinstance(value, float):
        return value
    return f"{value:.2f}" if np.isfinite(value) else ""
