"""Coverage of intervals, and how good the recommended set is, over independent traffics of sites nobody fitted to.

    python tests/benchmarks/placement_env/bench_intervals.py OUT [--sites NAME ...] [--traffics 20] [--frames 60]
    python tests/benchmarks/placement_env/bench_intervals.py OUT --print [--frames 60]

At each site some sets of one to three sensors that searches found are judged by the detector in several traffics, each
with a seed of its own. What a set is worth is its AP in all other traffics together. An interval of one traffic holds
if it contains that figure, as far as the figure is known itself: its own interval is narrower by the root of the number
of traffics. A recommendation is good if its AP there is within 0.01 of the best of the sets. Tallies are kept in
OUT/SITE.npz, so --print needs no detector.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parent)]

from regret_sites import Place, places  # noqa: E402

from placement_env.setting import Setting  # noqa: E402
from toolkit.runtime.run import Run  # noqa: E402

IOUS = (0.7, 0.8, 0.9)
OF_EACH_SIZE = 4  # sets
SIZES = (1, 2, 3)


def collect(name: str, place: Place, out: Path, traffics: int, frames: int) -> None:
    """Detect in every traffic with every set; keep tallies."""
    from placement_env.fidelity.preparation import Preparation
    from placement_env.objective import Objective
    from placement_env.report.planning.judging import Judge
    from placement_env.search.portfolio.entrants import Effort, entrants

    path = out / f"{name}.npz"
    kept: dict[str, Any] = dict(np.load(path)) if path.exists() else {}
    site = place.make()
    setting = Setting(site, candidates=place.candidates(site))
    if "sets" not in kept:
        objective = Objective(setting, Run(frames=60, seed=place.seed))
        found = entrants(objective, Effort(SIZES, evaluations=20_000, neighbours=OF_EACH_SIZE))
        rows = []
        for size in SIZES:
            own = np.flatnonzero(found.sets.sum(axis=1) == size)
            answers = [i for i in own if found.searches[i]] + [i for i in own if not found.searches[i]]
            rows += [found.sets[i] for i in answers[:OF_EACH_SIZE]]
        kept["sets"] = np.array(rows)
    sets = kept["sets"]
    for part in range(traffics):
        if f"{part}.truths" in kept:
            continue
        judged = Setting(site, candidates=setting.candidates, fidelity="detector")
        judge = Judge.of(Preparation(judged, Run(seed=place.seed + 1000 + part, frames=frames)), 0)
        (label,) = judge.detected.classes.labels
        members = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        for n, outcomes in enumerate(judge.detected.outcomes(members, range(frames)).values()):
            at = [judge.detected.ious.index(iou) for iou in IOUS]
            kept[f"{part}.{n}.scores"] = np.concatenate([each.scores for each in outcomes])
            kept[f"{part}.{n}.truth"] = np.concatenate([each.truth[at] for each in outcomes], axis=1)
            kept[f"{part}.{n}.frame"] = np.repeat(np.arange(frames), [len(each.scores) for each in outcomes])
        kept[f"{part}.truths"] = judge.to_find[label]
        np.savez_compressed(path, **kept)
        print(f"{name}: traffic {part}, {int(judge.to_find[label].sum())} vehicles", flush=True)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("out", type=Path)
    arguments.add_argument("--sites", nargs="+", default=["tjunction", "roundabout", "osm"])
    arguments.add_argument("--traffics", type=int, default=20)
    arguments.add_argument("--frames", type=int, default=60)
    arguments.add_argument("--print", action="store_true", dest="only_print")
    asked = arguments.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    for name, place in places(asked.sites).items():
        if not asked.only_print:
            collect(name, place, asked.out, asked.traffics, asked.frames)


if __name__ == "__main__":
    main()
