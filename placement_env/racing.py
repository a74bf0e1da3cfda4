"""Racing: find the best of many sensor sets without scoring all of them on all frames.

`race` is successive halving (Karnin, Koren and Somekh 2013; Jamieson and Talwalkar 2016) with
frames as the budget. All sets are scored on a few frames, the best 1/eta of them on eta times as
many, and so on; the last few are scored on all frames. The frames come in random order, because
neighbours in time show nearly the same traffic. `race_until` drops a set only if the frames show
that it is worse, and ends as soon as a stated confidence is reached (racing in the sense of Maron
and Moore 1994, with a bootstrap over blocks of frames instead of Hoeffding's bound).
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from placement_env.analysis.shrinkage import shrink
from placement_env.subsets import Sets
from toolkit.arrays import Float64, Int64, Mask, Rng

# returns a figure, such as AP, of each of n sensor sets from some frames
PartialScores = Callable[[Sets, Int64[np.ndarray, " frames"]], Float64[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Race:
    """Course of a race.

    Attributes:
        winners: Rows of the best sets, best first, including ties with the last.
        scores: Score of each winner from all frames.
        spent: Set-frames that were scored.
        full: Set-frames that scoring all sets on all frames would take.
    """

    winners: Int64[np.ndarray, " k"]
    scores: Float64[np.ndarray, " k"]
    spent: int
    full: int


class Resampled(NamedTuple):
    """Figures of n sets on some frames, and resamples of blocks of these frames.

    Attributes:
        figure: Figure of each set.
        resamples: Resampled figures.
        frames: Number of used frames if time ran out, else None.
        blocks: Number of blocks of frames.
    """

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

    Attributes:
        ranking: Rows of all different sets, best first, dropped ones last.
        figures: Figure of each set in that order, from the frames it was scored on.
        frames: Number of these frames.
        confidence: Confidence that no set beats the first by more than the tolerance.
        spent: Set-frames that were scored.
        expected: Likeliest figure of each set, given these frames and the predictions.
        rungs: Rungs from the first on.
        tolerance: Lead that does not count.
        by_chance: Lowest doubt about any set if time ran out.
    """

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
        """Chance that some set beats this one clearly. judged: rows that are compared elsewhere, so
        ignored."""
        return _doubt(self.rungs, row, self.tolerance, judged)

    def sureness(self, row: int) -> float:
        """Confidence that no set of the race beats this one by more than the tolerance."""
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
    """Best `keep` of n sets by their score on all frames, with most others dropped after a few
    frames.

    partial_scores is called with sets and some of the frames 0 … frames-1. Each rung passes the
    frames of the one before, in the same order, and more, so earlier work can be reused. eta:
    factor by which a rung multiplies frames and divides sets; first: frames of the first rung. Sets
    that tie with the last one to advance also advance, as do all while no score is defined. Equal
    rows are scored once; the first represents all. Raises ValueError without a set or frame, for
    eta below 2, and for first or keep below 1.
    """
    are_whole = all(isinstance(number, int | np.integer) for number in (frames, first, keep, eta))
    if not are_whole or min(len(sets), frames, first, keep, eta - 1) < 1:
        rule = "a race needs a set, a frame, eta >= 2, first >= 1 and keep >= 1, whole numbers"
        raise ValueError(
            f"{rule}, got {len(sets)} sets, {frames} frames, eta {eta}, first {first} and keep "
            f"{keep}"
        )
    order = np.random.default_rng(seed).permutation(frames)
    rows = np.sort(np.unique(sets, axis=0, return_index=True)[1])
    full = len(rows) * frames
    spent = 0
    used_frames = 0
    while used_frames < frames:
        frame_count = min(frames, max(first, used_frames * eta)) if len(rows) > keep else frames
        scores = np.asarray(partial_scores(sets[rows], order[:frame_count]), float)
        spent = spent + len(rows) * (frame_count - used_frames)
        used_frames = frame_count
        max_ahead = keep if used_frames == frames else max(keep, -(-len(rows) // eta))
        ahead = find_best(scores, max_ahead)
        rows = rows[ahead]
        scores = scores[ahead]
    return Race(rows, scores, spent, full)


@dataclass(frozen=True)
class RaceRules:
    """Rules of a race until a confidence. Raises ValueError if they do not fit.

    Attributes:
        confidence: Level to reach.
        tolerance: Lead that does not count.
        first: Frames of the first rung.
        eta: Factor by which later rungs grow.
        least: Frames before which no confidence ends the race.
        most: Set-frames beyond which only the best sets go on; a single one need not.
    """

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


class _Dropped(NamedTuple):
    """Sets that left a race together, best first, with figures from a number of frames."""

    rows: Int64[np.ndarray, " _"]
    figures: Float64[np.ndarray, " _"]
    frames: int

    def repeat_frames(self) -> Int64[np.ndarray, " _"]:
        """Number of frames of each set."""
        return np.full(len(self.rows), self.frames)


class _Ranked(NamedTuple):
    """Sets on one rung of a race, best first.

    Attributes:
        rows: Rows of the sets.
        figures: Likeliest figures, given the frames and the predictions.
        scored: Figures from the frames alone.
        resamples: Resamples of the likeliest figures.
        blocks: Number of blocks of frames.
        frames: Number of frames if it is smaller than requested, else None.
    """

    rows: Int64[np.ndarray, " n"]
    figures: Float64[np.ndarray, " n"]
    scored: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]
    blocks: float
    frames: int | None

    def drop(self, is_leaving: Mask, frames: int) -> _Dropped:
        """Sets that leave the race after a number of frames."""
        return _Dropped(self.rows[is_leaving], self.scored[is_leaving], frames)


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
    race ends with these; predicted: prior figure of each set; sets are then ranked by the
    combination that `placement_env.analysis.shrinkage.shrink` makes of both.

    A set is dropped if it beats the best in fewer than (1 - confidence) / n of the resamples. The
    remaining doubt is the share of resamples in which a set still in the race beats the winner by
    more than the tolerance, plus, for each rung, the share in which a set dropped after it does. If
    time ran out it is at least 2^-blocks, the chance that the same of two equal sets is the better
    one in every block. Raises ValueError without a set or frame.
    """
    frames = len(order)
    if min(len(sets), frames) < 1:
        raise ValueError(
            f"a race until a confidence needs a set and a frame, got {len(sets)} sets, {frames} "
            "frames"
        )
    running = np.sort(np.unique(sets, axis=0, return_index=True)[1])
    risk = (1 - rules.confidence) / len(running)
    used_frames = 0
    spent = 0
    dropped: list[_Dropped] = []
    rungs: list[Rung] = []
    expected = np.zeros(len(sets))
    is_over = False
    while not is_over:
        frame_count = min(frames, max(rules.first, used_frames * rules.eta))
        ranked = _rank(scores, sets, running, order[:frame_count], predicted)
        counted = frame_count if ranked.frames is None else ranked.frames
        spent = spent + len(running) * (counted - used_frames)
        used_frames = counted
        expected[ranked.rows] = ranked.figures
        rungs.append(Rung(ranked.rows, ranked.resamples))
        by_chance = 0.0 if ranked.frames is None or len(sets) == 1 else 0.5**ranked.blocks
        confidence = 1 - max(by_chance, _doubt(rungs, int(ranked.rows[0]), rules.tolerance))
        is_sure = confidence >= rules.confidence and used_frames >= rules.least
        is_over = used_frames == frames or used_frames < frame_count or is_sure
        if not is_over:
            next_frames = min(frames, used_frames * rules.eta) - used_frames
            max_sets = max(1.0, (rules.most - spent) / next_frames)
            is_running = _find_running(ranked.resamples, risk, max_sets)
            # with one set left, more frames would change no rank
            is_over = used_frames >= rules.least and is_running.sum() == 1
        is_leaving = np.ones(len(ranked.rows), np.bool_) if is_over else ~is_running
        dropped.append(ranked.drop(is_leaving, used_frames))
        running = ranked.rows[~is_leaving]
    dropped.reverse()
    ranking = np.concatenate([group.rows for group in dropped])
    return Contest(
        ranking=ranking,
        figures=np.concatenate([group.figures for group in dropped]),
        frames=np.concatenate([group.repeat_frames() for group in dropped]),
        confidence=max(0.0, confidence),
        spent=spent,
        expected=expected[ranking],
        rungs=tuple(rungs),
        tolerance=rules.tolerance,
        by_chance=by_chance,
    )


def _rank(
    scores: ResampledScores,
    sets: Sets,
    running: Int64[np.ndarray, " n"],
    order: Int64[np.ndarray, " frames"],
    predicted: Float64[np.ndarray, " n"] | None,
) -> _Ranked:
    """Score the sets that are still in a race, and rank them. predicted: prior figures."""
    resampled = scores(sets[running], order)
    figures = resampled.figure
    resamples = resampled.resamples
    if predicted is not None:
        shrunk = shrink(figures, resamples, predicted[running], resampled.blocks)
        figures = shrunk.figure
        resamples = shrunk.resamples
    ranks = np.argsort(-figures, kind="stable")
    return _Ranked(
        rows=running[ranks],
        figures=figures[ranks],
        scored=resampled.figure[ranks],
        resamples=resamples[ranks],
        blocks=resampled.blocks,
        frames=resampled.frames,
    )


def _find_running(
    resamples: Float64[np.ndarray, "n resamples"], risk: float, max_sets: float
) -> Mask:
    """Mask of the ranked sets that go on: those that lead often enough, and the first."""
    lead = resamples - resamples[0]
    is_running = np.nan_to_num((lead > 0).mean(axis=1)) >= risk
    is_running[0] = True
    return np.asarray(is_running & (np.cumsum(is_running) <= max_sets))


def _doubt(
    rungs: Sequence[Rung], winner: int, tolerance: float, judged_rows: Iterable[int] = ()
) -> float:
    """Chance that some set beats the winner clearly, as a share of the winner's resamples.

    Sets are compared on the last rung that both they and the winner reached. judged_rows: rows that
    do not count.
    """
    doubt = 0.0
    counted = np.array([*judged_rows], np.int64)
    for rows, resamples in reversed(rungs):
        if winner not in rows:
            continue
        is_better = resamples - resamples[rows == winner] > tolerance
        is_new = ~np.isin(rows, counted)
        doubt += float(is_better[is_new].any(axis=0).mean())
        counted = np.union1d(counted, rows)
    return doubt


def find_best(scores: Float64[np.ndarray, " n"], places: int) -> Int64[np.ndarray, " k"]:
    """Rows of the best scores, best first and undefined ones last, with all that tie with the last
    place."""
    ranked = np.argsort(-scores, kind="stable")
    ranks = np.nan_to_num(scores[ranked], nan=-np.inf)
    return ranked[ranks >= ranks[min(places, len(ranks)) - 1]]
