"""Charts of a plan: sound SVG for one item and for thirty, with names of any kind, that say what
they are given."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import placement_env.report.charts as charts
from placement_env.handover.mounted import PoleLoad
from placement_env.report.charts import (
    MAX_NAME_LETTERS,
    describe_sample,
    failure_chart,
    front_chart,
    interval_bars,
    link_chart,
    order_chart,
    price_label,
    scheme_chart,
    set_label,
    worth_chart,
)
from placement_env.report.content import (
    BuildStep,
    FailureCase,
    Judgement,
    PlanOption,
    SchemeFigures,
    SensorWorth,
)
from toolkit.plots import canvas
from toolkit.plots.canvas import house_style, render_pixels

NAMES = ["d0", "north-east pole_3 $5 <b>&amp;", "_hidden", "x" * 90, "\\frac{", "日本", "a\x07b"]
MANY = [f"{NAMES[k % 7]}{k}" for k in range(30)]


def judged(ap=0.9, vehicles=412):
    return Judgement(ap, max(0.0, ap - 0.05), min(1.0, ap + 0.03), ap, 0.97, vehicles, 60)


def option(k, judgement=None):
    return PlanOption((f"d{k}",), float(k % 5), 100.0 + 20 * k, 300.0, 0.3 + 0.02 * k, judgement)


def bars(names):
    return interval_bars(
        [(name, judged(0.5 + 0.01 * k)) for k, name in enumerate(names)], "AP by <zone> & $x_1$"
    )


def front(names):
    options = [option(k, judged(0.3 + 0.02 * k) if k % 2 else None) for k in range(len(names))]
    return front_chart(options, options[0], "EUR")


def schemes(names):
    return scheme_chart([SchemeFigures(name, 0.7, judged(), 812.3) for name in names])


def links(names):
    return link_chart(
        [
            PoleLoad(name, 3.0 + k, 4.0 + k, 20.0, (3.0 + k) / 20, k < 17, 3.5 + k)
            for k, name in enumerate(names)
        ]
    )


def worth(names):
    return worth_chart(
        [
            SensorWorth(
                one,
                0.3 - 0.02 * k,
                {other: 0.01 * (j - k) for j, other in enumerate(names) if other != one},
            )
            for k, one in enumerate(names)
        ]
    )


def failures(names):
    return failure_chart(judged(), [FailureCase((name, "d1"), judged(0.5)) for name in names])


def order(names):
    return order_chart(
        [BuildStep(name, 1.5 * (k + 1), judged(0.02 * k)) for k, name in enumerate(names)], "$"
    )


@pytest.mark.one_in(3)
@pytest.mark.parametrize("chart", [bars, front, schemes, links, worth, failures, order])
@pytest.mark.parametrize("names", [MANY[:1], MANY], ids=["one", "thirty"])
def test_charts_are_sound_small_and_the_same_each_time(chart, names):
    text = chart(names)
    root = ElementTree.fromstring(text)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.get("role") == "img"
    assert len(text) < 300_000
    assert "<text" not in text
    assert chart(names) == text


@pytest.mark.parametrize("chart", [bars, schemes, links, worth, failures, order])
def test_nothing_to_show_is_a_chart_too(chart):
    ElementTree.fromstring(chart([]))


def shown(monkeypatch, draw):
    figures = []

    def keep(figure, title=""):
        figures.append(figure)
        return ""

    monkeypatch.setattr(canvas, "svg_text", keep)
    draw()
    (figure,) = figures
    texts = [text.get_text() for text in figure.texts]
    for axes in figure.axes:
        texts += [
            text.get_text()
            for text in (*axes.texts, *axes.get_yticklabels(), *axes.get_xticklabels())
        ]
        texts += [axes.get_xlabel(), axes.get_ylabel()]
    return texts, figure


def widths(axes):
    return [round(float(bar.get_width()), 6) for bar in axes.patches]


def test_bars_are_as_long_as_the_ap_and_lines_as_the_interval(monkeypatch):
    texts, figure = shown(
        monkeypatch,
        lambda: interval_bars([("a", judged(0.9)), ("b", judged(0.5, 7))], "AP by zone"),
    )
    (axes,) = figure.axes
    assert widths(axes) == [0.9, 0.5]
    ends = [line.get_xdata() for line in axes.get_lines()]
    assert {tuple(round(float(x), 6) for x in end) for end in ends} == {(0.85, 0.93), (0.45, 0.53)}
    assert {"AP by zone", "a", "b", "AP", "0.900, N = 412", "0.50, N = 7"} <= set(texts)
    assert any(
        "up to 412 vehicles in 60 frames" in text and "95% intervals" in text for text in texts
    )
    assert axes.get_xlim() == (0, 1)
    assert axes.get_ylim() == (1.5, -0.5)  # the first row on top


def test_schemes_are_named_with_their_kbit(monkeypatch):
    texts, _ = shown(
        monkeypatch, lambda: scheme_chart([SchemeFigures("late", 0.8, judged(), 12.25)])
    )
    assert {"late, IoU 0.8", "0.900, N = 412; 12.25 kbit/sensor"} <= set(texts)


def test_links_that_carry_too_much_are_hatched(monkeypatch):
    fits, not_so = (
        PoleLoad("p", 3.0, 4.0, 20.0, 0.15, True, 3.0),
        PoleLoad("q", 25.0, 40.0, 20.0, 1.25, False, 30.0),
    )
    texts, figure = shown(monkeypatch, lambda: link_chart([fits, not_so]))
    (axes,) = figure.axes
    assert widths(axes) == [3.0, 25.0]
    assert [bar.get_hatch() is not None for bar in axes.patches] == [False, True]
    assert {"3 of 20 Mbit/s, 15%: fits", "25 of 20 Mbit/s, 125%: TOO MUCH", "Mbit/s"} <= set(texts)
    assert axes.get_xlim()[1] == pytest.approx(33)
    _, figure = shown(
        monkeypatch, lambda: link_chart([PoleLoad("p", 3.0, 4.0, 1e9, 0.0, True, 4.0)])
    )
    assert figure.axes[0].get_xlim()[1] == pytest.approx(4.4)


def test_failures_stand_beside_the_whole_set(monkeypatch):
    cases = [FailureCase(("d0", "d1"), judged(0.4))]
    texts, figure = shown(monkeypatch, lambda: failure_chart(judged(0.9), cases))
    (axes,) = figure.axes
    assert widths(axes) == [0.9, 0.4]
    assert [bar.get_hatch() is not None for bar in axes.patches] == [False, True]
    assert {"all work", "without d0, d1"} <= set(texts)
    assert [0.9, 0.9] in [list(line.get_xdata()) for line in axes.get_lines()]


def test_ap_climbs_with_what_was_spent(monkeypatch):
    steps = [BuildStep("d1", 2.0, judged(0.6)), BuildStep("d0", 5.0, judged(0.8))]
    texts, figure = shown(monkeypatch, lambda: order_chart(steps, "EUR"))
    first = figure.axes[0].get_lines()[0]
    assert list(first.get_xdata()) == [0, 2, 5]
    assert list(first.get_ydata()) == [0, 0.6, 0.8]
    assert {
        "price (EUR), spent",
        "1  d1: 2, AP 0.600, N = 412",
        "2  d0: 5, AP 0.800, N = 412",
    } <= set(texts)


def test_fronts_mark_the_chosen_set_and_those_beyond(monkeypatch):
    options = [option(1), option(2, judged(0.8)), option(3, judged(0.7))]
    texts, figure = shown(monkeypatch, lambda: front_chart(options, replace(options[1]), ""))
    for axes, value in zip(figure.axes, (140.0, 2.0), strict=True):
        marks = [
            (line.get_marker(), line.get_xydata()[0].tolist())
            for line in axes.get_lines()
            if len(line.get_xdata()) == 1
        ]
        assert [place for marker, place in marks if marker == "*"] == [[value, 0.8]]
        assert len(marks) == 3
        hollow = [line for line in axes.get_lines() if line.get_markerfacecolor() == "white"]
        assert [line.get_ydata()[0] for line in hollow] == [0.32]
    assert {"kbit per sensor and frame", "price (ordinary poles)", "AP"} <= set(texts)
    assert any(text.startswith("N = 3 sensor sets") for text in texts)


ONE, TWO = Judgement(0.9, 0.8, 0.95, 0.9, 0.9, 120, 40), Judgement(0.5, 0.4, 0.6, 0.5, 0.9, 20, 40)


@pytest.mark.parametrize("names", [["a"], ["x" * 90, "W" * 40], [str(k) for k in range(30)]])
def test_names_and_figures_stay_in_the_picture(monkeypatch, names):
    with house_style():
        _, figure = shown(
            monkeypatch, lambda: interval_bars([(name, ONE) for name in names], "a title")
        )
        (axes,) = figure.axes
        render_pixels(figure)
        for text in (*axes.get_yticklabels(), *axes.texts):
            box = text.get_window_extent()
            if "W" not in text.get_text():
                assert box.x0 >= 0
            assert box.x1 <= figure.bbox.x1
            assert len(text.get_text()) <= MAX_NAME_LETTERS
        assert axes.get_window_extent().width > 120
        assert axes.get_tightbbox().y0 >= 0


def test_rows_say_their_vehicles_in_words(monkeypatch):
    _, figure = shown(monkeypatch, lambda: interval_bars([("a", None), ("b", TWO)], "a title"))
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["not judged: no vehicles", "0.50, N = 20"]
    assert len(axes.patches) == 1
    assert "N = 120 vehicles in 40 frames" in describe_sample([ONE, None])
    assert "N = up to 120 vehicles in 40 frames" in describe_sample([ONE, TWO])
    assert describe_sample([None]) == "no vehicles were judged"
    assert price_label("EUR") == "price (EUR)"
    assert set_label(()) == "none"
    assert len(set_label([f"pole {k}" for k in range(30)])) <= MAX_NAME_LETTERS


WORTH = [
    *(
        SensorWorth("d0", 0.5, {"d1": -0.2, "d2": 0.05}),
        SensorWorth("d1", 0.3, {"d0": -0.2, "d2": 0.0}),
    ),
    SensorWorth("d2", -0.1, {"d0": 0.05, "d1": 0.0}),
]


@pytest.fixture
def figure_of(monkeypatch):
    return lambda worth: shown(monkeypatch, lambda: worth_chart(worth))[1]


def test_tables_of_pairs_have_figures(figure_of):
    bars, table = figure_of(WORTH).axes
    assert [bar.get_width() for bar in bars.patches] == [0.5, 0.3, -0.1]
    assert [text.get_text() for text in bars.texts] == ["+0.500", "+0.300", "-0.100"]
    (image,) = table.images
    pairs = np.ma.filled(image.get_array(), np.nan)
    assert pairs == pytest.approx(
        np.array([[np.nan, -0.2, 0.05], [-0.2, np.nan, 0], [0.05, 0, np.nan]]), nan_ok=True
    )
    assert image.get_clim() == (-0.2, 0.2)
    assert [text.get_text() for text in table.texts][:2] == ["-0.20", "+0.05"]
    assert [label.get_text() for label in bars.get_yticklabels()] == ["d0", "d1", "d2"]


def test_long_names_have_numbers_in_the_table(figure_of):
    bars, table = figure_of(
        [SensorWorth("north-east pole", 0.2, {}), SensorWorth("d1", 0.1, {})]
    ).axes
    assert [label.get_text() for label in bars.get_yticklabels()] == ["north-east pole  1", "d1  2"]
    assert [label.get_text() for label in table.get_xticklabels()] == ["1", "2"]


def test_large_tables_have_colours_alone(figure_of):
    names = [f"s{k}" for k in range(charts.MAX_FIGURE_SENSORS + 1)]
    many = [SensorWorth(one, 0.1, {other: 0.1 for other in names if other != one}) for one in names]
    assert not figure_of(many).axes[1].texts
    assert figure_of(many[:3]).axes[1].texts
