"""Answers that a search reports before it ends."""

from collections.abc import Callable

from placement_env.fidelity.preparation import Preparation
from placement_env.handover.mounted import set_names
from placement_env.objective import Objective, Score
from placement_env.search.methods import load_search
from placement_env.search.order import SearchOrder

MIN_GAIN_AP = 0.001  # smallest improvement that is reported during the search


def find_first_answer(order: SearchOrder, preparation: Preparation) -> Score:
    """Return the score of greedy's answer on the first frames, and report it (`SearchOrder.tell`).

    preparation: first frames of the search with the order's candidates."""
    objective = Objective.from_view(
        preparation, preparation.setting.pool, preparation.visibility, order.setting.weights
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
    reported; tell: called with each line of text."""

    def __init__(self, objective: Objective, first: Score, tell: Callable[[str], None]) -> None:
        self._objective = objective
        self._tell = tell
        self._last = first.subset
        self._reward = objective.score(first.subset).reward

    def __call__(self, subset: tuple[int, ...], reward: float, raced: int) -> None:
        """Report a set unless it is the last one, or too little better.

        subset: indices of its candidates; reward: by the objective, or in the race; raced: frames
        of the race so far, 0 before it."""
        if subset == self._last or (not raced and reward < self._reward + MIN_GAIN_AP):
            return
        self._last = subset
        self._reward = reward
        names = ", ".join(set_names(self._objective.candidates, subset))
        if raced:
            self._tell(f"ahead after {raced} frames of the race: {names}")
        else:
            self._tell(f"better: {names}, predicted AP {self._objective.score(subset).ap:.3f}")
