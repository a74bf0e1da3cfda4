"""`Demand` on the cheapest set: reach an AP, whichever sensor fails, and in each share of the traffic by itself.

Shares are consecutive parts of the frames, or levels of traffic by how many road users are there at once. What a set
reaches is the least over its failures and the shares, as the fidelity itself scores what is left of it.
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
    """at_least: AP, or share covered; failing: sensors that may fail, 0 or 1; parts: consecutive ones of the traffic,
    in each of which it is asked for; levels: of traffic, at each of which it is, instead. Raises ValueError where these
    do not fit."""

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

    @property
    def plain(self) -> bool:
        """True where nothing fails and traffic is undivided."""
        return not self.failing and self.parts == 1 and self.levels == 1

    def described(self, shares: int) -> str:
        """The conditions in words, of so many shares of the traffic.

        >>> Demand(0.9, 1, levels=3).described(3), Demand(0.9).described(1)
        (' at each of 3 levels of traffic, whichever sensor fails', '')
        """
        what = f" in each of {shares} parts of the traffic" if self.parts > 1 else ""
        what += f" at each of {shares} levels of traffic" if self.levels > 1 else ""
        return what + (", whichever sensor fails" if self.failing else "")

    def shares(self, objective: Objective, seen: Visibility) -> list[Int64[np.ndarray, " _"]]:
        """The frames of each share of the traffic in which there is an object that counts. seen: the objects that
        count; how full a frame is goes by the objective's traffic, else by these."""
        there = np.bincount(seen.frame, minlength=seen.frames)
        if self.levels == 1:
            part = np.arange(seen.frames) * self.parts // max(1, seen.frames)
            found = [np.flatnonzero(part == k) for k in range(self.parts)]
        elif objective.preparation is not None:
            found = list(objective.preparation.split(self.levels))
        else:
            found = list(Cases(levels=self.levels).split(there))
        return [frames for frames in found if there[frames].any()]

    def reach(self, by: Sequence[Fidelity], sets: Bool[np.ndarray, "n C"]) -> Float64[np.ndarray, " n"]:
        """Least AP of each set over its failures and the shares; 0 where a failure leaves nothing.

        by: fidelity of each share.
        """
        if not len(sets):
            return np.zeros(0)
        cases = Cases(failing=self.failing)
        rows, owners = cases.expand(sets)
        return cases.over_failures(np.min([each(rows).ap for each in by], axis=0), owners, tie=0)


class DemandFidelity:
    """Sets scored by the least AP that a demand looks at; recall and kbit are those of the intact set in all traffic.
    whole, by: fidelity of all frames, and of each share's."""

    def __init__(self, whole: Fidelity, by: Sequence[Fidelity], demand: Demand) -> None:
        self._whole, self._by, self._demand, self.name = whole, tuple(by), demand, whole.name

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """The least AP of each set; equal ones are told apart by a trace of the intact set's."""
        intact = self._whole(subsets)
        return intact._replace(ap=self._demand.reach(self._by, subsets) + TIE * intact.ap)
