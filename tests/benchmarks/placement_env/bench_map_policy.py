"""A policy that knows the map alone, tried on random junctions it never saw, against searches that look first.

    python tests/benchmarks/placement_env/bench_map_policy.py [--first 30000] [--junctions 40] [--folder out/junctions]
        [--policy FILE] [--budgets 2 3 4]
    python tests/benchmarks/placement_env/bench_map_policy.py --compare runs/policy/imitated.safetensors [FILE ...]
    python tests/benchmarks/placement_env/bench_map_policy.py --traffic [--first 0] [--junctions 300] [--folder ...]

Searches look at 24 frames of traffic of their own (seed + 500000, kept in FOLDER/searched with the CPU seconds it
took); every set is judged by the surrogate on the 16 frames of the junction's files, which no search saw. A sensor
whose link does not carry what it sends is left out of a set. Seconds are of the process.

"links seen" is the policy that is told, of the sensors it answers with alone, what they send, and answers again; "look
s" is what it takes to find out, by rendering the empty site from these sensors once.
map: the set that covers most traffic by the map's own figures, without a network. shortlist: greedy search over the 48
candidates that the policy likes best, places that are not among them never looked from.
--compare: of policies alone, beside the shipped one and greedy search, without swaps and with them: the mean over
budgets of what each has more, with its standard error over junctions. coview teach trains such policies.
--traffic: fits what `placement_env.candidates.outlook.ground_plan.TRAFFIC` says.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

SEARCHED, LATER = 24, 500_000
SHORT = 48
WAYS = ("no swaps", "swaps", "links seen, no swaps", "links seen, swaps")
COLUMNS = (
    "random",
    "map",
    "policy, no swaps",
    "policy",
    "policy, links seen",
    "shortlist",
    "greedy",
    "swap",
    "swap from policy",
)


def looked_at(seed: int, junction, folder: Path):
    """What the candidates see of the traffic that searches look at, and the seconds it took to find out."""
    from placement_env.fidelity.traffic import simulate_traffic
    from placement_env.fidelity.visibility import Visibility, see

    folder.mkdir(exist_ok=True)
    path, times = folder / f"{seed}.npz", folder / f"{seed}.json"
    if not times.exists():
        begun = process_time(), perf_counter()
        traffic = simulate_traffic(junction.site, SEARCHED, seed + LATER)
        see(traffic, junction.candidates, rendering="panorama").save(path)
        times.write_text(json.dumps({"cpu": process_time() - begun[0], "wall": perf_counter() - begun[1]}))
    return Visibility.load(path), json.loads(times.read_text())["cpu"]


def objective_for(junction, visibility):
    """Early fusion, AP at IoU 0.7."""
    from placement_env.fidelity.surrogate import Surrogate
    from placement_env.objective import Objective

    scored_by = Surrogate(visibility, "early", radius=junction.site.hybrid_radius)
    return Objective.of(junction.candidates, scored_by, "early", site=junction.site, visibility=visibility)


def by_the_map(known, candidates, budget: int) -> list[int]:
    """Greedy over the traffic in cells where a candidate's rays, as far as solids let them through, exceed 20."""
    from placement_env.candidates.outlook.outlook import MOST_RAYS, VIEW

    rays, clear = (known.view[..., VIEW.index(name)] for name in ("rays", "clear"))
    sees = np.expm1(rays * np.log1p(MOST_RAYS)) * clear > 20
    weight, chosen, covered = known.plan.traffic[known.plan.used], [], np.zeros(sees.shape[1], bool)
    for _ in range(budget):
        gain = (sees & ~covered) @ weight - 1e9 * np.isin(candidates.mount, candidates.mount[chosen])
        chosen.append(int(gain.argmax()))
        covered |= sees[chosen[-1]]
    return chosen


def random_set(objective, budget: int, rng: np.random.Generator) -> list[int]:
    """Candidates drawn one after the other."""
    chosen: list[int] = []
    while len(chosen) < budget and (allowed := np.flatnonzero(objective.allowed(chosen))).size:
        chosen.append(int(rng.choice(allowed)))
    return chosen


def over_some(junction, visibility, some: np.ndarray, budget: int) -> list[int]:
    """Greedy search over some of the candidates."""
    from placement_env.envs.maps.junctions import Junction
    from placement_env.search import greedy

    part = Junction(junction.site, junction.candidates.select(some), visibility.select(some))
    return some[list(greedy.search(objective_for(part, part.visibility), budget).best.subset)].tolist()


