"""Outcomes of detections and labels, by class.

They follow the rule `measured` of `toolkit.detection.evaluation`: a detection is true if its IoU by
volume with a label of its class, which no surer detection took, is at least
`toolkit.detection.metrics.TRUE_IOU`."""

from functools import partial
from typing import Literal

import numpy as np

from toolkit.detection.breakdown import select_truth
from toolkit.detection.detect import FrameDetections
from toolkit.detection.metrics import TRUE_IOU, matches, second_labels
from toolkit.objects import LABELS, Detections
from toolkit.plots.line_style import Outcome

# part of a scene that holds one outcome; `MARKED` gives the outcome, and so the style, of each part
Marked = Literal["hits", "missed", "false alarms", "ignored"]
_OUTCOMES: tuple[tuple[Marked, Outcome], ...] = (
    ("hits", "hit"),
    ("missed", "missed"),
    ("false alarms", "false alarm"),
)
MARKED: dict[Marked, Outcome] = {**dict(_OUTCOMES), "ignored": "not scored"}


def sort_outcomes(detected: FrameDetections) -> dict[Marked, dict[str, Detections]]:
    """Boxes (world frame) by outcome and name of the class, {} for a frame without labels.

    detected: the frame, its detections, and the area in which labels count.

    They are detections, but "missed" holds labelled boxes, with scores NaN. Classes without a box
    are left out. Every detection is a hit, a false alarm or ignored: beyond the area or the
    complete labels, or on an object that does not count. The second label of an object is a false
    alarm."""
    if not len(detected.frame.objects):
        return {}
    truth = select_truth(detected.frame, detected.stand.corners)
    detections = detected.detections
    is_outside = ~truth.inside(detected.detections)
    # pairs detections with labels, see `toolkit.detection.metrics.Match` for what comes back
    match_class = partial(
        matches, detections, truth.objects, counted=truth.counted, outside=is_outside
    )
    is_second = second_labels(detections, truth.objects, counted=truth.counted, outside=is_outside)
    boxes_by_part: dict[Marked, dict[str, Detections]] = {part: {} for part in MARKED}
    for label, name in enumerate(LABELS):
        # one threshold gives one match; its `truth` has the row of each detection's object,
        # negative for a detection without one
        (match,) = match_class([TRUE_IOU[label]], label=label)
        is_of_class = detections.labels == label
        is_false = (~match.ignored & (match.truth < 0)) | (is_second & is_of_class)
        missed_objects = truth.objects[match.scored & ~match.hit]
        no_scores = np.full(len(missed_objects), np.nan)
        class_boxes: dict[Marked, Detections] = {
            "hits": detections[~match.ignored & (match.truth >= 0)],
            "missed": Detections(
                boxes=missed_objects.boxes, scores=no_scores, labels=missed_objects.labels
            ),
            "false alarms": detections[is_false],
            "ignored": detections[match.ignored & is_of_class & ~is_second],
        }
        for part, boxes in class_boxes.items():
            if len(boxes):
                boxes_by_part[part][name] = boxes
    return boxes_by_part
