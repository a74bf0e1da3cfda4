"""`Demand` on the cheapest set: an AP to reach, whichever sensor fails, and in each share of the traffic by itself.

Shares are consecutive parts of the frames, or levels of traffic by the number of road users present. The reach of a set
is the least over its failures and the shares, as the fidelity itself scores the remaining sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.cases import TIE, Cases
from placement_env.checks import check_whole
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.protocol import Estimate, Fidelity
from toolkit.arrays import Bool, Float64, Int64


@dataclass(frozen=True)
class Demand:
    """Conditions that the cheapest set must meet. Raises ValueError where these do not fit.

    at_least: AP, or share covered; failing: sensors that may fail, 0 or 1; parts: consecutive parts of the traffic that
    must each reach it; levels: traffic levels that must each reach it, instead of parts.
    """

    at_least: float = 0.9
    failing: int = 0
    parts: int = 1
    levels: int = 1

    def __post_init__(self) -> None:
        check_whole("parts", self.parts, least=1)
        Cases(levels=self.levels)
        if not 0 < self.at_least <= 1:
            raise ValueError(f"the AP to be reached must lie above 0 and up to 1, got {self.at_least}: 0.9 is 0.9")
        if self.failing not in (0, 1):
            raise ValueError(f"0 or 1 sensor may fail here, got failing={self.failing}")
        if self.parts > 1 and self.levels > 1:
            raise ValueError("an AP is asked for in parts of the traffic or at levels of it: leave one of them out")

    def describe(self, shares: int) -> str:
        """The conditions in words. shares: their number.

        >>> Demand(0.9, 1, levels=3).describe(3), Demand(0.9).describe(1)
        (' at each of 3 levels of traffic, whichever sensor fails', '')
        """
        what = f" in each of {shares} parts of the traffic" if self.parts > 1 else ""
        what += f" at each of {shares} levels of traffic" if self.levels > 1 else ""
        return what + (", whichever sensor fails" if self.failing else "")

    def shares(self, objective: Objective, seen: Visibility) -> list[Int64[np.ndarray, " _"]]:
        """Frames of each share of the traffic, where they hold a counted object.

        seen: the counted objects. The traffic level of a frame comes from the objective's traffic, else from these.
        """
        there = np.bincount(seen.frame, minlength=seen.frames)
        found: Sequence[Int64[np.ndarray, " _"]]
        if self.levels == 1:
            part = np.arange(seen.frames) * self.parts // max(1, seen.frames)
            found = [np.flatnonzero(part == k) for k in range(self.parts)]
        elif objective.preparation is not None:
            found = objective.preparation.split(self.levels)
        else:
            found = Cases(levels=self.levels).split(there)
        return [frames for frames in found if there[frames].any()]

    def reach(self, by: Sequence[Fidelity], sets: Bool[np.ndarray, "n C"]) -> Float64[np.ndarray, " n"]:
        """Least AP of each set over failures and shares; 0 if a failure leaves nothing. by: fidelity of each share."""
        if not len(sets):
            return np.zeros(0)
        cases = Cases(failing=self.failing)
        rows, owners = cases.expand(sets)
        return cases.over_failures(np.min([each(rows).ap for each in by], axis=0), owners, tie=0)


USUAL_DEMAND = Demand()


class DemandFidelity:
    """Score sets by the least AP of a demand; recall and kbit are those of the intact set in all traffic.

    whole, by: fidelity of all frames, and of each share.
    """

    def __init__(self, whole: Fidelity, by: Sequence[Fidelity], demand: Demand) -> None:
        self._whole, self._by, self._demand, self.name = whole, tuple(by), demand, whole.name

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Least AP of each set. A trace of the intact set's AP separates equal ones."""
        intact = self._whole(subsets)
        return intact._replace(ap=self._demand.reach(self._by, subsets) + TIE * intact.ap)
