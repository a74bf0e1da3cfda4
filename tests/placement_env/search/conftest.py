"""Small objectives with known structure: coverage, which is monotone submodular, and an AP-like one, which is not."""

from dataclasses import dataclass

import numpy as np
import pytest

from placement_env.candidates import Axes, Candidates
from placement_env.fidelity import Estimate
from placement_env.objective import Objective, Weights
from toolkit.geometry import look
from toolkit.sensors import DepthCamera, Sensor
from toolkit.site import Mount

FREE = Weights()


def candidates_on(mounts, poses, *, capacity=2000.0, seed=0):
    """`poses` headings on each of `mounts` mounts, of random prices."""
    price = np.random.default_rng(seed).uniform(0.5, 2.0, mounts)
    posts = tuple(
        Mount(f"post{m}", np.array([10.0 * m, 0.0, 0.0]), price=float(price[m]), capacity=capacity)
        for m in range(mounts)
    )
    headings = np.linspace(0.0, 2 * np.pi, poses, endpoint=False)
    factors = np.array([(m, 0, h, 0, 0) for m in range(mounts) for h in range(poses)])
    sensors = tuple(
        Sensor(f"post{m}_h{h}", DepthCamera(), look((10.0 * m, 0.0, 5.0), float(headings[h])))
        for m, _, h, _, _ in factors
    )
    axes = Axes(np.array([5.0]), headings, np.array([0.0]), (DepthCamera(),))
    return Candidates(sensors, factors[:, 0].copy(), posts, factors, axes)


@dataclass
class Seen:
    """Share of objects that at least `views` sensors see: submodular for 1 view, not for more."""

    seen: np.ndarray
    sent: np.ndarray
    views: int = 1
    name: str = "coverage"
    calls: int = 0
    asked: int = 0

    def __call__(self, subsets):
        self.calls += 1
        self.asked += len(subsets)
        share = (subsets.astype(np.int64) @ self.seen.astype(np.int64) >= self.views).mean(axis=1)
        return Estimate(share, share, subsets @ self.sent)


def random_objective(mounts=6, poses=1, *, views=1, objects=60, seed=0, weights=FREE, capacity=2000.0, most=0.5):
    rng = np.random.default_rng(seed)
    candidates = candidates_on(mounts, poses, capacity=capacity, seed=seed)
    seen = rng.random((len(candidates), objects)) < rng.uniform(0.1 * most, most, (len(candidates), 1))
    sent = rng.uniform(100.0, 900.0, len(candidates))
    return Objective.of(candidates, Seen(seen, sent, views), "early", weights)


@pytest.fixture(scope="session")
def make():
    """Builds random objectives."""
    return random_objective