def tried(seed: int, asked, policy, budgets) -> list[dict]:
    """A row for each budget at one junction."""
    from placement_env.candidates.outlook.outlook import outlook
    from placement_env.envs.maps.junctions import prepare
    from placement_env.envs.maps.terms import Terms
    from placement_env.fidelity.traffic import Traffic
    from placement_env.fidelity.visibility import see
    from placement_env.search import greedy, swap
    from toolkit.objects import Objects
    from toolkit.traffic.snapshots import Snapshot

    empty = Snapshot(Objects(np.zeros((0, 7)), np.zeros(0, np.int64)), np.zeros(0, np.int64), 0.0)
    junction = prepare(seed, asked.folder)
    visibility, prepared_s = looked_at(seed, junction, asked.folder / "searched")
    searched, judged = objective_for(junction, visibility), objective_for(junction, junction.visibility)
    rng, rows = np.random.default_rng(seed), []
    for budget in budgets:
        begun = process_time()
        known = outlook(junction.site, junction.candidates)
        outlook_s = process_time() - begun
        terms, begun = Terms.plain(junction.candidates, budget), process_time()
        swapped = policy.answer_to(known, terms)
        answer_s, begun = process_time() - begun, process_time()
        searched.forget()
        chosen = list(greedy.search(searched, budget).best.subset)
        greedy_s = process_time() - begun
        some = policy.shortlist(known, terms, SHORT)
        plain = policy.answer_to(known, terms, swaps=0)
        sets = {
            "map": by_the_map(known, junction.candidates, budget),
            "policy, no swaps": list(plain.members),
            "policy": list(swapped.members),
            "policy, links seen": list(
                policy.answer_checked(known, terms, lambda some: searched.sent[list(some)]).members
            ),
            "shortlist": over_some(junction, visibility, some, budget),
            "greedy": chosen,
            "swap": list(swap.search(searched, budget, starts=1).best.subset),
            "swap from policy": list(swap.search(searched, budget, starts=1, start=swapped.members).best.subset),
        }
        built = {name: [c for c in members if searched.linked[c]] for name, members in sets.items()}
        chance = [judged.score(random_set(searched, budget, rng)).ap for _ in range(20)]
        places = [len(np.unique(junction.candidates.mount[each])) for each in (some, slice(None))]
        begun = process_time()
        see(Traffic(junction.site, (), (empty,)), junction.candidates.select(sorted(swapped.members)), rendering="full")
        looking_s = process_time() - begun
        rows.append(
            {"seed": seed, "budget": budget, "random": float(np.mean(chance))}
            | {name: judged.score(members).ap for name, members in built.items()}
            | {"refused": len(sets["policy"]) - len(built["policy"]), "predicted": swapped.ap}
            | {"share of places": places[0] / places[1], "outlook s": outlook_s, "answer s": answer_s}
            | {
                "look s": looking_s,
                "preparation s": prepared_s,
                "greedy s": greedy_s,
                "candidates": len(junction.candidates),
            }
        )
    return rows


def fitted_traffic(asked) -> None:
    """Print weights of `TRAFFIC`."""
    from scipy.optimize import nnls

    from placement_env.candidates.outlook.ground_plan import ground_plan
    from placement_env.envs.maps.junctions import prepare

    figures, counts = [], []
    for seed in range(asked.first, asked.first + asked.junctions):
        junction = prepare(seed, asked.folder, frames=asked.frames, places=asked.places)
        plan, seen = ground_plan(junction.site), junction.visibility
        cells = plan.cells_at(seen.boxes[:, :2])
        figures.append(plan.metres[plan.used])
        counts.append((np.bincount(cells[cells >= 0], minlength=len(plan.metres)) / seen.frames)[plan.used])
    print(nnls(np.concatenate(figures), np.concatenate(counts))[0].round(4).tolist(), len(figures), "junctions")


def places(asked) -> list:
    """Junctions with their outlook, the objective that is searched, the one that judges, and what greedy reaches."""
    from placement_env.candidates.outlook.outlook import outlook
    from placement_env.envs.maps.junctions import prepare
    from placement_env.rl.maps.held_out import built_ap
    from placement_env.search import greedy

    found = []
    for seed in range(asked.first, asked.first + asked.junctions):
        junction = prepare(seed, asked.folder)
        seen, _ = looked_at(seed, junction, asked.folder / "searched")
        searched, judged = objective_for(junction, seen), objective_for(junction, junction.visibility)
        reached = [
            built_ap(judged, greedy.search(searched, budget).best.subset, searched.linked) for budget in asked.budgets
        ]
        found.append((junction, outlook(junction.site, junction.candidates), searched, judged, reached))
    return found


