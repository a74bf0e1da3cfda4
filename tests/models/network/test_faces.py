"""Faces of boxes with known points: what is counted, what is moved, and that a face nobody sees
stays."""

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig
from models.detector import VoxelNetDetector
from models.network import faces, voxelnet
from models.training.second_stage import rebuild
from toolkit.boxes import corners
from toolkit.objects import CYCLIST, HEAVY, VEHICLE, Detections

OWN = faces.BIN_COUNT * faces.ZONES
BOX = np.array([[3.0, -2.0, 0.8, 4.0, 2.0, 1.6, 0.0]])  # from x = 1 to 5, y = -3 to -1, top at 1.6
CAR = np.array([VEHICLE])


def counts(row, zone):
    """The number of points in each step of a zone, from a row of features."""
    return np.expm1(row[zone * faces.BIN_COUNT : (zone + 1) * faces.BIN_COUNT]).round(4)


def turned(points, boxes, yaw, shift=(7.0, 3.0, 0.2)):
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    boxes = boxes.copy()
    boxes[:, :3] = boxes[:, :3] @ turn.T + shift
    boxes[:, 6] += yaw
    return points @ turn.T + shift, boxes


@pytest.mark.parametrize("yaw", [0.0, 1.1, np.pi, -2.5])
def test_points_are_counted_by_their_distance_beyond_each_face(yaw):
    points = np.array(
        [
            [5.09, -2.0, 0.3],  # 9 cm before the front, low
            [5.09, -2.0, 0.7],  # in the middle
            [0.71, -2.5, 1.3],  # 29 cm behind the rear, high
            [3.0, -0.85, 0.5],  # 15 cm left of the left side, low
            [4.0, -3.09, 1.2],  # 9 cm right of the right side, high and ahead
            [2.0, -3.17, 1.2],  # 17 cm right of it, high and behind
            [2.1, -2.0, 1.71],  # 11 cm above the top, behind
        ]
    )
    points, boxes = turned(points, BOX, yaw)
    seen = faces.face_features(points, boxes, CAR)
    front, rear = seen.end
    left, right = seen.side
    for row, zone, distance in (
        *(
            (front, 0, 0.09),
            (front, 1, 0.09),
            (rear, 2, 0.29),
            (left, 0, 0.15),
            (right, 2, 0.09),
            (right, 1, 0.17),
        ),
        (seen.top[0], 0, 0.11),
    ):
        step = int(np.floor((distance - faces.FIRST_BIN_M) / faces.BIN_M))
        assert counts(row, zone)[step] == 1, (zone, distance)
    np.testing.assert_array_equal(front[OWN : 2 * OWN], rear[:OWN])  # each sees the one opposite
    np.testing.assert_array_equal(right[OWN : 2 * OWN], left[:OWN])


def test_only_points_about_a_face_count_beside_what_is_known_of_the_box():
    aside = np.array(
        [[5.09, -4.2, 0.8], [5.09, -2.0, 0.15], [5.09, -2.0, 9.0], [9.0, -2.0, 0.8], [np.nan, 0, 0]]
    )
    seen = faces.face_features(aside, BOX, CAR)
    assert [int(total.sum()) for total in seen.counted] == [0, 0, 0]
    assert np.expm1(seen.end[:, : 2 * OWN]).sum() == 0
    # 9 cm beside the box is still its front, 11 cm not
    near = np.array([[5.09, -3.09, 0.8], [5.09, -3.11, 0.8]])
    assert faces.face_features(near, BOX, CAR).counted[0].tolist() == [1, 1]
    seen = faces.face_features(np.zeros((0, 3)), BOX, np.array([HEAVY]))
    expected = [0, 0, *np.log(np.array([4.0, 2.0, 1.6]) / [4.5, 1.8, 1.6]), 0, 0, 0, 1]
    for rows in seen[:3]:
        np.testing.assert_allclose(rows[:, -9:], np.tile(expected, (len(rows), 1)), atol=1e-7)
    assert [rows.shape for rows in seen[:3]] == [(2, 2 * OWN + 9), (2, 2 * OWN + 9), (1, OWN + 9)]
    points = np.random.default_rng(0).uniform((-5, -8, 0), (12, 5, 3), (4000, 3)).astype(np.float32)
    boxes = BOX + np.array(
        [[0.0] * 7, [4.0, 1.0, 0.1, 0.5, -0.3, 0.2, 0.7], [-4.0, 0, 0, 0, 0, 0, 2.0]]
    )
    labels = np.array([VEHICLE, CYCLIST, HEAVY])
    together = faces.face_features(points, boxes, labels)
    for row in range(3):
        alone = faces.face_features(points, boxes[row : row + 1], labels[row : row + 1])
        np.testing.assert_array_equal(together.end[[row, row + 3]], alone.end)
        np.testing.assert_array_equal(together.side[[row, row + 3]], alone.side)
        np.testing.assert_array_equal(together.top[[row]], alone.top)


