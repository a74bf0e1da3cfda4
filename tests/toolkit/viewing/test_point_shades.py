import numpy as np
import pytest

from toolkit.plots.palette import sensor_colour
from toolkit.viewing.drawn_sample import DrawnCloud, DrawnSample
from toolkit.viewing.point_shades import UNKNOWN_SHADE, Scales, newest_of, shades

POINTS = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 9]], np.float32)
CLOUD = DrawnCloud("a", POINTS, np.zeros(3), np.array([0.0, 0.1, 0.05, 0.02]), np.array([4, 3, 2, 1], np.float32))
BARE = DrawnCloud("b", POINTS, np.zeros(3))
SCALES = Scales(height=(0.0, 2.0), intensity=(1.0, 4.0), age=(0.0, 0.1))


def brightness(cloud, colouring):
    return shades(cloud, colouring, SCALES, index=2, newest=0.1).astype(int).sum(axis=1)


def test_sensors_have_the_colours_of_all_pictures():
    assert {bytes(row).hex() for row in shades(CLOUD, "sensor", SCALES, index=2, newest=0.1)} == {sensor_colour(2)[1:]}


def test_what_is_higher_brighter_or_older_is_lighter():
    height = brightness(CLOUD, "height")
    assert height[0] < height[1] < height[2] == height[3]  # beyond the scale
    assert (np.diff(brightness(CLOUD, "intensity")) < 0).all()
    assert np.argsort(brightness(CLOUD, "age")).tolist() == [1, 2, 3, 0]
    assert shades(CLOUD, "height", SCALES, index=0, newest=0.0)[0].tolist() == [68, 1, 84]


@pytest.mark.parametrize("colouring", ["intensity", "age"])
def test_points_without_what_is_asked_are_grey(colouring):
    assert shades(BARE, colouring, SCALES, index=0, newest=0.0).tolist() == [list(UNKNOWN_SHADE)] * 4


def test_scales_span_nearly_all_points():
    sample = DrawnSample("s", 0.0, (CLOUD, BARE), {}, {})
    assert newest_of(sample) == 0.1
    scales = Scales.of(sample)
    assert scales.height == pytest.approx(tuple(np.percentile([0, 1, 2, 9] * 2, (2, 98))))
    assert scales.intensity == pytest.approx((1.06, 3.94))
    assert scales.age == pytest.approx(tuple(np.percentile([0.1, 0, 0.05, 0.08], (2, 98))))
    assert Scales.of(DrawnSample("none", 0.0, (), {}, {})) == Scales()
    assert newest_of(DrawnSample("bare", 0.0, (BARE,), {}, {})) == 0.0


def test_a_scale_without_length_has_colours_still():
    flat = Scales(height=(1.0, 1.0))
    assert shades(CLOUD, "height", flat, index=0, newest=0.0).shape == (4, 3)


def test_scales_say_what_they_are_of():
    said = [SCALES.described(colouring) for colouring in ("sensor", "height", "intensity", "age")]
    assert said == ["sensor", "height, 0 to 2 m", "intensity, 1 to 4", "age, 0 to 0.1 s"]
