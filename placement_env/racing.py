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
from toolkit.arrays import Bool, Float64, Int64, Rng

# called with n sensor sets and indices of frames; returns a figure of each set, such as its AP,
# from these frames only
PartialScores = Callable[[Sets, Int64[np.ndarray, " frames"]], Float64[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Race:
    """Course of a race.

    Attributes:
        winners: Rows of the best sets in the array that raced, best first, including ties with the
            last.
        scores: Score of each winner from all frames, in the order of `winners`.
        spent: Set-frames that were scored; one set on one frame is one set-frame.
        full: Set-frames that scoring all different sets on all frames would take.
    """

    winners: Int64[np.ndarray, " k"]
    scores: Float64[np.ndarray, " k"]
    spent: int
    full: int


class Resampled(NamedTuple):
    """Figures of n sets on some frames, and resamples of blocks of these frames.

    Attributes:
        figure: Figure of each set from the frames, such as its AP.
        resamples: Figure of each set from blocks drawn with replacement; a column has the same
            draw for all sets, so that sets can be compared within it.
        frames: Number of used frames if time ran out, None if all frames were used.
        blocks: Number of blocks (runs of neighbouring frames) that the resamples draw from.
    """

    figure: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]
    frames: int | None = None
    blocks: float = math.inf


ResampledScores = Callable[[Sets, Int64[np.ndarray, " frames"]], Resampled]


class Rung(NamedTuple):
    """Sets that reached one rung of a race, and resamples of their figures there.

    Attributes:
        rows: Row of each set in the array that raced, best first.
        resamples: Figure of each set in each resample, in the order of `rows`.
    """

    rows: Int64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]


