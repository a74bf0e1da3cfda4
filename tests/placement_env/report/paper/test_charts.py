from xml.etree import ElementTree

import numpy as np
import pytest

from placement_env.report.paper.charts import draw_agreement, draw_log_fit, draw_pairs


def pairs(out):
    draw_pairs(["early", "late"], [0.9, None], [0.8, 0.7], out, title="Pairs", intervals=[(0.85, 0.95), None])


def agreement(out):
    draw_agreement({"early": [("0,2", 0.5, 0.6)], "late": [("0,1,2,3", 0.7, 0.8)]}, out, title="Sets")


def fit(out):
    draw_log_fit(np.array([10.0, 100.0]), np.array([0.4, 0.8]), (0.0, 0.17), out, title="Fit")


def nothing(out):
    draw_log_fit(np.zeros(0), np.zeros(0), (float("nan"), float("nan")), out, title="Nothing")


@pytest.mark.parametrize("draw", [pairs, agreement, fit, nothing])
def test_svg_is_sound_and_the_same_each_time(draw, tmp_path):
    for name in ("a.svg", "b.svg"):
        draw(tmp_path / name)
    ElementTree.parse(tmp_path / "a.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_png_too(tmp_path):
    pairs(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"


def test_both_and_the_interval_are_drawn(tmp_path):
    pairs(tmp_path / "a.svg")
    draw_pairs(["early", "late"], [0.9, None], [0.8, 0.7], tmp_path / "b.svg", title="Pairs")
    text = (tmp_path / "a.svg").read_text()
    assert all(colour in text for colour in ("#0072b2", "#e69f00"))
    assert "pattern" in text  # the paper's are hatched
    assert len(text) > len((tmp_path / "b.svg").read_text())
