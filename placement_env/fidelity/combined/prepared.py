"""A fidelity by its name as an objective counts it: at one IoU threshold or the mean over several, with what fails."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

from placement_env.classes import Classes
from placement_env.fidelity.combined.mean_iou import IoUs, iou_thresholds, mean_of
from placement_env.fidelity.combined.robust import Failing, robust
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.protocol import Fidelity

KEPT_WITH = ("traffic", "disk_cache", "visibility", "network")  # of preparations that differ in their threshold alone


@dataclass(frozen=True)
class Counting:
    """What of a set counts. iou: threshold or thresholds; failing: sensors."""

    ious: tuple[float, ...]
    failing: Failing

    @staticmethod
    def of(iou: float | Iterable[float], failing: Failing | int = 0) -> Counting:
        """From what users say. Raises ValueError where it is none."""
        return Counting(iou_thresholds(iou), failing if isinstance(failing, Failing) else Failing(failing))

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
        """Whether it is one threshold and nothing fails."""
        return len(self.ious) == 1 and not self.failing.sensors

    @property
    def origin(self) -> dict[str, Any]:
        """What results say of it."""
        failing = {"failing": asdict(self.failing)} if self.failing.sensors else {}
        return {"iou": self.ious[0] if len(self.ious) == 1 else list(self.ious), **failing}

    def check(self, preparation: Preparation, fidelity: str) -> None:
        """Raises ValueError where the fidelity cannot score so at one of the thresholds; renders nothing."""
        for iou in self.ious:
            replace(preparation, iou=iou).check(fidelity)

    def preparations(self, preparation: Preparation) -> tuple[Preparation, ...]:
        """The same at each threshold; what was seen is seen once."""
        if len(self.ious) == 1:
            return (preparation,)
        made = []
        for iou in self.ious:
            at = replace(preparation, iou=iou)
            vars(at).update({name: vars(preparation)[name] for name in KEPT_WITH if name in vars(preparation)})
            made.append(at)
        return tuple(made)

    def fidelity(self, preparation: Preparation, name: str) -> Fidelity:
        """The fidelity of that name, so counted."""
        return robust(mean_of([each.fidelity(name) for each in self.preparations(preparation)]), self.failing)
