"""Tables as lines of text, and names of others made safe to print."""

import re
from collections.abc import Sequence

_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def escape(text: object) -> str:
    r"""Replace what steers a terminal, turns the direction of writing or is no character by its
    escape sequence.

    Names come out of files of others."""
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))


def align_columns(table: Sequence[Sequence[str]], *, texts: int) -> str:
    """Align the columns of a table; the first `texts` to the left."""
    table = [[cell.replace("\n", "\\n") for cell in line] for line in table]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    sides = [str.ljust] * texts + [str.rjust] * (len(widths) - texts)
    rows = [zip(sides, line, widths, strict=True) for line in table]
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in row).rstrip() for row in rows
    )
