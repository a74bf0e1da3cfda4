import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.clouds import crop, from_depth, from_points, positions
from toolkit.frame import Frame, select_sensors
from toolkit.geometry import level_rows, look, pose, tilt_rows
from toolkit.objects import Detections, Objects, UnionDetector
from toolkit.points import (
    Crop,
    count_on_ground,
    crop_image,
    detect_on_ground,
    detect_unions_on_ground,
    frame_points,
    get_slope,
    has_centre_inside,
    is_beyond,
    is_inside,
)
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site

AREA = (-40, -20, 40, 20)
SENSORS = (
    Sensor("a", DepthCamera(), look((30.0, 8.0, 5.2), heading=2.7, tilt=0.1)),
    Sensor("b", DepthCamera(width=64, height=48), look((-7.0, -12.0, 5.2), heading=1.1, tilt=0.3)),
    Sensor("c", SpinningLidar(channels=16), pose(0.0, 0.0, 4.0, pitch=0.1)),
)


def frame():
    rng = np.random.default_rng(0)
    depths = [rng.uniform(0, 60, sensor.model.shape).astype(np.float32) for sensor in SENSORS]
    depths[0][:20] = np.nan
    depths[1][:5] = np.inf
    return Frame(SENSORS, tuple(depths), Objects.empty())


def test_frame_points_are_cropped_clouds_with_noise_of_the_generator():
    scene = frame()
    for points, sensor, depth in zip(
        frame_points(scene, area=AREA), SENSORS, scene.measurements, strict=True
    ):
        expected = positions(crop(from_depth(sensor, depth), AREA))
        assert len(expected) > 50
        assert points.dtype == np.float32
        assert points.flags.c_contiguous
        np.testing.assert_array_equal(points, expected)
    scene = frame()
    first, again, clean = (
        frame_points(scene, area=AREA, rng=rng)
        for rng in (*map(np.random.default_rng, (5, 5)), None)
    )
    for a, b, c in zip(first, again, clean, strict=True):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)
    scene = frame()
    for k, points in enumerate(frame_points(scene, area=AREA, height=3.0)):
        pixels = crop_image(scene.sensors[k], scene.images[k], Crop.from_place(AREA, 3.0))[1]
        sensor, measured = scene.sensors[k], scene.measurements[k].ravel()[pixels, None]
        np.testing.assert_allclose(
            sensor.world_rays[:, pixels].T * measured + sensor.position, points, atol=1e-4
        )
        assert (np.diff(pixels) > 0).all()


@pytest.mark.parametrize("unknown", [3, -1, "d", "0"])
def test_unknown_sensors_are_named(unknown):
    with pytest.raises(ValueError, match=r"choose among 0\.\.2 or a, b, c"):
        select_sensors(SENSORS, [unknown])


def test_points_move_and_areas_near_by_count():
    scene, shift = frame(), np.array([256.0, -128.0, 0.0])
    moved = tuple(Sensor(s.name, s.model, pose(*shift) @ s.pose) for s in SENSORS)
    area = np.array(AREA) + np.tile(shift[:2], 2)
    for here, there in zip(
        frame_points(scene, area=AREA),
        frame_points(Frame(moved, scene.measurements, scene.objects), area=area),
        strict=True,
    ):
        np.testing.assert_allclose(there, here + shift, atol=1e-4)
    boxes = np.array([[40, 20, 99, 4, 2, 1.5, 0], [40.1, 0, 1, 4, 2, 1.5, 0]])
    assert has_centre_inside(boxes, np.array(AREA, np.float64)).tolist() == [True, False]
    points = np.array([[3.0, 4.0, 9.0], [3.0, 4.001, 0.0], [0.0, -5.0, 0.0]])
    for metric in ("horizontal", "published"):
        level = is_beyond(
            points * [1, 1, 0],
            np.eye(4)[[0, 2, 1, 3]] if metric == "published" else np.eye(4),
            5.0,
            metric,
        )
        assert level.tolist() == [False, True, False]
    assert select_sensors(SENSORS) == [0, 1, 2]
    assert select_sensors(SENSORS, ["c", 0]) == [2, 0]
    assert select_sensors(SENSORS, []) == []
    both = frame_points(frame(), ["c", 0], area=AREA)
    alone = frame_points(frame(), area=AREA)
    np.testing.assert_array_equal(both[0], alone[2])
    np.testing.assert_array_equal(both[1], alone[0])
    with pytest.raises(ValueError, match="once only"):
        select_sensors(SENSORS, [0, "a"])
    with pytest.raises(ValueError, match="name of its own"):
        select_sensors((*SENSORS, SENSORS[0]))
    with pytest.raises(ValueError, match="list of numbers or names"):
        select_sensors(SENSORS, "abc")
    far = Sensor("far", DepthCamera(), look((5e5, 5.4e6, 300.0), heading=0.0))
    with pytest.raises(ValueError, match="origin near the site"):
        frame_points(Frame((far,), (np.ones((150, 200), np.float32),), Objects.empty()), area=AREA)
    with pytest.raises(ValueError, match="height must be a number"):
        frame_points(frame(), area=AREA, height=float("nan"))
    with pytest.raises(ValueError, match="height must be a number"):
        crop(from_depth(SENSORS[2], frame().measurements[2]), AREA, float("nan"))
    with pytest.raises(ValueError, match="floor must be a number"):
        crop(from_depth(SENSORS[2], frame().measurements[2]), AREA, floor=float("nan"))


