"""A report as one structure, written as HTML and PDF, and figures as words.

A document consists of sections of paragraphs, lists, tables and drawings. Every section opens with
its conclusion in one sentence. All texts are plain text. The page works from disk: styles, script,
drawings and the 3D scene are all inside, and a policy in the page forbids every request. The scene
is held as data until the reader scrolls near it.

Figures as words are shares, prices, names, AP with its interval, and sensors named by their
poles."""

import json
import math
import re
import tempfile
import unicodedata
import warnings
from base64 import b64decode, b64encode
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from operator import attrgetter
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
from toolkit.viewing.pages import render_page

_FOLDER = Path(__file__).parent
UNDEFINED_MARK = "–"  # for an undefined figure
PAPER_FONT = "DejaVuSansMono"  # a font of typst for letters that its main font lacks
LINE_PT = 487.0  # width of a page's text
LETTER_WIDTH_SHARE = 0.5  # width of a letter as a share of the font size
CELL_INSET_PT = 6.0  # space next to a cell's text
MIN_FONT_PT = 6.0  # in tables
LIST_FONT_PT = 7.5  # in lists of settings
DEFAULT_FONT_PT = 9.0
MAX_WORD_LETTERS = 24  # longer words are broken up
WORD_PIECE_LETTERS = 12  # letters of a broken word's pieces


@dataclass(frozen=True)
class Cell:
    """Content of one cell of a table. value: number to sort by, None to sort by text."""

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
        """Return whether the column holds numbers, which are aligned right."""
        return self.digits is not None

    def cell(self, value: Cell | str | float | None) -> Cell:
        """Return a cell of this column, with a dash for an undefined number.

        Shares become percent if that is the column's unit."""
        if isinstance(value, Cell):
            return value
        if isinstance(value, str):
            return Cell(value)
        factor = 100.0 if self.unit == "%" else 1.0
        figure = None if value is None or not math.isfinite(value) else value * factor
        return Cell(number(figure, self.digits or 0), figure)


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure with this many decimals."""
    return f"{value:,.{digits}f}" if value is not None and math.isfinite(value) else UNDEFINED_MARK


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
    """One line of a summary. alarm: whether the reader must not overlook it."""

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
    """A picture as SVG text. alt: text for screen readers."""

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


ReportBlock = Paragraph | Bullets | Facts | TableBlock | Drawing | SceneView
Content = tuple[str, tuple[ReportBlock, ...]]  # conclusion and blocks of a section


@dataclass(frozen=True)
class Section:
    """Section of a report. key: its anchor; conclusion: its first sentence."""

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


def say(conclusion: str, *blocks: ReportBlock) -> Content:
    """Return the content of a section."""
    return conclusion, blocks


def table(
    caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell | str | float | None]]
) -> tuple[TableBlock, ...]:
    """Return a table of formatted values, or nothing without rows.

    Raises ValueError for a row of another length."""
    if not rows:
        return ()
    cells = tuple(_format_row(columns, row) for row in rows)
    return (TableBlock(caption, tuple(columns), cells),)


def _format_row(
    columns: Sequence[Column], row: Sequence[Cell | str | float | None]
) -> tuple[Cell, ...]:
    return tuple(column.cell(value) for column, value in zip(columns, row, strict=True))


def to_html(document: Document, scene: Scene | None) -> str:
    """Return the page as HTML."""
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
    """Return the PDF, set by typst.

    The same document gives the same bytes. All texts are passed as data, so that typst reads none
    as markup. Raises ValueError if a drawing is not SVG."""
    import typst

    content = asdict(document)
    with tempfile.TemporaryDirectory(prefix="coview-report-") as folder:
        if document.logo:
            kind, _, coded = document.logo.removeprefix("data:image/").partition(";base64,")
            content["logo"] = f"logo.{kind}"
            Path(folder, content["logo"]).write_bytes(b64decode(coded))
        drawings = 0
        for section, section_values in zip(document.sections, content["sections"], strict=True):
            for block, values in zip(section.blocks, section_values["blocks"], strict=True):
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


def list_texts(value: object) -> list[str]:
    """List all texts of a document, or of a part of it."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, Drawing):
        return [value.caption, value.alt]
    if isinstance(value, tuple):
        return [text for item in value for text in list_texts(item)]
    if is_dataclass(value):
        return [text for field in fields(value) for text in list_texts(getattr(value, field.name))]
    return []


