"""Calibration on made-up detections whose truth is known."""

import numpy as np
import pytest
import torch

from models.network.candidates import calibrated
from models.network.rivals import logit, sigmoid
from models.network.voxelnet import VoxelNet
from models.training import calibration
from models.training.calibration import (
    FEWEST,
    LEAST_SURE,
    MOST_LOST,
    PRECISION,
    calibrated_on,
    lowest_threshold,
    platt,
    with_rivals,
)
from models.training.presets import config_for
from toolkit.detection.metrics import reliability
from toolkit.objects import CYCLIST, HEAVY, VEHICLE, Detections, Objects

AREA = (-12.8, -12.8, 12.8, 12.8)


def drawn(count=20000, slope=2.0, intercept=-1.0, seed=0):
    rng = np.random.default_rng(seed)
    scores = rng.uniform(0.02, 0.98, count)
    return scores, rng.random(count) < sigmoid(slope * logit(scores) + intercept)


def test_it_finds_the_slope_and_intercept_of_what_was_drawn():
    assert platt(*drawn()) == pytest.approx((2.0, -1.0), abs=0.08)
    assert platt(*drawn(slope=0.7, intercept=0.5)) == pytest.approx((0.7, 0.5), abs=0.05)


def test_calibrated_scores_are_shares():
    scores, hits = drawn()
    slope, intercept = platt(scores, hits)
    assert reliability(scores, hits).error > 0.1
    assert reliability(sigmoid(slope * logit(scores) + intercept), hits).error < 0.015


def test_it_finds_what_each_rival_takes_and_no_rival_adds():
    rng = np.random.default_rng(3)
    scores, rivals = rng.uniform(0.02, 0.98, 20000), rng.uniform(0, 1, (20000, 3)) * (rng.random((20000, 3)) < 0.5)
    hits = rng.random(20000) < sigmoid(1.5 * logit(scores) + 0.3 - rivals @ np.array([3.0, 0.0, 1.0]))
    assert with_rivals(scores, rivals, hits) == pytest.approx((1.5, 0.3, 3.0, 0.0, 1.0), abs=0.15)
    helped = rng.random(20000) < sigmoid(logit(scores) + rivals @ np.array([3.0, 0.0, 1.0]))
    assert with_rivals(scores, rivals, helped)[2:] == (0.0, 0.0, 0.0)


def test_few_or_spotless_detections_give_no_wild_answer():
    assert platt(np.zeros(0), np.zeros(0, bool)) == (1.0, 0.0)
    slope, intercept = platt(np.full(100, 0.9), np.ones(100, bool))
    assert 1.0 <= slope < 3
    assert 0 <= intercept < 2
    upside_down = platt(np.linspace(0.05, 0.95, 500), np.arange(500) < 250)
    assert upside_down[0] == 0.05  # order is kept


@pytest.mark.parametrize("seed", range(4))
def test_above_the_threshold_such_a_share_is_true_and_above_no_lower_one(seed):
    scores, hits = drawn(3000, slope=6.0, intercept=6.0, seed=seed)
    lowest = lowest_threshold(scores, hits, 0.96)
    assert hits[scores > lowest].mean() >= 0.96
    assert 0.2 < lowest < 0.5
    assert all(hits[scores > lower].mean() < 0.96 for lower in scores[scores < lowest])
    assert lowest_threshold(scores, np.ones(3000, bool), 0.95) == 0.0


def test_a_share_of_few_is_not_believed():
    scores, hits = np.linspace(1, 0.01, 100), np.arange(100) < FEWEST - 1
    assert lowest_threshold(scores, hits, 1.0) < scores[FEWEST - 2]
    assert lowest_threshold(scores, np.zeros(100, bool), 1.0) == scores[FEWEST]
    assert lowest_threshold(scores[:5], hits[:5] & False, 0.9) == 0.0


def test_a_threshold_costs_few_of_the_true_detections():
    scores, hits = drawn(4000)
    wanted = lowest_threshold(scores, hits, 0.99)
    assert (scores[hits] > wanted).mean() == pytest.approx(1 - MOST_LOST, abs=0.001)
    assert hits[scores > wanted].mean() < 0.9


def fake(found):
    """Stands for what a network detects on a packed file."""
    return lambda network, frames, *, count, seed, subsets, errors: found


