"""CMA-ES and gradient ascent from greedy's set in equal time, in panoramas and by rays, beside searches of the pool.

python tests/benchmarks/placement_env/bench_poses.py tjunction --frames 12 --seconds 25 --budget 3 --iou 0.9
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3]))

from placement_env.objective import Objective
from placement_env.search import cmaes, gradient, greedy
from placement_env.search.exact import cpsat
from placement_env.search.result import Result


def show(name: str, result: Result) -> None:
    """One line of figures."""
    print(
        f"{name:<24} reward {result.best.reward:.4f}, start {result.history.reward[0]:.4f}, "
        f"{result.evaluations} evaluations, {result.seconds:.1f} s",
        flush=True,
    )


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("site")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=25.0)
    parser.add_argument("--budget", type=int, default=3)
    parser.add_argument("--iou", type=float, default=0.9)
    asked = parser.parse_args()
    objective = Objective(asked.site, asked.frames, candidates="pool", iou=asked.iou)
    made = objective.preparation
    assert made is not None
    show("greedy", greedy.search(objective, asked.budget))
    show("CP-SAT", cpsat.search(objective, asked.budget, seconds=asked.seconds))
    for way in ("panoramas", "rays"):
        if way == "rays":
            vars(made)["live"] = None
        for seed in (0, 1):
            show(f"CMA-ES, {way}", cmaes.search(objective, asked.budget, seed=seed, seconds=asked.seconds))
            show(f"gradient, {way}", gradient.search(objective, asked.budget, seed=seed, seconds=asked.seconds))


if __name__ == "__main__":
    main()
