"""Overlap of tracks and true objects of one class in one frame, and what does not count.

A pair's similarity is the IoU of the volumes, or for people and cyclists, whose heights are
uncertain, 1 at the same place falling to 0 at `MAX_DISTANCE_M` on the ground.

As in KITTI's benchmark of tracking, some true objects are not to be found, such as those outside
the area, and tracks may be where nobody labelled. All are matched at a threshold. Then tracks that
match an object that is not to be found are left out, and tracks outside without a match, and the
objects that are not to be found. Heavy vehicles are such objects when vehicles are scored.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from toolkit.arrays import Bool, Float64, Int64
from toolkit.boxes import iou_3d
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Objects
from toolkit.tracking.tracks import Tracks

MAX_DISTANCE_M = 2.0  # people and cyclists farther apart are not similar at all
SIMILARITY_TOLERANCE = float(np.finfo(np.float64).eps)


class FramePairs(NamedTuple):
    """True objects and tracks of one frame.

    Attributes:
        truth: Id of each true object.
        tracks: Id of each track.
        similarity: 0 to 1, a row for each true object, a column for each track."""

    truth: Int64[np.ndarray, " n"]
    tracks: Int64[np.ndarray, " m"]
    similarity: Float64[np.ndarray, "n m"]


@dataclass(frozen=True, eq=False)
class FrameOverlap:
    """True objects and tracks of one class in one frame.

    Attributes:
        pairs: Their ids and similarity.
        scores: (m,), score of each track in this frame.
        counted: (n,), mask of the true objects that are to be found.
        outside: (m,), mask of the tracks that are no false alarm without a match.
        truth_rows: (n,), row of each true object among all objects of the frame.
        track_rows: (m,), row of each track among all tracks of the frame.
    """

    pairs: FramePairs
    scores: Float64[np.ndarray, " m"]
    counted: Bool[np.ndarray, " n"]
    outside: Bool[np.ndarray, " m"]
    truth_rows: Int64[np.ndarray, " n"]
    track_rows: Int64[np.ndarray, " m"]

    def select(
        self, truth: Bool[np.ndarray, " n"], tracks: Bool[np.ndarray, " m"]
    ) -> "FrameOverlap":
        """Return the overlap of some true objects and some tracks. truth, tracks: masks."""
        pairs = self.pairs
        return FrameOverlap(
            pairs=FramePairs(
                pairs.truth[truth], pairs.tracks[tracks], pairs.similarity[truth][:, tracks]
            ),
            scores=self.scores[tracks],
            counted=self.counted[truth],
            outside=self.outside[tracks],
            truth_rows=self.truth_rows[truth],
            track_rows=self.track_rows[tracks],
        )

    def above(self, score: float, mean_scores: dict[int, float]) -> "FrameOverlap":
        """Return the overlap without the tracks whose mean score is below a score.

        mean_scores: mean score of each track over its frames, by its id."""
        is_above = [mean_scores[number] >= score for number in self.pairs.tracks.tolist()]
        return self.select(np.ones(len(self.counted), np.bool_), np.array(is_above, np.bool_))

    def scored(self, threshold: float) -> "FrameOverlap":
        """Return the overlap without the true objects and tracks that do not count.

        These are the objects that are not to be found, the tracks that match one of them, and the
        tracks outside without a match.

        threshold: similarity from which an object and a track match."""
        if self.counted.all() and not self.outside.any():
            return self
        matched_rows, matched_columns = match_similar(self.pairs.similarity, threshold)
        # mask of tracks; a match decides for a track, also for one outside
        is_ignored = self.outside.copy()
        is_ignored[matched_columns] = ~self.counted[matched_rows]
        return self.select(self.counted, ~is_ignored)


def match_similar(
    similarity: Float64[np.ndarray, "n m"], threshold: float
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Return rows and columns of the one-to-one pairs of greatest similarity in all.

    Pairs below the threshold do not match.

    similarity: n true objects by m tracks, 0 to 1."""
    from scipy.optimize import linear_sum_assignment

    score = np.where(similarity >= threshold - SIMILARITY_TOLERANCE, similarity, 0.0)
    rows, columns = linear_sum_assignment(-score)
    is_match = score[rows, columns] > SIMILARITY_TOLERANCE
    return rows[is_match], columns[is_match]


def measure_overlap(
    tracks: Tracks,
    objects: Objects,
    label: int,
    *,
    counted: ArrayLike | None = None,
    outside: ArrayLike | None = None,
) -> FrameOverlap:
    """Measure the similarity of the true objects and the tracks of one class in a frame.

    Args:
        tracks: Tracks of the frame.
        objects: True objects of the frame.
        label: Number of the class.
        counted: Mask of the objects that are to be found, None for all.
        outside: Mask of the tracks that are no false alarm without a match, None for none."""
    is_of_class = objects.labels == label
    is_present = is_of_class
    if label == VEHICLE:
        is_present = is_of_class | (objects.labels == HEAVY)
    if counted is not None:
        is_of_class = is_of_class & np.asarray(counted, np.bool_)
    is_outside = np.zeros(len(tracks), np.bool_)
    if outside is not None:
        is_outside = np.asarray(outside, np.bool_)
    truth_rows = np.flatnonzero(is_present)
    track_rows = np.flatnonzero(tracks.labels == label)
    true_boxes = objects.boxes[truth_rows]
    boxes = tracks.boxes[track_rows]
    if label in (CYCLIST, PEDESTRIAN):
        offsets = true_boxes[:, None, :2] - boxes[None, :, :2]
        distances = np.hypot(offsets[..., 0], offsets[..., 1])
        similarity = np.maximum(0.0, 1 - distances / MAX_DISTANCE_M)
    else:
        similarity = iou_3d(true_boxes, boxes)
    return FrameOverlap(
        pairs=FramePairs(objects.ids[truth_rows], tracks.ids[track_rows], similarity),
        scores=tracks.scores[track_rows],
        counted=is_of_class[truth_rows],
        outside=is_outside[track_rows],
        truth_rows=truth_rows,
        track_rows=track_rows,
    )
