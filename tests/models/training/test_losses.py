"""Targets on hand-drawn cases."""

import math

import numpy as np
import pytest
import torch

from models.config import ROAD_USERS, VoxelNetConfig, road_users
from models.network.grid import anchors, encode_residuals, faces_back
from models.network.voxelnet import Prediction
from models.training.losses import (
    IGNORED,
    NEGATIVE,
    POSITIVE,
    assign,
    assign_by_kind,
    focal_loss,
    nearly_aligned_iou,
    paper_loss,
    quality_loss,
    sample,
)
from toolkit.boxes import iou_3d, iou_bev
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

GRID = anchors(VoxelNetConfig.light((-8, -8, 8, 8), anchor_size=(4.0, 2.0, 1.6))).double().numpy()
CELL = (20, 20)  # its anchors stand at (0.2, 0.2)


def car(x=0.2, y=0.2, yaw=0.0, length=4.0, width=2.0):
    return np.array([[x, y, 0.8, length, width, 1.6, yaw]])


def test_thresholds_split_anchors():
    found = assign(GRID, car())
    assert found.labels[(*CELL, 0)] == POSITIVE
    assert found.labels[(*CELL, 1)] == NEGATIVE  # turned by 90° it overlaps by a third
    assert found.labels[0, 0, 0] == NEGATIVE
    found = assign(GRID, car(), positive=0.6, negative=0.4)
    iou = iou_bev(GRID[20, :, 0], car())[:, 0]  # a row of anchors beside one another
    expected = np.where(iou > 0.6, POSITIVE, np.where(iou <= 0.4, NEGATIVE, IGNORED))
    np.testing.assert_array_equal(found.labels[20, :, 0], expected)
    assert set(expected) == {POSITIVE, IGNORED, NEGATIVE}


def test_anchors_belong_to_the_object_they_overlap_most():
    boxes = np.concatenate([car(1.3, -2.0), car(-4.0, 3.0, math.pi / 2, 4.6, 1.9)])
    found = assign(GRID, boxes, positive=0.5, negative=0.5, best=2.0)
    iou = iou_bev(GRID.reshape(-1, 7), boxes)
    np.testing.assert_array_equal(found.labels.ravel() == POSITIVE, iou.max(axis=1) > 0.5)
    positive = found.labels.ravel() == POSITIVE
    np.testing.assert_array_equal(found.owner.ravel()[positive], iou.argmax(axis=1)[positive])


def test_the_best_anchor_of_an_object_is_positive():
    found = assign(GRID, car(length=1.2, width=0.9))
    assert (found.labels == POSITIVE).sum() == 1
    assert (
        assign(GRID, car(length=0.2, width=0.2)).labels == POSITIVE
    ).sum() == 0  # nothing reaches `best`
    assert (assign(GRID, car(x=30.0)).labels == POSITIVE).sum() == 0  # outside the grid
    assert (assign(GRID, np.zeros((0, 7))).labels == NEGATIVE).all()


def test_neighbours_share_the_anchors_between_them():
    boxes = np.concatenate([car(0.2, 0.2), car(0.2, 2.6)])
    found = assign(GRID, boxes, positive=0.4)
    owners = found.owner[20, :, 0][found.labels[20, :, 0] == POSITIVE]
    assert sorted(set(owners)) == [0, 1]
    assert (np.diff(owners) >= 0).all()


@pytest.mark.parametrize(
    ("yaw", "fits"), [(0.6, 0), (math.pi, 0), (-math.pi / 2, 1), (2.0, 1), (7.0, 0)]
)
def test_yaws_snap_to_the_nearer_anchor(yaw, fits):
    labels = assign(GRID, car(yaw=yaw)).labels
    assert labels[(*CELL, fits)] == POSITIVE
    assert labels[(*CELL, 1 - fits)] == NEGATIVE


