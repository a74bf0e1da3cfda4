"""A report as one structure, written as HTML and PDF, and figures as words.

A document is sections of paragraphs, lists, tables and drawings; every section opens with its conclusion in one
sentence. All texts are plain text. The page works from disk: styles, script, drawings and the 3D scene are all inside,
and a policy in the page forbids every request. The scene is held as data until the reader scrolls near it.
"""

from __future__ import annotations

import json
import math
import tempfile
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from placement_env.cases import IoUs, iou_text
from placement_env.report.content import CONFIDENCE, Judgement
from toolkit.viewing.scene import render_page

if TYPE_CHECKING:
    from placement_env.report.pages.scene import Scene


_FOLDER = Path(__file__).parent
NONE = "–"  # for an undefined figure


@dataclass(frozen=True)
class Cell:
    """Content of one place in a table. value: the number to sort the column by (None: sort by text)."""

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Column:
    """Column of a table. unit: of its numbers; digits: after the point, None for texts, which are aligned left."""

    title: str
    unit: str = ""
    digits: int | None = 1

    @property
    def heading(self) -> str:
        """Title with unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def number(self) -> bool:
        """True for a column of numbers, which are aligned right."""
        return self.digits is not None

    def cell(self, value: Cell | str | float | None) -> Cell:
        """Cell of this column; a dash for undefined numbers."""
        if isinstance(value, Cell | str):
            return value if isinstance(value, Cell) else Cell(value)
        return Cell(
            number(value, self.digits or 0), None if value is None or not math.isfinite(value) else float(value)
        )


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure with this many decimals.

    >>> number(0.9), number(None), number(float("nan"))
    ('0.900', '–', '–')
    """
    return f"{value:,.{digits}f}" if value is not None and math.isfinite(value) else NONE


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
    """A table with the sentence above it."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Drawing:
    """A picture as SVG text. alt: for screen readers."""

    svg: str
    caption: str
    alt: str
    kind: ClassVar[str] = "drawing"


@dataclass(frozen=True)
class SceneView:
    """Place of the 3D scene on the page."""

    caption: str
    instead: str
    kind: ClassVar[str] = "scene"


ReportBlock = Paragraph | Bullets | TableBlock | Drawing | SceneView
Content = tuple[str, tuple[ReportBlock, ...]]  # of a section: its conclusion and blocks


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


def say(conclusion: str, *blocks: ReportBlock) -> Content:
    """Content of a section."""
    return conclusion, blocks


def table(
    caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell | str | float | None]]
) -> tuple[TableBlock, ...]:
    """Return a table of formatted values, or nothing without rows. Raises ValueError for a row of another length.

    >>> table("Links", [Column("Pole")], [])
    ()
    """
    cells = tuple(tuple(c.cell(value) for c, value in zip(columns, row, strict=True)) for row in rows)
    return (TableBlock(caption, tuple(columns), cells),) if rows else ()


def to_html(document: Document, scene: Scene | None) -> str:
    """Return the page."""
    return render_page(
        _FOLDER / "report.html.j2",
        {"html": scene.html, "frames": scene.frames} if scene else None,
        (_FOLDER / "report.js").read_text(encoding="utf-8"),
        document=document,
        style=(_FOLDER / "report.css").read_text(encoding="utf-8"),
        layers=scene.layers if scene else (),
        frames=scene.frames if scene else (),
        picture=_data_address,
    )


def _data_address(svg: str) -> str:
    """Address of a drawing as an image, in which no script runs."""
    return "data:image/svg+xml;base64," + b64encode(svg.encode("utf-8")).decode("ascii")


def to_pdf(document: Document) -> bytes:
    """Return the PDF, set by typst. The same document gives the same bytes.

    All texts are passed as data, so none of them is read as markup. Raises ValueError if a drawing is not SVG.
    """
    import typst

    content = asdict(document)
    with tempfile.TemporaryDirectory(prefix="coview-report-") as folder:
        drawings = 0
        for section, of_section in zip(document.sections, content["sections"], strict=True):
            for block, values in zip(section.blocks, of_section["blocks"], strict=True):
                values["kind"] = block.kind
                if isinstance(block, TableBlock):
                    values["columns"] = [{"heading": c.heading, "number": c.number} for c in block.columns]
                if isinstance(block, Drawing):
                    values["file"] = f"drawing{drawings}.svg"
                    Path(folder, values["file"]).write_text(values.pop("svg"), encoding="utf-8")
                    drawings += 1
        Path(folder, "content.json").write_text(json.dumps(content), encoding="utf-8")
        Path(folder, "report.typ").write_bytes((_FOLDER / "report.typ").read_bytes())
        try:
            pages = typst.compile(str(Path(folder, "report.typ")), root=folder, ignore_system_fonts=True, timestamp=0)
        except typst.TypstError as error:
            raise ValueError(f"the PDF cannot be set: {error.message}: the drawings must be SVG") from error
    assert isinstance(pages, bytes)
    return pages


JUDGED_COLUMNS = (
    Column("AP", digits=3),
    Column(f"{CONFIDENCE:.0%} interval"),
    Column("found", "%"),
    Column("vehicles", digits=0),
    Column("frames", digits=0),
)


def judged_cells(judged: Judgement | None) -> tuple[Cell | str | float | None, ...]:
    """Values of `JUDGED_COLUMNS`; dashes without anything to detect."""
    if judged is None:
        return None, "no vehicle", None, 0, None
    interval = Cell(interval_text(judged), judged.low)
    return judged.ap, interval, 100 * judged.recall, judged.vehicles, judged.frames


def text_columns(*titles: str) -> tuple[Column, ...]:
    """Columns of texts."""
    return tuple(Column(title, digits=None) for title in titles)


def price_column(title: str, currency: str) -> Column:
    """Column of prices."""
    return Column(title, currency or "units", 2)


def in_percent(share: float | None) -> float | None:
    """Share in percent, for a cell."""
    return None if share is None else 100 * share


def iou_value(iou: IoUs) -> float | str:
    """IoU threshold for a cell; words for several, whose mean counts."""
    return iou if isinstance(iou, float) else iou_text(iou)


def percent(share: float | None) -> str:
    """Format a share in percent, never rounded to 0 or 100 %.

    >>> percent(0.934), percent(0.0004), percent(1.0)
    ('93%', 'under 1%', '100%')
    """
    if share is None or not math.isfinite(share):
        return NONE
    if 0 < share < 0.01:
        return "under 1%"
    return "over 99%" if 0.99 < share < 1 else f"{100 * share:.0f}%"


def price_text(price: float, currency: str) -> str:
    """Format a price. Without a currency it is in units of one ordinary pole.

    >>> price_text(1250.0, "EUR"), price_text(1.0, ""), price_text(2.5, "")
    ('1,250 EUR', '1 unit', '2.5 units')
    """
    text = f"{price:,.{0 if price == round(price) else 2}f}"
    if currency:
        return f"{text} {currency}"
    return f"{text.rstrip('0').rstrip('.') if '.' in text else text} unit{'s' * (price != 1)}"


def count_text(count: int, noun: str) -> str:
    """Number of things, in words.

    >>> count_text(1, "sensor"), count_text(1200, "vehicle")
    ('1 sensor', '1,200 vehicles')
    """
    return f"{count:,} {noun}{'s' * (count != 1)}"


def join_names(names: Sequence[str]) -> str:
    """Names in a row.

    >>> join_names(["a", "b", "c"]), join_names(["a"]), join_names([])
    ('a, b and c', 'a', 'none')
    """
    if len(names) < 2:
        return names[0] if names else "none"
    return f"{', '.join(names[:-1])} and {names[-1]}"


def ap_text(judged: Judgement) -> str:
    """AP with interval and number of vehicles.

    >>> ap_text(Judgement(0.95, 0.91, 0.98, 0.96, 0.97, 40, 20))
    'AP 0.950 (0.910–0.980, 40 vehicles)'
    """
    return f"AP {ap_figure(judged)}"


def ap_figure(judged: Judgement) -> str:
    """AP with interval and number of vehicles, without the word AP."""
    return f"{number(judged.ap)} ({interval_text(judged)}, {count_text(judged.vehicles, judged.kind)})"


def list_aps(judged: Iterable[tuple[str, Judgement]]) -> str:
    """AP of each name, for screen readers."""
    return "; ".join(f"{name}: {ap_text(each)}" for name, each in judged)


def interval_text(judged: Judgement) -> str:
    """Both ends of the interval."""
    return f"{number(judged.low)}–{number(judged.high)}"
