"""Display of nouns: a short `repr`, a picture with a table in notebooks, and tables for pandas. A
noun gives a `Card`. It names the function that draws it, since pictures stand floors above most
nouns."""

import math
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

MOST_ROWS = 8  # rows of a table in a notebook
PICTURE_PIXELS = 800  # longest side of a picture in a notebook
_CELL = "padding:.15em .6em;text-align:left;white-space:nowrap"

Table = Mapping[str, Sequence[Any] | np.ndarray]  # columns of one length by name


@dataclass(frozen=True)
class Card:
    """Content that a noun shows.

    Attributes:
        title: Name of its class, mostly.
        facts: Short phrases.
        tables: Functions that build a table when it is needed, by its name; notebooks show the
            first.
        drawing: "module:function" that draws a picture, called with the noun and the name of a PNG
            file to write.
    """

    title: str
    facts: tuple[str, ...] = ()
    tables: Mapping[str, Callable[[], Table]] = field(default_factory=dict)
    drawing: str = ""


class Displayed:
    """Base of nouns that show themselves; dataclasses among them keep this `repr`."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.__repr__ = Displayed.__repr__  # type: ignore[method-assign]  # dataclass() replaces no method of the class

    def _card(self) -> Card:
        """Content of `repr`, notebook and tables."""
        raise NotImplementedError

    def __repr__(self) -> str:
        card = self._card()
        return f"{card.title}: {', '.join(card.facts)}"

    def _repr_html_(self) -> str:
        """HTML for a notebook. Names are escaped, nothing is loaded from elsewhere."""
        card = self._card()
        # the first table, an empty one if there is none
        make_table = next(iter(card.tables.values()), dict)
        picture_and_table = _draw(self, card) + _format_table(make_table())
        facts = " · ".join(card.facts)
        return (
            f'<div style="font-family:sans-serif;font-size:.85rem"><p><b>{escape(card.title)}</b> '
            f"{escape(facts)}</p><div "
            f'style="display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start">{picture_and_table}</div></div>'
        )

    def to_frame(self, table: str = "") -> Any:
        """Return a table as a pandas DataFrame.

        table: its name; "" for the one that notebooks show. Raises ValueError for an unknown table,
        ImportError without pandas.
        """
        tables = self._card().tables
        if table and table not in tables:
            raise ValueError(f"table must be one of {', '.join(tables)}, got {table!r}")
        try:
            import pandas
        except ImportError:
            raise ImportError(
                "to_frame needs pandas, which is not installed: pip install pandas"
            ) from None
        make_table = tables[table or next(iter(tables))]
        return pandas.DataFrame(dict(make_table()))


def figure_digits(objects: int, max_digits: int = 3) -> int:
    """Return the number of decimals that a share of this many objects supports.

    One object more or less changes the last decimal. There are at least two.

    >>> [figure_digits(objects) for objects in (6, 60, 600, 6000)]
    [2, 2, 3, 3]
    """
    return min(max_digits, max(2, len(str(objects))))


def format_share(share: float, objects: int, *, signed: bool = False) -> str:
    """Return AP, recall or their change with the decimals that so many objects support.

    >>> format_share(0.91234, 60), format_share(0.91234, 600), format_share(0.02, 60, signed=True)
    ('0.91', '0.912', '+0.02')
    """
    return f"{share:{'+' if signed else ''}.{figure_digits(objects)}f}"


def describe_count(number: int, thing: str, things: str = "") -> str:
    """Return a number with its noun in the singular or plural."""
    return f"{number:,} {thing if number == 1 else things or thing + 's'}"


def _draw(noun: object, card: Card) -> str:
    """Return a picture of an object as an <img>, or a line why there is none; "" without drawing.

    noun: object to draw; card: its card, whose `drawing` names the function that draws it."""
    if not card.drawing:
        return ""
    from PIL import Image

    module_name, _, function_name = card.drawing.partition(":")
    png = BytesIO()
    try:
        draw_to_file = getattr(import_module(module_name), function_name)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "drawn.png"
            draw_to_file(noun, path)
            with Image.open(path) as drawing:
                picture = drawing.convert("RGB")
        picture.thumbnail((PICTURE_PIXELS, PICTURE_PIXELS))
        # a palette makes the file small
        picture.quantize(dither=Image.Dither.NONE).save(png, "PNG", optimize=True)
    except (ImportError, IndexError, OSError, ValueError) as error:
        return f"<p>no picture: {escape(str(error))}</p>"
    source = b64encode(png.getvalue()).decode()
    # shown smaller than drawn, for sharp screens
    size = f"width:{picture.width * 0.8:.0f}px;max-width:100%;height:auto"
    return f'<img style="{size}" alt="{escape(card.title)}" src="data:image/png;base64,{source}">'


def _format_row(row: Iterable[object]) -> str:
    """Return a <tr> of a table's row."""
    cells = (f"<td style={_CELL!r}>{escape(_format_value(value))}</td>" for value in row)
    return f"<tr>{''.join(cells)}</tr>"


def _format_table(table: Table) -> str:
    """Return the first rows as a <table>, with a note if there are more; "" for an empty table."""
    count = max(map(len, table.values()), default=0)
    if not count:
        return ""
    head = "".join(f'<th style="{_CELL}">{escape(str(name))}</th>' for name in table)
    rows = zip(*(column[:MOST_ROWS] for column in table.values()), strict=True)
    body = "".join(map(_format_row, rows))
    hidden_rows = (
        f"<p>{MOST_ROWS} of {count:,} rows; to_frame() has all</p>" if count > MOST_ROWS else ""
    )
    opening = '<div style="overflow-x:auto;max-width:100%"><table style="border-collapse:collapse">'
    return (
        f"{opening}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{hidden_rows}</div>"
    )


def _format_value(value: object) -> str:
    """Return a cell's text: four digits of a real number, "" for None and NaN."""
    if isinstance(value, tuple):
        return ", ".join(map(_format_value, value))
    if isinstance(value, str | int | bool):
        return str(value)
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return "" if value is None else str(value)
    if math.isnan(number):
        return ""
    return f"{number:,.0f}" if abs(number) >= 1000 else f"{number:.4g}"
