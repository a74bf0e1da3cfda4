"""A report as one structure, written as HTML and PDF, and figures as words.

A document is sections of paragraphs, lists, tables and drawings; every section opens with its
conclusion in one sentence. All texts are plain text. The page works from disk: styles, script,
drawings and the 3D scene are all inside, and a policy in the page forbids every request. The scene
is held as data until the reader scrolls near it.

Figures of a plan as words: shares, prices, names, AP with its interval, and sensors by the names of
their poles."""

import json
import math
import re
import tempfile
import unicodedata
import warnings
from base64 import b64decode, b64encode
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from shutil import copyfile
from typing import ClassVar

from placement_env.handover.mounted import name_by_poles
from placement_env.report import content
from placement_env.report.pages.scene import Scene
from toolkit.display import describe_count
from toolkit.plots.fonts import (
    UNSET,
    choose_fonts,
    name_letters,
    number_names,
    own_font,
    replace_letters,
    spell_name,
)
from toolkit.sites.site import Site
from toolkit.viewing.scene import render_page

_FOLDER = Path(__file__).parent
NONE = "–"  # for an undefined figure


@dataclass(frozen=True)
class Cell:
    """Content of one place in a table. value: the number to sort the column by (None: sort by
    text)."""

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Column:
    """Column of a table. unit: of its numbers; digits: after the point, None for texts, which are
    aligned left."""

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
        """Cell of this column; a dash for undefined numbers. Shares are shown in percent where that
        is the unit."""
        if isinstance(value, Cell | str):
            return value if isinstance(value, Cell) else Cell(value)
        factor = 100.0 if self.unit == "%" else 1.0
        figure = None if value is None or not math.isfinite(value) else value * factor
        return Cell(number(figure, self.digits or 0), figure)


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure with this many decimals."""
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
class Fact:
    """One line of a summary. alarm: True for what the reader must not overlook."""

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


ReportBlock = Paragraph | Bullets | Facts | TableBlock | Drawing | SceneView
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
    """A report; subtitle: for the title page; logo: data URI of a PNG or JPEG picture, "" for
    none."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]
    language: str = "en"
    logo: str = ""


def say(conclusion: str, *blocks: ReportBlock) -> Content:
    """Content of a section."""
    return conclusion, blocks


def table(
    caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell | str | float | None]]
) -> tuple[TableBlock, ...]:
    """Return a table of formatted values, or nothing without rows. Raises ValueError for a row of
    another length."""
    cells = tuple(
        tuple(c.cell(value) for c, value in zip(columns, row, strict=True)) for row in rows
    )
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
        picture=lambda svg: (
            "data:image/svg+xml;base64," + b64encode(svg.encode()).decode()
        ),  # runs no script
    )


def to_pdf(document: Document) -> bytes:
    """Return the PDF, set by typst. The same document gives the same bytes. All texts are passed as
    data, so none of them is read as markup. Raises ValueError if a drawing is not SVG."""
    import typst

    content = asdict(document)
    with tempfile.TemporaryDirectory(prefix="coview-report-") as folder:
        if document.logo:
            kind, _, coded = document.logo.removeprefix("data:image/").partition(";base64,")
            content["logo"] = f"logo.{kind}"
            Path(folder, content["logo"]).write_bytes(b64decode(coded))
        drawings = 0
        for section, of_section in zip(document.sections, content["sections"], strict=True):
            for block, values in zip(section.blocks, of_section["blocks"], strict=True):
                values["kind"] = block.kind
                if isinstance(block, TableBlock):
                    values |= _lay_out(block)
                if isinstance(block, Drawing):
                    values["file"] = f"drawing{drawings}.svg"
                    Path(folder, values["file"]).write_text(values.pop("svg"), encoding="utf-8")
                    drawings += 1
        fonts = choose_fonts(list_texts(document), own_font(PAPER_FONT))
        content["fonts"] = list(fonts.families)
        Path(folder, "content.json").write_text(json.dumps(content), encoding="utf-8")
        Path(folder, "report.typ").write_bytes((_FOLDER / "report.typ").read_bytes())
        Path(folder, "fonts").mkdir()
        for k, file in enumerate(fonts.files):
            copyfile(file, Path(folder, "fonts", f"{k}{file.suffix}"))
        source = str(Path(folder, "report.typ"))
        font_folder = str(Path(folder, "fonts"))
        try:
            pages = typst.compile(
                source, root=folder, font_paths=[font_folder], ignore_system_fonts=True, timestamp=0
            )
        except typst.TypstError as error:
            raise ValueError(
                f"the PDF cannot be set: {error.message}: the drawings must be SVG"
            ) from error
    assert isinstance(pages, bytes)
    return pages