@dataclass(frozen=True, eq=False)
class Contest:
    """Course of a race until a confidence.

    Attributes:
        ranking: Rows of all different sets, best first, dropped ones last.
        figures: Measured figure of each set in that order, from the frames it was scored on.
        frames: Number of frames that each set was scored on, in that order.
        confidence: Confidence (0 to 1) that no set beats the first by more than the tolerance.
        spent: Set-frames that were scored; one set on one frame is one set-frame.
        expected: Likeliest figure of each set in that order, given these frames and the
            predictions.
        rungs: Rungs from the first on; without them only `confidence` is known.
        tolerance: Lead in the figure that does not count.
        by_chance: Least doubt (0 to 1) about any set if time ran out, else 0.
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
        """Chance (0 to 1) that some set beats one set by more than the tolerance.

        row: the set's row in the array that raced. judged: rows of sets that are compared
        elsewhere, so they are ignored here."""
        return _doubt(self.rungs, row, self.tolerance, judged)

    def sureness(self, row: int) -> float:
        """Confidence (0 to 1) that no set of the race beats one by more than the tolerance.

        row: the set's row in the array that raced."""
        if not self.rungs:  # nothing to compare by
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

    Sets that tie with the last one to advance also advance, as do all while no score is defined.
    Equal rows are scored once; the first represents all.

    Args:
        partial_scores: Called with sets and some of the frames 0 … frames-1; returns NaN for a set
            without a score there. Each rung passes the frames of the one before, in the same order,
            and more, so earlier work can be reused.
        sets: n sets as rows of booleans.
        frames: Number of frames.
        eta: Factor by which a rung multiplies frames and divides sets.
        first: Number of frames of the first rung.
        keep: Number of best sets.
        seed: Seed of the random order of the frames.

    Raises ValueError without a set or frame, for eta below 2, and for first or keep below 1.
    """
    are_whole = all(isinstance(number, int | np.integer) for number in (frames, first, keep, eta))
    if not are_whole or min(len(sets), frames, first, keep, eta - 1) < 1:
        rule = "a race needs a set, a frame, eta >= 2, first >= 1 and keep >= 1, whole numbers"
        raise ValueError(
            f"{rule}, got {len(sets)} sets, {frames} frames, eta {eta}, first {first} and keep "
            f"{keep}"
        )
    order = np.random.default_rng(seed).permutation(frames)
    _, first_rows = np.unique(sets, axis=0, return_index=True)
    rows = np.sort(first_rows)  # first row of each different set, in the given order
    full = len(rows) * frames
    spent = 0
    used_frames = 0
    while used_frames < frames:
        frame_count = min(frames, max(first, used_frames * eta)) if len(rows) > keep else frames
        scores = np.asarray(partial_scores(sets[rows], order[:frame_count]), float)
        spent = spent + len(rows) * (frame_count - used_frames)
        used_frames = frame_count
        # -(-a // b) is a / b, rounded up
        place_count = keep if used_frames == frames else max(keep, -(-len(rows) // eta))
        best = find_best(scores, place_count)
        rows = rows[best]
        scores = scores[best]
    return Race(winners=rows, scores=scores, spent=spent, full=full)


@dataclass(frozen=True)
class RaceRules:
    """Rules of a race until a confidence. Raises ValueError if they do not fit.

    Attributes:
        confidence: Confidence (0 to 1, both excluded) that ends the race.
        tolerance: Lead in the figure, such as AP, that does not count.
        first: Number of frames of the first rung.
        eta: Factor by which each later rung multiplies the frames.
        least: Number of frames before which no confidence ends the race.
        kept: Largest share of the sets of a rung that go on to the next, rounded up.
        most: Set-frames (sets times frames) to score at most; only as many of the best sets go on
            as the rest allows, but always one.
        target: Figure below which no set matters: the race also ends once the confidence is
            reached that no set has it.
        rival: Figure of a set outside the race, below which the best set hardly matters.
        most_behind: Set-frames to score at most while the best set is expected below `rival`.
    """

    confidence: float = 0.95
    tolerance: float = 0.01
    first: int = 12
    eta: int = 2
    least: int = 0
    kept: float = 1.0
    most: float = math.inf
    target: float = -math.inf
    rival: float = -math.inf
    most_behind: float = math.inf

    def __post_init__(self) -> None:
        """Raise ValueError if the fields do not fit."""
        if (
            min(self.first, self.eta - 1) < 1
            or not 0 < self.confidence < 1
            or not self.tolerance >= 0
            or not 0 < self.kept <= 1
        ):
            raise ValueError(
                "a race until a confidence needs eta >= 2, first >= 1, a confidence between 0 "
                "and 1, a tolerance from 0 up and a kept share above 0 and at most 1, got eta "
                f"{self.eta}, first {self.first}, confidence {self.confidence}, tolerance "
                f"{self.tolerance} and kept {self.kept}"
            )

    def count_kept(self, sets: int, best: float, spent: int, next_frames: int) -> int:
        """Largest number of sets that may go on to the next rung, at least 1.

        Args:
            sets: Number of sets of this rung.
            best: Likeliest figure of the best set.
            spent: Set-frames scored so far.
            next_frames: Frames that the next rung adds."""
        most = self.most
        if best < self.rival:
            most = min(most, self.most_behind)
        affordable = max(1.0, (most - spent) / next_frames)
        return int(min(affordable, math.ceil(self.kept * sets)))


class _Dropped(NamedTuple):
    """Sets that left a race together.

    Attributes:
        rows: Row of each set in the array that raced, best first.
        figures: Measured figure of each set, in the order of `rows`.
        frames: Number of frames from which all these figures are.
    """

    rows: Int64[np.ndarray, " _"]
    figures: Float64[np.ndarray, " _"]
    frames: int


class _RankedRung(NamedTuple):
    """Sets of one rung, best first.

    Attributes:
        rows: Row of each set in the array that raced; the others follow this order.
        measured: Measured figure of each set.
        expected: Likeliest figure, given the prediction too; the measured one without predictions.
        resamples: Likeliest figure in each resample of blocks of frames."""

    rows: Int64[np.ndarray, " _"]
    measured: Float64[np.ndarray, " _"]
    expected: Float64[np.ndarray, " _"]
    resamples: Float64[np.ndarray, "_ resamples"]


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
    race ends with these; order: indices of all frames in the order of their use; predicted: prior
    figure of each row of `sets`, None without; sets are then ranked by both combined
    (`placement_env.analysis.shrinkage.shrink`). Equal rows are scored once. A set is dropped if it
    beats the best in fewer than (1 - confidence) / n of the resamples, or if too many are better
    (`RaceRules.count_kept`). The remaining doubt is the share of resamples in which a set still in
    the race beats the winner by more than the tolerance, plus, for each rung, the share in which a
    set dropped after it does. If time ran out it is at least 2^-blocks, the chance that the same of
    two equal sets is better in every block. Raises ValueError without a set or frame.
    """
    frames = len(order)
    _check_entrants(sets, frames)
    # first row of each different set; from the first rung on the best come first
    running = np.sort(np.unique(sets, axis=0, return_index=True)[1])
    risk = (1 - rules.confidence) / len(running)
    used_frames = spent = 0
    dropped: list[_Dropped] = []
    rungs: list[Rung] = []
    expected = np.zeros(len(sets))
    while True:
        frame_count = min(frames, max(rules.first, used_frames * rules.eta))
        resampled = scores(sets[running], order[:frame_count])
        counted = frame_count if resampled.frames is None else resampled.frames
        spent += len(running) * (counted - used_frames)
        used_frames = counted
        ranked = _rank_rung(resampled, running, predicted)
        running = ranked.rows
        expected[running] = ranked.expected
        rungs.append(Rung(running, ranked.resamples))
        by_chance = 0.0 if resampled.frames is None or len(sets) == 1 else 0.5**resampled.blocks
        confidence = 1 - max(by_chance, _doubt(rungs, int(running[0]), rules.tolerance))
        # the second: time ran out before the frames of this rung
        is_over = used_frames == frames or used_frames < frame_count
        is_known = confidence >= rules.confidence and used_frames >= rules.least
        is_hopeless = _share_at(ranked.resamples, rules.target) <= 1 - rules.confidence
        if is_over or is_known or is_hopeless:
            dropped.append(_Dropped(running, ranked.measured, used_frames))
            break
        next_frames = min(frames, used_frames * rules.eta) - used_frames
        max_sets = rules.count_kept(len(running), float(ranked.expected[0]), spent, next_frames)
        is_running = _find_running(ranked.resamples, risk, max_sets)
        if used_frames >= rules.least and is_running.sum() == 1:  # more frames would change no rank
            dropped.append(_Dropped(running, ranked.measured, used_frames))
            break
        dropped.append(_Dropped(running[~is_running], ranked.measured[~is_running], used_frames))
        running = running[is_running]
    ranked_sets = _rank_dropped(dropped)
    return Contest(
        ranking=ranked_sets.rows,
        figures=ranked_sets.figures,
        frames=ranked_sets.frames,
        confidence=max(0.0, confidence),
        spent=spent,
        expected=expected[ranked_sets.rows],
        rungs=tuple(rungs),
        tolerance=rules.tolerance,
        by_chance=by_chance,
    )


