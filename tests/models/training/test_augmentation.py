"""Augmentations of scenes: what is thinned is a subset, what is tilted stays together."""

import numpy as np
import pytest

from models.training.augmentation import FEWEST_KEPT, LIFT, SLOPE, thinned, tilted

CENTRE = np.array([2.0, -1.0])


def test_thinning_keeps_from_a_tenth_to_all():
    points = np.random.default_rng(0).uniform(-9, 9, (2000, 3)).astype(np.float32)
    shares = []
    for seed in range(60):
        kept = thinned(points, np.random.default_rng(seed))
        assert kept.dtype == np.float32
        assert len(np.unique(np.concatenate([points, kept]), axis=0)) == len(points)
        shares.append(len(kept) / len(points))
    assert min(shares) > FEWEST_KEPT - 0.03
    assert min(shares) < 0.2
    assert max(shares) > 0.9
    assert np.mean(shares) == pytest.approx(0.55, abs=0.1)


def test_points_and_boxes_are_lifted_alike():
    rng = np.random.default_rng(1)
    boxes = np.column_stack([rng.uniform(-20, 20, (50, 2)), rng.uniform(0, 1, 50), np.ones((50, 4))])
    points = boxes[:, :3].astype(np.float32)
    moved_points, moved = tilted(points, boxes, CENTRE, np.random.default_rng(2))
    np.testing.assert_allclose(moved_points, moved[:, :3], atol=1e-5)
    np.testing.assert_array_equal(moved[:, [0, 1, 3, 4, 5, 6]], boxes[:, [0, 1, 3, 4, 5, 6]])
    assert points[0, 2] == np.float32(boxes[0, 2])  # what was given is as it was


def test_the_ground_is_a_plane_through_its_lift_at_the_centre():
    at = np.float32([[2, -1, 0], [12, -1, 0], [2, 9, 0], [12, 9, 0]])
    heights = np.array([tilted(at, np.zeros((0, 7)), CENTRE, np.random.default_rng(k))[0][:, 2] for k in range(800)])
    np.testing.assert_allclose(
        heights[:, 3] - heights[:, 0], heights[:, 1] + heights[:, 2] - 2 * heights[:, 0], atol=1e-6
    )
    assert heights[:, 0].std() == pytest.approx(LIFT, rel=0.1)
    for k in (1, 2):
        assert (heights[:, k] - heights[:, 0]).std() == pytest.approx(10 * SLOPE, rel=0.1)
