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
    narrowed_poses = narrow_pool(question.search_setting, run)
    if narrowed_poses is None:
        return question
    pool = question.setting.pool
    names = tuple(pool.sensors[c].name for c in narrowed_poses)
    stock = replace(question.stock, only=names)
    return replace(question, setting=replace(question.setting, candidates=stock))


def keep_buildable(
    preparations: Sequence[Preparation], objectives: Sequence[Objective], max_kbit: float | None
) -> list[BuildableView]:
    """Return the candidates that may be built at every drawing, and what they see at each.

    They have the same order at every drawing, so that one index means one candidate; between
    drawings candidates are matched by name.

    Args:
        preparations: Traffic at each drawing.
        objectives: Objective over the whole pool at each drawing.
        max_kbit: Most kbit per frame that one sensor may send, None for any number."""
    row_by_name = []  # index of each buildable candidate, at each drawing
    for objective in objectives:
        indices = find_buildable(objective, max_kbit)
        row_by_name.append({objective.names[c]: int(c) for c in indices})
    common = set(row_by_name[0]).intersection(*row_by_name[1:])
    names = [name for name in row_by_name[0] if name in common]
    views = []
    for preparation, index_by_name in zip(preparations, row_by_name, strict=True):
        indices = np.array([index_by_name[name] for name in names], np.int64)
        candidates = preparation.setting.pool.select(indices)
        views.append(BuildableView(candidates, preparation.visibility.select(indices)))
    return views


def find_buildable(objective: Objective, max_kbit: float | None) -> Int64[np.ndarray, " n"]:
    """Return the indices of candidates that may be built first and send at most `max_kbit`.

    Built first means allowed in an empty set. max_kbit: kbit per frame, None for any number."""
    limit = np.inf if max_kbit is None else max_kbit
    return np.flatnonzero(objective.allowed([]) & (objective.loads <= limit))


def find_max_sensors(question: Question, candidates: Candidates) -> int:
    """Return the largest number of sensors that budget and mounts allow, at least 1.

    The cheapest sensors are bought one after another until the money is spent. The first sensor on
    a mount costs the mount too, a further one only its model. If the question names no number,
    `MAX_BOUGHT_SENSORS` is the limit, or the number of kept poles if that is more."""
    first_prices = np.full(len(candidates.mounts), np.inf)  # cheapest first sensor of each mount
    np.minimum.at(first_prices, candidates.mount, candidates.prices)
    more_prices = np.full(len(candidates.mounts), np.inf)  # cheapest further sensor of each mount
    np.minimum.at(more_prices, candidates.mount, candidates.model_prices)
    prices = np.concatenate([first_prices, np.repeat(more_prices, candidates.places - 1)])
    prices = np.sort(prices[np.isfinite(prices)])
    max_price = question.setting.most_price * (1 + 1e-9)  # rounding of sums is no overspending
    affordable = int((np.cumsum(prices) <= max_price).sum())
    max_count = question.sensors
    if max_count is None:
        max_count = max(MAX_BOUGHT_SENSORS, len(question.setting.keep))
    return max(1, min(max_count, affordable))
