"""What a surrogate that knows points alone cannot know: standing things that the detector takes for vehicles.

    python tests/benchmarks/placement_env/bench_alarms.py ROWS.jsonl [--seeds 9101 9103 ...] [--cache FOLDER]

At drawn junctions the detector `general` scores sets of a pool of 60 poses: what greedy and swap find by surrogate and
perception entropy, and random ones, on one frame of each of 12 blocks of traffic. Beside it stands what it detects at
each candidate of these sets where nobody drives. A hit model is fitted to all sites but one, whose AP is then predicted
with the expected false alarms of the model alone, and with those that stand: of each place the highest score that any
member of a set gives it, counted in each frame before the objects that are hit less surely than that. Rows are kept in
ROWS.jsonl, so that a run that was killed goes on; drawn junctions above 6500 m² are left out.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from placement_env.setting import Setting

sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parent)]

from bench_regret import Rows  # noqa: E402
from bench_surrogate import spearman  # noqa: E402

SEEDS = (*range(9101, 9112), *range(52801, 52805))
MODELS: tuple[tuple[str, ...], ...] = (
    (), ("solid-state-lidar",), (), ("spinning-lidar",), (), ("depth-camera", "solid-state-lidar", "spinning-lidar")
)  # fmt: skip
FRAMES, POSES, LARGEST, APART = 12, 60, 6500.0, 2.0  # of different blocks; m², m
RATES = (0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 1.7, 2.2)  # of false alarms, that are tried
Row = dict[str, Any]


def row_of(seed: int, place: int, cache: Path) -> Row:
    """One site: the sets, what their members see, which objects they hit, their AP, and the alarms of each member."""
    from models.detector import load_detector
    from placement_env.candidates.pool import pool
    from placement_env.fidelity.detector import Detected
    from placement_env.fidelity.renders import Renders
    from placement_env.fidelity.seeing import see
    from placement_env.fidelity.traffic import simulate_traffic
    from toolkit.objects import VEHICLE
    from toolkit.points import detect_on_ground
    from toolkit.runtime.cache import Cache
    from toolkit.sensors.models import find_model
    from toolkit.sites.random import random_site

    site, rng = random_site(seed), np.random.default_rng(seed)
    if (site.area[2] - site.area[0]) * (site.area[3] - site.area[1]) > LARGEST:
        return {"seed": seed, "sets": []}
    named = tuple(map(find_model, MODELS[place % len(MODELS)]))
    every = pool(site, models=named) if named else pool(site)
    candidates = every.select(np.sort(rng.choice(len(every), min(POSES, len(every)), replace=False)))
    traffic = simulate_traffic(site, 4 * FRAMES, seed)
    empty = traffic.snapshots[0]
    empty = replace(empty, objects=empty.objects[np.zeros(0, np.int64)], bodies=empty.bodies[:0])
    traffic = replace(traffic, snapshots=traffic.snapshots[::4])
    seen = see(traffic, candidates)
    searched, drawn = _sets(site, candidates, seen, rng)
    sets = list(dict.fromkeys([*searched, *drawn]))
    rows = np.zeros((len(sets), len(candidates)), bool)
    for row, members in zip(rows, sets, strict=True):
        row[list(members)] = True
    detector = load_detector("general", area=site.area)
    detected = Detected(Renders(traffic, candidates), detector, "early", memo=Cache(cache / "cache.sqlite"))
    alone, alarms = Renders(replace(traffic, snapshots=(empty,)), candidates), {}
    for c in sorted({c for members in sets for c in members}):
        found = detect_on_ground(detector, alone.clouds(0, c), site)
        own = found.labels == VEHICLE
        alarms[c] = np.column_stack([found.boxes[own, :2], found.scores[own]]).round(3).tolist()
    return {
        "seed": seed, "sets": sets, "searched": len(searched), "ap": detected(rows).ap.tolist(), "alarms": alarms,
        "hits": [np.flatnonzero(detected.hits(row).hit[0]).tolist() for row in rows],
        "points": {c: seen.points[c].tolist() for c in alarms}, "distance": {
            c: seen.distance[c].round(2).tolist() for c in alarms
        },
        "yaw": seen.boxes[:, 6].round(4).tolist(), "frame": seen.frame.tolist(),
    }  # fmt: skip


def _sets(site: Any, candidates: Any, seen: Any, rng: np.random.Generator) -> tuple[list[Any], list[Any]]:
    """What searches find of 1 to 4 sensors, and random sets of eight of the candidates."""
    from placement_env.fidelity.surrogate import Surrogate
    from placement_env.objective import Objective
    from placement_env.search import greedy, swap
    from placement_env.search.portfolio.entrants import entropy_objective

    fast = Surrogate(seen, "early", radius=site.hybrid_radius)
    objective = Objective(Setting(site, candidates=candidates, fidelity=fast, scheme="early"), visibility=seen)
    found = [greedy.search(objective, k).best.subset for k in (1, 2, 3, 4)]
    for each in (objective, entropy_objective(objective)):
        found += [swap.search(each, k, evaluations=8000).best.subset for k in (2, 3)]
    group = rng.permutation(len(candidates))
    _, first = np.unique(candidates.mount[group], return_index=True)
    group = group[np.sort(first)][:8]
    drawn = [rng.choice(group, min(k, len(group)), replace=False).tolist() for k in (1, 1, 2, 2, 3, 3, 4, 5)]
    return list(dict.fromkeys(tuple(sorted(each)) for each in found if each)), [tuple(sorted(each)) for each in drawn]


def observed(row: Row) -> Any:
    """A row as `placement_env.fidelity.hit_fit.fit` takes it: its own members only."""
    from placement_env.fidelity.hit_fit import Observed
    from placement_env.fidelity.visibility import Visibility

    members = sorted(map(int, row["points"]))
    points, distance = (np.array([row[name][str(c)] for c in members], np.float32) for name in ("points", "distance"))
    boxes = np.zeros((points.shape[1], 7))
    boxes[:, 6] = row["yaw"]
    nothing = np.zeros((len(members), FRAMES), np.float32)
    seen = Visibility(points, distance, np.array(row["frame"], np.int64), boxes, nothing, nothing)
    subsets = np.array([np.isin(members, each) for each in row["sets"]])
    hits = np.array([np.isin(np.arange(points.shape[1]), each) for each in row["hits"]])
    return Observed(seen, subsets, hits, np.array(row["ap"]))


def standing(row: Row, members: list[int]) -> np.ndarray:
    """The highest score of each place where nobody drives, of places `APART` m or more from each other."""
    places: list[np.ndarray] = []
    scores: list[float] = []
    for x, y, score in (alarm for c in members for alarm in row["alarms"][str(c)]):
        near = [i for i, at in enumerate(places) if np.hypot(*(at - (x, y))) < APART]
        if near:
            scores[near[0]] = max(scores[near[0]], score)
        else:
            places.append(np.array([x, y]))
            scores.append(score)
    return np.array(scores)


def expected(p: np.ndarray, alarms: np.ndarray, rate: float) -> float:
    """AP of objects that are hit with probabilities p, with false alarms of the model's rate and those that stand."""
    p = -np.sort(-p)
    hits, rank = np.cumsum(p), np.arange(1, len(p) + 1)
    before = FRAMES * (alarms[None] > p[:, None]).sum(axis=1)
    return float((p * hits / np.maximum(hits + rate * (rank - hits) + before, 1e-9)).mean())


