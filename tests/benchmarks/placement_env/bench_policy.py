"""One policy trained over many random junctions, and tried on junctions it never saw against greedy search.

    python tests/benchmarks/placement_env/bench_policy.py [--train 40] [--test 12] [--poses 96] [--frames 20]
        [--budget 4] [--minutes 10] [--out FOLDER]

Every junction has as many random poses of its own pool as candidates, scored by the surrogate on traffic of its own.
The policy plays one episode, likeliest actions first, and then others until it has had the seconds that greedy took;
rewards are AP as the surrogate predicts it, times without rendering.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

UNSEEN = 9000  # random junctions from this seed on are for the test only
FRESH = 1000  # episodes at most, within greedy's seconds


def some_poses(count: int) -> Callable:
    """Candidates of a site: so many poses of its pool, drawn by its name."""

    def of_site(site):
        from placement_env.candidates.pool import pool

        every = pool(site)
        rng = np.random.default_rng(list(site.name.encode()))
        return every.select(np.sort(rng.choice(len(every), min(count, len(every)), replace=False)))

    return of_site


def play(policy, env, site, seconds: float):
    """The first episode's reward, the best one's within the seconds, episodes and seconds of the first."""
    from placement_env.rl.training import rollout

    start = perf_counter()
    first = rollout(policy, env, options={"site": site})
    took = perf_counter() - start
    best = rollout(policy, env, episodes=FRESH, seconds=seconds, options={"site": site})
    return first.best.reward, best.best.reward, took


def random_set(objective, budget: int, rng: np.random.Generator) -> float:
    """Reward of random candidates, one to a mount."""
    chosen: list[int] = []
    while len(chosen) < budget and (allowed := np.flatnonzero(objective.allowed(chosen))).size:
        chosen.append(int(rng.choice(allowed)))
    return objective.score(chosen).reward


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("train", 40), ("test", 12), ("poses", 96), ("frames", 20), ("budget", 4), ("seed", 0)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    arguments.add_argument("--minutes", type=float, default=10.0)
    arguments.add_argument("--out", type=Path)
    asked = arguments.parse_args()

    from placement_env.envs.select import SensorSelectEnv
    from placement_env.rl.training import Learning, train_policy
    from placement_env.search import greedy
    from toolkit.sites.random import random_site

    seen, unseen = ([random_site(first + k) for k in range(n)] for first, n in ((0, asked.train), (UNSEEN, asked.test)))
    common = {"frames": asked.frames, "budget": asked.budget, "candidates": some_poses(asked.poses)}
    start = perf_counter()
    env = SensorSelectEnv(site=seen, slots=asked.poses, **common)
    for site in seen:
        env.reset(options={"site": site})
    print(f"{asked.train} junctions prepared in {perf_counter() - start:.0f} s", flush=True)

    def told(steps: int, mean: float) -> None:
        if steps % 20480 == 0:
            print(f"{steps:8d} steps, mean return {mean:.4f}", flush=True)

    learning = Learning(learning_rate=1e-3, batch=256, width=64, augment=True)
    with TemporaryDirectory() as folder:
        policy = train_policy(
            lambda: env, asked.out or Path(folder), seconds=60 * asked.minutes, seed=asked.seed, learning=learning,
            progress=told,
        )  # fmt: skip
    tried = SensorSelectEnv(site=unseen, slots=asked.poses, **common)
    rng, rows = np.random.default_rng(asked.seed), []
    print(f"{'junction':14s} {'random':>7s} {'greedy':>7s} {'ms':>6s} {'policy':>7s} {'ms':>6s} {'same time':>9s}")
    for site in unseen:
        tried.reset(options={"site": site})
        objective = tried.placement()[0]
        objective.forget()
        begun = perf_counter()
        best = greedy.search(objective, asked.budget)
        seconds = perf_counter() - begun
        objective.forget()
        first, same_time, took = play(policy, tried, site, seconds)
        chance = np.mean([random_set(objective, asked.budget, rng) for _ in range(20)])
        rows.append((chance, best.best.reward, 1e3 * seconds, first, 1e3 * took, same_time))
        print("{:14s} {:7.4f} {:7.4f} {:6.0f} {:7.4f} {:6.0f} {:9.4f}".format(site.name, *rows[-1]), flush=True)
    print("{:14s} {:7.4f} {:7.4f} {:6.0f} {:7.4f} {:6.0f} {:9.4f}".format("mean", *np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
