"""Score sensor sets your own way: any function from sets to AP, recall and kbit is a fidelity.

python examples/06_own_objective.py
"""

import numpy as np

from placement_env import (
    Estimate,
    Objective,
    Setting,
    Visibility,
    Weights,
    exhaustive,
    greedy,
    paper_candidates,
    see,
    simulate_traffic,
)
from toolkit import load_site


class SeenFromTwoSides:
    """How much of the traffic at least two sensors see well, what is near the middle counting
    most."""

    name = "seen from two sides"

    def __init__(self, seen: Visibility, middle: np.ndarray, least: float = 50.0) -> None:
        near = np.exp(-np.linalg.norm(seen.boxes[:, :2] - middle, axis=1) / 15.0)
        self.importance = near / near.sum()
        self.well = (seen.points >= least).astype(np.int64)
        self.kbit = seen.sent.mean(axis=1, dtype=np.float64) * 96 / 1000  # 96 bit a point

    def __call__(self, subsets: np.ndarray) -> Estimate:
        """subsets: a row of booleans for each set."""
        share = (subsets @ self.well >= 2) @ self.importance
        return Estimate(share, share, subsets @ self.kbit)


def main(frames: int = 6) -> None:
    """Every search takes it like the ones that come with coview."""
    site = load_site("tjunction")
    candidates = paper_candidates(site)
    seen = see(simulate_traffic(site, frames, seed=0), candidates)
    middle = site.area.reshape(2, 2).mean(axis=0)
    objective = Objective(
        Setting(
            candidates=candidates,
            fidelity=SeenFromTwoSides(seen, middle),
            weights=Weights(price=0.02),
        ),
        visibility=seen,
    )
    print(exhaustive.search(objective, budget=3))
    print(greedy.search(objective, budget=3))


if __name__ == "__main__":
    main()
