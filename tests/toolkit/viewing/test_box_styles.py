"""Styles of boxes: edges, dashes and marks."""

from types import SimpleNamespace

import numpy as np
import pytest

from toolkit.viewing.box_lines import box_edges, roof_crosses
from toolkit.viewing.box_styles import BoxStyle, DashPattern, add_boxes

BOXES = np.array([[1.0, 2, 1, 4, 2, 2, 0.0], [9.0, 2, 1, 4, 2, 2, 1.0]])


def length(lines):
    return np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()


def test_a_style_draws_edges_then_marks():
    plain = BoxStyle("#102030", width=2.0)
    np.testing.assert_array_equal(plain.lines(BOXES), box_edges(BOXES))
    marked = BoxStyle("#102030", width=2.0, mark=roof_crosses)
    np.testing.assert_array_equal(marked.lines(BOXES)[:24], box_edges(BOXES))
    np.testing.assert_array_equal(marked.lines(BOXES)[24:], roof_crosses(BOXES))


def test_dashes_leave_gaps_in_the_edges_only():
    half = DashPattern(dash=0.5, gap=0.5)  # edges are 2 and 4 m long, so half of each is drawn
    dashed = BoxStyle("#102030", width=2.0, dashes=half, mark=roof_crosses)
    lines = dashed.lines(BOXES)
    np.testing.assert_array_equal(lines[-4:], roof_crosses(BOXES))
    assert length(lines[:-4]) == pytest.approx(length(box_edges(BOXES)) / 2)


def test_boxes_are_added_in_their_style_and_no_boxes_add_nothing():
    added = {}

    def add_line_segments(name, **options):
        added[name] = options
        return SimpleNamespace(name=name)

    api = SimpleNamespace(add_line_segments=add_line_segments)
    style = BoxStyle("#102030", width=2.5)
    assert add_boxes(api, "/none", BOXES[:0], style, visible=True) is None
    assert add_boxes(api, "/cars", BOXES, style, visible=False).name == "/cars"
    (cars,) = added.values()
    assert (cars["colors"], cars["thickness"], cars["visible"]) == ((16, 32, 48), 2.5, False)
    assert cars["points"].shape == (24, 2, 3)
