"""Coverage of intervals, and how good the recommended set is, over independent traffics of sites
nobody fitted to.

    python tests/benchmarks/placement_env/bench_intervals.py OUT [--sites NAME ...] [--traffics 20]
        [--frames 60]
    python tests/benchmarks/placement_env/bench_intervals.py OUT --print [--frames 60]

At each site some sets of one to three sensors that searches found are judged by the detector in
several traffics, each with a seed of its own. What a set is worth is its AP in all other traffics
together. An interval of one traffic holds if it contains that figure, as far as the figure is known
itself: its own interval is narrower by the root of the number of traffics. A recommendation is good
if its AP there is within 0.01 of the best of the sets. For more frames than one traffic has,
neighbouring traffics are joined. Tallies are kept in OUT/SITE.npz, so --print needs no detector.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parent)]

from regret_sites import Place, places  # noqa: E402

from placement_env.analysis.intervals import AP_TOLERANCE, Tally  # noqa: E402
from placement_env.fidelity.detector import IGNORED  # noqa: E402
from placement_env.report.content import Judgement, PlanOption  # noqa: E402
from placement_env.report.planning.choice import choose  # noqa: E402
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
    from placement_env.search.portfolio.entrants import Effort, find_entrants

    path = out / f"{name}.npz"
    kept: dict[str, Any] = dict(np.load(path)) if path.exists() else {}
    site = place.make()
    setting = Setting(site, candidates=place.candidates(site))
    if "sets" not in kept:
        objective = Objective(setting, Run(frames=60, seed=place.seed))
        found = find_entrants(objective, Effort(SIZES, evaluations=20_000, neighbours=OF_EACH_SIZE))
        rows = []
        for size in SIZES:
            own = np.flatnonzero(found.sets.sum(axis=1) == size)
            answers = [i for i in own if found.searches[i]] + [
                i for i in own if not found.searches[i]
            ]
            rows += [found.sets[i] for i in answers[:OF_EACH_SIZE]]
        kept["sets"] = np.array(rows)
    sets = kept["sets"]
    for part in range(traffics):
        if f"{part}.truths" in kept:
            continue
        judged = Setting(site, candidates=setting.candidates, fidelity="detector")
        judge = Judge.from_preparation(
            Preparation(judged, Run(seed=place.seed + 1000 + part, frames=frames)), 0
        )
        (label,) = judge.detected.classes.labels
        members = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        for n, outcomes in enumerate(judge.detected.outcomes(members, range(frames)).values()):
            at = [judge.detected.ious.index(iou) for iou in IOUS]
            kept[f"{part}.{n}.scores"] = np.concatenate([each.scores for each in outcomes])
            kept[f"{part}.{n}.truth"] = np.concatenate(
                [each.truth[at] for each in outcomes], axis=1
            )
            kept[f"{part}.{n}.frame"] = np.repeat(
                np.arange(frames), [len(each.scores) for each in outcomes]
            )
        truths = judge.detected.count_to_find(range(frames), label)
        kept[f"{part}.truths"] = truths
        np.savez_compressed(path, **kept)
        print(f"{name}: traffic {part}, {int(truths.sum())} vehicles", flush=True)


def tally(kept: dict[str, Any], part: int, n: int, iou: int, frames: int = 10**6) -> Tally:
    """Tally of one set in some first frames of one traffic."""
    scores, truth, frame = (kept[f"{part}.{n}.{name}"] for name in ("scores", "truth", "frame"))
    used = (truth[iou] != IGNORED) & (frame < frames)
    return Tally(scores[used], truth[iou, used] >= 0, frame[used], kept[f"{part}.truths"][:frames])


def pool(tallies: list[Tally]) -> Tally:
    """Tally of several traffics one after another."""
    before = np.cumsum([0, *(len(each.truths) for each in tallies)])
    frame = np.concatenate(
        [each.frame + first for each, first in zip(tallies, before, strict=False)]
    )
    scores, hit, truths = (
        np.concatenate([getattr(t, name) for t in tallies]) for name in ("scores", "hit", "truths")
    )
    return Tally(scores, hit, frame, truths)


def report(path: Path, frames: int) -> None:
    """Print how often intervals hold the AP of all other traffics, and how good recommendations are
    there."""
    kept: dict[str, Any] = dict(np.load(path))
    parts = sorted({int(name.partition(".")[0]) for name in kept if name.endswith(".truths")})
    sets, length = kept["sets"], len(kept[f"{parts[0]}.truths"])
    cuts = [min(length, frames - first) for first in range(0, frames, length)]
    groups = [parts[first : first + len(cuts)] for first in range(len(parts) - len(cuts) + 1)]
    held, widths, plain, losses, picked = [], [], [], [], []
    for number, part in enumerate(groups):
        options, draws, fresh, mean = [], {}, [], []
        for n, row in enumerate(sets):
            own = [
                pool([tally(kept, p, n, i, cut) for p, cut in zip(part, cuts, strict=True)])
                for i in range(len(IOUS))
            ]
            there = pool([tally(kept, other, n, 0) for other in parts if other not in part])
            fresh.append(there.ap)
            mean.append(float(np.mean([each.ap for each in own])))
            drawn, ends = own[0].resamples(seed=number), own[0].interval(seed=number)
            held.append(ends.low <= there.ap <= ends.high)
            widths.append(ends.high - ends.low)
            middle = np.quantile(drawn, [0.025, 0.975])
            plain.append(middle[0] <= there.ap <= middle[1])
            judged = Judgement(
                own[0].ap, *ends, own[0].recall, None, int(own[0].truths.sum()), frames
            )
            names = tuple(map(str, np.flatnonzero(row)))
            options.append(
                PlanOption(names, float(row.sum()), 100.0, 100.0, 0.0, judged, mean_ap=mean[-1])
            )
            draws[n] = drawn
        best, alike = choose(options, draws)
        losses.append(max(fresh) - fresh[alike[0]])
        picked.append(alike[0] != best)
    within, count = np.mean(np.array(losses) <= AP_TOLERANCE + 1e-9), len(held)
    print(
        f"{path.stem}, {len(groups)} times {frames} frames, {len(sets)} sets: intervals hold "
        f"{np.sum(held)} of {count} ({np.mean(held):.1%}; plain percentiles "
        f"{np.mean(plain):.1%}), mean width {np.mean(widths):.3f}; recommended within "
        f"{AP_TOLERANCE:g} of the best on all other frames {within:.0%}, loss "
        f"{np.mean(losses):.4f} on average, {max(losses):.4f} at most; cheaper than the best in "
        f"{np.sum(picked)}"
    )


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
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
        report(asked.out / f"{name}.npz", asked.frames)


if __name__ == "__main__":
    main()
