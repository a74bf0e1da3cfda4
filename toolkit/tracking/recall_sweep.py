"""MOTA over all recalls: AMOTA and sAMOTA (Weng, Wang, Held and Kitani, IROS 2020).

A track's score is the mean of its scores over its frames. The score of recall r (1/40, 2/40, … 1)
is found among the true positives in descending order of their tracks' scores, at the one whose
number is nearest to r · G, with G true objects. Tracks below this score are left out, and false
positives FP, misses FN and switches S are counted as for MOTA.

    AMOTA    sum over r of 1 - (FP + FN + S) / G, divided by 40
    sAMOTA   sum over r of 1 - (FP + FN + S - (1 - r) · G) / (r · G), cut to 0 to 1, divided by 40

No two recalls have one true positive. If the last true positive has no recall yet, the first recall
beyond it has it; later ones count 0. So fewer than 40 true objects cannot have an sAMOTA of 1.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.tracking.frame_overlap import FrameOverlap
from toolkit.tracking.scores import CLEAR_THRESHOLD, match_clear

RECALLS = 40


class SweepScores(NamedTuple):
    """Scores over all recalls, NaN without true objects.

    Attributes:
        amota: AMOTA.
        samota: sAMOTA."""

    amota: float
    samota: float


class RecallPoint(NamedTuple):
    """Recall, and the score from which tracks are taken to reach it."""

    recall: float
    score: float


def sweep_recalls(
    frames: Sequence[FrameOverlap], threshold: float = CLEAR_THRESHOLD
) -> SweepScores:
    """Score the tracks of one class in all frames at each recall; AMOTA and sAMOTA are the means.

    Both are NaN without true objects.

    Args:
        frames: True objects and tracks of each frame.
        threshold: Similarity from which an object and a track match."""
    # by number of the track
    mean_scores = average_scores(frames)
    scored = [overlap.scored(threshold) for overlap in frames]
    clear = match_clear([overlap.pairs for overlap in scored], threshold)
    objects = clear.objects
    if not objects:
        return SweepScores(float("nan"), float("nan"))
    hit_scores = []
    for overlap, match in zip(scored, clear.matches, strict=True):
        hit_ids = overlap.pairs.tracks[match.columns].tolist()
        hit_scores += [mean_scores[number] for number in hit_ids]
    # number of false positives, misses and switches, by the least score of the tracks that count
    errors_by_score: dict[float, int] = {}
    amota = 0.0
    samota = 0.0
    for recall, score in list_recalls(np.array(hit_scores), objects):
        if score not in errors_by_score:
            surer = [overlap.above(score, mean_scores).scored(threshold) for overlap in frames]
            counts = match_clear([overlap.pairs for overlap in surer], threshold)
            errors_by_score[score] = counts.false_positives + counts.misses + counts.switches
        errors = errors_by_score[score]
        amota += 1 - errors / objects
        # MOTA without the misses that a recall below 1 implies
        scaled = 1 - (errors - (1 - recall) * objects) / (recall * objects)
        samota += min(1.0, max(0.0, scaled))
    return SweepScores(amota / RECALLS, samota / RECALLS)


def average_scores(frames: Sequence[FrameOverlap]) -> dict[int, float]:
    """Return the mean score of each track over its frames, by its id."""
    scores: dict[int, list[float]] = {}
    for overlap in frames:
        rows = zip(overlap.pairs.tracks.tolist(), overlap.scores.tolist(), strict=True)
        for number, score in rows:
            scores.setdefault(number, []).append(score)
    return {number: float(np.mean(values)) for number, values in scores.items()}


def list_recalls(scores: Float64[np.ndarray, " n"], objects: int) -> list[RecallPoint]:
    """List the recalls k / `RECALLS` (k = 1, 2, …) that are reached, with the score of each.

    In the order of falling scores, true positive number r · `objects`, rounded, reaches recall r.
    No two recalls have the same true positive.

    Args:
        scores: Score of each true positive's track, in any order.
        objects: Number of true objects."""
    descending = np.sort(scores)[::-1].tolist()
    points = []
    count = 0  # true positives with at least the score of the last point
    for number in range(RECALLS + 1):
        if count == len(descending):
            break
        recall = number / RECALLS
        # rounded, a half down; errors of the product at the tenth digit must not round up
        nearest = int(np.ceil(round(recall * objects - 0.5, 9)))
        count = min(max(nearest, count + 1), len(descending))
        points.append(RecallPoint(recall, descending[count - 1]))
    return points[1:]  # the first has a recall of 0
