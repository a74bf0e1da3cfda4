"""What became of a scheme's detections under one condition, frame after frame, and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from placement_env.analysis.tally import Tally
from placement_env.report.content import Judgement
from placement_env.report.stress.conditions import Condition
from placement_env.report.stress.systems import System
from toolkit.detection.link.tracks import Tracks
from toolkit.detection.metrics import match
from toolkit.frame import Frame
from toolkit.objects import Detections
from toolkit.points import centred_in
from toolkit.sites.site import Site


@dataclass(frozen=True)
class StressRow:
    """One scheme under one condition. judged: AP with its interval; kbit_per_sensor: per frame, of the sensors that
    send; age: of what the centre shows, mean over sensors and frames (s); label, iou: of what is to be found; amount:
    of what goes wrong, None where it is no number; tally: what `judged` is computed from."""

    kind: str
    level: str
    scheme: str
    codec: str
    judged: Judgement
    kbit_per_sensor: float
    age: float
    label: str
    iou: float
    amount: float | None = None
    tally: Tally | None = field(default=None, repr=False, compare=False)

    def as_dict(self) -> dict[str, Any]:
        """For JSON, without its tally."""
        said = {name: value for name, value in vars(self).items() if name != "tally"}
        return said | {"judged": asdict(self.judged)}


class Run:
    """One system under one condition: label and IoU thresholds of what is to be found."""

    def __init__(self, system: System, label: str, ious: Sequence[float]) -> None:
        self.system, self._label, self._ious = system, label, tuple(ious)
        self._scores: list[list[np.ndarray]] = [[] for _ in ious]
        self._hits: list[list[np.ndarray]] = [[] for _ in ious]
        self._truths: list[int] = []
        self._kbit: list[float] = []
        self._ages: list[float] = []
        self._tracks, self._last = Tracks(), -np.inf

    def tracked(self, detections: Detections, now: float, age: float, *, begins: bool) -> Detections:
        """What was detected in measurements of an age, where it is now."""
        if begins:
            self._tracks, self._last = Tracks(), -np.inf
        if age != age:
            return detections
        self._last = max(self._last, now - age)
        self._tracks.update(detections, self._last)
        return self._tracks.at(now)

    def add(self, frame: Frame, site: Site, detections: Detections, kbit: float, age: float) -> None:
        """One frame more."""
        counted = centred_in(frame.objects.boxes, site.area)
        for k, iou in enumerate(self._ious):
            matched = match(detections, frame.objects, iou, label=self._label, counted=counted)
            self._scores[k].append(detections.scores[~matched.ignored])
            self._hits[k].append(matched.truth[~matched.ignored] >= 0)
        self._truths.append(int(matched.scored.sum()))
        self._kbit.append(kbit)
        self._ages.append(age)

    def rows(self, condition: Condition, seed: int) -> list[StressRow]:
        """The figures of all frames, at each IoU."""
        ages = np.array(self._ages)
        age = float(ages[~np.isnan(ages)].mean()) if (~np.isnan(ages)).any() else np.nan
        kbit, system = float(np.mean(self._kbit)), self.system
        said = (condition.kind, condition.level, system.scheme.name, system.name)
        tallies = [
            Tally.of_frames(scores, hits, self._truths) for scores, hits in zip(self._scores, self._hits, strict=True)
        ]
        return [
            StressRow(*said, _judged(each, self._label, seed), kbit, age, self._label, iou, condition.amount, each)
            for iou, each in zip(self._ious, tallies, strict=True)
        ]


def _judged(tally: Tally, label: str, seed: int) -> Judgement:
    figures = (tally.ap, *tally.interval(seed=seed), tally.recall, tally.precision if len(tally.hit) else None)
    return Judgement(*figures, int(tally.truths.sum()), len(tally.truths), label)
