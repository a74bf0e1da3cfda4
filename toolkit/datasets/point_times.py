"""Times of a cloud's points in seconds, from a column of an unstated unit.

- A unit at the end of the name counts: `offset_ns`, `time_us`, `timestamp_ms`.
- Numbers since 1970 show their unit: seconds, milli-, micro- or nanoseconds.
- Other whole numbers are nanoseconds, as in Ouster, Livox and Argoverse, others seconds, as in
  Velodyne, Hesai and RoboSense.

A sweep takes a millisecond to ten seconds. If another unit would give that and this one does not,
the unit is not known, and no times are better than wrong ones."""

import re

import numpy as np

from toolkit.arrays import Float64, Shaped

COLUMN = re.compile(r"(?:offset|t|time|timestamp|time_stamp|offset_time)(?:_(s|ms|us|ns))?")
UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
EPOCH_S = (1e8, 4.1e9)  # 1973 to 2099
MIN_SWEEP_S = 1e-3
MAX_SWEEP_S = 10.0
MIN_SWEEP_POINTS = 100  # fewer may be a moment's


def is_time(name: str) -> bool:
    """True for a column that holds times of points."""
    return name != "offset" and COLUMN.fullmatch(name) is not None


def parse_point_times(
    name: str, times: Shaped[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"] | None:
    """Return seconds since the first point, None if the unit of the column is not known.

    >>> parse_point_times("t", np.array([0, 50_000_000], np.uint32))
    array([0.  , 0.05])
    >>> parse_point_times("t", np.arange(0, 100_000, 100)) is None  # microseconds?
    True
    """
    is_whole = times.dtype.kind in "iu"
    if is_whole:
        ticks = times.astype(np.int64)
    else:
        ticks = np.nan_to_num(times.astype(np.float64), posinf=0.0, neginf=0.0)
    if not len(ticks):
        return np.zeros(0)
    ticks_since_first = ticks - ticks.min()
    stated_unit = _find_unit(name) or _find_epoch_unit(float(np.median(ticks)))
    if stated_unit is not None:
        return ticks_since_first * stated_unit
    usual_unit = UNITS_S["ns" if is_whole else "s"]
    span = float(ticks_since_first.max())
    # units in which the points take as long as a sweep
    plausible_units = [
        unit for unit in UNITS_S.values() if MIN_SWEEP_S <= span * unit <= MAX_SWEEP_S
    ]
    is_sweep = len(ticks) >= MIN_SWEEP_POINTS
    is_doubtful = is_sweep and bool(plausible_units) and usual_unit not in plausible_units
    if is_doubtful or span * usual_unit > MAX_SWEEP_S:
        return None
    return ticks_since_first * usual_unit


def _find_unit(name: str) -> float | None:
    """Seconds in the unit at the end of a column's name, such as 1e-9 for _ns; None without one."""
    name_match = COLUMN.fullmatch(name)
    return UNITS_S[name_match[1]] if name_match is not None and name_match[1] else None


def _find_epoch_unit(time: float) -> float | None:
    """Seconds in the unit in which a number is a time since 1970; None for no such unit."""
    return next(
        (unit for unit in UNITS_S.values() if EPOCH_S[0] <= time * unit <= EPOCH_S[1]), None
    )
