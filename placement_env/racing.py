"""Racing: find the best of many sensor sets without scoring all on all frames, or with an accurate
fidelity.

`race` is successive halving (Karnin, Koren and Somekh 2013; Jamieson and Talwalkar 2016) with
frames as the budget. All sets are scored on a few frames, the best 1/eta of them on eta times as
many, and so on; the last few are scored on all frames. The frames come in random order, because
neighbours in time show nearly the same traffic. `race_until` drops a set only where the frames show
that it is worse, and ends as soon as a stated confidence is reached (racing in the sense of Maron
and Moore 1994, with a bootstrap over blocks of frames instead of Hoeffding's bound)."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from placement_env.analysis.shrinkage import shrink
from placement_env.subsets import Sets
from toolkit.arrays import Float64, Int64, Rng

# figure, such as AP, of each of n sensor sets from some frames
PartialScores = Callable[[Sets, Int64[np.ndarray, " frames"]], Float64[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Race:
    """Course of a race. winners: rows of the best sets, best first, including ties with the last;
    scores: of each, from all frames; spent, full: set-frames scored, and those that scoring all
    sets on all frames would take."""

    winners: Int64[np.ndarray, " k"]
    scores: Float64[np.ndarray, " k"]
    spent: int
    full: int


class Resampled(NamedTuple):
    """Figures of n sets on some frames, and resamples of blocks of these; frames: number used where
    time ran out."""

    figure: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]
    frames: int | None = None
    blocks: float = math.inf


ResampledScores = Callable[[Sets, Int64[np.ndarray, " frames"]], Resampled]


class Rung(NamedTuple):
    """Sets that reached one rung of a race, and resamples of their figures there."""

    rows: Int64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]


@dataclass(frozen=True, eq=False)
class Contest:
    """Course of a race until a confidence.

    ranking: rows of all different sets, best first, dropped ones last; figures: of each in that
    order, from the frames it was scored on; frames: number of these; confidence: that no set beats
    the first by more than the tolerance; spent: set-frames scored; expected: likeliest figure of
    each, given these frames and the predictions; rungs: from the first on; tolerance: a lead that
    does not count; by_chance: least doubt of any set, where time ran out."""

    ranking: Int64[np.ndarray, " k"]
    figures: Float64[np.ndarray, " k"]
    frames: Int64[np.ndarray, " k"]
    confidence: float
    spent: int
    expected: Float64[np.ndarray, " k"]
    rungs: tuple[Rung, ...] = ()
    tolerance: float = 0.0
    by_chance: float = 0.0

    def doubt(self, row: int, judged: Iterable[int] = ()) -> float:
        """Chance that some set beats one of the sets clearly. judged: rows that are compared
        elsewhere, so not here."""
        return _doubt(self.rungs, row, self.tolerance, judged)

    def sureness(self, row: int) -> float:
        """Confidence that no set of the race beats one of them by more than the tolerance."""
        if not self.rungs:
            return self.confidence
        return max(0.0, 1 - max(self.by_chance, self.doubt(row)))


def race(
    partial_scores: PartialScores,
    sets: Sets,
    frames: int,
    *,
    eta: int = 3,
    first: int = 8,
    keep: int = 1,
    seed: int | Rng = 0,
) -> Race:
    """Best `keep` sets of n by their score on all frames, most others dropped after a few frames.

    partial_scores is called with sets and some of the frames 0 … frames-1. Each rung passes the
    frames of the one before, in the same order, and more, so earlier work can be reused. eta:
    factor by which a rung multiplies frames and divides sets; first: frames of the first rung. Sets
    that tie with the last one to advance also advance, as do all while no score is defined. Equal
    rows are scored once; the first stands for all. Raises ValueError without a set or frame, for
    eta below 2, and for first or keep below 1."""
    whole = all(isinstance(number, int | np.integer) for number in (frames, first, keep, eta))
    if not whole or min(len(sets), frames, first, keep, eta - 1) < 1:
        said = "a race needs a set, a frame, eta >= 2, first >= 1 and keep >= 1, whole numbers"
        raise ValueError(
            f"{said}, got {len(sets)} sets, {frames} frames, eta {eta}, first {first} and keep "
            f"{keep}"
        )
    order = np.random.default_rng(seed).permutation(frames)
    running = np.sort(np.unique(sets, axis=0, return_index=True)[1])
    full = len(running) * frames
    spent = 0
    seen = 0
    while seen < frames:
        reached = min(frames, max(first, seen * eta)) if len(running) > keep else frames
        scores = np.asarray(partial_scores(sets[running], order[:reached]), float)
        spent = spent + len(running) * (reached - seen)
        seen = reached
        places = keep if seen == frames else max(keep, -(-len(running) // eta))
        ahead = find_best(scores, places)
        running = running[ahead]
        scores = scores[ahead]
    return Race(running, scores, spent, full)


@dataclass(frozen=True)
class RaceRules:
    """Rules of a race until a confidence. Raises ValueError where they do not fit.

    confidence: level to reach; tolerance: a lead that does not count; first, eta: frames of the
    first rung, and the factor by which later ones grow; least: frames before which no confidence
    ends it; most: set-frames, beyond which only the best go on, and a single one need not."""

    confidence: float = 0.95
    tolerance: float = 0.01
    first: int = 12
    eta: int = 2
    least: int = 0
    most: float = math.inf

    def __post_init__(self) -> None:
        if (
            min(self.first, self.eta - 1) < 1
            or not 0 < self.confidence < 1
            or not self.tolerance >= 0
        ):
            raise ValueError(
                "a race until a confidence needs eta >= 2, first >= 1, a confidence between 0 "
                f"and 1 and a tolerance from 0 up, got eta {self.eta}, first {self.first}, "
                f"confidence {self.confidence} and tolerance {self.tolerance}"
            )


def race_until(
    scores: ResampledScores,
    sets: Sets,
    order: Int64[np.ndarray, " frames"],
    rules: RaceRules = RaceRules(),
    *,
    predicted: Float64[np.ndarray, " n"] | None = None,
) -> Contest:
    """Race sets until the best is known confidently enough, or all frames are used.

    scores: called with sets and the first frames of `order`, more each time; if it uses fewer, the
    race ends with these; predicted: prior figure of each set; sets are then ranked by what
    `placement_env.analysis.shrinkage.shrink` makes of both.

    A set is dropped where it beats the best in fewer than (1 - confidence) / n of the resamples.
    The remaining doubt is the share of resamples in which a set still in the race beats the winner
    by more than the tolerance, plus, for each rung, the share in which a set dropped after it does.
    Where time ran out it is at least 2^-blocks, the chance that the same of two equal sets is the
    better one in every block. Raises ValueError without a set or frame."""
    frames = len(order)
    if min(len(sets), frames) < 1:
        raise ValueError(
            f"a race until a confidence needs a set and a frame, got {len(sets)} sets, {frames} "
            "frames"
        )
    running = np.sort(np.unique(sets, axis=0, return_index=True)[1])
    risk = (1 - rules.confidence) / len(running)
    seen = 0
    spent = 0
    dropped: list[tuple[Int64[np.ndarray, " _"], Float64[np.ndarray, " _"], int]] = []
    rungs: list[Rung] = []
    expected = np.zeros(len(sets))
    while True:
        reached = min(frames, max(rules.first, seen * rules.eta))
        found = scores(sets[running], order[:reached])
        counted = reached if found.frames is None else found.frames
        spent = spent + len(running) * (counted - seen)
        seen = counted
        measured = found.figure
        if predicted is not None:
            likely = shrink(found.figure, found.resamples, predicted[running], found.blocks)
            found = found._replace(figure=likely.figure, resamples=likely.resamples)
        expected[running] = found.figure
        ranked = np.argsort(-found.figure, kind="stable")
        found = found._replace(figure=found.figure[ranked], resamples=found.resamples[ranked])
        running = running[ranked]
        measured = measured[ranked]
        rungs.append(Rung(running, found.resamples))
        by_chance = 0.0 if found.frames is None or len(sets) == 1 else 0.5**found.blocks
        sure = 1 - max(by_chance, _doubt(rungs, int(running[0]), rules.tolerance))
        if seen == frames or seen < reached or (sure >= rules.confidence and seen >= rules.least):
            dropped.append((running, measured, seen))
            break
        lead = found.resamples - found.resamples[0]
        stays = np.nan_to_num((lead > 0).mean(axis=1)) >= risk
        stays[0] = True
        added = min(frames, seen * rules.eta) - seen
        stays &= np.cumsum(stays) <= max(1.0, (rules.most - spent) / added)
        if seen >= rules.least and stays.sum() == 1:  # more frames would change no rank
            dropped.append((running, measured, seen))
            break
        dropped.append((running[~stays], measured[~stays], seen))
        running = running[stays]
    rows, figures, counts = zip(*dropped[::-1], strict=True)
    scored_on = np.repeat(np.array(counts, np.int64), [len(each) for each in rows])
    ranking = np.concatenate(rows)
    course = tuple(rungs), rules.tolerance, by_chance
    return Contest(
        ranking,
        np.concatenate(figures),
        scored_on,
        max(0.0, sure),
        spent,
        expected[ranking],
        *course,
    )


def _doubt(
    rungs: Sequence[Rung], winner: int, tolerance: float, judged: Iterable[int] = ()
) -> float:
    """Chance that some set beats the winner clearly: of sets with the same last rung that the
    winner reached too, a share of its resamples. judged: rows that do not count."""
    doubt = 0.0
    counted = np.array([*judged], np.int64)
    for rows, resamples in reversed(rungs):
        if winner not in rows:
            continue
        better = resamples - resamples[rows == winner] > tolerance
        new = ~np.isin(rows, counted)
        doubt += float(better[new].any(axis=0).mean())
        counted = np.union1d(counted, rows)
    return doubt


def find_best(scores: Float64[np.ndarray, " n"], places: int) -> Int64[np.ndarray, " k"]:
    """Rows of the best scores, best first and undefined ones last, with all that tie with the last
    place."""
    ranked = np.argsort(-scores, kind="stable")
    ranks = np.nan_to_num(scores[ranked], nan=-np.inf)
    return ranked[ranks >= ranks[min(places, len(ranks)) - 1]]
