"""Reference lines against circles, clothoids and polynomials worked out by hand."""

from xml.etree import ElementTree

import numpy as np
import pytest

from toolkit.sites.opendrive.reference_line import Cubics, cubics, number, reference_line


def line_of(*shapes, x=10.0, y=5.0, heading=0.0, elevation=""):
    start, text = 0.0, ""
    for length, shape in shapes:
        text += f'<geometry s="{start}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>'
        start += length
    profile = f"<elevationProfile>{elevation}</elevationProfile>"
    return reference_line(ElementTree.fromstring(f'<road id="7"><planView>{text}</planView>{profile}</road>'))


def test_line_and_the_side_of_t():
    line = line_of((20.0, "<line/>"), heading=np.pi / 2)
    np.testing.assert_allclose(line.at(np.array([0.0, 12.0])), [[10, 5, np.pi / 2], [10, 17, np.pi / 2]], atol=1e-12)
    np.testing.assert_allclose(line.beside(np.array([12.0]), np.array([3.0])), [[7, 17]], atol=1e-12)


@pytest.mark.parametrize("curvature", [0.1, -0.1, 1e-12])
def test_arc_lies_on_its_circle(curvature):
    line = line_of((15.0, f'<arc curvature="{curvature}"/>'), x=0.0, y=0.0)
    s = np.array([0.0, 5.0, 15.0])
    turn = curvature * s
    exact = [np.sin(turn) / curvature, (1 - np.cos(turn)) / curvature, turn]
    np.testing.assert_allclose(line.at(s), np.transpose(exact), atol=1e-3 if curvature == 1e-12 else 1e-9)


def test_spiral_against_its_series():
    line = line_of((20.0, '<spiral curvStart="0" curvEnd="0.05"/>'), x=0.0, y=0.0)
    s, rate = 20.0, 0.05 / 20.0
    ((x, y, heading),) = line.at(np.array([s]))
    assert heading == pytest.approx(rate * s**2 / 2)
    assert x == pytest.approx(s - rate**2 * s**5 / 40 + rate**4 * s**9 / 3456, abs=1e-3)
    assert y == pytest.approx(rate * s**3 / 6 - rate**3 * s**7 / 336, abs=1e-3)


def test_polynomials():
    s = np.array([0.0, 4.0])
    cubic = line_of((8.0, '<poly3 a="1" b="0" c="0.5" d="0"/>'), x=0.0, y=0.0)
    np.testing.assert_allclose(cubic.at(s), [[0, 1, 0], [4, 9, np.arctan(4.0)]])
    normal = '<paramPoly3 pRange="{}" aU="0" bU="{}" cU="0" dU="0" aV="0" bV="0" cV="{}" dV="0"/>'
    for text in (normal.format("normalized", 8, 16), normal.format("arcLength", 1, 0.25)):
        np.testing.assert_allclose(line_of((8.0, text), x=0.0, y=0.0).at(s)[:, :2], [[0, 0], [4, 4]])


def test_pieces_follow_in_order_of_s():
    line = line_of((10.0, "<line/>"), (10.0, '<arc curvature="0.1"/>'))
    assert line.length == 20.0
    assert line.at(np.array([15.0]))[0, 2] == pytest.approx(0.5)


def test_elevation_and_its_slope():
    line = line_of(
        (50.0, "<line/>"), elevation='<elevation s="30" a="4" b="0.02"/><elevation s="0" a="1" b="0.1" c="0.001"/>'
    )
    np.testing.assert_allclose(line.elevation.at(np.array([0.0, 10, 40])), [1, 2.1, 4.2])
    np.testing.assert_allclose(line.elevation.slope(np.array([10.0, 40])), [0.12, 0.02])
    assert (Cubics(np.zeros(0), np.zeros((0, 4))).at(np.arange(3.0)) == 0).all()
    assert not len(cubics([]).starts)


@pytest.mark.parametrize("text", ["nan", "inf", "1e9", "far", ""])
def test_what_is_no_number(text):
    with pytest.raises(ValueError, match=r"<a> needs a finite number as s, got .*: export it again") as raised:
        number(ElementTree.fromstring(f'<a s="{text}"/>'), "s")
    assert "\n" not in str(raised.value)
    assert number(ElementTree.fromstring("<a/>"), "s", 2.5) == 2.5


def test_damaged_geometry():
    with pytest.raises(ValueError, match="road '7' has no <geometry>"):
        line_of()
    with pytest.raises(ValueError, match="holds <loop>, not one of line, arc"):
        line_of((5.0, "<loop/>"))
    with pytest.raises(ValueError, match="length of 0 to 100000 m, got -3"):
        line_of((-3.0, "<line/>"))
