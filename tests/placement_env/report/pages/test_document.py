"""A report as a structure, as a page and as a PDF."""

import re
from base64 import b64encode
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO

import pytest
from PIL import Image

from placement_env.report.pages.document import (
    Bullets,
    Cell,
    Column,
    Document,
    Fact,
    Facts,
    PageDrawing,
    Paragraph,
    SceneView,
    Section,
    TableBlock,
    build_table,
)
from placement_env.report.pages.report import build_document
from placement_env.report.pages.scene import PlanScene
from placement_env.report.pages.scene_layer import Layer
from placement_env.report.pages.typesetting import to_html, to_pdf
from toolkit.viewing.pages import POLICY, script_data


def test_headings_and_names_are_text_with_units():
    assert [Column("price", "EUR").heading, Column("AP").heading] == ["price (EUR)", "AP"]
    with pytest.raises(ValueError, match="shorter"):
        build_table("Links", [Column("a"), Column("b")], [["x"]])
    assert build_table("Links", [Column("Pole")], []) == ()
    (only,) = build_table("Links", [Column("Pole"), Column("kbit", digits=2)], [["p", 3]])
    assert only.rows == ((Cell("p"), Cell("3.00", 3.0)),)
    rows = ((Cell(HOSTILE), Cell(HOSTILE, 1.0)),)
    blocks = (
        *(Paragraph(HOSTILE), Bullets((HOSTILE,)), PageDrawing("<svg/>", HOSTILE, HOSTILE)),
        TableBlock(HOSTILE, (Column(HOSTILE, digits=None), Column(HOSTILE)), rows),
    )
    document = Document(HOSTILE, HOSTILE, (Section("requirement", HOSTILE, HOSTILE, blocks),))
    outline = Outline(to_html(document, SCENE))
    assert [each.get("type") for each in outline.all("script")] == ["application/json", None]
    assert not [tag for tag, attributes in outline.elements if "onload" in attributes]
    assert "".join(outline.words).count(HOSTILE) == 14


HOSTILE = "<script>alert('x')</script>\" onload=\"y"
SCENE = PlanScene(
    "<html></script><!--</html>",
    (Layer(HOSTILE, "/sensors/0", "#112233", HOSTILE),),
    (("/a 0",), ("/a 1",)),
)


class Outline(HTMLParser):
    """Elements with their attributes, and all text outside of scripts and styles."""

    def __init__(self, page):
        super().__init__()
        self.elements, self.words, self.inside = [], [], ""
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.inside = tag

    def handle_endtag(self, tag):
        self.inside = ""

    def handle_data(self, data):
        if self.inside not in ("script", "style"):
            self.words.append(data)

    def all(self, tag):
        return [attributes for each, attributes in self.elements if each == tag]


@pytest.fixture(scope="module")
def outline(document):
    return Outline(to_html(document, SCENE))


@pytest.mark.slow
def test_outlines_have_title_navigation_and_pictures_of_their_own(outline):
    assert outline.all("html") == [{"lang": "en"}]
    assert [len(outline.all(tag)) for tag in ("title", "h1", "main", "nav", "header")] == [1] * 5
    links = [each["href"] for each in outline.all("a") if "class" not in each]
    assert links == [f"#{section['id']}" for section in outline.all("section")]
    assert len(links) == 13
    pictures = outline.all("img")
    assert len(pictures) == 17  # four of them views of sensors
    assert all(
        len(each["alt"]) > 20 and each["src"].startswith("data:image/svg+xml;base64,")
        for each in pictures
    )


def test_pages_load_nothing_from_elsewhere(outline):
    for tag, attributes in outline.elements:
        for name in ("src", "href", "action", "poster", "data"):
            address = attributes.get(name) or "#"
            assert address.startswith(("#", "data:")), (tag, address[:60])
    (policy,) = [each for each in outline.all("meta") if each.get("http-equiv")]
    assert policy["content"] == POLICY
    assert "default-src 'none'" in POLICY
    assert "http" not in POLICY


def test_cells_of_numbers_hold_their_value(outline):
    cells = [each for each in outline.all("td") if each.get("class") == "number"]
    assert {"data-value"} <= {name for each in cells for name in each}
    assert any(float(each["data-value"]) == 0.962 for each in cells if "data-value" in each)


def test_documents_keep_their_data_and_bytes(document):
    page = to_html(document, SCENE)
    (data,) = re.findall(
        r'<script type="application/json" id="scene-data">(.*?)</script>', page, re.DOTALL
    )
    assert data == script_data({"html": SCENE.html, "frames": SCENE.frames})
    assert "<" not in data
    first = to_pdf(document)
    assert first == to_pdf(document)
    assert first.startswith(b"%PDF-")
    assert b"/CreationDate" not in first
    assert 6 <= count_pages(first) <= 10


def test_plans_without_sensors_or_scene_have_pages(nothing_chosen):
    outline = Outline(to_html(build_document(nothing_chosen.plan, nothing_chosen.site, None), None))
    assert outline.all("iframe") == []
    assert "No link carries 0.001 kbit per frame." in outline.words
    assert count_pages(to_pdf(build_document(nothing_chosen.plan, nothing_chosen.site, None))) <= 6


TYPST = '#panic("x") $x^2$ `raw` \\ @ref <label> *b* _i_ // /* ] [ } { "'
SQUARE = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><rect width="9" '
    'height="9"/></svg>'
)


def count_pages(pdf):
    return max(
        int(count) for count in re.findall(rb"/Type\s*/Pages.*?/Count (\d+)", pdf, re.DOTALL)
    )


def small(*blocks):
    return Document("Plan", "For a test", (Section("one", "One", "Fine.", blocks),))


def test_texts_are_no_markup_and_long_tables_go_over_pages():
    rows = ((Cell(TYPST), Cell(TYPST, 1.0)),)
    columns = (Column(TYPST, digits=None), Column(TYPST, "m"))
    blocks = (
        Paragraph(TYPST),
        Facts((Fact(TYPST, TYPST, alarm=True),)),
        Bullets((TYPST,)),
        PageDrawing(SQUARE, TYPST, TYPST),
        TableBlock(TYPST, columns, rows),
    )
    hostile = Document(
        TYPST, TYPST, (Section("one", TYPST, TYPST, (*blocks, SceneView(TYPST, TYPST))),)
    )
    assert count_pages(to_pdf(hostile)) == 1
    many = tuple((Cell(f"pole {k}"), Cell(str(k), float(k))) for k in range(300))
    poles = TableBlock("Poles", (Column("Pole", digits=None), Column("k")), many)
    assert count_pages(to_pdf(small(poles))) > 3
    with pytest.raises(
        ValueError, match=r"the PDF cannot be set: .*: the drawings must be SVG"
    ) as caught:
        to_pdf(small(PageDrawing("no picture", "A caption.", "alt")))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_a_logo_stands_on_both_documents(kind):
    drawn = BytesIO()
    Image.new("RGB", (400, 100), "green").save(drawn, kind)
    logo = f"data:image/{kind};base64,{b64encode(drawn.getvalue()).decode()}"
    plain = Document("Elm", "of 2026", (Section("decision", "Decision", "Build one."),))
    with_logo = replace(plain, logo=logo)
    assert f'<img class="logo" alt="" src="{logo}">' in to_html(with_logo, None)
    assert "<img" not in to_html(plain, None)
    assert count_pages(to_pdf(with_logo)) == 1
    assert b"/Subtype/Image" in to_pdf(with_logo)
    assert b"/Subtype/Image" not in to_pdf(plain)
