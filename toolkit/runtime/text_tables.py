"""Tables as lines of text, and names of others made safe to print."""

import re
from collections.abc import Sequence

_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def escape(text: object) -> str:
    r"""Replace characters that control a terminal, change the writing direction or are unprintable.

    They become escape sequences. Names come from other people's files."""
    return _UNPRINTABLE.sub(lambda match: match[0].encode("unicode_escape").decode(), str(text))


def align_columns(table: Sequence[Sequence[str]], *, texts: int) -> str:
    """Text of a table in lines, its first `texts` columns aligned to the left, others to the right.

    table: rows of equally many cells, with the headings as the first row."""
    rows = [_escape_breaks(row) for row in table]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    justify = [str.ljust] * texts + [str.rjust] * (len(widths) - texts)
    lines = []
    for row in rows:
        cells = [side(cell, width) for side, cell, width in zip(justify, row, widths, strict=True)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def _escape_breaks(row: Sequence[str]) -> list[str]:
    r"""Cells of a row with line breaks as \n, so that each row is one line."""
    return [cell.replace("\n", "\\n") for cell in row]