def reached_by(policy, found: list, budgets: list[int]) -> np.ndarray:
    """AP (junction, budget, way)."""
    from placement_env.envs.maps.terms import Terms
    from placement_env.rl.maps.held_out import built_ap

    ap = np.zeros((len(found), len(budgets), len(WAYS)))
    for k, (junction, known, searched, judged, _) in enumerate(found):
        for b, budget in enumerate(budgets):
            terms = Terms.plain(junction.candidates, budget)
            bare = [policy.answer_to(known, terms, swaps=swaps) for swaps in (0, 2)]
            seen = [
                policy.answer_checked(known, terms, lambda some, of=searched: of.sent[list(some)], swaps=swaps)
                for swaps in (0, 2)
            ]
            ap[k, b] = [built_ap(judged, answer.members, searched.linked) for answer in (*bare, *seen)]
    return ap


def printed(differences: np.ndarray) -> str:
    """Mean and standard error of each way."""
    means, errors = differences.mean(axis=0), differences.std(axis=0, ddof=1) / np.sqrt(len(differences))
    return "   ".join(f"{mean:+.4f} ± {error:.4f}" for mean, error in zip(means, errors, strict=True))


def compared(asked) -> None:
    """Print what policies reach."""
    from placement_env.rl.maps.map_policy import SHIPPED_POLICY, MapPolicy

    found = places(asked)
    greedy = np.array([reached for *_, reached in found])
    print("greedy", greedy.mean(axis=0).round(4).tolist(), "with", asked.budgets, "sensors", flush=True)
    before: list[np.ndarray] = []
    for path in (SHIPPED_POLICY, *asked.compare):
        policy = MapPolicy.load(path)
        ap = reached_by(policy, found, asked.budgets)
        print(f"\n{path}: {policy.source}\n{'':9s} {', '.join(WAYS)}")
        for budget, row in zip(asked.budgets, ap.mean(axis=0), strict=True):
            print(f"{budget} sensors", *(f"{each:.4f}" for each in row))
        for name, other in zip(("shipped", *(each.stem for each in asked.compare)), before, strict=False):
            print(f"more than {name:8s}", printed((ap - other).mean(axis=1)))
        before.append(ap)
        print("more than greedy  ", printed((ap - greedy[..., None]).mean(axis=1)), flush=True)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("first", 30000), ("junctions", 40), ("frames", 16), ("places", 12)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    arguments.add_argument("--budgets", type=int, nargs="+", default=[2, 3, 4])
    arguments.add_argument("--folder", type=Path, default=Path("out/junctions"))
    arguments.add_argument("--policy", type=Path)
    arguments.add_argument("--compare", type=Path, nargs="+")
    arguments.add_argument("--traffic", action="store_true")
    asked = arguments.parse_args()
    if asked.compare:
        compared(asked)
        return
    if asked.traffic:
        fitted_traffic(asked)
        return
    from placement_env.rl.maps.map_policy import SHIPPED_POLICY, MapPolicy

    policy, rows = MapPolicy.load(asked.policy or SHIPPED_POLICY), []
    for seed in range(asked.first, asked.first + asked.junctions):
        rows += tried(seed, asked, policy, asked.budgets)
        for row in rows[-len(asked.budgets) :]:
            print(json.dumps({name: round(v, 4) for name, v in row.items()}), flush=True)
    for budget in asked.budgets:
        of_budget = [row for row in rows if row["budget"] == budget]
        print(f"\n{budget} sensors, mean of {len(of_budget)} junctions (and standard error of what greedy has more)")
        for name in COLUMNS:
            ap, best = (np.array([row[each] for row in of_budget]) for each in (name, "greedy"))
            error = (best - ap).std(ddof=1) / np.sqrt(len(ap))
            print(
                f"{name:18s} {ap.mean():.4f}   {(best - ap).mean():+.4f} ± {error:.4f}  worst {(best - ap).max():+.4f}"
            )
    for name in (
        "outlook s",
        "answer s",
        "look s",
        "preparation s",
        "greedy s",
        "share of places",
        "refused",
        "candidates",
    ):
        print(f"{name:17s} {np.mean([row[name] for row in rows]):.3f}")


if __name__ == "__main__":
    main()
