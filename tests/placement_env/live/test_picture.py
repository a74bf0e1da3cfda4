"""Pictures under the scene: placed by two points, kept whole, refused when damaged."""

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image

from placement_env.live.picture import MAX_PICTURE_BYTES, MAX_SIDE_PX, GroundPicture, keep_picture

AREA = np.array([-40.0, -30.0, 40.0, 30.0])
LAID = GroundPicture("plan.png", "picture-0123456789ab.jpg", 800, 600, 0.0, 0.0, 0.1)
SPOT = st.tuples(st.floats(-50, 50), st.floats(-50, 50))


def encode(kind="PNG", size=(400, 300)):
    made = BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (*size[::-1], 3), np.uint8)).save(
        made, kind
    )
    return made.getvalue()


def lie(picture, point):
    """Where a point of a picture (m from its middle, before it was placed) lies in the site."""
    found = complex(*point) * picture.scale / LAID.scale * np.exp(1j * picture.turn) + complex(
        picture.x, picture.y
    )
    return found.real, found.imag


@given(SPOT, SPOT, SPOT, SPOT)
def test_two_points_come_to_lie_where_they_belong(start, end, first, last):
    if min(np.hypot(*np.subtract(end, start)), np.hypot(*np.subtract(last, first))) < 0.5:
        with pytest.raises(ValueError, match="apart"):
            LAID.place((start, end), (*first, *last))
        return
    placed = LAID.place((start, end), (*first, *last))
    assert lie(placed, start) == pytest.approx(first, abs=1e-6)
    assert lie(placed, end) == pytest.approx(last, abs=1e-6)


def test_a_distance_scales_about_the_first_point():
    placed = LAID.place(((1, 2), (4, 6)), (10,))
    assert lie(placed, (1, 2)) == pytest.approx((1, 2))
    assert lie(placed, (4, 6)) == pytest.approx((7, 10))
    assert (placed.turn, placed.scale) == pytest.approx((0, 0.2))


@pytest.mark.parametrize("numbers", [(), (1, 2), (1, 2, 3), (1, 2, 3, np.nan), (np.inf,)])
def test_other_numbers_are_refused(numbers):
    with pytest.raises(ValueError):
        LAID.place(((0, 0), (5, 5)), numbers)


def test_a_picture_is_kept_and_read_back(tmp_path):
    kept = keep_picture("my plan.jpeg", encode("JPEG", (2 * MAX_SIDE_PX, 100)), tmp_path, AREA)
    assert (kept.width, kept.height) == (MAX_SIDE_PX, 50)
    assert kept.width * kept.scale == pytest.approx(80)
    assert kept.read(tmp_path).shape == (50, MAX_SIDE_PX, 3)
    (tmp_path / kept.file).write_bytes(b"gone")
    with pytest.raises(ValueError, match="no whole PNG or JPEG"):
        kept.read(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("plan.png", encode()[:-200], "no whole"),
        ("plan.gif", encode("GIF"), "no whole"),
        ("plan.png", b"", "no whole"),
        ("x" * 61, encode(), "1 to 60"),
        ("a\nb.png", encode(), "one line"),
        ("plan.png", bytes(MAX_PICTURE_BYTES + 1), "at most 40 MB"),
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(tmp_path, name, content, said):
    with pytest.raises(ValueError, match=said) as refused:
        keep_picture(name, content, tmp_path, AREA)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_picture_bomb_is_refused(tmp_path, limits):
    limits("placement_env.live.picture", MAX_PIXELS=400 * 300 - 1)
    with pytest.raises(ValueError, match="million pixels"):
        keep_picture("plan.png", encode(), tmp_path, AREA)


@pytest.mark.parametrize(
    "change",
    [
        {"name": ""},
        {"file": "../x.jpg"},
        {"scale": 0.0},
        {"width": 0},
        {"turn": np.nan},
        {"x": "1"},
    ],
)
def test_a_row_that_does_not_fit_is_refused(change):
    with pytest.raises(ValueError):
        replace(LAID, **change)
