"""What stands in most frames is left out; what moves, waits or is seen by a moving sensor is
not."""

from itertools import product

import numpy as np
import pytest

from toolkit.calibration.place import Place
from toolkit.detection.detect import detect_frames
from toolkit.detection.standing import learn_standing_scene
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, pose, transform
from toolkit.objects import PEDESTRIAN, VEHICLE, Detections, Objects

POST, CAR_M = (8.0, 6.0), 1.5


def block(rng, low, high, count):
    return rng.uniform(low, high, (count, 3))


def world_points(k, rng, *, waits=False):
    """Ground, a wall, a post at (8, 6), and a car that drives along y = 0, or waits."""
    still = np.random.default_rng(99)
    ground = np.column_stack([still.uniform(-30, 30, (6000, 2)), np.zeros(6000)])
    wall = np.column_stack(
        [still.uniform(-30, 30, 3000), np.full(3000, 12.0), still.uniform(0, 4, 3000)]
    )
    hut = block(still, [-22, -20, 0], [-12, -12, 3], 2000)
    post = block(still, [POST[0] - 0.1, POST[1] - 0.1, 0], [POST[0] + 0.1, POST[1] + 0.1, 1.8], 60)
    still_points = np.concatenate([ground, wall, hut, post])
    still_points += rng.normal(0, 0.01, still_points.shape)
    x = 10.0 if waits else -20.0 + 3 * k
    car = block(still if waits else rng, [x - 2, -1, 0.2], [x + 2, 1, CAR_M], 300)
    return np.concatenate([still_points, car]), x


def frames(
    world_SE3_lidar=lambda k: pose(0.0, 0.0, 4.0),
    *,
    seen_from=None,
    count=12,
    step_s=0.5,
    waits=False,
):
    made = []
    for k in range(count):
        rng = np.random.default_rng(k)
        points, _ = world_points(k, rng, waits=waits)
        place = world_SE3_lidar(k)
        true = place if seen_from is None else seen_from(k)
        cloud = SensorCloud("lidar", transform(invert(true), points).astype(np.float32), place)
        made.append(Frame.of_clouds(str(k), (cloud,), Objects.empty(), time=step_s * k))
    return made


class Both:
    """Find the post as a pedestrian, and the car where it is."""

    def __init__(self, score=0.9, *, waits=False):
        self.number, self.score, self.waits = 0, score, waits

    def __call__(self, points):
        x = 10.0 if self.waits else -20.0 + 3 * self.number
        self.number += 1
        boxes = np.array([[*POST, 0.9, 0.6, 0.6, 1.8, 0.0], [x, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]])
        return Detections(boxes, np.array([0.4, self.score]), np.array([PEDESTRIAN, VEHICLE]))


def test_a_post_is_left_out_and_a_car_that_drives_is_not():
    seen = frames()
    scene = learn_standing_scene(seen)
    assert scene is not None
    found = list(detect_frames(seen, Both(), Place("none"), scene))
    assert [each.detections.labels.tolist() for each in found] == [[VEHICLE]] * len(seen)
    assert [each.left_out for each in found] == [1] * len(seen)
    assert "most of the 12 frames is background: 7 detections are left out" in scene.describe(7)
    bare = list(detect_frames(seen, Both(), Place("none")))
    assert [len(each.detections) for each in bare] == [2] * len(seen)


@pytest.mark.parametrize(
    ("score", "step_s", "kept"), [(0.9, 0.5, 1), (0.3, 0.5, 0), (0.9, 10.0, 0)]
)
def test_a_sure_vehicle_may_wait_in_a_short_recording(score, step_s, kept):
    seen = frames(waits=True, step_s=step_s)
    scene = learn_standing_scene(seen)
    found = list(detect_frames(seen, Both(score, waits=True), Place("none"), scene))
    assert {len(each.detections) for each in found} == {kept}


def test_a_scene_reaches_one_voxel_over_each_face():
    """Noise puts a point near a face into the next voxel, 0.25 m wide."""
    points = np.array([[0, 0, 0], [0, 0, 5], [0, 0, 10]], np.float32)
    cloud = SensorCloud("lidar", points, np.eye(4))
    seen = [Frame.of_clouds(str(k), (cloud,), Objects.empty(), time=10.0 * k) for k in range(10)]
    scene = learn_standing_scene(seen)
    # a voxel has a corner at the median of the points, so the highest point is at one as well
    middle = np.array([0.125, 0.125, 10.125])
    steps = np.array(list(product((-1, 0, 1), repeat=3)))
    step_count = np.abs(steps).sum(axis=1)
    assert scene.holds(middle + 0.25 * steps).tolist() == (step_count <= 1).tolist()
    assert not scene.holds(middle + 0.5 * steps[step_count == 1]).any()


def test_moving_and_turning_sensors_and_few_frames_have_no_scene():
    assert learn_standing_scene(frames(count=9)) is None
    assert learn_standing_scene(frames(lambda k: pose(0.7 * k, 0.0, 4.0))) is None
    assert learn_standing_scene(frames(lambda k: pose(0.0, 0.0, 4.0, yaw=0.1 * k))) is None
    # in the sensor's own frame, its pose unknown
    driven = frames(seen_from=lambda k: pose(3.0 * k, 0.8 * k, 4.0))
    assert learn_standing_scene(driven) is None
    turned = frames(seen_from=lambda k: pose(0.0, 0.0, 4.0, yaw=0.5 * k))
    assert learn_standing_scene(turned) is None
    assert learn_standing_scene([]) is None
