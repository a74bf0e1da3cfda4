"""Losses: finite, with gradients, near zero for a perfect prediction; the IoU in them against the exact one."""

import math

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig, road_users
from models.network.anchors import anchors, encode, faces_back
from models.network.voxelnet import Prediction
from models.training.losses import focal_loss, nearly_aligned_iou, published_loss, quality_loss
from models.training.targets import IGNORED, NEGATIVE, POSITIVE, assign, assign_by_kind
from toolkit.boxes import iou_3d

CONFIG = VoxelNetConfig.light((-8, -8, 8, 8))
ANCHORS = anchors(CONFIG)
BOXES = np.array(
    [[0.3, 0.1, 0.8, 4.2, 1.8, 1.5, 3.0], [-4, 4, 0.7, 4.6, 1.9, 1.4, -1.4], [4, -3, 0.9, 4, 1.7, 1.6, 0.5]]
)


def targets(boxes=BOXES):
    found = assign(ANCHORS.double().numpy(), boxes, positive=0.5, negative=0.35)
    wanted = torch.tensor(boxes if len(boxes) else np.ones((1, 7)), dtype=torch.float32)[torch.from_numpy(found.owner)]
    return torch.from_numpy(found.labels)[None], wanted[None]


def channels(by_anchor):
    """(B, H, W, A, k) as the head lays it out."""
    items, rows, columns, count, k = by_anchor.shape
    return by_anchor.permute(0, 3, 4, 1, 2).reshape(items, count * k, rows, columns)


def perfect(labels, wanted, published):
    """What a network that knows everything says."""
    anchor = ANCHORS.expand_as(wanted)
    residuals = channels(encode(wanted, anchor, doubled=not published))
    sure = torch.where(labels == POSITIVE, 20.0, -20.0)[..., None]
    if published:
        return Prediction(channels(torch.cat((-sure, sure), -1)), residuals)
    direction = torch.where(faces_back(wanted, anchor), 20.0, -20.0)[..., None]
    return Prediction(channels(sure), residuals, channels(direction), channels(torch.full_like(sure, 20.0)))


@pytest.mark.parametrize(("loss", "published"), [(quality_loss, False), (published_loss, True)])
def test_a_perfect_prediction_costs_nothing(loss, published):
    labels, wanted = targets()
    values = loss(perfect(labels, wanted, published), labels, wanted, ANCHORS)
    assert max(float(value) for value in values.values()) < 1e-4


@pytest.mark.parametrize("boxes", [BOXES, BOXES[:0]])
@pytest.mark.parametrize(("loss", "widths"), [(quality_loss, (2, 16, 2, 2)), (published_loss, (4, 14))])
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


def test_ignored_anchors_cost_nothing():
    labels, wanted = targets()
    maps = [torch.randn(1, width, *CONFIG.map_shape) for width in (2, 16, 2, 2)]
    ignored = labels == NEGATIVE
    before = quality_loss(Prediction(*maps), labels.masked_fill(ignored, IGNORED), wanted, ANCHORS)["class"]
    shouting = maps[0] + 50 * channels(ignored[..., None].float())
    after = quality_loss(Prediction(shouting, *maps[1:]), labels.masked_fill(ignored, IGNORED), wanted, ANCHORS)
    torch.testing.assert_close(after["class"], before)


def test_focal_loss_is_its_definition():
    logits = torch.tensor([2.0, -1.0, 0.5, 80.0])
    positive, counted = torch.tensor([True, True, False, False]), torch.tensor([True, True, True, False])
    p = torch.sigmoid(logits)
    expected = [0.25 * (1 - p[0]) ** 2 * -torch.log(p[0]), 0.25 * (1 - p[1]) ** 2 * -torch.log(p[1])]
    expected += [0.75 * p[2] ** 2 * -torch.log(1 - p[2])]
    torch.testing.assert_close(focal_loss(logits, positive, counted), torch.stack(expected).sum())


def test_iou_is_exact_where_yaws_agree():
    rng = np.random.default_rng(0)
    wanted = np.column_stack([rng.normal(0, 1, (200, 3)), rng.uniform(1, 5, (200, 3)), rng.uniform(-4, 4, 200)])
    boxes = wanted + np.column_stack([rng.normal(0, 0.5, (200, 6)), np.zeros(200)])
    boxes[:, 3:6] = np.abs(boxes[:, 3:6]) + 0.5
    boxes[::2, 6] += math.pi
    ours = nearly_aligned_iou(torch.tensor(boxes), torch.tensor(wanted))
    np.testing.assert_allclose(ours, np.diag(iou_3d(boxes, wanted)), atol=1e-9)