def test_slopes_are_cropped_and_detected_in_as_level_ground():
    slope = (0.06, -0.02)
    steep = Site("steep", np.array([-50.0, -50, 50, 50]), height=3.0, relief=Relief(0.0, 0, slope))
    flat = np.random.default_rng(4).uniform([-45, -45, -1], [45, 45, 5], (400, 3))
    boxes = np.array([[10.0, 5, 1, 20, 30, 2, 0.4], [-20, -20, 1, 25, 25, 2, 1.0]])
    kept = is_inside(flat, steep.area, 3.0)
    world = tilt_rows(flat, slope)
    assert get_slope(steep) == slope
    assert get_slope((0, 0, 1, 1)) == (0.0, 0.0)
    np.testing.assert_array_equal(is_inside(level_rows(world, slope), steep.area, 3.0), kept)
    np.testing.assert_array_equal(
        count_on_ground(world, tilt_rows(boxes, slope), steep), count_points(flat, boxes)
    )
    np.testing.assert_allclose(positions(crop(from_points(world), steep)), world[kept], atol=1e-4)
    given = []

    def detect(points):
        given.append(points)
        return Detections(np.array([[10.0, 20, 1, 4, 2, 1.5, 0.3]]), np.array([0.9]))

    steep = Site("steep", np.array([-50.0, -50, 50, 50]), relief=Relief(0.0, 0, (0.05, -0.02)))
    points = np.array([[10.0, 20, 1.1], [0, 0, 1]], np.float32)
    found = detect_on_ground(detect, points, steep)
    np.testing.assert_allclose(given[0], [[10, 20, 1.0], [0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(found.boxes, [[10.0, 20, 1.1, 4, 2, 1.5, 0.3]])
    assert found.scores.tolist() == [0.9]
    np.testing.assert_allclose(detect_on_ground(detect, points, AREA).boxes[0, 2], 1.0)
    assert given[1] is points


def test_unions_of_clouds_come_back_onto_the_slope():
    given = []

    class Detector:
        def __call__(self, points):
            raise AssertionError

        def unions(self, clouds, unions):
            given.append((clouds, unions))
            return [
                Detections(np.array([[10.0, 20, 1, 4, 2, 1.5, 0.3]]), np.array([0.9])),
                Detections.empty(),
            ]

    assert isinstance(Detector(), UnionDetector)
    assert not isinstance(detect_on_ground, UnionDetector)
    steep = Site("steep", np.array([-50.0, -50, 50, 50]), relief=Relief(0.0, 0, (0.05, -0.02)))
    clouds = [np.array([[10.0, 20, 1.1]], np.float32), np.array([[0, 0, 1]], np.float32)]
    unions = np.array([[True, True], [False, True]])
    first, second = detect_unions_on_ground(Detector(), clouds, unions, steep)
    np.testing.assert_allclose(np.concatenate(given[0][0]), [[10, 20, 1.0], [0, 0, 1]], atol=1e-6)
    np.testing.assert_array_equal(given[0][1], unions)
    np.testing.assert_allclose(first.boxes, [[10.0, 20, 1.1, 4, 2, 1.5, 0.3]])
    assert len(second) == 0
    np.testing.assert_allclose(
        detect_unions_on_ground(Detector(), clouds, unions, AREA)[0].boxes[0, 2], 1.0
    )
    assert given[1][0][0] is clouds[0]
