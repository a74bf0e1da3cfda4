"""Targets on hand-drawn cases."""

import math

import numpy as np
import pytest

from models.config import ROAD_USERS, VoxelNetConfig, road_users
from models.network.anchors import anchors
from models.training.targets import IGNORED, NEGATIVE, POSITIVE, assign, assign_by_kind, sample
from toolkit.boxes import iou_bev
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

GRID = anchors(VoxelNetConfig.light((-8, -8, 8, 8), anchor_size=(4.0, 2.0, 1.6))).double().numpy()
CELL = (20, 20)  # its anchors stand at (0.2, 0.2)


def car(x=0.2, y=0.2, yaw=0.0, length=4.0, width=2.0):
    return np.array([[x, y, 0.8, length, width, 1.6, yaw]])


def test_a_box_on_an_anchor_is_its_target():
    found = assign(GRID, car())
    assert found.labels[(*CELL, 0)] == POSITIVE
    assert found.labels[(*CELL, 1)] == NEGATIVE  # turned by 90° it overlaps by a third
    assert found.labels[0, 0, 0] == NEGATIVE


@pytest.mark.parametrize(("yaw", "fits"), [(0.6, 0), (math.pi, 0), (-math.pi / 2, 1), (2.0, 1), (7.0, 0)])
def test_yaws_snap_to_the_nearer_anchor(yaw, fits):
    labels = assign(GRID, car(yaw=yaw)).labels
    assert labels[(*CELL, fits)] == POSITIVE
    assert labels[(*CELL, 1 - fits)] == NEGATIVE


def test_thresholds_split_positive_ignored_negative():
    found = assign(GRID, car(), positive=0.6, negative=0.4)
    iou = iou_bev(GRID[20, :, 0], car())[:, 0]  # a row of anchors beside one another
    expected = np.where(iou > 0.6, POSITIVE, np.where(iou <= 0.4, NEGATIVE, IGNORED))
    np.testing.assert_array_equal(found.labels[20, :, 0], expected)
    assert set(expected) == {POSITIVE, IGNORED, NEGATIVE}


def test_overlap_equals_exact_iou_where_yaws_are_right_angles():
    boxes = np.concatenate([car(1.3, -2.0), car(-4.0, 3.0, math.pi / 2, 4.6, 1.9)])
    found = assign(GRID, boxes, positive=0.5, negative=0.5, best=2.0)
    iou = iou_bev(GRID.reshape(-1, 7), boxes)
    np.testing.assert_array_equal(found.labels.ravel() == POSITIVE, iou.max(axis=1) > 0.5)
    positive = found.labels.ravel() == POSITIVE
    np.testing.assert_array_equal(found.owner.ravel()[positive], iou.argmax(axis=1)[positive])


def test_every_object_has_an_anchor_however_small():
    found = assign(GRID, car(length=1.2, width=0.9))
    assert (found.labels == POSITIVE).sum() == 1
    assert (assign(GRID, car(length=0.2, width=0.2)).labels == POSITIVE).sum() == 0  # nothing reaches `best`
    assert (assign(GRID, car(x=30.0)).labels == POSITIVE).sum() == 0  # outside the grid
    assert (assign(GRID, np.zeros((0, 7))).labels == NEGATIVE).all()


def test_an_anchor_belongs_to_the_object_it_overlaps_most():
    boxes = np.concatenate([car(0.2, 0.2), car(0.2, 2.6)])
    found = assign(GRID, boxes, positive=0.4)
    owners = found.owner[20, :, 0][found.labels[20, :, 0] == POSITIVE]
    assert sorted(set(owners)) == [0, 1]
    assert (np.diff(owners) >= 0).all()


def test_negatives_on_ignored_objects_do_not_count():
    lorry = car(-3.0, -3.0, 0.5, 6.0, 2.5)
    labels = assign(GRID, car(3.0, 3.0), ignored=lorry).labels
    ignored = GRID[labels == IGNORED]
    assert len(ignored) == pytest.approx(2 * 6.0 * 2.5 / 0.4**2, rel=0.1)
    assert np.hypot(*(ignored[:, :2] - [-3, -3]).T).max() < 3.3
    positive = assign(GRID, car(), ignored=car(length=9.0)).labels  # what should be found stays so
    assert positive[(*CELL, 0)] == POSITIVE


def test_a_sample_keeps_so_many_and_half_of_them_positive_at_most():
    found = assign(GRID, np.concatenate([car(), car(-5, -5), car(5, 5, 1.5)]), positive=0.3, negative=0.3)
    kept = sample(found, np.random.default_rng(0), size=20, positives=5)
    assert (kept.labels == POSITIVE).sum() == 5
    assert (kept.labels == NEGATIVE).sum() == 15
    chosen = kept.labels != IGNORED
    np.testing.assert_array_equal(kept.labels[chosen], found.labels[chosen])
    few = sample(assign(GRID, car(), positive=0.9, negative=0.9), np.random.default_rng(0), size=20, positives=5)
    assert ((few.labels == POSITIVE).sum(), (few.labels == NEGATIVE).sum()) == (1, 19)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_an_anchor_between_two_objects_belongs_to_the_one_it_overlaps_more(order):
    """The anchor at 0.2 is positive for both; neither has it for its best one, so that only the overlap decides."""
    near, far = car(0.75, 0.2), car(-0.75, 0.2)
    found = assign(GRID, np.concatenate([[near, far][k] for k in order]), positive=0.3, best=2.0)
    assert found.labels[(*CELL, 0)] == POSITIVE
    assert found.owner[(*CELL, 0)] == order.index(0)


