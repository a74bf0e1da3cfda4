"""Names beyond Latin in pictures and on paper: set whole, or numbered and named by their code
points.

A font that lacks a letter draws .notdef, an empty box (OpenType 1.9, "glyf"). The fonts that a test
needs are drawn by fontTools, so that it does not hang on those of the computer."""

import re
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen

from placement_env.report.pages.document import Document, PageDrawing, Paragraph, Section
from placement_env.report.pages.printable_names import drop_unset
from placement_env.report.pages.typesetting import to_html, to_pdf
from toolkit.plots import canvas, fonts

CHINESE = "信号灯杆一"
WORDS = {
    "Greek": "Ώμος",
    "Arabic": "عمود",
    "Hebrew": "עמוד",
    "Georgian": "ბოძი",
    "Latin": "Straße;5",
}
FOREIGN = {"Chinese": CHINESE, "Devanagari": "खम्भा", "Hangul": "전봇대", "Thai": "เสาไฟ"}


def build_font(path: Path, letters: str, family: str) -> Path:
    """A font with a square for each letter."""
    pen = TTGlyphPen(None)
    for k, corner in enumerate(((100, 0), (100, 700), (800, 700), (800, 0))):
        (pen.lineTo if k else pen.moveTo)(corner)
    pen.closePath()
    square = pen.glyph()
    names = [".notdef", *(f"u{ord(letter):04X}" for letter in letters)]
    builder = FontBuilder(1000, isTTF=True)
    builder.setupGlyphOrder(names)
    builder.setupCharacterMap(
        {ord(letter): name for letter, name in zip(letters, names[1:], strict=True)}
    )
    builder.setupGlyf(dict.fromkeys(names, square))
    builder.setupHorizontalMetrics(dict.fromkeys(names, (1000, 100)))
    builder.setupHorizontalHeader(ascent=800, descent=-200)
    builder.setupNameTable(
        {"familyName": family, "styleName": "Regular", "psName": family.replace(" ", "")}
    )
    builder.setupOS2(sTypoAscender=800, sTypoDescender=-200, usWinAscent=800, usWinDescent=200)
    builder.setupPost()
    builder.save(path)
    return path


def draw(name: str):
    figure = canvas.blank_figure(3, 1)
    figure.text(0.1, 0.5, name)
    return figure


@pytest.mark.filterwarnings("error")  # also matplotlib's "Glyph ... missing from font"
@pytest.mark.parametrize("name", WORDS.values(), ids=WORDS)
def test_letters_that_come_with_matplotlib(system_fonts, name):
    system_fonts()
    figure = draw(name)
    canvas.svg_text(figure)
    assert figure.texts[0].get_text() == name


def test_letters_that_no_bold_font_has_are_set_in_the_usual_one(system_fonts):
    """DejaVu Sans Bold 2.37 lacks 74 Arabic letters of DejaVu Sans."""
    system_fonts()
    bold = fonts.list_letters(fonts.own_font("DejaVuSans-Bold"))
    (letter, *_) = sorted(fonts.list_letters(fonts.own_font("DejaVuSans")) - bold)
    figure = canvas.blank_figure(3, 1)
    heading = figure.text(0.1, 0.5, f"é{chr(letter)}", fontweight="bold")
    latin = figure.text(0.1, 0.2, "é", fontweight="bold")
    canvas.set_letters(figure)
    assert (heading.get_fontweight(), latin.get_fontweight()) == ("normal", "bold")


@pytest.mark.parametrize("name", FOREIGN.values(), ids=FOREIGN)
def test_letters_without_a_font_are_numbered_and_named(system_fonts, name):
    system_fonts()
    figure = draw(name)
    with pytest.warns(
        UserWarning, match=f"no font here can set the letters .*U\\+{ord(max(name)):04X}.*Noto Sans"
    ):
        canvas.render_pixels(figure)
    assert figure.texts[0].get_text() == "(1)"


