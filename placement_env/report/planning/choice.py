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
from placement_env.search.portfolio.reward_race import NEAR_TIE_AP
from toolkit.arrays import Bool

Rule = Literal["best", "as good", "cheapest", "none"]


@dataclass(frozen=True, eq=False)
class Choice:
    """The answer among the entrants, which are the sets that the searches found.

    All indices are rows of `options` and `sets`, which keep the order of the entrants.

    Attributes:
        options: Every entrant with its figures, judged or not.
        sets: True for the candidates that are members of each entrant.
        chosen: Index of the answer.
        best: Index of the best set, which may be the answer.
        alike: Indices of sets as good as the best, cheap ones first, without the answer.
        rule: Reason for the answer: it is the "best", a cheaper one "as good", the "cheapest" that
            reaches the required AP, or the best because "none" reaches it.
        confidence: Probability that no set of as many sensors is better than the answer by more
            than `AP_TOLERANCE`, on all frames of the comparison. None without a race, as when sets
            were judged by price, and with too few frames or objects."""

    options: tuple[PlanOption, ...]
    sets: Bool[np.ndarray, "n candidates"]
    chosen: int
    best: int
    alike: tuple[int, ...]
    rule: Rule
    confidence: float | None = None

    @property
    def option(self) -> PlanOption:
        """The answer with its figures from the comparison."""
        return self.options[self.chosen]

    @property
    def members(self) -> tuple[int, ...]:
        """Indices of the candidates of the answer, ascending."""
        return tuple(np.flatnonzero(self.sets[self.chosen]).tolist())

    def list_judged_rows(self) -> list[int]:
        """List the indices of the options judged on as many frames as the answer, which is all."""
        frames = [0 if option.judged is None else option.judged.frames for option in self.options]
        return np.flatnonzero(np.array(frames) == frames[self.chosen]).tolist()

    @property
    def near_optimal(self) -> tuple[PlanOption, ...]:
        """Sets that are as good as the best, cheap ones first."""
        return tuple(sorted((self.options[i] for i in self.alike), key=rank_thrift))


def rank_thrift(option: PlanOption) -> tuple[float, int, float, float]:
    """Sort key: cheap sets first, then few sensors, high mean AP over IoU, few kbit per sensor.

    A set without a mean AP counts as 0."""
    return option.price, len(option.sensors), -(option.mean_ap or 0.0), option.kbit_per_sensor


def choose(
    options: Sequence[PlanOption], draws: Mapping[int, Resamples]
) -> tuple[int, tuple[int, ...]]:
    """Return the index of the best judged option, and of all options as good as it.

    The indices of options as good are sorted by thrift, cheap ones first. They include the best,
    which comes before an equally thrifty one. Options with too narrow links are left out, unless
    all have them.

    Args:
        options: All options; at least one is judged.
        draws: Resampled AP of each judged option by its index, all on the same frames and with the
            same resamples, so that they can be compared draw by draw."""
    judgements = {}  # results over all cases, by index of the option
    for i in sorted(draws):
        judgement = options[i].counted
        if judgement is not None:
            judgements[i] = judgement
    fitting_judgements = {
        i: judgement for i, judgement in judgements.items() if options[i].fits_links
    }
    eligible_judgements = fitting_judgements or judgements
    highest_ap = max(judgement.ap for judgement in eligible_judgements.values())
    min_ap = highest_ap - NEAR_TIE_AP
    near_ties = [i for i, judgement in eligible_judgements.items() if judgement.ap >= min_ap]
    best = min(near_ties, key=lambda i: (-(options[i].mean_ap or 0.0), *rank_thrift(options[i])))
    blocks = intervals.count_blocks(eligible_judgements[best].frames)
    alike_options = [best]
    for i in eligible_judgements:
        if i != best and intervals.is_as_good(draws[i], draws[best], blocks):
            alike_options.append(i)
    # `i != best` puts the best first among equally thrifty sets
    return best, tuple(sorted(alike_options, key=lambda i: (*rank_thrift(options[i]), i != best)))


def find_front_options(options: tuple[PlanOption, ...]) -> tuple[PlanOption, ...]:
    """Return the judged sets that no other beats in AP, kbit per sensor and price together.

    They are sorted by price, then by AP, both ascending."""
    judged_options = []
    figures = []  # columns to minimise, so AP is negative
    prices_and_aps = []
    for option in options:
        judgement = option.counted
        if judgement is not None:
            judged_options.append(option)
            figures.append((-judgement.ap, option.kbit_per_sensor, option.price))
            prices_and_aps.append((option.price, judgement.ap))
    # an empty list becomes a table of no rows and three columns
    front = find_front(np.array(figures).reshape(-1, 3)).tolist()
    front.sort(key=lambda i: prices_and_aps[i])
    return tuple(judged_options[i] for i in front)
