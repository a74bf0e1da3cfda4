"""Scores of tracks against the truth.

With TP, FP, FN the numbers of matched pairs, of tracks and of true objects without a partner:

    HOTA    mean over thresholds a = .05, .1, … .95 of sqrt(DetA · AssA)  (Luiten et al., IJCV 2021)
    DetA    TP / (TP + FP + FN) at a
    AssA    mean over the matched pairs at a of m / (n + k - m): a true object has n frames and a
            track k, in m of which they are matched
    MOTA    1 - (FP + FN + switches) / true objects, at one threshold (Bernardin and Stiefelhagen
            2008); a switch is a match with another track than the last one
    IDF1    2 · IDTP / (frames of true objects + frames of tracks), one track for each true object
            (Ristani et al. 2016)

A pair's similarity, and which objects and tracks do not count, is defined in
`toolkit.tracking.frame_overlap`. Matches are those of TrackEval: HOTA prefers pairs that are
similar over the whole recording, MOTA those of the frame before. LocA is left out, since its mean
counts 1 at thresholds where nothing matches.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import Objects, label_index
from toolkit.tracking.frame_overlap import SIMILARITY_TOLERANCE, FramePairs, measure_overlap
from toolkit.tracking.tracks import Tracks

THRESHOLDS = np.arange(0.05, 0.99, 0.05)
CLEAR_THRESHOLD = 0.5  # of MOTA, IDF1 and the share mostly tracked
MOSTLY_TRACKED_SHARE = 0.8
_PREFERENCE = 1000.0  # of the pair of the frame before, above any similarity


@dataclass(frozen=True)
class TrackScores:
    """Scores of one class, as defined at the top of the module; NaN without true objects.

    Attributes:
        hota: HOTA.
        deta: Mean of DetA over the thresholds.
        assa: Mean of AssA over the thresholds.
        mota: MOTA.
        idf1: IDF1.
        switches: Number of switches.
        mostly_tracked: Share of the true objects that are matched in more than
            `MOSTLY_TRACKED_SHARE` of their frames.
        objects: Number of true objects."""

    hota: float
    deta: float
    assa: float
    mota: float
    idf1: float
    switches: int
    mostly_tracked: float
    objects: int


def score_tracks(
    tracks: Sequence[Tracks], truths: Sequence[Objects], label: str | int = "vehicle"
) -> TrackScores:
    """Score the tracks of one class in all frames of a recording.

    Args:
        tracks: Tracks in each frame.
        truths: True objects in each frame, with ids that last.
        label: Name or number of the class.

    Raises ValueError for unequal numbers of frames."""
    if len(tracks) != len(truths):
        raise ValueError(
            f"each frame needs tracks and truth, got {len(tracks)} and {len(truths)} frames"
        )
    number = label_index(label)
    frames = []
    for frame_tracks, objects in zip(tracks, truths, strict=True):
        overlap = measure_overlap(frame_tracks, objects, number)
        frames.append(overlap.scored(CLEAR_THRESHOLD).pairs)
    return score_pairs(frames)


def score_pairs(frames: Sequence[FramePairs], threshold: float = CLEAR_THRESHOLD) -> TrackScores:
    """Score tracks whose similarity to the true objects is known in each frame.

    threshold: similarity from which an object and a track match, except for HOTA."""
    numbers = _number(frames)
    truth_ids = numbers.truth_ids
    track_ids = numbers.track_ids
    numbered = numbers.frames
    if not len(truth_ids):
        nan = float("nan")
        return TrackScores(
            hota=nan,
            deta=nan,
            assa=nan,
            mota=nan,
            idf1=nan,
            switches=0,
            mostly_tracked=nan,
            objects=0,
        )
    truth_frames = np.zeros(len(truth_ids))
    track_frames = np.zeros(len(track_ids))
    for pairs in numbered:
        truth_frames[pairs.truth] += 1
        track_frames[pairs.tracks] += 1
    deta, assa = _score_hota(numbered, truth_frames, track_frames)
    matches, switches = _match_in_order(numbered, len(truth_ids), threshold)
    matched_frames = np.zeros(len(truth_ids))
    for pairs, match in zip(numbered, matches, strict=True):
        matched_frames[pairs.truth[match.rows]] += 1
    true_positives = matched_frames.sum()
    misses = truth_frames.sum() - true_positives
    false_positives = track_frames.sum() - true_positives
    errors = misses + false_positives + switches
    is_mostly_tracked = matched_frames / truth_frames > MOSTLY_TRACKED_SHARE
    identity_hits = _count_identity_hits(numbered, len(truth_ids), len(track_ids), threshold)
    return TrackScores(
        hota=float(np.sqrt(deta * assa).mean()),
        deta=float(deta.mean()),
        assa=float(assa.mean()),
        mota=float(1 - errors / truth_frames.sum()),
        idf1=float(2 * identity_hits / (truth_frames.sum() + track_frames.sum())),
        switches=switches,
        mostly_tracked=float(is_mostly_tracked.mean()),
        objects=len(truth_ids),
    )


class _Numbers(NamedTuple):
    """Numbers of true objects and tracks.

    Attributes:
        truth_ids: Id of each true object, by its number.
        track_ids: Id of each track, by its number.
        frames: Frames with numbers in place of ids."""

    truth_ids: Int64[np.ndarray, " truths"]
    track_ids: Int64[np.ndarray, " tracks"]
    frames: list[FramePairs]


def _number(frames: Sequence[FramePairs]) -> _Numbers:
    """Number all true objects and tracks of a recording from 0 on, in the order of their ids."""
    no_ids = np.zeros(0, np.int64)
    truth_ids = np.unique(np.concatenate([no_ids, *(pairs.truth for pairs in frames)]))
    track_ids = np.unique(np.concatenate([no_ids, *(pairs.tracks for pairs in frames)]))
    numbered = []
    for pairs in frames:
        truth = np.searchsorted(truth_ids, pairs.truth)
        tracks = np.searchsorted(track_ids, pairs.tracks)
        numbered.append(FramePairs(truth, tracks, pairs.similarity))
    return _Numbers(truth_ids, track_ids, numbered)


def _score_hota(
    frames: Sequence[FramePairs],
    truth_frames: Float64[np.ndarray, " truths"],
    track_frames: Float64[np.ndarray, " tracks"],
) -> tuple[Float64[np.ndarray, " a"], Float64[np.ndarray, " a"]]:
    """DetA and AssA (0 to 1) at each of `THRESHOLDS`.

    Args:
        frames: Frames with numbers in place of ids: of N true objects and M tracks.
        truth_frames: Number of frames of each true object.
        track_frames: Number of frames of each track."""
    from scipy.optimize import linear_sum_assignment

    # similarity of each true object and each track, summed over the frames; in each frame as a
    # share of their similarities to all partners
    shared = np.zeros((len(truth_frames), len(track_frames)))
    for truth, tracks, similarity in frames:
        total = similarity.sum(axis=0) + similarity.sum(axis=1)[:, None] - similarity
        share = np.where(
            total > SIMILARITY_TOLERANCE, similarity / np.maximum(total, SIMILARITY_TOLERANCE), 0.0
        )
        shared[truth[:, None], tracks] += share
    alignment = shared / (truth_frames[:, None] + track_frames - shared)
    # number of frames in which a true object and a track match, at each threshold
    matches = np.zeros((len(THRESHOLDS), len(truth_frames), len(track_frames)))
    for truth, tracks, similarity in frames:
        rows, columns = linear_sum_assignment(-alignment[truth[:, None], tracks] * similarity)
        is_match = similarity[rows, columns] >= THRESHOLDS[:, None] - SIMILARITY_TOLERANCE
        for number, mask in enumerate(is_match):
            matches[number, truth[rows[mask]], tracks[columns[mask]]] += 1
    true_positives = matches.sum(axis=(1, 2))
    # pairs, and partners that either side lacks
    everything = truth_frames.sum() + track_frames.sum() - true_positives
    association = matches / np.maximum(1, truth_frames[:, None] + track_frames - matches)
    assa = (matches * association).sum(axis=(1, 2)) / np.maximum(1, true_positives)
    return true_positives / np.maximum(1, everything), assa


class ClearMatch(NamedTuple):
    """Pairs of one frame, matched for MOTA.

    Attributes:
        rows: Row of each matched object in the frame's pairs.
        columns: Column of its track."""

    rows: Int64[np.ndarray, " k"]
    columns: Int64[np.ndarray, " k"]


class ClearCounts(NamedTuple):
    """Matches and counts for MOTA.

    Attributes:
        matches: Matched pairs of each frame.
        false_positives: Number of tracks without a match, in all frames.
        misses: Number of true objects without a match, in all frames.
        switches: Number of switches.
        objects: Number of true objects, in all frames."""

    matches: list[ClearMatch]
    false_positives: int
    misses: int
    switches: int
    objects: int


def match_clear(frames: Sequence[FramePairs], threshold: float = CLEAR_THRESHOLD) -> ClearCounts:
    """Match true objects and tracks frame by frame, preferring the pairs of the frame before.

    threshold: similarity from which an object and a track match."""
    numbers = _number(frames)
    matches, switches = _match_in_order(numbers.frames, len(numbers.truth_ids), threshold)
    matched = sum(len(match.rows) for match in matches)
    objects = sum(len(pairs.truth) for pairs in frames)
    tracks = sum(len(pairs.tracks) for pairs in frames)
    return ClearCounts(
        matches,
        false_positives=tracks - matched,
        misses=objects - matched,
        switches=switches,
        objects=objects,
    )


def _match_in_order(
    frames: Sequence[FramePairs], objects: int, threshold: float
) -> tuple[list[ClearMatch], int]:
    """Matched pairs of each frame, and the number of switches.

    Pairs of the frame before are preferred; a frame without objects or tracks is passed over.

    Args:
        frames: Frames with numbers in place of ids.
        objects: Number of true objects in all frames.
        threshold: Similarity from which an object and a track match."""
    from scipy.optimize import linear_sum_assignment

    last = np.full(objects, -1)  # track of each object's last match, -1 without one
    before = np.full(objects, -1)  # track of its match in the frame before, -1 without one
    switches = 0
    matches = []
    nothing = ClearMatch(np.zeros(0, np.int64), np.zeros(0, np.int64))
    for truth, tracks, similarity in frames:
        if not len(truth) or not len(tracks):
            matches.append(nothing)
            continue
        score = similarity + _PREFERENCE * (tracks == before[truth][:, None])
        score[similarity < threshold - SIMILARITY_TOLERANCE] = 0.0
        rows, columns = linear_sum_assignment(-score)
        is_match: Bool[np.ndarray, " k"] = score[rows, columns] > SIMILARITY_TOLERANCE
        match = ClearMatch(rows[is_match], columns[is_match])
        matched = truth[match.rows]
        partners = tracks[match.columns]
        switches += int(((last[matched] >= 0) & (last[matched] != partners)).sum())
        last[matched] = partners
        before[:] = -1
        before[matched] = partners
        matches.append(match)
    return matches, switches


def _count_identity_hits(
    frames: Sequence[FramePairs], objects: int, tracks: int, threshold: float
) -> float:
    """Largest number of matches (IDTP) if each true object has one and the same track throughout.

    Args:
        frames: Frames with numbers in place of ids.
        objects: Number of true objects in all frames.
        tracks: Number of tracks in all frames.
        threshold: Similarity from which both are similar."""
    from scipy.optimize import linear_sum_assignment

    similar_frames = np.zeros((objects, tracks))
    for truth, frame_tracks, similarity in frames:
        rows, columns = np.nonzero(similarity >= threshold - SIMILARITY_TOLERANCE)
        similar_frames[truth[rows], frame_tracks[columns]] += 1
    rows, columns = linear_sum_assignment(-similar_frames)
    return float(similar_frames[rows, columns].sum())
