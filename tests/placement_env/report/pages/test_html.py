import re
from html.parser import HTMLParser

import pytest

from placement_env.report.pages.document import Bullets, Cell, Column, Document, Drawing, Paragraph, Section, TableBlock
from placement_env.report.pages.html import html_of
from placement_env.report.pages.scene import Layer, Scene
from placement_env.report.pages.sections import report_of
from toolkit.viewing.scene import POLICY, script_data

HOSTILE = "<script>alert('x')</script>\" onload=\"y"
SCENE = Scene("<html></script><!--</html>", (Layer(HOSTILE, "/sensors/0", "#112233", HOSTILE),), (("/a 0",), ("/a 1",)))


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
    return Outline(html_of(document, SCENE))


def test_language_title_and_landmarks(outline):
    assert outline.all("html") == [{"lang": "en"}]
    assert [len(outline.all(tag)) for tag in ("title", "h1", "main", "nav", "header")] == [1] * 5


def test_every_section_is_in_the_navigation(outline):
    links = [each["href"] for each in outline.all("a") if "class" not in each]
    assert links == [f"#{section['id']}" for section in outline.all("section")]
    assert len(links) == 14


def test_pictures_have_words_and_come_from_the_page_itself(outline):
    pictures = outline.all("img")
    assert len(pictures) == 13
    assert all(len(each["alt"]) > 20 and each["src"].startswith("data:image/svg+xml;base64,") for each in pictures)


def test_nothing_is_asked_from_anywhere(outline):
    for tag, attributes in outline.elements:
        for name in ("src", "href", "action", "poster", "data"):
            address = attributes.get(name) or "#"
            assert address.startswith(("#", "data:")), (tag, address[:60])
    (policy,) = [each for each in outline.all("meta") if each.get("http-equiv")]
    assert policy["content"] == POLICY
    assert "default-src 'none'" in POLICY
    assert "http" not in POLICY


def test_numbers_carry_what_they_are_sorted_by(outline):
    cells = [each for each in outline.all("td") if each.get("class") == "number"]
    assert {"data-value"} <= {name for each in cells for name in each}
    assert any(float(each["data-value"]) == 0.962 for each in cells if "data-value" in each)


def test_names_are_text_and_never_markup():
    rows = ((Cell(HOSTILE), Cell(HOSTILE, 1.0)),)
    blocks = (
        *(Paragraph(HOSTILE), Bullets((HOSTILE,)), Drawing("<svg/>", HOSTILE, HOSTILE)),
        TableBlock(HOSTILE, (Column(HOSTILE, number=False), Column(HOSTILE)), rows),
    )
    document = Document(HOSTILE, HOSTILE, (Section("requirement", HOSTILE, HOSTILE, blocks),))
    outline = Outline(html_of(document, SCENE))
    assert [each.get("type") for each in outline.all("script")] == ["application/json", None]
    assert not [tag for tag, attributes in outline.elements if "onload" in attributes]
    assert "".join(outline.words).count(HOSTILE) == 14


def test_data_cannot_leave_their_script(document):
    page = html_of(document, SCENE)
    (data,) = re.findall(r'<script type="application/json" id="scene-data">(.*?)</script>', page, re.DOTALL)
    assert data == script_data({"html": SCENE.html, "frames": SCENE.frames})
    assert "<" not in data


def test_without_a_scene_the_page_has_no_frame(nothing_chosen):
    outline = Outline(html_of(report_of(nothing_chosen.plan, nothing_chosen.site, None), None))
    assert outline.all("iframe") == []
    assert "No link carries 0.001 kbit per frame." in outline.words
