"""What sensors see of vehicles: made up, and of the small junction; a model of a detector's hits."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.fidelity.hits.hit_model import HitModel
from placement_env.fidelity.visibility import Visibility, see


def random_visibility(candidates=12, objects=300, frames=20, seed=0):
    rng = np.random.default_rng(seed)
    shape = (candidates, objects)
    points = np.where(rng.random(shape) < 0.3, np.rint(rng.lognormal(4, 1.5, shape)), 0).astype(np.float32)
    boxes = np.column_stack(
        [rng.uniform(-30, 30, (objects, 2)), np.tile([0.7, 4.4, 1.8, 1.5], (objects, 1)), rng.uniform(-3, 3, objects)]
    )
    sent, far = (rng.integers(100, 5000, (candidates, frames)).astype(np.float32) for _ in range(2))
    distance = rng.uniform(5, 60, shape).astype(np.float32)
    return Visibility(points, distance, np.sort(rng.integers(0, frames, objects)), boxes, sent, far)


@pytest.fixture(scope="session")
def made_visibility():
    """Makes it up, of as many candidates, objects and frames as asked for."""
    return random_visibility


@pytest.fixture(scope="session")
def hit_model():
    return HitModel("early", 0.7, -4.0, 1.8, 0.98, 0.7, 0.3, "made up", 0.3, 0.6)


@pytest.fixture(scope="session")
def hit_models(hit_model):
    """One for each of the paper's schemes."""
    return {
        "early": hit_model,
        "late": replace(hit_model, scheme="late", norm=6.0),
        "hybrid": replace(hit_model, scheme="hybrid", norm=4.0),
    }


@pytest.fixture(scope="session")
def seen(small_traffic, small_candidates):
    return see(small_traffic, small_candidates)
