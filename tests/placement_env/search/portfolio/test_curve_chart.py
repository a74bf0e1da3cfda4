"""The picture of a budget curve holds the figures it is made from."""

import numpy as np
import pytest

import placement_env.search.answer as drawing
from placement_env.search.portfolio.curve import CurvePoint
from toolkit.plots import canvas

POINTS = [
    CurvePoint(1, (0,), 11.0, 300.0, ("greedy",), 0.6, 0.5, 0.4, 0.55, 0.97, True),
    CurvePoint(2, (0, 2), 21.5, 400.0, (), 0.8, 0.45, 0.35, 0.5, 0.96, False),
    CurvePoint(3, (0, 1, 2), 32.5, 500.0, (), 0.9, 0.7, 0.65, 0.75, 0.96, True),
]


@pytest.fixture
def axes_of(spy, tmp_path):
    calls = spy(canvas, "write_figure")

    def drawn(points):
        out = tmp_path / "curve.svg"
        drawing.draw_curve(points, out, judge="surrogate", currency="EUR")
        figure, _ = calls.pop().args
        assert "by the surrogate" in figure.texts[1].get_text()
        (axes,) = figure.axes
        return axes

    return drawn


def test_the_line_goes_through_what_pays_over_money_too(axes_of):
    axes = axes_of(POINTS)
    line, *rest = axes.lines
    assert np.array(line.get_data()).T.tolist() == [[1.0, 0.5], [3.0, 0.7]]
    drawn = {(each.get_marker(), *np.array(each.get_data()).T.ravel().tolist()) for each in rest}
    assert ("_", 2.0, 0.35, 2.0, 0.5) in drawn
    assert ("x", 2.0, 0.8) in drawn
    assert [each.get_markerfacecolor() for each in rest if each.get_marker() == "o"][1] == "white"
    assert axes.get_xlabel() == "sensors"
    axes = axes_of([CurvePoint(**{**vars(point), "money": point.price + 0.5}) for point in POINTS])
    assert np.array(axes.lines[0].get_data()).T.tolist() == [[11.0, 0.5], [32.5, 0.7]]
    assert axes.get_xlabel() == "price (EUR)"


def test_it_is_written(tmp_path):
    drawing.draw_curve(POINTS, tmp_path / "curve.svg", judge="detector")
    assert "<svg" in (tmp_path / "curve.svg").read_text()