def test_samples_are_halved_and_ignored_negatives_do_not_count():
    lorry = car(-3.0, -3.0, 0.5, 6.0, 2.5)
    labels = assign(GRID, car(3.0, 3.0), ignored=lorry).labels
    ignored = GRID[labels == IGNORED]
    assert len(ignored) == pytest.approx(2 * 6.0 * 2.5 / 0.4**2, rel=0.1)
    assert np.hypot(*(ignored[:, :2] - [-3, -3]).T).max() < 3.3
    positive = assign(GRID, car(), ignored=car(length=9.0)).labels  # what should be found stays so
    assert positive[(*CELL, 0)] == POSITIVE
    found = assign(
        GRID, np.concatenate([car(), car(-5, -5), car(5, 5, 1.5)]), positive=0.3, negative=0.3
    )
    kept = sample(found, np.random.default_rng(0), size=20, positives=5)
    assert (kept.labels == POSITIVE).sum() == 5
    assert (kept.labels == NEGATIVE).sum() == 15
    chosen = kept.labels != IGNORED
    np.testing.assert_array_equal(kept.labels[chosen], found.labels[chosen])
    few = sample(
        assign(GRID, car(), positive=0.9, negative=0.9),
        np.random.default_rng(0),
        size=20,
        positives=5,
    )
    assert ((few.labels == POSITIVE).sum(), (few.labels == NEGATIVE).sum()) == (1, 19)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_an_anchor_between_two_objects_belongs_to_the_one_it_overlaps_more(order):
    """The anchor at 0.2 is positive for both; neither has it for its best one, so that only the
    overlap decides."""
    near, far = car(0.75, 0.2), car(-0.75, 0.2)
    found = assign(GRID, np.concatenate([[near, far][k] for k in order]), positive=0.3, best=2.0)
    assert found.labels[(*CELL, 0)] == POSITIVE
    assert found.owner[(*CELL, 0)] == order.index(0)


def test_anchors_have_the_owner_they_fit_and_ignored_ones_cost_nothing():
    found = assign(GRID, np.concatenate([car(), car()]), positive=0.3, best=2.0)
    assert (found.owner[found.labels == POSITIVE] == 0).all()
    # A small object whose best anchor lies under a large one: without this rule it would have none.
    found = assign(
        GRID, np.concatenate([car(), car(0.2, 0.2, length=2.0, width=1.2)]), positive=0.5
    )
    owners = found.owner[found.labels == POSITIVE]
    assert (owners == 1).sum() == 1
    assert (owners == 0).sum() > 1
    found = assign(GRID, np.concatenate([car(-6, -6), car()]), positive=0.6, negative=0.3)
    assert (found.owner[found.labels != POSITIVE] == 0).all()
    assert (found.owner == 1).any()
    labels, wanted = targets()
    maps = [torch.randn(1, width, *CONFIG.map_shape) for width in (2, 16, 2, 2)]
    ignored = labels == NEGATIVE
    before = quality_loss(Prediction(*maps), labels.masked_fill(ignored, IGNORED), wanted, ANCHORS)[
        "class"
    ]
    shouting = maps[0] + 50 * channels(ignored[..., None].float())
    after = quality_loss(
        Prediction(shouting, *maps[1:]), labels.masked_fill(ignored, IGNORED), wanted, ANCHORS
    )
    torch.testing.assert_close(after["class"], before)


KINDS = ROAD_USERS
CLASSES = anchors(VoxelNetConfig.light((-8, -8, 8, 8), **road_users())).double().numpy()


def slowly(boxes, labels, asked):
    """Matching by class as it is defined: each anchor against each object of its class, one after
    the other."""
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
            if (
                np.hypot(*(anchor[:2] - box[:2]))
                > (np.hypot(*anchor[3:5]) + np.hypot(*box[3:5])) / 2
            ):
                continue
            iou = iou_bev(anchor[None], box[None])[0, 0]
            if iou > most + 1e-12:
                most, owner[place] = iou, row
            if iou > best.get(row, (0.1 - 1e-9,))[0] + 1e-12:
                best[row] = (iou, place)
        found[place] = (
            POSITIVE if most > kind.positive else NEGATIVE if most <= kind.negative else IGNORED
        )
        for row in np.flatnonzero(labels == LABELS.index(kind.label)):
            box = boxes[row] + [0, 0, 0, kind.margin, kind.margin, 0, 0]
            if not asked[row] and found[place] == NEGATIVE:
                (dx, dy), cos, sin = anchor[:2] - box[:2], np.cos(box[6]), np.sin(box[6])
                if (
                    abs(dx * cos + dy * sin) <= box[3] / 2
                    and abs(dy * cos - dx * sin) <= box[4] / 2
                ):
                    found[place] = IGNORED
    for row, (_, place) in best.items():
        found[place], owner[place] = POSITIVE, row
    assert first == {"vehicle": 0, "heavy": 2, "cyclist": 4, "pedestrian": 6}
    return found, np.where(found == POSITIVE, owner, 0)


