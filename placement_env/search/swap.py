"""Swap local search: change one sensor at a time until nothing improves, from several starts.

The set is a list of `budget` places, each with one sensor or empty. A step scores every alternative
for one place and takes the best, so it may swap, add or drop a sensor. When no place can be
improved, the set is a local optimum under such changes, and the search restarts from a random set.
"""

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from placement_env.checks import check_whole
from placement_env.objective import Objective
from placement_env.search.checkpoint import Checkpoint, KeptState
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.greedy import grow
from placement_env.search.progress import Progress, add_each, as_rows
from placement_env.search.result import Certificate, Result

DEFAULT_STARTS = 5
EXTRA_SENSOR_CHANCE = 0.5  # chance of each further sensor on mounts that carry several
EMPTY_PLACE = -1  # a place without a sensor


@dataclass
class Climb:
    """Climb in progress, from one start to a local optimum.

    Attributes:
        start: Number of the start, from 0.
        before: Best reward of the search until it began, -inf at the first start.
        places: A candidate's index or `EMPTY_PLACE` each, as many as the budget of sensors.
        waiting: Indices of the places that are still to be changed.
        reward: Reward of the current set.
    """

    start: int
    before: float
    places: list[int]
    waiting: list[int]
    reward: float


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    starts: int | None = None,
    start: Iterable[int | str] | None = None,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Best local optimum of several starts: greedy's set or `start`, then sets drawn from `seed`.

    The certificate is "local optimum" if the neighbourhood of the best set was searched completely.

    Args:
        objective: Objective to maximise.
        budget: Largest number of sensors.
        seed: Seed of the random starts and of the order of places.
        seconds: Time limit, None for none.
        evaluations: Most sets to score, None for no limit.
        starts: Number of starts; None for as many as the limits allow, or `DEFAULT_STARTS` without
            a limit.
        start: Candidates of the first start by index or name; those that do not fit with earlier
            ones are left out. None for greedy's set.
        checkpoint: Keeps the state of the search.

    Raises ValueError if `starts` is below 1, and for an unknown candidate.
    """
    if starts is not None:
        check_whole("starts", starts, least=1)
    progress = Progress(objective, budget, seconds, evaluations)
    rng = np.random.default_rng(seed)
    if starts is None:
        starts = DEFAULT_STARTS if seconds is None and evaluations is None else sys.maxsize
    first_number = 0
    proven = False  # True if no change of one sensor improves the best set
    climb = None

    def state() -> KeptState:
        """Values for a checkpoint, from which the search resumes in the middle of a climb."""
        values = {"progress": progress.state(), "rng": rng.bit_generator.state, "proven": proven}
        return values | ({} if climb is None else {"climb": vars(climb)})

    if (saved := checkpoint.load()) is not None:
        progress.resume(saved["progress"])
        rng.bit_generator.state = saved["rng"]
        proven = saved["proven"]
        climb = Climb(**saved["climb"])
        first_number = climb.start
    for start_number in range(first_number, starts):
        if climb is None:
            if progress.spent and start_number:
                break
            climb = _begin_climb(progress, start_number, rng=rng, start=start)
        is_optimum = _climb_to_optimum(
            progress, climb, rng, save_state=lambda: checkpoint.offer(state)
        )
        proven = is_optimum if progress.reward > climb.before else proven
        climb = None
    certificate = progress.unknown("stopped before all changes of one sensor were tried")
    if proven:
        certificate = Certificate(
            "local optimum", progress.reward, note="no set that differs in one sensor is better"
        )
    return progress.result("swap", certificate)


def _begin_climb(
    progress: Progress,
    start_number: int,
    *,
    rng: np.random.Generator,
    start: Iterable[int | str] | None,
) -> Climb:
    """Climb at its first set, which is scored here.

    start_number: number of the start. Start 0 begins at `start` or at greedy's set
    (`_choose_first_set`), later ones at a set drawn from `rng` (`draw_set`).

    start: candidates of start 0 by index or name, None for greedy's set.
    """
    if start_number == 0:
        best_before = -np.inf
        members = _choose_first_set(progress, start)
    else:
        best_before = progress.reward
        members = draw_set(progress.objective, progress.budget, rng)
    reward = float(progress.rewards(as_rows([members], progress.size))[0])
    places = members + [EMPTY_PLACE] * (progress.budget - len(members))
    return Climb(
        start=start_number,
        before=best_before,
        places=places,
        waiting=list(range(len(places))),
        reward=reward,
    )


def _choose_first_set(progress: Progress, start: Iterable[int | str] | None) -> list[int]:
    """Members (indices) of the set at which the first climb begins.

    They are the candidates of `start` as far as they fit, or greedy's best set without `start`.
    Candidates on poles that must carry a sensor are taken first. If such a pole stays empty, greedy
    adds sensors. If no set on greedy's way pays, its last set is returned.

    start: candidates by index or name, None for greedy's set.
    """
    if start is None:
        last_set = grow(progress).members
        return np.flatnonzero(progress.best).tolist() or last_set
    objective = progress.objective
    members = list[int]()
    candidates = np.flatnonzero(objective.row(start))
    is_required = np.isin(objective.candidates.mount[candidates], objective.kept)
    for candidate in candidates[is_required].tolist() + candidates[~is_required].tolist():
        # `next_allowed`: mask of the candidates that may join these members
        if len(members) < progress.budget and objective.next_allowed(members)[candidate]:
            members.append(candidate)
    # `keeps`: each pole that must carry a sensor has one
    if objective.keeps(objective.row(members)[None])[0]:
        return members
    return grow(progress, start=members).members


def _climb_to_optimum(
    progress: Progress, climb: Climb, rng: np.random.Generator, save_state: Callable[[], None]
) -> bool:
    """Change places one by one until none improves; True if this ended before the limits did.

    Changes `climb`, and keeps the best set in `progress`. After an improvement all other places
    wait again, in an order drawn from `rng`.

    save_state: called before each change; a search that resumes there repeats the change.
    """
    places = climb.places  # index of a candidate or `EMPTY_PLACE` each, changed in place
    while climb.waiting:
        save_state()
        position = climb.waiting.pop(0)
        members = [c for i, c in enumerate(places) if i != position and c != EMPTY_PLACE]
        options = np.flatnonzero(progress.objective.allowed(members))  # may fill the place
        members_row = as_rows([members], progress.size)  # the set with this place empty
        subsets = np.vstack([members_row, add_each(members, options, progress.size)])
        # False if a pole that must carry a sensor is empty
        keeps_required = progress.objective.keeps(subsets)
        # what the place holds in each of the sets
        fillings = np.r_[EMPTY_PLACE, options][keeps_required]
        rewards = progress.rewards(subsets[keeps_required])
        best = int(rewards.argmax()) if len(rewards) else 0
        if len(rewards) and rewards[best] > climb.reward:
            climb.reward = float(rewards[best])
            places[position] = int(fillings[best])
            climb.waiting = [i for i in rng.permutation(len(places)).tolist() if i != position]
        if not np.isfinite(rewards).all():  # -inf beyond the limits
            return False
    if climb.reward == progress.reward:  # among equal sets the one whose neighbourhood was searched
        progress.best = as_rows([[c for c in places if c != EMPTY_PLACE]], progress.size)[0]
    return True


def draw_set(objective: Objective, budget: int, rng: np.random.Generator) -> list[int]:
    """Random feasible set: an affordable candidate on each mount, required mounts first.

    Mounts come in random order. If mounts carry several, further sensors join with a chance of
    `EXTRA_SENSOR_CHANCE` each. The same state of the generator draws the same set, so the order of
    draws must stay.

    budget: largest number of sensors."""
    candidates = objective.candidates
    allowed_candidates = np.flatnonzero(objective.allowed([]))  # indices
    mount = candidates.mount[allowed_candidates]
    members: list[int] = []
    mounts = rng.permutation(np.unique(mount))
    required_first = np.argsort(~np.isin(mounts, objective.kept), kind="stable")
    for next_mount in mounts[required_first].tolist():
        poses = allowed_candidates[mount == next_mount]
        options = poses[objective.next_allowed(members)[poses]]  # that may join these members
        if len(members) < budget and options.size:
            members.append(int(rng.choice(options)))
    while (
        candidates.has_shared_mounts
        and len(members) < budget
        and rng.random() < EXTRA_SENSOR_CHANCE
    ):
        options = np.flatnonzero(objective.allowed(members))
        if not options.size:
            break
        members.append(int(rng.choice(options)))
    return members
