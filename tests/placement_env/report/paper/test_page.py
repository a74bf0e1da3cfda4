import re
from html.parser import HTMLParser

import pytest

from placement_env.analysis.intervals import Interval
from placement_env.report.paper.comparison import Compared, Experiment
from placement_env.report.paper.page import paper_page

ROWS = (
    Compared(("early",), "AP", 0.99, 0.71, Interval(0.98, 1.0), reason="more is seen & found <A>"),
    Compared(("late",), "AP", 0.71, 0.70),
    Compared(("sent",), "kbit", 516.0, 516.0),
)
MADE = Experiment("one", "Title & more", "table 1", ("scheme",), ROWS, "2 frames", "So it is.", lambda out: None)


@pytest.fixture(scope="module")
def page():
    about = {"frames": "2", "made by": "coview <reproduce>"}
    return paper_page("Ours & theirs", [MADE], {"one": b"<svg/>"}, conditions=about, causes={"A": "Because."})


def test_it_asks_for_nothing_else(page):
    found = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert found
    assert all(each.startswith(("data:", "#")) for each in found)
    assert "<script" not in page
    assert "url(" not in page


def test_ours_the_papers_and_the_difference_stand_side_by_side(page):
    cells = re.findall(r"<tr[^>]*>(<td.*?)</tr>", page)
    first = re.findall(r"<td[^>]*>(.*?)</td>", cells[0])
    assert first == [
        "early", "AP", "0.9900", "0.9800–1.0000", "0.7100", "+0.2800", "more is seen &amp; found &lt;A&gt;",
    ]  # fmt: skip
    assert [re.findall(r"<td[^>]*>(.*?)</td>", row)[5] for row in cells] == ["+0.2800", "+0.0100", "+0.00"]


def test_large_differences_are_counted_and_marked(page):
    assert "1 of 2 AP differ from the paper's by more than 0.05" in page
    assert page.count('<tr class="large">') == 1


def test_texts_are_escaped_and_all_there(page):
    for text in (
        "Ours &amp; theirs",
        "Title &amp; more",
        "coview &lt;reproduce&gt;",
        "So it is.",
        "2 frames",
        "Because.",
    ):
        assert text in page


def test_every_element_is_closed(page):
    class Checker(HTMLParser):
        def __init__(self):
            super().__init__()
            self.open = []

        def handle_starttag(self, tag, attrs):
            if tag not in ("meta", "img"):
                self.open.append(tag)

        def handle_endtag(self, tag):
            assert self.open.pop() == tag

    checker = Checker()
    checker.feed(page)
    assert checker.open == []


def test_it_prints_section_by_section(page):
    assert "@media print" in page
    assert "break-before: page" in page
