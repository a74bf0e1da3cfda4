"""The surrogate of another paper, by what it says it counts."""

import numpy as np

from placement_env.fidelity.perception_entropy import PerceptionEntropy
from placement_env.fidelity.visibility import Visibility


def test_entropy_falls_with_the_points_on_a_vehicle(made_visibility):
    """More points on every vehicle are never worse, none at all are worth nothing."""
    seen = made_visibility(6, 40)
    sets = np.eye(6, dtype=bool)
    richer = Visibility(seen.points * 3, seen.distance, seen.frame, seen.boxes, seen.sent, seen.far)
    blind = Visibility(seen.points * 0, seen.distance, seen.frame, seen.boxes, seen.sent, seen.far)
    assert (PerceptionEntropy(richer)(sets).ap >= PerceptionEntropy(seen)(sets).ap).all()
    assert (PerceptionEntropy(richer)(sets).ap > PerceptionEntropy(seen)(sets).ap).any()
    assert not PerceptionEntropy(blind)(sets).ap.any()
