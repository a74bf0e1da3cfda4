"""Surrogates of other papers, by what they say they count."""

import numpy as np

from placement_env.fidelity.published_surrogates import InformationGain, PerceptionEntropy
from placement_env.fidelity.visibility import Visibility


def test_information_gain_counts_the_cells_that_are_uncertain():
    """Two places: one always occupied, one in half of the frames; only the second is worth seeing."""
    boxes = np.array([[0, 0, 0.7, 4, 2, 1.5, 0], [30, 0, 0.7, 4, 2, 1.5, 0], [0, 0, 0.7, 4, 2, 1.5, 0]], np.float64)
    seen = Visibility(
        np.array([[9, 0, 9], [0, 9, 0]], np.float32),
        np.full((2, 3), 9, np.float32),
        np.array([0, 0, 1]),
        boxes,
        np.ones((2, 2), np.float32),
        np.ones((2, 2), np.float32),
    )
    np.testing.assert_allclose(InformationGain(seen)(np.eye(2, dtype=bool)).ap, [0, 1])


def test_entropy_falls_with_the_points_on_a_vehicle(made_visibility):
    """More points on every vehicle are never worse, none at all are worth nothing."""
    seen = made_visibility(6, 40)
    sets = np.eye(6, dtype=bool)
    richer = Visibility(seen.points * 3, seen.distance, seen.frame, seen.boxes, seen.sent, seen.far)
    blind = Visibility(seen.points * 0, seen.distance, seen.frame, seen.boxes, seen.sent, seen.far)
    assert (PerceptionEntropy(richer)(sets).ap >= PerceptionEntropy(seen)(sets).ap).all()
    assert (PerceptionEntropy(richer)(sets).ap > PerceptionEntropy(seen)(sets).ap).any()
    assert not PerceptionEntropy(blind)(sets).ap.any()
