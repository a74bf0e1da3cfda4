"""Detections of one set on the final traffic, box by box."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from placement_env.analysis.intervals import Tally
from placement_env.classes import Classes
from placement_env.fidelity.detector import Detected, choose_home, detect_in_frames
from placement_env.report.planning import judging
from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.points import count_on_ground


@dataclass(frozen=True, eq=False)
class ScoredBoxes:
    """Detections of one sensor set and the scored objects, box by box.

    The t objects and n detections of all frames follow one another, frame after frame. Boxes have
    the columns x, y, z, length, width, height (m) and yaw (rad), in the site's frame.

    Attributes:
        truths: Boxes of the scored objects.
        truth_frame: Frame of each object, from 0.
        truth_label: Class of each object, an index into `LABELS`.
        points: Number of the set's points on each object.
        boxes: Boxes of the detections.
        scores: Score of each detection.
        frame: Frame of each detection, from 0.
        label: Class of each detection, an index into `LABELS`.
        hits: At each IoU threshold, the index into `truths` that each detection hits, or
            FALSE_ALARM (-1) or IGNORED (-2).
        frames: Number of frames.
        classes: Classes that count."""

    truths: Float64[np.ndarray, "t 7"]
    truth_frame: Int64[np.ndarray, " t"]
    truth_label: Int64[np.ndarray, " t"]
    points: Int64[np.ndarray, " t"]
    boxes: Float64[np.ndarray, "n 7"]
    scores: Float64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    label: Int64[np.ndarray, " n"]
    hits: Int64[np.ndarray, "ious n"]
    frames: int
    classes: Classes

    def tally(
        self,
        label: int,
        in_group: Bool[np.ndarray, " t"],
        is_counted: Bool[np.ndarray, " n"],
        iou_index: int,
    ) -> Tally:
        """Tally some objects and some detections of one class at one IoU threshold.

        Args:
            label: Class, an index into `LABELS`.
            in_group: True for the objects to tally, of any class.
            is_counted: True for the detections to tally, of any class.
            iou_index: Row of `hits`."""
        is_truth = in_group & (self.truth_label == label)
        is_detection = is_counted & (self.label == label)
        frame_truths = np.bincount(self.truth_frame[is_truth], minlength=self.frames)
        return Tally(
            scores=self.scores[is_detection],
            hit=self.hits[iou_index, is_detection] >= 0,
            frame=self.frame[is_detection],
            truths=frame_truths,
        )


def score_boxes(judge: judging.Judge, members: tuple[int, ...]) -> ScoredBoxes:
    """Collect objects and detections of one set in all frames of a judge.

    members: indices of the set's candidates, ascending. Detections are by the judge's detector at
    the first error profile."""
    detected = judge.detected  # at the first error profile
    outcomes = judge.outcomes(members)
    objects = [detected.renders.objects(k)[detected.scored(k)] for k in range(judge.frames)]
    detections = detect_in_frames(detected, members, range(judge.frames), are_known=True)
    frame = np.repeat(np.arange(judge.frames), [len(outcome.scores) for outcome in outcomes])
    object_counts = list(map(len, objects))
    # outcomes count objects from 0 in every frame; `first_truth` moves them to rows of all frames
    first_truth = np.cumsum([0, *object_counts])[frame]
    iou_rows = [detected.ious.index(iou) for iou in judge.cases.ious]
    # axes: IoU threshold of the cases, detection; negative without an object
    truth = np.concatenate([outcome.truth for outcome in outcomes], axis=1)[iou_rows]
    return ScoredBoxes(
        truths=np.concatenate([frame_objects.boxes for frame_objects in objects]),
        truth_frame=np.repeat(np.arange(judge.frames), object_counts),
        truth_label=np.concatenate([frame_objects.labels for frame_objects in objects]),
        points=count_set_points(detected, members),  # on each object
        boxes=np.concatenate([frame_detections.boxes for frame_detections in detections]),
        scores=np.concatenate([outcome.scores for outcome in outcomes]),
        frame=frame,
        label=np.concatenate([frame_detections.labels for frame_detections in detections]),
        hits=np.where(truth >= 0, first_truth + truth, truth).astype(np.int64),
        frames=judge.frames,
        classes=detected.classes,
    )


def fuse_clouds(detected: Detected, members: Sequence[int], k: int) -> Float32[np.ndarray, "n 3"]:
    """Return the points of all sensors of a set in frame k, in the site's frame (m)."""
    no_points = np.empty((0, 3), np.float32)  # a set without sensors has a cloud too
    return np.concatenate([no_points, *(detected.renders.clouds(k, c) for c in members)])


def count_set_points(detected: Detected, members: Sequence[int]) -> Int64[np.ndarray, " t"]:
    """Count the points of a set on each scored object, frame after frame.

    members: indices of the set's candidates. The objects have the order of `ScoredBoxes.truths`."""
    frame_counts = count_frame_points(detected, members)
    scored_counts = [counts[detected.scored(k)] for k, counts in enumerate(frame_counts)]
    return np.concatenate([np.empty(0, np.int64), *scored_counts])


def count_frame_points(
    detected: Detected, members: Sequence[int]
) -> Iterator[Int64[np.ndarray, " objects"]]:
    """Yield for each frame the number of points of a set on each object, scored or not.

    members: indices of the set's candidates."""
    job = partial(_count_points, detected, members)
    return detected.processes.map(job, range(detected.frames), home=choose_home, is_quick=True)


def _count_points(
    detected: Detected, members: Sequence[int], k: int
) -> Int64[np.ndarray, " objects"]:
    """Count the points of a set on each object of frame k."""
    boxes = detected.renders.objects(k).boxes
    return count_on_ground(fuse_clouds(detected, members, k), boxes, detected.renders.site)
