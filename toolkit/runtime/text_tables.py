"""Tables as lines of text."""

from __future__ import annotations

from collections.abc import Sequence


def align_columns(table: Sequence[Sequence[str]], *, texts: int) -> str:
    """Align the columns of a table; the first `texts` to the left.

    >>> print(align_columns([["scheme", "kbit"], ["late", "2.5"]], texts=1))
    scheme  kbit
    late     2.5
    """
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    sides = [str.ljust] * texts + [str.rjust] * (len(widths) - texts)
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, line, widths, strict=True)).rstrip()
        for line in table
    )
