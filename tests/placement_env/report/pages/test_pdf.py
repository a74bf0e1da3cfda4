import re

import pytest

from placement_env.report.pages.document import (
    Bullets,
    Cell,
    Column,
    Document,
    Drawing,
    Paragraph,
    SceneView,
    Section,
    TableBlock,
)
from placement_env.report.pages.pdf import pdf_of
from placement_env.report.pages.sections import report_of

HOSTILE = '#panic("x") $x^2$ `raw` \\ @ref <label> *b* _i_ // /* ] [ } { "'
SQUARE = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><rect width="9" height="9"/></svg>'


def pages(pdf):
    return max(int(count) for count in re.findall(rb"/Type\s*/Pages.*?/Count (\d+)", pdf, re.DOTALL))


def document(*blocks, words="Fine."):
    return Document("Plan", "For a test", (Section("one", "One", words, blocks),))


def test_the_same_document_has_the_same_bytes(example):
    report = report_of(example.plan, example.site, example.ground)
    first = pdf_of(report)
    assert first == pdf_of(report)
    assert first.startswith(b"%PDF-")
    assert b"/CreationDate" not in first
    assert 6 <= pages(first) <= 20


def test_texts_are_never_markup():
    rows = ((Cell(HOSTILE), Cell(HOSTILE, 1.0)),)
    columns = (Column(HOSTILE, number=False), Column(HOSTILE, "m"))
    blocks = (
        Paragraph(HOSTILE),
        Bullets((HOSTILE,)),
        Drawing(SQUARE, HOSTILE, HOSTILE),
        TableBlock(HOSTILE, columns, rows),
    )
    hostile = Document(HOSTILE, HOSTILE, (Section("one", HOSTILE, HOSTILE, (*blocks, SceneView(HOSTILE, HOSTILE))),))
    assert pages(pdf_of(hostile)) == 2


def test_a_long_table_goes_over_pages():
    rows = tuple((Cell(f"pole {k}"), Cell(str(k), float(k))) for k in range(150))
    assert pages(pdf_of(document(TableBlock("Poles", (Column("Pole", number=False), Column("k")), rows)))) > 3


def test_a_drawing_that_is_no_svg_is_one_line():
    with pytest.raises(ValueError, match=r"the PDF cannot be set: .*: the drawings must be SVG") as caught:
        pdf_of(document(Drawing("no picture", "A caption.", "alt")))
    assert "\n" not in str(caught.value)


def test_a_plan_without_sensors(nothing_chosen):
    assert pages(pdf_of(report_of(nothing_chosen.plan, nothing_chosen.site, None))) <= 6
