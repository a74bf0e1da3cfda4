"""Regret of `portfolio`, and surrogates beside the detector, at 12 junctions that nothing was
fitted to.

    python tests/benchmarks/placement_env/bench_regret.py ROWS.jsonl [--sites NAME ...] [--budgets 2
        3 4] [--late]
    python tests/benchmarks/placement_env/bench_regret.py ROWS.jsonl --drawn 32 [--sites NAME ...]
        [--late]
    python tests/benchmarks/placement_env/bench_regret.py ROWS.jsonl --print

At each site and budget the searches and `portfolio` answer, and the detector judges all their
answers and a drawn set on 100 frames of traffic that nobody saw. With --drawn nothing is searched:
so many sets of 1 to 8 sensors, drawn at random, are judged beside the surrogates, which are shown
no answers of searches. Each row is kept in ROWS.jsonl when it is known, detections in --cache, so
that a run that was killed goes on where it was; --print says what the rows say so far
(`regret_figures.py`). Budgets go round the sites, so that few rows already stand for all of them.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from placement_env.setting import Setting
from toolkit.runtime.run import Run

sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parent)]

from regret_sites import Place, places  # noqa: E402

SEARCHED, RACED, JUDGED = 60, 96, 100  # frames
MOST_DRAWN = 8  # sensors of a set that is drawn
DRAWS = 200  # resamples that are kept of each set
IOUS = (0.7, 0.8, 0.9)


class Rows:
    """A file of JSON lines, appended to as rows come; a torn last line is left out."""

    def __init__(self, path: Path) -> None:
        self.path, self.rows = path, list(read_rows(path))

    def add(self, **row: Any) -> None:
        self.rows.append(row)
        with self.path.open("a") as file:
            file.write(json.dumps(row) + "\n")

    def find(self, **wanted: Any) -> list[dict[str, Any]]:
        return [
            row
            for row in self.rows
            if all(row.get(name) == value for name, value in wanted.items())
        ]


def read_rows(path: Path) -> Iterator[dict[str, Any]]:
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue


class Judging:
    """One site: what is searched there, and the detector on fresh traffic."""

    def __init__(
        self,
        name: str,
        place: Place,
        cache: Path,
        workers: int,
        scheme: str = "early",
        frames: int = JUDGED,
    ) -> None:
        self.name, self.seed, self.scheme, self.frames = name, place.seed, scheme, frames
        self.cache, self.workers = cache, workers
        self.site = place.make()
        self.candidates = place.candidates(self.site)

    @cached_property
    def objective(self) -> Any:
        from placement_env.objective import Objective

        return Objective(
            Setting(self.site, scheme=self.scheme, candidates=self.candidates),
            Run(frames=SEARCHED, seed=self.seed, cache=self.cache, workers=self.workers),
        )

    def prepared(self, part: int, frames: int, **settings: Any) -> Any:
        """What fidelities are made from on another part of the traffic, after that of the
        searches."""
        from dataclasses import replace

        made = self.objective.preparation
        run = replace(made.run, seed=made.run.seed + part, frames=frames)
        return replace(made, setting=replace(made.setting, **settings), run=run)

    def evaluators(self) -> tuple[Any, Any]:
        from placement_env.search.portfolio.portfolio import Judging as PortfolioJudging
        from placement_env.search.portfolio.schedule import Schedule

        judging = PortfolioJudging(race_frames=RACED, final_frames=self.frames)
        return judging.build_evaluators(self.objective, Schedule())

    def searches(self, k: int) -> dict[str, Callable[[], Any]]:
        """Each search, with as much as the portfolio lets it do, or as it does by itself."""
        from placement_env.search import greedy, swap
        from placement_env.search.exact import cpsat, hits
        from placement_env.search.portfolio.entrants import (
            CPSAT_EFFORT_S,
            SWAP_EVALUATIONS,
            entropy_objective,
        )

        objective = self.objective
        swapping = {"starts": swap.DEFAULT_STARTS, "evaluations": SWAP_EVALUATIONS}
        made: dict[str, Callable[[], Any]] = {
            "greedy": partial(greedy.search, objective, k),
            "swap": partial(swap.search, objective, k, **swapping),
            "swap by entropy": partial(swap.search, entropy_objective(objective), k, **swapping),
            "cpsat": partial(cpsat.search, objective, k, seconds=60.0, effort=CPSAT_EFFORT_S),
            "hits": partial(hits.search, objective, k, seconds=10.0),
        }
        return (
            made
            if self.scheme == "early"
            else {name: made[name] for name in ("greedy", "swap", "cpsat")}
        )

    def drawn(self, count: int) -> list[tuple[int, ...]]:
        """Sets of 1 to `MAX_DRAWN_POINTS` sensors in turn, drawn at random."""
        rng = np.random.default_rng([self.seed, count])
        return [self.draw(rng, 1 + turn % MOST_DRAWN) for turn in range(count)]

    def draw(self, rng: np.random.Generator, k: int) -> tuple[int, ...]:
        members = rng.permutation(len(self.candidates))
        _, first = np.unique(self.candidates.mount[members], return_index=True)
        return tuple(sorted(members[np.sort(first)][:k].tolist()))

    def row_of(self, subset: tuple[int, ...]) -> np.ndarray:
        row = np.zeros((1, len(self.candidates)), bool)
        row[0, list(subset)] = True
        return row

    def judged(self, subset: tuple[int, ...]) -> dict[str, Any]:
        """What the detector says of a set, with resamples; fast scores of the same traffic."""
        from placement_env.search.portfolio.evaluators import CasesEvaluator, DetectorEvaluator

        detected, row, frames = self._detected, self.row_of(subset), np.arange(self.frames)
        each = [
            CasesEvaluator((DetectorEvaluator(detected, (iou,)),)).evaluate(row, frames)
            for iou in IOUS
        ]
        return {
            "ap": [round(float(found.ap[0]), 5) for found in each],
            "draws": [
                np.round(found.resamples[0][:DRAWS], 4).tolist() for found in (each[0], each[2])
            ],
            "same": {name: round(float(score(row)[0][0]), 5) for name, score in self._fast.items()},
        }

    @cached_property
    def _detected(self) -> Any:
        return self.prepared(2, self.frames).fidelity("detector")

    @cached_property
    def _fast(self) -> dict[str, Callable[[np.ndarray], Any]]:
        """Fast fidelities on the traffic of the judgement."""
        from information_gain import InformationGain

        from placement_env.fidelity.coverage import Coverage
        from placement_env.fidelity.perception_entropy import PerceptionEntropy
        from placement_env.fidelity.surrogate import Surrogate

        vehicles = self.prepared(2, self.frames).visibility
        radius = self.site.hybrid_radius
        made: dict[str, Callable[[np.ndarray], Any]] = {
            f"surrogate@{iou:g}": Surrogate(vehicles, self.scheme, iou=iou, radius=radius)
            for iou in IOUS
        }
        made["coverage"] = Coverage(vehicles, self.scheme)
        made["perception entropy"] = PerceptionEntropy(vehicles, self.scheme)
        made["information gain"] = InformationGain(vehicles, self.scheme)
        made["point count"] = lambda rows: (rows @ np.log1p(vehicles.points).sum(axis=1),)
        return made


def run(judging: Judging, k: int, rows: Rows) -> None:
    at = {"site": judging.name, "k": k, "scheme": judging.scheme}
    for name, search in judging.searches(k).items():
        if not rows.find(kind="search", method=name, **at):
            found = search()
            predicted = judging.objective.score(found.best.subset).ap
            rows.add(
                kind="search",
                method=name,
                **at,
                subset=list(found.best.subset),
                predicted=predicted,
                seconds=round(found.seconds, 2),
                evaluations=found.evaluations,
            )
    if not rows.find(kind="portfolio", **at):
        rows.add(kind="portfolio", **at, **_portfolio(judging, k))
    answers = [
        tuple(row["subset"])
        for kind in ("portfolio", "search")
        for row in rows.find(kind=kind, **at)
    ]
    drawn = judging.draw(np.random.default_rng([judging.seed, k]), k)
    judge_sets(judging, dict.fromkeys([*answers, drawn]), rows, k=k)


def judge_sets(
    judging: Judging, sets: Iterable[tuple[int, ...]], rows: Rows, *, k: int | None = None
) -> None:
    at = {"site": judging.name, "scheme": judging.scheme}
    for subset in sets:
        if subset and not rows.find(kind="set", subset=list(subset), **at):
            predicted = float(judging.objective.scores(judging.row_of(subset)).ap[0])
            own = {
                "k": len(subset) if k is None else k,
                "subset": list(subset),
                "predicted": predicted,
            }
            rows.add(kind="set", **at, **own, **judging.judged(subset))
    print(f"{judging.name} {k or ''} {judging.scheme}: {len(rows.rows)} rows", flush=True)


def _portfolio(judging: Judging, k: int) -> dict[str, Any]:
    from placement_env.search.portfolio import portfolio

    began = perf_counter()
    found = portfolio.search(
        judging.objective, k, judging=portfolio.Judging(evaluators=judging.evaluators())
    )
    said = found.assessment
    return {
        "subset": list(found.best.subset),
        "predicted": found.best.ap,
        "expected": said.expected,
        "ap": said.ap,
        "low": said.low,
        "high": said.high,
        "confidence": said.confidence,
        "raced": said.raced,
        "entrants": said.entrants,
        "searching": round(found.seconds, 2),
        "seconds": round(perf_counter() - began, 2),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("rows", type=Path)
    arguments.add_argument("--sites", nargs="+", default=[])
    arguments.add_argument("--budgets", nargs="+", type=int, default=[2, 3, 4])
    arguments.add_argument("--drawn", type=int, default=0)
    arguments.add_argument("--frames", type=int, default=JUDGED)
    arguments.add_argument("--late", action="store_true")
    arguments.add_argument("--print", action="store_true", dest="only_print")
    arguments.add_argument("--cache", type=Path, default=Path("out/regret"))
    arguments.add_argument("--workers", type=int, default=1)
    asked = arguments.parse_args()
    if not asked.only_print:
        chosen, rows = places(asked.sites), Rows(asked.rows)
        scheme = "late" if asked.late else "early"
        for turn in range(1 if asked.drawn else len(asked.budgets)):
            for number, (name, place) in enumerate(chosen.items()):
                judging = Judging(name, place, asked.cache, asked.workers, scheme, asked.frames)
                if asked.drawn:
                    judge_sets(judging, judging.drawn(asked.drawn), rows)
                else:
                    run(judging, asked.budgets[(number // 2 + turn) % len(asked.budgets)], rows)
    from regret_figures import figures

    print("\n".join(figures(list(read_rows(asked.rows)))))


if __name__ == "__main__":
    main()
