"""`choose`: the best of the judged sets, and the sets that are as good.

Among the sets whose AP is within `NEAR_TIE_AP` of the highest, the best has the greatest mean AP
over the detector's IoU thresholds. A set is as good as the best if, on the same frames, its whole
interval of the loss is within the tolerance (`is_as_good`)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from placement_env.analysis import intervals
from placement_env.analysis.intervals import Resamples
from placement_env.report.content import PlanOption
from placement_env.search.exact.exhaustive import find_front
from placement_env.search.portfolio.portfolio import NEAR_TIE_AP
from toolkit.arrays import Bool

Rule = Literal["best", "as good", "cheapest", "none"]


@dataclass(frozen=True, eq=False)
class Choice:
    """The answer among options: all entrants in their order, judged or not.

    Attributes:
        options: Every entrant.
        sets: Members of each entrant.
        chosen: Index of the answer.
        best: Index of the best set.
        alike: Indices of sets as good as the best, without the answer.
        rule: Rule by which the answer was chosen.
        confidence: Probability that no set of as many sensors is better than the answer by more
            than `AP_TOLERANCE`, on all frames of the comparison. None without a race, as when sets
            were judged by price, and with too few frames or objects."""

    options: tuple[PlanOption, ...]
    sets: Bool[np.ndarray, "n C"]
    chosen: int
    best: int
    alike: tuple[int, ...]
    rule: Rule
    confidence: float | None = None

    @property
    def option(self) -> PlanOption:
        """The answer."""
        return self.options[self.chosen]

    @property
    def members(self) -> tuple[int, ...]:
        """Indices of the candidates of the answer, ascending."""
        return tuple(np.flatnonzero(self.sets[self.chosen]).tolist())

    @property
    def near_optimal(self) -> tuple[PlanOption, ...]:
        """Sets that are as good as the best, cheap ones first."""
        return tuple(sorted((self.options[i] for i in self.alike), key=rank_thrift))


def rank_thrift(option: PlanOption) -> tuple[float, int, float, float]:
    """Sort key: cheap sets first, then few sensors, then a high mean AP over IoU thresholds."""
    return option.price, len(option.sensors), -(option.mean_ap or 0.0), option.kbit_per_sensor


def choose(
    options: Sequence[PlanOption], draws: Mapping[int, Resamples]
) -> tuple[int, tuple[int, ...]]:
    """Return the index of the best option, and of all options as good as it, cheap ones first.

    The best option is among both. Options with too narrow links are left out, unless all have
    them. draws: resampled AP of each judged option, on the same frames."""
    judged = {i: counted for i in sorted(draws) if (counted := options[i].counted) is not None}
    fitting = {i: counted for i, counted in judged.items() if options[i].fits_links}
    judged = fitting or judged
    highest_ap = max(judgement.ap for judgement in judged.values())
    close = [i for i, judgement in judged.items() if judgement.ap >= highest_ap - NEAR_TIE_AP]
    best = min(close, key=lambda i: (-(options[i].mean_ap or 0.0), *rank_thrift(options[i])))
    blocks = intervals.count_blocks(judged[best].frames)
    alike = [i for i in judged if i == best or intervals.is_as_good(draws[i], draws[best], blocks)]
    return best, tuple(sorted(alike, key=lambda i: (*rank_thrift(options[i]), i != best)))


def find_front_options(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Return the judged sets that no other beats in AP, kbit per sensor and price together."""
    judged_options = [(option, option.counted) for option in options if option.counted is not None]
    figures = [
        (-judgement.ap, option.kbit_per_sensor, option.price)
        for option, judgement in judged_options
    ]
    front = [judged_options[i] for i in find_front(np.array(figures).reshape(-1, 3))]
    front.sort(key=lambda pair: (pair[0].price, pair[1].ap))
    return tuple(option for option, _ in front)