def _lay_out(block: TableBlock) -> dict[str, object]:
    """Return the font size of a table on paper and the width of each column.

    The widths are such that no word reaches into the next column."""
    headings = _break_words([column.heading for column in block.columns])
    rows = [_break_words(map(attrgetter("text"), row)) for row in block.rows]
    max_text = max(MAX_WORD_LETTERS, 110 // len(block.columns))
    letters = []
    for texts in zip(headings, *rows, strict=True):
        words = [word for text in texts for word in re.split(r"[\s\u200b]", text)]
        longest_word = max(map(_count_letters, words))
        longest_text = max(map(_count_letters, texts))
        letters.append(max(longest_word, min(longest_text, max_text)))
    size = (LINE_PT - CELL_INSET_PT * len(letters)) / (LETTER_WIDTH_SHARE * sum(letters))
    max_size = DEFAULT_FONT_PT if len(letters) > 2 else LIST_FONT_PT
    size = min(max(size, MIN_FONT_PT), max_size)
    columns = [
        {
            "heading": headings[i],
            "number": column.number,
            "width": letters[i] * LETTER_WIDTH_SHARE * size + CELL_INSET_PT,
        }
        for i, column in enumerate(block.columns)
    ]
    return {"size": size, "columns": columns, "rows": rows}


def _count_letters(text: str) -> int:
    """Return the width of a text in Latin letters; East Asian letters are two wide."""
    return sum(2 if unicodedata.east_asian_width(letter) in "WF" else 1 for letter in text)


def _break_words(texts: Iterable[str]) -> list[str]:
    """Return texts whose long words can be broken at the end of a line."""
    return [re.sub(rf"\S{{{MAX_WORD_LETTERS},}}", _break_up, text) for text in texts]


def _break_up(word: re.Match[str]) -> str:
    return "\u200b".join(
        word[0][i : i + WORD_PIECE_LETTERS] for i in range(0, len(word[0]), WORD_PIECE_LETTERS)
    )


def percent(share: float | None) -> str:
    """Format a share in percent, never rounded to 0 or 100 %."""
    if share is None or not math.isfinite(share):
        return UNDEFINED_MARK
    if 0 < share < 0.01:
        return "under 1%"
    return "over 99%" if 0.99 < share < 1 else f"{100 * share:.0f}%"


def price_text(price: float, currency: str) -> str:
    """Format a price. Without a currency it is in units of one ordinary pole."""
    text = f"{price:,.{0 if price == round(price) else 2}f}"
    if currency:
        return f"{text} {currency}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return f"{text} unit{'s' * (price != 1)}"


def ap_text(judged: content.Judgement) -> str:
    """Format an AP with its interval and number of vehicles."""
    return f"AP {ap_figure(judged)}"


def ap_figure(judged: content.Judgement) -> str:
    """Format an AP with its interval and number of vehicles, without the word AP."""
    return (
        f"{judged.format_ap()} ({interval_text(judged)}, "
        f"{describe_count(judged.vehicles, judged.kind)})"
    )


def list_aps(judgements: Iterable[tuple[str, content.Judgement]]) -> str:
    """List the AP of each name, for screen readers."""
    return "; ".join(f"{name}: {ap_text(judgement)}" for name, judgement in judgements)


def interval_text(judged: content.Judgement) -> str:
    """Format both ends of the interval, if there is one."""
    if math.isnan(judged.low):
        return "no interval"
    return f"{number(judged.low, judged.digits)}–{number(judged.high, judged.digits)}"


def settle_names(plan: content.Plan, site: Site) -> tuple[content.Plan, Site, str]:
    """Number the poles and sensors whose names hold letters that no font here can set.

    Returns the plan with numbers in all its texts, the site, and a note, empty without numbers."""
    poles = [mount.name for mount in site.mounts]
    poles += [sensor.pole for sensor in plan.sensors]
    poles += plan.poles_unused
    sensors = [sensor.name for sensor in site.sensors]
    sensors += [sensor.name for sensor in plan.sensors]
    unset_letters = choose_fonts([*poles, *sensors], own_font(PAPER_FONT)).unset
    numbers = number_names(tuple(dict.fromkeys(sensors)), unset_letters, "sensor")
    numbers |= number_names(tuple(dict.fromkeys(poles)), unset_letters, "pole")
    if not numbers:
        return plan, site, ""
    longest_first = "|".join(map(re.escape, sorted(numbers, key=len, reverse=True)))

    def number_all(text: str) -> str:
        return re.sub(longest_first, lambda match: numbers[match[0]], text)

    mounts = tuple(replace(mount, name=number_all(mount.name)) for mount in site.mounts)
    renamed_sensors = tuple(
        replace(sensor, name=number_all(sensor.name)) for sensor in site.sensors
    )
    listed_names = "; ".join(
        f"{number} is {spell_name(name, unset_letters)}" for name, number in numbers.items()
    )
    note = f"Names with letters that no font here can set are numbered: {listed_names}."
    letters = "".join(sorted(unset_letters))
    number_texts = ", ".join(f"{name!r} is {number}" for name, number in numbers.items())
    remedy = "install a font that has them, such as Noto Sans"
    warnings.warn(
        f"no font here can set the letters {letters}, so in the report {number_texts}: {remedy}",
        stacklevel=3,
    )
    numbered_plan = content.replace_texts(plan, number_all)
    return numbered_plan, replace(site, mounts=mounts, sensors=renamed_sensors), note


def drop_unset(document: Document) -> Document:
    """Replace letters that no font here can set, with a warning."""
    unset_letters = choose_fonts(list_texts(document), own_font(PAPER_FONT)).unset
    if not unset_letters:
        return document
    letters = "".join(sorted(unset_letters))
    warnings.warn(
        f"no font here can set the letters {letters}, which the report shows as {UNSET}",
        stacklevel=3,
    )
    first_section = document.sections[0]
    codes = name_letters(unset_letters)
    note = Paragraph(
        f"No font here can set {codes}: {UNSET} stands for them. Install one that can, such as "
        "Noto Sans."
    )
    first_section = replace(first_section, blocks=(*first_section.blocks, note))
    sections = (first_section, *document.sections[1:])
    logo = document.logo
    printable = content.replace_texts(
        replace(document, sections=sections, logo=""),
        lambda text: replace_letters(text, unset_letters),
    )
    return replace(printable, logo=logo)


def use_pole_names(plan: content.Plan) -> content.Plan:
    """Name all sensors of a pool by their poles, in all texts of a plan.

    Sensors outside the chosen set that share a pole with it are marked by their other aim."""
    chosen_names = {sensor.name for sensor in plan.sensors}
    used_poles = {sensor.pole for sensor in plan.sensors}
    poles: dict[str, str] = {}
    for option in plan.considered:
        poles |= zip(option.sensors, option.poles, strict=False)
    names = {}
    for name, pole in poles.items():
        (short,) = name_by_poles([name], [pole])
        if name not in chosen_names and short != name:
            names[name] = f"{short} (other aim)" if pole in used_poles else short
    return content.rename(plan, names)