@pytest.mark.parametrize(
    ("distance", "step"),
    [(-0.59, 0), (-0.55, 1), (0.01, 15), (0.51, 27), (0.53, None), (-0.61, None)],
)
def test_counts_reach_from_60_cm_inside_to_52_cm_beyond_a_face(distance, step):
    front = faces.face_features(np.array([[5.0 + distance, -2.0, 0.8]]), BOX, CAR).end[0]
    expected = np.zeros(28)
    if step is not None:
        expected[step] = 1
    np.testing.assert_array_equal(counts(front, 1), expected)


@pytest.mark.parametrize("seed", range(5))
def test_moved_by_its_offsets_a_box_is_the_truth(seed):
    rng = np.random.default_rng(seed)
    truths = np.column_stack(
        [rng.normal(0, 9, (9, 3)), rng.uniform(1, 5, (9, 3)), rng.uniform(-4, 4, 9)]
    )
    boxes = truths + np.column_stack([rng.normal(0, 0.2, (9, 6)), np.zeros(9)])
    boxes[:, 2] = truths[:, 2] - truths[:, 5] / 2 + boxes[:, 5] / 2  # on the same floor
    boxes[::2, 6] += np.pi  # the other way round, of the same place
    result = faces.move_faces(boxes, *faces.face_offsets(boxes, truths))
    np.testing.assert_allclose(result[:, :6], truths[:, :6], atol=1e-9)
    np.testing.assert_array_equal(result[:, 6], boxes[:, 6])


def test_faces_move_outwards_and_a_batch_is_its_items():
    box = faces.move_faces(BOX, np.array([0.3, -0.1]), np.array([0.2, 0.05]), np.array([-0.4]))[0]
    low, high = corners(box[None])[0].min(axis=0), corners(box[None])[0].max(axis=0)
    np.testing.assert_allclose(low, [1.1, -3.05, 0.0], atol=1e-12)
    np.testing.assert_allclose(high, [5.3, -0.8, 1.2], atol=1e-12)
    box = faces.move_faces(BOX, np.array([-3.0, -3.0]), np.array([-2.0, -2.0]), np.array([-5.0]))[0]
    np.testing.assert_allclose(box[3:6], 0.2 * BOX[0, 3:6])
    clouds = [
        np.random.default_rng(k).uniform((-9, -9, -1), (9, 9, 4), (count, 3)).astype(np.float32)
        for k, count in ((1, 3000), (2, 400))
    ]
    staged, plain = (
        VoxelNetDetector(rebuild(network(), faces=("vehicle",))),
        VoxelNetDetector(network()),
    )
    for together, alone, before in zip(
        staged.batch(clouds), map(staged, clouds), map(plain, clouds), strict=True
    ):
        np.testing.assert_allclose(together.boxes, alone.boxes, atol=1e-4)
        np.testing.assert_allclose(alone.scores, before.scores, atol=1e-6)
        assert np.abs(alone.boxes - before.boxes).max() > 0.01
        np.testing.assert_allclose(alone.boxes[:, 6], before.boxes[:, 6], atol=1e-6)


class Known(faces.FaceNetworks):
    """Answers the same shift for every face, with a mean error of 2 cm."""

    def answers(self, sort, features):
        return torch.full((len(features),), 0.25), torch.full((len(features),), float(np.log(0.02)))


def cloud_at_the_front(count):
    return np.column_stack(
        [np.full(count, 5.1), np.linspace(-2.5, -1.5, count), np.full(count, 0.8)]
    )


def test_faces_move_where_sure_and_untrained_networks_stay_finite():
    known = Known()
    found = Detections(BOX, np.array([0.9]), CAR)
    known.prior[:] = 0.05
    seen = faces.measure_faces(known, found, cloud_at_the_front(3), ("vehicle",))
    # its ends; no side, no top
    np.testing.assert_allclose(seen.boxes[0], [3.0, -2.0, 0.8, 4.5, 2.0, 1.6, 0.0])
    np.testing.assert_array_equal(
        faces.measure_faces(known, found, cloud_at_the_front(2), ("vehicle",)).boxes, BOX
    )
    np.testing.assert_array_equal(
        faces.measure_faces(known, found, cloud_at_the_front(50), ("heavy",)).boxes, BOX
    )
    known.prior[:] = 0.019
    np.testing.assert_array_equal(
        faces.measure_faces(known, found, cloud_at_the_front(50), ("vehicle",)).boxes, BOX
    )
    assert (
        len(faces.measure_faces(known, Detections.empty(), cloud_at_the_front(5), ("vehicle",)))
        == 0
    )
    torch.manual_seed(0)
    networks = faces.FaceNetworks()
    shifts = networks.measure(faces.face_features(cloud_at_the_front(9), BOX, CAR)).shifts
    assert [len(each) for each in shifts] == [2, 2, 1]
    assert all(np.isfinite(each).all() for each in shifts)
    assert [name for name, _ in networks.named_children()] == list(faces.SORTS)


def network():
    torch.manual_seed(0)
    made = voxelnet.VoxelNet(VoxelNetConfig.light((-8, -8, 8, 8))).eval()
    torch.nn.init.normal_(made.head.classes.bias, 0.0, 0.1)
    return made
