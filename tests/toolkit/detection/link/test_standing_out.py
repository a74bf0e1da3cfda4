"""What a sensor sends of an image: what stands out, and where nothing is of what the scene has."""

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.link.standing_out import drawn_scene, standing_out
from toolkit.detection.view import Captured
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.spinning_lidar import SpinningLidar

AREA = (-30.0, -30.0, 30.0, 30.0)
CAMERA = Sensor("c", DepthCamera(width=80, height=60), look((0.0, 0.0, 5.0), 0.0, 0.5))
LIDAR = Sensor("l", SpinningLidar(channels=30, azimuth_step=0.1, fov_up=-0.2, fov_down=-0.8), pose(0.0, 0.0, 5.0))


def ground(sensor):
    """Flat ground at 0.5 m, of which a little lies beyond the area."""
    down = sensor.world_rays[2].reshape(sensor.model.shape)
    with np.errstate(divide="ignore"):
        measured = (0.5 - sensor.position[2]) / down
    return np.where((down < 0) & (measured < 60), measured, 0).astype(np.float32)


def out_of(image, sensor=CAMERA, scene=None):
    captured = Captured(Frame((sensor,), (image,), Objects.empty()), 0, AREA)
    scene = EmptyScene.of(sensor, ground(sensor)) if scene is None else scene
    return standing_out(captured, scene), drawn_scene(captured, scene).pixels


def test_the_scene_itself_sends_nothing():
    out, drawn = out_of(ground(CAMERA))
    assert (len(out.pixels), out.missing.sum()) == (0, 0)
    assert len(drawn) > 500


@pytest.mark.parametrize("sensor", [CAMERA, LIDAR], ids=lambda sensor: sensor.name)
def test_a_blinded_sensor_misses_all_that_would_be_drawn(sensor):
    out, drawn = out_of(np.zeros(sensor.model.shape, np.float32), sensor)
    np.testing.assert_array_equal(np.flatnonzero(out.missing), drawn)
    assert not len(out.pixels)


def test_what_stands_close_before_the_sensor_outside_the_crop_hides_the_scene():
    out, drawn = out_of(np.full(CAMERA.model.shape, 0.3, np.float32))
    np.testing.assert_array_equal(np.flatnonzero(out.missing), drawn)
    assert not len(out.pixels)


def test_a_partly_blinded_sensor_misses_that_part_and_sends_what_stands_in_the_other():
    image = ground(CAMERA)
    image[:, :20] = 0
    image[15:20, 30:35] = 4.0
    out, drawn = out_of(image)
    expected = drawn[drawn % 40 < 20]
    np.testing.assert_array_equal(np.flatnonzero(out.missing), expected)
    np.testing.assert_array_equal(out.pixels, np.flatnonzero(image.ravel() == 4.0))


@pytest.mark.parametrize(("share", "sent"), [(0.05, 0.01), (0.9, 0.85)])
def test_drop_outs_here_and_there_are_drawn(share, sent):
    image = ground(CAMERA)
    dropped = (np.random.default_rng(0).random(image.shape) < share) & (image > 0)
    out, drawn = out_of(np.where(dropped, 0, image).astype(np.float32))
    among = np.isin(np.flatnonzero(dropped), drawn).sum()
    assert (out.missing & ~dropped).sum() == 0
    if share < 0.5:
        assert out.missing.sum() < sent * among
    else:
        assert out.missing.sum() > sent * among


@pytest.mark.parametrize(("rows", "columns", "missing"), [(1, 1, 0), (1, 2, 0), (2, 2, 0), (3, 4, 0), (4, 4, 16)])
def test_half_of_the_pixels_about_must_be_missing(rows, columns, missing):
    """Of 25 about the middle of 4 x 4 they are 16, about its corners 9; of 3 x 4 they are 12 of 25 at most."""
    image = ground(CAMERA)
    image[20 : 20 + rows, 15 : 15 + columns] = 0
    out, _ = out_of(image)
    assert out.missing.sum() == (0 if not missing else 4)
    assert not missing or out.missing[21:23, 16:18].all()


def test_where_nothing_may_return_nothing_is_missed_unless_all_about_is():
    """The scene of a pixel whose second mode is nothing: alone it shows the scene, in a blinded part it is missing."""
    scene = EmptyScene.of(CAMERA, ground(CAMERA))
    second = np.full(scene.first.shape, np.nan, np.float32)
    second[15:25, 10:20] = 0
    scene = EmptyScene(**{**{name: getattr(scene, name) for name in scene.__dataclass_fields__}, "second": second})
    image = ground(CAMERA)
    image[15:25, 10:20] = 0
    assert not out_of(image, scene=scene)[0].missing.any()
    image[10:30, 8:22] = 0
    missing = out_of(image, scene=scene)[0].missing
    assert missing[11:15, 9:21].all()
    assert missing[15, 10]
    assert not missing[20, 15]
    nothing, drawn = out_of(np.zeros_like(image), scene=scene)
    np.testing.assert_array_equal(np.flatnonzero(nothing.missing), drawn)


def test_sky_is_not_missed():
    image = ground(CAMERA)
    assert (image[:3] == 0).all()
    assert not out_of(np.zeros_like(image))[0].missing[:3].any()
