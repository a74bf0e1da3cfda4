"""Answers that a search reports before it ends."""

from collections.abc import Callable

from placement_env.fidelity.preparation import Preparation
from placement_env.handover.mounted import set_names
from placement_env.objective import Objective, Score
from placement_env.search.methods import load_search
from placement_env.search.order import SearchOrder

MIN_GAIN_AP = 0.001  # smallest improvement that is reported during the search


def find_first_answer(order: SearchOrder, preparation: Preparation) -> Score:
    """Score of greedy's answer on the first frames, which is also reported as a line of text.

    order: has the budget and the function to report to; preparation: first frames of the search
    with the order's candidates."""
    objective = Objective.from_view(
        preparation,
        candidates=preparation.setting.pool,
        visibility=preparation.visibility,
        weights=order.setting.weights,
    )
    best = load_search("greedy")(objective, order.budget, seed=order.run.seed).best
    names = ", ".join(set_names(objective.candidates, best.subset)) or "no sensors"
    if order.tell is not None:
        order.tell(
            f"first answer, by greedy on {len(preparation.traffic)} frames: {names}, predicted AP "
            f"{best.ap:.3f}"
        )
    return best


class BetterReport:
    """Report each better set: first by its prediction, then the leader of the race.

    An objective calls it as `Objective.watch`. first: score of the first answer, which was
    reported; report: called with each line of text."""

    def __init__(self, objective: Objective, first: Score, report: Callable[[str], None]) -> None:
        self._objective = objective
        self._report = report
        self._last_subset = first.subset
        self._last_reward = objective.score(first.subset).reward

    def __call__(self, subset: tuple[int, ...], reward: float, race_frames: int) -> None:
        """Report a set unless it was the last one reported, or is better by too little.

        subset: indices of its candidates; reward: by the objective, or in the race; race_frames:
        frames that the race has scored so far, 0 before it. In the race each new leader counts."""
        is_small_gain = not race_frames and reward < self._last_reward + MIN_GAIN_AP
        if subset == self._last_subset or is_small_gain:
            return
        self._last_subset = subset
        self._last_reward = reward
        names = ", ".join(set_names(self._objective.candidates, subset))
        if race_frames:
            self._report(f"ahead after {race_frames} frames of the race: {names}")
        else:
            self._report(f"better: {names}, predicted AP {self._objective.score(subset).ap:.3f}")
