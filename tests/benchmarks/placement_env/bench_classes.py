"""Cars and pedestrians: the front between them, and the set whose worse class is best, by the detector.

For each weight of pedestrians swap searches the pool by the surrogate; so does it for the worse of both classes. What
it finds is judged by the detector (`general`) on traffic that no search saw: AP of vehicles at IoU 0.7, of pedestrians
at 0.5.

python tests/benchmarks/placement_env/bench_classes.py tjunction roundabout 9301 --frames 40 --judged 60 --sensors 3
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from placement_env.analysis.intervals import percentiles
from placement_env.classes import Classes
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.search import swap
from placement_env.search.portfolio.evaluators import Evaluated, build_evaluator
from placement_env.setting import Setting
from toolkit.runtime.run import Run
from toolkit.sites.files import load_site
from toolkit.sites.random import random_site

BOTH = ("vehicle", "pedestrian")
WEIGHTS = (0.01, 0.2, 0.4, 0.5, 0.6, 0.8, 0.99)  # of pedestrians
WORST = Classes(BOTH, combine="worst")


@dataclass
class Answer:
    """A set, and what found it."""

    by: list[str]
    subset: tuple[int, ...]


def found(made: Preparation, sensors: int) -> list[Answer]:
    """The different answers of swap for each weight, and for the worse class."""
    seen = made.visibility
    asked = {f"pedestrians {w:g}": Classes(BOTH, (1 - w, w)) for w in WEIGHTS} | {"the worse class": WORST}
    answers: dict[tuple[int, ...], Answer] = {}
    for name, classes in asked.items():
        fidelity = of_classes(made, classes).fidelity("surrogate")
        objective = Objective(Setting(made.site, candidates=made.candidates, fidelity=fidelity), visibility=seen)
        subset = swap.search(objective, sensors, starts=3).best.subset
        answers.setdefault(subset, Answer([], subset)).by.append(name)
    return list(answers.values())


def of_classes(made: Preparation, classes: Classes) -> Preparation:
    """The same traffic and view for other classes or weights of them."""
    there = replace(made, setting=replace(made.setting, classes=classes))
    vars(there).update({name: vars(made)[name] for name in ("traffic", "network", "visibility") if name in vars(made)})
    return there


def judged(made: Preparation, sets: np.ndarray, frames: int) -> dict[str, Evaluated]:
    """AP of vehicles, of pedestrians and of the worse on fresh traffic, by the detector."""
    run = replace(made.run, seed=made.run.seed + 1, frames=frames)
    fresh = Preparation(replace(made.setting, classes=WORST), run)
    assert fresh.traffic is not None
    assert fresh.network == "general"
    each: dict[str, Any] = {"vehicle": Classes(BOTH[:1]), "pedestrian": Classes(BOTH[1:]), "worst": WORST}
    scores: dict[str, Evaluated] = {}
    for name, classes in each.items():
        scores[name] = build_evaluator(of_classes(fresh, classes), "detector").evaluate(sets, np.arange(frames))
    return scores


def report(name: str, asked: argparse.Namespace) -> None:
    """Print the front of a site, and its best set by the worse class."""
    site = random_site(int(name)) if name.isdigit() else load_site(name)
    with tempfile.TemporaryDirectory() as kept:
        objective = Objective(
            Setting(site, candidates="pool", classes=WORST), Run(frames=asked.frames, cache=asked.cache or kept)
        )
        made = objective.preparation
        assert made is not None
        answers = found(made, asked.sensors)
        sets = np.array([objective.row(answer.subset) for answer in answers])
        predicted = objective.class_ap(sets)
        scores = judged(made, sets, asked.judged)
    cars, people, worse = (scores[each].ap for each in ("vehicle", "pedestrian", "worst"))
    print(f"{site.name}: {len(objective.candidates)} poses, {asked.sensors} sensors, {asked.judged} frames", flush=True)
    for i in np.argsort(-cars):
        beaten = ((cars >= cars[i]) & (people >= people[i]) & ((cars > cars[i]) | (people > people[i]))).any()
        said = [f"{each} {interval(scores[each], i)}" for each in ("vehicle", "pedestrian")]
        marks = f"{'' if beaten else ', front'}{', max-min' if i == worse.argmax() else ''}"
        guess = ", ".join(f"{ap:.3f}" for ap in predicted[i])
        print(f"  {', '.join(said)} (predicted {guess}){marks}: {', '.join(answers[i].by)}", flush=True)


def interval(scores: Evaluated, row: int) -> str:
    """An AP with its 95 % interval."""
    low, high = percentiles(scores.resamples[row], confidence=0.95)
    return f"{scores.ap[row]:.3f} ({low:.3f} to {high:.3f})"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sites", nargs="+", help="names, files, or seeds of drawn junctions")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--judged", type=int, default=60)
    parser.add_argument("--sensors", type=int, default=3)
    parser.add_argument("--cache", help="folder where what was seen and detected is kept")
    options = parser.parse_args()
    for each in options.sites:
        report(each, options)