def test_classes_are_matched_as_slowly_by_definition():
    boxes = np.array(
        [
            *([-5.03, 4.01, 0.8, 4.3, 1.8, 1.5, 0.2], [1.11, 1.07, 1.6, 7.0, 2.4, 3.0, 1.5]),
            *([5.13, -5.21, 0.9, 1.8, 0.6, 1.7, -0.4], [5.17, -3.93, 0.9, 0.6, 0.5, 1.8, 0.0]),
            *([-5.31, -5.11, 0.9, 0.6, 0.5, 1.8, 2.9], [-3.07, -5.03, 0.9, 1.7, 0.6, 1.7, 0.7]),
        ]
    )
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
    walker = np.array([[0.35, 0.3, 0.9, 0.6, 0.5, 1.8, 0.0]])
    bare = assign(CLASSES[:, :, 6:], walker, positive=0.5, negative=0.35)
    wide = assign(CLASSES[:, :, 6:], walker, positive=0.5, negative=0.35, margin=0.8)
    assert ((bare.labels == POSITIVE).sum(), (wide.labels == POSITIVE).sum()) == (1, 3)
    found = assign_by_kind(
        CLASSES, KINDS, np.zeros((0, 7)), np.zeros(0, np.int64), np.zeros(0, bool)
    )
    assert (found.labels == NEGATIVE).all()
    assert (found.owner == 0).all()


CONFIG = VoxelNetConfig.light((-8, -8, 8, 8))
ANCHORS = anchors(CONFIG)
BOXES = np.array(
    [
        [0.3, 0.1, 0.8, 4.2, 1.8, 1.5, 3.0],
        [-4, 4, 0.7, 4.6, 1.9, 1.4, -1.4],
        [4, -3, 0.9, 4, 1.7, 1.6, 0.5],
    ]
)


def targets(boxes=BOXES):
    found = assign(ANCHORS.double().numpy(), boxes, positive=0.5, negative=0.35)
    wanted = torch.tensor(boxes if len(boxes) else np.ones((1, 7)), dtype=torch.float32)[
        torch.from_numpy(found.owner)
    ]
    return torch.from_numpy(found.labels)[None], wanted[None]


def channels(by_anchor):
    """(B, H, W, A, k) as the head lays it out."""
    items, rows, columns, count, k = by_anchor.shape
    return by_anchor.permute(0, 3, 4, 1, 2).reshape(items, count * k, rows, columns)


def perfect(labels, wanted, published):
    """What a network that knows everything says."""
    anchor = ANCHORS.expand_as(wanted)
    residuals = channels(encode_residuals(wanted, anchor, doubled=not published))
    sure = torch.where(labels == POSITIVE, 20.0, -20.0)[..., None]
    if published:
        return Prediction(channels(torch.cat((-sure, sure), -1)), residuals)
    direction = torch.where(faces_back(wanted, anchor), 20.0, -20.0)[..., None]
    return Prediction(
        channels(sure), residuals, channels(direction), channels(torch.full_like(sure, 20.0))
    )


@pytest.mark.parametrize(("loss", "published"), [(quality_loss, False), (paper_loss, True)])
def test_a_perfect_prediction_costs_nothing(loss, published):
    labels, wanted = targets()
    values = loss(perfect(labels, wanted, published), labels, wanted, ANCHORS)
    assert max(float(value) for value in values.values()) < 1e-4


@pytest.mark.parametrize("boxes", [BOXES, BOXES[:0]])
@pytest.mark.parametrize(("loss", "widths"), [(quality_loss, (2, 16, 2, 2)), (paper_loss, (4, 14))])
def test_losses_are_finite_and_every_map_gets_a_gradient(loss, widths, boxes):
    labels, wanted = targets(boxes)
    maps = [torch.randn(1, width, *CONFIG.map_shape, requires_grad=True) for width in widths]
    values = loss(Prediction(*maps), labels, wanted, ANCHORS)
    assert all(torch.isfinite(value) for value in values.values())
    torch.stack(list(values.values())).sum().backward()
    gradients = [map_.grad.abs().sum() for map_ in maps]
    assert all(torch.isfinite(gradient) for gradient in gradients)
    assert gradients[0] > 0
    assert all((gradient > 0) == (len(boxes) > 0) for gradient in gradients[1:])


