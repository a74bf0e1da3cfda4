"""Whether swap search finds better sets when it starts from what the map policy proposes, at equal evaluations.

    python tests/benchmarks/placement_env/bench_map_start.py [--first 30000] [--junctions 10] [--folder out/junctions]
        [--policy FILE] [--budgets 2 3 4]

Junctions, traffic and judgement as of `bench_map_policy.py`. Limits are in multiples of the sets that greedy search
scores; "starts" is five starts without a limit, as in a portfolio. drawn: greedy's set, then drawn ones; proposal: the
proposed set between these; proposal first: the proposed set, then drawn ones.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parent)]

from bench_map_policy import looked_at, objective_for  # noqa: E402

TIMES = (1.5, 2.0, 3.0, 4.0, 8.0)
STARTS = "starts"
WAYS = ("drawn", "proposal", "proposal first")


def tried(seed: int, asked, policy) -> list[dict]:
    """A row for each budget at one junction."""
    from placement_env.envs.maps.junctions import prepare
    from placement_env.rl.maps.map_starts import MapStarts
    from placement_env.search import greedy, swap

    junction = prepare(seed, asked.folder)
    visibility, _ = looked_at(seed, junction, asked.folder / "searched")
    searched, judged = objective_for(junction, visibility), objective_for(junction, junction.visibility)
    starts, rows = MapStarts(policy), []
    for budget in asked.budgets:
        proposed = starts(searched, budget).members
        grown = greedy.search(searched, budget)
        row = {"seed": seed, "budget": budget, "greedy sets": grown.evaluations}
        for name, members in (("proposed", proposed), ("greedy", grown.best.subset)):
            row |= {name: searched.score(members).reward, f"{name}, fresh": judged.score(members).ap}
        ways = dict(zip(WAYS, ({}, {"also": [proposed]}, {"start": proposed}), strict=True))
        for times in (*TIMES, STARTS):
            limits = {"starts": swap.STARTS} if times == STARTS else {"evaluations": int(times * grown.evaluations)}
            for name, settings in ways.items():
                found = swap.search(searched, budget, **limits, **settings)
                row |= {
                    f"{times} {name}": found.best.reward,
                    f"{times} {name}, fresh": judged.score(found.best.subset).ap,
                    f"{times} {name}, sets": found.evaluations / grown.evaluations,
                }
        rows.append(row)
    return rows


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--first", type=int, default=30000)
    arguments.add_argument("--junctions", type=int, default=10)
    arguments.add_argument("--budgets", type=int, nargs="+", default=[2, 3, 4])
    arguments.add_argument("--folder", type=Path, default=Path("out/junctions"))
    arguments.add_argument("--policy", type=Path)
    asked = arguments.parse_args()
    from placement_env.rl.maps.map_policy import SHIPPED_POLICY, MapPolicy

    policy, rows = MapPolicy.load(asked.policy or SHIPPED_POLICY), []
    for seed in range(asked.first, asked.first + asked.junctions):
        rows += tried(seed, asked, policy)
        for row in rows[-len(asked.budgets) :]:
            print(json.dumps({name: round(value, 6) for name, value in row.items()}), flush=True)
    for name in ("proposed", "greedy"):
        print(f"{name:30s} {_mean(rows, name):.4f}, on fresh traffic {_mean(rows, f'{name}, fresh'):.4f}")
    for times in (*TIMES, STARTS):
        for name in WAYS:
            more = np.array([row[f"{times} {name}"] - row[f"{times} drawn"] for row in rows])
            print(
                f"{times!s:7s}{name:23s} {_mean(rows, f'{times} {name}'):.4f}, on fresh traffic "
                f"{_mean(rows, f'{times} {name}, fresh'):.4f}; better {(more > 1e-9).sum()}, worse "
                f"{(more < -1e-9).sum()} of {len(rows)}; {_mean(rows, f'{times} {name}, sets'):.1f} times greedy's sets"
            )


def _mean(rows: list[dict], name: str) -> float:
    return float(np.mean([row[name] for row in rows]))


if __name__ == "__main__":
    main()
