"""Figures as words and cells."""

import pytest

from placement_env.classes import join_names
from placement_env.report.content import Judgement, overlap
from placement_env.report.pages import columns, figure_texts
from placement_env.report.pages.document import Cell, Column, build_table
from placement_env.report.pages.figure_texts import number_text

JUDGED = Judgement(0.95, 0.91, 0.98, 0.965, None, 1412, 60)


@pytest.mark.parametrize(
    ("share", "text"),
    [
        *(
            (0.0, "0%"),
            (0.004, "under 1%"),
            (0.5, "50%"),
            (0.996, "over 99%"),
            (1.0, "100%"),
            (None, "–"),
        ),
        (float("nan"), "–"),
    ],
)
def test_a_share_is_never_rounded_to_all_or_nothing(share, text):
    assert figure_texts.percent(share) == text


def test_figures_prices_and_names_in_words():
    assert number_text(None) == number_text(float("nan")) == number_text(float("inf")) == "–"
    assert Column("AP").cell(None) == Column("AP").cell(float("nan")) == Cell("–", None)
    assert [figure_texts.price_text(p, "EUR") for p in (6.0, 1250.5)] == ["6 EUR", "1,250.50 EUR"]
    assert [figure_texts.price_text(p, "") for p in (1.0, 2.5, 4.0)] == [
        "1 unit",
        "2.5 units",
        "4 units",
    ]
    assert figure_texts.ap_text(JUDGED) == "AP 0.950 (0.910–0.980, 1,412 vehicles)"
    assert figure_texts.interval_text(JUDGED) == "0.910–0.980"
    (judged,) = build_table(
        "", columns.JUDGED_COLUMNS, [columns.judgement_cells(JUDGED), columns.judgement_cells(None)]
    )
    assert [[cell.text for cell in row] for row in judged.rows] == [
        ["0.950", "0.910–0.980", "96.5", "1,412", "60"],
        ["–", "no vehicle", "–", "0", "–"],
    ]
    assert [join_names(list("abcd"[:n])) for n in range(4)] == [
        "none",
        "a",
        "a and b",
        "a, b and c",
    ]


@pytest.mark.parametrize(
    ("low", "high", "expected"), [(0.5, 0.91, True), (0.5, 0.90, False), (0.981, 1.0, False)]
)
def test_intervals_overlap_where_they_touch(low, high, expected):
    other = Judgement(0.7, low, high, 0.7, None, 9, 9)
    assert overlap(JUDGED, other) is overlap(other, JUDGED) is expected