def test_focal_and_iou_losses_are_their_definitions():
    logits = torch.tensor([2.0, -1.0, 0.5, 80.0])
    positive, counted = (
        torch.tensor([True, True, False, False]),
        torch.tensor([True, True, True, False]),
    )
    p = torch.sigmoid(logits)
    expected = [
        0.25 * (1 - p[0]) ** 2 * -torch.log(p[0]),
        0.25 * (1 - p[1]) ** 2 * -torch.log(p[1]),
    ]
    expected += [0.75 * p[2] ** 2 * -torch.log(1 - p[2])]
    torch.testing.assert_close(focal_loss(logits, positive, counted), torch.stack(expected).sum())
    rng = np.random.default_rng(0)
    wanted = np.column_stack(
        [rng.normal(0, 1, (200, 3)), rng.uniform(1, 5, (200, 3)), rng.uniform(-4, 4, 200)]
    )
    boxes = wanted + np.column_stack([rng.normal(0, 0.5, (200, 6)), np.zeros(200)])
    boxes[:, 3:6] = np.abs(boxes[:, 3:6]) + 0.5
    boxes[::2, 6] += math.pi
    ours = nearly_aligned_iou(torch.tensor(boxes), torch.tensor(wanted))
    np.testing.assert_allclose(ours, np.diag(iou_3d(boxes, wanted)), atol=1e-9)
    wanted = np.array([[0, 0, 0.8, 4.5, 1.8, 1.6, 0.3]]).repeat(5, axis=0)
    boxes = wanted + np.outer(np.deg2rad([0, 1, 2, 4, 8]), [0, 0, 0, 0, 0, 0, 1])
    exact = np.diag(iou_3d(boxes, wanted))
    np.testing.assert_allclose(
        nearly_aligned_iou(torch.tensor(boxes), torch.tensor(wanted)), exact, atol=0.015
    )
    labels, wanted = targets()
    with pytest.raises(ValueError, match='head="quality"'):
        quality_loss(perfect(labels, wanted, True), labels, wanted, ANCHORS)


ALL_CLASSES = VoxelNetConfig.light((-8, -8, 8, 8), **road_users())
OWNERS = ALL_CLASSES.anchor_labels


def class_maps(seed=0):
    generator = torch.Generator().manual_seed(seed)
    return Prediction(
        *(torch.randn(1, 7 * k, *ALL_CLASSES.map_shape, generator=generator) for k in (1, 8, 1, 1))
    )


def class_targets(count=4):
    """One object of each class, the first `count` of them there."""
    sizes = [[4.2, 1.8, 1.5], [8, 2.5, 3], [1.8, 0.6, 1.7], [0.6, 0.5, 1.8]]
    boxes = np.column_stack([[-4, 3, -4, 4], [-4, 3, 4, -4], [0.8] * 4, sizes, [0.3, 1.4, 3, 0.0]])[
        :count
    ]
    grid = anchors(ALL_CLASSES)
    labels = np.array([0, 3, 1, 2])[:count]
    found = assign_by_kind(
        grid.double().numpy(), ALL_CLASSES.kinds, boxes, labels, np.ones(count, bool)
    )
    wanted = torch.tensor(boxes, dtype=torch.float32)[torch.from_numpy(found.owner)]
    return torch.from_numpy(found.labels)[None], wanted[None], grid


def test_losses_of_classes_are_sums_over_their_own_positives():
    labels, wanted, grid = class_targets()
    maps = class_maps()
    together = quality_loss(maps, labels, wanted, grid, OWNERS)
    parts = []
    for own in (slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 7)):
        cut = [each.reshape(1, 7, -1, *ALL_CLASSES.map_shape)[:, own] for each in maps]
        prediction = Prediction(*(each.reshape(1, -1, *ALL_CLASSES.map_shape) for each in cut))
        parts.append(
            quality_loss(prediction, labels[..., own], wanted[..., own, :], grid[..., own, :])
        )
    for name, value in together.items():
        torch.testing.assert_close(value, torch.stack([part[name] for part in parts]).sum())
    labels, wanted, grid = class_targets(3)
    without = quality_loss(class_maps(), labels, wanted, grid, OWNERS)
    maps = class_maps()
    maps.residuals[:, 48:] += 9.0  # of the pedestrian's anchors
    after = quality_loss(maps, labels, wanted, grid, OWNERS)
    for name in ("box", "iou", "direction", "quality", "class"):
        torch.testing.assert_close(after[name], without[name])
    labels, wanted = targets()
    maps = Prediction(*(torch.randn(1, width, *CONFIG.map_shape) for width in (2, 16, 2, 2)))
    one, named = (
        quality_loss(maps, labels, wanted, ANCHORS),
        quality_loss(maps, labels, wanted, ANCHORS, (0, 0)),
    )
    assert all(torch.equal(one[name], named[name]) for name in one)
    labels, wanted, grid = class_targets()
    once = quality_loss(class_maps(), labels, wanted, grid, OWNERS)
    twice = [torch.cat((each, each)) for each in (*class_maps(), labels, wanted)]
    again = quality_loss(Prediction(*twice[:4]), twice[4], twice[5], grid, OWNERS)
    for name, value in once.items():
        torch.testing.assert_close(again[name], value)