def test_iou_is_close_where_yaws_nearly_agree():
    wanted = np.array([[0, 0, 0.8, 4.5, 1.8, 1.6, 0.3]]).repeat(5, axis=0)
    boxes = wanted + np.outer(np.deg2rad([0, 1, 2, 4, 8]), [0, 0, 0, 0, 0, 0, 1])
    exact = np.diag(iou_3d(boxes, wanted))
    np.testing.assert_allclose(nearly_aligned_iou(torch.tensor(boxes), torch.tensor(wanted)), exact, atol=0.015)


def test_the_quality_loss_wants_a_quality_head():
    labels, wanted = targets()
    with pytest.raises(ValueError, match='head="quality"'):
        quality_loss(perfect(labels, wanted, True), labels, wanted, ANCHORS)


CLASSES = VoxelNetConfig.light((-8, -8, 8, 8), **road_users())
OWNERS = CLASSES.anchor_labels


def class_maps(seed=0):
    generator = torch.Generator().manual_seed(seed)
    return Prediction(*(torch.randn(1, 7 * k, *CLASSES.map_shape, generator=generator) for k in (1, 8, 1, 1)))


def class_targets(count=4):
    """One object of each class, the first `count` of them there."""
    sizes = [[4.2, 1.8, 1.5], [8, 2.5, 3], [1.8, 0.6, 1.7], [0.6, 0.5, 1.8]]
    boxes = np.column_stack([[-4, 3, -4, 4], [-4, 3, 4, -4], [0.8] * 4, sizes, [0.3, 1.4, 3, 0.0]])[:count]
    grid = anchors(CLASSES)
    labels = np.array([0, 3, 1, 2])[:count]
    found = assign_by_kind(grid.double().numpy(), CLASSES.kinds, boxes, labels, np.ones(count, bool))
    wanted = torch.tensor(boxes, dtype=torch.float32)[torch.from_numpy(found.owner)]
    return torch.from_numpy(found.labels)[None], wanted[None], grid


def test_the_loss_of_classes_is_the_sum_of_each_class_over_its_own_positives():
    labels, wanted, grid = class_targets()
    maps = class_maps()
    together = quality_loss(maps, labels, wanted, grid, OWNERS)
    parts = []
    for own in (slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 7)):
        cut = [each.reshape(1, 7, -1, *CLASSES.map_shape)[:, own] for each in maps]
        prediction = Prediction(*(each.reshape(1, -1, *CLASSES.map_shape) for each in cut))
        parts.append(quality_loss(prediction, labels[..., own], wanted[..., own, :], grid[..., own, :]))
    for name, value in together.items():
        torch.testing.assert_close(value, torch.stack([part[name] for part in parts]).sum())


def test_a_class_that_is_not_there_learns_nothing_of_boxes():
    labels, wanted, grid = class_targets(3)
    without = quality_loss(class_maps(), labels, wanted, grid, OWNERS)
    maps = class_maps()
    maps.residuals[:, 48:] += 9.0  # of the pedestrian's anchors
    after = quality_loss(maps, labels, wanted, grid, OWNERS)
    for name in ("box", "iou", "direction", "quality", "class"):
        torch.testing.assert_close(after[name], without[name])


def test_one_class_by_name_costs_what_one_class_costs():
    labels, wanted = targets()
    maps = Prediction(*(torch.randn(1, width, *CONFIG.map_shape) for width in (2, 16, 2, 2)))
    one, named = quality_loss(maps, labels, wanted, ANCHORS), quality_loss(maps, labels, wanted, ANCHORS, (0, 0))
    assert all(torch.equal(one[name], named[name]) for name in one)


def test_losses_are_per_positive_anchor_so_that_the_same_twice_costs_the_same():
    labels, wanted, grid = class_targets()
    once = quality_loss(class_maps(), labels, wanted, grid, OWNERS)
    twice = [torch.cat((each, each)) for each in (*class_maps(), labels, wanted)]
    again = quality_loss(Prediction(*twice[:4]), twice[4], twice[5], grid, OWNERS)
    for name, value in once.items():
        torch.testing.assert_close(again[name], value)
