"""AMOTA and sAMOTA: cases by hand, and a version that counts without any of our matching."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.objects import Objects
from toolkit.tracking.frame_overlap import measure_overlap
from toolkit.tracking.recall_sweep import RECALLS, list_recalls, sweep_recalls
from toolkit.tracking.tracks import Tracks

CAR = np.array([0.0, 0, 0.75, 4.5, 1.9, 1.5, 0.0])


def place_cars(columns):
    boxes = np.tile(CAR, (len(columns), 1))
    boxes[:, 0] = 10.0 * np.asarray(columns)
    return boxes


def overlaps(frames):
    """frames: true columns, tracked columns, scores; equal columns match, ids are the columns."""
    found = []
    for truth, tracked, scores in frames:
        objects = Objects(place_cars(truth), ids=np.array(truth, int))
        tracks = Tracks(place_cars(tracked), np.array(scores, float), ids=np.array(tracked, int))
        found.append(measure_overlap(tracks, objects, 0))
    return found


def test_perfect_tracks_have_one():
    found = sweep_recalls(overlaps([([1, 2], [1, 2], [0.9, 0.4])] * 40))
    assert found.samota == pytest.approx(1.0)
    # of 1 - (1 - r) over the 40 recalls, in steps of a whole track
    assert 0.5 < found.amota <= 1.0


def test_tracks_of_half_the_objects_have_half():
    frames = [([1, 2], [1], [0.9])] * 40
    found = sweep_recalls(overlaps(frames))
    assert found.samota == pytest.approx(0.5)
    # of 82 objects 42 are found: .525 is reached by 43, and has the last one
    found = sweep_recalls(overlaps([*frames, ([1, 2], [1, 2], [0.9, 0.9])]))
    assert found.samota == pytest.approx((20 + 1 - (40 - 0.475 * 82) / (0.525 * 82)) / RECALLS)


def test_false_alarms_that_are_unsure_do_not_hurt_low_recalls():
    sure = [([1, 2], [1, 2, 9], [0.9, 0.5, 0.95])] * 40
    unsure = [([1, 2], [1, 2, 9], [0.9, 0.5, 0.1])] * 40
    assert sweep_recalls(overlaps(unsure)).samota == pytest.approx(1.0)
    assert sweep_recalls(overlaps(sure)).samota < 0.8


def test_without_truth_or_matches():
    assert np.isnan(sweep_recalls(overlaps([([], [1], [0.9])])).samota)
    assert sweep_recalls(overlaps([([1], [5], [0.9])])).samota == 0


def sweep_slowly(frames):
    """Published procedure on frames whose matches are known: equal columns."""
    scores = {}
    for _, tracked, frame_scores in frames:
        for column, score in zip(tracked, frame_scores, strict=True):
            scores.setdefault(column, []).append(score)
    mean = {column: np.mean(values) for column, values in scores.items()}
    total = sum(len(truth) for truth, _, _ in frames)
    hits = [mean[c] for truth, tracked, _ in frames for c in tracked if c in truth]
    hits.sort(reverse=True)
    points, recall = [], 0.0
    for number, score in enumerate(hits):
        left = (number + 1) / total
        right = (number + 2) / total if number < len(hits) - 1 else left
        if right - recall < recall - left - 1e-12 and number < len(hits) - 1:
            continue
        points.append((recall, score))
        recall += 1 / 40
    value = 0.0
    for recall, score in points[1:41]:
        errors = 0
        for truth, tracked, _ in frames:
            kept = {column for column in tracked if mean[column] >= score}
            errors += len(kept - set(truth)) + len(set(truth) - kept)
        scaled = 1 - (errors - (1 - recall) * total) / (recall * total)
        value += min(1, max(0, scaled))
    return value / 40


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 60), st.integers(1, 5))
def test_it_is_the_published_procedure(seed, count, objects):
    rng = np.random.default_rng(seed)
    frames = []
    for _ in range(count):
        truth = np.flatnonzero(rng.random(objects) < 0.8).tolist()
        tracked = np.flatnonzero(rng.random(objects + 3) < 0.6).tolist()
        frames.append((truth, tracked, rng.random(len(tracked)).round(3).tolist()))
    if not sum(len(truth) for truth, _, _ in frames):
        return
    assert sweep_recalls(overlaps(frames)).samota == pytest.approx(sweep_slowly(frames), abs=1e-9)


def test_each_recall_has_the_nearest_true_positive():
    points = list_recalls(np.linspace(1, 0.01, 80), 80)
    assert len(points) == RECALLS
    assert points[0].recall == 1 / 40
    assert points[-1].recall == 1
    assert points[-1].score == pytest.approx(0.01)
    assert len(list_recalls(np.array([0.5]), 100)) == 0
