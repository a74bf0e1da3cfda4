"""Times of frames that cannot follow each other."""

from collections.abc import Iterator

import numpy as np

from toolkit.arrays import Float64
from toolkit.doctor.findings import Finding, report_error

MIN_FRAME_STEP_S = 1e-3  # least plausible time from frame to frame
MAX_FRAME_STEP_S = 300.0  # largest plausible time from frame to frame


def suspect_times(times: Float64[np.ndarray, " frames"]) -> Iterator[Finding]:
    """Find times that repeat, go back or are in another unit.

    times: time of each frame in order (s); those that are not finite are left out."""
    steps = np.diff(times[np.isfinite(times)])
    backward_count = int((steps <= 0).sum())
    # a few may, since time begins again with each scene or sensor
    if backward_count > max(1, len(steps) / 10):
        evidence = f"{backward_count} of {len(steps)} steps, the smallest of {steps.min():g} s"
        remedy = "check the times, or sort the frames"
        yield report_error(
            where="frames",
            suspected="times that repeat or go back",
            evidence=evidence,
            remedy=remedy,
        )
    elif len(steps) and not MIN_FRAME_STEP_S < np.median(steps) < MAX_FRAME_STEP_S:
        evidence = f"{np.median(steps):g} s from frame to frame, median of {len(steps)}"
        yield Finding(
            severity="warning",
            where="frames",
            suspected="times in another unit than seconds",
            evidence=evidence,
            remedy="check the unit of the times",
        )
