"""Tables of figures as text, for terminals."""

from __future__ import annotations

from collections.abc import Sequence


def columns(table: Sequence[Sequence[str]]) -> str:
    """Rows of cells as aligned columns, the first to the left.

    >>> print(columns([["sensor", "AP"], ["north", "0.5"]]))
    sensor   AP
    north   0.5
    """
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    sides = [str.ljust] + [str.rjust] * (len(widths) - 1)
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)).rstrip()
        for row in table
    )
