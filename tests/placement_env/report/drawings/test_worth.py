"""Shapley values as bars, and the interactions of pairs as a table."""

import numpy as np
import pytest

import placement_env.report.drawings.worth as drawing
from placement_env.report.content import SensorWorth

WORTH = [
    SensorWorth("d0", 0.5, {"d1": -0.2, "d2": 0.05}),
    SensorWorth("d1", 0.3, {"d0": -0.2, "d2": 0.0}),
    SensorWorth("d2", -0.1, {"d0": 0.05, "d1": 0.0}),
]


@pytest.fixture
def figure_of(monkeypatch):
    figures = []

    def keep(figure, title):
        figures.append(figure)
        return ""

    monkeypatch.setattr(drawing, "chart_text", keep)

    def drawn(worth):
        drawing.worth_chart(worth)
        return figures.pop()

    return drawn


def test_values_and_pairs_are_those_given(figure_of):
    bars, table = figure_of(WORTH).axes
    assert [bar.get_width() for bar in bars.patches] == [0.5, 0.3, -0.1]
    assert [text.get_text() for text in bars.texts] == ["+0.500", "+0.300", "-0.100"]
    (image,) = table.images
    pairs = np.ma.filled(image.get_array(), np.nan)
    assert pairs == pytest.approx(
        np.array([[np.nan, -0.2, 0.05], [-0.2, np.nan, 0.0], [0.05, 0.0, np.nan]]), nan_ok=True
    )
    assert image.get_clim() == (-0.2, 0.2)
    assert [text.get_text() for text in table.texts][:2] == ["-0.20", "+0.05"]
    assert [label.get_text() for label in bars.get_yticklabels()] == ["d0", "d1", "d2"]


def test_long_names_have_numbers(figure_of):
    bars, table = figure_of([SensorWorth("north-east pole", 0.2, {}), SensorWorth("d1", 0.1, {})]).axes
    assert [label.get_text() for label in bars.get_yticklabels()] == ["north-east pole  1", "d1  2"]
    assert [label.get_text() for label in table.get_xticklabels()] == ["1", "2"]


def test_a_large_table_has_no_figures(figure_of):
    names = [f"s{k}" for k in range(drawing.MOST_FIGURES + 1)]
    many = [SensorWorth(one, 0.1, {other: 0.1 for other in names if other != one}) for one in names]
    assert not figure_of(many).axes[1].texts
    assert figure_of(many[:3]).axes[1].texts
