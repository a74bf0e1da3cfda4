from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image

from toolkit.plots import canvas, palette
from toolkit.viewing.colouring import COLOURINGS
from toolkit.viewing.drawing import Drawing
from toolkit.viewing.drawn import DrawnSample
from toolkit.viewing.still import write_still


@pytest.fixture(autouse=True)
def small(limits):
    limits(canvas, DPI=50)


@pytest.fixture(scope="module")
def drawn(samples, finds_the_car):
    return Drawing(finds_the_car).draw_all(samples)[1]


@pytest.fixture(scope="module")
def judged(touched, finds_the_car):
    return Drawing(finds_the_car).draw_all([touched])[0]


def has(picture, colour):
    wanted = np.array(tuple(bytes.fromhex(colour[1:]))) / 255
    return bool((np.abs(picture[..., :3] - wanted).max(axis=-1) < 0.02).any())


def test_a_picture_has_sensors_points_and_outcomes(judged, tmp_path):
    write_still(judged, tmp_path / "a.png", title="lidars")
    picture = image.imread(tmp_path / "a.png")
    assert min(picture.shape[:2]) > 300
    for outcome in ("hit", "missed"):
        assert has(picture, palette.OUTCOME[outcome].colour)
    write_still(judged, tmp_path / "b.png", title="lidars")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_colourings_and_outcomes_that_nobody_judges_are_drawn(drawn, tmp_path):
    write_still(replace(drawn, outcomes={}, truth={}, tags=()), tmp_path / "a.png")
    picture = image.imread(tmp_path / "a.png")
    assert [has(picture, palette.sensor_colour(k)) for k in (0, 1, 2)] == [True, True, False]
    assert not any(
        has(picture, palette.OUTCOME[outcome].colour) for outcome in ("hit", "false alarm")
    )
    pictures = set()
    for colouring in COLOURINGS:
        write_still(drawn, tmp_path / "a.png", colouring=colouring)
        pictures.add((tmp_path / "a.png").read_bytes())
    assert len(pictures) == len(COLOURINGS)
    write_still(drawn, tmp_path / "a.png", half=(20.0, 10.0))
    rows, columns, _ = image.imread(tmp_path / "a.png").shape
    assert 1.3 < columns / rows < 1.8


@pytest.mark.one_in(2)
@pytest.mark.parametrize("colouring", COLOURINGS)
def test_points_are_coloured_as_asked(drawn, tmp_path, colouring):
    write_still(drawn, tmp_path / "a.svg", colouring=colouring, sensors=("north", "south"))
    assert (tmp_path / "a.svg").read_text().startswith("<?xml")


def test_nothing_can_be_drawn_and_other_endings_are_refused(tmp_path):
    nothing = DrawnSample("nothing", 0.0, (), {}, {})
    write_still(nothing, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000
    with pytest.raises(ValueError, match=r"must end in \.png or \.svg, got a\.jpg"):
        write_still(nothing, tmp_path / "a.jpg")
