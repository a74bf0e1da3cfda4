"""Tables of what was counted on a street."""

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.runtime.text_tables import align_columns
from toolkit.runtime.writing import write_text

StreetRow = dict[str, Any]  # JSON object of counts, of conflicts, or of one of them


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


def describe_stretch(result: StreetRow, describe: Callable[[StreetRow], str]) -> list[str]:
    """Lines about the stretch of a street that was recorded with rays, none without one.

    result: all results; describe: function that returns the text of the stretch's results."""
    if "stretch" not in result:
        return []
    return ["errors of the sensors, in a stretch with rays:", describe(result["stretch"])]


def _format_cell(value: object) -> object:
    """Value of a cell: a number to two decimals, "" for an infinite or unknown one."""
    if not isinstance(value, float):
        return value
    return f"{value:.2f}" if np.isfinite(value) else ""
