"""Doctor of labels: mistakes that points give away.

A mistake is reported if the boxes fit better without it than chance explains
(`toolkit.doctor.box_fits`)."""

from collections.abc import Iterable, Sequence

import numpy as np

from toolkit.arrays import FrameBoxes
from toolkit.datasets import problem_kinds
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, GroundView, fits_better, measure_view_fits
from toolkit.doctor.empty_labels import suspect_empty
from toolkit.doctor.explanations import MAX_TIED_FIT_GAP, MIN_CHOICE_GAIN, choose_clearer
from toolkit.doctor.findings import Finding
from toolkit.doctor.label_headings import suspect_headings
from toolkit.doctor.label_mistakes import LOST_DEGREES
from toolkit.doctor.label_offset import find_offset
from toolkit.doctor.label_search import MIN_TURN_GAIN, find_explanation, turn_each
from toolkit.doctor.label_shifts import find_shift
from toolkit.frame import Frame

MIN_SUNK_SHARE = 0.3  # least share of its height by which the median box is off the ground
MIN_FULL_TURN_SHARE = 0.2  # least share of yaws beyond a full turn, for yaws in degrees
MIN_CERTAIN_FIT_SHARE = 0.3  # least mean fit of an explanation that is certain


def diagnose_labels(samples: Iterable[Frame]) -> list[Finding]:
    """Return findings about the labels of consecutive frames."""
    return diagnose_boxes([GroundView.from_frame(sample) for sample in samples])


def diagnose_boxes(views: Sequence[GroundView]) -> list[Finding]:
    """Return findings about the labels of consecutive frames, none for sound labels.

    Yaws in degrees come first, then mistakes of all boxes, empty boxes, delays, and headings: later
    checks need labels that passed the earlier ones. views: frames with their points above the
    ground."""
    label_count = sum(len(view.sample.objects) for view in views)
    full_turn_count = sum(view.sample.problems.get(problem_kinds.FULL_TURNS, 0) for view in views)
    if full_turn_count and full_turn_count >= MIN_FULL_TURN_SHARE * label_count:
        evidence = f"{full_turn_count} of {label_count} yaws are beyond a full turn in radians"
        return [
            Finding(
                severity="error",
                where="labels",
                suspected="yaw in degrees where radians belong",
                evidence=evidence,
                remedy="multiply yaw by pi / 180",
            )
        ]
    boxes = [view.sample.objects.boxes for view in views]
    findings = list[Finding]()
    current_fits = measure_view_fits(views, boxes)
    best = find_explanation(views, current_fits)
    # A heading for each box explains an offset too, so an offset wins even if it fits a bit worse.
    has_free_headings = best is not None and best.mistake is LOST_DEGREES
    margin = -MIN_CHOICE_GAIN if has_free_headings else MAX_TIED_FIT_GAP
    best = choose_clearer(best, find_offset(views, current_fits), margin)
    if best is not None:
        findings.append(
            compare_fits(
                best.mistake.name,
                fits_before=current_fits,
                fits_after=best.fits,
                remedy=best.mistake.remedy,
            )
        )
        boxes = best.boxes
    findings += suspect_heights(views, boxes)
    if findings:
        return findings
    empty_findings = [*suspect_empty(views)]
    if empty_findings:
        return empty_findings
    shift = find_shift(views)
    if shift is not None:
        side = "behind" if shift.is_behind else "ahead of"
        sign = "+" if shift.is_behind else "-"
        name = f"labels lie about {shift.amount} {side} the clouds"
        remedy = f"move labels by {sign}{shift.amount} along their way, or pair other clouds"
        return [compare_fits(name, shift.fits_before, shift.fits_after, remedy)]
    turned = turn_each(views)
    if fits_better(current_fits, turned.fits, MIN_TURN_GAIN):
        return [
            compare_fits(
                LOST_DEGREES.name,
                fits_before=current_fits,
                fits_after=turned.fits,
                remedy=LOST_DEGREES.remedy,
            )
        ]
    return suspect_headings([view.sample for view in views])


def suspect_heights(views: Sequence[GroundView], boxes: Sequence[FrameBoxes]) -> list[Finding]:
    """Find boxes whose z is the height of their floor or roof instead of their centre.

    views: frames with their ground; boxes: boxes (m, 7) of each frame, world frame. Returns one
    finding or none."""
    # heights of centres above the ground as shares of their boxes' heights; 0.5 is right
    shares_by_frame = [np.zeros(0)]
    for view, view_boxes in zip(views, boxes, strict=True):
        if view.ground is not None:
            centre_z, box_height = view_boxes[:, 2], view_boxes[:, 5]
            ground_z = view.ground.height(view_boxes[:, :2])
            shares_by_frame.append((centre_z - ground_z) / box_height)
    shares = np.concatenate(shares_by_frame)
    share = float(np.median(shares)) if len(shares) >= MIN_FITTED_BOXES else 0.5
    if not abs(share - 0.5) >= MIN_SUNK_SHARE:  # also for a share that is NaN
        return []
    side = "floor" if share < 0.5 else "roof"
    remedy = "add half the height to z" if share < 0.5 else "take half the height off z"
    words = f"the centre of the {side} where the centre of the box belongs"
    evidence = (
        f"the stored centres stand {share:.0%} of the boxes' heights above the ground, median "
        f"of {len(shares)}"
    )
    return [
        Finding(severity="error", where="labels", suspected=words, evidence=evidence, remedy=remedy)
    ]


def compare_fits(
    mistake: str, fits_before: np.ndarray, fits_after: np.ndarray, remedy: str
) -> Finding:
    """Return a finding whose evidence is the mean fit before and after.

    Args:
        mistake: the mistake in words.
        fits_before: fit of each box as it is, 0 to 1.
        fits_after: fit of each box with the mistake undone.
        remedy: what the user should do about it, in words."""
    means = f"{fits_before.mean():.0%} as they are, {fits_after.mean():.0%} with that undone"
    if fits_after.mean() < MIN_CERTAIN_FIT_SHARE:
        remedy += (
            "; few boxes fit even then, so the cause may be another, such as a shift: draw a "
            "frame by coview view"
        )
    return Finding(
        severity="error",
        where="labels",
        suspected=mistake,
        evidence=f"mean fit of {len(fits_before)} boxes to the points: {means}",
        remedy=remedy,
    )
