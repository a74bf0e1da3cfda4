"""Every search for the same time: what it found, what the detector says of it, and regret where the optimum is known.

    python tests/benchmarks/placement_env/bench_search.py SITE [--candidates paper|pool] [--fidelity surrogate]
        [--budget 4] [--seconds 60] [--frames 200] [--verify 50] [--seed 0] [--cache FOLDER] [--workers 2]
        [--methods ...]

--verify: frames that the detector scores the found sets on, 0 for none. Regret is of the reward in the fidelity that
was searched, against the best of all sets (up to 16 candidates).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

METHODS = (
    "exhaustive",
    "greedy",
    "swap",
    "cpsat",
    "cmaes",
    "ppo",
)
SEEING = ("cpsat", "cmaes")  # need to know what each candidate sees, which a table does not tell
MOST_EXHAUSTIVE = 16


def run(method: str, objective, asked: argparse.Namespace):
    module, _, function = (
        ("rl.training", "", "search")
        if method == "ppo"
        else (f"search.{method.partition('.')[0]}", "", method.partition(".")[2])
    )
    search = getattr(import_module(f"placement_env.{module}"), function or "search")
    return search(objective, asked.budget, seed=asked.seed, seconds=asked.seconds)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("site")
    arguments.add_argument("--candidates", choices=("paper", "pool"), default="pool")
    arguments.add_argument("--fidelity", choices=("coverage", "surrogate", "table"), default="surrogate")
    arguments.add_argument("--seconds", type=float, default=60.0)
    arguments.add_argument("--cache", type=Path)
    arguments.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    for name, default in (("budget", 4), ("frames", 200), ("verify", 50), ("seed", 0), ("workers", 2)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()

    from placement_env.candidates.pool import paper_candidates, pool
    from placement_env.objective import Objective
    from placement_env.search.verification import score_result
    from placement_env.setting import Setting
    from toolkit.runtime.run import Run
    from toolkit.sites.files import load_site

    site = load_site(asked.site)
    candidates = pool(site) if asked.candidates == "pool" else paper_candidates(site)
    start = perf_counter()
    common = Run(frames=asked.frames, seed=asked.seed, cache=asked.cache, workers=asked.workers)
    objective = Objective(Setting(site, candidates=candidates, fidelity=asked.fidelity), common)
    print(f"{len(candidates)} candidates over {asked.frames} frames prepared in {perf_counter() - start:.0f} s")
    if asked.verify:
        fresh = replace(common, frames=asked.verify, seed=asked.seed + 1)
        judge = Objective(Setting(site, candidates=candidates, fidelity="detector"), fresh)
    optimum = np.nan
    if len(candidates) <= MOST_EXHAUSTIVE:
        exhaustive = import_module("placement_env.search.exact.exhaustive")
        optimum = exhaustive.search(objective, asked.budget).best.reward
    print(f"{asked.site}, {asked.fidelity}, budget {asked.budget}, {asked.seconds:g} s each", flush=True)
    print(f"{'method':18s} {'reward':>8s} {'regret':>8s} {'detector AP':>12s} {'sets':>9s} {'s':>7s}  known")
    for method in asked.methods:
        if method == "exhaustive" and len(candidates) > MOST_EXHAUSTIVE:
            continue
        if method in SEEING and asked.fidelity == "table":
            continue
        found = run(method, objective, asked)
        ap = score_result(judge, found).ap if asked.verify else np.nan
        print(
            f"{method:18s} {found.best.reward:8.4f} {optimum - found.best.reward:8.4f} {ap:12.4f} "
            f"{found.evaluations:9d} {found.seconds:7.1f}  {found.certificate.kind}, {found.certificate.measure}",
            flush=True,
        )


if __name__ == "__main__":
    main()