PAPER_FONT = "DejaVuSansMono"  # one of typst's own, for letters that its main font lacks


def list_texts(value: object) -> list[str]:
    """All texts of a document, or of a part of it."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, Drawing):
        return [value.caption, value.alt]
    if isinstance(value, tuple):
        return [text for part in value for text in list_texts(part)]
    if is_dataclass(value):
        return [text for each in fields(value) for text in list_texts(getattr(value, each.name))]
    return []


# points: width of a page's text, of a letter at 1 pt, beside a cell's text
LINE = 487.0
LETTER = 0.5
INSET = 6.0
# points, of a table's text; of lists of settings
LEAST_SIZE = 6.0
LIST_SIZE = 7.5
USUAL_SIZE = 9.0
# letters of words that stay whole; of the pieces of longer ones
LONGEST_WORD = 24
PIECE = 12


def _lay_out(block: TableBlock) -> dict[str, object]:
    """Size of a table's text on paper and the width of each column, so that no word reaches into
    the next one."""
    lines = [
        [column.heading for column in block.columns],
        *([cell.text for cell in row] for row in block.rows),
    ]
    texts = [
        [re.sub(rf"\S{{{LONGEST_WORD},}}", _break_up, text) for text in line] for line in lines
    ]
    needs = []
    for column in zip(*texts, strict=True):
        word = max(
            _count_letters(word) for text in column for word in re.split(r"[\s\u200b]", text)
        )
        needs.append(
            max(
                word,
                min(max(map(_count_letters, column)), max(LONGEST_WORD, 110 // len(block.columns))),
            )
        )
    size = (LINE - INSET * len(needs)) / (LETTER * sum(needs))
    size = min(max(size, LEAST_SIZE), USUAL_SIZE if len(needs) > 2 else LIST_SIZE)
    columns = [
        {"heading": heading, "number": column.number, "width": need * LETTER * size + INSET}
        for heading, column, need in zip(texts[0], block.columns, needs, strict=True)
    ]
    return {"size": size, "columns": columns, "rows": texts[1:]}


def _count_letters(text: str) -> int:
    """Width of a text in Latin letters; those of East Asia are two wide."""
    return sum(2 if unicodedata.east_asian_width(letter) in "WF" else 1 for letter in text)


def _break_up(word: re.Match[str]) -> str:
    return "\u200b".join(word[0][i : i + PIECE] for i in range(0, len(word[0]), PIECE))


def percent(share: float | None) -> str:
    """Format a share in percent, never rounded to 0 or 100 %."""
    if share is None or not math.isfinite(share):
        return NONE
    if 0 < share < 0.01:
        return "under 1%"
    return "over 99%" if 0.99 < share < 1 else f"{100 * share:.0f}%"


def price_text(price: float, currency: str) -> str:
    """Format a price. Without a currency it is in units of one ordinary pole."""
    text = f"{price:,.{0 if price == round(price) else 2}f}"
    if currency:
        return f"{text} {currency}"
    return f"{text.rstrip('0').rstrip('.') if '.' in text else text} unit{'s' * (price != 1)}"


def ap_text(judged: content.Judgement) -> str:
    """AP with interval and number of vehicles."""
    return f"AP {ap_figure(judged)}"


def ap_figure(judged: content.Judgement) -> str:
    """AP with interval and number of vehicles, without the word AP."""
    return (
        f"{judged.format_ap()} ({interval_text(judged)}, "
        f"{describe_count(judged.vehicles, judged.kind)})"
    )


def list_aps(judged: Iterable[tuple[str, content.Judgement]]) -> str:
    """AP of each name, for screen readers."""
    return "; ".join(f"{name}: {ap_text(each)}" for name, each in judged)


def interval_text(judged: content.Judgement) -> str:
    """Both ends of the interval, if it has one."""
    return (
        "no interval"
        if math.isnan(judged.low)
        else "–".join(number(end, judged.digits) for end in (judged.low, judged.high))
    )


def settle_names(plan: content.Plan, site: Site) -> tuple[content.Plan, Site, str]:
    """Number the poles and sensors whose names hold letters that no font here can set, in all texts
    of a plan and on its site; return a note of them, empty for none."""
    poles = (
        [mount.name for mount in site.mounts]
        + [sensor.pole for sensor in plan.sensors]
        + [*plan.poles_unused]
    )
    sensors = [sensor.name for sensor in site.sensors] + [sensor.name for sensor in plan.sensors]
    unset = choose_fonts([*poles, *sensors], own_font(PAPER_FONT)).unset
    numbers = number_names(tuple(dict.fromkeys(sensors)), unset, "sensor")
    numbers |= number_names(tuple(dict.fromkeys(poles)), unset, "pole")
    if not numbers:
        return plan, site, ""
    longest_first = "|".join(map(re.escape, sorted(numbers, key=len, reverse=True)))

    def number_all(text: str) -> str:
        return re.sub(longest_first, lambda found: numbers[found[0]], text)

    mounts = tuple(replace(mount, name=number_all(mount.name)) for mount in site.mounts)
    mounted = tuple(replace(sensor, name=number_all(sensor.name)) for sensor in site.sensors)
    listed = "; ".join(f"{number} is {spell_name(name, unset)}" for name, number in numbers.items())
    note = f"Names with letters that no font here can set are numbered: {listed}."
    letters = "".join(sorted(unset))
    said = ", ".join(f"{name!r} is {number}" for name, number in numbers.items())
    remedy = "install a font that has them, such as Noto Sans"
    warnings.warn(
        f"no font here can set the letters {letters}, so in the report {said}: {remedy}",
        stacklevel=3,
    )
    return (
        content.replace_texts(plan, number_all),
        replace(site, mounts=mounts, sensors=mounted),
        note,
    )


def drop_unset(document: Document) -> Document:
    """Replace letters that no font here can set by question marks, with a warning."""
    unset = choose_fonts(list_texts(document), own_font(PAPER_FONT)).unset
    if not unset:
        return document
    letters = "".join(sorted(unset))
    warnings.warn(
        f"no font here can set the letters {letters}, which the report shows as {UNSET}",
        stacklevel=3,
    )
    head, *rest = document.sections
    codes = name_letters(unset)
    note = Paragraph(
        f"No font here can set {codes}: {UNSET} stands for them. Install one that can, such as "
        "Noto Sans."
    )
    sections = (replace(head, blocks=(*head.blocks, note)), *rest)
    logo = document.logo
    shown = content.replace_texts(
        replace(document, sections=sections, logo=""), lambda text: replace_letters(text, unset)
    )
    return replace(shown, logo=logo)


def use_pole_names(plan: content.Plan) -> content.Plan:
    """Call the sensors of a pool that are not in the chosen set by their poles too, in all texts of
    a plan. Those on a pole of the chosen set have another aim, which is marked."""
    chosen = {sensor.name for sensor in plan.sensors}
    used = {sensor.pole for sensor in plan.sensors}
    poles = {
        name: pole
        for each in plan.considered
        for name, pole in zip(each.sensors, each.poles, strict=False)
    }
    names = {}
    for name, pole in poles.items():
        (short,) = name_by_poles([name], [pole])
        if name not in chosen and short != name:
            names[name] = f"{short} (other aim)" if pole in used else short
    return content.rename(plan, names)
