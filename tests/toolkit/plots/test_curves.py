"""Curves are drawn whole, named below the axes, and come out the same each time."""

import numpy as np
import pytest
from matplotlib.image import imread

from toolkit.plots.canvas import house_style, render_pixels
from toolkit.plots.curves import (
    MAX_LINEAR_POINTS,
    curve_axes,
    draw_density_cdf,
    draw_pr_curves,
    draw_training,
    name_curves,
)

LINE = np.linspace(0, 1, 5)
LOSS = {"loss": ([1.0, 2.0], [3.0, 1.0])}
AP = {"AP 0.7": ([2.0], [0.5])}


def picture(path):
    image = imread(path)
    assert np.ptp(image) > 0.5, "an empty picture"
    return image


def test_precision_over_recall(tmp_path):
    for name in ("a.png", "b.png"):
        draw_pr_curves(
            {"early": (LINE, 1 - LINE), "$late$": (LINE, 1 - LINE**2)},
            tmp_path / name,
            title="IoU 0.7",
        )
    draw_pr_curves({"early": (LINE, 1 - LINE)}, tmp_path / "one.png", title="IoU 0.7")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert picture(tmp_path / "one.png").shape != picture(tmp_path / "a.png").shape


NONE, SOME = {"none": np.zeros(0, np.int64)}, {"0, 2": np.array([3, 0, 8]), "1": np.array([9000])}


@pytest.mark.parametrize("counts", [{}, NONE, SOME])
def test_density(tmp_path, counts):
    draw_density_cdf(counts, tmp_path / "cdf.png")
    picture(tmp_path / "cdf.png")


def test_few_points_take_half_of_the_axis():
    with house_style():
        _, axes = curve_axes("", 0)
        axes.set_xscale("symlog", linthresh=MAX_LINEAR_POINTS, linscale=1.5)
        axes.set_xlim(0, 2000)
        across = axes.transData.transform([(x, 0) for x in (0, 50, 100, 2000)])
        place = axes.transAxes.inverted().transform(across)[:, 0]
    assert place[1] == pytest.approx(place[2] / 2)
    assert place[2] > 0.45
    assert place[3] == pytest.approx(1)


@pytest.mark.parametrize(
    ("curves", "files"),
    [(LOSS, {"losses.png"}), (LOSS | AP, {"losses.png", "ap.png"}), ({}, set())],
)
def test_a_training_has_a_picture_of_what_was_measured(tmp_path, curves, files):
    draw_training(curves, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == files


@pytest.mark.parametrize("count", [1, 5, 30])
def test_the_legend_lies_below_the_axes(count):
    names = ["_hidden", "$5", *("x" * 90 for _ in range(28))][:count]
    with house_style():
        figure, axes = curve_axes("a title", count)
        for _ in names:
            axes.plot([0, 1], [0, 1])
        axes.set(xlabel="recall")
        name_curves(axes, names)
        render_pixels(figure)
    (legend,) = figure.legends
    assert legend.get_texts()[0].get_text() == "_hidden"
    assert len(legend.get_texts()) == count
    assert (
        0
        <= legend.get_window_extent().y0
        < legend.get_window_extent().y1
        <= axes.get_tightbbox().y0 + 1
    )
    assert axes.get_window_extent().height > 150
