"""A fidelity by its name as an objective counts it: IoU thresholds, sensors that fail, levels of traffic, errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from placement_env.cases import IoUs
from placement_env.classes import Classes
from placement_env.fidelity.combined.error_profiles import over_profiles, several
from placement_env.fidelity.combined.mean_iou import iou_thresholds, mean_of
from placement_env.fidelity.combined.robust import Failing, robust
from placement_env.fidelity.combined.traffic_levels import ALL_TRAFFIC, LevelFidelity, TrafficLevels
from placement_env.fidelity.preparation import Preparation, check_errors_for
from placement_env.fidelity.traffic import Traffic, scored
from placement_env.fidelity.visibility import of_frames
from placement_env.protocol import Fidelity
from toolkit.arrays import Int64
from toolkit.objects import LABELS

BY_LEVELS = ("coverage", "surrogate")


@dataclass(frozen=True)
class Counting:
    """What of a set counts. iou: threshold or thresholds; failing: sensors; levels: of traffic."""

    ious: tuple[float, ...]
    failing: Failing
    levels: TrafficLevels = ALL_TRAFFIC

    @staticmethod
    def of(iou: float | Iterable[float], failing: Failing | int = 0, levels: TrafficLevels | int = 1) -> Counting:
        """From what users say. Raises ValueError where it is none."""
        lost = failing if isinstance(failing, Failing) else Failing(failing)
        over = levels if isinstance(levels, TrafficLevels) else TrafficLevels(levels)
        return Counting(iou_thresholds(iou), lost, over)

    @property
    def iou(self) -> IoUs:
        """The threshold, or those whose mean counts."""
        return self.ious[0] if len(self.ious) == 1 else self.ious

    def of_class(self, classes: Classes, name: str) -> IoUs:
        """The threshold or thresholds of a class: its own where it has one, else these."""
        own = tuple(sorted({classes.iou_of(name, iou) for iou in self.ious}))
        return own[0] if len(own) == 1 else own

    @property
    def plain(self) -> bool:
        """Whether it is one threshold, nothing fails and all traffic is one."""
        return len(self.ious) == 1 and not self.failing.sensors and self.levels.count == 1

    @property
    def origin(self) -> dict[str, Any]:
        """What results say of it."""
        failing = {"failing": asdict(self.failing)} if self.failing.sensors else {}
        levels = {"levels": asdict(self.levels)} if self.levels.count > 1 else {}
        return {"iou": self.ious[0] if len(self.ious) == 1 else list(self.ious), **failing, **levels}

    def check(self, preparation: Preparation, fidelity: str) -> None:
        """Raises ValueError where the fidelity cannot score so at one of the thresholds; renders nothing."""
        for iou in self.ious:
            replace(preparation, iou=iou).check(fidelity)
        if self.levels.count > 1 and fidelity not in BY_LEVELS:
            raise ValueError(f"levels of traffic are known to fidelity {' and '.join(BY_LEVELS)}, got {fidelity!r}")

    def preparations(self, preparation: Preparation) -> tuple[Preparation, ...]:
        """The same at each threshold; what was seen is seen once."""
        if len(self.ious) == 1:
            return (preparation,)
        return tuple(preparation.changed(iou=iou) for iou in self.ious)

    def fidelity(self, preparation: Preparation, name: str) -> Fidelity:
        """The fidelity of that name, so counted; over several error profiles, at each of them."""
        check_errors_for(preparation.errors, name)
        over = several(preparation.errors)
        if over is not None:
            return over_profiles([self.fidelity(each, name) for each in preparation.at_profiles], over)
        made = self.preparations(preparation)
        whole = mean_of([each.fidelity(name) for each in made])
        if self.levels.count == 1:
            return robust(whole, self.failing)
        seen, parts = preparation.visibility, []
        for frames in self.parts(preparation.traffic):
            there = of_frames(seen, frames)
            parts.append(mean_of([each.at(each.candidates, there).fidelity(name) for each in made]))
        return robust(LevelFidelity(whole, parts, self.levels), self.failing)

    def parts(self, traffic: Traffic) -> tuple[Int64[np.ndarray, " _"], ...]:
        """The frames of each level of traffic, by how many road users of any class are in the site's area."""
        every = range(len(LABELS))
        there = [int(scored(each.objects, traffic.site, every).sum()) for each in traffic.snapshots]
        return self.levels.parts(np.array(there, np.int64))