class _RankedSets(NamedTuple):
    """All sets of a race, best first.

    Attributes:
        rows: Row of each set in the array that raced.
        figures: Measured figure of each set.
        frames: Number of frames from which each figure is.
    """

    rows: Int64[np.ndarray, " n"]
    figures: Float64[np.ndarray, " n"]
    frames: Int64[np.ndarray, " n"]


def _rank_dropped(dropped: Sequence[_Dropped]) -> _RankedSets:
    """Rank all sets: those that stayed longest come first.

    dropped: sets that left together, those that left first at the beginning."""
    groups = dropped[::-1]
    counts = np.array([group.frames for group in groups], np.int64)
    return _RankedSets(
        rows=np.concatenate([group.rows for group in groups]),
        figures=np.concatenate([group.figures for group in groups]),
        frames=np.repeat(counts, [len(group.rows) for group in groups]),
    )


def _check_entrants(sets: Sets, frames: int) -> None:
    """Raise ValueError unless a race has at least one set and one frame."""
    if min(len(sets), frames) < 1:
        raise ValueError(
            f"a race until a confidence needs a set and a frame, got {len(sets)} sets, {frames} "
            "frames"
        )


def _rank_rung(
    resampled: Resampled,
    rows: Int64[np.ndarray, " n"],
    predicted: Float64[np.ndarray, " all"] | None,
) -> _RankedRung:
    """Rank the sets of a rung by their figures, combined with the predictions if given.

    resampled: figures of these sets; rows: row of each in the array that raced; predicted: prior
    figure of all rows of that array, None without."""
    expected = resampled.figure
    resamples = resampled.resamples
    if predicted is not None:
        # figures drawn towards the predictions, the more the noisier they are
        shrunk = shrink(resampled.figure, resamples, predicted[rows], resampled.blocks)
        expected = shrunk.figure
        resamples = shrunk.resamples
    ranking = np.argsort(-expected, kind="stable")
    return _RankedRung(
        rows=rows[ranking],
        measured=resampled.figure[ranking],
        expected=expected[ranking],
        resamples=resamples[ranking],
    )


