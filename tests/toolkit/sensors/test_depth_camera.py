"""The pinhole camera: its image, what falls into it, and the windows of boxes. What any model can: `test_model`."""

import numpy as np
import pytest

from toolkit.boxes import corners
from toolkit.geometry import invert, look, transform
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

CAMERA = DepthCamera(width=120, height=90, stride=2)


@pytest.mark.parametrize(
    ("width", "height", "stride", "shape"), [(400, 300, 2, (150, 200)), (41, 30, 3, (10, 14)), (5, 5, 9, (1, 1))]
)
def test_every_stride_th_pixel_is_measured(width, height, stride, shape):
    camera = DepthCamera(width=width, height=height, stride=stride)
    assert camera.shape == shape
    assert camera.rays().shape == (*shape, 3)


def test_a_right_angle_is_as_wide_as_two_focal_lengths():
    camera = DepthCamera(width=200, height=200, fov=np.pi / 2)
    assert camera.intrinsic[0, 0] == pytest.approx(100)
    assert camera.horizontal_fov == pytest.approx(camera.vertical_fov) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("point", "seen"),
    [((0, 0, 10), True), ((9.9, 0, 10), True), ((10.1, 0, 10), False), ((0, 7.4, 10), True), ((0, 7.6, 10), False),
     ((0, 0, -10), False), ((0, 0, 999), True), ((0, 0, 1001), False)],
)  # fmt: skip
def test_what_falls_into_the_image(point, seen):
    assert CAMERA.in_view(np.array([point], float)).tolist() == [seen]


def test_a_principal_point_off_the_middle_moves_the_view():
    camera = DepthCamera(width=120, height=90, centre=(90.0, 45.0))
    assert camera.in_view(np.array([[-14.0, 0, 10], [14.0, 0, 10]])).tolist() == [True, False]


def test_a_window_holds_every_pixel_of_its_box_and_few_others():
    sensor = Sensor("s", CAMERA, look((0.0, 0.0, 5.0), 0.0, 0.2))
    box = corners(np.array([[15.0, 1.0, 0.75, 4.0, 2.0, 1.5, 0.4]]))
    in_sensor = transform(invert(sensor.pose), box)
    ((row, top, bottom, left, right),) = CAMERA.windows(in_sensor)
    pixels = in_sensor[0] @ CAMERA.intrinsic.T
    u, v = pixels[:, 0] / pixels[:, 2] / 2, pixels[:, 1] / pixels[:, 2] / 2
    assert row == 0
    assert left <= u.min() <= left + 1
    assert right - 2 <= u.max() <= right
    assert top <= v.min() <= top + 1
    assert bottom - 2 <= v.max() <= bottom


def test_boxes_behind_it_have_no_window_and_those_around_it_all_of_the_image():
    sensor = Sensor("s", CAMERA, look((0.0, 0.0, 0.0), 0.0))
    boxes = corners(np.array([[-15.0, 0, 0, 4, 2, 1.5, 0], [0, 0, 0, 4, 4, 4, 0]]))
    windows = CAMERA.windows(transform(invert(sensor.pose), boxes))
    assert windows.tolist() == [[1, 0, CAMERA.shape[0], 0, CAMERA.shape[1]]]
