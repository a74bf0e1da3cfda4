"""Candidates that may be built, and the largest number of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.report.planning.question import Question
from placement_env.search.first_look import narrow_pool
from toolkit.arrays import Int64
from toolkit.runtime.run import Run

MAX_BOUGHT_SENSORS = 12  # sensors that money may buy if their number is not limited


class BuildableView(NamedTuple):
    """Candidates that may be built, and what they see at one drawing of the site."""

    candidates: Candidates
    visibility: Visibility


def narrow_question(question: Question, run: Run) -> Question:
    """Return the question with only the poses that see most, if there are too many to search.

    The poses stay as names in the question's stock (`Stock.only`). A pool that is small enough
    comes back as the same question.

    run: run of the search traffic; some of its frames are looked at."""
    kept_candidates = narrow_pool(question.search_setting, run)  # indices, None for all
    if kept_candidates is None:
        return question
    pool = question.setting.pool
    names = tuple(pool.sensors[c].name for c in kept_candidates)
    stock = replace(question.stock, only=names)
    return replace(question, setting=replace(question.setting, candidates=stock))


def keep_buildable(
    preparations: Sequence[Preparation], objectives: Sequence[Objective], max_kbit: float | None
) -> list[BuildableView]:
    """Return the candidates that may be built at every drawing, and what they see at each.

    A drawing fills in at random what no map knows of the site. Candidates have the same order at
    every drawing, so that one index means one candidate; they are matched by name.

    Args:
        preparations: Traffic at each drawing.
        objectives: Objective over the whole pool at each drawing.
        max_kbit: Most kbit per frame that one sensor may send, None for any number."""
    drawing_indices = []  # index of each buildable candidate by its name, for each drawing
    for objective in objectives:
        indices = find_buildable(objective, max_kbit)
        drawing_indices.append({objective.names[c]: int(c) for c in indices})
    common_names = set(drawing_indices[0]).intersection(*drawing_indices[1:])
    # in the order of the first drawing
    names = [name for name in drawing_indices[0] if name in common_names]
    views = []
    for preparation, index_by_name in zip(preparations, drawing_indices, strict=True):
        indices = np.array([index_by_name[name] for name in names], np.int64)
        candidates = preparation.setting.pool.select(indices)
        views.append(BuildableView(candidates, preparation.visibility.select(indices)))
    return views


def find_buildable(objective: Objective, max_kbit: float | None) -> Int64[np.ndarray, " n"]:
    """Return the indices of candidates that may be built first and send at most `max_kbit`.

    Built first means allowed in an empty set. max_kbit: kbit per frame, None for any number."""
    limit_kbit = np.inf if max_kbit is None else max_kbit
    return np.flatnonzero(objective.allowed([]) & (objective.loads <= limit_kbit))


def find_max_sensors(question: Question, candidates: Candidates) -> int:
    """Return the largest number of sensors that budget and mounts allow, at least 1.

    The cheapest sensors are bought one after another until the money is spent. The first sensor on
    a mount costs the mount too, a further one only its model. If the question names no number,
    `MAX_BOUGHT_SENSORS` is the limit, or the number of kept poles if that is more.

    candidates: sensors that may be built; `mount` is the index of each one's mount, `places` the
    number of sensors that each mount can carry."""
    # cheapest first sensor of each mount, infinite for a mount without candidates
    first_prices = np.full(len(candidates.mounts), np.inf)
    np.minimum.at(first_prices, candidates.mount, candidates.prices)
    # cheapest further sensor of each mount
    more_prices = np.full(len(candidates.mounts), np.inf)
    np.minimum.at(more_prices, candidates.mount, candidates.model_prices)
    place_prices = np.concatenate([first_prices, np.repeat(more_prices, candidates.places - 1)])
    rising_prices = np.sort(place_prices[np.isfinite(place_prices)])
    max_price = question.setting.most_price * (1 + 1e-9)  # rounding of sums is no overspending
    affordable = int((np.cumsum(rising_prices) <= max_price).sum())
    max_count = question.sensors
    if max_count is None:
        max_count = max(MAX_BOUGHT_SENSORS, len(question.setting.keep))
    return max(1, min(max_count, affordable))