def _find_running(
    resamples: Float64[np.ndarray, "n resamples"], risk: float, max_sets: int
) -> Bool[np.ndarray, " n"]:
    """Mask of the sets that go on to the next rung, the best always among them.

    Args:
        resamples: Resampled figures of the sets, best set first.
        risk: Least share of resamples in which a set must beat the best.
        max_sets: Largest number of sets that may go on.
    """
    lead = resamples - resamples[0]
    lead_share = np.nan_to_num((lead > 0).mean(axis=1))
    is_running = lead_share >= risk
    is_running[0] = True
    is_running &= np.cumsum(is_running) <= max_sets  # the first `max_sets` that are True
    return is_running


def _share_at(resamples: Float64[np.ndarray, "n resamples"], target: float) -> float:
    """Share of the resamples in which any set has the target or more; undefined figures may."""
    is_below = resamples < target
    return float((~is_below).any(axis=0).mean())


def _doubt(
    rungs: Sequence[Rung], winner: int, tolerance: float, judged_rows: Iterable[int] = ()
) -> float:
    """Bound on the chance that some set beats the winner by more than the tolerance.

    On each rung that the winner reached it is the share of resamples in which any set beats it; the
    shares are added, so the sum may exceed 1. Each set counts on the last rung that both it and the
    winner reached.

    Args:
        rungs: Rungs of the race, the first one first.
        winner: Row of the set that is doubted, in the array that raced.
        tolerance: Lead in the figure that does not count.
        judged_rows: Rows of sets that do not count.
    """
    doubt = 0.0
    counted_rows = np.array([*judged_rows], np.int64)
    for rows, resamples in reversed(rungs):
        if winner not in rows:
            continue
        is_better = resamples - resamples[rows == winner] > tolerance  # sets × resamples
        is_new = ~np.isin(rows, counted_rows)
        doubt += float(is_better[is_new].any(axis=0).mean())
        counted_rows = np.union1d(counted_rows, rows)
    return doubt


def find_best(scores: Float64[np.ndarray, " n"], places: int) -> Int64[np.ndarray, " k"]:
    """Indices of the best scores, best first, with all that tie with the last place.

    scores: NaN if undefined; these come last and tie with each other. places: number of scores
    without ties, from 1 up; all scores if there are fewer."""
    ranking = np.argsort(-scores, kind="stable")
    descending = np.nan_to_num(scores[ranking], nan=-np.inf)
    last_place = min(places, len(descending)) - 1
    return ranking[descending >= descending[last_place]]