def predicted(row: Row, model: Any, rate: float, *, known: bool) -> np.ndarray:
    """AP of each set of a site. known: whether the alarms that stand are."""
    from placement_env.fidelity.surrogate import Evidence
    from toolkit.detection.schemes import find_scheme

    each = observed(row)
    evidence = Evidence(each.visibility, find_scheme("early"), each.radius)
    powers, raw = evidence.joined(each.subsets.astype(np.float32) @ evidence.rows(model), model)
    p = model.probability(powers, raw)
    alarms = [standing(row, members) if known else np.zeros(0) for members in row["sets"]]
    return np.array([expected(one.astype(np.float64), own, rate) for one, own in zip(p, alarms, strict=True)])


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("rows", type=Path)
    arguments.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    arguments.add_argument("--cache", type=Path, default=Path("out/alarms"))
    asked = arguments.parse_args()

    from placement_env.fidelity.hit_fit import fit

    rows = Rows(asked.rows)
    for place, seed in enumerate(asked.seeds):
        if not rows.find(seed=seed):
            rows.add(**json.loads(json.dumps(row_of(seed, place, asked.cache))))
            print(f"{seed}: {len(rows.rows[-1]['sets'])} sets", flush=True)
    sites = [row for row in rows.rows if row["seed"] in asked.seeds and row["sets"]]
    print("  site places  |error|, of searched sets, Spearman: with the model's alarms alone, with those that stand")
    found = []
    for row in sites:
        others = [other for other in sites if other is not row]
        model = fit([observed(other) for other in others], scheme="early", iou=0.7)
        figures: list[float] = []
        for known in (False, True):
            tried = [
                np.concatenate([np.abs(predicted(other, model, rate, known=known) - other["ap"]) for other in others])
                for rate in RATES
            ]
            rate = RATES[int(np.argmin([each.mean() for each in tried]))]
            ap = predicted(row, model, rate, known=known)
            error = np.abs(ap - row["ap"])
            figures += [error.mean(), error[: row["searched"]].mean(), float(spearman(ap, np.array(row["ap"])))]
        found.append(figures)
        places = len(standing(row, sorted({c for members in row["sets"] for c in members})))
        print(f"{row['seed']:6d} {places:6d}  {_written(figures)}", flush=True)
    print(f"{'mean':>6s} {'':6s}  {_written(np.mean(found, axis=0))}")


def _written(figures: Any) -> str:
    return "   ".join(" ".join(f"{each:.3f}" for each in part) for part in (figures[:3], figures[3:]))


if __name__ == "__main__":
    main()
