"""Labels without a point of any sensor."""

from collections.abc import Iterator, Sequence

from toolkit.arrays import FrameBoxes
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
    boxes = [view.sample.objects.boxes for view in views]
    box_count = sum(len(view_boxes) for view_boxes in boxes)
    empty_count = _count_empty(views, boxes)
    if not box_count or empty_count / box_count <= MAX_EMPTY_SHARE:
        return
    observation = f"{empty_count} of {box_count} boxes hold no point above the ground"
    samples = [view.sample for view in views]
    # the labels moved to the world from each frame that they may be in by mistake
    explanations = [
        undo_each(other_frame.mistake, views, other_frame.choose)
        for other_frame in other_frames(samples)
    ]
    best = max(explanations, key=lambda explanation: float(explanation.fits.mean()))
    remaining_count = _count_empty(views, best.boxes)
    if remaining_count / box_count <= MAX_EXPLAINED_EMPTY_SHARE:
        evidence = f"{observation}, {remaining_count} with that undone"
        yield Finding(
            severity="error",
            where="labels",
            suspected=best.mistake.name,
            evidence=evidence,
            remedy=best.mistake.remedy,
        )
        return
    remedy = (
        "check the frame and unit of labels, the poses of sensors, and that labels and clouds "
        "belong together"
    )
    yield Finding(
        severity="warning",
        where="labels",
        suspected="boxes without a point from any sensor",
        evidence=observation,
        remedy=remedy,
    )


def _count_empty(views: Sequence[GroundView], boxes: Sequence[FrameBoxes]) -> int:
    """Number of boxes without a point above the ground.

    boxes: boxes (m, 7) of each view, world frame, which are counted instead of its labels."""
    empty_count = 0
    for view, view_boxes in zip(views, boxes, strict=True):
        if len(view_boxes):
            empty_count += int((count_points(view.points, view_boxes) == 0).sum())
    return empty_count
