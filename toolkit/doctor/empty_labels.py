"""Labels without a point of any sensor."""

from collections.abc import Iterator, Sequence

import numpy as np

from toolkit.arrays import BoxRows
from toolkit.boxes import count_points
from toolkit.doctor.box_fits import GroundView
from toolkit.doctor.explanations import undo_each
from toolkit.doctor.findings import Finding
from toolkit.doctor.label_frames import other_frames

MAX_EMPTY_SHARE = 0.5  # largest share of sound labels without a point
MAX_EXPLAINED_EMPTY_SHARE = 0.2  # the same, once a mistake is undone that explains them


def suspect_empty(views: Sequence[GroundView]) -> Iterator[Finding]:
    """Find labels that mostly have no point of any sensor inside.

    The finding names the wrong frame of coordinates if boxes would have points without it. views:
    frames with their points above the ground."""
    empty_count, total = _count_empty(views, [view.sample.objects.boxes for view in views])
    if not total or empty_count / total <= MAX_EMPTY_SHARE:
        return
    observation = f"{empty_count} of {total} boxes hold no point above the ground"
    samples = [view.sample for view in views]
    # the labels moved to the world from each frame that they may be in by mistake
    explanations = [
        undo_each(other_frame.mistake, views, other_frame.choose)
        for other_frame in other_frames(samples)
    ]
    best = max(explanations, key=lambda attempt: float(attempt.fits.mean()))
    remaining_count, _ = _count_empty(views, best.boxes)
    if remaining_count / total <= MAX_EXPLAINED_EMPTY_SHARE:
        evidence = f"{observation}, {remaining_count} with that undone"
        yield Finding("error", "labels", best.mistake.name, evidence, best.mistake.remedy)
        return
    remedy = (
        "check the frame and unit of labels, the poses of sensors, and that labels and clouds "
        "belong together"
    )
    yield Finding("warning", "labels", "boxes without a point from any sensor", observation, remedy)


def _count_empty(views: Sequence[GroundView], boxes: Sequence[BoxRows]) -> tuple[int, int]:
    """Number of boxes without a point above the ground, and number of all boxes.

    boxes: boxes (m, 7) of each view, in place of its labels."""
    counts = [
        count_points(view.points, view_boxes)
        for view, view_boxes in zip(views, boxes, strict=True)
        if len(view_boxes)
    ]
    point_counts = np.concatenate([np.zeros(0, np.int64), *counts])
    return int((point_counts == 0).sum()), len(point_counts)
