"""Racing: the best of many sensor sets without scoring all of them on all frames, or with an accurate fidelity.

`race` is successive halving (Karnin, Koren and Somekh 2013; Jamieson and Talwalkar 2016) with frames as the budget: all
sets are scored on a few frames, the best 1/eta of them on eta times as many, and so on; the last few on all frames. The
frames come in a random order, as neighbours in time show nearly the same traffic. `verify` scores with an
accurate fidelity the few sets that a fast one finds best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from placement_env.subsets import SetFunction
from toolkit.arrays import Bool, Float64, Int64

PartialScores = Callable[
    [Bool[np.ndarray, "n C"], Int64[np.ndarray, " frames"]], Float64[np.ndarray, " n"]
]  # a figure, such as AP, of each of n sensor sets from some frames alone


@dataclass(frozen=True, eq=False)
class Rung:
    """One stage of a race. sets: rows of the k sets scored, best first; scores: of each, NaN if undefined."""

    frames: int
    sets: Int64[np.ndarray, " k"]
    scores: Float64[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class Race:
    """How a race went. winners: rows of the best sets, best first, and what ties with the last of them; scores: of
    each, from all frames; spent: set-frames scored, a frame that a set was scored on before not counted again; full:
    set-frames that all sets on all frames would take."""

    winners: Int64[np.ndarray, " k"]
    scores: Float64[np.ndarray, " k"]
    rungs: tuple[Rung, ...]
    spent: int
    full: int


@dataclass(frozen=True, eq=False)
class Verified:
    """The k sets that a fast fidelity finds best, as an accurate one ranks them, with the figures of both."""

    sets: Bool[np.ndarray, "k C"]
    fast: Float64[np.ndarray, " k"]
    accurate: Float64[np.ndarray, " k"]


def race(
    partial_scores: PartialScores,
    sets: Bool[np.ndarray, "n C"],
    frames: int,
    *,
    eta: int = 3,
    first: int = 8,
    keep: int = 1,
    seed: int | np.random.Generator = 0,
) -> Race:
    """The `keep` best of n sets by their score on all frames, most sets being dropped after few of them.

    partial_scores is asked for sets on some of the frames 0 … frames-1; each rung asks for the frames of the one
    before, in the same order, and more, so that what was fused and detected before need not be again. eta: by how much
    a rung multiplies frames and divides sets. first: frames of the first rung. Sets that tie with the last to go on go
    on too, as do all while no score is defined (no object yet). Equal rows are scored once; the first stands for all.
    Raises ValueError without a set or frame, or for eta below 2, first or keep below 1.

    >>> ap = np.array([0.3, 0.9, 0.5])
    >>> race(lambda sets, frames: sets @ ap, np.eye(3, dtype=bool), frames=20).winners
    array([1])
    """
    whole = all(isinstance(number, int | np.integer) for number in (frames, first, keep, eta))
    if not whole or min(len(sets), frames, first, keep, eta - 1) < 1:
        raise ValueError(
            "a race needs a set, a frame, eta >= 2, first >= 1 and keep >= 1, whole numbers, "
            f"got {len(sets)} sets, {frames} frames, eta {eta}, first {first} and keep {keep}"
        )
    order = np.random.default_rng(seed).permutation(frames)
    running = np.sort(np.unique(sets, axis=0, return_index=True)[1])
    full, spent, seen = len(running) * frames, 0, 0
    rungs: list[Rung] = []
    while seen < frames:
        reached = min(frames, max(first, seen * eta)) if len(running) > keep else frames
        scores = np.asarray(partial_scores(sets[running], order[:reached]), float)
        spent, seen = spent + len(running) * (reached - seen), reached
        ranked = _best_first(scores)
        rungs.append(Rung(seen, running[ranked], scores[ranked]))
        places = keep if seen == frames else max(keep, -(-len(running) // eta))
        running = rungs[-1].sets[: _with_ties(rungs[-1].scores, places)]
    return Race(running, rungs[-1].scores[: len(running)], tuple(rungs), spent, full)


def verify(fast: SetFunction, accurate: SetFunction, sets: Bool[np.ndarray, "n C"], *, best: int = 5) -> Verified:
    """The `best` of the sets by a fast figure and what ties with the last of them, ranked by an accurate one.

    Equal sets are scored once. Of equal accurate figures the set of the greater fast one goes first.
    Raises ValueError without a set, or for best below 1.

    >>> sets = np.eye(3, dtype=bool)
    >>> verify(lambda s: s @ np.array([0.3, 0.8, 0.9]), lambda s: s @ np.array([0.2, 0.7, 0.6]), sets, best=2).accurate
    array([0.7, 0.6])
    """
    if len(sets) < 1 or best < 1:
        raise ValueError(f"there must be a set to verify and best >= 1, got {len(sets)} sets and best {best}")
    sets = sets[np.sort(np.unique(sets, axis=0, return_index=True)[1])]
    guesses = np.asarray(fast(sets), float)
    ranked = _best_first(guesses)
    few = ranked[: _with_ties(guesses[ranked], best)]
    figures = np.asarray(accurate(sets[few]), float)
    final = _best_first(figures)
    return Verified(sets[few[final]], guesses[few[final]], figures[final])


def _best_first(scores: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Rows by descending score, equal ones in their order, undefined ones last."""
    return np.argsort(-scores, kind="stable")


def _with_ties(descending: Float64[np.ndarray, " n"], places: int) -> int:
    """How many share the first `places`: those and what equals the last of them.

    >>> _with_ties(np.array([0.9, 0.5, 0.5, 0.1]), 2), _with_ties(np.array([0.9, np.nan, np.nan]), 2)
    (3, 3)
    """
    ranks = np.nan_to_num(descending, nan=-np.inf)
    return int((ranks >= ranks[min(places, len(ranks)) - 1]).sum())
