"""Axes with rows: names stand beside them, and figures have room."""

import pytest

from placement_env.report.content import Judgement
from placement_env.report.drawings.axes import (
    LETTERS,
    counted_words,
    draw_intervals,
    padded_limits,
    price_words,
    row_axes,
    set_words,
)
from toolkit.plots.canvas import drawn_pixels, house_style

ONE, TWO = Judgement(0.9, 0.8, 0.95, 0.9, 0.9, 120, 40), Judgement(0.5, 0.4, 0.6, 0.5, 0.9, 20, 40)


@pytest.mark.parametrize("names", [["a"], ["x" * 90, "W" * 40], [str(k) for k in range(30)]])
def test_names_and_figures_stay_in_the_picture(names):
    with house_style():
        figure, axes = row_axes("a title", "said", names)
        draw_intervals(axes, [ONE] * len(names))
        drawn_pixels(figure)
        for text in (*axes.get_yticklabels(), *axes.texts):
            box = text.get_window_extent()
            if "W" not in text.get_text():
                assert box.x0 >= 0
            assert box.x1 <= figure.bbox.x1
            assert len(text.get_text()) <= LETTERS
        assert axes.get_window_extent().width > 120
        assert axes.get_tightbbox().y0 >= 0


def test_a_row_without_vehicles_says_so():
    with house_style():
        _, axes = row_axes("a title", "said", ["a", "b"])
        draw_intervals(axes, [None, TWO])
    assert [text.get_text() for text in axes.texts] == ["not judged: no vehicles", "0.500, N = 20"]
    assert len(axes.patches) == 1


def test_the_number_of_vehicles_is_said():
    assert "N = 120 vehicles in 40 frames" in counted_words([ONE, None])
    assert "N = up to 120 vehicles in 40 frames" in counted_words([ONE, TWO])
    assert counted_words([None]) == "no vehicles were judged"


@pytest.mark.parametrize(("values", "limits"), [([], (0, 1)), ([0.0], (0, 1)), ([1.0, 10.0], (0, 11))])
def test_limits_leave_room(values, limits):
    assert padded_limits(values) == pytest.approx(limits)


def test_words():
    assert price_words("EUR") == "price (EUR)"
    assert set_words(()) == "none"
    assert len(set_words([f"pole {k}" for k in range(30)])) <= LETTERS
