"""Times of frames, as tracks need them."""

from collections.abc import Sequence

import numpy as np

MAX_INTERVAL_S = 1.0  # median time between frames; farther apart, road users are not recognised


def find_time_problem(times: Sequence[float]) -> str | None:
    """Return why road users cannot be followed through frames at these times (s), None if they can.

    Times must ascend and be at most `MAX_INTERVAL_S` apart in the median."""
    steps = np.diff(times)
    if len(steps) and not (steps > 0).all():
        number = int(np.argmin(steps > 0)) + 1
        return (
            "tracks need frames in the order of time, each with its own, got "
            f"{times[number]:g} s after {times[number - 1]:g} s at frame {number}"
        )
    if len(steps) and np.median(steps) > MAX_INTERVAL_S:
        return (
            f"tracks need frames at most {MAX_INTERVAL_S:g} s apart, got {np.median(steps):g} s: "
            "record more often, or simulate with --every 0.1"
        )
    return None