def scene(label, scores, hits):
    """A frame with detections of one class, each on an object or 10 m beside it."""
    size = {VEHICLE: (4.0, 1.8, 1.5), CYCLIST: (1.8, 0.6, 1.7), HEAVY: (9, 2.5, 3)}[label]
    boxes = np.array([[20.0 * k, 0.0, 1.0, *size, 0.0] for k in range(len(scores))])
    there, labels = boxes.copy(), np.full(len(scores), label)
    there[:, 1] += np.where(hits, 0.0, 10.0)
    return Detections(boxes, np.array(scores), labels), Objects(there, labels), np.ones(len(scores), bool)


def test_every_class_is_calibrated_by_itself_and_has_its_threshold(monkeypatch, packed):
    rng = np.random.default_rng(0)
    frames = []
    for label, slope, intercept in ((VEHICLE, 3.0, 2.0), (CYCLIST, 1.0, -1.0)):
        scores = rng.uniform(0.05, 0.98, 900)
        hits = rng.random(900) < sigmoid(slope * logit(scores) + intercept)
        frames += [scene(label, scores[k : k + 90], hits[k : k + 90]) for k in range(0, 900, 90)]
    frames += [scene(HEAVY, np.full(FEWEST - 1, 0.5), np.zeros(FEWEST - 1, bool))]  # too few to say anything
    monkeypatch.setattr(calibration, "detections_of", fake(frames))
    torch.manual_seed(0)
    network = VoxelNet(config_for(AREA, "fast", classes=("vehicle", "cyclist", "heavy")))
    result = calibrated_on(network, packed).config
    assert result.calibration[0] == pytest.approx((3.0, 2.0), abs=0.6)
    assert result.calibration[1] == pytest.approx((1.0, -1.0), abs=0.2)
    assert result.calibration[2] == (1.0, 0.0)
    assert result.thresholds[2] == LEAST_SURE
    for number, label in enumerate((VEHICLE, CYCLIST)):
        slope, shift = result.calibration[number]
        sure = [
            (sigmoid(slope * logit(found.scores) + shift), there.boxes[:, 1] == 0)
            for found, there, _ in frames
            if found.labels[0] == label
        ]
        scores, true = (np.concatenate(each) for each in zip(*sure, strict=True))
        assert result.thresholds[number] == round(max(LEAST_SURE, lowest_threshold(scores, true, PRECISION)), 3)


def test_a_class_that_shadows_another_takes_from_its_scores(monkeypatch, packed):
    """Everybody is a heavy vehicle with its cab found as a vehicle, half of the time; else a vehicle alone."""
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(12):
        heavy = rng.random(30) < 0.5
        found, there, counted = scene(VEHICLE, rng.uniform(0.4, 0.9, 30), ~heavy)
        trucks, drawn, _ = scene(HEAVY, rng.uniform(0.6, 0.95, 30), np.ones(30, bool))
        labels = np.repeat([VEHICLE, HEAVY], [30 - heavy.sum(), heavy.sum()])
        true = Objects(np.concatenate([there.boxes[~heavy], drawn.boxes[heavy]]), labels)
        frames.append((Detections.merge([found, trucks[heavy]]), true, counted))
    monkeypatch.setattr(calibration, "detections_of", fake(frames))
    network = VoxelNet(config_for(AREA, "fast", classes=("vehicle", "heavy")))
    (_, _, own, from_heavy), (_, _, from_vehicle, _) = calibrated_on(network, packed).config.rivalry
    assert own == 0
    assert from_heavy > 4
    assert from_vehicle < 0.5


def test_a_flawless_detector_keeps_what_it_detects(monkeypatch, packed):
    flawless = [scene(VEHICLE, np.full(50, 0.6), np.ones(50, bool))]
    monkeypatch.setattr(calibration, "detections_of", fake(flawless))
    assert calibrated_on(VoxelNet(config_for(AREA, "fast")), packed).config.thresholds == (LEAST_SURE,)


def test_the_detector_calibrates_as_the_fit_does():
    config = config_for(AREA, "fast", classes=("vehicle", "pedestrian"))
    from dataclasses import replace

    config = replace(config, calibration=((2.0, -1.0), (0.5, 0.25)))
    scores = torch.tensor([0.1, 0.5, 0.9]).repeat(2, 1, 1, 1).permute(0, 1, 3, 2)[..., None].reshape(2, 1, 1, 3, 1)
    label = torch.tensor(config.anchor_labels)
    after = calibrated(scores, label, config)
    expected = [sigmoid(2 * logit(np.array([0.1, 0.5])) - 1), sigmoid(0.5 * logit(np.array([0.9])) + 0.25)]
    np.testing.assert_allclose(after[0, 0, 0, :, 0], np.concatenate(expected), atol=1e-6)
    assert torch.equal(calibrated(scores, label, replace(config, calibration=())), scores)
