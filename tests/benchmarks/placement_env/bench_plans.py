"""Plans at ten sites that nothing was fitted to: what they promise, their regret, and the price of
`--min-ap`.

    python tests/benchmarks/placement_env/bench_plans.py ROWS.jsonl [--sites NAME ...] [--print]

At each site `plan` answers with at most three sensors, once for the best set and once for the
cheapest that reaches an AP a little below. Its answers, all sets that it judged, the searches' own
answers and the best neighbours of these are then judged on `JUDGED` frames of other traffic. What a
plan says about its set beside the decision (schemes, worth, failures) is left out, since it takes
half of the time. Each site is a row of ROWS.jsonl when it is known, detections stay in --cache;
--print says what the rows say so far.

Sites are the first nine seeds from 77001 on whose detection area is below 7,000 m², and a piece of
docs/own-junction.osm. Of each, a hundred and twenty poses drawn from the pool are candidates.
"""

import argparse
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parent)]

from bench_regret import IOUS, Rows, read_rows  # noqa: E402
from regret_sites import ROOT  # noqa: E402

from placement_env.candidates.candidates import pool  # noqa: E402
from placement_env.fidelity.preparation import Preparation  # noqa: E402
from placement_env.report import content  # noqa: E402
from placement_env.report.planning import chosen_set, planning  # noqa: E402
from placement_env.report.planning.question import Question, Stock  # noqa: E402
from placement_env.setting import Setting  # noqa: E402
from toolkit.runtime.run import Run  # noqa: E402
from toolkit.sites.maps.osm_site import import_osm  # noqa: E402
from toolkit.sites.maps.piece import MapPiece  # noqa: E402
from toolkit.sites.random import random_site  # noqa: E402
from toolkit.sites.site import Site  # noqa: E402

SENSORS, POSES, LARGEST = 3, 120, 7000.0
FRAMES, JUDGED = 80, 100  # of each part of a plan's traffic, and of the independent judgement
BELOW = 0.06  # AP by which the required one lies below that of the best plan
OTHERS = 3  # best sets of each number of sensors by prediction that are judged too


def sites() -> Iterator[tuple[str, int]]:
    """Names and seeds."""
    yield "osm", 77000
    found, seed = 0, 77000
    while found < 9:
        seed += 1
        xmin, ymin, xmax, ymax = random_site(seed).area
        if (xmax - xmin) * (ymax - ymin) < LARGEST:
            found += 1
            yield f"random-{seed}", seed


def make(name: str, seed: int) -> Site:
    if name != "osm":
        return random_site(seed)
    return import_osm(
        MapPiece(ROOT / "docs" / "own-junction.osm", centre=(8.0, 49.5), size=(70.0, 50.0), seed=3)
    )


class Drawn(Stock):
    """Some poses of the pool."""

    def __call__(self, site: Site) -> Any:
        every = pool(site)
        chosen = np.random.default_rng(len(every)).choice(
            len(every), min(POSES, len(every)), replace=False
        )
        return every.select(np.sort(chosen))


