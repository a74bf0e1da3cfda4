"""Clouds as images send what the images they were made of send, and the centre has the same points of them."""

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.ground import Ground
from toolkit.calibration.samples.sample_scenes import SampleScenes
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.samples.imaged import ImagedClouds
from toolkit.detection.samples.views import sample_view
from toolkit.detection.schemes import SCHEMES
from toolkit.detection.view import frame_view
from toolkit.frame import Frame
from toolkit.geometry import invert, pose, transform
from toolkit.objects import Detections, Objects
from toolkit.points import unproject
from toolkit.sensors.row_lidar import RowLidar
from toolkit.sensors.sensor import Sensor

AREA = np.array([-30.0, -30, 30, 30])
MODEL = RowLidar(tuple(np.deg2rad(np.linspace(-5, -40, 20))), columns=180)
SENSORS = (Sensor("a", MODEL, pose(-8.0, 0.0, 5.0, yaw=0.3)), Sensor("b", MODEL, pose(8.0, 1.0, 4.0, yaw=2.0)))
FLOOR = 0.05  # m that the ground lies above zero, so that the crop keeps it


def empty(sensor):
    """Flat ground, to the millimetre as float32 has it."""
    down = -sensor.model.rays()[..., 2].astype(np.float64)
    return ((sensor.pose[2, 3] - FLOOR) / down).astype(np.float32)


def occupied(sensor):
    """Somebody in 5 x 8 pixels, a metre before the ground."""
    image = empty(sensor)
    image[6:11, 40:48] -= 1.0
    image[15, 100] = 0  # nothing returned
    return image


FRAME = Frame(SENSORS, tuple(occupied(sensor) for sensor in SENSORS), Objects.empty(), 2.5, 3)
SCENES = tuple(EmptyScene.of(sensor, empty(sensor)) for sensor in SENSORS)


class Seen:
    """Keeps the points it is shown."""

    def __init__(self):
        self.points = []

    def __call__(self, points):
        self.points.append(points)
        return Detections(np.array([[0.0, 0, 1, 4, 2, 1.5, 0]]), np.array([0.5]))


def sample(height=0.0, order=None):
    """The clouds of the frame, in a world whose origin is `height` below."""
    clouds = []
    for sensor, image in zip(FRAME.sensors, FRAME.measurements, strict=True):
        xyz, valid = unproject(sensor, image)
        own = transform(invert(sensor.pose), xyz.T[valid].astype(np.float64)).astype(np.float32)
        rows = np.random.default_rng(0).permutation(len(own)) if order is None else order
        clouds.append(SensorCloud(sensor.name, own[rows], pose(z=height) @ sensor.pose))
    return Sample("3", tuple(clouds), Objects.empty(), time=2.5)


def given():
    return SampleScenes(lambda: iter(()), SCENES)


def by_place(points):
    return points[np.lexsort(points.T.round(3))]


@pytest.mark.parametrize("name", ["foreground", "adaptive", "early", "late"])
def test_schemes_send_and_detect_as_on_a_frame_of_images(name):
    scheme, codec, ours, theirs = SCHEMES[name], RangeImages(), Seen(), Seen()
    view = sample_view(sample(), ours, None, np.zeros(2), AREA, codec=codec, scenes=given(), number=3)
    of_frame = frame_view(FRAME, theirs, AREA, height=4.0, codec=codec, scene=lambda k: SCENES[k])
    mine, theirs_fused = scheme.fuse(view, [0, 1]), scheme.fuse(of_frame, [0, 1])
    np.testing.assert_allclose(mine.bits, theirs_fused.bits, atol=16 if name in ("early", "foreground") else 400)
    assert len(ours.points) == len(theirs.points)
    for own, other in zip(ours.points, theirs.points, strict=True):
        assert own.dtype == np.float32
        np.testing.assert_allclose(by_place(own), by_place(other), atol=0.025)


def test_foreground_is_a_fraction_of_the_image_and_brings_all_of_it():
    seen = Seen()
    view = sample_view(sample(), seen, None, np.zeros(2), AREA, scenes=given())
    fused = Foreground().fuse(view, [0, 1])
    whole = SCHEMES["early"].fuse(
        sample_view(sample(), Seen(), None, np.zeros(2), AREA, codec=RangeImages(), scenes=given()), [0, 1]
    )
    assert (fused.bits < whole.bits / 2).all()
    pixels = sum(int((view.captured(k).measurement > 0).sum()) for k in (0, 1))
    inside = sum(len(view.cloud(k).points) for k in (0, 1))
    assert inside <= pixels
    assert len(seen.points[0]) >= inside


def test_level_ground_is_below_what_the_centre_draws():
    ground, seen = Ground(np.array([0.0, 0.0, 100.0])), Seen()
    view = sample_view(sample(height=100.0), seen, ground, np.zeros(2), AREA, scenes=given())
    Foreground().fuse(view, [0, 1])
    upright = Seen()
    Foreground().fuse(sample_view(sample(), upright, None, np.zeros(2), AREA, scenes=given()), [0, 1])
    assert len(seen.points[0]) == pytest.approx(len(upright.points[0]), abs=3)
    heights = seen.points[0][:, 2]
    assert np.median(heights) == pytest.approx(FLOOR, abs=0.005)
    assert heights.max() < 4


def test_points_that_share_a_pixel_stay_where_they_were_measured():
    behind = sample()
    cloud = behind.clouds[0]
    doubled = np.concatenate([cloud.points, 1.01 * cloud.points[:7]]).astype(np.float32)
    behind = Sample("3", (SensorCloud("a", doubled, cloud.world_SE3_sensor),), Objects.empty())
    imaged = ImagedClouds(behind, given(), None, np.zeros(2), AREA, height=4.0, number=9)
    points, captured = imaged.measure(0), imaged.capture(0)
    assert len(points) == len(captured.pixels) == len(np.unique(captured.pixels))
    assert (captured.frame.time, captured.frame.index) == (0.0, 9)
    assert imaged.measure(0) is points
    assert imaged.scene(0) is SCENES[0]
    assert imaged.model(0) == MODEL
    np.testing.assert_allclose(captured.points(captured.sending(captured.pixels).measurement),
                               points[np.argsort(captured.pixels)], atol=1e-4)  # fmt: skip
