"""Times of frames and clouds, as they are read and written."""

from collections.abc import Sequence

import numpy as np

from toolkit.datasets.record_values import Unchecked, as_number
from toolkit.frame import Frame, SensorCloud


def clock_time(frame: Frame, number: int) -> float:
    """Return the time (s) to write for a frame, `number` tenths of a second if unknown.

    number: number of the frame in its recording. Raises ValueError for a time that is not since
    1970, which no layout with clock times holds."""
    time = frame.time if np.isfinite(frame.time) else 0.1 * number
    if not 0 <= time < 2**31:
        raise ValueError(
            f"frame {frame.name!r} must have seconds since 1970, below 2^31, got {time:g}: mend "
            "its time"
        )
    return time


def cloud_time(cloud: SensorCloud, frame_time_s: float) -> float:
    """Return the time (s) to write for a cloud: the time of its frame if unknown."""
    return frame_time_s if cloud.stamp_s is None else cloud.stamp_s


def frame_time(clouds: Sequence[SensorCloud]) -> float:
    """Return the time (s) of the first cloud as the time of its frame, NaN if unknown."""
    first = clouds[0].stamp_s if clouds else None
    return np.nan if first is None else first


def finite_time(value: Unchecked, name: str) -> float | None:
    """Return a time (s) that a file states, None if it is missing, empty, NaN or infinite.

    name: what errors call it. Raises ValueError for anything but a number."""
    if value is None or value == "":
        return None
    seconds = as_number(value, name)
    return seconds if np.isfinite(seconds) else None
