"""A report as one structure that pages for browsers and PDFs are both made from: sections of paragraphs, lists, tables
and drawings, every section opened by the sentence that says what to conclude from it. All texts are plain text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Cell:
    """What stands in one place of a table, and the number by which the column is sorted (None: by its text)."""

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Column:
    """Heading of a column, unit of its numbers ("" without), and whether it holds numbers, which stand right."""

    title: str
    unit: str = ""
    number: bool = True

    @property
    def heading(self) -> str:
        """Title with unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title


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
class TableBlock:
    """A table with the sentence above it. Raises ValueError where a row does not have a cell for each column."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    kind: ClassVar[str] = "table"

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"{self.caption!r} has {len(self.columns)} columns, got a row of {len(row)} cells")


@dataclass(frozen=True)
class Drawing:
    """A picture as SVG text, the sentence that says what to conclude from it, and what it shows for who cannot see."""

    svg: str
    caption: str
    alt: str
    kind: ClassVar[str] = "drawing"


@dataclass(frozen=True)
class SceneView:
    """Where the page shows the junction in 3D; on paper stands `instead`."""

    caption: str
    instead: str
    kind: ClassVar[str] = "scene"


ReportBlock = Paragraph | Bullets | TableBlock | Drawing | SceneView


@dataclass(frozen=True)
class Section:
    """key: its anchor; conclusion: the sentence that opens it."""

    key: str
    title: str
    conclusion: str
    blocks: tuple[ReportBlock, ...] = ()


@dataclass(frozen=True)
class Document:
    """A report. subtitle: for the title page."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]
    language: str = "en"


def table(caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell]]) -> tuple[TableBlock, ...]:
    """A table, or none where it would have no row.

    >>> table("Links", [Column("Pole")], [])
    ()
    """
    return (TableBlock(caption, tuple(columns), tuple(tuple(row) for row in rows)),) if rows else ()