def test_an_anchor_that_overlaps_two_objects_alike_belongs_to_the_first():
    found = assign(GRID, np.concatenate([car(), car()]), positive=0.3, best=2.0)
    assert (found.owner[found.labels == POSITIVE] == 0).all()


def test_the_best_anchor_of_an_object_is_its_own_though_it_overlaps_another_more():
    """A small object whose best anchor lies under a large one: without this rule it would have none."""
    found = assign(GRID, np.concatenate([car(), car(0.2, 0.2, length=2.0, width=1.2)]), positive=0.5)
    owners = found.owner[found.labels == POSITIVE]
    assert (owners == 1).sum() == 1
    assert (owners == 0).sum() > 1


def test_anchors_that_are_not_positive_have_no_owner():
    found = assign(GRID, np.concatenate([car(-6, -6), car()]), positive=0.6, negative=0.3)
    assert (found.owner[found.labels != POSITIVE] == 0).all()
    assert (found.owner == 1).any()


KINDS = ROAD_USERS
CLASSES = anchors(VoxelNetConfig.light((-8, -8, 8, 8), **road_users())).double().numpy()


def slowly(boxes, labels, asked):
    """Matching by class as it is defined: each anchor against each object of its class, one after the other."""
    found = np.zeros(CLASSES.shape[:3], np.int8)
    owner = np.zeros(CLASSES.shape[:3], np.int64)
    kinds = [kind for kind in KINDS for _ in kind.yaws]
    first = {kind.label: [k.label for k in kinds].index(kind.label) for kind in KINDS}
    best = {}
    for place in np.ndindex(*CLASSES.shape[:3]):
        kind, anchor = kinds[place[2]], CLASSES[place].copy()
        anchor[3:5] += kind.margin
        most = 0.0
        for row in np.flatnonzero(labels == LABELS.index(kind.label)):
            box = boxes[row].copy()
            box[3:5] += kind.margin
            if not asked[row]:
                continue
            box[6] = round(box[6] / (np.pi / 2)) * np.pi / 2
            if np.hypot(*(anchor[:2] - box[:2])) > (np.hypot(*anchor[3:5]) + np.hypot(*box[3:5])) / 2:
                continue
            iou = iou_bev(anchor[None], box[None])[0, 0]
            if iou > most + 1e-12:
                most, owner[place] = iou, row
            if iou > best.get(row, (0.1 - 1e-9,))[0] + 1e-12:
                best[row] = (iou, place)
        found[place] = POSITIVE if most > kind.positive else NEGATIVE if most <= kind.negative else IGNORED
        for row in np.flatnonzero(labels == LABELS.index(kind.label)):
            box = boxes[row] + [0, 0, 0, kind.margin, kind.margin, 0, 0]
            if not asked[row] and found[place] == NEGATIVE:
                (dx, dy), cos, sin = anchor[:2] - box[:2], np.cos(box[6]), np.sin(box[6])
                if abs(dx * cos + dy * sin) <= box[3] / 2 and abs(dy * cos - dx * sin) <= box[4] / 2:
                    found[place] = IGNORED
    for row, (_, place) in best.items():
        found[place], owner[place] = POSITIVE, row
    assert first == {"vehicle": 0, "heavy": 2, "cyclist": 4, "pedestrian": 6}
    return found, np.where(found == POSITIVE, owner, 0)


def test_classes_are_matched_as_slowly_by_definition():
    boxes = np.array([
        [-5.03, 4.01, 0.8, 4.3, 1.8, 1.5, 0.2], [1.11, 1.07, 1.6, 7.0, 2.4, 3.0, 1.5],
        [5.13, -5.21, 0.9, 1.8, 0.6, 1.7, -0.4], [5.17, -3.93, 0.9, 0.6, 0.5, 1.8, 0.0],
        [-5.31, -5.11, 0.9, 0.6, 0.5, 1.8, 2.9], [-3.07, -5.03, 0.9, 1.7, 0.6, 1.7, 0.7],
    ])  # fmt: skip
    labels = np.array([VEHICLE, HEAVY, CYCLIST, PEDESTRIAN, PEDESTRIAN, CYCLIST])
    asked = np.array([True, True, True, True, False, False])
    found = assign_by_kind(CLASSES, KINDS, boxes, labels, asked)
    expected, owner = slowly(boxes, labels, asked)
    np.testing.assert_array_equal(found.labels, expected)
    np.testing.assert_array_equal(found.owner, owner)
    for row, anchors_of_class in enumerate([slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 7)]):
        mine = (found.owner == row) & (found.labels == POSITIVE)
        assert mine.sum() >= 3  # the margin gives small ones more than one
        assert mine[:, :, anchors_of_class].sum() == mine.sum()
    assert (found.labels[:, :, 6] == IGNORED).sum() > 0


def test_without_a_margin_a_pedestrian_has_one_anchor():
    walker = np.array([[0.35, 0.3, 0.9, 0.6, 0.5, 1.8, 0.0]])
    bare = assign(CLASSES[:, :, 6:], walker, positive=0.5, negative=0.35)
    wide = assign(CLASSES[:, :, 6:], walker, positive=0.5, negative=0.35, margin=0.8)
    assert ((bare.labels == POSITIVE).sum(), (wide.labels == POSITIVE).sum()) == (1, 3)


def test_no_objects_of_any_class_are_all_negative():
    found = assign_by_kind(CLASSES, KINDS, np.zeros((0, 7)), np.zeros(0, np.int64), np.zeros(0, bool))
    assert (found.labels == NEGATIVE).all()
    assert (found.owner == 0).all()
