"""Candidates: maps become boxes with scores that mean something, each class by itself."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig, road_users
from models.network.candidates import (
    MAX_CLOUD_CANDIDATES,
    MIN_RIVAL_SCORE,
    apply_rivals,
    average_boxes,
    candidates,
    strongest_rivals,
    suppress_boxes,
)
from models.network.grid import anchors, encode_residuals, faces_back
from models.network.voxelnet import Prediction
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections

CONFIG = VoxelNetConfig.light((-8, -8, 8, 8))
CLASSES = VoxelNetConfig.light((-8, -8, 8, 8), **road_users())
LEAST = (0.1, 0.1, 0.1, 0.1)
FIRST_ANCHOR = {VEHICLE: 0, HEAVY: 2, CYCLIST: 4, PEDESTRIAN: 6}


def prediction_of(boxes, config=CONFIG, sure=5.0):
    """Maps whose nearest anchors of each box hold it, as a perfect network would give them."""
    grid, boxes = anchors(config), torch.tensor(boxes, dtype=torch.float32)
    rows, columns, count, _ = grid.shape
    logits = torch.full((rows, columns, count, 1), -9.0)
    residuals, direction = torch.zeros(rows, columns, count, 8), torch.zeros(rows, columns, count)
    quality = torch.zeros(rows, columns, count)
    for number, box in enumerate(boxes):
        near = (grid[..., :2] - box[:2]).norm(dim=-1) < 0.7
        logits[near] = sure - number
        residuals[near] = encode_residuals(box.expand_as(grid[near]), grid[near])
        direction[near] = faces_back(box.expand_as(grid[near]), grid[near]) * 2.0 - 1
        quality[near] = 4.0
    shaped = [
        m.reshape(1, rows, columns, -1).permute(0, 3, 1, 2)
        for m in (logits, residuals, direction, quality)
    ]
    return Prediction(*shaped)


def test_perfect_maps_become_their_boxes_averaged_by_squared_scores():
    boxes = [
        [1.0, 2.0, 0.7, 4.5, 1.8, 1.5, 0.3],
        [-3.0, -4.0, 0.9, 4.0, 1.7, 1.6, 2.5],
        [5, -5, 1.2, 9, 2.5, 3, -1.5],
    ]
    found = suppress_boxes(
        *candidates(prediction_of(boxes), anchors(CONFIG), CONFIG, (0.1,))[0], CONFIG, 0.1
    )
    np.testing.assert_allclose(found.boxes[:, :6], np.array(boxes)[:, :6], atol=1e-4)
    turns = (found.boxes[:, 6] - np.array(boxes)[:, 6]) / (2 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-4)
    assert np.all(np.diff(found.scores) < 0)
    config = VoxelNetConfig.light((-8, -8, 7.5, 8))  # the grid reaches 8
    boxes = [[7.8, 0.0, 0.7, 4.5, 1.8, 1.5, 0.3], [-3.0, -4.0, 0.9, 4.0, 1.7, 1.6, 2.5]]
    found = suppress_boxes(
        *candidates(prediction_of(boxes, config), anchors(config), config, (0.1,))[0], config, 0.1
    )
    np.testing.assert_allclose(found.boxes[:, 0], [-3.0], atol=1e-4)
    best = [0.0, 0, 1, 4, 2, 1.5, 0.1]
    beside = [0.2, 0, 1, 4, 2, 1.5, 0.1 + np.pi]  # the same line, the other way
    across, far = [0.0, 0, 1, 4, 2, 1.5, 0.1 + np.pi / 2], [9.0, 0, 1, 4, 2, 1.5, 0]
    found = Detections(
        np.array([best, beside, across, far]), np.array([0.8, 0.4, 0.7, 0.6]), np.zeros(4, np.int64)
    )
    mean = average_boxes(found, np.array([0, 3]), 0.75)
    np.testing.assert_allclose(mean.boxes[0], [0.2 / 5, 0, 1, 4, 2, 1.5, 0.1], atol=1e-12)
    np.testing.assert_allclose(mean.boxes[1], far)
    np.testing.assert_array_equal(mean.scores, [0.8, 0.6])
    assert len(average_boxes(Detections.empty(), np.array([], np.int64), 0.75)) == 0


def class_prediction(boxes, labels, sure):
    """Maps in which the first anchor of a class in the cells nearest to each box holds it."""
    grid = anchors(CLASSES)
    shape = grid.shape[:3]
    logits, quality = torch.full((*shape, 1), -9.0), torch.full(shape, 9.0)
    residuals, direction = torch.zeros(*shape, 8), torch.full(shape, -9.0)
    for box, label, logit in zip(
        torch.tensor(boxes, dtype=torch.float32), labels, sure, strict=True
    ):
        anchor = FIRST_ANCHOR[label]
        near = (grid[:, :, anchor, :2] - box[:2]).norm(dim=-1) < 0.5
        logits[..., anchor, :][near] = logit
        residuals[..., anchor, :][near] = encode_residuals(
            box.expand_as(grid[near][:, anchor]), grid[near][:, anchor]
        )
    maps = (logits, residuals, direction, quality)
    return Prediction(*(each.reshape(1, *shape[:2], -1).permute(0, 3, 1, 2) for each in maps))


def test_every_class_has_its_boxes():
    """A rider on a bicycle, a person in the same place, a van that is also seen as a truck: four of
    four."""
    boxes = [
        *([1.0, 2.0, 0.9, 1.8, 0.6, 1.7, 0.3], [1.1, 2.0, 0.9, 0.6, 0.6, 1.7, 0.0]),
        *([-3.0, -4.0, 0.9, 4.9, 1.9, 2.0, 0.2], [-3.0, -4.0, 1.2, 5.5, 2.1, 2.5, 0.2]),
    ]
    labels = [CYCLIST, PEDESTRIAN, VEHICLE, HEAVY]
    prediction = class_prediction(boxes, labels, [3.0, 2.0, 1.0, 0.5])
    found = suppress_boxes(
        *candidates(prediction, anchors(CLASSES), CLASSES, LEAST)[0], CLASSES, 0.1
    )
    assert found.labels.tolist() == labels
    np.testing.assert_allclose(found.boxes, boxes, atol=1e-4)
    expected = torch.sigmoid(torch.tensor([3.0, 2.0, 1.0, 0.5])) * torch.sigmoid(torch.tensor(9.0))
    np.testing.assert_allclose(found.scores, expected, atol=1e-6)


def test_scores_are_in_the_order_of_the_labels():
    prediction = class_prediction([[0, 0, 0.9, 1.8, 0.6, 1.7, 0.3]], [CYCLIST], [3.0])
    ((_, scores),) = candidates(prediction, anchors(CLASSES), CLASSES, LEAST)
    assert len(scores) > 2
    assert (scores[:, [0, 1, 3]] == 0).all()  # in the order of the configuration's labels
    assert (scores[:, 2] > 0.9).all()


def test_boxes_of_rivals_are_averaged_within_their_class():
    box, other = [0.0, 0, 1, 4, 2, 1.5, 0.1], [0.2, 0, 1, 4, 2, 1.5, 0.1]
    found = Detections(
        np.array([box, other, other]),
        np.array([0.8, 0.7, 0.4]),
        np.array([VEHICLE, HEAVY, VEHICLE]),
    )
    mean = average_boxes(found, np.array([0, 1]), 0.75)
    np.testing.assert_allclose(mean.boxes, [[0.2 / 5, *box[1:]], other], atol=1e-12)
    assert mean.labels.tolist() == [VEHICLE, HEAVY]


def test_the_strongest_rivals_are_found_by_hand():
    rivalry = np.zeros((5, 4))
    rivalry[0, 3], rivalry[1, 2] = 0.7, 0.6
    rivalry[2, 0], rivalry[3, 1] = 0.5, 0.9
    np.testing.assert_array_equal(strongest_rivals(street(), STREET), rivalry)
    assert strongest_rivals(Detections.empty(), STREET).shape == (0, 4)
    found = street()
    weak = Detections(
        found.boxes, np.array([0.6, 0.9 * MIN_RIVAL_SCORE, 0.9, MIN_RIVAL_SCORE, 0.8]), found.labels
    )
    rivals = strongest_rivals(weak, STREET)
    assert rivals[0, 3] == 0
    assert rivals[2, 0] == MIN_RIVAL_SCORE
    found = street()
    beside = found.boxes[1:2].copy()
    beside[:, 0] += 0.1
    more = Detections.merge([found, Detections(beside, np.array([0.75]), np.array([PEDESTRIAN]))])
    assert strongest_rivals(more, STREET)[0].tolist() == [0, 0, 0, 0.75]


def test_rivals_take_from_scores():
    sure = Detections(street().boxes, np.array([1.0, 0.0, 1.0, 0.0, 1.0]), street().labels)
    assert np.isfinite(apply_rivals(sure, replace(STREET, rivalry=ROWS)).scores).all()
    after = apply_rivals(street(), replace(STREET, rivalry=ROWS))

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    def logit(p):
        return np.log(p / (1 - p))

    after_rivals = [
        sigmoid(2 * logit(0.6) - 0.5 - 3 * 0.7),
        0.7,
        0.9,
        sigmoid(logit(0.5) - 2 * 0.9),
        0.8,
    ]
    np.testing.assert_allclose(after.scores, after_rivals, atol=1e-12)
    np.testing.assert_array_equal(after.boxes, street().boxes)
    np.testing.assert_array_equal(after.labels, street().labels)


CONFIGS = {
    "one class": CONFIG,
    "one class, calibrated": dataclasses.replace(CONFIG, calibration=((1.4, -0.6),)),
    "classes": CLASSES,
    "classes, calibrated": dataclasses.replace(
        CLASSES, calibration=((1.5, 0.4), (0.7, -1.0), (9.0, 3.0), (0.1, 0.2))
    ),
    "published": dataclasses.replace(VoxelNetConfig.from_paper("tjunction"), area=CONFIG.area),
}


def label_scores(prediction, config):
    """Score (B, H, W, A, L) of every anchor, by the definition; anchors of a class have its score
    alone."""
    items, _, rows, columns = prediction.class_logits.shape
    logits, quality = (
        None
        if each is None
        else each.reshape(items, len(config.anchor_labels), -1, rows, columns).permute(
            0, 3, 4, 1, 2
        )
        for each in (prediction.class_logits, prediction.quality_logits)
    )
    if config.head == "published":
        return torch.softmax(logits, -1)[..., 1:]
    scores = torch.sigmoid(logits) * torch.sigmoid(quality)
    if config.calibration:
        pairs = torch.tensor(config.calibration)
        slope, shift = (
            pairs[list(config.anchor_labels)].T[..., None] if config.kinds else pairs.T
        )[:]
        scores = torch.sigmoid(slope * torch.logit(scores, 1e-6) + shift)
    return scores


@pytest.mark.parametrize("least", [0.0, 1e-7, 0.05, 0.6, 0.9999, 1.0])
@pytest.mark.parametrize("name", CONFIGS)
def test_a_glance_at_the_classes_misses_no_candidate(name: str, least: float):
    """Beside scores of every anchor and label, one that is not a number among them."""
    config = CONFIGS[name]
    shape, torch_rng = config.map_shape, torch.Generator().manual_seed(7)
    count = len(config.anchor_labels)
    widths = (count * config.classes, count * config.residuals, count, count)
    maps = [6 * torch.randn(2, width, *shape, generator=torch_rng) for width in widths]
    maps[0][0, 0, 3, 3] = torch.nan
    prediction = Prediction(*maps) if config.head == "quality" else Prediction(*maps[:2])
    scores = label_scores(prediction, config)
    thresholds = [least] * len(config.labels)
    for item, (_, by_label) in enumerate(
        candidates(prediction, anchors(config), config, thresholds)
    ):
        above = torch.where(scores[item] > least, scores[item], 0).amax(-1).flatten()
        expected = above.sort(descending=True).values[:MAX_CLOUD_CANDIDATES]
        torch.testing.assert_close(
            by_label.amax(-1).sort(descending=True).values, expected[expected > 0]
        )


# vehicle, heavy, cyclist, pedestrian
STREET = VoxelNetConfig.light((-20, -20, 20, 20), **road_users())
ROWS = (
    *(
        (1.0, 0.0, 9.0, 2.0, 0.0, 0.0),
        (1.0, 0.0, 0.0, 9.0, 0.0, 0.0),
        (2.0, -0.5, 0.0, 0.0, 0.0, 3.0),
    ),
    (1.0,) + (0.0,) * 5,
)


def street():
    """A cyclist that is a pedestrian as well, a truck whose cab is a vehicle, and a pedestrian
    beside the truck."""
    boxes = [
        *(
            [0, 0, 0.8, 1.8, 0.6, 1.6, 0],
            [0.4, 0, 0.8, 0.6, 0.6, 1.6, 1.0],
            [10, 0, 1.6, 9, 2.5, 3.2, 0],
        ),
        *([13, 0.1, 0.9, 4, 1.9, 1.8, 0], [10, 1.45, 0.8, 0.6, 0.6, 1.7, 0]),
    ]
    labels = np.array([CYCLIST, PEDESTRIAN, HEAVY, VEHICLE, PEDESTRIAN])
    return Detections(np.array(boxes), np.array([0.6, 0.7, 0.9, 0.5, 0.8]), labels)


@pytest.mark.parametrize("found", [street(), Detections.empty()])
def test_without_rivalry_nothing_changes(found):
    assert apply_rivals(found, STREET) is found
