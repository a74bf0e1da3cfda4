"""A report as one structure: sections of paragraphs, lists, tables and drawings.

Every section opens with its conclusion in one sentence. All texts are plain text."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from placement_env.report.pages.figure_texts import number_text


@dataclass(frozen=True)
class Cell:
    """Content of one cell of a table.

    text: shown text; value: number to sort rows by, None to sort by text."""

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Column:
    """Column of a table.

    unit: unit of its numbers; digits: digits after the point, None for texts, which are aligned
    left."""

    title: str
    unit: str = ""
    digits: int | None = 1

    @property
    def heading(self) -> str:
        """Title with its unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def number(self) -> bool:
        """Return True if the column holds numbers, which are aligned right."""
        return self.digits is not None

    def cell(self, value: Cell | str | float | None) -> Cell:
        """Return a cell of this column, with a dash for an undefined number.

        Shares become percent if that is the column's unit.

        value: finished cell, text, or number; None, NaN and infinity are undefined numbers."""
        if isinstance(value, Cell):
            return value
        if isinstance(value, str):
            return Cell(value)
        factor = 100.0 if self.unit == "%" else 1.0
        figure = None if value is None or not math.isfinite(value) else value * factor
        return Cell(number_text(figure, self.digits or 0), figure)


@dataclass(frozen=True)
class Paragraph:
    """A paragraph of text."""

    text: str
    kind: ClassVar[str] = "paragraph"


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: tuple[str, ...]
    kind: ClassVar[str] = "bullets"


@dataclass(frozen=True)
class Fact:
    """One line of a summary.

    label: short heading of the line; alarm: True if the reader must not overlook it."""

    label: str
    text: str
    alarm: bool = False


@dataclass(frozen=True)
class Facts:
    """A summary, line by line."""

    items: tuple[Fact, ...]
    kind: ClassVar[str] = "facts"


@dataclass(frozen=True)
class TableBlock:
    """A table with the sentence above it. rows: a cell for each column."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class PageDrawing:
    """A picture as SVG text. caption: sentence below it; alt: text for screen readers."""

    svg: str
    caption: str
    alt: str
    kind: ClassVar[str] = "drawing"


@dataclass(frozen=True)
class SceneView:
    """Place of the 3D scene on the page. instead: sentence in the PDF, which has no scene."""

    caption: str
    instead: str
    kind: ClassVar[str] = "scene"


ReportBlock = Paragraph | Bullets | Facts | TableBlock | PageDrawing | SceneView
Content = tuple[str, tuple[ReportBlock, ...]]  # conclusion and blocks of a section


@dataclass(frozen=True)
class Section:
    """Section of a report. key: its anchor in the page; conclusion: its first sentence."""

    key: str
    title: str
    conclusion: str
    blocks: tuple[ReportBlock, ...] = ()


@dataclass(frozen=True)
class Document:
    """A report.

    Attributes:
        title: Title of the report.
        subtitle: Second line of the title page.
        sections: Sections in their order.
        language: Code of the language.
        logo: Data URI of a PNG or JPEG picture, "" for none."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]
    language: str = "en"
    logo: str = ""


def build_content(conclusion: str, *blocks: ReportBlock) -> Content:
    """Return the content of a section: its conclusion, one sentence or more, and its blocks."""
    return conclusion, blocks


def build_table(
    caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell | str | float | None]]
) -> tuple[TableBlock, ...]:
    """Return a tuple of one table with formatted values, or an empty tuple without rows.

    The tuple can be unpacked into the blocks of a section. caption: sentence above the table.

    Raises ValueError for a row of another length."""
    if not rows:
        return ()
    cells = tuple(_format_row(columns, row) for row in rows)
    return (TableBlock(caption, tuple(columns), cells),)


def _format_row(
    columns: Sequence[Column], row: Sequence[Cell | str | float | None]
) -> tuple[Cell, ...]:
    """Cells of a row, which has one value for each column."""
    return tuple(column.cell(value) for column, value in zip(columns, row, strict=True))
