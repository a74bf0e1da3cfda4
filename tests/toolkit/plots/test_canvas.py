"""Figures are written the same each time, as PNG and SVG, and text in them is taken as it is."""

import re
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest

from toolkit.plots import canvas


def figure(text="a", value=1.0):
    made = canvas.blank_figure(2.0, 1.0)
    axes = made.add_axes((0.1, 0.2, 0.8, 0.7))
    axes.plot([0, value], [0, 1.234567])
    axes.set_title(canvas.replace_unprintable(text))
    return made


@pytest.mark.parametrize("ending", ["png", "svg", "SVG"])
def test_the_same_figure_is_the_same_file(tmp_path, ending):
    for name in ("a", "b"):
        with canvas.house_style():
            canvas.write_figure(figure(), tmp_path / f"{name}.{ending}")
    one, other = (tmp_path / f"{name}.{ending}" for name in ("a", "b"))
    assert one.read_bytes() == other.read_bytes()
    assert one.read_bytes().startswith(b"\x89PNG" if ending == "png" else b"<?xml")


def test_pictures_heed_no_settings_of_the_user():
    with canvas.house_style():
        usual = canvas.svg_text(figure())
    with mpl.rc_context(
        {"font.size": 30, "svg.fonttype": "none", "lines.linewidth": 9, "text.color": "red"}
    ):
        with canvas.house_style():
            assert canvas.svg_text(figure()) == usual
        assert mpl.rcParams["font.size"] == 30
    with canvas.house_style():
        assert canvas.svg_text(figure("$x$")) != canvas.svg_text(figure("x"))


def test_pictures_on_one_page_share_no_names():
    with canvas.house_style():
        one, other = canvas.svg_text(figure(value=1.0)), canvas.svg_text(figure(value=2.0))
    names = [
        {each.get("id") for each in ElementTree.fromstring(text).iter()} - {None}
        for text in (one, other)
    ]
    assert names[0]
    assert not names[0] & names[1]
    for text, known in zip((one, other), names, strict=True):
        used = set(re.findall(r'(?:url\(#|href="#)([^")]+)', text))
        assert used
        assert used <= known


def test_paths_are_rounded():
    with canvas.house_style():
        assert "1.234567" not in canvas.svg_text(figure())
        path = (
            ElementTree.fromstring(canvas.svg_text(figure())).find(".//{*}g[@id]//{*}path").get("d")
        )
    assert path is not None
    assert "  " not in path
    assert all(
        len(number.partition(".")[2]) <= 2
        for number in path.replace("M", " ").replace("L", " ").split()
    )


def test_pictures_are_rendered_as_pixels():
    with canvas.house_style():
        pixels = canvas.render_pixels(figure())
    assert pixels.shape == (100, 200, 3)
    assert pixels.dtype == np.uint8
    assert np.ptp(pixels) > 200


@pytest.mark.parametrize("name", ["a.pdf", "a", "a.png.txt"])
def test_other_endings_are_refused(tmp_path, name):
    with pytest.raises(ValueError, match=r"end in \.png or \.svg"):
        canvas.write_figure(figure(), tmp_path / name)
    assert not list(tmp_path.iterdir())


TEXTS = ["$x_1$", "a < b & c > d", "_hidden", "50 %", "$", "\\frac{", "a\x00b\nc", "-- -->", "日"]


@pytest.mark.parametrize("text", TEXTS)
def test_text_is_taken_as_it_is(text):
    with canvas.house_style():
        drawn = canvas.svg_text(figure(text), title=text)
    root = ElementTree.fromstring(drawn)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.find("{http://www.w3.org/2000/svg}title").text == canvas.replace_unprintable(text)
    assert root.get("role") == "img"
    assert "<text" not in drawn
    assert "<metadata" not in drawn


@pytest.mark.parametrize(
    ("text", "most", "short"),
    [
        ("abc", 3, "abc"),
        ("abcd", 3, "a…d"),
        ("abcdefgh", 5, "ab…gh"),
        ("a\tb", 9, "a b"),
        ("", 4, ""),
    ],
)
def test_long_text_loses_its_middle(text, most, short):
    assert canvas.shorten(text, most) == short


@pytest.mark.parametrize(
    ("values", "limits"), [([], (0, 1)), ([0.0], (0, 1)), ([1.0, 10.0], (0, 11))]
)
def test_limits_leave_room(values, limits):
    assert canvas.pad_limits(values) == pytest.approx(limits)
