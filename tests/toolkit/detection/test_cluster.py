import time
from dataclasses import replace

import numpy as np
import pytest

from toolkit.boxes import corners, iou_3d
from toolkit.detection.cluster import ClusterDetector
from toolkit.detection.metrics import evaluate
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Objects

SIGMA = 0.015
CAR = [8.0, -3.0, 0.75, 4.4, 1.9, 1.5, 0.4]


def faces(box, sides=("front", "rear", "left", "right", "top"), step=0.1, rng=None):
    quads = {
        "front": (0, 3, 4),
        "rear": (1, 2, 5),
        "left": (0, 1, 4),
        "right": (3, 2, 7),
        "top": (4, 5, 7),
    }
    corner = corners([box])[0]
    points = []
    for side in sides:
        start, across, up = (corner[k] for k in quads[side])
        counts = [max(2, round(np.linalg.norm(end - start) / step)) for end in (across, up)]
        u, v = np.meshgrid(*(np.linspace(0, 1, k) for k in counts))
        points.append(start + u.reshape(-1, 1) * (across - start) + v.reshape(-1, 1) * (up - start))
    rng = np.random.default_rng(0) if rng is None else rng
    cloud = np.concatenate(points)
    return (cloud + rng.normal(0, SIGMA, cloud.shape)).astype(np.float32)


def street(rng, under=()):
    """An empty street with a wall, 40 x 30 m; what lies `under` boxes is hidden."""
    x, y = np.meshgrid(np.arange(-20, 20, 0.25), np.arange(-15, 15, 0.25))
    ground = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.02)])
    wall = faces([0, 14.0, 1.5, 30, 0.3, 3.0, 0], ("right",), 0.15, rng)
    for box in under:
        cos, sin = np.cos(box[6]), np.sin(box[6])
        dx, dy = ground[:, 0] - box[0], ground[:, 1] - box[1]
        u, v = dx * cos + dy * sin, dy * cos - dx * sin
        ground = ground[(abs(u) > box[3] / 2) | (abs(v) > box[4] / 2)]
    ground = ground + rng.normal(0, SIGMA / 2, ground.shape)
    cloud = np.concatenate([ground, wall])
    return cloud[cloud[:, 2] > 0].astype(np.float32)


@pytest.fixture(scope="module")
def detector():
    return ClusterDetector.learn([street(np.random.default_rng(seed)) for seed in range(3)])


def scene(boxes, sides=None, seed=9, **options):
    rng = np.random.default_rng(seed)
    seen = [
        faces(box, **({} if sides is None else {"sides": sides}), rng=rng, **options)
        for box in boxes
    ]
    return np.concatenate([street(rng, boxes), *seen])


def test_empty_streets_are_empty_and_the_better_seen_scores_higher(detector):
    assert len(detector(street(np.random.default_rng(7)))) == 0
    assert len(detector(np.zeros((0, 3), np.float32))) == 0
    cloud = scene([CAR])
    one, two = detector(cloud), detector(cloud)
    np.testing.assert_array_equal(one.boxes, two.boxes)
    np.testing.assert_array_equal(one.scores, two.scores)
    cloud = scene([CAR])
    bad = np.array([[np.nan, 0, 1], [0, np.inf, 1], [500, 500, 1]], np.float32)
    found = detector(np.concatenate([cloud, bad]))
    np.testing.assert_allclose(found.boxes, detector(cloud).boxes)
    height = detector.background.height(np.array([[0.0, 0.0], [0.0, 13.8], [500.0, 500.0]]))
    np.testing.assert_allclose(height, 0.01, atol=0.02)
    other = [-8.0, 0.0, 0.75, 4.4, 1.9, 1.5, 0.0]
    rng = np.random.default_rng(1)
    cloud = np.concatenate(
        [street(rng, [CAR, other]), faces(CAR, rng=rng), faces(other, ("rear",), 0.3, rng)]
    )
    found = detector(cloud)
    best = iou_3d(found.boxes, [CAR, other]).argmax(axis=0)
    assert found.scores[best[0]] > 2 * found.scores[best[1]]
    assert ((found.scores > 0) & (found.scores <= 1)).all()
    others = [
        *(
            ClusterDetector.learn([street(np.random.default_rng(9))]),
            ClusterDetector(detector.background, fewest=6),
        ),
        ClusterDetector(detector.background, cell=0.25),
    ]
    assert len({detector.digest, *(other.digest for other in others)}) == 4
    assert ClusterDetector(detector.background).digest == detector.digest