@pytest.mark.filterwarnings("error")
def test_letters_are_set_in_a_font_of_the_computer(system_fonts, tmp_path: Path):
    latin = build_font(tmp_path / "latin.ttf", "abc", "Tiny Latin")
    system_fonts(latin, build_font(tmp_path / "hanzi.ttf", CHINESE, "Tiny Hanzi"))
    figure = draw(f"a {CHINESE}")
    canvas.svg_text(figure)
    assert figure.texts[0].get_text() == f"a {CHINESE}"
    assert figure.texts[0].get_fontfamily()[-1] == "Tiny Hanzi"
    pictures = [
        canvas.render_pixels(draw(text)).astype(int) for text in ("", CHINESE[0], CHINESE[:2])
    ]
    ink = [int(np.abs(picture - 255).sum()) for picture in pictures]
    assert ink[2] == pytest.approx(2 * ink[1], rel=0.1)  # two squares of the font
    assert ink[0] == 0


def test_fonts_of_boxes_and_damaged_ones_are_no_fonts(system_fonts, tmp_path: Path):
    (tmp_path / "broken.ttf").write_bytes(b"\x00\x01\x00\x00" + bytes(40))
    boxes = build_font(tmp_path / "LastResort.ttf", CHINESE, "Last Resort")
    system_fonts(tmp_path / "broken.ttf", boxes, tmp_path / "gone.ttf")
    assert fonts.choose_fonts([CHINESE], fonts.own_font("DejaVuSans")).unset == frozenset(CHINESE)


def test_without_shaping_joined_scripts_count_as_unset(system_fonts):
    system_fonts()
    chosen = fonts.choose_fonts(WORDS.values(), fonts.own_font("DejaVuSans"), shaping=False)
    assert chosen.unset == frozenset("عمودעמוד")


def streams(pdf: bytes) -> bytes:
    """All of a PDF's streams, unpacked."""
    whole = [pdf]
    for packed in re.findall(rb"stream\r?\n(.*?)endstream", pdf, re.DOTALL):
        try:
            whole.append(zlib.decompress(packed))
        except zlib.error:
            continue
    return b"\n".join(whole)


def document(*texts: str) -> Document:
    return Document(
        "Plan", "For a test", (Section("one", "One", "Fine.", tuple(map(Paragraph, texts))),)
    )


def test_paper_is_set_in_a_font_of_the_computer(system_fonts, tmp_path: Path):
    system_fonts(build_font(tmp_path / "hanzi.ttf", CHINESE, "Tiny Hanzi"))
    pdf = streams(to_pdf(document(CHINESE, *WORDS.values())))
    assert b"TinyHanzi" in pdf
    for letter in (*CHINESE, "Ώ"):
        assert f"{ord(letter):04X}".encode() in pdf.upper()  # of the map from glyphs to letters


def test_a_document_names_the_letters_that_it_cannot_set(system_fonts):
    system_fonts()
    whole = document(f"Client: {CHINESE} AG", *WORDS.values())
    with pytest.warns(
        UserWarning, match=f"no font here can set the letters .*{CHINESE[1]}.*shows as \\?"
    ):
        shown = drop_unset(whole)
    texts = [block.text for block in shown.sections[0].blocks]  # type: ignore[union-attr]
    assert texts[:-1] == ["Client: ? AG", *WORDS.values()]
    assert "U+4FE1" in texts[-1]
    assert CHINESE[0] not in to_html(shown, None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert drop_unset(document(*WORDS.values())) == document(*WORDS.values())


def test_drawings_keep_their_pictures(system_fonts):
    system_fonts()
    picture = PageDrawing("<svg/>", f"Of {CHINESE}", "A picture")
    whole = Document(
        "Plan", "", (Section("one", "One", "Fine.", (picture,)),), logo="data:image/png;base64,AA=="
    )
    with pytest.warns(UserWarning, match="no font here"):
        shown = drop_unset(whole)
    assert shown.sections[0].blocks[0] == PageDrawing("<svg/>", "Of ?", "A picture")
    assert shown.logo == whole.logo
