"""Figures of the chosen set: schemes, worth of each sensor, failures, order of building; all by the detector on the
final traffic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from placement_env.analysis.worth import estimate_worth, exact_worth
from placement_env.fidelity.detector import IOUS, Detected
from placement_env.objective import Objective
from placement_env.report.content import BuildStep, FailureCase, SchemeFigures, SensorWorth
from placement_env.report.planning.judging import Judge
from placement_env.subsets import all_subsets
from toolkit.arrays import Bool, Float64
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme

ALL_SUBSETS = 6  # sensors of which every subset is judged by the detector

_Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class ChosenSet:
    """The chosen set: indices of its candidates, ascending, and their names."""

    members: tuple[int, ...]
    names: tuple[str, ...]

    def rows(self, subsets: Bool[np.ndarray, "n k"], candidates: int) -> Bool[np.ndarray, "n C"]:
        """Subsets of the set as rows of all candidates."""
        rows = np.zeros((len(subsets), candidates), np.bool_)
        rows[:, list(self.members)] = subsets
        return rows

    def without(self, failed: tuple[int, ...], candidates: int) -> Bool[np.ndarray, " C"]:
        """The set less some of its members, by their places in it, as a row."""
        left = np.ones(len(self.members), np.bool_)
        left[list(failed)] = False
        return self.rows(left[None], candidates)[0]

    @property
    def is_small(self) -> bool:
        """Whether every subset is judged."""
        return len(self.members) <= ALL_SUBSETS


def by_scheme(judge: Judge, chosen: ChosenSet, progress: _Progress | None = None) -> tuple[SchemeFigures, ...]:
    """The set under every scheme at every IoU; nothing that was detected is detected again."""
    detected, rows = judge.detected, []
    row = chosen.rows(np.ones((1, len(chosen.members)), np.bool_), len(detected.renders.sensors))
    for name in PAPER_SCHEMES:
        other = Judge(
            Detected(
                detected.renders, detected.detector, find_scheme(name), codec=detected.codec, iou=detected.iou,
                memo=detected.memo, processes=detected.processes, classes=detected.classes,
            ).at(detected.iou, detected.ious),
            judge.seed,
            judge.cases,
        )  # fmt: skip
        figures = other.judge(row, progress=progress)
        kbit = float(np.mean([outcome.bits.mean() for outcome in other.outcomes(chosen.members)])) / 1000
        for iou in sorted({*IOUS, *judge.ious[:1]} if len(judge.ious) == 1 else IOUS):
            judged = figures[0] if iou == judge.iou else other.judge(row, iou=iou)[0]
            rows.append(SchemeFigures(name, iou, judged, kbit))
        if len(judge.ious) > 1:
            rows.append(SchemeFigures(name, judge.iou, figures[0], kbit))
    return tuple(rows)


def worths(
    judge: Judge, objective: Objective, chosen: ChosenSet, progress: _Progress | None = None
) -> tuple[SensorWorth, ...]:
    """Shapley values and interactions: exact, by the detector, of up to `ALL_SUBSETS` sensors; of more, sampled by the
    fidelity of the searches."""
    candidates, count = len(objective.candidates), len(chosen.members)
    if chosen.is_small:
        aps = [each.ap for each in judge.judge(chosen.rows(all_subsets(count), candidates), progress=progress)]
        worth = exact_worth(lambda _: np.array(aps), count)
    else:
        worth = estimate_worth(lambda sets: objective.scores(chosen.rows(sets, candidates)).ap, count, rounds=64)
    return tuple(
        SensorWorth(
            name,
            float(worth.shapley[i]),
            {other: float(worth.synergy[i, j]) for j, other in enumerate(chosen.names) if j != i},
        )
        for i, name in enumerate(chosen.names)
    )


def failure_cases(judge: Judge, chosen: ChosenSet, progress: _Progress | None = None) -> tuple[FailureCase, ...]:
    """What is left when one sensor fails, and when two do, wherever any is left; worst first of each number."""
    candidates, count = len(judge.detected.renders.sensors), len(chosen.members)
    cases: list[FailureCase] = []
    for failing in (1, 2):
        lost = list(combinations(range(count), failing)) if failing < count else []
        rows = np.array([chosen.without(each, candidates) for each in lost], np.bool_).reshape(len(lost), candidates)
        judged = judge.judge(rows, progress=progress)
        found = [
            FailureCase(tuple(chosen.names[i] for i in each), left) for each, left in zip(lost, judged, strict=True)
        ]
        cases += sorted(found, key=lambda case: case.judged.ap)
    return tuple(cases)


def build_order(
    judge: Judge, objective: Objective, chosen: ChosenSet, progress: _Progress | None = None
) -> tuple[BuildStep, ...]:
    """Which sensor to build first, second …: each the one that adds most AP to those before, by the detector for up to
    `ALL_SUBSETS` sensors, else by the fidelity of the searches; the steps are judged by the detector."""
    built, order, prefixes = np.zeros(len(chosen.members), np.bool_), [], []
    while not built.all():
        options = np.flatnonzero(~built)
        rows = np.repeat(built[None], len(options), axis=0)
        rows[np.arange(len(options)), options] = True
        best = int(_aps(judge, objective, chosen, rows, progress).argmax())
        built = rows[best]
        order.append(int(options[best]))
        prefixes.append(built)
    sets = chosen.rows(np.array(prefixes), len(objective.candidates))
    steps = zip(order, objective.price(sets).tolist(), judge.judge(sets, progress=progress), strict=True)
    return tuple(BuildStep(chosen.names[i], price, judged) for i, price, judged in steps)


def _aps(
    judge: Judge, objective: Objective, chosen: ChosenSet, subsets: Bool[np.ndarray, "n k"], progress: _Progress | None
) -> Float64[np.ndarray, " n"]:
    rows = chosen.rows(subsets, len(objective.candidates))
    if not chosen.is_small:
        return objective.scores(rows).ap
    return np.array([each.ap for each in judge.judge(rows, progress=progress)])