@pytest.mark.parametrize("yaw", np.deg2rad([0, 20, 45, 70, 90, 135]))
def test_a_car_seen_all_round(detector, yaw):
    box = np.array([*CAR[:6], yaw])
    found = detector(scene([box]))
    assert found.labels.tolist() == [VEHICLE]
    assert iou_3d(found.boxes, [box])[0, 0] > 0.85


@pytest.mark.parametrize(
    "sides", [("left", "front"), ("rear", "right"), ("left", "top"), ("rear", "top", "left")]
)
def test_a_car_seen_from_a_corner(detector, sides):
    found = detector(scene([CAR], sides))
    assert found.labels.tolist() == [VEHICLE]
    assert iou_3d(found.boxes, [CAR])[0, 0] > 0.7


@pytest.mark.parametrize("sides", [("left",), ("right",)])
def test_a_car_of_which_one_side_is_seen_is_completed_to_where_the_ground_is_hidden(
    detector, sides
):
    found = detector(scene([CAR], sides))
    assert found.labels.tolist() == [VEHICLE]
    assert iou_3d(found.boxes, [CAR])[0, 0] > 0.6


@pytest.mark.parametrize(
    ("size", "label"),
    [
        *(((0.5, 0.6, 1.75), PEDESTRIAN), ((1.8, 0.6, 1.75), CYCLIST), ((4.4, 1.9, 1.5), VEHICLE)),
        *(((5.3, 2.0, 2.0), VEHICLE), ((12.0, 2.5, 3.1), HEAVY), ((7.0, 2.4, 3.0), HEAVY)),
    ],
)
def test_size_tells_the_class(detector, size, label):
    box = [2.0, 1.0, size[2] / 2, *size, 0.7]
    found = detector(scene([box]))
    assert found.labels.tolist() == [label]
    assert iou_3d(found.boxes, [box])[0, 0] > 0.6


def test_neighbours_are_told_apart_quickly(detector):
    row = [[-9.0 + 2.4 * k, -4.0, 0.75, 4.4, 1.9, 1.5, np.pi / 2] for k in range(4)]
    truths = [Objects(np.array(row), np.zeros(4, np.int64))]
    assert evaluate([detector(scene(row))], truths, iou_thresholds=[0.5])[0.5].ap == 1
    cloud = scene([CAR, [-8.0, 0, 0.75, 4.4, 1.9, 1.5, 1.0]])
    found = detector(cloud)
    shuffled = detector(np.random.default_rng(0).permutation(cloud))
    np.testing.assert_allclose(np.sort(shuffled.scores), np.sort(found.scores), atol=0.05)
    assert (iou_3d(shuffled.boxes, found.boxes).max(axis=1) > 0.9).all()

    offset = np.array([512.0, -256, 0], np.float32)
    elsewhere = ClusterDetector.learn(
        [street(np.random.default_rng(seed)) + offset for seed in range(3)]
    )
    moved = elsewhere(cloud + offset)
    assert len(moved) == len(found)
    back = moved.boxes - [*offset, 0, 0, 0, 0]
    assert (iou_3d(back, found.boxes).max(axis=1) > 0.9).all()
    rng = np.random.default_rng(3)
    places = [(x, y) for x in (-15, -8, -1, 6, 13) for y in (-10, -5, 0, 5)]
    cars = [[x, y, 0.75, 4.4, 1.9, 1.5, rng.uniform(-0.5, 0.5)] for x, y in places]
    cloud = scene(cars, step=0.06)
    times = []
    for _ in range(3):
        start = time.thread_time()
        found = detector(cloud)
        times.append(time.thread_time() - start)
    assert (found.labels == VEHICLE).sum() == len(cars)
    assert min(times) < 0.4


@pytest.mark.parametrize("reach", [0.2, 0.4, 0.6])
def test_cells_at_just_the_reach_are_neighbours(reach):
    """Wherever they are: 3 x 0.2 is above 0.6 in float64, and differences of such places on either
    side of it."""
    detector = replace(ClusterDetector.learn(np.zeros((1, 3))), reach=(reach,))
    for start in range(100):
        far = 50.15 + 0.2 * start
        places = np.array([0.05, far, far + reach]).repeat(detector.fewest)
        points = np.column_stack([places, np.zeros((len(places), 2))])
        assert len(detector._find_clusters(points, detector.reach)) == 2
