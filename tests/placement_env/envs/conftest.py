"""An objective of made-up vehicles, scored in no time."""

from collections.abc import Callable

import numpy as np
import pytest

from placement_env.candidates.candidates import pool
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.setting import Setting, Weights
from toolkit.sites.site import Mount, Site

SITE = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
BOTH = Weights(0.0001, 0.01)


def covered(
    weights: Weights = BOTH, mounts: int = 3, headings: int = 2, capacity: float = 2000.0
) -> Objective:
    """Coverage of 60 made-up vehicles in 10 frames."""
    poles = [
        Mount(f"m{i}", np.array([10.0 * i - 10, 12.0, 0.0]), capacity=capacity)
        for i in range(mounts)
    ]
    some = pool(SITE, heights=(5.0,), headings=headings, tilts=(0.3,), mounts=poles, blind=True)
    rng = np.random.default_rng(0)
    shape = (len(some), 60)
    points = (rng.integers(0, 200, shape) * (rng.random(shape) < 0.3)).astype(np.float32)
    boxes = np.column_stack(
        [rng.uniform(-20, 20, (60, 2)), np.ones(60), np.full((60, 3), 2.0), np.zeros(60)]
    )
    sent = rng.integers(1000, 9000, (len(some), 10)).astype(np.float32)
    near = rng.uniform(5, 40, shape).astype(np.float32)
    seen = Visibility(points, near, np.arange(60) // 6, boxes, sent, sent / 2)
    return Objective(
        Setting(SITE, candidates=some, fidelity=Coverage(seen), scheme="early", weights=weights),
        visibility=seen,
    )


@pytest.fixture(scope="session")
def objective() -> Callable[..., Objective]:
    """Makes one of weights, how many mounts and headings, and what a link carries."""
    return covered
