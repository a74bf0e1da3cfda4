import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.datasets import published_layout as published
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera

MAPS = (np.eye(4), pose(104.0, -196.0, yaw=np.pi / 2), pose(-3.0, 5.0, 0.2, yaw=-2.0))
angles = st.floats(-np.pi, np.pi)


@settings(max_examples=50, deadline=None)
@given(st.sampled_from(MAPS), angles, st.floats(-1.5, 1.5), st.tuples(*[st.floats(-100, 100)] * 3))
def test_extrinsic_and_back(map_SE3_site, heading, tilt, position):
    site_SE3_sensor = look(position, heading, tilt)
    there = published.extrinsic(site_SE3_sensor, map_SE3_site)
    assert np.isclose(np.linalg.det(there), 1)
    assert np.allclose(published.parse_extrinsic(there, map_SE3_site), site_SE3_sensor, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.sampled_from(MAPS), st.lists(st.tuples(*[st.floats(-50, 50)] * 3, angles), max_size=4))
def test_objects_and_back(map_SE3_site, places):
    boxes = np.array([[x, y, z, 4.0, 2.0, 1.5, yaw] for x, y, z, yaw in places]).reshape(-1, 7)
    objects = Objects(boxes, np.arange(len(boxes)), np.arange(len(boxes)) + 7)
    back = published.parse_rows(
        published.format_objects(objects, map_SE3_site), map_SE3_site, objects.ids
    )
    assert np.allclose(back.boxes[:, :6], boxes[:, :6], atol=1e-9)
    assert np.allclose(np.exp(1j * back.boxes[:, 6]), np.exp(1j * boxes[:, 6]))
    assert back.labels.tolist() == objects.labels.tolist()
    assert back.ids.tolist() == objects.ids.tolist()


def test_cameras_look_along_the_axes_of_carla():
    """On an unturned map a camera at (1, 2, 5) that looks north (+y) looks along -y in CARLA, its
    right is +x."""
    matrix = published.extrinsic(look((1.0, 2.0, 5.0), np.pi / 2), np.eye(4))
    ahead, right, above = np.array(
        [[1, -2 - 7, 5, 1], [1 + 3, -2 - 7, 5, 1], [1, -2 - 7, 5 + 2, 1]]
    ).T.T
    assert np.allclose(matrix @ ahead, [7, 0, 0, 1])
    assert np.allclose(matrix @ right, [7, 3, 0, 1])
    assert np.allclose(matrix @ above, [7, 0, 2, 1])


def test_boxes_are_mirrored_into_carla_coordinates():
    rows = published.format_objects(
        Objects(np.array([[1, 2, 0.75, 4, 2, 1.5, np.deg2rad(30)]]), np.array([1])), np.eye(4)
    )
    assert np.allclose(rows, [[1, -2, 0.75, 0, 0, -30, 2, 1, 0.75, 1]])


def test_intrinsics_come_back():
    camera = DepthCamera(width=320, height=200, fov=1.2, centre=(150.0, 99.5))
    back = published.parse_intrinsic(published.intrinsic(camera), 200, 320)
    assert back.centre == (150.0, 99.5)
    assert back.fov == pytest.approx(1.2)


def test_images_are_expanded_and_measured_again():
    camera = DepthCamera(width=8, height=6)
    depth = np.zeros(camera.shape, np.float32)
    depth[0] = [1.5, 999.0, np.inf, np.nan]
    image = published.expand_image(depth, camera)
    assert image.shape == (6, 8)
    assert image[0].tolist() == [1.5, 0, 999, 0, 1000, 0, 1000, 0]
    first, nothing = published.measure_images([(image, 2), (np.full((6, 8), np.nan), 2)])
    assert first[0].tolist() == [1.5, 999, 0, 0]
    assert nothing.tolist() == np.zeros((3, 4)).tolist()


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        *(
            (np.full((4, 4), np.nan), "NaN"),
            (np.zeros((4, 4)), "singular"),
            (np.eye(3), r"shape \(4, 4\)"),
        ),
        *((np.diag([1.0, -1, 1, 1]), "mirrors"), (2 * np.eye(4), "row 0 0 0 1")),
    ],
)
def test_extrinsics_refused(matrix, says):
    with pytest.raises(ValueError, match=says):
        published.parse_extrinsic(matrix, np.eye(4), "cameras/d0/extrinsic")


@pytest.mark.parametrize(
    "matrix",
    [np.eye(4), DepthCamera().intrinsic, np.full((3, 3), np.nan), np.zeros((3, 3)), -np.eye(3)],
)
def test_intrinsics_refused(matrix):
    with pytest.raises(ValueError, match=r"cameras/d0/intrinsic must be"):
        published.parse_intrinsic(matrix, 300, 400, "cameras/d0/intrinsic")


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        *((np.zeros((2, 9)), "10 columns"), (np.zeros(10), "10 columns")),
        *(
            (np.full((1, 10), np.nan), "row 0 holds NaN"),
            ([[0, 0, 0, 0, 0, 0, 1, 1, 1, 7.0]], r"classes 0\.\.3"),
        ),
        ([[0, 0, 0, 0, 0, 0, 1, 1, 1, 0.5]], r"classes 0\.\.3"),
    ],
)
def test_objects_refused(rows, says):
    with pytest.raises(ValueError, match=says):
        published.parse_rows(np.array(rows), np.eye(4))


@pytest.mark.parametrize("rows", [np.zeros((0, 10)), np.zeros(0)])
def test_no_objects(rows):
    assert len(published.parse_rows(rows, np.eye(4))) == 0
