"""Judging: sensor sets by the detector on traffic that no search saw, with intervals and the number of vehicles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.analysis.intervals import percentiles
from placement_env.analysis.tally import Tally
from placement_env.classes import VEHICLES, Classes
from placement_env.fidelity.detector import Detected, Outcome
from placement_env.report.content import CONFIDENCE, ClassAP, Judgement
from toolkit.arrays import Bool, Int64
from toolkit.objects import HEAVY, LABELS

NOUNS = {name: "heavy vehicle" if name == LABELS[HEAVY] else name for name in LABELS}


@dataclass(frozen=True, eq=False)
class Judge:
    """The detector on one part of the traffic. seed: of the bootstrap."""

    detected: Detected
    seed: int

    def judge(
        self,
        sets: Bool[np.ndarray, "n C"],
        *,
        iou: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> list[Judgement]:
        """Judgement of each set over all frames. iou: None for the plan's own; progress: called with how many frames
        are done, where any has to be."""
        rows = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = self.detected.outcomes(dict.fromkeys(rows), range(self.frames), progress)
        return [combined_judgement(self.tallies(outcomes[row], iou), self.classes, self.seed) for row in rows]

    def tallies(self, outcomes: Sequence[Outcome], iou: float | None = None) -> list[Tally]:
        """What became of one set's detections, class by class."""
        at = self.detected.ious.index(self.detected.iou if iou is None else iou)
        return [
            Tally.of([outcome.of_class(label) for outcome in outcomes], self.truths_of(label), at)
            for label in self.classes.labels
        ]

    def by_class(self, chosen: tuple[int, ...]) -> tuple[ClassAP, ...]:
        """Judgement of one set for each class that counts, by itself."""
        tallies = self.tallies(self.outcomes(chosen))
        classes = self.classes
        return tuple(
            ClassAP(name, weight, classes.iou_of(name, self.detected.iou), combined_judgement([tally], one, self.seed))
            for name, weight, tally in zip(classes.names, classes.weights, tallies, strict=True)
            for one in [Classes((name,))]
        )

    @property
    def classes(self) -> Classes:
        """That count."""
        return self.detected.classes

    @property
    def absent(self) -> tuple[str, ...]:
        """Classes that count and of which there is nothing to find."""
        return tuple(LABELS[label] for label in self.classes.labels if not self.truths_of(label).any())

    def outcomes(self, chosen: tuple[int, ...]) -> list[Outcome]:
        """Of one set in every frame."""
        return self.detected.outcomes([chosen], range(self.frames))[chosen]

    @property
    def frames(self) -> int:
        """How many frames it judges by."""
        return self.detected.frames

    @property
    def truths(self) -> Int64[np.ndarray, " frames"]:
        """Vehicles, or objects of all classes that count, to be found in each frame."""
        return np.array([self.detected.scored(k).sum() for k in range(self.frames)], np.int64)

    def truths_of(self, label: int) -> Int64[np.ndarray, " frames"]:
        """Those of one class."""
        return np.array([self.detected.to_find(k, label).sum() for k in range(self.frames)], np.int64)


def combined_judgement(tallies: Sequence[Tally], classes: Classes, seed: int) -> Judgement:
    """Figures of a tally for each class; the interval of several is that of their combination, resample by resample."""
    if classes.names == VEHICLES.names:
        return judgement(tallies[0], seed)
    draws = np.stack([tally.resamples(seed=seed) for tally in tallies], axis=1)
    low, high = percentiles(classes.combined(draws), confidence=CONFIDENCE)
    ap, recall = (
        float(classes.combined(np.array([[getattr(tally, name) for tally in tallies]]))[0]) for name in ("ap", "recall")
    )
    detections, hits = (sum(len(each.hit) for each in tallies), sum(int(each.hit.sum()) for each in tallies))
    return Judgement(
        ap=ap,
        low=min(low, ap),
        high=max(high, ap),
        recall=recall,
        precision=hits / detections if detections else None,
        vehicles=sum(int(each.truths.sum()) for each in tallies),
        frames=len(tallies[0].truths),
        kind=NOUNS[classes.names[0]] if len(classes.names) == 1 else "object",
    )


def judgement(tally: Tally, seed: int) -> Judgement:
    """Figures of a tally in which there is something to find; the interval holds the AP itself."""
    low, high = tally.interval(confidence=CONFIDENCE, seed=seed)
    ap, precision = tally.ap, tally.precision
    return Judgement(
        ap=ap,
        low=min(low, ap),
        high=max(high, ap),
        recall=tally.recall,
        precision=None if math.isnan(precision) else precision,
        vehicles=int(tally.truths.sum()),
        frames=len(tally.truths),
    )
