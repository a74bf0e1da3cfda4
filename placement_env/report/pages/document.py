"""A report as one structure, written as HTML and PDF.

A document is sections of paragraphs, lists, tables and drawings; every section opens with its conclusion in one
sentence. All texts are plain text. The page works from disk: styles, script, drawings and the 3D scene are all inside,
and a policy in the page forbids every request. The scene is held as data until the reader scrolls near it.
"""

from __future__ import annotations

import json
import tempfile
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from toolkit.viewing.scene import POLICY, scene_script, script_data

if TYPE_CHECKING:
    from placement_env.report.pages.scene import Scene

_FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Cell:
    """Content of one place in a table. value: the number to sort the column by (None: sort by text)."""

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Column:
    """Column of a table. unit: of its numbers, "" without; number: whether it holds numbers, aligned right."""

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
    """A table with the sentence above it. Raises ValueError for a row without a cell for each column."""

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
    """A picture as SVG text. It has the sentence that states its conclusion, and a description for screen readers."""

    svg: str
    caption: str
    alt: str
    kind: ClassVar[str] = "drawing"


@dataclass(frozen=True)
class SceneView:
    """Place of the junction in 3D on the page. On paper `instead` stands there."""

    caption: str
    instead: str
    kind: ClassVar[str] = "scene"


ReportBlock = Paragraph | Bullets | TableBlock | Drawing | SceneView


@dataclass(frozen=True)
class Section:
    """Section of a report. key: its anchor; conclusion: the sentence that opens it."""

    key: str
    title: str
    conclusion: str
    blocks: tuple[ReportBlock, ...] = ()


@dataclass(frozen=True)
class Document:
    """A report; subtitle: for the title page."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]
    language: str = "en"


def table(caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell]]) -> tuple[TableBlock, ...]:
    """Return a table, or nothing without rows.

    >>> table("Links", [Column("Pole")], [])
    ()
    """
    return (TableBlock(caption, tuple(columns), tuple(tuple(row) for row in rows)),) if rows else ()


def to_html(document: Document, scene: Scene | None) -> str:
    """Return the page. A missing scene is replaced by a note."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page: str = environment.get_template("report.html.j2").render(
        document=document,
        policy=POLICY,
        style=Markup((_FOLDER / "report.css").read_text(encoding="utf-8")),
        script=Markup((_FOLDER / "report.js").read_text(encoding="utf-8") + scene_script()),
        layers=scene.layers if scene else (),
        frames=scene.frames if scene else (),
        scene_data=Markup(script_data({"html": scene.html, "frames": scene.frames})) if scene else None,
        picture=_data_address,
    )
    return page


def _data_address(svg: str) -> str:
    """Address of a drawing as an image. No script runs in it, and its ids cannot clash with another drawing's."""
    return "data:image/svg+xml;base64," + b64encode(svg.encode("utf-8")).decode("ascii")


def to_pdf(document: Document) -> bytes:
    """Return the PDF, set by typst.

    The same document gives the same bytes.

    All texts are passed as data, so none of them is read as markup. Raises ValueError if a drawing is not SVG.
    """
    import typst

    with tempfile.TemporaryDirectory(prefix="coview-report-") as folder:
        _write_project(document, Path(folder))
        try:
            pages = typst.compile(str(Path(folder, "report.typ")), root=folder, ignore_system_fonts=True, timestamp=0)
        except typst.TypstError as error:
            raise ValueError(f"the PDF cannot be set: {error.message}: the drawings must be SVG") from error
    assert isinstance(pages, bytes)
    return pages


def _write_project(document: Document, folder: Path) -> None:
    """Write template, data and drawings into a folder for typst."""
    sections, drawings = [], 0
    for section in document.sections:
        blocks = []
        for block in section.blocks:
            values = _block_values(block)
            svg = values.pop("svg", None)
            if svg is not None:
                values["file"] = f"drawing{drawings}.svg"
                Path(folder, values["file"]).write_text(svg, encoding="utf-8")
                drawings += 1
            blocks.append(values)
        sections.append({"title": section.title, "conclusion": section.conclusion, "blocks": blocks})
    content = {"title": document.title, "subtitle": document.subtitle, "language": document.language}
    Path(folder, "content.json").write_text(json.dumps(content | {"sections": sections}), encoding="utf-8")
    Path(folder, "report.typ").write_bytes((_FOLDER / "report.typ").read_bytes())


def _block_values(block: ReportBlock) -> dict[str, Any]:
    values = {"kind": block.kind, **asdict(block)}
    for of_column, column in zip(values.get("columns", ()), getattr(block, "columns", ()), strict=True):
        of_column["heading"] = column.heading
    return values
