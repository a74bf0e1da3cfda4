"""The page and its charts."""

import re
from functools import partial
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

from examples.studies.paper.charts import draw_agreement, draw_log_fit, draw_pairs
from examples.studies.paper.comparison import Compared, Experiment
from examples.studies.paper.page import paper_page
from placement_env.analysis.intervals import Interval

INTERVAL = Interval(0.85, 0.95)
ROWS = (
    Compared(("early",), "AP", 0.99, 0.71, Interval(0.98, 1.0), reason="more is seen & found <A>"),
    *(Compared(("late",), "AP", 0.71, 0.70), Compared(("sent",), "kbit", 516.0, 516.0)),
)
MADE = Experiment(
    "one", "Title & more", "table 1", ("scheme",), ROWS, "2 frames", "So it is.", lambda out: None
)


@pytest.fixture(scope="module")
def page():
    about = {"frames": "2", "made by": "coview <reproduce>"}
    return paper_page(
        "Ours & theirs", [MADE], {"one": b"<svg/>"}, conditions=about, causes={"A": "Because."}
    )


def test_pages_request_nothing(page):
    found = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert found
    assert all(each.startswith(("data:", "#")) for each in found)
    assert "<script" not in page
    assert "url(" not in page


def test_figures_stand_beside_the_papers(page):
    cells = re.findall(r"<tr[^>]*>(<td.*?)</tr>", page)
    first = re.findall(r"<td[^>]*>(.*?)</td>", cells[0])
    figures = ["early", "AP", "0.9900", "0.9800–1.0000", "0.7100", "+0.2800"]
    assert first == [*figures, "more is seen &amp; found &lt;A&gt;"]
    assert [re.findall(r"<td[^>]*>(.*?)</td>", row)[5] for row in cells] == [
        "+0.2800",
        "+0.0100",
        "+0.00",
    ]
    assert "1 of 2 AP values differ from the paper's by more than 0.05" in page
    assert page.count('<tr class="large">') == 1


def test_pages_break_in_print(page):
    assert "@media print" in page
    assert "break-before: page" in page


def test_pages_are_closed_and_escaped(page):
    for text in (
        *(
            "Ours &amp; theirs",
            "Title &amp; more",
            "coview &lt;reproduce&gt;",
            "So it is.",
            "2 frames",
            "Because.",
        ),
    ):
        assert text in page

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


def pairs(out, interval=INTERVAL):
    rows = [Compared(("early",), "AP", 0.9, 0.8, interval), Compared(("late",), "AP", None, 0.7)]
    draw_pairs(["early", "late"], rows, out, title="Pairs")


SETS = {"early": [("0,2", 0.5, 0.6)], "late": [("0,1,2,3", 0.7, 0.8)]}


@pytest.mark.parametrize(
    "draw",
    [
        *(pairs, partial(draw_agreement, SETS, title="Sets")),
        partial(
            draw_log_fit, np.array([10.0, 100.0]), np.array([0.4, 0.8]), (0.0, 0.17), title="Fit"
        ),
        partial(
            draw_log_fit, np.zeros(0), np.zeros(0), (float("nan"), float("nan")), title="Nothing"
        ),
    ],
)
def test_svg_is_sound_and_the_same_each_time(draw, tmp_path):
    for name in ("a.svg", "b.svg"):
        draw(out=tmp_path / name)
    ElementTree.parse(tmp_path / "a.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_pictures_as_png_draw_both_and_the_interval(tmp_path):
    pairs(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    pairs(tmp_path / "a.svg")
    pairs(tmp_path / "b.svg", None)
    text = (tmp_path / "a.svg").read_text()
    assert all(colour in text for colour in ("#0072b2", "#e69f00"))
    assert "pattern" in text  # the paper's are hatched
    assert len(text) > len((tmp_path / "b.svg").read_text())