def measure(name: str, seed: int, cache: Path) -> dict[str, Any]:
    for left_out in ("schemes", "worth", "failures", "order"):
        setattr(chosen_set.ChosenSet, left_out, lambda self: ())
    # sensors keep the names of their candidates
    setattr(content, "rename", lambda plan, names: plan)  # noqa: B010
    site, run = make(name, seed), Run(seed=seed, frames=FRAMES, cache=cache)
    setting = Setting(site, candidates=Drawn())
    began = process_time()
    best = planning.plan(Question(setting, run, SENSORS)).plan
    if best.chosen is None or best.chosen.counted is None or best.best is None:
        return {"refused": best.verdict.sentence}
    asked = round(best.chosen.counted.ap - BELOW, 2)
    cheap = planning.plan(Question(setting, run, SENSORS, min_ap=asked)).plan
    planned = process_time() - began
    candidates = setting.pool
    rows = {sensor.name.replace("/", "-"): c for c, sensor in enumerate(candidates.sensors)}
    considered = (*best.considered, *cheap.considered)
    options = {each.sensors: each for each in considered}
    known = {each.sensors for each in considered if each.judged is not None or each.searches}
    for size in range(1, SENSORS + 1):
        of_size = [each for each in options.values() if len(each.sensors) == size]
        known |= {
            each.sensors for each in sorted(of_size, key=lambda each: -each.predicted)[:OTHERS]
        }
    sets = sorted(known)
    mask = np.zeros((len(sets), len(candidates)), np.bool_)
    for row, names in zip(mask, sets, strict=True):
        row[[rows[each] for each in names]] = True
    judge = Preparation(
        Setting(site, candidates=candidates, fidelity="detector"), run.part(7, JUDGED)
    )
    figures = judge.detected(judge.setting.cases.profiles[0]).estimates(mask)
    aps = np.array([figures[iou].ap for iou in IOUS])
    price = [options[each].price for each in sets]

    def place(plan: Any, option: Any) -> dict[str, Any]:
        at = sets.index(option.sensors)
        low, high = option.counted.low, option.counted.high
        return {
            "ap": aps[:, at].tolist(),
            "price": price[at],
            "promised": option.counted.ap,
            "low": low,
            "high": high,
        }

    return {
        "asked": asked,
        "met": cheap.verdict.met,
        "chosen": place(best, best.chosen),
        "best": place(best, best.best) | {"promised": None},
        "cheap": None if cheap.chosen is None else place(cheap, cheap.chosen),
        "sets": [
            {"ap": aps[:, n].tolist(), "price": price[n], "sensors": len(each)}
            for n, each in enumerate(sets)
        ],
        "planning_s": planned,
        "judging_s": process_time() - began - planned,
    }


def figures(rows: list[dict[str, Any]]) -> Iterator[str]:
    off, regrets, prices = [], [], []
    head = (
        f"{'site':14s} {'promised':>8s} {'judged':>7s} {'best 0.7':>8s} {'mean':>6s} {'best':>6s}"
    )
    yield f"{head}  min-ap: asked price least"
    for row in (row for row in rows if "chosen" in row):
        chosen, best, cheap, sets = row["chosen"], row["best"], row["cheap"], row["sets"]
        highest, mean = (
            max(each["ap"][0] for each in sets),
            max(np.mean(each["ap"]) for each in sets),
        )
        off.append(chosen["promised"] - chosen["ap"][0])
        regrets.append(
            (highest - best["ap"][0], mean - np.mean(best["ap"]), highest - chosen["ap"][0])
        )
        least = min(
            (each["price"] for each in sets if each["ap"][0] >= row["asked"]), default=np.nan
        )
        prices.append(cheap["price"] / least - 1 if cheap and row["met"] else np.nan)
        yield (
            f"{row['site']:14s} {chosen['promised']:8.3f} {chosen['ap'][0]:7.3f} {highest:8.3f} "
            f"{np.mean(best['ap']):6.3f} {mean:6.3f}  {row['asked']:13.2f} "
            f"{cheap['price'] if cheap else np.nan:5.2f} {least:5.2f}  {row['planning_s']:.0f} + "
            f"{row['judging_s']:.0f} s"
        )
    if off:
        at, mean, chosen = np.array(regrets).T
        yield (
            f"promised less judged: mean {np.mean(off):+.4f}, mean of the size "
            f"{np.mean(np.abs(off)):.4f}"
        )
        yield (
            f"regret at 0.7: {at.mean():.4f}, at mean IoU {mean.mean():.4f}; of the answer "
            f"{chosen.mean():.4f}"
        )
        yield (
            f"price of --min-ap above the least known: mean {np.nanmean(prices):+.1%}, of "
            f"{np.isfinite(prices).sum()}"
        )


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("rows", type=Path)
    arguments.add_argument("--sites", nargs="+", default=[])
    arguments.add_argument("--print", action="store_true", dest="only_print")
    arguments.add_argument("--cache", type=Path, default=Path("out/plans"))
    asked = arguments.parse_args()
    rows = Rows(asked.rows)
    every = [] if asked.only_print else list(sites())
    for name, seed in every:
        if (not asked.sites or name in asked.sites) and not rows.find(site=name):
            rows.add(site=name, **partial(measure, cache=asked.cache)(name, seed))
            print(name, flush=True)
    print("\n".join(figures(list(read_rows(asked.rows)))))


if __name__ == "__main__":
    main()
