"""Frames hold together; the empty scene is what is seen behind all that moves."""

import numpy as np
import pytest

from toolkit.frame import Frame, empty_scene
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

SMALL = DepthCamera(width=4, height=2, stride=1)
ONE, OTHER = (Sensor(name, SMALL, pose()) for name in ("one", "other"))
IMAGE = np.ones(SMALL.shape, np.float32)


@pytest.mark.parametrize(
    ("sensors", "measurements", "message"),
    [
        ((ONE, OTHER), (IMAGE,), "2 sensors but 1 measurements"),
        ((ONE, OTHER, ONE), (IMAGE,) * 3, r"different names, got \['one', 'other', 'one'\]"),
        ((ONE,), (IMAGE.T,), r"'one' measures \(2, 4\) pixels, got an image of \(4, 2\)"),
    ],
)
def test_what_does_not_fit_is_refused(sensors, measurements, message):
    with pytest.raises(ValueError, match=message):
        Frame(sensors, measurements, Objects.empty())


def test_the_empty_scene_is_the_farthest_return_and_none_counts_as_farthest():
    images = [IMAGE * np.float32(metres) for metres in (3.0, 7.0, 5.0)]
    images[1][0, 0] = 0
    found = empty_scene([Frame((ONE,), (image,), Objects.empty()) for image in images]).images[0]
    assert found[0, 0] == 0
    assert (found.ravel()[1:] == 7).all()
    with pytest.raises(ValueError, match="needs a frame"):
        empty_scene([])
