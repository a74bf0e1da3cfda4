"""A report document as HTML and as PDF.

The page works from disk: styles, script, drawings and the 3D scene are all inside, and a policy in
the page forbids every request. The scene is held as data until the reader scrolls near it."""

import json
import re
import tempfile
import unicodedata
from base64 import b64decode, b64encode
from collections.abc import Iterable
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from shutil import copyfile

from placement_env.report.pages.document import Document, PageDrawing, TableBlock
from placement_env.report.pages.printable_names import PAPER_FONT, list_texts
from placement_env.report.pages.scene import PlanScene
from toolkit.plots.fonts import choose_fonts, own_font
from toolkit.viewing.pages import render_page

_FOLDER = Path(__file__).parent
LINE_PT = 487.0  # width of a page's text
LINE_LETTERS = 110  # about as many letters fit into a line
LETTER_WIDTH_SHARE = 0.5  # width of a letter as a share of the font size
CELL_INSET_PT = 6.0  # space next to a cell's text
MIN_FONT_PT = 6.0  # in tables
LIST_FONT_PT = 7.5  # in lists of settings
DEFAULT_FONT_PT = 9.0
MAX_WORD_LETTERS = 24  # longer words are broken up
WORD_PIECE_LETTERS = 12  # letters of a broken word's pieces


def to_html(document: Document, scene: PlanScene | None) -> str:
    """Return the report as one page of HTML, which needs no other file.

    scene: the junction in 3D, None for a page without it."""

    def encode_picture(svg: str) -> str:
        # as a picture, unlike as an element, SVG runs no script
        return "data:image/svg+xml;base64," + b64encode(svg.encode()).decode()

    # values that the page's script reads
    script_values = {"html": scene.html, "frames": scene.frames} if scene else None
    return render_page(
        _FOLDER / "report.html.j2",
        script_values,
        (_FOLDER / "report.js").read_text(encoding="utf-8"),
        document=document,
        style=(_FOLDER / "report.css").read_text(encoding="utf-8"),
        layers=scene.layers if scene else (),
        frames=scene.frames if scene else (),
        picture=encode_picture,
    )


def to_pdf(document: Document) -> bytes:
    """Return the PDF, set by typst.

    The same document gives the same bytes. All texts are passed as data, so that typst reads none
    as markup. Raises ValueError if a drawing is not SVG."""
    import typst

    content = asdict(document)
    with tempfile.TemporaryDirectory(prefix="coview-report-") as folder:
        if document.logo:
            kind, _, logo_base64 = document.logo.removeprefix("data:image/").partition(";base64,")
            content["logo"] = f"logo.{kind}"
            Path(folder, content["logo"]).write_bytes(b64decode(logo_base64))
        drawings = 0
        for section, section_values in zip(document.sections, content["sections"], strict=True):
            for block, values in zip(section.blocks, section_values["blocks"], strict=True):
                values["kind"] = block.kind
                if isinstance(block, TableBlock):
                    values |= _lay_out(block)
                if isinstance(block, PageDrawing):
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


def _lay_out(block: TableBlock) -> dict[str, object]:
    """Return the font size of a table on paper, and its columns and rows for typst, as JSON values.

    Sizes and widths are in points. The widths are such that no word reaches into the next column,
    unless the smallest font is still too wide."""
    headings = _break_words([column.heading for column in block.columns])
    rows = [_break_words(map(attrgetter("text"), row)) for row in block.rows]
    # letters that a column may take for whole texts: its share of a line
    max_text = max(MAX_WORD_LETTERS, LINE_LETTERS // len(block.columns))
    widths = []  # width of each column in letters
    for texts in zip(headings, *rows, strict=True):
        # words end at spaces, and at the zero-width spaces of `_break_words`
        words = [word for text in texts for word in re.split(r"[\s\u200b]", text)]
        longest_word = max(map(_count_letters, words))
        longest_text = max(map(_count_letters, texts))
        widths.append(max(longest_word, min(longest_text, max_text)))
    # font size at which all columns fill the line
    full_size = (LINE_PT - CELL_INSET_PT * len(widths)) / (LETTER_WIDTH_SHARE * sum(widths))
    max_size = DEFAULT_FONT_PT if len(widths) > 2 else LIST_FONT_PT
    size = min(max(full_size, MIN_FONT_PT), max_size)
    columns = [
        {
            "heading": headings[i],
            "number": column.number,
            "width": widths[i] * LETTER_WIDTH_SHARE * size + CELL_INSET_PT,
        }
        for i, column in enumerate(block.columns)
    ]
    return {"size": size, "columns": columns, "rows": rows}


def _count_letters(text: str) -> int:
    """Return the width of a text in Latin letters; East Asian letters are two wide."""
    return sum(2 if unicodedata.east_asian_width(letter) in "WF" else 1 for letter in text)


def _break_words(texts: Iterable[str]) -> list[str]:
    """Return texts whose long words can be broken at the end of a line.

    Words of `MAX_WORD_LETTERS` letters or more get zero-width spaces."""
    return [re.sub(rf"\S{{{MAX_WORD_LETTERS},}}", _break_up, text) for text in texts]


def _break_up(match: re.Match[str]) -> str:
    """Matched word with zero-width spaces between its pieces."""
    word = match.group()
    starts = range(0, len(word), WORD_PIECE_LETTERS)
    return "\u200b".join(word[start : start + WORD_PIECE_LETTERS] for start in starts)
